"""A reference: the bench's planned motion as polynomials on a mesh.

Successive references can be joined. On disk a reference is one .npz file, readable with
numpy alone (`numpy.load(path)`). Keys, all float64 unless said otherwise:

    header   JSON text (a 0-d string array): {"format": "dpcontrol-reference", "version": 2, "method": "radau-5",
             "status": text, "converged": bool, "limits": {"position", "velocity", "acceleration"},
             "numbers": {the result's figures by name}, "notes": {the plan's content}}
    mesh     (N+1,)        interval ends, s
    points   (K,)          collocation points of an interval scaled to 0 … 1
    support  (K+1,)        where the states are given on it (version 1: 0 and the points)
    states   (N, K+1, nx)  at the support: angles, rates, cart position, cart velocity
    inputs   (N, K, nu)    at the points: cart acceleration, m/s²
    extra_*  any shape     arrays of the plan's content, by name

The content is that of `dpcontrol.references.content`, empty for a reference without a plan.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import IO, Any, ClassVar

import numpy as np

from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.dynamics.equations import NumericEquations
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import ReferenceCause
from dpcontrol.foundation.document import Documented, document_of, picked, plain
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import archive, write_archive
from dpcontrol.foundation.parts import installed
from dpcontrol.references.content import PlanContent, restored, stored
from dpcontrol.references.ending import ReferenceEnding
from dpcontrol.references.method import Method, method_named
from dpcontrol.references.problem import Limits, ReferenceProblem, state_scale
from dpcontrol.references.trajectory import LimitUse, Trajectory, error_between_nodes, largest_values, limit_uses

_PLAN = (
    "title itinerary model energy plan=key made_from=origin symbols:time,text,name,arrives_at=target wraps transfers "
    "starts_at=stops.0.saddle"
)


@dataclass(frozen=True, eq=False)
class Reference(Trajectory):
    """A trajectory of pendulum and cart, with its input, for tracking.

    Its mesh, states, inputs (cart acceleration, m/s²) and method are those of `Trajectory`.

    Attributes:
        limits: limits that it respects.
        ending: how its search ended.
        converged: True if it can be used.
        max_error_between_nodes: scaled, infinite if not measured.
        constraint_violation: scaled, at the nodes.
        iterations: of the solver in all rounds.
        solve_seconds: time of the solver, s.
        plan: what the plan of an itinerary stores with it, None for other references.
    """

    limits: Limits
    ending: ReferenceEnding
    converged: bool
    max_error_between_nodes: float
    constraint_violation: float = 0.0
    iterations: int = 0
    solve_seconds: float = 0.0
    plan: PlanContent | None = None

    @property
    def status(self) -> str:
        """Method of the reference, or the cause of its failure with a remedy."""
        return self.ending.status

    @property
    def intervals(self) -> int:
        """Number of intervals of the mesh."""
        return len(self.mesh) - 1

    @classmethod
    def of(cls, trajectory: Trajectory, limits: Limits, **about: Any) -> "Reference":
        """Return a trajectory as a reference with limits and the figures of its search.

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
        """Larger of error between nodes and constraint violation, scaled."""
        return max(self.max_error_between_nodes, self.constraint_violation)

    @cached_property
    def largest(self) -> dict[str, float]:
        """The largest size of each limited quantity of the cart by name, SI units, with the values between nodes."""
        return largest_values(self, self.limits)

    @property
    def content(self) -> PlanContent:
        """Content of the plan that the reference belongs to.

        Raises:
            InputError: it belongs to none.
        """
        if self.plan is None:
            raise InputError("the reference has no plan; plan an itinerary")
        return self.plan

    @property
    def max_cart_position(self) -> float:
        """Largest distance of the cart from the middle, m."""
        return self.largest["position"]

    @property
    def max_cart_velocity(self) -> float:
        """Largest speed of the cart, m/s."""
        return self.largest["velocity"]

    @property
    def max_cart_acceleration(self) -> float:
        """Largest acceleration of the cart, m/s²."""
        return self.largest["acceleration"]

    @property
    def rms_cart_acceleration(self) -> float:
        """Root of the mean squared acceleration of the cart, m/s²."""
        lengths = np.diff(self.mesh)
        square = (self.inputs[..., 0] ** 2) @ self.method.weights
        return float(np.sqrt(square @ lengths / lengths.sum()))

    @property
    def arms(self) -> ArmChainParameters | None:
        """Parameters of its arms, or None without a plan."""
        return None if self.plan is None else self.plan.origin.parameters

    @cached_property
    def uses(self) -> tuple[LimitUse, ...]:
        """Each limit's bound, with the largest value and its time."""
        return limit_uses(self, self.limits)

    @cached_property
    def errors(self) -> Array | None:
        """Errors between nodes (N,), scaled, measured again on each interval; None without known arms or heyoka."""
        if self.arms is None or not installed("heyoka"):
            return None
        zero_guess = np.zeros(self.states.shape[-1] - 2)
        problem = ReferenceProblem(
            equations=equations_of(self.arms, Level.CART),
            parameters=self.arms.planned().base(),
            guess=lambda times: np.broadcast_to(zero_guess, (len(times), len(zero_guess))),
            duration=self.duration,
            limits=self.limits,
        )
        return error_between_nodes(problem, self)

    def energies(self, states: Array) -> Array | None:
        """Return the pendulum's energies (K,), J, or None if the arms are unknown.

        Args:
            states: states (K, N).
        """
        if self.arms is None:
            return None
        pendulum = equations_of(self.arms, Level.CONSERVATIVE)
        return NumericEquations(pendulum, self.arms.base()).hamiltonian(states[:, :-2])

    def document(self) -> dict[str, Any]:
        """Return the JSON output of `dpcontrol reference`, without the file's name."""
        lengths = np.diff(self.mesh)
        return {
            **({} if self.plan is None else document_of(self.plan, _PLAN)),
            "duration": self.duration,
            "intervals": len(lengths),
            "shortest_interval": float(lengths.min()),
            "longest_interval": float(lengths.max()),
            "method": self.method.name,
            "limits": {use.name: picked(use, "unit", "bound", "largest", "share", "time") for use in self.uses},
            "effort": self.effort,
            "measured_error_between_nodes": None if self.errors is None else float(self.errors.max()),
            **picked(self, "rms_cart_acceleration", "max_error_between_nodes", "constraint_violation"),
            **picked(self, "iterations", "solve_seconds", "converged", "status"),
            "arrays": {"states": self.states.shape, "inputs": self.inputs.shape},
        }


