"""A reference: what the bench shall do, as polynomials on a mesh, and how good it is.

State: the polynomial of degree K through the interval's start and its K points. Input: of degree K - 1 through the
points. Both are evaluated in barycentric form (Berrut & Trefethen, SIAM Review 46 (2004), eq. 4.2).

References that end where the next begins can be joined to one. On disk a reference is one .npz file, readable with
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

A reference in figures: its use of each limit, its effort, and its error measured again on every interval.

The error between nodes and the energy need the arms that it was made for, which a plan's notes carry: `made_from`,
whose `parameters` are those of `dpcontrol.dynamics.chain.ArmChainParameters` by name.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.dynamics.equations import NumericEquations
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import archive, picked, plain, write_archive
from dpcontrol.references.method import Method, interpolation_matrix, method_named
from dpcontrol.references.problem import LIMIT_UNITS, Limits, ReferenceProblem, state_scale
from dpcontrol.references.trajectory import Trajectory, error_between_nodes, largest_values, where_largest

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Reference:
    """A trajectory of pendulum and cart, with its input, to be tracked.

    mesh (N+1,) s; method; states (N, K+1, nx) at each interval's start and points; inputs (N, K, nu) at the
    points, cart acceleration in m/s²; limits it was made for. status: a sentence; converged: whether it may be
    used. max_error_between_nodes: scaled, infinite where it was not measured; constraint_violation: scaled, at
    the nodes; max_cart_… in m, m/s, m/s², between nodes too; iterations of the solver in all; solve_seconds.
    extra: arrays, and notes: JSON values, that the caller stores with it.
    """

    mesh: Array
    method: Method
    states: Array
    inputs: Array
    limits: Limits
    status: str
    converged: bool
    max_error_between_nodes: float
    constraint_violation: float
    max_cart_position: float
    max_cart_velocity: float
    max_cart_acceleration: float
    rms_cart_acceleration: float
    iterations: int
    solve_seconds: float
    extra: Mapping[str, Array] = field(default_factory=lambda: MappingProxyType({}))
    notes: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    def __repr__(self) -> str:
        return f"<reference of {self.duration:.4g} s: {self.status}>"

    @property
    def trajectory(self) -> Trajectory:
        """Return its values on the mesh alone."""
        return Trajectory(self.method, self.mesh, self.states, self.inputs)

    @property
    def duration(self) -> float:
        """Return its length in s."""
        return float(self.mesh[-1] - self.mesh[0])

    @property
    def residual(self) -> float:
        """Return the larger of error between nodes and constraint violation (scaled)."""
        return max(self.max_error_between_nodes, self.constraint_violation)

    @property
    def stats(self) -> dict[str, float]:
        """Return the cost of finding it."""
        return {
            "intervals": len(self.mesh) - 1,
            "iterations": self.iterations,
            "solve_seconds": self.solve_seconds,
        }

    def _evaluate(self, times: ArrayLike, points: Array, values: Array) -> Array:
        at = np.clip(np.asarray(times, dtype=float), self.mesh[0], self.mesh[-1])
        flat = at.ravel()
        index = np.clip(np.searchsorted(self.mesh, flat, side="right") - 1, 0, len(self.mesh) - 2)
        tau = (flat - self.mesh[index]) / (self.mesh[index + 1] - self.mesh[index])
        rows = interpolation_matrix(points, tau)
        return np.einsum("mk,mkn->mn", rows, values[index]).reshape(*at.shape, -1)

    def state(self, times: ArrayLike) -> Array:
        """Return states (…, nx) at `times` (…) s; times outside count as the nearest end."""
        return self._evaluate(times, self.method.support, self.states)

    def input(self, times: ArrayLike) -> Array:
        """Return inputs (…, nu) at `times` (…) s; times outside count as the nearest end."""
        return self._evaluate(times, self.method.points, self.inputs)


def reference_of(
    trajectory: Trajectory,
    limits: Limits,
    *,
    status: str,
    converged: bool,
    error: float,
    violation: float = 0.0,
    iterations: int = 0,
    seconds: float = 0.0,
) -> Reference:
    """Return the reference that a trajectory is, with what it asks of the cart.

    error: between nodes, and violation: of constraints, both scaled; iterations and seconds: of the search.
    """
    lengths = np.diff(trajectory.mesh)
    square = (trajectory.inputs[..., 0] ** 2) @ trajectory.method.weights
    largest = largest_values(trajectory, limits)
    return Reference(
        mesh=trajectory.mesh,
        method=trajectory.method,
        states=trajectory.states,
        inputs=trajectory.inputs,
        limits=limits,
        status=status,
        converged=converged,
        max_error_between_nodes=error,
        constraint_violation=violation,
        max_cart_position=largest["position"],
        max_cart_velocity=largest["velocity"],
        max_cart_acceleration=largest["acceleration"],
        rms_cart_acceleration=float(np.sqrt(square @ lengths / lengths.sum())),
        iterations=iterations,
        solve_seconds=seconds,
    )


def still(state: Array, seconds: float, *, method: Method, limits: Limits, interval: float) -> Reference:
    """Return the reference that stays at an equilibrium (N,), without input."""
    count = max(1, int(np.ceil(seconds / interval)))
    states = np.tile(np.asarray(state, dtype=float), (count, len(method.support), 1))
    mesh = np.linspace(0.0, seconds, count + 1)
    resting = Trajectory(method, mesh, states, np.zeros((count, len(method.points), 1)))
    return reference_of(resting, limits, status=f"at rest for {seconds:g} s", converged=True, error=0.0)


def joined(pieces: Sequence[Reference]) -> tuple[Reference, Array]:
    """Return pieces as one reference, and the times (P + 1,) at which they begin and the last ends.

    All have one method. A jump from one to the next counts as a constraint violation; their inputs may jump.

    Raises:
        ValueError: no pieces, or pieces of different methods.
    """
    if not pieces or len({piece.method.name for piece in pieces}) > 1:
        raise ValueError("pieces of one method are joined, one at least")
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
    lengths = np.diff(begins)
    square = sum(piece.rms_cart_acceleration**2 * length for piece, length in zip(pieces, lengths, strict=True))
    bad = [piece for piece in pieces if not piece.converged]
    error = max(piece.max_error_between_nodes for piece in pieces)
    count = len(mesh) - 1
    status = bad[0].status if bad else (
        f"converged in {sum(piece.iterations for piece in pieces)} iterations; error between nodes {error:.1e} on "
        f"{count} intervals of {len(pieces)} pieces"
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
        max_cart_position=max(piece.max_cart_position for piece in pieces),
        max_cart_velocity=max(piece.max_cart_velocity for piece in pieces),
        max_cart_acceleration=max(piece.max_cart_acceleration for piece in pieces),
        rms_cart_acceleration=float(np.sqrt(square / lengths.sum())),
        iterations=sum(piece.iterations for piece in pieces),
        solve_seconds=sum(piece.solve_seconds for piece in pieces),
    )
    return together, begins


FORMAT = "dpcontrol-reference"
VERSION = 2
READ = (1, 2)
"""Versions that are read."""
_EXTRA = "extra_"
_NUMBERS = (
    "max_error_between_nodes",
    "constraint_violation",
    "max_cart_position",
    "max_cart_velocity",
    "max_cart_acceleration",
    "rms_cart_acceleration",
    "iterations",
    "solve_seconds",
)


def save_reference(path: Path, reference: Reference) -> None:
    """Write `reference` to `path` (whole, or not at all) in the layout above.

    Raises:
        InputError: the file cannot be written, or the notes are not JSON.
    """
    header = {
        "format": FORMAT,
        "version": VERSION,
        "method": reference.method.name,
        "limits": reference.limits.named(),
        "numbers": plain(picked(reference, *_NUMBERS)),
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
    """Make a reference of a file's parts; any of the raised errors means that the file is not one."""
    method = method_named(header["method"])
    mesh, states, inputs = (np.asarray(arrays[k], dtype=float) for k in ("mesh", "states", "inputs"))
    intervals, count = len(mesh) - 1, len(method.points)
    if not np.allclose(arrays["points"], method.points, rtol=0, atol=1e-12):
        raise ValueError(f"its points are not those of {method.name}")
    if "support" in arrays and not np.allclose(arrays["support"], method.support, rtol=0, atol=1e-12):
        raise ValueError(f"its states are not given where {method.name} has them")
    if intervals < 1 or not (np.diff(mesh) > 0).all():
        raise ValueError("its mesh does not rise")
    if states.shape[:2] != (intervals, count + 1) or inputs.shape[:2] != (intervals, count):
        raise ValueError(f"states {states.shape} and inputs {inputs.shape} do not fit its mesh")
    if states.ndim != 3 or inputs.ndim != 3 or not (np.isfinite(states).all() and np.isfinite(inputs).all()):
        raise ValueError("its states or inputs are not finite")
    numbers: dict[str, Any] = {k: np.inf if header["numbers"][k] is None else header["numbers"][k] for k in _NUMBERS}
    return Reference(
        mesh=mesh,
        method=method,
        states=states,
        inputs=inputs,
        limits=Limits(**header["limits"]),
        status=str(header["status"]),
        converged=bool(header["converged"]),
        extra=MappingProxyType({k[len(_EXTRA) :]: v for k, v in arrays.items() if k.startswith(_EXTRA)}),
        notes=MappingProxyType(dict(header["notes"])),
        **numbers,
    )


