"""Itinerary files: what to do and how, from TOML to the settings of each stage."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from dpcontrol.control.ekf import EkfSettings
from dpcontrol.control.tracking import ControllerSettings, FeedforwardSettings, TvlqrSettings
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.tables import Table, read_toml, suggest
from dpcontrol.itineraries.walk import parse_walk
from dpcontrol.lab.bench import SensorSettings
from dpcontrol.lab.loop import LoopSettings
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits, ReferenceSettings
from dpcontrol.scenes.lookup import find
from dpcontrol.scenes.model import Model, load_model
from dpcontrol.tubes.equilibria import equilibria

CONTROLLERS: Mapping[str, type[ControllerSettings]] = {"tvlqr": TvlqrSettings, "feedforward": FeedforwardSettings}
"""Kinds of controller and what holds the settings of each."""


@dataclass(frozen=True)
class Itinerary:
    """One scene: the walk and the settings of every stage. `loop` carries seed 0 until a run gives another.

    walk and wraps are those of the file done `repeat` times: what is planned, run and scored.
    """

    name: str
    path: Path
    title: str
    model: Model
    energy: float
    walk: tuple[str, ...]
    wraps: tuple[int, ...]
    repeat: int
    lead_in: int
    lead_out: int
    limits: Limits
    reference: ReferenceSettings
    loop: LoopSettings
    text: str

    def with_run(self, **overrides: Any) -> "Itinerary":
        """Return the scene with run settings replaced: mismatch, initial_error, seed, controller kind; None keeps.

        Raises:
            InputError: an unknown controller or an impossible value.
        """
        given = {key: value for key, value in overrides.items() if value is not None}
        kind = given.pop("controller", None)
        if kind is not None and kind != self.loop.controller.kind:
            if kind not in CONTROLLERS:
                raise InputError(f"controller = {kind!r}: {suggest(kind, CONTROLLERS)}")
            given["controller"] = CONTROLLERS[kind]()
        return replace(self, loop=replace(self.loop, **given))


def load_itinerary(name: str) -> Itinerary:
    """Load an itinerary, and its model, by name or path.

    A relative model path is taken from the itinerary's folder.

    Raises:
        InputError: no such file, or a mistake in it or in its model: names file, table, key, value and remedy.
    """
    path = find("itineraries", name)
    table, text = read_toml(path)
    title = table.text("title", path.stem)
    model = _model(table, path)
    _ = model.arms  # an itinerary needs arms on a cart
    energy = table.number("energy")
    saddles = [name for name, e in equilibria(model.system).items() if e.kind.startswith("index-1")]
    walk, wraps, repeat = _walk(table, saddles)
    _check_energy(table, walk, saddles, model, energy)
    lead_in, lead_out = table.integer("lead_in", 2), table.integer("lead_out", 2)
    table.text("start", "orbit", allowed=("orbit",))
    limits = table.table("limits").settings(Limits)
    reference = _reference(table.table("reference"))
    loop = _loop(table.table("run"), _controller(table.table("controller")), _estimator(table.table("estimator")))
    table.finish()
    return Itinerary(
        path.stem, path, title, model, energy, walk, wraps, repeat, lead_in, lead_out, limits, reference, loop, text
    )  # fmt: skip


def _model(table: Table, path: Path) -> Model:
    name = table.text("model", "lab")
    beside = path.parent / name
    try:
        return load_model(str(beside) if name.endswith(".toml") and beside.is_file() else name)
    except InputError as error:
        raise InputError(f"{table.where('model')} = {name!r}: {error}") from error


def _walk(table: Table, saddles: list[str]) -> tuple[tuple[str, ...], tuple[int, ...], int]:
    """Return the walk and its wraps, repeated as often as asked, and how often that is.

    Raises:
        InputError: a walk or wraps that no energy could save; before anything is computed.
    """
    walk, wraps, repeat = table.texts("walk"), table.integers("wraps", ()), table.integer("repeat", 1, least=1)
    try:
        symbols = parse_walk(walk, saddles)
    except InputError as error:
        raise InputError(f"{table.where('walk')}: {error}") from error
    if repeat == 1 and len(wraps) != len(walk) - 1:
        raise InputError(
            f"{table.where('wraps')} = {list(wraps)}: a walk of {len(walk)} symbols has {len(walk) - 1} interior "
            "stops; give one whole number for each"
        )
    if repeat == 1:
        return walk, wraps, repeat
    if symbols[0].source != symbols[-1].target:
        raise InputError(
            f"{table.where('repeat')} = {repeat}: the walk starts at {symbols[0].source} and ends at "
            f"{symbols[-1].target}; only a walk that ends where it starts can be repeated"
        )
    if len(wraps) != len(walk):
        raise InputError(
            f"{table.where('wraps')} = {list(wraps)}: a walk of {len(walk)} symbols that is repeated has {len(walk)} "
            "stops, the last from its last symbol back to its first; give one whole number for each"
        )
    return walk * repeat, (wraps * repeat)[:-1], repeat


def _check_energy(table: Table, walk: tuple[str, ...], saddles: list[str], model: Model, energy: float) -> None:
    """Refuse an energy at which a saddle of the walk has no orbits."""
    points = equilibria(model.system)
    for saddle in {name for s in parse_walk(walk, saddles) for name in (s.source, s.target)}:
        if energy <= points[saddle].energy:
            raise InputError(
                f"{table.where('energy')} = {energy!r} J: {saddle} has Lyapunov orbits only above its own "
                f"{points[saddle].energy!r} J; choose a higher energy"
            )


def _reference(table: Table) -> ReferenceSettings:
    table.text("level", "cart", allowed=("cart",))
    settings = table.settings(ReferenceSettings)
    try:
        method_named(settings.method)
    except InputError as error:
        raise InputError(f"{table.where('method')}: {error}") from error
    return settings


def _controller(table: Table) -> ControllerSettings:
    kind = CONTROLLERS[table.text("kind", "tvlqr", allowed=CONTROLLERS)]
    return table.settings(kind)


def _estimator(table: Table) -> EkfSettings:
    table.text("kind", "ekf", allowed=("ekf",))
    return table.settings(EkfSettings)


def _loop(table: Table, controller: ControllerSettings, estimator: EkfSettings) -> LoopSettings:
    sensor_names = [f.name for f in fields(SensorSettings)]
    values = table.remaining()
    sensors, rest = (
        Table({k: v for k, v in values.items() if (k in sensor_names) == wanted}, file=table.file, name=table.name)
        for wanted in (True, False)
    )
    found = sensors.settings(SensorSettings)
    return rest.settings(
        LoopSettings, also=sensor_names, seed=0, controller=controller, estimator=estimator, sensors=found
    )
