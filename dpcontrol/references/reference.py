"""A reference: the bench's planned motion as polynomials on a mesh.

This module has its file, its figures and the notes of its plan.

Successive references can be joined. On disk a reference is one .npz file, readable with
numpy alone (`numpy.load(path)`). Keys, all float64 unless said otherwise:

    header   JSON text (a 0-d string array): {"format": "dpcontrol-reference", "version": 2, "method": "radau-5",
             "status": text, "converged": bool, "limits": {"position", "velocity", "acceleration"},
             "numbers": {the result's figures by name}, "notes": {what the caller stored}}
    mesh     (N+1,)        interval ends, s
    points   (K,)          collocation points of an interval scaled to 0 … 1
    support  (K+1,)        where the states are given on it (version 1: 0 and the points)
    states   (N, K+1, nx)  at the support: angles, rates, cart position, cart velocity
    inputs   (N, K, nu)    at the points: cart acceleration, m/s²
    extra_*  any shape     arrays the caller stored, by name

The notes are `PlanNotes`. Their arrays are among the extra ones: `orbit_K` (M, 2n), samples of the K-th orbit over a
period. The error between nodes and the energy require the reference's arms: `made_from` has their `parameters`, by the
names of `dpcontrol.dynamics.chain.ArmChainParameters`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any, Literal, NotRequired, TypedDict, cast

import numpy as np

from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.dynamics.equations import NumericEquations
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.document import picked, plain
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import archive, write_archive
from dpcontrol.foundation.parts import installed
from dpcontrol.foundation.settings import frozen
from dpcontrol.references.method import Method, method_named
from dpcontrol.references.problem import LIMIT_UNITS, Limits, ReferenceProblem, state_scale
from dpcontrol.references.trajectory import Trajectory, error_between_nodes, largest_values, where_largest


@dataclass(frozen=True, eq=False)
class Reference(Trajectory):
    """A trajectory of pendulum and cart, with its input, for tracking.

    Its mesh, states, inputs (cart acceleration, m/s²) and method are those of `Trajectory`.

    Attributes:
        limits: limits that it respects.
        status: a sentence.
        converged: True if it can be used.
        max_error_between_nodes: scaled, infinite if not measured.
        constraint_violation: scaled, at the nodes.
        iterations: of the solver in all rounds.
        solve_seconds: time of the solver, s.
        extra: arrays stored with it.
        notes: JSON values stored with it.
    """

    limits: Limits
    status: str
    converged: bool
    max_error_between_nodes: float
    constraint_violation: float = 0.0
    iterations: int = 0
    solve_seconds: float = 0.0
    extra: Mapping[str, Array] = field(default_factory=lambda: MappingProxyType({}))
    notes: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def intervals(self) -> int:
        """Number of intervals of the mesh."""
        return len(self.mesh) - 1

    @classmethod
    def of(cls, trajectory: Trajectory, limits: Limits, **about: Any) -> "Reference":
        """Return a trajectory as a reference.

        Args:
            trajectory: motion with its input.
            limits: limits of the cart.
            **about: the fields after `limits`, by name.
        """
        return cls(trajectory.method, trajectory.mesh, trajectory.states, trajectory.inputs, limits, **about)

    def __repr__(self) -> str:
        return f"<reference of {self.duration:.4g} s: {self.status}>"

    @property
    def residual(self) -> float:
        """Return the larger of error between nodes and constraint violation (scaled)."""
        return max(self.max_error_between_nodes, self.constraint_violation)

    @cached_property
    def largest(self) -> dict[str, float]:
        """The largest size of each limited quantity of the cart.

        They are by name, in SI units, and include the values between nodes.
        """
        return largest_values(self, self.limits)

    @property
    def max_cart_position(self) -> float:
        """Return the cart's largest distance from the middle, m."""
        return self.largest["position"]

    @property
    def max_cart_velocity(self) -> float:
        """Return the cart's largest speed, m/s."""
        return self.largest["velocity"]

    @property
    def max_cart_acceleration(self) -> float:
        """Return the cart's largest acceleration, m/s²."""
        return self.largest["acceleration"]

    @property
    def rms_cart_acceleration(self) -> float:
        """Return the root of the cart's mean squared acceleration, m/s²."""
        lengths = np.diff(self.mesh)
        square = (self.inputs[..., 0] ** 2) @ self.method.weights
        return float(np.sqrt(square @ lengths / lengths.sum()))


