"""Itinerary files: what to do and how, from TOML to the settings of each stage."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dpcontrol.dynamics.uncertain_arms import Uncertainty
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.tables import Table, read_toml
from dpcontrol.lab.loop import LoopSettings
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits, ReferenceSettings
from dpcontrol.scenes.lookup import find
from dpcontrol.scenes.model import Model, load_model
from dpcontrol.scenes.parts import HoldPart, OrbitPart, Part, WalkPart, read_parts
from dpcontrol.scenes.run_settings import overridden, read_run_settings

ENDS = ("orbit", "rest", "hold")
"""Where an itinerary may start and finish."""


@dataclass(frozen=True)
class Itinerary:
    """One scene: its parts and the settings of every stage. `loop` carries seed 0 until a run gives another.

    start, finish: "orbit" (on the first, last part's orbit), "rest" (hanging still) or "hold" (at the equilibrium that
    is its only part). keeps: whether the stops of its walk are planned as stays on sustained orbits, as the file asks
    for; runs with other controllers follow the same reference.
    """

    name: str
    path: Path
    title: str
    model: Model
    parts: tuple[Part, ...]
    start: str
    finish: str
    limits: Limits
    reference: ReferenceSettings
    loop: LoopSettings
    text: str
    keeps: bool = False

    @property
    def stay(self) -> HoldPart | OrbitPart | None:
        """The equilibrium or orbit that it stays at, if it goes nowhere."""
        only = self.parts[0]
        if isinstance(only, OrbitPart) or (isinstance(only, HoldPart) and self.start == "hold"):
            return only
        return None

    @property
    def walks(self) -> tuple[WalkPart, ...]:
        """The parts that are walks."""
        return tuple(part for part in self.parts if isinstance(part, WalkPart))

    @property
    def walk(self) -> tuple[str, ...]:
        """The symbols of all walks, in order."""
        return tuple(text for part in self.walks for text in part.walk)

    @property
    def wraps(self) -> tuple[int, ...]:
        """The wraps of all walks, in order; stops where two parts meet have none."""
        return tuple(count for part in self.walks for count in part.wraps)

    @property
    def uncertainty(self) -> Uncertainty | None:
        """How well the model is known, where runs draw their plant from that.

        Raises:
            InputError: they do, and the model's file does not say.
        """
        return self.model.known_to if self.loop.model_uncertainty else None

    def with_run(self, **overrides: Any) -> "Itinerary":
        """Return the scene with run settings replaced by name, such as mismatch or controller; None keeps.

        Raises:
            InputError: an unknown name or kind, or an impossible value; an uncertainty to draw the plant from that
                the model's file does not give.
        """
        scene = replace(self, loop=overridden(self.loop, overrides))
        _ = scene.uncertainty
        return scene


def load_itinerary(name: str, *, model: Model | None = None) -> Itinerary:
    """Load an itinerary, and its model, by name or path.

    A relative model path is taken from the itinerary's folder. model: taken instead of the one that the file names.

    Raises:
        InputError: no such file, or a mistake in it or in its model: names file, table, key, value and remedy.
    """
    path = find("itineraries", name)
    table, text = read_toml(path)
    title = table.text("title", path.stem)
    model = _model(table, path, model)
    _ = model.arms  # an itinerary needs arms on a cart
    parts = read_parts(table, model)
    start = table.text("start", "orbit", allowed=ENDS)
    finish = table.text("finish", start if start == "hold" else "orbit", allowed=ENDS)
    if "hold" in (start, finish) and not (start == finish and len(parts) == 1 and isinstance(parts[0], HoldPart)):
        raise InputError(
            f'{table.where("start")} = "hold": for an itinerary whose only part is a hold; others start at "orbit" or '
            '"rest"'
        )
    if isinstance(parts[0], OrbitPart) and (start, finish) != ("orbit", "orbit"):
        raise InputError(f'{table.where("orbit")}: an orbit is kept from "orbit" to "orbit"; remove start and finish')
    for key, which, part in (("start", start, parts[0]), ("finish", finish, parts[-1])):
        if which == "orbit" and isinstance(part, HoldPart):
            raise InputError(
                f"{table.where(key)} = {which!r}: the part there is a hold, which no orbit leads to; {key} at rest"
            )
    limits = table.table("limits").settings(Limits)
    reference = _reference(table.table("reference"))
    if reference.level == "conservative" and (start, finish, len(parts)) != ("orbit", "orbit", 1):
        raise InputError(
            f'{path}: [reference] level = "conservative": rest, holds and changes of energy need the cart; use "cart"'
        )
    loop = read_run_settings(
        table.table("run"), controller=table.table("controller"), estimator=table.table("estimator"),
        supervisor=table.table("supervisor"),
    )  # fmt: skip
    keeps = loop.keep != "none"
    if keeps and not (len(parts) == 1 and isinstance(parts[0], WalkPart) and (start, finish) == ("orbit", "orbit")):
        raise InputError(
            f'{path}: [controller] keep = "{loop.keep}": keeps the stops of one walk from orbit to orbit; remove it, '
            "or start, finish and [[parts]]"
        )
    if keeps and reference.level == "conservative":
        raise InputError(
            f'{path}: [reference] level = "conservative": orbits are kept by the cart\'s motion; use "cart", or remove '
            "keep under [controller]"
        )
    table.finish()
    return Itinerary(path.stem, path, title, model, parts, start, finish, limits, reference, loop, text, keeps)


def _model(table: Table, path: Path, given: Model | None) -> Model:
    name = table.text("model", "lab")
    if given is not None:
        return given
    beside = path.parent / name
    try:
        return load_model(str(beside) if name.endswith(".toml") and beside.is_file() else name)
    except InputError as error:
        raise InputError(f"{table.where('model')} = {name!r}: {error}") from error


def _reference(table: Table) -> ReferenceSettings:
    settings = table.settings(ReferenceSettings)
    try:
        method_named(settings.method)
    except InputError as error:
        raise InputError(f"{table.where('method')}: {error}") from error
    return settings
