"""Rotating orbits: one arm turns over and over, the other returns, x(T) = x(0) + 2π e_arm.

The product R of time reversal and reflection maps (θ, ω)(t) to (-θ, ω)(-t); about a resting position θ* (multiples
of π) its fixed set is {θ = θ*, ω free}. An orbit that starts there and meets the fixed set half a turn on,

    θ(τ) = θ* + π e_arm,      H(θ*, ω) = energy,

is mirrored into itself, so that T = 2τ. On the mirror line at an energy the rates form an ellipse, ω(ψ): it is scanned
over ψ, and refined where the other arm's angle on arrival jumps; each change of its sign gives Newton's method on
(ω, τ) a guess. "Simple" orbits are those of which the turning arm first arrives half a turn on at θ(τ).

Their families are followed in energy (module family). The trace of the section's map is watched: at +2 another family
branches off or the family folds, at -2 the period doubles.

Sources: Kaheman et al. (2023), section 3; Lamb & Roberts, Time-reversal symmetry in dynamical systems (1998); Meyer &
Offin, Introduction to Hamiltonian Dynamical Systems and the N-Body Problem, 3rd ed., chapter 11.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import fields_of, picked
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.orbits.family import (
    LINGERS,
    SLOPE,
    CurveEvent,
    Family,
    FamilyCurve,
    FamilyPoint,
    Followed,
    FollowingSettings,
    follow,
    nearest_equilibrium,
)
from dpcontrol.orbits.lyapunov import SymmetricShooting, fixed_and_moved


@dataclass(frozen=True)
class RotatingSettings:
    """How the mirror line is scanned. jump: rad, of the other arm's angle on arrival, above which is refined.

    longest: half a turn may take so many of the slowest small oscillation's periods. Orbits that linger longer are
    there without end (they shadow the connections) and ever more unstable, so that a list needs a bound. finest: rad,
    of the scan. tolerance: scaled.
    """

    first_angles: int = 360
    jump: float = 0.3
    finest: float = 1e-5
    most_angles: int = 5_000
    longest: float = 1.0
    newton_iterations: int = 12
    tolerance: float = 1e-12


@dataclass(frozen=True)
class RotatingRecord:
    """What is published of a symmetric orbit that turns one arm once a period.

    arm: which turns, 1 the innermost; winding (n,): whole turns of each angle over a period. state (N,): on the mirror
    line, the turning arm hanging; period in s. floquet_multipliers (2,): of the section's map, larger modulus first;
    trace: their sum. kind: "hyperbolic", "inverse hyperbolic" or "elliptic" ("parabolic" at |trace| = 2 to rounding).
    residual: largest component of x(T) - x(0) - 2π winding. status: a sentence.
    """

    arm: int
    winding: tuple[int, ...]
    energy: float
    period: float
    state: Array
    floquet_multipliers: NDArray[np.complex128]
    trace: float
    kind: str
    residual: float
    status: str

    def document(self) -> dict[str, Any]:
        """Return the record with the keys that `dpcontrol orbit --rotating --json` prints."""
        return fields_of(RotatingRecord, self)


@dataclass(frozen=True)
class RotatingOrbit(RotatingRecord):
    """A symmetric orbit that turns one arm once a period; newton_residual: of the shooting equations, scaled."""

    system: System
    newton_residual: float
    converged: bool


@dataclass(frozen=True)
class HalfTurn(SymmetricShooting):
    """Symmetric shooting from one mirror to the one `turn` (N,) on; everything else is the same."""

    turn: Array

    def arc(self, unknowns: Array) -> tuple[Array, Array]:
        """Return how far the half turn's end is off its mirror (n,) and the derivative (n, n + 1) by (c, τ).

        Raises:
            ArithmeticError: the arc became infinite.
        """
        miss, jacobian = super().arc(unknowns)
        return miss - self.target @ self.turn, jacobian


def rotating_orbits(
    system: System, arm: int, energy: float, *, sense: int = 1, settings: RotatingSettings | None = None
) -> tuple[RotatingOrbit, ...]:
    """Find all symmetric simple orbits at `energy` (J) that turn `arm` (1 or 2), slowest first.

    sense: +1 counter-clockwise, -1 its reflection. The other arm's mirror position, hanging or upright, is not
    prescribed. Empty where there is none that the scan resolves.

    Raises:
        InputError: no double pendulum, no such arm or sense, or an energy that is not finite.
    """
    settings = settings or RotatingSettings()
    _check(system, arm, energy, sense)
    found: list[RotatingOrbit] = []
    for position in (0.0, np.pi):
        problem = half_turn(system, arm, sense, position)
        for guess in _guesses(problem, arm, sense, energy, settings):
            unknowns, residual = problem.at_energy(
                guess, energy, iterations=settings.newton_iterations, tolerance=settings.tolerance
            )
            # Newton may end on an orbit of another winding or energy: only what stays near its guess is the guess's.
            apart = np.abs(unknowns - guess) / np.append(system.scale[2:], guess[-1])
            if residual > settings.tolerance or apart.max() > 0.2:
                continue
            orbit = described(problem, unknowns, arm, energy, residual)
            if not any(np.abs(orbit.state - other.state).max() < 1e-7 for other in found):
                found.append(orbit)
    return tuple(sorted(found, key=lambda o: -o.period))


def half_turn(system: System, arm: int, sense: int, position: float) -> HalfTurn:
    """Return the shooting problem of orbits turning `arm`, the other at `position` (0 or π) on the mirror line."""
    n = system.dimension // 2
    start, target = fixed_and_moved(system.reversers[-1])
    centre, turn = np.zeros(2 * n), np.zeros(2 * n)
    centre[:n] = [0.0 if k == arm - 1 else position for k in range(n)]
    turn[arm - 1] = sense * np.pi
    return HalfTurn(system, centre, start, target, 2, turn)


def described(problem: HalfTurn, unknowns: Array, arm: int, energy: float, newton_residual: float) -> RotatingOrbit:
    """Return the orbit of solved unknowns (ω, τ), with its multipliers."""
    system, state, period = problem.system, problem.state(unknowns), problem.period(unknowns)
    trace, end = section_trace(problem, unknowns)
    residual = float(np.abs(end - state - 2 * problem.turn).max())
    # The section's map keeps area: its multipliers are the roots of λ² - trace λ + 1.
    if abs(trace) > 2:
        large = (trace + np.sign(trace) * np.sqrt(trace * trace - 4)) / 2
        multipliers = np.array([large, 1 / large], dtype=complex)
    else:
        multipliers = np.array([complex(trace, s * np.sqrt(4 - trace * trace)) / 2 for s in (1, -1)])
    return RotatingOrbit(
        system=system,
        arm=arm,
        winding=tuple(int(k) for k in np.rint(problem.turn[: system.dimension // 2] / np.pi)),
        energy=energy,
        state=state,
        period=period,
        floquet_multipliers=multipliers,
        trace=trace,
        kind=kind_of(trace),
        residual=residual,
        newton_residual=newton_residual,
        converged=True,
        status=f"converged to a residual of {newton_residual:.1e}; closes to {residual:.1e}",
    )


def section_trace(problem: HalfTurn, unknowns: Array) -> tuple[float, Array]:
    """Return the trace of the section's map and the state (N,) after one period.

    The monodromy matrix adds to it the two multipliers at one of the flow and of the energy.
    """
    end, monodromy = problem.system.propagator.flow_with_stm(problem.state(unknowns), problem.period(unknowns))
    return float(np.trace(monodromy)) - 2.0, end


def kind_of(trace: float) -> str:
    """Return what an area-keeping map with this trace does near its fixed point."""
    if abs(abs(trace) - 2) < 1e-9:
        return "parabolic"
    if trace > 2:
        return "hyperbolic"
    return "inverse hyperbolic" if trace < -2 else "elliptic"


def can_rotate(system: System) -> bool:
    """Tell whether a system has two arms and both reversers, as the search for rotating orbits needs."""
    return {"outer-down", "inner-down", "aligned"} <= set(system.named_sections) and len(system.reversers) > 1


def _check(system: System, arm: int, energy: float, sense: int) -> None:
    if not can_rotate(system):
        raise InputError(f"{system.name} has no two arms: rotating orbits are those of a double pendulum")
    if arm not in (1, 2):
        raise InputError(f"arm = {arm}: must be 1 (inner) or 2 (outer)")
    if sense not in (1, -1):
        raise InputError(f"sense = {sense}: must be +1 (counter-clockwise) or -1")
    if not np.isfinite(energy):
        raise InputError(f"energy = {energy}: must be a finite number of joules")


@dataclass(frozen=True)
class _Arrival:
    """How far the other arm is off on arrival from ellipse angle ψ (None: it does not arrive), and s of flight."""

    angle: float
    miss: float | None
    time: float


def _guesses(problem: HalfTurn, arm: int, sense: int, energy: float, settings: RotatingSettings) -> list[Array]:
    """Return guesses (ω, τ) from the scan of the mirror line at `energy`."""
    system = problem.system
    kinetic = energy - float(system.numeric.hamiltonian(problem.centre))
    if kinetic <= 0:
        return []
    # ½ ωᵀ M ω = kinetic: the rates are the columns of this matrix times (cos ψ, sin ψ).
    axes = np.sqrt(2 * kinetic) * np.linalg.inv(np.linalg.cholesky(system.numeric.mass_matrix(problem.centre))).T
    turning, other = arm - 1, 2 - arm
    unit = np.eye(4)
    section = Section(
        f"angle_{arm} = pi + 2 pi k",
        tuple(unit[turning]),
        tuple(unit[other]),
        tuple(unit[other][:2]),
        offset=np.pi,
        period=2 * np.pi,
    )
    lowest = min(system.equilibria.values(), key=lambda x: float(system.numeric.hamiltonian(x)))
    slowest = np.abs(np.linalg.eigvals(system.numeric.jacobian(lowest)).imag).min()
    longest = settings.longest * 2 * np.pi / float(slowest)

    def rates(angle: float) -> Array:
        return axes @ np.array([np.cos(angle), np.sin(angle)])

    def arrive(angles: Array) -> list[_Arrival]:
        arrivals = []
        states = np.array([problem.centre + problem.start @ (problem.start[2:].T @ rates(angle)) for angle in angles])
        for angle, crossing in zip(angles, system.propagator.crossings(states, section, longest=longest), strict=True):
            if crossing is None or sense * crossing.state[turning] < 0:
                arrivals.append(_Arrival(float(angle), None, np.inf))
            else:
                miss = float(crossing.state[other] - problem.centre[other])
                arrivals.append(_Arrival(float(angle), miss, crossing.time))
        return arrivals

    # The scan starts where no symmetry of the ellipse can put an orbit on a grid point.
    grid = 0.1234 + np.linspace(0, 2 * np.pi, settings.first_angles + 1)
    arrivals = _refined(arrive(grid), arrive, settings)
    guesses = []
    for a, b in pairwise(arrivals):
        if a.miss is None or b.miss is None or abs(a.miss - b.miss) > settings.jump or a.miss * b.miss > 0:
            continue
        share = a.miss / (a.miss - b.miss)
        angle = a.angle + share * (b.angle - a.angle)
        guesses.append(np.append(problem.start[2:].T @ rates(angle), a.time + share * (b.time - a.time)))
    for a, b, c in zip(arrivals, arrivals[1:], arrivals[2:], strict=False):
        # A pair of orbits that has just been born may lie between neighbours without a change of sign.
        if a.miss is None or b.miss is None or c.miss is None:
            continue
        if abs(b.miss) < min(abs(a.miss), abs(c.miss), settings.jump) and a.miss * c.miss > 0:
            guesses.append(np.append(problem.start[2:].T @ rates(b.angle), b.time))
    return guesses


def _refined(
    arrivals: list[_Arrival], arrive: Callable[[Array], list[_Arrival]], settings: RotatingSettings
) -> list[_Arrival]:
    """Halve the scan's steps where neighbours arrive far apart, or only one does, down to the finest step."""

    def smooth(a: _Arrival, b: _Arrival) -> bool:
        if a.miss is None or b.miss is None:
            return a.miss is b.miss
        return abs(a.miss - b.miss) <= settings.jump

    while len(arrivals) < settings.most_angles:
        fine = [smooth(a, b) or b.angle - a.angle < settings.finest for a, b in pairwise(arrivals)]
        if all(fine):
            break
        middles = iter(
            arrive(np.array([(a.angle + b.angle) / 2 for (a, b), done in zip(pairwise(arrivals), fine, strict=True)
                             if not done]))
        )  # fmt: skip
        merged = arrivals[:1]
        for b, done in zip(arrivals[1:], fine, strict=True):
            merged += [b] if done else [next(middles), b]
        arrivals = merged
    return arrivals


