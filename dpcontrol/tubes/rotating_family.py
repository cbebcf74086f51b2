"""A family of rotating orbits, followed in energy along its own curve, with the changes of its stability.

The half turn's equations leave a curve in (ω, τ), followed by pseudo-arclength so that it may turn back in energy. The
trace of the section's map is watched: at +2 another family branches off or the family folds, at -2 the period
doubles. Each change is located as a root along the curve, every trial point corrected onto it.

Source: Meyer & Offin, Introduction to Hamiltonian Dynamical Systems and the N-Body Problem, 3rd ed., chapter 11.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import Progress, no_progress
from dpcontrol.tubes.rotating import HalfTurn, RotatingOrbit, described, half_turn, kind_of, section_trace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RotatingFamilySettings:
    """step, smallest_step: along the curve, in scaled units of (ω, τ); longest: period in s, largest: trace."""

    step: float = 0.05
    smallest_step: float = 1e-6
    most_members: int = 400
    longest: float = 5.0
    largest: float = 1e8
    newton_iterations: int = 12
    tolerance: float = 1e-12


@dataclass(frozen=True)
class StabilityChange:
    """An orbit at which the trace passes +2 or -2; before and after: kinds along the family's curve."""

    orbit: RotatingOrbit
    critical_trace: float
    before: str
    after: str


@dataclass(frozen=True)
class RotatingFamily:
    """Members along the family's curve, from one end to the other; folds: where its energy turns back.

    ends: why it was left on either side, sentences. converged: neither end is where Newton's method failed.
    """

    members: tuple[RotatingOrbit, ...]
    changes: tuple[StabilityChange, ...]
    folds: tuple[RotatingOrbit, ...]
    ends: tuple[str, str]
    converged: bool
    status: str

    @property
    def energies(self) -> Array:
        """Energies (K,) in J."""
        return np.array([m.energy for m in self.members])

    @property
    def traces(self) -> Array:
        """Traces (K,) of the section's map."""
        return np.array([m.trace for m in self.members])


@dataclass(frozen=True)
class _Point:
    unknowns: Array
    tangent: Array
    energy: float
    slope: float
    trace: float
    residual: float


class _Curve:
    def __init__(self, problem: HalfTurn, orbit: RotatingOrbit, settings: RotatingFamilySettings) -> None:
        self.problem, self.settings, self.arm = problem, settings, orbit.arm
        self.weights = np.append(problem.system.scale[2:], orbit.period / 2)

    def point(self, unknowns: Array, heading: Array | None, residual: float) -> _Point:
        _, jacobian = self.problem.arc(unknowns)
        tangent = np.linalg.svd(jacobian * self.weights)[2][-1]
        energy, gradient = self.problem.energy(unknowns)
        slope = float((gradient * self.weights) @ tangent)
        # The first tangent looks up in energy, every other one along its predecessor.
        if (slope if heading is None else tangent @ heading) < 0:
            tangent, slope = -tangent, -slope
        return _Point(unknowns, tangent, energy, slope, section_trace(self.problem, unknowns)[0], residual)

    def step(self, start: _Point, length: float) -> _Point | None:
        """Return the curve's point `length` on from `start`, None where Newton's method does not find it."""
        guess = start.unknowns + length * start.tangent * self.weights
        found, residual = self.problem.along(
            guess,
            start.tangent,
            self.weights,
            iterations=self.settings.newton_iterations,
            tolerance=self.settings.tolerance,
        )
        moved = float(np.linalg.norm((found - guess) / self.weights))
        if residual > self.settings.tolerance or moved > 0.5 * abs(length):
            return None
        try:
            point = self.point(found, start.tangent, residual)
        except (ArithmeticError, np.linalg.LinAlgError):
            return None
        # A tangent that turned by 25 degrees belongs to another curve, or to too long a step.
        return point if point.tangent @ start.tangent > 0.9 else None

    def orbit(self, point: _Point) -> RotatingOrbit:
        return described(self.problem, point.unknowns, self.arm, point.energy, point.residual)

    def located(self, start: _Point, length: float, test: str, value: float) -> _Point | None:
        """Return the point up to `length` on from `start` where an attribute takes a value."""

        def off(h: float) -> float:
            point = start if h == 0 else self.step(start, h)
            if point is None:
                raise ArithmeticError("left the curve")
            return getattr(point, test) - value

        try:
            return self.step(start, float(brentq(off, 0.0, length, xtol=1e-13)))  # type: ignore[arg-type]
        except (ArithmeticError, ValueError):
            return None