def load_reference(path: Path | IO[bytes]) -> Reference:
    """Read what `save_reference` wrote, from a path or an open binary file.

    Raises:
        InputError: there is no such file, or it is damaged or not a reference; says which.
    """
    making = {"make": "plan the itinerary first", "again": "plan again"}
    with archive(path, what="a reference", **making, format=FORMAT, versions=READ) as (header, arrays):
        return _checked(header, arrays)


@dataclass(frozen=True)
class LimitUse:
    """How much of one of the cart's limits a reference uses: bound and largest size in `unit`, and when, s."""

    name: str
    unit: str
    bound: float
    largest: float
    time: float

    @property
    def share(self) -> float:
        """Return the largest over the bound."""
        return self.largest / self.bound


@dataclass(frozen=True, eq=False)
class ReferenceSummary:
    """A reference and what follows from it.

    uses of the limits. effort: ∫u² dt in m²/s³. arms that it was made for and errors between nodes (N,), scaled, on
    each interval: None where the notes do not say for which arms it was made.
    """

    reference: Reference
    uses: tuple[LimitUse, ...]
    effort: float
    arms: ArmChainParameters | None
    errors: Array | None

    def energies(self, states: Array) -> Array | None:
        """Return the pendulum's energy in J at states (K, N), or None where the arms are not known."""
        if self.arms is None:
            return None
        pendulum = equations_of(self.arms, Level.CONSERVATIVE)
        return NumericEquations(pendulum, self.arms.base()).hamiltonian(states[:, :-2])

    def document(self) -> dict[str, Any]:
        """Return what `dpcontrol reference --json` prints, the file's name apart."""
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
    """Return the summary of a reference, its error between nodes measured again.

    Raises:
        InputError: the notes name arms that cannot be, or others than it has.
    """
    arms = _arms(reference)
    return ReferenceSummary(
        reference=reference,
        uses=_uses(reference),
        effort=reference.rms_cart_acceleration**2 * reference.duration,
        arms=arms,
        errors=None if arms is None else _errors(reference, arms),
    )