_STUCK = "could not be followed beyond"
_TRACE = "trace"
_CRITICAL = {"multiplier +1": 2.0, "multiplier -1": -2.0}
"""Traces at which a multiplier crosses ±1."""


@dataclass(frozen=True)
class RotatingFamilySettings(FollowingSettings):
    """How a family of rotating orbits is followed. longest: period in s, largest: trace."""

    longest: float = 5.0
    largest: float = 1e8


@dataclass(frozen=True)
class StabilityChange:
    """An orbit at which the trace passes +2 or -2; before and after: kinds along the family's curve."""

    orbit: RotatingOrbit
    critical_trace: float
    before: str
    after: str


@dataclass(frozen=True)
class RotatingFamily(Family[RotatingOrbit]):
    """Members along the family's curve, from one end to the other; folds: where its energy turns back.

    ends: why it was left on either side, sentences. converged: neither end is where Newton's method failed.
    """

    changes: tuple[StabilityChange, ...]
    folds: tuple[RotatingOrbit, ...]
    ends: tuple[str, str]

    @property
    def traces(self) -> Array:
        """Traces (K,) of the section's map."""
        return self.column("trace")

    def document(self) -> dict[str, Any]:
        """Return its part of what `dpcontrol orbit --rotating --energies --json` prints."""
        return {
            "members": [member.document() for member in self.members],
            "changes": [{**picked(c, "critical_trace", "before", "after"), **c.orbit.document()} for c in self.changes],
            "folds": [fold.document() for fold in self.folds],
            **picked(self, "ends", "status"),
        }


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

    def measure(unknowns: Array) -> dict[str, float]:
        trace = section_trace(problem, unknowns)[0]
        return {_TRACE: trace, **{test: trace - critical for test, critical in _CRITICAL.items()}}

    curve = FamilyCurve(
        problem,
        weights=np.append(orbit.system.scale[2:], orbit.period / 2),
        measure=measure,
        iterations=settings.newton_iterations,
        tolerance=settings.tolerance,
        accept=settings.tolerance,
    )

    def described_point(point: FamilyPoint) -> RotatingOrbit:
        return described(problem, point.unknowns, orbit.arm, point.energy, point.residual)

    unknowns = np.append(problem.start.T @ (orbit.state - problem.centre), orbit.period / 2)
    first = curve.point(unknowns, None, orbit.newton_residual)
    up, down = (_followed(curve, start, energies, settings, progress) for start in (first, first.reversed()))
    points = [*reversed(down.points), first, *up.points]
    members = tuple(described_point(p) for p in points)
    changes = [_change(event, described_point(event.place), downward=True)
               for event in reversed(down.events) if event.test != SLOPE]  # fmt: skip
    changes += [_change(event, described_point(event.place)) for event in up.events if event.test != SLOPE]
    folds = tuple(described_point(e.place) for e in (*reversed(down.events), *up.events) if e.test == SLOPE)
    lower, upper = (_homoclinics(problem, run.here) if run.last is None else run.last.reason for run in (down, up))
    failed = [end for end in (lower, upper) if end.startswith(_STUCK)]
    status = f"{len(members)} orbits from {members[0].energy:.9g} to {members[-1].energy:.9g} J, "
    status += f"{len(changes)} changes of stability, {len(folds)} folds in energy"
    if failed:
        status += "; " + "; ".join(failed)
    return RotatingFamily(tuple(changes), folds, (lower, upper), members=members, converged=not failed, status=status)


