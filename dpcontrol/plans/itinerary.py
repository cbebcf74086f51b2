"""Itinerary files: from TOML to the settings of each stage.

Either the file's top level gives one part's keys, or [[parts]] lists several:

    energy, walk, wraps, repeat, lead_in, lead_out      a walk
    hold = "up-up", seconds = 2.0, cart = 0.1           a stay at an equilibrium, its cart at a place
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
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError, InputErrors, Mistakes, remark, shortened
from dpcontrol.foundation.settings import check_choice, leaves_of, nearest
from dpcontrol.foundation.shipped import PATHS, find
from dpcontrol.foundation.toml import Choice, Place, Table, Tables, parse_toml, read_toml, table_of, with_values
from dpcontrol.loop.bench import Push
from dpcontrol.loop.controllers import CONTROLLERS, ESTIMATORS, filter_defaults
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.own import OwnEstimator, OwnExpressions, OwnLaw, OwnPlant, names_file, own_object
from dpcontrol.loop.result import SupervisorSettings
from dpcontrol.orbits.lyapunov import equilibria
from dpcontrol.plans.layout import GENTLE, KEEP, RUN, ZEROS, Header, HoldPart, OrbitPart, Pace, Part, WalkPart
from dpcontrol.plans.model import Model, load_model, model_from, quoted
from dpcontrol.plans.overrides import NOT_OF_LOOP, canonical, resolved
from dpcontrol.plans.plausible import rig_oddities
from dpcontrol.references.content import PlanContent
from dpcontrol.references.problem import Limits, ReferenceSettings
from dpcontrol.references.reference import Reference, load_reference
from dpcontrol.walks.symbols import expanded, parse_walk

_PARTS: Mapping[str, type] = {"hold": HoldPart, "orbit": OrbitPart, "walk": WalkPart}
"""The kinds of parts, by the key that only they have."""


def _kind_of_part(values: Mapping[str, Any]) -> str:
    """Return the kind of a part of an itinerary, as the key that only this kind has: "hold", "orbit" or "walk".

    Raises:
        InputError: the part has two of these keys.
    """
    keys = [key for key in _PARTS if key in values] or ["walk"]
    if len(keys) > 1:
        raise InputError(f"{keys[0]}: this part has {keys[1]} as well; give each its own [[parts]]", key=keys[0])
    return keys[0]


def _part(part: Part, system: System) -> Part:
    """Return a part after a check of its names and its energy against the model's system.

    Composite edges and repetitions of a walk are written out, see `_expanded`.

    Raises:
        InputError: an impossible walk, wraps, energy or hold.
    """
    points, saddles = equilibria(system), system.saddles
    if isinstance(part, HoldPart):
        check_choice("hold", points, part.hold)
        return part
    if isinstance(part, OrbitPart):
        check_choice("orbit", saddles, part.orbit)
        visited_saddles = [part.orbit]
    else:
        # A walk that is impossible at any energy is reported first.
        part = _expanded(part, saddles)
        visited_saddles = [name for symbol in parse_walk(part.walk, saddles) for name in (symbol.source, symbol.target)]
    for saddle in visited_saddles:
        if part.energy <= points[saddle].energy:
            reason = f"{saddle} has Lyapunov orbits only above its own {points[saddle].energy:.9g} J"
            raise InputError(f"energy = {part.energy!r} J: {reason}; choose a higher energy", key="energy")
    return part


def _expanded(part: WalkPart, saddles: Sequence[str]) -> WalkPart:
    """Return a walk with its composite edges and repetitions written out as the elementary symbols to plan.

    Raises:
        InputError: a walk or wraps that are impossible at any energy.
    """
    walk, wraps, repeat = part.walk, part.wraps, part.repeat
    try:
        symbols = parse_walk(walk, saddles)
    except InputError as error:
        raise InputError(f"walk: {error}", key="walk") from error
    if repeat > 1 and symbols[0].source != symbols[-1].target:
        ends = f"the walk starts at {symbols[0].source} and ends at {symbols[-1].target}"
        reason = f"{ends}; only a walk that ends where it starts can be repeated"
        raise InputError(f"repeat = {repeat}: {reason}", key="repeat")
    # A repeated walk has one more stop, from its last symbol to its first.
    stops = len(walk) - (repeat == 1)
    if len(wraps) != stops:
        places = "between its symbols" + (", and from its last to its first" if repeat > 1 else "")
        requirement = f"must be whole numbers, one for each of {stops} stops {places}"
        raise InputError(f"wraps = {shortened(list(wraps))}: {requirement}", key="wraps")
    walk, wraps = expanded(symbols, wraps)
    return replace(part, walk=walk * repeat, wraps=(wraps * repeat)[: len(walk) * repeat - 1])


def _law_table(kind: Any) -> Table:
    """Return the table [controller] of a law, which makes its settings and the name of the law that keeps the stops.

    Stops are stays on the sustained orbits of a walk, for which the file may name another law ("none" by default).
    `kind` is the class of the law's settings.
    """

    def settings_and_keeper(values: dict[str, Any], _: object) -> tuple[Any, str]:
        """Return the law's settings and the name of the law that keeps stops, from the table's values by key.

        The second argument, the system of the file's model, is not needed.
        """
        keep = values.pop("keep", "none")
        return kind(**values), keep

    return Table({**table_of(kind).keys, "keep": KEEP}, settings_and_keeper)


def _part_table(kind: Any) -> Table:
    """Return the table of a kind of part, whose values are checked against the model's system if that is known.

    `kind` is the class of the part.
    """

    def part_of_values(values: dict[str, Any], system: System | None) -> Part:
        """Return the part with these values by key, checked and expanded if the model's system is known."""
        return kind(**values) if system is None else _part(kind(**values), system)

    return Table(leaves_of(kind), part_of_values)


