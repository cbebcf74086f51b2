"""Lyapunov orbits by symmetric shooting, continued in energy from the linear centre.

The arc's equations (module symmetric_shooting) are closed by H(x(0)) = energy: n + 1 equations for n + 1 unknowns.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError
from dpcontrol.orbits.symmetric_shooting import LinearCentre, SymmetricShooting, symmetric_shooting

Array = NDArray[np.float64]

_ON_THE_WAY = 1e-7
"""Scaled residual of orbits that are only passed."""


@dataclass(frozen=True)
class ContinuationSettings:
    """How a family is followed. step: largest change of √(energy above the saddle) over √(energy scale)."""

    step: float = 0.2
    smallest_step: float = 1e-4
    newton_iterations: int = 12
    tolerance: float = 1e-13


@dataclass(frozen=True)
class OrbitRecord:
    """What is published of a periodic orbit about a saddle.

    energy in J, period in s, state (N,): where it crosses the saddle's fixed set. floquet_multipliers (N,), largest
    first. residual: closure over one period, the largest component of x(T) - x(0). status: a sentence.
    """

    energy: float
    period: float
    state: Array
    floquet_multipliers: NDArray[np.complex128]
    residual: float
    status: str
    saddle: str
    family: int

    @property
    def name(self) -> str:
        """The saddle, and the family where it is not the first."""
        return self.saddle if self.family == 0 else f"{self.saddle} family {self.family}"

    def document(self) -> dict[str, Any]:
        """Return the record with the keys that `dpcontrol orbit --json` prints."""
        return {field.name: getattr(self, field.name) for field in fields(OrbitRecord)}


@dataclass(frozen=True)
class LyapunovOrbit(OrbitRecord):
    """A periodic orbit about a saddle: its record, and what its tubes are made from.

    newton_residual: of the shooting equations, scaled.
    """

    system: System
    monodromy: Array
    newton_residual: float
    converged: bool

    def __repr__(self) -> str:
        return f"<orbit about {self.saddle} at {self.energy:g}: {self.status}>"

    @property
    def unstable_multiplier(self) -> float:
        """The largest Floquet multiplier, real for a saddle's orbit."""
        return float(self.floquet_multipliers[0].real)

    @property
    def centre(self) -> Array:
        """State (N,) of the saddle that the orbit surrounds."""
        return self.system.equilibrium(self.saddle)

    @property
    def reverser(self) -> Array:
        """The reverser (N, N) that, about the centre, turns the orbit's unstable manifold into its stable one."""
        return self.system.reversers[0]

    @property
    def whole_turns(self) -> Array:
        """Whole turns (N,) that a period adds to the coordinates: none, a Lyapunov orbit does not turn."""
        return np.zeros(self.system.dimension)

    @property
    def turn(self) -> Array:
        """Lengths (N,) that a period adds to the coordinates."""
        return self.whole_turns * self.system.turn_lengths

    @property
    def laps(self) -> bool:
        """Whether the orbit may itself cross sections, so that its tubes cross them with every lap."""
        return False


def lyapunov_orbit(
    system: System,
    saddle: str,
    *,
    energy: float,
    family: int = 0,
    settings: ContinuationSettings | None = None,
) -> LyapunovOrbit:
    """Return the Lyapunov orbit about `saddle` at `energy` (J).

    Raises:
        InputError: unknown saddle or family, or an energy on the wrong side of the saddle's.
    """
    settings = settings or ContinuationSettings()
    problem, linear = symmetric_shooting(system, saddle, family)
    if not np.isfinite(energy):
        raise InputError(f"energy = {energy}: must be a finite number of joules")
    if (energy - linear.energy) * linear.sign <= 0:
        raise InputError(
            f"energy = {energy!r} J: the Lyapunov orbits about {saddle} exist only "
            f"{'above' if linear.sign > 0 else 'below'} its energy of {linear.energy!r} J"
        )
    unknowns, residual, converged, status = _follow(problem, settings, linear, energy)
    return described_orbit(
        problem,
        unknowns,
        saddle=saddle,
        family=family,
        energy=energy,
        newton_residual=residual,
        converged=converged,
        status=status,
    )


def described_orbit(
    problem: SymmetricShooting,
    unknowns: Array,
    *,
    saddle: str,
    family: int,
    energy: float,
    newton_residual: float,
    converged: bool,
    status: str,
) -> LyapunovOrbit:
    """Return the orbit of solved unknowns (n + 1,) with its monodromy matrix, multipliers and closure."""
    system = problem.system
    state, period = problem.state(unknowns), problem.period(unknowns)
    end, monodromy = system.propagator.flow_with_stm(state, period)
    return LyapunovOrbit(
        system=system,
        saddle=saddle,
        family=family,
        energy=energy,
        state=state,
        period=period,
        floquet_multipliers=floquet_multipliers(system, state, period, monodromy),
        monodromy=monodromy,
        residual=float(np.abs(end - state).max()),
        newton_residual=newton_residual,
        converged=converged,
        status=status,
    )