def rotating_families(
    orbits: Sequence[RotatingOrbit],
    energies: tuple[float, float],
    *,
    progress: Progress = no_progress,
) -> tuple[RotatingFamily, ...]:
    """Follow the families of several orbits of one energy, each family once: where it folds it holds several.

    Raises:
        InputError: the bounds do not enclose the orbits' energy.
    """
    families: list[RotatingFamily] = []
    for k, orbit in enumerate(orbits):
        if not any(_passes(family, orbit) for family in families):
            share = part_of(progress, k / len(orbits), (k + 1) / len(orbits))
            families.append(rotating_family(orbit, energies, progress=share))
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


def _followed(
    curve: FamilyCurve,
    start: FamilyPoint,
    energies: tuple[float, float],
    settings: RotatingFamilySettings,
    progress: Progress,
) -> Followed:
    def too_long(here: FamilyPoint, following: FamilyPoint) -> bool:
        # A step across all of the elliptic range would confuse its two ends.
        first, second = here.measures[_TRACE], following.measures[_TRACE]
        return abs(first) > 2 and abs(second) > 2 and first * second < 0

    def stop(here: FamilyPoint) -> str:
        period = curve.problem.period(here.unknowns)
        if period > settings.longest:
            return f"left at {here.energy:.9g} J: the period has grown to {period:.3g} s"
        if abs(here.measures[_TRACE]) > settings.largest:
            return f"left at {here.energy:.9g} J: multipliers above {settings.largest:g} are rounding in double"
        return ""

    tests = (*_CRITICAL, SLOPE)
    return follow(
        curve, start, energies, tests=tests, settings=settings, stop=stop, too_long=too_long, progress=progress
    )


def _change(event: CurveEvent, orbit: RotatingOrbit, *, downward: bool = False) -> StabilityChange:
    """Return the change of stability at an event; downward: the curve was followed against its direction."""
    critical = _CRITICAL[event.test]
    before, after = (kind_of(float(critical + np.sign(side))) for side in (event.before, event.after))
    return StabilityChange(orbit, critical, *((after, before) if downward else (before, after)))


def _homoclinics(problem: SymmetricShooting, place: FamilyPoint) -> str:
    """Say that the family ends at an equilibrium by which its last orbit lingers, or that no step converges."""
    system = problem.system
    name, near = nearest_equilibrium(problem, place)
    height = float(system.numeric.hamiltonian(system.equilibria[name]))
    if near > LINGERS or abs(height - place.energy) > 1e-3 * system.energy_scale:
        return f"{_STUCK} {place.energy:.9g} J: no step converges"
    return (
        f"ends in the homoclinics of {name}: at {place.energy:.9g} J the period has grown to "
        f"{problem.period(place.unknowns):.3g} s and the orbit passes {name} ({height:.9g} J) "
        f"at a scaled distance of {near:.1g}"
    )
