"""A plan's content: symbols, stops, orbits and costs beside its reference.

Planning makes it, and a reference's file stores it: the fields without arrays as JSON (`notes` of the header), and
the arrays under the names `orbit_K`, the K-th orbit's curve. So a log that holds the reference can be scored and
reviewed without other files.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np

from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.settings import adapter, frozen

REST_BEFORE, REST_AFTER = 0.5, 1.0
"""Time that the pendulum hangs still at the start and after its return, s."""


@dataclass(frozen=True)
class PlanStop:
    """A stop: place of wraps or rest.

    Attributes:
        angles: angles (n,) of its saddle with the turns of the motion, rad.
        orbit: index of its orbit.
        arrived_on: index of the arriving orbit, if the stop changes the energy.
    """

    saddle: str
    angles: tuple[float, ...]
    orbit: int
    arrived_on: int | None = None

    @property
    def orbits(self) -> tuple[int, int]:
        """Indices of the arriving and of the leaving orbit."""
        return self.orbit if self.arrived_on is None else self.arrived_on, self.orbit


@dataclass(frozen=True)
class PlanSection:
    """Section of a connection: normal · state = value, crossed at these angles, rad.

    Attributes:
        name: its name in the system; "" in plans without it.
        hits: crossing numbers of the unstable and the stable tube.
    """

    normal: tuple[float, ...]
    value: float
    angles: tuple[float, ...]
    name: str = ""
    hits: tuple[int, int] = (1, 1)


@dataclass(frozen=True, kw_only=True)
class PlanSymbol:
    """Motion between two stops: a connection, or a transfer, which has neither name nor section.

    Attributes:
        text: symbol as the itinerary writes it, or name of the transfer.
        name: name of the connection, None for a transfer.
        source, target: saddles or equilibria at both ends.
        winding: whole turns of each arm.
        sense: direction of the connection's turn, +1 or -1, 0 for a transfer.
        time: of the section's crossing, or the middle of a transfer, s.
        time_out, time_in: from the orbit to the section and on to the next orbit, s.
        phase_out, phase_in: phases on these orbits.
    """

    text: str
    name: str | None = None
    source: str
    target: str
    winding: tuple[int, ...]
    sense: int = 0
    time: float
    section: PlanSection | None = None
    time_out: float = 0.0
    time_in: float = 0.0
    phase_out: float = 0.0
    phase_in: float = 0.0


def symbol_figures(symbols: Sequence[PlanSymbol], place: int) -> dict[str, Any]:
    """Return the number of a symbol among all symbols, or of a transfer among all transfers, for messages.

    Args:
        symbols: symbols and transfers in order.
        place: index of the symbol or transfer among them; negative from the end.

    Returns:
        Kind of the motion, its number from 1, their count and its name; empty without symbols.
    """
    if not symbols:
        return {}
    transfers = [symbol.section is None for symbol in symbols]
    same_kind = [k for k, transfer in enumerate(transfers) if transfer == transfers[place]]
    return {
        "motion": "transfer" if transfers[place] else "symbol",
        "symbol": same_kind.index(range(len(symbols))[place]) + 1,
        "symbols": len(same_kind),
        "name": symbols[place].text,
    }


@dataclass(frozen=True, eq=False)
class PlanOrbit:
    """A periodic orbit, or an equilibrium.

    Attributes:
        energy: J.
        period: s; of an equilibrium the observation time of its ends.
        multiplier: unstable Floquet multiplier, 1 for an equilibrium.
        curve: states (M, 2n) over a period.
        state, free_period: state (2n,) and period, s, of the Lyapunov orbit, from which tubes are drawn.
    """

    saddle: str
    energy: float
    period: float
    multiplier: float
    curve: Array
    state: tuple[float, ...] = ()
    free_period: float = 0.0


@dataclass(frozen=True)
class PlanSaddle:
    """An equilibrium at its named position: rad, J."""

    angles: tuple[float, ...]
    energy: float


@dataclass(frozen=True)
class Shadowing:
    """Result of the search for the walks' orbits.

    Attributes:
        residual: largest residual of the orbits, or None without a walk.
        duration: duration of all orbits together, s.
        status: how each search ended, in words.
        wraps_realised: wraps that the orbits make at their stops.
    """

    residual: float | None = None
    duration: float = 0.0
    status: str = ""
    wraps_realised: tuple[int, ...] = ()


@dataclass(frozen=True)
class Origin:
    """Inputs that reproduce the plan.

    Attributes:
        program: name and version of the program.
        scene, scene_hash: text of the itinerary and its hash.
        model, model_hash: text of the model and its hash.
        parameters: parameters of the model's arms.
        plant: text of the plant's model that the itinerary names, if any.
        code: version of the planner.
    """

    program: str
    scene: str
    scene_hash: str
    model: str
    model_hash: str
    parameters: ArmChainParameters
    plant: str = ""
    code: str = ""


@dataclass(frozen=True)
class TransferCost:
    """Cost of a transfer: its name, begin and duration, s, effort ∫u² dt, m²/s³, and stroke of the cart, m."""

    text: str
    begin: float
    duration: float
    effort: float
    stroke: float


@dataclass(frozen=True)
class FlightSegment:
    """A flight between two kept orbits.

    Attributes:
        fly: its symbols.
        rows: its first mesh interval and that after it.
    """

    fly: str
    rows: tuple[int, int]


@dataclass(frozen=True)
class StaySegment:
    """Periods on a kept orbit.

    Attributes:
        keep: saddle of the orbit.
        energy: energy of the Lyapunov orbit that the sustained one continues, J.
        family: number of this orbit's family, from 0.
        lyapunov_period: its period, s, by which the orbit is recognised.
        turns: turns of its states relative to the orbit, rad.
        periods: number of periods.
        rows: first mesh interval of its first period and that after it.
    """

    keep: str
    energy: float
    family: int
    lyapunov_period: float
    turns: tuple[float, ...]
    periods: int
    rows: tuple[int, int]


@dataclass(frozen=True, eq=False, kw_only=True)
class PlanContent:
    """Symbols, stops, orbits and costs of a plan.

    Attributes:
        wraps: wraps at each interior stop, None beside a transfer.
        lead_in, lead_out: periods before the first and after the last symbol.
        transfers: begin and end of each transfer between pieces, s.
        saddles: equilibria of the model by name.
        origin: inputs of the plan.
        costs: cost of each transfer.
        segments: stays and flights of a walk with kept stops, or the stay on one orbit.
        polished: least scaled distance to each stop's orbit, of a plan re-optimised as a whole. Such a plan keeps
            crossings, windings and wraps, but can leave the neighbourhood of the orbits.
        key: hash of the plan's inputs.
    """

    __pydantic_config__: ClassVar[Any] = {"arbitrary_types_allowed": True, "allow_inf_nan": False, "extra": "forbid"}

    itinerary: str
    title: str
    model: str
    wraps: tuple[int | None, ...] = ()
    lead_in: int = 0
    lead_out: int = 0
    shadowing: Shadowing
    stops: tuple[PlanStop, ...]
    symbols: tuple[PlanSymbol, ...] = ()
    transfers: tuple[tuple[float, float], ...] = ()
    orbits: tuple[PlanOrbit, ...]
    saddles: dict[str, PlanSaddle]
    origin: Origin
    costs: tuple[TransferCost, ...] = ()
    segments: tuple[FlightSegment | StaySegment, ...] = ()
    polished: tuple[float, ...] = ()
    key: str = ""

    @property
    def energy(self) -> float | None:
        """Energy of the first orbit, J, or None if there are only equilibria."""
        return next((orbit.energy for orbit in self.orbits if orbit.multiplier != 1.0), None)

    @property
    def walk(self) -> list[str]:
        """Names of the connections and texts of the transfers, in order."""
        return [symbol.name or symbol.text for symbol in self.symbols]

    @property
    def stays(self) -> list[StaySegment]:
        """The kept orbits, in order."""
        return [segment for segment in self.segments if isinstance(segment, StaySegment)]

    @property
    def rest(self) -> str:
        """Name of the lowest equilibrium, at which the arms hang."""
        return min(self.saddles, key=lambda name: self.saddles[name].energy)

    def orbit(self, stop: PlanStop) -> PlanOrbit:
        """Return the orbit, or the equilibrium, at which a stop of the plan stays.

        Args:
            stop: one of the plan's stops.
        """
        return self.orbits[stop.orbit]

    def lift(self, stop: PlanStop) -> Array:
        """Return the turns (n,) of a stop's angles from its saddle's named position, rad.

        Args:
            stop: one of the plan's stops.
        """
        return np.asarray(stop.angles) - np.asarray(self.saddles[stop.saddle].angles)

    def transitions(self) -> list[tuple[int, int]]:
        """Return the first transfer between each two equilibria, for pictures and for plans of single transitions.

        Returns:
            A pair (k, j) for each: symbol k is the transfer, and j its index in `transfers`.
        """
        # A stop at rest has no growth over a period; other stops begin or end a walk.
        is_equilibrium = [self.orbit(stop).multiplier == 1.0 for stop in self.stops]
        # Indices in `transfers` by the middle of the transfer, (begin, end), which is the time of its symbol.
        numbers_by_middle = {round(sum(transfer) / 2, 6): k for k, transfer in enumerate(self.transfers)}
        pairs: dict[tuple[str, str], tuple[int, int]] = {}
        for k, symbol in enumerate(self.symbols):
            transfer = numbers_by_middle.get(round(symbol.time, 6))
            if transfer is not None and symbol.name is None and is_equilibrium[k] and is_equilibrium[k + 1]:
                pairs.setdefault((symbol.source, symbol.target), (k, transfer))
        return list(pairs.values())

    def fits(self, arms: int) -> bool:
        """Return True if the parts agree with each other and with a number of arms, as those of an undamaged file do.

        Args:
            arms: number of arms of the reference.
        """
        all_angles = [angles_of_place.angles for angles_of_place in (*self.stops, *self.saddles.values())]
        normals = [symbol.section.normal for symbol in self.symbols if symbol.section is not None]
        return (
            len(self.stops) == len(self.symbols) + 1
            and len(self.wraps) == max(len(self.symbols) - 1, 0)
            and {stop.saddle for stop in self.stops} <= set(self.saddles) & {orbit.saddle for orbit in self.orbits}
            and all(0 <= k < len(self.orbits) for stop in self.stops for k in stop.orbits)
            and all(len(angles_of_place) == arms for angles_of_place in all_angles)
            and all(len(normal) == 2 * arms for normal in normals)
            and all(orbit.period > 0 and orbit.curve.shape[1:] == (2 * arms,) for orbit in self.orbits)
            and self.origin.parameters.count == arms
        )


_KEYS = {"origin": "made_from", "costs": "taken", "segments": "program", "key": "plan"}
"""Fields with other names in the file."""


def stored(content: PlanContent) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return a plan's content as JSON values, and its arrays by name.

    Args:
        content: the content.
    """
    arrays = {f"orbit_{k}": orbit.curve for k, orbit in enumerate(content.orbits)}
    values = asdict(content, dict_factory=_plain)
    return {_KEYS.get(name, name): value for name, value in values.items()}, arrays