def _arms(reference: Reference) -> ArmChainParameters | None:
    made_from = reference.notes.get("made_from")
    if not isinstance(made_from, Mapping) or "parameters" not in made_from:
        return None
    try:
        values: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in dict(made_from["parameters"]).items()
        }
        arms = ArmChainParameters(**values)
    except (InputError, TypeError, ValueError) as error:
        raise InputError(f"the reference's notes hold no arms' parameters ({error}); plan again") from error
    if 2 * arms.count + 2 != reference.states.shape[-1]:
        raise InputError(
            f"the reference's notes name {arms.count} arms but its states have {reference.states.shape[-1]} entries; "
            "plan again"
        )
    return arms


def _errors(reference: Reference, arms: ArmChainParameters) -> Array:
    nothing = np.zeros(reference.states.shape[-1] - 2)
    problem = ReferenceProblem(
        equations=equations_of(arms, Level.CART),
        parameters=arms.base(),
        guess=lambda times: np.broadcast_to(nothing, (len(times), len(nothing))),
        duration=reference.duration,
        limits=reference.limits,
    )
    return error_between_nodes(problem, reference.trajectory)


def _uses(reference: Reference) -> tuple[LimitUse, ...]:
    trajectory = reference.trajectory
    largest = largest_values(trajectory, reference.limits)
    return tuple(
        LimitUse(name, LIMIT_UNITS[name], bound, largest[name], where_largest(trajectory, name))
        for name, bound in reference.limits.named().items()
    )