class ByReference:
    """Base of results whose status is that of their reference."""

    reference: Reference

    @property
    def converged(self) -> bool:
        """True if the reference converged and can be followed."""
        return self.reference.converged

    @property
    def status(self) -> str:
        """Method of the reference, or the cause of its failure.

        A failure also has a remedy.
        """
        return self.reference.status


def still(state: Array, seconds: float, *, method: Method, limits: Limits, interval: float) -> Reference:
    """Return the reference that stays at an equilibrium, without input.

    Args:
        state: equilibrium (N,).
        seconds: duration, s.
        method: collocation method.
        limits: limits of the cart.
        interval: longest interval of the mesh, s.
    """
    count = max(1, int(np.ceil(seconds / interval)))
    states = np.tile(np.asarray(state, dtype=float), (count, len(method.support), 1))
    mesh = np.linspace(0.0, seconds, count + 1)
    inputs = np.zeros((count, len(method.points), 1))
    status = f"at rest for {seconds:g} s"
    return Reference(method, mesh, states, inputs, limits, status, converged=True, max_error_between_nodes=0.0)


def joined(pieces: Sequence[Reference]) -> tuple[Reference, Array]:
    """Return pieces as one reference, and their times.

    The times (P + 1,), s, are those of their begins and the last end.

    All have the same method. A jump of states between pieces counts as a constraint violation. Inputs can jump.

    Args:
        pieces: references (P,) in order.

    Raises:
        ValueError: no pieces, or pieces of different methods.
    """
    if not pieces or len({piece.method.name for piece in pieces}) > 1:
        raise ValueError("pieces must have one method, and there must be at least one")
    first, limits = pieces[0], pieces[0].limits
    if len(pieces) == 1:
        return first, np.array([0.0, first.duration])
    scale = state_scale(first.states.shape[-1], limits)
    begins = np.concatenate([[0.0], np.cumsum([piece.duration for piece in pieces])])
    meshes = [piece.mesh - piece.mesh[0] + begin for piece, begin in zip(pieces, begins[:-1], strict=True)]
    mesh = np.concatenate([*(m[:-1] for m in meshes), meshes[-1][-1:]])
    jumps = [
        float(np.max(np.abs(before.state(before.mesh[-1]) - after.state(after.mesh[0])) / scale))
        for before, after in pairwise(pieces)
    ]
    bad = [piece for piece in pieces if not piece.converged]
    error = max(piece.max_error_between_nodes for piece in pieces)
    iterations = sum(piece.iterations for piece in pieces)
    status = bad[0].status if bad else (
        f"converged in {iterations} iterations; error between nodes {error:.1e} on {len(mesh) - 1} intervals of "
        f"{len(pieces)} pieces"
    )  # fmt: skip
    together = replace(
        first,
        mesh=mesh,
        states=np.concatenate([piece.states for piece in pieces]),
        inputs=np.concatenate([piece.inputs for piece in pieces]),
        status=status,
        converged=not bad,
        max_error_between_nodes=error,
        constraint_violation=max([*jumps, *(piece.constraint_violation for piece in pieces)]),
        iterations=iterations,
        solve_seconds=sum(piece.solve_seconds for piece in pieces),
    )
    return together, begins


_START = "start_{}_{}"


def start_arrays(which: int, lead_in: Reference) -> dict[str, Array]:
    """Return the extra arrays of a start's transfer.

    Args:
        which: number of the plan's start.
        lead_in: its transfer.
    """
    return {_START.format(which, name): array for name, array in picked(lead_in, "mesh", "states", "inputs").items()}


def start_reference(reference: Reference, which: int) -> Reference | None:
    """Return the transfer of a plan's start.

    The result is None if the start is at rest.

    Args:
        reference: reference of the plan.
        which: number of the start.
    """
    arrays = {name: reference.extra.get(_START.format(which, name)) for name in ("mesh", "states", "inputs")}
    if any(array is None for array in arrays.values()):
        return None
    return replace(reference, **arrays, extra=MappingProxyType({}), notes=MappingProxyType({}))


