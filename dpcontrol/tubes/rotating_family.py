"""A family of rotating orbits, followed in energy along its own curve, with the changes of its stability.

The half turn's equations leave a curve in (ω, τ), followed by pseudo-arclength so that it may turn back in energy. The
trace of the section's map is watched: at +2 another family branches off or the family folds, at -2 the period
doubles. Each change is located as a root along the curve, every trial point corrected onto it.

Source: Meyer & Offin, Introduction to Hamiltonian Dynamical Systems and the N-Body Problem, 3rd ed., chapter 11.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.tubes.family_curve import SLOPE, FamilyCurve, FamilyPoint
from dpcontrol.tubes.family_end import LINGERS, nearest_equilibrium
from dpcontrol.tubes.rotating import RotatingOrbit, described, half_turn, kind_of, section_trace
from dpcontrol.tubes.symmetric_shooting import SymmetricShooting

Array = NDArray[np.float64]

_TRACE = "trace"


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
    problem = half_turn(orbit.system, orbit.arm, sense, float(other))
    curve = FamilyCurve(
        problem,
        weights=np.append(orbit.system.scale[2:], orbit.period / 2),
        measure=lambda unknowns: {_TRACE: section_trace(problem, unknowns)[0]},
        iterations=settings.newton_iterations,
        tolerance=settings.tolerance,
        accept=settings.tolerance,
    )

    def described_point(point: FamilyPoint) -> RotatingOrbit:
        return described(problem, point.unknowns, orbit.arm, point.energy, point.residual)

    unknowns = np.append(problem.start.T @ (orbit.state - problem.centre), orbit.period / 2)
    first = curve.point(unknowns, None, orbit.newton_residual)
    up = _follow(curve, first, (low, high), described_point, settings, progress)
    down = _follow(curve, first.reversed(), (low, high), described_point, settings, progress)
    points = [*reversed(down.points), first, *up.points]
    members = tuple(described_point(p) for p in points)
    # Down the curve, what came before a change comes after it.
    changes = [replace(c, before=c.after, after=c.before) for c in reversed(down.changes)] + up.changes
    folds = (*reversed(down.folds), *up.folds)
    failed = [run.reason for run in (down, up) if run.failed]
    status = f"{len(members)} orbits from {members[0].energy:.9g} to {members[-1].energy:.9g} J, "
    status += f"{len(changes)} changes of stability, {len(folds)} folds in energy"
    if failed:
        status += "; " + "; ".join(failed)
    return RotatingFamily(members, tuple(changes), folds, (down.reason, up.reason), not failed, status)


def rotating_families(
    orbits: Sequence[RotatingOrbit],
    energies: tuple[float, float],
    *,
    settings: RotatingFamilySettings | None = None,
    progress: Progress = no_progress,
) -> tuple[RotatingFamily, ...]:
    """Follow the families of several orbits of one energy, each family once: where it folds it holds several.

    Raises:
        InputError: the bounds do not enclose the orbits' energy.
    """
    families: list[RotatingFamily] = []
    for k, orbit in enumerate(orbits):
        if not any(_passes(family, orbit) for family in families):

            def share(what: str, done: float, k: int = k) -> None:
                progress(what, (k + done) / len(orbits))

            families.append(rotating_family(orbit, energies, settings=settings, progress=share))
    return tuple(families)


def _passes(family: RotatingFamily, orbit: RotatingOrbit) -> bool:
    """Whether a family's curve passes an orbit: near where it crosses the orbit's energy, in scaled units."""
    scale = orbit.system.scale
    for a, b in pairwise(family.members):
        if (a.energy - orbit.energy) * (b.energy - orbit.energy) > 0 or a.energy == b.energy:
            continue
        share = (orbit.energy - a.energy) / (b.energy - a.energy)
        state = a.state + share * (b.state - a.state)
        period = a.period + share * (b.period - a.period)
        # Members lie a few hundredths apart: a chord is off its curve by less than a tenth of that.
        reach = 0.1 * max(float(np.abs((b.state - a.state) / scale).max()), abs(b.period / a.period - 1)) + 1e-6
        off = max(float(np.abs((state - orbit.state) / scale).max()), abs(period / orbit.period - 1))
        if off < reach:
            return True
    return False


@dataclass
class _Run:
    """What one direction of following has met so far."""

    points: list[FamilyPoint]
    changes: list[StabilityChange]
    folds: list[RotatingOrbit]
    reason: str = ""
    failed: bool = False


def _follow(
    curve: FamilyCurve,
    start: FamilyPoint,
    energies: tuple[float, float],
    described_point: Callable[[FamilyPoint], RotatingOrbit],
    settings: RotatingFamilySettings,
    progress: Progress,
) -> _Run:
    def too_long(here: FamilyPoint, following: FamilyPoint) -> bool:
        # A step across all of the elliptic range would confuse its two ends.
        first, second = here.measures[_TRACE], following.measures[_TRACE]
        return abs(first) > 2 and abs(second) > 2 and first * second < 0

    run, here = _Run([], [], []), start
    steps = curve.followed(start, step=settings.step, smallest=settings.smallest_step, too_long=too_long)
    for before, after, length in steps:
        following = after
        beyond = min(max(following.energy, energies[0]), energies[1])
        if beyond != following.energy:
            place = curve.located(before, length, lambda point, beyond=beyond: point.energy - beyond)
            if place is not None:
                following = replace(place, energy=beyond)
            run.reason = f"left at the asked bound of {beyond:g} J; the family goes on"
        _events(curve, run, before, following, length, described_point)
        run.points.append(following)
        progress("family of rotating orbits", abs(following.energy - start.energy) / (energies[1] - energies[0]))
        here = following
        period, trace = curve.problem.period(here.unknowns), abs(here.measures[_TRACE])
        if not run.reason and period > settings.longest:
            run.reason = f"left at {here.energy:.9g} J: the period has grown to {period:.3g} s"
        elif not run.reason and trace > settings.largest:
            run.reason = f"left at {here.energy:.9g} J: multipliers above {settings.largest:g} are rounding in double"
        elif not run.reason and len(run.points) >= settings.most_members:
            run.reason = f"left after {settings.most_members} members at {here.energy:.9g} J; allow more"
        if run.reason:
            return run
    run.reason = _homoclinics(curve.problem, here)
    run.failed = not run.reason
    run.reason = run.reason or f"could not be followed beyond {here.energy:.9g} J: no step converges"
    return run


def _events(
    curve: FamilyCurve,
    run: _Run,
    here: FamilyPoint,
    following: FamilyPoint,
    length: float,
    described_point: Callable[[FamilyPoint], RotatingOrbit],
) -> None:
    for critical in (2.0, -2.0):
        sides = [p.measures[_TRACE] - critical for p in (here, following)]
        if sides[0] * sides[1] < 0:
            place = curve.located(here, length, lambda point, critical=critical: point.measures[_TRACE] - critical)
            if place is not None:
                before, after = (kind_of(float(critical + np.sign(side))) for side in sides)
                run.changes.append(StabilityChange(described_point(place), critical, before, after))
    if here.measures[SLOPE] * following.measures[SLOPE] < 0:
        place = curve.located(here, length, lambda point: point.measures[SLOPE])
        if place is not None:
            run.folds.append(described_point(place))


def _homoclinics(problem: SymmetricShooting, place: FamilyPoint) -> str:
    """Say that the family ends at an equilibrium by which its last orbit lingers; empty if it does not linger."""
    system = problem.system
    name, near = nearest_equilibrium(problem, place)
    height = float(system.numeric.hamiltonian(system.equilibria[name]))
    if near > LINGERS or abs(height - place.energy) > 1e-3 * system.energy_scale:
        return ""
    return (
        f"ends in the homoclinics of {name}: at {place.energy:.9g} J the period has grown to "
        f"{problem.period(place.unknowns):.3g} s and the orbit passes {name} ({height:.9g} J) "
        f"at a scaled distance of {near:.1g}"
    )
