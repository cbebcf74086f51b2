"""Itinerary files: what to do and how, from TOML to the settings of each stage.

Either the file's top level gives one part's keys, or [[parts]] lists several:

    energy, walk, wraps, repeat, lead_in, lead_out      a walk
    hold = "up-up", seconds = 2.0                       a stay at an equilibrium
    orbit = "down-up", energy = -0.07, seconds = 60     a stay on a periodic orbit; the only part of its itinerary

In [run] the keys of sensors, drive and disturbances stand side by side, as a user thinks of one bench; [[run.blows]]
lists blows at given times; plant names the model file of a plant of its own. `RunOptions` has the same names:
`mismatch = 0.05` in the file is `--mismatch 0.05`. zeros are of the rig that a run takes place on: what its hanging
arms read, rad, as `dpcontrol commission` measures it.
[controller], [estimator] and [supervisor] have the rest of a run's settings.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from dpcontrol.control.estimator_settings import Augment, FilterSettings
from dpcontrol.control.tracking import AdaptiveSettings, TvlqrSettings
from dpcontrol.dynamics.chain import ArmChainParameters, Uncertainty
from dpcontrol.dynamics.plant import check_component
from dpcontrol.foundation.errors import InputError, remark
from dpcontrol.foundation.settings import Table, parse_toml, read_toml, suggest
from dpcontrol.foundation.shipped import find
from dpcontrol.loop.bench import DisturbanceSettings, DriveSettings, MechanicsSettings, Push, SensorSettings
from dpcontrol.loop.controllers import CONTROLLERS, ESTIMATORS, KEEPERS, estimators_of
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.own import OwnEstimator, OwnExpressions, OwnLaw, OwnPlant, own_object
from dpcontrol.loop.result import SupervisorSettings
from dpcontrol.orbits.lyapunov import equilibria
from dpcontrol.plans.model import Model, load_model, model_from, quoted
from dpcontrol.plans.plausible import rig_oddities
from dpcontrol.plans.run_options import RunOptions
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits, ReferenceSettings
from dpcontrol.references.reference import Reference, load_reference
from dpcontrol.walks.symbols import expanded, parse_walk


@dataclass(frozen=True)
class WalkPart:
    """A walk at one energy in J; walk and wraps are those of the file done `repeat` times."""

    energy: float
    walk: tuple[str, ...]
    wraps: tuple[int, ...]
    repeat: int
    lead_in: int
    lead_out: int


@dataclass(frozen=True)
class HoldPart:
    """A stay at an equilibrium, s."""

    hold: str
    seconds: float


@dataclass(frozen=True)
class OrbitPart:
    """A stay on the sustained orbit about a saddle, energy in J, for about `seconds` s: whole periods."""

    orbit: str
    energy: float
    seconds: float
    family: int


Part = WalkPart | HoldPart | OrbitPart


def read_parts(table: Table, model: Model) -> tuple[Part, ...]:
    """Return the parts of an itinerary's file.

    Raises:
        InputError: an impossible walk, wraps, energy or hold; names file, table, key, value and remedy.
    """
    listed = table.tables("parts")
    if not listed:
        return (_part(table, model),)
    for key in ("walk", "energy", "wraps", "hold", "orbit"):
        if key in table:
            raise InputError(f"{table.where(key)}: the file lists [[parts]]; the key belongs into one of them")
    parts = []
    for one in listed:
        parts.append(_part(one, model))
        if isinstance(parts[-1], OrbitPart):
            raise InputError(f"{one.where('orbit')}: an orbit is kept in an itinerary of its own, without [[parts]]")
        one.finish()
    return tuple(parts)


def _part(table: Table, model: Model) -> Part:
    saddles = model.system.saddles
    if "hold" in table:
        if "walk" in table:
            raise InputError(f"{table.where('hold')}: this part has a walk as well; give each its own [[parts]]")
        return HoldPart(table.text("hold", allowed=equilibria(model.system)), _seconds(table, 2.0))
    if "orbit" in table:
        if "walk" in table:
            raise InputError(
                f"{table.where('orbit')}: an itinerary that keeps an orbit has no walk; remove one of them"
            )
        name = table.text("orbit", allowed=saddles)
        energy = _energy(table, [name], model)
        return OrbitPart(name, energy, _seconds(table, 10.0), table.integer("family", 0))
    # What is impossible at any energy comes first.
    walk, wraps, repeat = _walk(table, saddles)
    visited = [name for symbol in parse_walk(walk, saddles) for name in (symbol.source, symbol.target)]
    energy = _energy(table, visited, model)
    return WalkPart(energy, walk, wraps, repeat, table.integer("lead_in", 2), table.integer("lead_out", 2))


def _seconds(table: Table, default: float) -> float:
    seconds = table.number("seconds", default)
    if not 0.5 <= seconds <= 3600:
        raise InputError(f"{table.where('seconds')} = {seconds!r}: must be 0.5 to 3600 s")
    return seconds


def _energy(table: Table, saddles: Sequence[str], model: Model) -> float:
    """Return the energy, at which each of these saddles has orbits."""
    energy, points = table.number("energy"), equilibria(model.system)
    for saddle in saddles:
        if energy <= points[saddle].energy:
            raise InputError(
                f"{table.where('energy')} = {energy!r} J: {saddle} has Lyapunov orbits only above its own "
                f"{points[saddle].energy!r} J; choose a higher energy"
            )
    return energy


def _walk(table: Table, saddles: Sequence[str]) -> tuple[tuple[str, ...], tuple[int, ...], int]:
    """Return the expanded and repeated walk, its wraps, and the number of repetitions.

    Raises:
        InputError: a walk or wraps that are impossible at any energy; before anything is computed.
    """
    walk, wraps, repeat = table.texts("walk"), table.integers("wraps", ()), table.integer("repeat", 1, least=1)
    try:
        symbols = parse_walk(walk, saddles)
    except InputError as error:
        raise InputError(f"{table.where('walk')}: {error}") from error
    stops = len(walk) - 1
    of = f"a walk of {len(walk)} symbols has {stops} interior stops"
    if repeat > 1:
        if symbols[0].source != symbols[-1].target:
            raise InputError(
                f"{table.where('repeat')} = {repeat}: the walk starts at {symbols[0].source} and ends at "
                f"{symbols[-1].target}; only a walk that ends where it starts can be repeated"
            )
        stops = len(walk)
        of = (
            f"a walk of {stops} symbols that is repeated has {stops} stops, the last from its last symbol back to its "
            "first"
        )
    if len(wraps) != stops:
        raise InputError(
            f"{table.where('wraps')} = {list(wraps)}: {of}; give one whole number for each{table.misspelt('wraps')}"
        )
    walk, wraps = expanded(symbols, wraps)
    return walk * repeat, (wraps * repeat)[: len(walk) * repeat - 1], repeat


_PARTS: Mapping[str, type] = {
    "sensors": SensorSettings,
    "drive": DriveSettings,
    "disturbances": DisturbanceSettings,
    "mechanics": MechanicsSettings,
}
_HOMES = {f.name: part for part, kind in _PARTS.items() for f in fields(kind) if f.name != "explicit"}
"""Which part of the loop's settings has a key of [run]; those of none are the loop's own."""
_OPTION_HOMES = {**_HOMES, **dict.fromkeys(("hold", "on_fall", "attempts"), "supervisor")}
"""The same for the options of a run."""


def read_run_settings(
    run: Table, *, controller: Table, estimator: Table, supervisor: Table, plant: ArmChainParameters | None = None
) -> LoopSettings:
    """Return the settings of a scene's runs, with seed 0; plant: its arms where they are others than the model's.

    Raises:
        InputError: an unknown key or an impossible value; names file, table, key, value and what is allowed.
    """
    blows = [table.settings(Push) for table in run.tables("blows")]
    values = run.remaining()
    known = (
        "rate", "initial_error", "mismatch", "model_uncertainty", "friction", "plant", "travel", "drive_lag",
        "zeros", *_HOMES,
    )  # fmt: skip
    parts = {}
    for part, kind in _PARTS.items():
        own = {k: v for k, v in values.items() if _HOMES.get(k) == part}
        given = {"explicit": tuple(blows)} if part == "disturbances" else {}
        parts[part] = Table(own, file=run.file, name=run.name).settings(kind, also=known, **given)
    rest = Table({k: v for k, v in values.items() if k not in _HOMES}, file=run.file, name=run.name)
    keep = controller.text("keep", "none", allowed=KEEPERS)
    law = _kind(controller, CONTROLLERS, "adaptive" if keep == "none" else "tvlqr")
    if keep != "none" and not isinstance(law, TvlqrSettings):
        raise InputError(
            f'{controller.where("keep")} = {keep!r}: what flies between the stops is kind = "tvlqr", not "{law.kind}"'
        )
    filters = estimators_of(law)
    return rest.settings(
        LoopSettings, also=known, seed=0, keep=keep, plant=plant, controller=law,
        estimator=_kind(estimator, filters, "ekf"), supervisor=supervisor.settings(SupervisorSettings), **parts,
    )  # fmt: skip


def _kind(table: Table, kinds: Mapping[str, type], default: str) -> Any:
    return table.settings(kinds[table.text("kind", default, allowed=kinds)])


def overridden(loop: LoopSettings, options: RunOptions) -> LoopSettings:
    """Return the settings with those that are given replaced. A controller or estimator is named by its kind.

    The plant, which is a file, stays as it is: see `Itinerary.with_run`. A controller that cannot hand over to what
    keeps the stops follows the whole reference itself.

    Raises:
        InputError: an unknown kind, or an impossible value.
    """
    kinds: Mapping[str, Mapping[str, type]] = {"controller": CONTROLLERS, "estimator": ESTIMATORS}
    changes: dict[str, dict[str, Any]] = {}
    own: dict[str, Any] = {}
    for name, value in options.given().items():
        if name == "plant":
            continue
        if name in _OPTION_HOMES:
            changes.setdefault(_OPTION_HOMES[name], {})[name] = value
        elif name not in kinds:
            own[name] = value
        elif not isinstance(value, str) or ".py:" in value:
            made = own_object(name, value)
            law_of = OwnExpressions if made.symbolic else OwnLaw
            own[name] = law_of(made.name, made) if name == "controller" else OwnEstimator(kind=made.name, own=made)
        elif value not in kinds[name]:
            raise InputError(f"{name} = {value!r}: {suggest(str(value), kinds[name])}")
        elif value != getattr(loop, name).kind:
            default: Any = kinds[name][value]
            own[name] = default()
    law, filters = own.get("controller", loop.controller), own.get("estimator", loop.estimator)
    adaptive, knows = isinstance(law, AdaptiveSettings), Augment.PARAMETERS in filters.augments
    defaults = estimators_of(law).get(filters.kind, OwnEstimator)
    if adaptive and isinstance(filters, OwnEstimator):
        raise InputError(
            f'controller: kind = "adaptive" needs the errors of the model, which {filters.kind} does not estimate; use '
            '"tvlqr"'
        )
    others = not isinstance(filters, OwnEstimator) and own.keys() & kinds
    if others and (type(filters) is not defaults or (adaptive and not knows)):
        # The adaptive law needs the parameters' errors.
        needed = {"augment": defaults.augment} if adaptive and not knows else {}
        own["estimator"] = defaults(**{**_changed(filters), **needed})
    if not isinstance(law, TvlqrSettings):
        own.setdefault("keep", "none")
    own |= {part: replace(getattr(loop, part), **values) for part, values in changes.items()}
    return replace(loop, **own)


def setting_of(loop: LoopSettings, name: str) -> Any:
    """Return the value of the setting that `overridden` would replace by this name: the loop's own, or a part's.

    Of controller and estimator it is the kind.
    """
    value = getattr(getattr(loop, _OPTION_HOMES[name]) if name in _OPTION_HOMES else loop, name)
    return value.kind if name in ("controller", "estimator") else value


def _changed(filters: FilterSettings) -> dict[str, Any]:
    """Return what a filter's settings do not have by default: what the file asks for, whatever the controller."""
    default = type(filters)()
    return {name: value for name, value in vars(filters).items() if value != getattr(default, name)}