FORMAT = "dpcontrol-reference"
VERSION = 2
_EXTRA = "extra_"
_FOUND = ("max_error_between_nodes", "constraint_violation", "iterations", "solve_seconds")
"""Figures of the search; the cart's figures follow from the trajectory."""
_CART = ("max_cart_position", "max_cart_velocity", "max_cart_acceleration", "rms_cart_acceleration")


_LARGEST = 1e9
"""Largest values in SI units whose squares are still finite."""


def save_reference(path: Path | BytesIO, reference: Reference) -> None:
    """Write a reference atomically, in the layout above.

    Args:
        path: path, or a file in memory.
        reference: reference to write.

    Raises:
        InputError: the file cannot be written, or the notes are not JSON.
    """
    header = {
        "format": FORMAT,
        "version": VERSION,
        "method": reference.method.name,
        "limits": reference.limits.named(),
        "numbers": plain(picked(reference, *_FOUND, *_CART)),
        "notes": dict(reference.notes),
        **picked(reference, "status", "converged"),
    }
    arrays = {
        **picked(reference, "mesh", "states", "inputs"),
        **picked(reference.method, "points", "support"),
        **{_EXTRA + name: array for name, array in reference.extra.items()},
    }
    write_archive(path, header, arrays)


def _checked(header: Any, arrays: dict[str, Array]) -> Reference:
    """Build a reference from a file's parts.

    Any of the raised errors means an invalid file.
    """
    method = method_named(header["method"])
    mesh, states, inputs = (np.asarray(arrays[k], dtype=float) for k in ("mesh", "states", "inputs"))
    intervals, count = len(mesh) - 1, len(method.points)
    if not np.allclose(arrays["points"], method.points, rtol=0, atol=1e-12):
        raise ValueError(f"its points are not those of {method.name}")
    if "support" in arrays and not np.allclose(arrays["support"], method.support, rtol=0, atol=1e-12):
        raise ValueError(f"its states are not given where {method.name} has them")
    if intervals < 1 or not (mesh[1:] > mesh[:-1]).all():
        raise ValueError("its mesh does not rise")
    if states.shape[:2] != (intervals, count + 1) or inputs.shape[:2] != (intervals, count):
        raise ValueError(f"states {states.shape} and inputs {inputs.shape} do not fit its mesh")
    if states.ndim != 3 or inputs.ndim != 3:
        raise ValueError(f"states {states.shape} and inputs {inputs.shape} must have three dimensions")
    # Not a number fails too.
    if not all(np.abs(values).max(initial=0.0) <= _LARGEST for values in (mesh, states, inputs)):
        raise ValueError("its mesh, states or inputs are not finite, or too large")
    found: dict[str, Any] = {}
    for k in _FOUND:
        found[k] = value = np.inf if header["numbers"][k] is None else header["numbers"][k]
        # JSON has integers of any length.
        if not isinstance(value, int | float) or not (abs(value) <= 1e300 or value == np.inf):
            raise ValueError(f"its {k} is not a number")
    if not all(isinstance(bound, int | float) for bound in header["limits"].values()):
        raise ValueError("its limits are not numbers")
    return Reference(
        method, mesh, states, inputs, Limits(**header["limits"]),
        status=str(header["status"]), converged=bool(header["converged"]), **found,
        extra=MappingProxyType({k[len(_EXTRA) :]: v for k, v in arrays.items() if k.startswith(_EXTRA)}),
        notes=MappingProxyType(dict(header["notes"])),
    )  # fmt: skip


def load_reference(path: Path | IO[bytes]) -> Reference:
    """Read what `save_reference` wrote.

    Args:
        path: path, or an open binary file.

    Raises:
        InputError: the file does not exist, is damaged or is not a reference.
    """
    making = {"make": "plan the itinerary first", "again": "plan again"}
    with archive(path, what="a reference", **making, format=FORMAT, versions=(VERSION,)) as (header, arrays):
        return _checked(header, arrays)


@dataclass(frozen=True)
class LimitUse:
    """Use of one of the cart's limits.

    Bound and largest size in `unit`, and the time of the latter, s.
    """

    name: str
    unit: str
    bound: float
    largest: float
    time: float

    @property
    def share(self) -> float:
        """Largest size divided by the bound."""
        return self.largest / self.bound