def _plain(items: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return a dataclass's fields without arrays, which are stored apart, and without missing values."""
    return {name: value for name, value in items if value is not None and not isinstance(value, np.ndarray)}


def restored(notes: Mapping[str, Any], arrays: Mapping[str, Array], *, arms: int) -> PlanContent:
    """Return a plan's content from the values and arrays of a file, the inverse of `stored`.

    Args:
        notes: its JSON values.
        arrays: its arrays by name.
        arms: number of arms of the reference.

    Raises:
        ValueError: they are not those of a plan; so do `LookupError` and `InputError`.
    """
    values = _without_none(notes)
    values |= {name: values.pop(key) for name, key in _KEYS.items() if key in values}
    for k, orbit in enumerate(values["orbits"]):
        orbit["curve"] = arrays[f"orbit_{k}"]
    values["origin"]["parameters"] = ArmChainParameters(**frozen(values["origin"]["parameters"]))
    content: PlanContent = adapter(PlanContent).validate_python(values)
    if not content.fits(arms):
        raise ValueError(f"its plan is not one of {arms} arms, or its parts contradict each other")
    return content


def _without_none(value: Any) -> Any:
    """Return JSON values without the null entries of objects, which stand for the defaults of fields."""
    if isinstance(value, Mapping):
        return {name: _without_none(part) for name, part in value.items() if part is not None}
    return [_without_none(part) for part in value] if isinstance(value, list) else value