ENDS = ("orbit", "rest", "hold")
"""Where an itinerary may start and finish."""


@dataclass(frozen=True)
class Itinerary:
    """One scene: its parts and the settings of every stage. `loop` carries seed 0 until a run gives another.

    start, finish: "orbit" (on the first, last part's orbit; at the start with its exact rates, which no rig can make),
    "rest" (hanging still) or "hold" (at the equilibrium that is its first, last part; both or neither). keeps: whether
    the stops of its walk are planned as stays on sustained orbits, as the file asks for; runs with other controllers
    follow the same reference. zeros (n,) rad, or none: what a rig's hanging arms read.
    stored: the .npz of the plan that it was taken from, if any, and is not planned again.
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
    zeros: tuple[float, ...] = ()
    stored: Path | None = None

    @property
    def stay(self) -> HoldPart | OrbitPart | None:
        """The equilibrium or orbit that it stays at, if it goes nowhere."""
        only = self.parts[0] if len(self.parts) == 1 else None
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

    def with_run(self, options: RunOptions, *, seed: int | None = None) -> "Itinerary":
        """Return the scene with run settings replaced, such as mismatch or controller, and the seed where it is given.

        Raises:
            InputError: an unknown kind or an impossible value; a plant whose file is missing or faulty or that has
                other arms; an uncertainty to draw the plant from that the model's file does not give.
        """
        loop = self.loop
        if options.plant is not None:
            named = isinstance(options.plant, str) and ".py:" not in options.plant
            made = None if named else own_object("plant", options.plant)
            if made is not None and made.symbolic:
                check_component(made.thing, self.model.arms.count)
            arms = None if made else own_plant(str(options.plant), self.model.arms, where="plant")
            loop = replace(loop, plant=arms if made is None else OwnPlant(made.name, made))
        loop = overridden(loop, options)
        scene = replace(self, loop=loop if seed is None else replace(loop, seed=seed))
        _ = scene.uncertainty
        scene.remark_on_rig()
        return scene

    def remark_on_rig(self) -> None:
        """Remark on numbers of the rig that look as if they were given in another unit.

        Raises:
            InputError: a number that no rig has.
        """
        try:
            for sentence in rig_oddities(self.limits, self.loop, arms=self.model.arms.count, zeros=self.zeros):
                remark(f"{self.path}: {sentence}")
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from error


def load_itinerary(name: str) -> Itinerary:
    """Load an itinerary, and its model, by name or path: of a TOML file, or of a plan (.npz) that was made of one.

    A relative model path is taken from the itinerary's folder.

    Raises:
        InputError: no such file, or a mistake in it or in its model: names file, table, key, value and remedy.
    """
    if name.endswith(".npz"):
        return stored_itinerary(Path(name), load_reference(Path(name)))
    path = find("itineraries", name)
    table, text = read_toml(path)
    scene = _itinerary(table, text, path, None)
    scene.remark_on_rig()
    return scene


def stored_itinerary(file: Path, reference: Reference) -> Itinerary:
    """Return the itinerary of a plan's file, from the texts that its reference was made from.

    Raises:
        InputError: it is a reference that no plan made.
    """
    notes = reference.notes
    try:
        model = model_from(notes["made_from"]["model"], notes["model"])
        scene = itinerary_from(notes["made_from"]["scene"], notes["itinerary"], model, folder=file.parent)
    except (KeyError, TypeError) as error:
        raise InputError(f"{file} is a reference, but its notes are not those of a plan: {error}") from error
    return replace(scene, path=file, stored=file)


def itinerary_of(
    model: Model,
    walks: Sequence[WalkPart],
    *,
    name: str,
    start: str = "orbit",
    finish: str = "orbit",
    limits: Limits,
    reference: ReferenceSettings,
) -> Itinerary:
    """Return the itinerary of walks, one after the other; its text is a file that gives the same one.

    Raises:
        InputError: the model has no arms, a saddle of a walk has no orbit at its energy, or an end is none of `ENDS`.
    """
    lines = [f"title = {quoted(name)}", f"model = {quoted(model.name)}", f'start = "{start}"', f'finish = "{finish}"']
    for part in walks:
        lines += [
            "[[parts]]", f"energy = {float(part.energy)!r}", f"walk = [{', '.join(map(quoted, part.walk))}]",
            f"wraps = {list(part.wraps)}", f"lead_in = {part.lead_in}", f"lead_out = {part.lead_out}",
        ]  # fmt: skip
    for table, settings in (("limits", limits), ("reference", reference)):
        values = ((f.name, getattr(settings, f.name)) for f in fields(settings))
        lines += [f"[{table}]", *(f"{key} = {quoted(v) if isinstance(v, str) else repr(v)}" for key, v in values)]
    return itinerary_from("\n".join(lines) + "\n", name, model)


def itinerary_from(text: str, name: str, model: Model, *, folder: Path = Path()) -> Itinerary:
    """Return the itinerary of a file's text, under a name; folder: of the files that it names, such as a plant's.

    Raises:
        InputError: a mistake in it.
    """
    file = folder / f"{name}.toml"
    return _itinerary(parse_toml(text, str(file)), text, file, model)


def _itinerary(table: Table, text: str, path: Path, model: Model | None) -> Itinerary:
    """Return the itinerary of a file's table and text."""
    title = table.text("title", path.stem)
    model = _model(table, path, model)
    _ = model.arms  # an itinerary needs arms on a cart
    parts = read_parts(table, model)
    start = table.text("start", "orbit", allowed=ENDS)
    finish = table.text("finish", start if start == "hold" else "orbit", allowed=ENDS)
    if "hold" in (start, finish) and not (start == finish and all(isinstance(parts[k], HoldPart) for k in (0, -1))):
        raise InputError(
            f'{table.where("start")} = "hold": for an itinerary whose first and last part are holds, and its finish as '
            'well; others start at "rest", or in simulation at "orbit"'
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
    run = table.table("run")
    zeros = run.numbers("zeros", ())
    if zeros and len(zeros) != model.arms.count:
        raise InputError(f"{run.where('zeros')} has {len(zeros)} values; give one for each of {model.arms.count} arms")
    own = run.text("plant", "")
    plant = own_plant(own, model.arms, where=run.where("plant"), beside=path.parent) if own else None
    loop = read_run_settings(
        run, plant=plant, controller=table.table("controller"), estimator=table.table("estimator"),
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
    return Itinerary(path.stem, path, title, model, parts, start, finish, limits, reference, loop, text, keeps, zeros)


def _model(table: Table, path: Path, given: Model | None) -> Model:
    name = table.text("model", "lab")
    if given is not None:
        return given
    return _named_model(name, where=table.where("model"), beside=path.parent)


def _named_model(name: str, *, where: str, beside: Path | None) -> Model:
    """Return a model by name or path, which is taken from the folder `beside` where it is there."""
    own = None if beside is None else beside / name
    try:
        return load_model(str(own) if own is not None and name.endswith(".toml") and own.is_file() else name)
    except InputError as error:
        raise InputError(f"{where} = {name!r}: {error}") from error


def own_plant(name: str, arms: ArmChainParameters, *, where: str, beside: Path | None = None) -> ArmChainParameters:
    """Return the arms of a plant's own model file, given by name or path, in the place of the model's `arms`.

    Raises:
        InputError: no such file, a mistake in it, or another number of arms; begins with `where`.
    """
    own = _named_model(name, where=where, beside=beside)
    if own.arms.count != arms.count:
        raise InputError(
            f"{where} = {name!r}: the plant has {own.arms.count} arms, the itinerary's model {arms.count}; give "
            "a plant of as many arms"
        )
    return own.arms


def _reference(table: Table) -> ReferenceSettings:
    settings = table.settings(ReferenceSettings)
    try:
        method_named(settings.method)
    except InputError as error:
        raise InputError(f"{table.where('method')}: {error}") from error
    return settings