@dataclass(frozen=True, eq=False)
class ReferenceFile(Documented):
    """A reference in a file.

    Attributes:
        file: the file.
        reference: reference of the file.
        transitions: picture of the transfers between equilibria, or None.
    """

    KEYS: ClassVar[str] = "file **reference.document transitions"

    file: Path
    reference: Reference
    transitions: Path | None = None


class ByReference:
    """Base of results whose status is that of their reference."""

    reference: Reference

    @property
    def converged(self) -> bool:
        """True if the reference converged and can be followed."""
        return self.reference.converged

    @property
    def status(self) -> str:
        """Method of the reference, or the cause of its failure with a remedy."""
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
    ending = ReferenceEnding(ReferenceCause.REST, times=(seconds,))
    return Reference(method, mesh, states, inputs, limits, ending, converged=True, max_error_between_nodes=0.0)


def joined(pieces: Sequence[Reference]) -> tuple[Reference, Array]:
    """Return pieces of one method as one reference, and the times (P + 1,), s, of their begins and the last end.

    A jump of states between pieces counts as a constraint violation. Inputs can jump.

    Args:
        pieces: references (P,) in order.
    """
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
    failed = [piece for piece in pieces if not piece.converged]
    error = max(piece.max_error_between_nodes for piece in pieces)
    iterations = sum(piece.iterations for piece in pieces)
    ending = ReferenceEnding(
        ReferenceCause.PIECES, iterations=iterations, error=error, intervals=len(mesh) - 1, parts=len(pieces)
    )
    joined_reference = replace(
        first,
        mesh=mesh,
        states=np.concatenate([piece.states for piece in pieces]),
        inputs=np.concatenate([piece.inputs for piece in pieces]),
        ending=failed[0].ending if failed else ending,
        converged=not failed,
        max_error_between_nodes=error,
        constraint_violation=max([*jumps, *(piece.constraint_violation for piece in pieces)]),
        iterations=iterations,
        solve_seconds=sum(piece.solve_seconds for piece in pieces),
    )
    return joined_reference, begins


