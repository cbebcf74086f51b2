"""The itinerary that a page puts together: its TOML text is the only truth, everything else is read from it."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import parse_toml, with_values
from dpcontrol.planner.shown import fitting_model
from dpcontrol.scenes.itinerary import Itinerary, WalkPart, itinerary_from
from dpcontrol.scenes.model import Model, quoted
from dpcontrol.walks.symbols import parse_walk

LONGEST = 100_000
"""Characters of a text that is read."""
_NAME = "itinerary"
_TEXT = """\
title  = "Planned by looking"
model  = {model}
energy = {energy!r}
walk   = []
wraps  = []
start  = "rest"
finish = "rest"

[run]
mismatch      = 0.02
initial_error = 0.02
"""


@dataclass(frozen=True)
class Mistake:
    """A mistake in a text: its line, counted from 1, and the sentence."""

    line: int
    message: str


@dataclass(frozen=True)
class Draft:
    """An itinerary's text as far as it can be read; mistake: None where it is whole, or only lacks its first symbol.

    values: the keys of the file. model: as loaded, None where there is none. itinerary: None where it lacks its first
    symbol or has a mistake.
    """

    text: str
    values: dict[str, Any]
    model: Model | None
    itinerary: Itinerary | None
    mistake: Mistake | None

    @property
    def walk(self) -> list[str]:
        """The symbols, those of all parts in order."""
        return list(self.itinerary.walk) if self.itinerary else _listed(self.values.get("walk"), str)

    @property
    def wraps(self) -> list[int]:
        """The wraps at the interior stops."""
        return list(self.itinerary.wraps) if self.itinerary else _listed(self.values.get("wraps"), int)

    @property
    def energy(self) -> float | None:
        """The energy of the walk, or of its first part, J."""
        if self.itinerary is not None:
            return self.itinerary.walks[0].energy if self.itinerary.walks else None
        energy = self.values.get("energy")
        return float(energy) if isinstance(energy, int | float) else None

    @cached_property
    def stops(self) -> list[str]:
        """The saddles that the walk visits, in order."""
        try:
            symbols = parse_walk(self.walk, self.model.system.saddles) if self.model and self.walk else ()
        except InputError:
            return []
        return [symbols[0].source, *(symbol.target for symbol in symbols)] if symbols else []

    @property
    def fixed(self) -> str:
        """Why the walk cannot be changed by pointing, or ""."""
        if self.mistake is not None and not self.values:
            return f"line {self.mistake.line} of the TOML has a mistake: correct it first, or undo"
        if "parts" in self.values:
            return "the TOML lists [[parts]]: change it as text"
        if self.itinerary and not all(isinstance(part, WalkPart) for part in self.itinerary.parts):
            return "the TOML holds or keeps a place: change it as text"
        if self.values.get("repeat", 1) != 1:
            return "the TOML repeats its walk: change it as text"
        return ""

    def document(self) -> dict[str, Any]:
        """Return what the page shows of it."""
        run = self.values.get("run")
        return {
            "model": self.values.get("model", "lab"),
            "energy": self.energy,
            "walk": self.walk,
            "wraps": self.wraps,
            "stops": self.stops,
            "start": self.values.get("start", "orbit"),
            "finish": self.values.get("finish", "orbit"),
            "toml": self.text,
            "settings": run if isinstance(run, dict) else {},
            "mistake": vars(self.mistake) if self.mistake else None,
            "fixed": self.fixed,
            "whole": self.itinerary is not None,
        }

    def changed(self, table: str, values: dict[str, Any]) -> str:
        """Return the text with keys of a table, or of the top level ("") set.

        Raises:
            InputError: the text cannot be changed by pointing.
        """
        if self.fixed and (not self.values or values.keys() & {"walk", "wraps"}):
            raise InputError(self.fixed)
        return with_values(self.text, table, values, file=f"{_NAME}.toml")


def first_text(model: str, energy: float) -> str:
    """Return the text that a page begins with."""
    return _TEXT.format(model=quoted(model), energy=energy)


def read_draft(text: str) -> Draft:
    """Return what a text says."""
    if len(text) > LONGEST:
        return Draft(text, {}, None, None, Mistake(1, f"the text has more than {LONGEST:,} characters"))
    values: dict[str, Any] = {}
    model = None
    try:
        values = parse_toml(text, f"{_NAME}.toml").remaining()
        model = fitting_model(str(values.get("model", "lab")))
        if values.get("walk") == [] and not values.get("wraps") and "parts" not in values:
            # A walk is begun by its first symbol; until then everything else is checked with one that exists.
            begun = [f"{model.system.saddles[0]} +"]
            itinerary_from(with_values(text, "", {"walk": begun}, file=f"{_NAME}.toml"), _NAME, model)
            return Draft(text, values, model, None, None)
        return Draft(text, values, model, itinerary_from(text, _NAME, model), None)
    except InputError as error:
        message = str(error).removeprefix(f"{_NAME}.toml").lstrip(": ")
        return Draft(text, values, model, None, Mistake(line_of(text, message), message))


def line_of(text: str, message: str) -> int:
    """Return the line, counted from 1, that a message about a TOML text is about."""
    lines = text.splitlines() or [""]
    if found := re.search(r"at line (\d+)", message):
        return min(int(found[1]), len(lines))
    if "end of document" in message:
        return len(lines)
    named = re.match(r"\[+([\w.-]+)\]+", message)
    places: list[tuple[int, int]] = []
    table = ""
    for k, line in enumerate(lines, start=1):
        header = re.match(r"\s*\[+\s*([\w.-]+)\s*\]+", line)
        table = header[1] if header else table
        key = header or re.match(r"\s*([\w-]+)\s*=", line)
        if key and (not named or (named[1] == table and not header)):
            place = re.search(rf"(?<![\w-]){re.escape(key[1])}(?![\w-])", message)
            places += [(place.start(), k)] if place else []
    # The key that a message is about comes first in it.
    return min(places, default=(0, 1))[1]


def _listed(value: Any, kind: type) -> list[Any]:
    return [one for one in value if isinstance(one, kind)] if isinstance(value, list) else []


def fault_of(status: str, walk: Sequence[str]) -> int | None:
    """Return the number of the symbol, from 0, that a failed plan's sentence names; None where it names none."""
    if found := re.search(r"symbol (\d+)\b", status):
        return min(int(found[1]), len(walk)) - 1 if walk else None
    return next((k for k, text in enumerate(walk) if text in status), None)


def enough_wraps(status: str) -> list[int] | None:
    """Return the wraps that a failed plan's sentence advises, or None."""
    found = re.search(r"must be at least \[([\d, ]*)\]|wraps \[([\d, ]*)\] work", status)
    digits = re.findall(r"\d+", found[1] or found[2] or "") if found else []
    return [int(one) for one in digits] or None
