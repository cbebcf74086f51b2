"""A reference in figures: its use of each limit, its effort, and its error measured again on every interval.

The error between nodes and the energy need the arms that it was made for, which a plan's notes carry: `made_from`,
whose `parameters` are those of `dpcontrol.dynamics.chain.ArmChainParameters` by name.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.dynamics.equations import NumericEquations
from dpcontrol.foundation.documents import picked
from dpcontrol.foundation.errors import InputError
from dpcontrol.references.problem import LIMIT_UNITS, ReferenceProblem
from dpcontrol.references.reference import Reference
from dpcontrol.references.trajectory import error_between_nodes, largest_values, where_largest

Array = NDArray[np.float64]


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
