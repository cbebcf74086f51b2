"""Itinerary files: from TOML to the settings of each stage.

Either the file's top level gives one part's keys, or [[parts]] lists several:

    energy, walk, wraps, repeat, lead_in, lead_out      a walk
    hold = "up-up", seconds = 2.0                       a stay at an equilibrium
    orbit = "down-up", energy = -0.07, seconds = 60     a stay on a periodic orbit; the only part of its itinerary

[run] lists the keys of sensors, drive, disturbances and mechanics side by side. [[run.blows]] lists blows at given
times, plant names a model file for the plant's own arms, and zeros are the readings of the rig's hanging arms, rad.
[controller], [estimator] and [supervisor] have the rest of a run's settings.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from dpcontrol.control.estimator_settings import Augment, FilterSettings
from dpcontrol.control.tracking import AdaptiveSettings, TvlqrSettings
from dpcontrol.dynamics.chain import ArmChainParameters, Uncertainty
from dpcontrol.dynamics.plant import check_component
from dpcontrol.foundation.errors import InputError, Mistakes, remark, together
from dpcontrol.foundation.settings import Place, decode, nearest, parse_toml, read_toml, suggest
from dpcontrol.foundation.shipped import find
from dpcontrol.loop.bench import Push
from dpcontrol.loop.controllers import CONTROLLERS, ESTIMATORS, KEEPERS, estimators_of
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.own import OwnEstimator, OwnExpressions, OwnLaw, OwnPlant, names_file, own_object
from dpcontrol.loop.result import SupervisorSettings
from dpcontrol.orbits.lyapunov import equilibria
from dpcontrol.plans.layout import BENCH, Header, HoldPart, OrbitPart, Part, RunTable, WalkPart
from dpcontrol.plans.model import Model, load_model, model_from, quoted
from dpcontrol.plans.overrides import OBJECTS, canonical, resolved
from dpcontrol.plans.plausible import rig_oddities
from dpcontrol.references.content import PlanContent
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits, ReferenceSettings
from dpcontrol.references.reference import Reference, load_reference
from dpcontrol.walks.symbols import expanded, parse_walk


def _parts(
    document: Mapping[str, Any], listed: Any, model: Model, top: Place, mistakes: Mistakes
) -> tuple[Part | None, ...]:
    """Return the parts of an itinerary's file, None for those with mistakes.

    Args:
        document: keys of the file's one part.
        listed: its [[parts]], if any.
        model: gives equilibria and energies.
        top: of the file.
        mistakes: collects them.
    """
    if listed is None:
        with mistakes:
            return (_part(document, model, top, also=[*_names(Header), *_TABLES, "parts"]),)
        return (None,)
    if not isinstance(listed, list) or not listed or not all(isinstance(one, dict) for one in listed):
        with mistakes:
            raise top.error("parts", listed, "must be tables, each under [[parts]]")
        return ()
    found: list[Part | None] = []
    for number, one in enumerate(listed, start=1):
        place, part = replace(top, table="parts", number=number), None
        with mistakes:
            if "orbit" in one:
                raise place.refusal("orbit: an itinerary that keeps an orbit has no [[parts]]", "orbit")
            part = _part(one, model, place)
        found.append(part)
    return tuple(found)


def _part(values: Mapping[str, Any], model: Model, place: Place, *, also: Sequence[str] = ()) -> Part:
    """Return one part of an itinerary.

    Raises:
        InputError: an impossible walk, wraps, energy or hold; names file, table, key, value and remedy.
    """
    saddles = model.system.saddles
    if "hold" in values:
        if "walk" in values:
            raise place.refusal("hold: this part has a walk as well; give each its own [[parts]]", "hold")
        stay = decode(HoldPart, values, place, also=also)
        if stay.hold not in (names := equilibria(model.system)):
            raise place.error("hold", stay.hold, suggest(stay.hold, names))
        return stay
    if "orbit" in values:
        if "walk" in values:
            raise place.refusal("orbit: an itinerary that keeps an orbit has no walk; remove one of them", "orbit")
        kept = decode(OrbitPart, values, place, also=also)
        if kept.orbit not in saddles:
            raise place.error("orbit", kept.orbit, suggest(kept.orbit, saddles))
        _check_energy(kept.energy, [kept.orbit], model, place)
        return kept
    # A walk that is impossible at any energy is reported first.
    part = _expanded(decode(WalkPart, values, place, also=also), saddles, place)
    visited = [name for symbol in parse_walk(part.walk, saddles) for name in (symbol.source, symbol.target)]
    _check_energy(part.energy, visited, model, place)
    return part


def _check_energy(energy: float, saddles: Sequence[str], model: Model, place: Place) -> None:
    """Reject an energy at which one of these saddles has no orbits.

    Raises:
        InputError: names the saddle and its energy.
    """
    points = equilibria(model.system)
    for saddle in saddles:
        if energy <= points[saddle].energy:
            only = f"{saddle} has Lyapunov orbits only above its own {points[saddle].energy:.9g} J"
            raise place.refusal(f"energy = {energy!r} J: {only}; choose a higher energy", "energy")


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"


def _expanded(part: WalkPart, saddles: Sequence[str], place: Place) -> WalkPart:
    """Return a walk with its powers and repetitions written out.

    Raises:
        InputError: a walk or wraps that are impossible at any energy.
    """
    walk, wraps, repeat = part.walk, part.wraps, part.repeat
    try:
        symbols = parse_walk(walk, saddles)
    except InputError as error:
        raise error.under(f"{place} walk: ", table=place.table, key="walk") from error
    stops = len(walk) - 1
    of = f"a walk of {_count(len(walk), 'symbol')} has {_count(stops, 'interior stop')}"
    if repeat > 1:
        if symbols[0].source != symbols[-1].target:
            ends = f"the walk starts at {symbols[0].source} and ends at {symbols[-1].target}"
            raise place.error("repeat", repeat, f"{ends}; only a walk that ends where it starts can be repeated")
        stops = len(walk)
        of = (
            f"a walk of {stops} symbols that is repeated has {stops} stops, the last from its last symbol back to its "
            "first"
        )
    if len(wraps) != stops:
        raise place.error("wraps", list(wraps), f"{of}; give one whole number for each")
    walk, wraps = expanded(symbols, wraps)
    return replace(part, walk=walk * repeat, wraps=(wraps * repeat)[: len(walk) * repeat - 1])


def _names(kind: type) -> list[str]:
    return [one.name for one in fields(kind)]


def read_run_settings(
    tables: Mapping[str, Mapping[str, Any]], top: Place, *, plant: Model | None = None
) -> tuple[LoopSettings, tuple[float, ...]]:
    """Return the settings of an itinerary's runs, and the rig's zeros.

    The seed is 0.

    Args:
        tables: run, controller, estimator and supervisor of the file.
        top: of the file.
        plant: model of the plant's own arms, if the file names one.

    Raises:
        InputError: every mistake with file, table, key, value and allowed range.
    """
    places = {name: replace(top, table=name) for name in ("run", "controller", "estimator", "supervisor")}
    run, law_keys = dict(tables.get("run", {})), dict(tables.get("controller", {}))
    mistakes, parts, blows, keep = Mistakes(), dict[str, Any](), list[Push](), law_keys.pop("keep", "none")
    law: Any = None
    struck = run.pop("blows", ())
    with mistakes:
        if not isinstance(struck, list | tuple) or not all(isinstance(one, dict) for one in struck):
            raise places["run"].error("blows", struck, "must be a list of tables, [[run.blows]]")
        for number, one in enumerate(struck, start=1):
            with mistakes:
                blows.append(decode(Push, one, replace(top, table="run.blows", number=number)))
    given = RunTable()
    with mistakes:
        given = decode(RunTable, run, places["run"], also=["blows"])
        for part, kind in BENCH.items():
            own = {name: getattr(given, name) for name in _names(kind) if name != "explicit"}
            with mistakes:
                parts[part] = decode(kind, own, places["run"])
        parts |= {name: getattr(given, name) for name in _names(RunTable) if name in _names(LoopSettings)}
        parts["plant"] = None if plant is None else plant.arms
    with mistakes:
        if keep not in KEEPERS:
            raise places["controller"].error("keep", keep, suggest(str(keep), KEEPERS))
        law = _kind(law_keys, CONTROLLERS, "adaptive" if keep == "none" else "tvlqr", places["controller"])
        if keep != "none" and not isinstance(law, TvlqrSettings):
            raise places["controller"].error(
                "keep", keep, f'the law between the stops must be kind = "tvlqr", not "{law.kind}"'
            )
    with mistakes:
        parts["estimator"] = _kind(tables.get("estimator", {}), estimators_of(law), "ekf", places["estimator"])
    with mistakes:
        parts["supervisor"] = decode(SupervisorSettings, tables.get("supervisor", {}), places["supervisor"])
    mistakes.report()
    parts["disturbances"] = replace(parts["disturbances"], explicit=tuple(blows))
    try:
        return LoopSettings(seed=0, keep=keep, controller=law, **parts), given.zeros
    except InputError as error:
        raise error.under(f"{places['run']} ", table="run") from error


def _kind(values: Mapping[str, Any], kinds: Mapping[str, type], default: str, place: Place) -> Any:
    """Return the settings of a controller or an estimator by its kind."""
    kind = values.get("kind", default)
    if not isinstance(kind, str) or kind not in kinds:
        raise place.error("kind", kind, suggest(str(kind), kinds))
    return decode(kinds[kind], values, place)


def overridden(loop: LoopSettings, settings: Mapping[str, Any]) -> LoopSettings:
    """Return a run's settings with some replaced.

    Paths are those of `dpcontrol.plans.overrides`.

    `plant` is a file and stays unchanged; see `Itinerary.with_run`. A controller that cannot hand over to a keeper of
    stops follows the whole reference.

    Args:
        loop: settings of the run.
        settings: new values by path.

    Raises:
        InputError: an unknown name, an unknown kind, or an impossible value.
    """
    given = canonical(settings)
    own = {
        role: _of_kind(role, given[role], getattr(loop, role)) for role in ("controller", "estimator") if role in given
    }
    law, filters = own.get("controller", loop.controller), own.get("estimator", loop.estimator)
    adaptive, augmented = isinstance(law, AdaptiveSettings), Augment.PARAMETERS in filters.augments
    defaults = estimators_of(law).get(filters.kind, OwnEstimator)
    if adaptive and isinstance(filters, OwnEstimator):
        raise InputError(
            f'controller: kind = "adaptive" needs the errors of the model, which {filters.kind} does not estimate; use '
            '"tvlqr"'
        )
    if (
        own
        and not isinstance(filters, OwnEstimator)
        and (type(filters) is not defaults or (adaptive and not augmented))
    ):
        # The adaptive law needs the parameters' errors.
        needed = {"augment": defaults.augment} if adaptive and not augmented else {}
        own["estimator"] = defaults(**{**_changed(filters), **needed})
    loop, changes, mistakes = replace(loop, **own, **_followed(law)), dict[str, dict[str, Any]](), Mistakes()
    for path, value in given.items():
        if path not in OBJECTS:
            part, _, name = path.rpartition(".")
            changes.setdefault("" if path == "controller.keep" else part, {})[name] = value
    top = changes.pop("", {})
    for part, values in changes.items():
        now = getattr(loop, part)
        for name in values:
            if name not in (there := [one for one in _names(type(now)) if one != "kind"]):
                raise InputError(f"{part}.{name}: {now.kind} has no such setting; it has {', '.join(there)}")
        with mistakes:
            top[part] = replace(now, **values)
    with mistakes:
        loop = replace(loop, **top)
    mistakes.report()
    return loop


def _followed(law: Any) -> dict[str, Any]:
    """Return the change of `keep` that goes with a law.

    Only TVLQR hands over to a keeper of stops.
    """
    return {} if isinstance(law, TvlqrSettings) else {"keep": "none"}


def _of_kind(role: str, value: Any, now: Any) -> Any:
    """Return the settings of a controller or an estimator.

    The object is named by its kind or given as an object.

    Raises:
        InputError: an unknown kind.
    """
    kinds: Mapping[str, Any] = {"controller": CONTROLLERS, "estimator": ESTIMATORS}[role]
    if not isinstance(value, str) or names_file(value):
        made = own_object(role, value)
        law = OwnExpressions if made.symbolic else OwnLaw
        return law(made.name, made) if role == "controller" else OwnEstimator(kind=made.name, own=made)
    if value not in kinds:
        raise InputError(f"{role} = {value!r}: {suggest(value, kinds)}")
    return now if value == now.kind else kinds[value]()


def setting_of(loop: LoopSettings, name: str) -> Any:
    """Return the value of a setting of a run.

    Of controller and estimator it is the kind.

    Args:
        loop: settings of the run.
        name: path of the setting, or its last part.
    """
    path = resolved(name)
    if path in ("controller", "estimator"):
        return getattr(loop, path).kind
    part, _, last = path.rpartition(".")
    return loop.keep if path == "controller.keep" else getattr(getattr(loop, part) if part else loop, last, None)


def _changed(filters: FilterSettings) -> dict[str, Any]:
    """Return the settings of a filter that differ from their defaults.

    The file sets these for any controller.
    """
    default = type(filters)()
    return {name: value for name, value in vars(filters).items() if value != getattr(default, name)}


@dataclass(frozen=True)
class Itinerary:
    """An itinerary: its parts and the settings of every stage.

    `loop` has seed 0 until a run sets another.

    Attributes:
        start, finish: "orbit" (on the first or last part's orbit, at its exact rates, which rigs cannot start from),
            "rest" (hanging) or "hold" (at the equilibrium of the first or last part, for both ends or neither).
        keeps: True if the file plans stops as stays on sustained orbits. Other controllers follow the same reference.
        zeros: readings (n,) of a rig's hanging arms, rad, or none.
        stored: .npz file of its existing plan, if any.
        plant: text of the plant's model that the file names, if any.
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
    plant: str = ""

    @property
    def stay(self) -> HoldPart | OrbitPart | None:
        """The equilibrium or orbit of an itinerary without transfers."""
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
        """The wraps of all walks, in order, without stops between parts."""
        return tuple(count for part in self.walks for count in part.wraps)

    @property
    def uncertainty(self) -> Uncertainty | None:
        """Uncertainty of the model, if runs draw their plant from it.

        Raises:
            InputError: they do, and the model's file does not give it.
        """
        return self.model.identified_uncertainty if self.loop.model_uncertainty else None

    def with_run(self, settings: Mapping[str, Any], *, seed: int | None = None) -> "Itinerary":
        """Return the itinerary with some run settings replaced.

        Args:
            settings: new values by path.
            seed: seed of the random numbers; None to keep the present one.

        Raises:
            InputError: an unknown kind or an impossible value, a plant with a missing or faulty file or with other
                arms, or a drawn plant without an uncertainty in the model's file.
        """
        loop = self.loop
        plant = canonical(settings).get("plant")
        if plant is not None:
            named = isinstance(plant, str) and not names_file(plant)
            made = None if named else own_object("plant", plant)
            if made is not None and made.symbolic:
                check_component(made.thing, self.model.arms.count)
            own = OwnPlant(made.name, made) if made else own_plant(str(plant), self.model.arms, where="plant").arms
            loop = replace(loop, plant=own)
        loop = overridden(loop, settings)
        scene = replace(self, loop=loop if seed is None else replace(loop, seed=seed))
        _ = scene.uncertainty
        given = (path.rpartition(".") for path in canonical(settings))
        scene.remark_on_rig([f"[{table if table in _TABLES else 'run'}] {key}" for table, _, key in given])
        return scene

    def remark_on_rig(self, given: Collection[str] = ()) -> None:
        """Emit remarks on numbers of the rig in doubtful units.

        Args:
            given: tables and keys of settings that override those of the file, as in "[run] lag".

        Raises:
            InputError: an impossible number.
        """
        try:
            odd = rig_oddities(self.limits, self.loop, arms=self.model.arms.count, zeros=self.zeros)
            for table, key, sentence in odd:
                begin = "setting" if f"{table} {key}" in given else f"{self.path}: {table}"
                remark(f"{begin} {sentence}")
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from error


def load_itinerary(name: str) -> Itinerary:
    """Load an itinerary, and its model, by name or path.

    A relative model path is taken from the itinerary's folder.

    Args:
        name: name or path of a TOML file, or of a plan (.npz) that was made of one.

    Raises:
        InputError: no such file, or a mistake in it or in its model: names file, table, key, value and remedy.
    """
    if name.endswith(".npz"):
        return stored_itinerary(Path(name), load_reference(Path(name)))
    path = find("itineraries", name)
    document, text = read_toml(path)
    scene = _itinerary(document, text, path)
    scene.remark_on_rig()
    return scene


def stored_itinerary(file: Path, reference: Reference) -> Itinerary:
    """Return the itinerary of a plan's file.

    The itinerary is read from the texts that its reference was made from.

    Args:
        file: file of the plan (.npz).
        reference: reference in that file.

    Raises:
        InputError: it is a reference without a plan.
    """
    if reference.plan is None:
        raise InputError(f"{file} is a reference without a plan; plan an itinerary with --out")
    return replace(planned_itinerary(reference.plan), path=file, stored=file)


def planned_itinerary(content: PlanContent) -> Itinerary:
    """Return the itinerary from whose texts a plan was made.

    Args:
        content: content of the plan.
    """
    origin = content.origin
    return itinerary_from(origin.scene, content.itinerary, model_from(origin.model, content.model), plant=origin.plant)


def itinerary_of(
    model: Model,
    walks: Sequence[WalkPart],
    *,
    name: str,
    start: str = "orbit",
    finish: str = "orbit",
    limits: Limits | None = None,
    reference: ReferenceSettings | None = None,
) -> Itinerary:
    """Return the itinerary of walks, one after the other.

    Its text is a file that gives the same one.

    Args:
        model: model of the arms.
        walks: walks in order.
        name: name and title of the itinerary.
        start: state at the start, one of `ENDS`.
        finish: state at the end, one of `ENDS`.
        limits: the cart's limits (default: those of itineraries).
        reference: settings of the reference (default: those of itineraries).

    Raises:
        InputError: the model has no arms, a saddle of a walk has no orbit at its energy, or an end is none of `ENDS`.
    """
    lines = [f"title = {quoted(name)}", f"model = {quoted(model.name)}", f'start = "{start}"', f'finish = "{finish}"']
    for part in walks:
        lines += [
            "[[parts]]", f"energy = {float(part.energy)!r}", f"walk = [{', '.join(map(quoted, part.walk))}]",
            f"wraps = {list(part.wraps)}", f"lead_in = {part.lead_in}", f"lead_out = {part.lead_out}",
        ]  # fmt: skip
    for table, settings in (("limits", limits or Limits()), ("reference", reference or ReferenceSettings())):
        values = ((f.name, getattr(settings, f.name)) for f in fields(settings))
        lines += [f"[{table}]", *(f"{key} = {quoted(v) if isinstance(v, str) else repr(v)}" for key, v in values)]
    return itinerary_from("\n".join(lines) + "\n", name, model)


def itinerary_from(text: str, name: str, model: Model, *, plant: str = "") -> Itinerary:
    """Return the itinerary of a file's text, under a name.

    Args:
        text: text of a TOML file.
        name: name of the itinerary.
        model: model of the arms.
        plant: text of the plant's model (default: that of the file which the itinerary names).

    Raises:
        InputError: a mistake in it.
    """
    file = Path(f"{name}.toml")
    return _itinerary(parse_toml(text, str(file)), text, file, model, model_from(plant, "plant") if plant else None)


_TABLES = ("limits", "reference", "run", "controller", "estimator", "supervisor")
_SAME_IN_PARTS = {name for kind in (WalkPart, HoldPart, OrbitPart) for name in _names(kind)}


def _itinerary(
    document: Mapping[str, Any], text: str, path: Path, model: Model | None = None, plant: Model | None = None
) -> Itinerary:
    """Return the itinerary of a file's contents and text.

    Raises:
        InputError: names every mistake.
    """
    top, mistakes, rest = Place(str(path)), Mistakes(), dict(document)
    tables: dict[str, Any] = {name: rest.pop(name) for name in _TABLES if name in rest}
    for name, table in list(tables.items()):
        with mistakes:
            if not isinstance(table, dict):
                tables[name] = {}
                raise top.error(name, table, f"must be a table, [{name}]")
    listed, head = rest.pop("parts", None), {name: rest.pop(name) for name in _names(Header) if name in rest}
    if listed is None:
        kind: type = HoldPart if "hold" in rest else OrbitPart if "orbit" in rest else WalkPart
        unknown = [key for key in rest if key not in _SAME_IN_PARTS]
        # The part reports a misspelling of a key that it lacks.
        misspelt = {nearest(name, unknown) for name in _names(kind) if name not in rest}
        head |= {key: rest.pop(key) for key in unknown if key not in misspelt}
    header = unread = Header()
    with mistakes:
        header = decode(Header, head if listed is None else head | rest, top, also=[*_TABLES, *_SAME_IN_PARTS, "parts"])
    with mistakes:
        model = model or _named_model(header.model, where=f"{top} model", at=("", "model"), beside=path.parent)
        _ = model.arms  # an itinerary needs arms on a cart
    if model is None:
        mistakes.report()
    assert model is not None
    parts = _parts(rest, listed, model, top, mistakes)
    limits, reference, loop, zeros = Limits(), ReferenceSettings(), None, ()
    with mistakes:
        limits = decode(Limits, tables.get("limits", {}), replace(top, table="limits"))
    with mistakes:
        reference = _reference(tables.get("reference", {}), replace(top, table="reference"))
    if header.start == "hold" and listed is None:
        # Dry friction moves an arm that `adaptive` holds by twice as much.
        tables["controller"] = {"kind": "lqr", **tables.get("controller", {})}
    with mistakes:
        if plant is None and (named := tables.get("run", {}).get("plant")):
            plant = own_plant(str(named), model.arms, where=f"{replace(top, table='run')} plant", beside=path.parent)
    with mistakes:
        loop, zeros = read_run_settings(tables, top, plant=plant)
        if zeros and len(zeros) != model.arms.count:
            run = replace(top, table="run")
            raise run.refusal(f"zeros has {len(zeros)} values; give one for each of {model.arms.count} arms", "zeros")
    known = tuple(part for part in parts if part is not None)
    start, finish = header.start, head.get("finish", header.start if header.start == "hold" else "orbit")
    if known and len(known) == len(parts) and header is not unread:
        with mistakes:
            _check_ends(known, start, finish, top)
        with mistakes:
            _check_level(known, start, finish, reference, "none" if loop is None else loop.keep, path)
    mistakes.report()
    assert loop is not None
    return Itinerary(
        path.stem, path, header.title or path.stem, model, known, start, finish, limits, reference, loop, text,
        loop.keep != "none", zeros, plant="" if plant is None else plant.text,
    )  # fmt: skip


def _check_ends(parts: tuple[Part, ...], start: str, finish: str, top: Place) -> None:
    """Reject ends that the parts do not have.

    Raises:
        InputError: names the end.
    """
    if "hold" in (start, finish) and not (start == finish and all(isinstance(parts[k], HoldPart) for k in (0, -1))):
        raise top.error(
            "start" if start == "hold" else "finish",
            "hold",
            'is for start and finish together, and for holds as first and last part; use "rest", or in simulation '
            '"orbit"',
        )
    if isinstance(parts[0], OrbitPart) and (start, finish) != ("orbit", "orbit"):
        raise top.refusal('orbit: an orbit is kept from "orbit" to "orbit"; remove start and finish', "orbit")
    for key, which, part in (("start", start, parts[0]), ("finish", finish, parts[-1])):
        if which == "orbit" and isinstance(part, HoldPart):
            raise top.error(key, which, f"the part there is a hold without an orbit; {key} at rest")


def _check_level(
    parts: tuple[Part, ...], start: str, finish: str, reference: ReferenceSettings, keep: str, path: Path
) -> None:
    """Reject a level or a keeper that does not fit.

    They are the reference's level and the keeper of stops.

    Raises:
        InputError: names the setting.
    """
    if reference.level == "conservative" and (start, finish, len(parts)) != ("orbit", "orbit", 1):
        raise InputError(
            f'{path}: [reference] level = "conservative": rest, holds and changes of energy need the cart; use "cart"'
        )
    if keep == "none":
        return
    if not (len(parts) == 1 and isinstance(parts[0], WalkPart) and (start, finish) == ("orbit", "orbit")):
        raise InputError(
            f'{path}: [controller] keep = "{keep}": keeps the stops of one walk from orbit to orbit; remove it, '
            "or start, finish and [[parts]]"
        )
    if reference.level == "conservative":
        raise InputError(
            f'{path}: [reference] level = "conservative": orbits are kept by the cart\'s motion; use "cart", or remove '
            "keep under [controller]"
        )


def _named_model(name: str, *, where: str, at: tuple[str, str], beside: Path | None) -> Model:
    """Return a model by name or path.

    The folder `beside` has priority. An error has the table and key `at`.
    """
    own = None if beside is None else beside / name
    try:
        return load_model(str(own) if own is not None and name.endswith(".toml") and own.is_file() else name)
    except InputError as error:
        table, key = at
        raise together(
            [InputError(f"{where} = {name!r}: {mistake}", table=table, key=key) for mistake in error.errors]
        ) from error


def own_plant(name: str, arms: ArmChainParameters, *, where: str, beside: Path | None = None) -> Model:
    """Return the model of a plant's own arms.

    Args:
        name: name or path of the file.
        arms: the model's arms, which the plant replaces.
        where: place of the name, with which messages begin.
        beside: folder that is searched first.

    Raises:
        InputError: no such file, a mistake in it, or another number of arms; begins with `where`.
    """
    own = _named_model(name, where=where, at=("run", "plant"), beside=beside)
    if own.arms.count != arms.count:
        raise InputError(
            f"{where} = {name!r}: the plant has {own.arms.count} arms, the itinerary's model {arms.count}; give "
            "a plant of as many arms"
        )
    return own


def _reference(values: Mapping[str, Any], place: Place) -> ReferenceSettings:
    settings = decode(ReferenceSettings, values, place)
    try:
        method_named(settings.method)
    except InputError as error:
        raise error.under(f"{place} ", table=place.table, key="method") from error
    return settings