def rotating_family(
    orbit: RotatingOrbit,
    energies: tuple[float, float],
    *,
    settings: RotatingFamilySettings | None = None,
    progress: Progress = no_progress,
) -> RotatingFamily:
    """Follow the family of a rotating orbit both ways within `energies` (lowest, highest) in J.

    Raises:
        InputError: the bounds do not enclose the orbit's energy.
    """
    settings = settings or RotatingFamilySettings()
    low, high = energies
    if not low < orbit.energy < high:
        raise InputError(f"energies {low:g} to {high:g} J: must enclose the orbit's, {orbit.energy:g} J")
    sense = 1 if sum(orbit.winding) > 0 else -1
    other = orbit.state[2 - orbit.arm]
    curve = _Curve(half_turn(orbit.system, orbit.arm, sense, float(other)), orbit, settings)
    unknowns = np.append(curve.problem.start.T @ (orbit.state - curve.problem.centre), orbit.period / 2)
    first = curve.point(unknowns, None, orbit.newton_residual)
    up = _follow(curve, first, (low, high), settings, progress)
    back = replace(first, tangent=-first.tangent, slope=-first.slope)
    down = _follow(curve, back, (low, high), settings, progress)
    points = [*reversed(down.points), first, *up.points]
    members = tuple(curve.orbit(p) for p in points)
    # Down the curve, what came before a change comes after it.
    changes = [replace(c, before=c.after, after=c.before) for c in reversed(down.changes)] + up.changes
    folds = (*reversed(down.folds), *up.folds)
    failed = [run.reason for run in (down, up) if run.failed]
    status = f"{len(members)} orbits from {members[0].energy:.9g} to {members[-1].energy:.9g} J, "
    status += f"{len(changes)} changes of stability, {len(folds)} folds in energy"
    if failed:
        status += "; " + "; ".join(failed)
    return RotatingFamily(members, tuple(changes), folds, (down.reason, up.reason), not failed, status)


@dataclass
class _Run:
    """What one direction of following has met so far."""

    points: list[_Point]
    changes: list[StabilityChange]
    folds: list[RotatingOrbit]
    reason: str = ""
    failed: bool = False


def _follow(
    curve: _Curve,
    start: _Point,
    energies: tuple[float, float],
    settings: RotatingFamilySettings,
    progress: Progress,
) -> _Run:
    run, here, length = _Run([], [], []), start, min(settings.step, 0.01)
    while not run.reason:
        following = curve.step(here, length)
        if following is None:
            length /= 2
            if length < settings.smallest_step:
                run.reason = _homoclinics(curve.problem, here)
                run.failed = not run.reason
                run.reason = run.reason or f"could not be followed beyond {here.energy:.9g} J: no step converges"
            continue
        # A step across all of the elliptic range would confuse its two ends.
        if (abs(here.trace) > 2) and (abs(following.trace) > 2) and here.trace * following.trace < 0:
            length /= 2
            if length > settings.smallest_step:
                continue
        beyond = min(max(following.energy, energies[0]), energies[1])
        if beyond != following.energy:
            place = curve.located(here, length, "energy", beyond)
            if place is not None:
                following = replace(place, energy=beyond)
            run.reason = f"left at the asked bound of {beyond:g} J; the family goes on"
        _events(curve, run, here, following, length)
        run.points.append(following)
        progress("family of rotating orbits", abs(following.energy - start.energy) / (energies[1] - energies[0]))
        here, length = following, min(settings.step, 1.5 * length)
        period = curve.problem.period(here.unknowns)
        if run.reason:
            break
        if period > settings.longest:
            run.reason = f"left at {here.energy:.9g} J: the period has grown to {period:.3g} s"
        elif abs(here.trace) > settings.largest:
            run.reason = f"left at {here.energy:.9g} J: multipliers above {settings.largest:g} are rounding in double"
        elif len(run.points) >= settings.most_members:
            run.reason = f"left after {settings.most_members} members at {here.energy:.9g} J; allow more"
    return run


def _events(curve: _Curve, run: _Run, here: _Point, following: _Point, length: float) -> None:
    for critical in (2.0, -2.0):
        if (here.trace - critical) * (following.trace - critical) < 0:
            place = curve.located(here, length, "trace", critical)
            if place is not None:
                sides = [critical + np.sign(p.trace - critical) for p in (here, following)]
                before, after = (kind_of(float(side)) for side in sides)
                run.changes.append(StabilityChange(curve.orbit(place), critical, before, after))
    if here.slope * following.slope < 0:
        place = curve.located(here, length, "slope", 0.0)
        if place is not None:
            run.folds.append(curve.orbit(place))


def _homoclinics(problem: HalfTurn, place: _Point) -> str:
    """Say that the family ends at an equilibrium by which its last orbit lingers; empty if it does not linger."""
    system = problem.system
    arc = system.propagator.sample(problem.state(place.unknowns), np.linspace(0, place.unknowns[-1], 400))
    for name, state in system.equilibria.items():
        height = float(system.numeric.hamiltonian(state))
        near = float(np.min(system.scaled_distance(arc, state)))
        if near < 0.05 and abs(height - place.energy) < 1e-3 * system.energy_scale:
            return (
                f"ends in the homoclinics of {name}: at {place.energy:.9g} J the period has grown to "
                f"{problem.period(place.unknowns):.3g} s and the orbit passes {name} ({height:.9g} J) "
                f"at a scaled distance of {near:.1g}"
            )
    return ""
