"""Lyapunov orbits in 113-bit arithmetic: symmetric shooting again, with residuals in extended precision.

The equations are those of `orbits.symmetric_shooting`, evaluated in 113 bits at the exact energy; the Jacobian
stays in double, so each Newton step leaves about 1e-12 of the residual and no linear algebra is needed beyond double.
Source: Higham, Accuracy and Stability of Numerical Algorithms (2002), chapter 12 (refinement with extended residuals).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.extended import Extended, ExtendedPropagator, digits, extended, pi_times
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.orbits.lyapunov import LyapunovOrbit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RefinementSettings:
    """amplitude: on the local manifolds at the outer nodes, scaled; tolerance: of every residual (rad, rad/s, J).

    stalled: refinement ends when a step leaves more than this share of the residual.
    """

    amplitude: float = 1e-20
    segments: int = 8
    iterations: int = 10
    tolerance: float = 1e-24
    stalled: float = 0.3


@dataclass(frozen=True, eq=False)
class ExtendedOrbit:
    """A Lyapunov orbit in extended precision: state (N,), period in s, residual of its shooting equations."""

    orbit: LyapunovOrbit
    propagator: ExtendedPropagator
    state: Extended
    period: Any
    residual: Any

    @property
    def digits(self) -> list[str]:
        """The state as decimal digits, one string for each component."""
        return digits(self.state)

    @property
    def period_digits(self) -> str:
        """The period in s as decimal digits."""
        return str(self.period)

    def at(self, phase: Any) -> Extended:
        """Return the state (N,) at a phase (period 1), flown from the nearest image of phase zero."""
        system = self.orbit.system
        halves = len(system.reversers) > 1
        spacing = 0.5 if halves else 1.0
        turns = int(np.rint(float(phase) / spacing))
        state = self.propagator.flow(self.state, (phase - extended(turns * spacing)) * self.period)
        if not halves or turns % 2 == 0:
            return state
        # γ(φ + ½) = S γ(φ) about the saddle.
        centre = exact_position(system, self.orbit.centre)
        symmetry = extended(system.reversers[-1] @ system.reversers[0])
        return symmetry @ (state - centre) + centre


def exact_position(system: System, state: Array) -> Extended:
    """Return a resting state (N,) whose angles are whole multiples of π in double as those multiples in extended.

    Other components are taken as the binary numbers that they are.
    """
    halves = np.where(np.isfinite(system.periods), state / np.pi, 0.0)
    whole = np.rint(halves)
    angular = np.isfinite(system.periods) & (np.abs(halves - whole) < 1e-12)
    return pi_times(np.where(angular, whole, 0.0)) + extended(np.where(angular, 0.0, state))


def refine_orbit(
    orbit: LyapunovOrbit, propagator: ExtendedPropagator, energy: Any, settings: RefinementSettings | None = None
) -> ExtendedOrbit:
    """Refine a Lyapunov orbit by symmetric shooting at `energy` (113-bit).

    Raises:
        GoalMissed: the residual stays above the tolerance; says how large it is.
    """
    settings = settings or RefinementSettings()
    system = orbit.system
    first, last = system.reversers[-1], system.reversers[0]
    quarters = 4 if len(system.reversers) > 1 else 2
    unit = np.eye(system.dimension)
    # Projectors: half the sum keeps the fixed set, half the difference vanishes on it.
    keep, leave = (unit + first) / 2, (unit - last) / 2
    centre = exact_position(system, orbit.centre)
    start = extended(keep) @ (extended(orbit.state) - centre)
    duration = extended(orbit.period / quarters)[()]
    best, best_residual = (start, duration), np.inf
    for _ in range(settings.iterations):
        state = centre + start
        end = propagator.flow(state, duration)
        missing = extended(leave) @ (end - centre)
        height = propagator.energy(state) - energy
        residual = max(np.abs(missing).max(), abs(height))
        if residual < best_residual:
            best, previous, best_residual = (start, duration), best_residual, residual
            if residual > settings.stalled * previous and residual < settings.tolerance:
                break
        else:
            break
        end_double, stm = system.propagator.flow_with_stm(state.astype(float), float(duration))
        jacobian = np.zeros((system.dimension + 1, system.dimension + 1))
        jacobian[:-1, :-1] = leave @ stm @ keep
        jacobian[:-1, -1] = leave @ system.numeric.rate(end_double)
        jacobian[-1, :-1] = system.numeric.gradient(state.astype(float)) @ keep
        # Scaled so that the residual's double image keeps its digits; half the rows and columns are empty.
        size = residual if residual > 0 else extended(1.0)[()]
        right = np.append((missing / size).astype(float), float(height / size))
        step = np.linalg.lstsq(jacobian, right, rcond=1e-10)[0]
        start = start - extended(keep @ step[:-1]) * size
        duration = duration - extended(step[-1])[()] * size
    start, duration = best
    if not best_residual <= settings.tolerance:
        raise GoalMissed(
            f"the Lyapunov orbit about {orbit.saddle} could be refined only to a residual of "
            f"{float(best_residual):.1e}; use double precision"
        )
    return ExtendedOrbit(orbit, propagator, centre + start, duration * quarters, best_residual)


def distance(refined: ExtendedOrbit, state: Extended, phase: float) -> float:
    """Return the scaled distance of a state from an orbit near a phase, the foot found by Gauss-Newton steps."""
    system = refined.orbit.system
    at = extended(phase)[()]
    gap = state
    for _ in range(4):
        foot = refined.at(at)
        gap = state - foot
        angular = np.isfinite(system.periods)
        turns = np.where(angular, np.rint(gap.astype(float) / (2 * np.pi)), 0.0)
        gap = (gap - pi_times(2.0 * turns)).astype(float) / system.scale
        slope = system.numeric.rate(foot.astype(float)) * float(refined.period) / system.scale
        at = at + extended(float(gap @ slope / (slope @ slope)))[()]
    return float(np.abs(gap).max())
