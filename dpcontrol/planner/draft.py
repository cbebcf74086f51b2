"""Draft of an itinerary, stored only as TOML text."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.toml import parse_toml, with_values
from dpcontrol.planner.shown import energies_of, fitting_model
from dpcontrol.plans.itinerary import Itinerary, WalkPart, itinerary_from
from dpcontrol.plans.model import Model, quoted
from dpcontrol.plans.plan import plan_cost, plan_key
from dpcontrol.walks.symbols import parse_walk

LONGEST = 100_000
"""Largest length of a text in characters."""
_NAME = "planned"
"""Name of every itinerary, because the file's name may be chosen later."""
_USUAL_WRAPS = 2
"""Wraps at a new stop. With two, nearly every pair of connections has an orbit."""
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
    """An error in a text, with line number and message."""

    line: int
    message: str


@dataclass(frozen=True)
class Draft:
    """A possibly incomplete itinerary.

    A text without symbols is not an error.

    Attributes:
        values: keys of the file.
        model: the model, if it could be loaded.
        itinerary: None if the text has an error or no symbols.
        mistake: first error, or None.
    """

    text: str
    values: dict[str, Any]
    model: Model | None
    itinerary: Itinerary | None
    mistake: Mistake | None

    @property
    def walk(self) -> list[str]:
        """The symbols of all parts in order."""
        return list(self.itinerary.walk) if self.itinerary else _listed(self.values.get("walk"), str)

    @property
    def wraps(self) -> list[int]:
        """The wraps at the interior stops; while the text has an error, those that can be read."""
        return list(self.itinerary.wraps) if self.itinerary else _listed(self.values.get("wraps"), int)

    @property
    def energy(self) -> float | None:
        """The energy of the walk, or of its first part, J."""
        if self.itinerary is not None:
            return self.itinerary.walks[0].energy if self.itinerary.walks else None
        energy = self.values.get("energy")
        return float(energy) if isinstance(energy, int | float) and abs(energy) < 1e300 else None

    @cached_property
    def stops(self) -> list[str]:
        """The saddles visited by the walk, in order, or none while the text has an error."""
        itinerary = self.itinerary
        symbols = parse_walk(itinerary.walk, itinerary.model.system.saddles) if itinerary and itinerary.walk else ()
        return [symbols[0].source, *(symbol.target for symbol in symbols)] if symbols else []

    @property
    def fixed(self) -> str:
        """Reason why the walk can be edited only as text, or ""."""
        if self.mistake is not None and not self.values:
            return f"line {self.mistake.line} of the TOML has an error: correct it first, or undo"
        parts = self.itinerary.parts if self.itinerary else ()
        is_repeated = self.values.get("repeat", 1) != 1
        if "parts" in self.values or is_repeated or not all(isinstance(part, WalkPart) for part in parts):
            return "the TOML has parts, holds, sustained orbits or repetitions: edit it as text"
        return ""

    @property
    def problem(self) -> str:
        """Reason why the itinerary cannot be planned, or ""."""
        missing = "" if self.itinerary else "the walk has no symbol yet: click a connection"
        return self.mistake.message if self.mistake else missing

    @property
    def seconds(self) -> float:
        """Likely duration of planning, s."""
        return plan_cost(self.itinerary).seconds if self.itinerary else 0.0

    @cached_property
    def content(self) -> str:
        """The key of the itinerary's plan, independent of name and title, or ""."""
        return "" if self.itinerary is None else plan_key(replace(self.itinerary, name="", title=""))

    def document(self) -> dict[str, Any]:
        """Return the draft as JSON values, which the page shows."""
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
        """Return the draft's text with changed values of keys, as the page's controls set them.

        Args:
            table: name of the table, "" for the top level.
            values: new values by key.

        Raises:
            InputError: the walk can be edited only as text.
        """
        if self.fixed and (not self.values or values.keys() & {"walk", "wraps"}):
            raise InputError(self.fixed)
        return with_values(self.text, table, values)

    def appended(self, symbol: str) -> str:
        """Return the text with one more symbol, and the usual wraps before it.

        Args:
            symbol: symbol that starts where the walk ends.

        Raises:
            InputError: the walk ends elsewhere, or can be edited only as text.
        """
        if self.model and not self.fixed:
            parse_walk([*self.walk, symbol], self.model.system.saddles)
        wraps = [*self.wraps, _USUAL_WRAPS] if self.walk else []
        return self.changed("", {"walk": [*self.walk, symbol], "wraps": wraps})

    def wrapped(self, stop: int, change: int) -> str:
        """Return the text with more or fewer wraps, but at least none, at one stop.

        Args:
            stop: index of the stop.
            change: number of additional wraps.

        Raises:
            InputError: the walk can be edited only as text.
            IndexError: no such stop.
        """
        wraps = self.wraps
        wraps[stop] = max(wraps[stop] + change, 0)
        return self.changed("", {"wraps": wraps})


def first_text(model: str) -> str:
    """Return the text with which a new page begins: an itinerary of a model without symbols.

    Args:
        model: name or path of the model.
    """
    return _TEXT.format(model=quoted(model), energy=energies_of(fitting_model(model))[2])


def read_draft(text: str) -> Draft:
    """Return the draft of a text, in which its first error is stored for the page, since users type step by step.

    Args:
        text: itinerary in TOML.
    """
    values: dict[str, Any] = {}
    model = itinerary = mistake = None
    try:
        if len(text) > LONGEST:
            raise InputError(f"the text has more than {LONGEST:,} characters")
        values = parse_toml(text, f"{_NAME}.toml")
        model = fitting_model(str(values.get("model", "lab")))
        is_empty = values.get("walk") == [] and not values.get("wraps") and "parts" not in values
        # If the walk is empty, the other keys are validated with a placeholder symbol.
        complete_text = with_values(text, "", {"walk": [f"{model.system.saddles[0]} +"]}) if is_empty else text
        valid_itinerary = itinerary_from(complete_text, _NAME, model)
        itinerary = None if is_empty else valid_itinerary
    except InputError as error:
        if values and model is None:
            error = InputError(str(error), key="model")
        message = str(error).removeprefix(f"{_NAME}.toml").lstrip(": ")
        mistake = Mistake(line_of(text, error), message)
    return Draft(text, values, model, itinerary, mistake)


def line_of(text: str, error: InputError) -> int:
    """Return the line number (from 1) of an error in a text.

    It is the line of the error's key in its table. Without this line, it is the one at which parsing stopped, or that
    of the table's header.

    Args:
        text: itinerary in TOML.
        error: error of the itinerary.
    """
    table, header, lines = "", 1, text.splitlines()
    for number, line in enumerate(lines, start=1):
        content = line.partition("#")[0].strip()
        if content.startswith("["):
            table = content.strip("[] ")
            header = number if table == error.table else header
        elif table == error.table and content.partition("=")[0].strip() == error.key != "":
            return number
    return min(error.line, len(lines)) or header


def _listed(value: Any, kind: type) -> list[Any]:
    """Return the entries of this type in a value of the file, none if the value is no list."""
    return [entry for entry in value if isinstance(entry, kind)] if isinstance(value, list) else []