@dataclass(frozen=True, eq=False)
class ReferenceSummary:
    """Effort, use of limits and other figures of a reference.

    Attributes:
        reference: the reference.
        arms: its arms, or None if the notes lack them.
    """

    reference: Reference
    arms: ArmChainParameters | None

    @cached_property
    def uses(self) -> tuple[LimitUse, ...]:
        """Each limit's bound, with the largest value and its time."""
        reference = self.reference
        return tuple(
            LimitUse(name, LIMIT_UNITS[name], bound, reference.largest[name], where_largest(reference, name))
            for name, bound in reference.limits.named().items()
        )

    @property
    def effort(self) -> float:
        """∫u² dt in m²/s³."""
        return self.reference.rms_cart_acceleration**2 * self.reference.duration

    @cached_property
    def errors(self) -> Array | None:
        """Errors between nodes (N,), scaled, measured again on each interval.

        They are None if the arms are unknown or heyoka is not installed.
        """
        if self.arms is None or not installed("heyoka"):
            return None
        nothing = np.zeros(self.reference.states.shape[-1] - 2)
        problem = ReferenceProblem(
            equations=equations_of(self.arms, Level.CART),
            parameters=self.arms.planned().base(),
            guess=lambda times: np.broadcast_to(nothing, (len(times), len(nothing))),
            duration=self.reference.duration,
            limits=self.reference.limits,
        )
        return error_between_nodes(problem, self.reference)

    def energies(self, states: Array) -> Array | None:
        """Return the pendulum's energies (K,), J.

        The result is None if the arms are unknown.

        Args:
            states: states (K, N).
        """
        if self.arms is None:
            return None
        pendulum = equations_of(self.arms, Level.CONSERVATIVE)
        return NumericEquations(pendulum, self.arms.base()).hamiltonian(states[:, :-2])

    def document(self) -> dict[str, Any]:
        """Return the JSON output of `dpcontrol reference`, without the file's name."""
        reference, notes = self.reference, self.reference.notes
        lengths = np.diff(reference.mesh)
        stops = list(notes.get("stops") or [])
        return {
            "title": str(notes.get("title") or ""),
            **{name: notes.get(name) for name in ("itinerary", "model", "energy", "plan")},
            "made_from": dict(notes.get("made_from") or {}),
            "symbols": [
                {
                    "time": float(symbol["time"]),
                    "text": str(symbol["text"]),
                    "name": symbol["name"],
                    "arrives_at": str(stop["saddle"]),
                }
                for symbol, stop in zip(notes.get("symbols") or [], stops[1:], strict=True)
            ],
            "wraps": list(notes.get("wraps") or []),
            "transfers": [[float(begin), float(end)] for begin, end in notes.get("transfers") or []],
            "starts_at": str(stops[0]["saddle"]) if stops else None,
            "duration": reference.duration,
            "intervals": len(lengths),
            "shortest_interval": float(lengths.min()),
            "longest_interval": float(lengths.max()),
            "method": reference.method.name,
            "limits": {use.name: picked(use, "unit", "bound", "largest", "share", "time") for use in self.uses},
            "effort": self.effort,
            "measured_error_between_nodes": None if self.errors is None else float(self.errors.max()),
            **picked(reference, "rms_cart_acceleration", "max_error_between_nodes", "constraint_violation"),
            **picked(reference, "iterations", "solve_seconds", "converged", "status"),
            "arrays": {"states": reference.states.shape, "inputs": reference.inputs.shape}
            | {name: np.shape(array) for name, array in reference.extra.items()},
        }


def summarised(reference: Reference) -> ReferenceSummary:
    """Return figures of a reference, with its arms from the notes.

    Args:
        reference: reference with the notes of its plan.

    Raises:
        InputError: the arms in the notes are impossible or differ from the reference's.
    """
    made_from = reference.notes.get("made_from")
    if not isinstance(made_from, Mapping) or "parameters" not in made_from:
        return ReferenceSummary(reference, None)
    try:
        arms = ArmChainParameters(**frozen(dict(made_from["parameters"])))
    except (InputError, TypeError, ValueError) as error:
        raise InputError(f"the reference's notes lack the arms' parameters ({error}); plan again") from error
    if 2 * arms.count + 2 != reference.states.shape[-1]:
        raise InputError(
            f"the reference's notes name {arms.count} arms but its states have {reference.states.shape[-1]} entries; "
            "plan again"
        )
    return ReferenceSummary(reference, arms)