FORMAT = "dpcontrol-reference"
VERSION = 2
_EXTRA = "extra_"
_FOUND = ("max_error_between_nodes", "constraint_violation", "iterations", "solve_seconds")
"""Figures of the search; the cart's figures follow from the trajectory."""
_CART = ("max_cart_position", "max_cart_velocity", "max_cart_acceleration", "rms_cart_acceleration")


_LARGEST = 1e9
"""Largest values in SI units whose squares are still finite."""


def save_reference(path: Path | BytesIO, reference: Reference) -> None:
    """Write a reference to one .npz file, in the layout of the module's text, and as a whole or not at all.

    Args:
        path: path, or a file in memory.
        reference: reference to write.

    Raises:
        InputError: the file cannot be written.
    """
    notes, extra = ({}, {}) if reference.plan is None else stored(reference.plan)
    header = {
        "format": FORMAT,
        "version": VERSION,
        "method": reference.method.name,
        "limits": reference.limits.named(),
        "numbers": plain(picked(reference, *_FOUND, *_CART)),
        "notes": notes,
        **picked(reference, "status", "converged"),
    }
    arrays = {
        **picked(reference, "mesh", "states", "inputs"),
        **picked(reference.method, "points", "support"),
        **{_EXTRA + name: array for name, array in extra.items()},
    }
    write_archive(path, header, arrays)


def _checked(header: Any, arrays: dict[str, Array]) -> Reference:
    """Return the reference of a file's header (JSON values by key) and arrays, after a check that they fit each other.

    Raises:
        ValueError: the file is invalid; so do `LookupError`, `TypeError` and `InputError`.
    """
    method = method_named(header["method"])
    mesh, states, inputs = (np.asarray(arrays[k], dtype=float) for k in ("mesh", "states", "inputs"))
    intervals, count = len(mesh) - 1, len(method.points)
    place_pairs = zip((arrays["points"], arrays["support"]), (method.points, method.support), strict=True)
    if not all(np.allclose(*pair, rtol=0, atol=1e-12) for pair in place_pairs):
        raise ValueError(f"its points or support are not those of {method.name}")
    if intervals < 1 or not (mesh[1:] > mesh[:-1]).all():
        raise ValueError("its mesh does not rise")
    if (*states.shape[:-1], *inputs.shape[:-1]) != (intervals, count + 1, intervals, count):
        raise ValueError(f"states {states.shape} and inputs {inputs.shape} do not fit its mesh")
    # Not a number fails too.
    if not all(np.abs(values).max(initial=0.0) <= _LARGEST for values in (mesh, states, inputs)):
        raise ValueError("its mesh, states or inputs are not finite, or too large")
    numbers, limits = header["numbers"], Limits(**header["limits"])
    figures = {name: np.inf if numbers[name] is None else float(numbers[name]) for name in _FOUND}
    if np.isnan([*figures.values(), *limits.named().values()]).any():
        raise ValueError("its numbers or limits are not numbers")
    arrays_of_plan = {name.removeprefix(_EXTRA): array for name, array in arrays.items()}
    notes = header["notes"]
    return Reference(
        method, mesh, states, inputs, limits,
        ending=ReferenceEnding(ReferenceCause.STORED, text=str(header["status"])), converged=bool(header["converged"]),
        iterations=int(figures.pop("iterations")), **figures,
        plan=restored(notes, arrays_of_plan, arms=states.shape[-1] // 2 - 1) if notes else None,
    )  # fmt: skip


def load_reference(path: Path | IO[bytes]) -> Reference:
    """Return the reference that a file of `save_reference` holds.

    Args:
        path: path, or an open binary file.

    Raises:
        InputError: the file does not exist, is damaged or is not a reference.
    """
    remedies = {"make": "plan the itinerary first", "again": "plan again"}
    with archive(path, what="a reference", **remedies, format=FORMAT, versions=(VERSION,)) as (header, arrays):
        return _checked(header, arrays)