_FILTERS = {kind: Table(table_of(settings).keys) for kind, settings in ESTIMATORS.items()}
"""The tables of filters, whose defaults depend on the law."""
BLOWS = Tables(table_of(Push))
"""The list of blows."""
PART = Choice({key: _part_table(kind) for key, kind in _PARTS.items()}, _kind_of_part)
FILE = Table(
    {
        **leaves_of(Header),
        "": PART,
        "parts": Tables(PART),
        "limits": table_of(Limits),
        "reference": table_of(ReferenceSettings),
        "run": Table({**{key: leaf for key, (_, leaf) in RUN.items()}, "zeros": ZEROS, "blows": BLOWS}),
        "controller": Choice({kind: _law_table(law) for kind, law in CONTROLLERS.items()}, lambda law: law.get("kind")),
        "estimator": Choice(_FILTERS, lambda table: table.get("kind", "ekf")),
        "supervisor": table_of(SupervisorSettings),
    }
)
"""The file of an itinerary, in which the key "" has the keys of the only part."""


def _completed(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a file's contents with the default law, and with the keys of an only part under "".

    `start = "anywhere"` becomes a key of [run] and a start on the orbit or the equilibrium.
    """
    controller, completed = document.get("controller", {}), dict(document)
    if document.get("start") == "anywhere" and isinstance(run := document.get("run", {}), dict):
        completed["run"] = {"start": "anywhere", **run}
        completed["start"] = "hold" if "hold" in document else "orbit"
    if isinstance(controller, dict):
        # Dry friction moves an arm that `adaptive` holds by twice as much.
        law_of_walk = "adaptive" if controller.get("keep", "none") == "none" else "tvlqr"
        stays = document.get("finish") != "rest" and not document.get("cart")
        is_held_equilibrium = completed.get("start") == "hold" and "parts" not in document and stays
        completed["controller"] = {"kind": "lqr" if is_held_equilibrium else law_of_walk, **controller}
    keys = [key for kind in _PARTS.values() for key in leaves_of(kind)]
    setting_names = {
        key: key if key in keys else nearest(key, [*FILE.keys, *keys]) for key in document if key not in FILE.keys
    }
    if "parts" not in (*document, *setting_names.values()):
        # The part reports a misspelling of its keys.
        completed[""] = {key: completed.pop(key) for key, setting in setting_names.items() if setting in keys}
    return completed


def overridden(loop: LoopSettings, settings: Mapping[str, Any]) -> LoopSettings:
    """Return a run's settings with the values of some paths (`dpcontrol.plans.overrides`) replaced.

    `plant` and `seconds` change an itinerary; see `Itinerary.with_run`. The setting `keep` names a law that keeps the
    sustained orbits of a walk's stops. A controller that cannot hand over to it follows the whole reference.

    Args:
        loop: settings of the run.
        settings: new values by path.

    Raises:
        InputError: an unknown name, an unknown kind, or an impossible value.
    """
    values = canonical(settings)
    law, filters = (
        _of_kind(role, values[role], getattr(loop, role)) if role in values else getattr(loop, role)
        for role in ("controller", "estimator")
    )
    if isinstance(filters, OwnEstimator) and isinstance(law, AdaptiveSettings):
        raise InputError(
            f'controller: kind = "adaptive" needs the errors of the model, which {filters.kind} does not estimate; use '
            '"tvlqr"'
        )
    if not isinstance(filters, OwnEstimator) and {"controller", "estimator"} & set(values):
        filters = _fitting(filters, law, loop)
    # Only TVLQR hands over to a keeper of stops.
    keep = loop.keep if isinstance(law, TvlqrSettings) else "none"
    changes = {
        "keep" if path == "controller.keep" else path: values[path] for path in values if path not in NOT_OF_LOOP
    }
    return replace(loop, controller=law, estimator=filters, keep=keep).with_(changes)


def _fitting(filters: FilterSettings, law: Any, before: LoopSettings) -> FilterSettings:
    """Return a filter's settings with the defaults that suit a law.

    Values that differ from the defaults for the former law, that of the run's settings `before`, are kept.
    """
    kind, defaults = ESTIMATORS[filters.kind], filter_defaults(filters.kind, law)
    # A filter of another kind than before has the defaults of its kind.
    is_same_kind = filters.kind == before.estimator.kind
    former_defaults = kind(**filter_defaults(filters.kind, before.controller, before.keep) if is_same_kind else {})
    explicit_values = {name: value for name, value in vars(filters).items() if value != getattr(former_defaults, name)}
    if isinstance(law, AdaptiveSettings) and Augment.PARAMETERS not in filters.augments:
        # This law needs the parameters' errors.
        explicit_values["augment"] = defaults["augment"]
    return kind(**{**defaults, **explicit_values})


def _of_kind(role: str, value: Any, now: Any) -> Any:
    """Return the settings of a controller or an estimator that a user names by kind or gives as an object.

    Args:
        role: "controller" or "estimator".
        value: kind, file of a user's law or estimator, or the object itself.
        now: present settings, which are kept if they are of this kind.

    Raises:
        InputError: an unknown kind.
    """
    if not isinstance(value, str) or names_file(value):
        user_object = own_object(role, value)
        if role == "estimator":
            return OwnEstimator(kind=user_object.name, own=user_object)
        return (OwnExpressions if user_object.symbolic else OwnLaw)(user_object.name, user_object)
    kinds: Mapping[str, Any] = {"controller": CONTROLLERS, "estimator": ESTIMATORS}[role]
    check_choice(role, kinds, value)
    return now if value == now.kind else kinds[value]()


def setting_of(loop: LoopSettings, name: str) -> Any:
    """Return the value that a setting has in a run, such as one that a preflight varies.

    Of controller and estimator it is the kind. A setting that the run's law or filter lacks is None.

    Args:
        loop: settings of the run.
        name: path of the setting, or its last part.
    """
    path = resolved(name)
    if path == "controller.keep":
        return loop.keep
    value: Any = loop
    for step in f"{path}.kind".split(".") if path in ("controller", "estimator") else path.split("."):
        value = getattr(value, step, None)
    return value


@dataclass(frozen=True)
class Itinerary:
    """An itinerary: its parts and the settings of every stage.

    `loop` has seed 0 until a run sets another.

    Attributes:
        start, finish: "orbit" (on the first or last part's orbit, at its exact rates, which rigs cannot start from),
            "rest" (hanging) or "hold" (at the equilibrium of the first or last part, or at the saddle of its orbit).
            Runs start with the cart in the middle.
        transfer: time of the transfers whose parts give none.
        near: transfers of similar arms, near which those of this itinerary are sought first.
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
    transfer: Pace = GENTLE
    near: tuple[Reference, ...] = ()

    @property
    def stay(self) -> HoldPart | OrbitPart | None:
        """The equilibrium or orbit of an itinerary without transfers."""
        only = self.parts[0] if len(self.parts) == 1 else None
        stays = self.start == "hold" and self.finish != "rest"
        if isinstance(only, OrbitPart) or (isinstance(only, HoldPart) and stays and not only.cart):
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
        """Return the itinerary with some settings of its run replaced, as the options of a run do.

        Args:
            settings: new values by path.
            seed: seed of the random numbers; None to keep the present one.

        Raises:
            InputError: an unknown kind or an impossible value, a plant with a missing or faulty file or with other
                arms, a drawn plant without an uncertainty in the model's file, or a duration of something else than
                one stay.
        """
        loop, values = self.loop, canonical(settings)
        if "plant" in values:
            loop = replace(loop, plant=self._plant(values["plant"]))
        loop = overridden(loop, settings)
        itinerary = self._lasting(values["seconds"]) if "seconds" in values else self
        itinerary = replace(itinerary, loop=loop if seed is None else replace(loop, seed=seed))
        _ = itinerary.uncertainty
        paths = (path.rpartition(".") for path in values)
        itinerary.remark_on_rig([f"[{table if table in FILE.keys else 'run'}] {key}" for table, _, key in paths])
        return itinerary

    def _lasting(self, seconds: float) -> "Itinerary":
        """Return an itinerary of a single stay with another duration (s), also in the text that a plan stores.

        Raises:
            InputError: the itinerary has walks or several parts, or is that of an existing plan.
        """
        stay = self.parts[0]
        if len(self.parts) > 1 or isinstance(stay, WalkPart) or self.stored is not None:
            raise InputError(f"seconds = {seconds:g}: {self.path} is not the file of one stay; change its [[parts]]")
        text = with_values(self.text, "", {"seconds": seconds})
        return replace(self, text=text, parts=(replace(stay, seconds=seconds),))

    def check_parts(self, planned: "Itinerary") -> None:
        """Reject an itinerary whose stay has another duration than in a plan, which would need a new plan.

        Args:
            planned: itinerary of the plan.

        Raises:
            InputError: a stay has another duration.
        """
        if self.parts != planned.parts:
            raise InputError("seconds: the plan has another duration; change seconds in the file of the itinerary")

    def _plant(self, plant: Any) -> Any:
        """Return the arms of a model's file, or the settings of a user's plant, which are simulated instead of the
        model.
        """
        if isinstance(plant, str) and not names_file(plant):
            return own_plant(plant, self.model.arms, where="plant").arms
        user_object = own_object("plant", plant)
        if user_object.symbolic:
            check_component(user_object.thing, self.model.arms.count)
        return OwnPlant(user_object.name, user_object)

    def remark_on_rig(self, options: Collection[str] = ()) -> None:
        """Emit remarks on numbers of the rig that seem to be in another unit than the expected one.

        Args:
            options: tables and keys of settings that override those of the file, as in "[run] lag".

        Raises:
            InputError: an impossible number.
        """
        try:
            oddities = rig_oddities(self.limits, self.loop, arms=self.model.arms.count, zeros=self.zeros)
            for table, key, sentence in oddities:
                place = "setting" if f"{table} {key}" in options else f"{self.path}: {table}"
                remark(f"{place} {sentence}")
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from error


def load_itinerary(name: str) -> Itinerary:
    """Return an itinerary and its model from a file, by name or path.

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
    itinerary = _itinerary(document, text, path)
    itinerary.remark_on_rig()
    return itinerary


def stored_itinerary(file: Path, reference: Reference) -> Itinerary:
    """Return the itinerary of a plan's file, read from the texts that its reference was made from.

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
    """Return the itinerary from which a plan was made, read from the texts that the plan stores.

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
    """Return the itinerary of walks, one after the other, with a text that gives the same itinerary as a file.

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
    """Return the itinerary that a text in TOML describes, as if it were a file of this name.

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


def _itinerary(
    document: Mapping[str, Any], text: str, path: Path, model: Model | None = None, plant: Model | None = None
) -> Itinerary:
    """Return the itinerary that a file's parsed contents describe.

    Args:
        document: contents of the file.
        text: text of the file.
        path: path of the file, for messages and for files in its folder.
        model: model of the arms. Without it, the model in the file is read.
        plant: model of the plant. Without it, the plant in the file is read, if there is one.

    Raises:
        InputError: names every mistake.
    """
    file_place, mistakes, content = Place(str(path)), Mistakes(), dict[str, Any]()
    document = _completed(document)
    with mistakes:
        name = str(document.get("model", "lab"))
        model = model or _named_model(name, where=f"{file_place} model", at=("", "model"), beside=path.parent)
        _ = model.arms  # an itinerary needs arms on a cart
    with mistakes:
        content = FILE.read(document, file_place, None if model is None else model.system)
    mistakes.report()
    assert model is not None
    run, place, (law, keep) = content.get("run", {}), replace(file_place, table="run"), content["controller"]
    if plant is None and (plant_name := run.get("plant")):
        plant = own_plant(plant_name, model.arms, where=f"{place} plant", beside=path.parent)
    if (zeros := run.get("zeros", ())) and len(zeros) != model.arms.count:
        raise place.refusal(f"zeros has {len(zeros)} values; give one for each of {model.arms.count} arms", "zeros")
    estimator, settings = content.get("estimator", {}), {RUN[key][0]: value for key, value in run.items() if key in RUN}
    settings |= {"plant": None if plant is None else plant.arms, "disturbances.explicit": run.get("blows", ())}
    supervisor = content.get("supervisor", SupervisorSettings())
    with replace(file_place, table="estimator"):
        kind = estimator.get("kind", "ekf")
        filters = ESTIMATORS[kind](**{**filter_defaults(kind, law, keep), **estimator})
    with place:
        loop = LoopSettings(seed=0, keep=keep, controller=law, estimator=filters, supervisor=supervisor).with_(settings)
    parts = content.get("parts") or (content[""],)
    itinerary = Itinerary(
        path.stem, path, content.get("title") or path.stem, model, parts, content.get("start", "orbit"),
        content.get("finish", "hold" if isinstance(parts[-1], HoldPart) else "orbit"), content.get("limits", Limits()),
        content.get("reference", ReferenceSettings()), loop, text, loop.keep != "none", zeros,
        plant="" if plant is None else plant.text, transfer=content.get("transfer", GENTLE),
    )  # fmt: skip
    _check_together(itinerary)
    return itinerary


def _check_together(itinerary: Itinerary) -> None:
    """Reject ends, a level of the reference or a keeper of stops that do not fit the parts.

    The keeper is the law, named by `keep`, that stays on the sustained orbits of a walk's stops.

    Raises:
        InputError: names the first setting that does not fit.
    """
    file_place, (start, finish) = Place(str(itinerary.path)), (itinerary.start, itinerary.finish)
    first, has_parts = itinerary.parts[0], len(itinerary.parts) > 1
    orbits = not has_parts and (start, finish) == ("orbit", "orbit")
    if any(isinstance(part, OrbitPart) for part in itinerary.parts) and not orbits:
        reason = "an itinerary that keeps an orbit has no [[parts]], start and finish; remove these"
        raise file_place.refusal(f"orbit: {reason}", "orbit")
    if start == "orbit" and isinstance(first, HoldPart):
        raise file_place.error(
            "start", start, 'the first part is a hold without an orbit; set start = "hold" or "rest"'
        )
    for number, part in enumerate(itinerary.parts, start=1):
        limit = itinerary.limits.position
        if isinstance(part, HoldPart) and abs(part.cart) >= limit:
            place = replace(file_place, table="parts", number=number) if has_parts else file_place
            raise place.error("cart", part.cart, f"must be within ±{limit:g} m; give limits a longer position")
    keep, conservative = itinerary.loop.keep, itinerary.reference.level == "conservative"
    if conservative and (keep != "none" or not orbits):
        raise replace(file_place, table="reference").error(
            "level", "conservative", 'rest, holds, kept stops and changes of energy need the cart; use "cart"'
        )
    if keep != "none" and not (orbits and isinstance(first, WalkPart)):
        raise replace(file_place, table="controller").error(
            "keep", keep, "keeps the stops of one walk from orbit to orbit; remove it, or start, finish and [[parts]]"
        )


def _named_model(name: str, *, where: str, at: tuple[str, str], beside: Path | None) -> Model:
    """Return a model by name or path; a path is first looked for in the folder `beside`.

    An error begins with `where`, the place of the name, and has the table and key `at`.

    Raises:
        InputErrors: no such file, or mistakes in it.
    """
    file_beside = None if beside is None else beside / name
    try:
        is_beside = file_beside is not None and file_beside.suffix.lower() in PATHS and file_beside.is_file()
        return load_model(str(file_beside) if is_beside else name)
    except InputError as error:
        table, key = at
        raise InputErrors(
            [InputError(f"{where} = {name!r}: {mistake}", table=table, key=key) for mistake in error.errors]
        ) from error


def own_plant(name: str, arms: ArmChainParameters, *, where: str, beside: Path | None = None) -> Model:
    """Return the model of the arms that a simulated plant has instead of the itinerary's.

    Args:
        name: name or path of the file.
        arms: the model's arms, which the plant replaces.
        where: place of the name, with which messages begin.
        beside: folder that is searched first.

    Raises:
        InputError: no such file, a mistake in it, or another number of arms; begins with `where`.
    """
    plant = _named_model(name, where=where, at=("run", "plant"), beside=beside)
    if plant.arms.count != arms.count:
        raise InputError(
            f"{where} = {name!r}: the plant has {plant.arms.count} arms, the itinerary's model {arms.count}; give "
            "a plant of as many arms"
        )
    return plant