REST_BEFORE, REST_AFTER = 0.5, 1.0
"""Time that the pendulum hangs still at the start and after its return, s."""


class StopNote(TypedDict):
    """A stop: place of wobbles or rest.

    Angles include turns, rad. Orbits are indices into `orbits`.

    Attributes:
        arrived_on: the arriving orbit, if the stop changes the energy.
    """

    saddle: str
    angles: list[float]
    orbit: int
    arrived_on: NotRequired[int]


class SectionNote(TypedDict):
    """Section of a connection.

    Normal · state = value, at these angles, rad. Its short name is null for the default one between its saddles.
    """

    normal: list[float]
    value: float
    angles: list[float]
    name: str | None


class SymbolNote(TypedDict):
    """Motion between two stops.

    A connection, or a transfer, which has neither name nor section.

    Attributes:
        time: of the section's crossing, or the middle of a transfer, s.
        hits: crossing numbers of the unstable and the stable tube, null for a transfer.
        time_out, time_in: from the orbit to the section and on to the next orbit, s, null for a transfer.
    """

    text: str
    name: str | None
    source: str
    target: str
    winding: list[int]
    sense: int
    time: float
    section: SectionNote | None
    hits: list[int] | None
    time_out: float
    time_in: float
    phase_out: float
    phase_in: float


class OrbitNote(TypedDict):
    """A periodic orbit, or an equilibrium: energy, J, and period, s.

    The period of an equilibrium is the observation time of its ends.
    """

    saddle: str
    energy: float
    period: float
    multiplier: float


class SaddleNote(TypedDict):
    """An equilibrium at its named position: rad, J."""

    angles: list[float]
    energy: float


class ShadowingNote(TypedDict):
    """Search for the walks' orbits.

    Largest residual, or None without a walk, and total time in s.
    """

    residual: float | None
    duration: float
    status: str
    wraps_realised: list[int]


class OriginNote(TypedDict):
    """Inputs that reproduce the plan.

    Texts of itinerary, model and plant ("" without an own plant), arms, program.
    """

    program: str
    scene: str
    scene_hash: str
    model: str
    model_hash: str
    plant: str
    parameters: dict[str, Any]
    code: NotRequired[str]


class StayNote(TypedDict):
    """Stay of an itinerary without transfers.

    The equilibrium, or the orbit and the inputs of its search.
    """

    kind: Literal["hold", "orbit"]
    hold: NotRequired[str]
    orbit: NotRequired[str]
    energy: NotRequired[float]
    family: NotRequired[int]
    intervals: NotRequired[int]
    lyapunov_period: NotRequired[float]


class ApproachNote(TypedDict):
    """Closest approach of a transfer to a family.

    Scaled `distance` from the orbit at `energy` J, at `time` s.
    """

    orbit: str
    distance: float
    energy: float
    time: float


class TransferNote(TypedDict):
    """Cost of a transfer.

    Duration in s, ∫u² dt in m²/s³, stroke in m, and approaches by family of orbits.
    """

    text: str
    begin: float
    duration: float
    effort: float
    stroke: float
    closest: list[ApproachNote]


class SegmentNote(TypedDict):
    """A stay or a flight of a walk with kept stops.

    A stay has the saddle in "keep", a flight has "fly".

    Attributes:
        rows: range of mesh intervals, of a stay those of its first period.
        turns: turns of its states relative to the orbit.
    """

    rows: list[int]
    fly: NotRequired[str]
    keep: NotRequired[str]
    energy: NotRequired[float]
    family: NotRequired[int]
    lyapunov_period: NotRequired[float]
    turns: NotRequired[list[float]]
    periods: NotRequired[int]


class StartNote(TypedDict):
    """A transfer from hanging at rest to a stop.

    It joins the plan's reference at `at` s, `turns` short of it.

    Its arrays are extra ones (`start_reference`). A stop at rest needs none.

    Attributes:
        status: result of the search.
    """

    stop: int
    at: float
    turns: list[int]
    status: str