@dataclass(frozen=True)
class _Passed:
    """A member on the way: its place s, unknowns (n + 1,) and their change by s."""

    s: float
    unknowns: Array
    slope: Array


def _follow(
    problem: SymmetricShooting, settings: ContinuationSettings, linear: LinearCentre, energy: float
) -> tuple[Array, float, bool, str]:
    """Continue from the linear centre in s = √(energy above the saddle), predicting by cubics in s."""
    saddle_energy, sign = linear.energy, linear.sign
    goal = np.sqrt(abs(energy - saddle_energy))
    largest = settings.step * np.sqrt(problem.system.energy_scale)
    at_birth = 2 * np.pi / linear.frequency / problem.quarters
    units = np.append(np.abs(problem.start.T) @ problem.system.scale, at_birth)
    passed = [_Passed(0.0, np.append(0 * linear.direction, at_birth), np.append(linear.direction, 0.0))]
    step = min(largest, goal)
    residual = np.inf
    while passed[-1].s < goal:
        last = passed[-1]
        # A last step that rounding alone leaves over would have no length to judge corrections by.
        s = goal if last.s + (1 + 1e-6) * step >= goal else last.s + step
        ends = s == goal
        enough = 0.0 if ends else _ON_THE_WAY
        guess = _predicted(passed[-2:], s)
        found = problem.member(
            guess, energy if ends else saddle_energy + sign * s * s, iterations=settings.newton_iterations,
            tolerance=settings.tolerance, enough=enough,
        )  # fmt: skip
        residual = found.residual
        corrected, moved = (float(np.linalg.norm(v / units)) for v in (found.unknowns - guess, guess - last.unknowns))
        # A correction as long as half the step has left for another curve, as in module family_curve.
        if residual > max(settings.tolerance, enough) or corrected > 0.5 * moved:
            step = (s - last.s) / 2
            if step < settings.smallest_step * largest:
                reached = saddle_energy + sign * last.s**2
                return last.unknowns, residual, False, (
                    f"not converged: the family could be followed only to {reached:.6g} J (residual "
                    f"{residual:.1e} beyond); ask for an energy nearer to the saddle's"
                )  # fmt: skip
            continue
        passed.append(_Passed(s, found.unknowns, 2 * sign * s * found.slope))
        step = min(largest, step * 1.5)
    return passed[-1].unknowns, residual, True, f"converged in {len(passed) - 1} continuation steps"


def _predicted(points: Sequence[_Passed], s: float) -> Array:
    """Return the unknowns (n + 1,) at s on the tangent at one point, or on the cubic through two and their tangents."""
    last = points[-1]
    ahead = last.unknowns + (s - last.s) * last.slope
    if len(points) == 1:
        return ahead
    # Newton's form on the nodes last, last, first, first.
    first = points[0]
    width = first.s - last.s
    chord = (first.unknowns - last.unknowns) / width
    bend, far_bend = (chord - last.slope) / width, (first.slope - chord) / width
    return ahead + (s - last.s) ** 2 * (bend + (s - first.s) * (far_bend - bend) / width)


def floquet_multipliers(system: System, state: Array, period: float, monodromy: Array) -> NDArray[np.complex128]:
    """Return the N Floquet multipliers of a periodic orbit, largest modulus first.

    The pair at one belongs to the flow and the energy: M f = f and ∇Hᵀ M = ∇Hᵀ. The others are the eigenvalues
    of M on ker ∇H modulo f. Those inside the unit circle are taken from the backward monodromy matrix, since the
    forward one knows them only to rounding times the largest squared.
    """
    rate, gradient = system.numeric.rate(state), system.numeric.gradient(state)
    plane, _ = np.linalg.qr(np.column_stack([rate, gradient]))
    rest = np.linalg.svd(plane.T)[2][2:].T
    forward = np.linalg.eigvals(rest.T @ monodromy @ rest)
    _, backward_monodromy = system.propagator.flow_with_stm(state, -period)
    backward = np.linalg.eigvals(rest.T @ backward_monodromy @ rest)
    outside = forward[np.abs(forward) > 1 + 1e-6]
    inside = 1 / backward[np.abs(backward) > 1 + 1e-6]
    count = system.dimension - 2 - len(outside) - len(inside)
    neutral = forward[np.argsort(np.abs(np.abs(forward) - 1))[: max(count, 0)]]
    along = rate @ monodromy @ rate / (rate @ rate)
    across = gradient @ monodromy @ gradient / (gradient @ gradient)
    values = np.concatenate([outside, [along, across], neutral, inside]).astype(complex)
    return values[np.argsort(-np.abs(values), kind="stable")]
