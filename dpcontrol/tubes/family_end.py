"""Why a family of periodic orbits was left: hyperbolicity lost, homoclinics of an equilibrium, or not known.

A family that runs into an equilibrium's homoclinics has a period that grows without bound: with μ the equilibrium's
slowest growth rate and two passages to a period, energy - limit ~ exp(-μ T/2); the limit is extrapolated.
Source: Vanderbauwhede & Fiedler, Homoclinic period blow-up in reversible and conservative systems (1992).
"""

from dataclasses import dataclass

import numpy as np

from dpcontrol.dynamics.system import System
from dpcontrol.tubes.family_curve import FamilyPoint
from dpcontrol.tubes.symmetric_shooting import SymmetricShooting

SIZE = "size"
"""Measure of a family's point: the largest multiplier's modulus, at least one."""

LINGERS = 0.05
"""Scaled distance of an equilibrium within which an orbit is said to linger by it."""


@dataclass(frozen=True)
class FamilyEnd:
    """Where the family was left: energy in J, kind, and the reason as a sentence.

    kind: "saddle", "energy bound", "homoclinics", "hyperbolicity lost" or "not followed further".
    """

    energy: float
    kind: str
    reason: str


def lost(test: str, place: FamilyPoint) -> FamilyEnd:
    """Return the end at a member where the measure `test`, "multiplier +1" or "multiplier -1", vanishes."""
    what = "a branch leaves the family or it folds" if test.endswith("+1") else "the period doubles"
    reason = f"hyperbolicity is lost at {place.energy:.12g} J: a multiplier crosses {test.split()[1]}, where {what}"
    return FamilyEnd(place.energy, "hyperbolicity lost", reason)


def nearest_equilibrium(problem: SymmetricShooting, place: FamilyPoint) -> tuple[str, float]:
    """Return the equilibrium that an orbit passes nearest, and the scaled distance at which it does."""
    system = problem.system
    arc = system.propagator.sample(problem.state(place.unknowns), np.linspace(0, place.unknowns[-1], 400))
    distances = {name: float(np.min(system.scaled_distance(arc, x))) for name, x in system.equilibria.items()}
    return min(distances.items(), key=lambda item: item[1])


def family_end(
    system: System, points: list[FamilyPoint], problem: SymmetricShooting, *, largest: float | None = None
) -> FamilyEnd:
    """Say why the family could not be followed on: homoclinics of an equilibrium, or not known.

    points: the last members; largest: the modulus of multipliers at which the family was left, if it was for that.
    """
    place = points[-1]
    name, distance = nearest_equilibrium(problem, place)
    goal = float(system.numeric.hamiltonian(system.equilibria[name]))
    limit = _extrapolated(points, problem)
    if distance < LINGERS and limit is not None and abs(limit - goal) < 1e-3 * system.energy_scale:
        return FamilyEnd(
            place.energy,
            "homoclinics",
            f"ends in the homoclinics of {name}: the period grows without bound (followed to "
            f"{problem.period(place.unknowns):.3g} s, multiplier {place.measures[SIZE]:.1e}) as the energy tends to "
            f"{limit:.6g} J, extrapolated; {name} has {goal:.6g} J",
        )
    if largest is not None:
        reason = f"left at {place.energy:.9g} J: multipliers above {largest:g} are rounding in double"
    else:
        reason = f"could not be followed beyond {place.energy:.9g} J (residual {place.residual:.1e})"
    return FamilyEnd(place.energy, "not followed further", reason)


def _extrapolated(points: list[FamilyPoint], problem: SymmetricShooting) -> float | None:
    """Return the energy's limit as the period grows, from nine equal steps, None if it has none."""
    if len(points) < 9:
        return None
    # Equal steps in the period, as the rule wants: an exponential in it is what homoclinics give.
    periods = np.array([problem.period(p.unknowns) for p in points[-9:]])
    energies = np.array([p.energy for p in points[-9:]])
    if np.any(np.diff(periods) <= 0):
        return None
    rates = np.diff(energies) / np.diff(periods)
    middles = (periods[1:] + periods[:-1]) / 2
    # ln|dE/dT| is linear in T there; what remains of the energy is the last rate over its decay.
    decay = -float(np.polyfit(middles, np.log(np.abs(rates)), 1)[0]) if np.all(rates != 0) else 0.0
    if decay <= 0:
        return None
    last = float(rates[-1] * np.exp(-decay * (periods[-1] - middles[-1])))
    return float(energies[-1] + last / decay)