class PlanNotes(TypedDict):
    """Symbols, stops, orbits and costs stored with a reference.

    Attributes:
        wraps: one for each interior stop, None beside a transfer.
        transfers: intervals of transfers between pieces, s.
        taken: cost of each transfer.
        energy: energy of the first orbit, J.
        polished: least scaled distance to each stop's orbit, of a plan re-optimised as a whole. Such a plan keeps
            crossings, windings and wraps, but can leave the neighbourhood of the orbits.
    """

    itinerary: str
    title: str
    model: str
    energy: float | None
    walk: list[str]
    wraps: list[int | None]
    lead_in: int | None
    lead_out: int | None
    shadowing: ShadowingNote
    stops: list[StopNote]
    symbols: list[SymbolNote]
    transfers: list[list[float]]
    orbits: list[OrbitNote]
    saddles: dict[str, SaddleNote]
    made_from: OriginNote
    taken: NotRequired[list[TransferNote]]
    plan: NotRequired[str]
    stay: NotRequired[StayNote]
    program: NotRequired[list[SegmentNote]]
    starts: NotRequired[list[StartNote]]
    polished: NotRequired[list[float]]


def transitions_in(notes: PlanNotes) -> list[tuple[int, int]]:
    """Return numbers of symbol and transfer of each transition.

    Transitions are between equilibria. Of each pair, only the first is returned.

    Args:
        notes: notes of a plan.
    """
    # A stop at rest has no growth over a period; other stops begin or end a walk.
    still = [notes["orbits"][stop["orbit"]]["multiplier"] == 1.0 for stop in notes.get("stops", [])]
    ways = {round(sum(way) / 2, 6): k for k, way in enumerate(notes.get("transfers", []))}
    found: dict[tuple[str, str], tuple[int, int]] = {}
    for k, symbol in enumerate(notes.get("symbols", [])):
        way = ways.get(round(symbol["time"], 6))
        if way is not None and symbol["name"] is None and still[k] and still[k + 1]:
            found.setdefault((symbol["source"], symbol["target"]), (k, way))
    return list(found.values())


def holds_plan(reference: Reference) -> bool:
    """True if a reference has consistent notes of a plan.

    Args:
        reference: reference from a file.
    """
    notes: Any = dict(reference.notes)
    n = reference.states.shape[-1] // 2 - 1
    try:
        stops, symbols, orbits, saddles = (notes[key] for key in ("stops", "symbols", "orbits", "saddles"))
        homes = {stop["saddle"] for stop in stops} <= set(saddles) and len(stops) == len(symbols) + 1 >= 1
        angles = [entry["angles"] for entry in (*stops, *saddles.values())]
        curves = [reference.extra[f"orbit_{k}"] for k in range(len(orbits))]
        flown = [s for s in symbols if s["section"] is not None]
        numbers = [s[key] for s in flown for key in ("time_in", "time_out", "phase_in", "phase_out")]
        numbers += [s["time"] for s in symbols] + [t for pair in notes.get("transfers", []) for t in pair]
        numbers += [s["section"]["value"] for s in flown] + [saddle["energy"] for saddle in saddles.values()]
        known = {orbit["saddle"] for orbit in orbits} >= {stop["saddle"] for stop in stops}
        texts = [notes["title"], notes["itinerary"], *(s["text"] for s in symbols)]
        return bool(
            homes
            and known
            and all(len(a) == n for a in angles)
            and all(c.ndim == 2 and c.shape[1] == 2 * n and len(c) > 1 for c in curves)
            and all(0 <= stop.get("orbit", 0) < len(orbits) for stop in stops)
            and all(o["period"] > 0 and np.isfinite(o["energy"]) for o in orbits)
            and np.isfinite(np.array(numbers, dtype=float)).all()
            and all(len(s["section"]["normal"]) == 2 * n for s in flown)
            and len(notes["wraps"]) == max(len(symbols) - 1, 0)
            and all(isinstance(text, str) for text in texts)
        )
    except (KeyError, IndexError, TypeError, ValueError, AttributeError):
        return False


def plan_notes(reference: Reference) -> PlanNotes:
    """Return the notes of a reference that a plan made.

    Args:
        reference: reference of a plan.
    """
    return cast(PlanNotes, dict(reference.notes))
