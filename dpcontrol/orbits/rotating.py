"""Rotating orbits, on which one arm turns, x(T) = x(0) + 2πe_arm.

The product R of time reversal and reflection maps (θ, ω)(t) to (-θ, ω)(-t). About a resting position θ* (multiples
of π), its fixed set is {θ = θ*, ω free}. An orbit that starts there and meets the fixed set after half a turn,

    θ(τ) = θ* + π e_arm,      H(θ*, ω) = energy,

is symmetric with T = 2τ. The rates of given energy at θ* form an ellipse ω(ψ). The search scans it over ψ and refines
the scan at jumps of the other arm's final angle. Each sign change of this angle gives an initial guess for Newton's
method on (ω, τ). On "simple" orbits, θ(τ) is the first arrival of the rotating arm after half a turn.

Families are followed in energy (module family), with the trace of the Poincaré map as a test. At +2 the family branches
or folds, and at -2 its period doubles.

Sources: Kaheman et al. (2023), section 3. Lamb & Roberts, Time-reversal symmetry in dynamical systems (1998). Meyer &
Offin, Introduction to Hamiltonian Dynamical Systems and the N-Body Problem, 3rd ed., chapter 11.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import FamilyEndCause, OrbitCause
from dpcontrol.foundation.checked import number
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.foundation.shown import Brief, checked_times
from dpcontrol.orbits.continuation import SLOPE, TO_ROUNDING, Curve, CurvePoint, Newton, member
from dpcontrol.orbits.family import (
    CRITICAL,
    SIZE,
    CurveEvent,
    Family,
    FollowingSettings,
    family_end,
    follow,
)
from dpcontrol.orbits.lyapunov import SymmetricShooting, fixed_and_moved
from dpcontrol.orbits.orbit import OrbitOutcome, Periodic
from dpcontrol.words.searches import Concluded, rotating_family_sentence


@dataclass(frozen=True)
class RotatingSettings:
    """Settings of the search for rotating orbits.

    The bound `longest` is necessary because infinitely many slower orbits shadow the connections, with increasing
    instability.

    Attributes:
        first_angles: number of steps of the scan over the angle ψ of the first rates (`_guesses`), before refinement.
        jump: jumps of the other arm's final angle above this are refined, rad.
        finest: smallest step of ψ, rad.
        most_angles: number of trajectories at which refinement stops.
        longest: largest duration of half a turn, in periods of the slowest small oscillation.
    """

    first_angles: int = 360
    jump: float = 0.3
    finest: float = 1e-5
    most_angles: int = 5_000
    longest: float = 1.0
    newton: Newton = TO_ROUNDING


@dataclass(frozen=True)
class RotatingRecord(Brief, Documented):
    """Properties of a symmetric orbit with one turn per period.

    The kind is "hyperbolic", "inverse hyperbolic", "elliptic", or "parabolic" if |trace| = 2 to rounding.

    Attributes:
        arm: rotating arm, 1 for the inner one.
        winding (n,): whole turns per period.
        energy: energy, J.
        period: s.
        state (N,): initial state, the arm hanging.
        floquet_multipliers (2,): larger modulus first.
        trace: sum of the multipliers.
        kind: stability: "elliptic", "hyperbolic", "inverse hyperbolic" or "parabolic".
        residual: largest residual of the shooting equations, scaled.

    The residual is the largest component of x(T) - x(0) - 2π winding.
    """

    KEYS: ClassVar[str] = "arm winding energy period state floquet_multipliers trace kind residual status"

    arm: int
    winding: tuple[int, ...]
    energy: float
    period: float
    state: Array
    floquet_multipliers: NDArray[np.complex128]
    trace: float
    kind: str
    residual: float

    @property
    def hyperbolic(self) -> bool:
        """True if the multipliers are off the unit circle."""
        return self.kind in ("hyperbolic", "inverse hyperbolic")


@dataclass(frozen=True)
class RotatingOrbit(RotatingRecord, Periodic, Concluded):
    """A symmetric rotating orbit with the residual of its shooting equations.

    Attributes:
        system: system of the orbit.
        outcome: cause and figures of the search.
    """

    converged: ClassVar[bool] = True

    system: System
    outcome: OrbitOutcome

    @property
    def cause(self) -> OrbitCause:
        """How the search for the orbit ended: every orbit that it returns has converged."""
        return self.outcome.cause

    def __repr__(self) -> str:
        return f"<{self.name} at {self.energy:g}: {self.kind}, {self.status}>"

    @property
    def name(self) -> str:
        """Name of the arm that rotates."""
        return f"{('inner', 'outer')[self.arm - 1]}-rotating"

    def states(self, times: Any = None) -> Array:
        """Return the states at given times.

        Args:
            times: times (K,) from the orbit's start, s; by default 200 over one period.

        Returns:
            States (K, N), with whole turns counted.

        Raises:
            InputError: the times are not finite numbers.
        """
        if times is None:
            return self.sample()
        laps, times_in_period = np.divmod(checked_times(times), self.period)
        distinct, indices = np.unique(times_in_period, return_inverse=True)
        turn = np.concatenate([self.winding, np.zeros(len(self.winding))]) * self.system.turn_lengths
        return self.system.propagator.sample(self.state, distinct)[indices] + laps[..., None] * turn


@dataclass(frozen=True)
class HalfTurn(SymmetricShooting):
    """Symmetric shooting between fixed sets that differ by `turn` (N,): half a turn of one arm, ±π rad."""

    turn: Array

    def arc(self, unknowns: Array) -> tuple[Array, Array]:
        """Return the residual (n,) of the arc's end on the fixed set after half a turn, and its Jacobian (n, n + 1).

        Args:
            unknowns: (c, τ) (n + 1,), τ in s.

        Raises:
            ArithmeticError: the arc diverged.
        """
        residual, jacobian = super().arc(unknowns)
        return residual - self.target @ self.turn, jacobian


def rotating_orbits(
    system: System, arm: int, energy: float, *, sense: int = 1, settings: RotatingSettings | None = None
) -> tuple[RotatingOrbit, ...]:
    """Find the symmetric simple rotating orbits at `energy`, slowest first.

    The initial position of the other arm may be hanging or upright.

    Args:
        system: system of two arms.
        arm: rotating arm, 1 or 2.
        energy: J.
        sense: +1 counter-clockwise, -1 clockwise.
        settings: scan and tolerances.

    Raises:
        InputError: the system is not a double pendulum, or an argument is invalid.
    """
    settings = settings or RotatingSettings()
    if not can_rotate(system):
        raise InputError(f"{system.name} is not a double pendulum: rotating orbits need two arms")
    energy = number("energy", energy)
    orbits: list[RotatingOrbit] = []
    for position in (0.0, np.pi):
        problem = half_turn(system, arm, sense, position)
        for guess in _guesses(problem, arm, sense, energy, settings):
            solution = member(problem, guess, energy, settings.newton)
            # Newton's method may converge to an orbit of another winding, so results must be near their guess.
            changes = np.abs(solution.unknowns - guess) / np.append(system.scale[2:], guess[-1])
            if solution.residual > settings.newton.tolerance or changes.max() > 0.2:
                continue
            orbit = described(problem, solution.unknowns, arm, energy, solution.residual)
            if not any(np.abs(orbit.state - earlier.state).max() < 1e-7 for earlier in orbits):
                orbits.append(orbit)
    return tuple(sorted(orbits, key=lambda rotating_orbit: -rotating_orbit.period))


def half_turn(system: System, arm: int, sense: int, position: float) -> HalfTurn:
    """Return the shooting problem of symmetric orbits on which an arm rotates.

    Args:
        system: system of two arms.
        arm: number of the arm, from 1.
        sense: +1 or -1.
        position: first angle of the other arm, 0 or π rad.
    """
    n = system.dimension // 2
    start, target = fixed_and_moved(system.reversers[-1])
    centre, turn = np.zeros(2 * n), np.zeros(2 * n)
    centre[:n] = [0.0 if k == arm - 1 else position for k in range(n)]
    turn[arm - 1] = sense * np.pi
    return HalfTurn(system, centre, start, target, 2, turn)


def described(problem: HalfTurn, unknowns: Array, arm: int, energy: float, newton_residual: float) -> RotatingOrbit:
    """Return the rotating orbit for solved unknowns (ω, τ), with its multipliers and type.

    Args:
        problem: shooting problem of the orbit.
        unknowns: solution (ω, τ) (n + 1,): first rates ω on the fixed set, rad/s, and duration τ of half a turn, s.
        arm: number of the arm, from 1.
        energy: energy of the orbit, J.
        newton_residual: scaled residual of the solution.
    """
    system, state, period = problem.system, problem.state(unknowns), problem.period(unknowns)
    trace, end = section_trace(problem, unknowns)
    residual = float(np.abs(end - state - 2 * problem.turn).max())
    # The Poincaré map preserves area, so its multipliers are the roots of λ² - trace λ + 1.
    if abs(trace) > 2:
        large = (trace + np.sign(trace) * np.sqrt(trace * trace - 4)) / 2
        multipliers = np.array([large, 1 / large], dtype=complex)
    else:
        multipliers = np.array([complex(trace, sign * np.sqrt(4 - trace * trace)) / 2 for sign in (1, -1)])
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
        outcome=OrbitOutcome(OrbitCause.ROTATING, newton_residual),
    )


def section_trace(problem: HalfTurn, unknowns: Array) -> tuple[float, Array]:
    """Return the trace of the Poincaré map, which determines stability, and the final state (N,).

    It is the trace of the monodromy matrix without the two multipliers at one, of the flow and the energy.

    Args:
        problem: shooting problem of the orbit.
        unknowns: solution (ω, τ) (n + 1,): first rates ω on the fixed set, rad/s, and duration τ of half a turn, s.
    """
    end, monodromy = problem.system.propagator.flow_with_stm(problem.state(unknowns), problem.period(unknowns))
    return float(np.trace(monodromy)) - 2.0, end


def kind_of(trace: float) -> str:
    """Return the stability type of an area-preserving map's fixed point.

    Args:
        trace: trace of the map's derivative.
    """
    if abs(abs(trace) - 2) < 1e-9:
        return "parabolic"
    if trace > 2:
        return "hyperbolic"
    return "inverse hyperbolic" if trace < -2 else "elliptic"


def can_rotate(system: System) -> bool:
    """Return True if a system has two arms and both reversers."""
    return {"outer-down", "inner-down", "aligned"} <= set(system.named_sections) and len(system.reversers) > 1


@dataclass(frozen=True)
class _Arrival(Brief):
    """The end of one trajectory of the scan, after half a turn of the rotating arm.

    `angle` is the angle ψ of its first rates, rad (`_guesses`). `miss` is the final angle of the other arm less its
    first one, rad, zero for a rotating orbit; None for a trajectory that does not make the half turn. `time` is its
    duration, s, infinite without one.
    """

    angle: float
    miss: float | None
    time: float


def _guesses(problem: HalfTurn, arm: int, sense: int, energy: float, settings: RotatingSettings) -> list[Array]:
    """Return guesses of rotating orbits, from a scan of the first rates of given energy.

    A guess (ω, τ) (n + 1,) consists of the first rates ω, rad/s, and the duration τ of half a turn, s.

    The first rates of given kinetic energy form an ellipse, with the angle ψ as parameter. A guess lies at each sign
    change of the other arm's deviation after half a turn, and at each small minimum of its size. `arm`, `sense`: number
    of the rotating arm, from 1, and direction ±1. `energy`: J. `settings`: limits of the scan.
    """
    system = problem.system
    kinetic = energy - float(system.numeric.hamiltonian(problem.centre))
    if kinetic <= 0:
        return []
    # ½ ωᵀ M ω = kinetic: the rates are the columns of this matrix times (cos ψ, sin ψ).
    axes = np.sqrt(2 * kinetic) * np.linalg.inv(np.linalg.cholesky(system.numeric.mass_matrix(problem.centre))).T
    turning_arm, other_arm = arm - 1, 2 - arm
    unit_vectors = np.eye(4)
    section = Section(
        f"θ{'₁₂'[turning_arm]} = π + 2πk",
        tuple(unit_vectors[turning_arm]),
        tuple(unit_vectors[other_arm]),
        tuple(unit_vectors[other_arm][:2]),
        offset=np.pi,
        period=2 * np.pi,
    )
    lowest = min(system.equilibria.values(), key=lambda x: float(system.numeric.hamiltonian(x)))
    slowest = np.abs(np.linalg.eigvals(system.numeric.jacobian(lowest)).imag).min()
    longest = settings.longest * 2 * np.pi / float(slowest)

    def rates(angle: float) -> Array:
        """Return the rates (2,) at an angle ψ of the ellipse, rad/s."""
        return axes @ np.array([np.cos(angle), np.sin(angle)])

    def arrive(angles: Array) -> list[_Arrival]:
        """Return the arrivals of the trajectories from angles (K,) of the ellipse."""
        arrivals = []
        states = np.array([problem.centre + problem.start @ (problem.start[2:].T @ rates(angle)) for angle in angles])
        ends, times = system.propagator.crossings(states, section, longest=longest)
        for angle, end, time in zip(angles, ends, times.tolist(), strict=True):
            if np.isinf(time) or sense * end[turning_arm] < 0:
                arrivals.append(_Arrival(float(angle), None, np.inf))
            else:
                arrivals.append(_Arrival(float(angle), float(end[other_arm] - problem.centre[other_arm]), time))
        return arrivals

    # The offset prevents orbits on grid points, due to the symmetry of the ellipse.
    grid = 0.1234 + np.linspace(0, 2 * np.pi, settings.first_angles + 1)
    arrivals = _refined(arrive(grid), arrive, settings)
    guesses = []
    for first, second in pairwise(arrivals):
        if (
            first.miss is None
            or second.miss is None
            or abs(first.miss - second.miss) > settings.jump
            or first.miss * second.miss > 0
        ):
            continue
        share = first.miss / (first.miss - second.miss)
        angle = first.angle + share * (second.angle - first.angle)
        guesses.append(np.append(problem.start[2:].T @ rates(angle), first.time + share * (second.time - first.time)))
    for first, second, third in zip(arrivals, arrivals[1:], arrivals[2:], strict=False):
        # A pair of orbits near its bifurcation may lie between neighbours without a change of sign.
        if first.miss is None or second.miss is None or third.miss is None:
            continue
        if abs(second.miss) < min(abs(first.miss), abs(third.miss), settings.jump) and first.miss * third.miss > 0:
            guesses.append(np.append(problem.start[2:].T @ rates(second.angle), second.time))
    return guesses


def _refined(
    arrivals: list[_Arrival], arrive: Callable[[Array], list[_Arrival]], settings: RotatingSettings
) -> list[_Arrival]:
    """Return the arrivals of the scan with further ones between neighbours whose arrivals jump.

    `arrivals`: in the order of their angles ψ. `arrive`: function that returns the arrivals of angles (K,).
    """

    def smooth(a: _Arrival, b: _Arrival) -> bool:
        """Return True if the arrival does not jump between two angles of the scan."""
        if a.miss is None or b.miss is None:
            return a.miss is b.miss
        return abs(a.miss - b.miss) <= settings.jump

    while len(arrivals) < settings.most_angles:
        steps = [smooth(a, b) or b.angle - a.angle < settings.finest for a, b in pairwise(arrivals)]
        if all(steps):
            break
        middles = iter(
            arrive(np.array([(a.angle + b.angle) / 2 for (a, b), resolved in zip(pairwise(arrivals), steps, strict=True)
                             if not resolved]))
        )  # fmt: skip
        merged = arrivals[:1]
        for b, resolved in zip(arrivals[1:], steps, strict=True):
            merged += [b] if resolved else [next(middles), b]
        arrivals = merged
    return arrivals


ROTATING_LIMITS = FollowingSettings(largest_multiplier=1e8, longest=5.0)


@dataclass(frozen=True)
class StabilityChange:
    """An orbit at which the trace crosses ±2 (`critical_trace`), with the kinds of the orbits before and after it."""

    orbit: RotatingOrbit
    critical_trace: float
    before: str
    after: str


@dataclass(frozen=True)
class RotatingFamily(Family[RotatingOrbit], Documented):
    """Rotating orbits along a family's curve, from one end to the other.

    Attributes:
        changes: changes of stability along the family.
        folds: folds in energy.
    """

    KEYS: ClassVar[str] = (
        "members changes:critical_trace,before,after,**orbit folds ends:energy,cause,reason=status status"
    )

    changes: tuple[StabilityChange, ...]
    folds: tuple[RotatingOrbit, ...]

    @property
    def converged(self) -> bool:
        """True if Newton's method failed at neither end."""
        return all(end.cause is not FamilyEndCause.STUCK for end in self.ends)

    @property
    def status(self) -> str:
        """Range and changes of the family in words."""
        return rotating_family_sentence(self)


def rotating_family(
    orbit: RotatingOrbit,
    energies: tuple[float, float],
    *,
    settings: FollowingSettings = ROTATING_LIMITS,
    progress: Progress = no_progress,
) -> RotatingFamily:
    """Follow the family of a rotating orbit in both directions.

    Args:
        orbit: orbit to start from.
        energies: (lowest, highest), J.
        settings: steps and limits.
        progress: called with a label and the completed share.

    Raises:
        InputError: the bounds do not enclose the orbit's energy.
    """
    low, high = energies
    if not low < orbit.energy < high:
        raise InputError(f"energies {low:g} to {high:g} J: must enclose the orbit's, {orbit.energy:g} J")
    sense = 1 if sum(orbit.winding) > 0 else -1
    other_angle = orbit.state[2 - orbit.arm]
    problem = half_turn(orbit.system, orbit.arm, sense, float(other_angle))

    def measure(unknowns: Array) -> dict[str, float]:
        """Return the tests of the trace, zero where it is ±2, and its modulus as the size."""
        trace = section_trace(problem, unknowns)[0]
        return {**{test: trace - 2 * multiplier for test, multiplier in CRITICAL.items()}, SIZE: abs(trace)}

    weights = np.append(orbit.system.scale[2:], orbit.period / 2)
    curve = Curve(problem, weights, settings.newton, settings.newton.tolerance, measure)

    def described_point(point: CurvePoint) -> RotatingOrbit:
        """Return the orbit at a point of the curve."""
        return described(problem, point.unknowns, orbit.arm, point.value, point.residual)

    unknowns = np.append(problem.start.T @ (orbit.state - problem.centre), orbit.period / 2)
    first = curve.point(unknowns, None, orbit.outcome.newton_residual)
    up, down = (
        follow(curve, problem, start, energies, settings=settings, progress=progress)
        for start in (first, first.reversed())
    )
    members = tuple(described_point(curve_point) for curve_point in [*reversed(down.points), first, *up.points])
    events = [(event, described_point(event.place), True) for event in reversed(down.events)]
    events += [(event, described_point(event.place), False) for event in up.events]
    changes = tuple(_change(event, place, downward) for event, place, downward in events if event.test != SLOPE)
    folds = tuple(place for event, place, _ in events if event.test == SLOPE)
    lower, upper = (branch.last or family_end([branch.here], problem) for branch in (down, up))
    return RotatingFamily(changes, folds, members=members, ends=(lower, upper))


def rotating_families(
    orbits: Sequence[RotatingOrbit],
    energies: tuple[float, float],
    *,
    progress: Progress = no_progress,
) -> tuple[RotatingFamily, ...]:
    """Follow the families of several orbits, each family once.

    A family with folds may contain several of the orbits.

    Args:
        orbits: rotating orbits of one system.
        energies: lower and upper bound, J.
        progress: called with a label and the completed share.

    Raises:
        InputError: the bounds do not enclose the orbits' energy.
    """
    families: list[RotatingFamily] = []
    for k, orbit in enumerate(orbits):
        if not any(_passes(family, orbit) for family in families):
            share = part_of(progress, k / len(orbits), (k + 1) / len(orbits))
            families.append(rotating_family(orbit, energies, progress=share))
    return tuple(families)


@dataclass(frozen=True)
class RotatingOrbits(Documented):
    """The symmetric orbits of one energy, J, on which an arm turns forward.

    Attributes:
        orbits: orbits, the longest period first.
        arm: arm that turns over, "inner" or "outer".
        energy: energy of the orbits, J.
    """

    KEYS: ClassVar[str] = "rotating_orbits=orbits count=#orbits arm energy status"

    orbits: tuple[RotatingOrbit, ...]
    arm: str
    energy: float

    @property
    def status(self) -> str:
        """Number of the orbits in words."""
        return f"{len(self.orbits)} symmetric orbits that turn the {self.arm} arm forward; each has a reflection"


@dataclass(frozen=True)
class RotatingFamilies(Documented):
    """The families of the orbits of one energy, J, on which an arm turns forward, between two energies.

    Attributes:
        families: families of the orbits.
        arm: arm that turns over, "inner" or "outer".
        energy: energy of the starting orbits, J.
        energies: lowest and highest energy, J.
    """

    KEYS: ClassVar[str] = "families count=#families arm energy energies status"

    families: tuple[RotatingFamily, ...]
    arm: str
    energy: float
    energies: tuple[float, float]

    @property
    def status(self) -> str:
        """Ranges and changes of the families in words."""
        return "; ".join(family.status for family in self.families)

    @property
    def missed(self) -> str:
        """Which families Newton's method lost."""
        lost = [family.status for family in self.families if not family.converged]
        return f"{len(lost)} of {len(self.families)} families of rotating orbits: {'; '.join(lost)}" if lost else ""


def _passes(family: RotatingFamily, orbit: RotatingOrbit) -> bool:
    """Return True if a family's curve passes through an orbit, so that the family need not be followed again."""
    scale = orbit.system.scale
    for first, second in pairwise(family.members):
        if (first.energy - orbit.energy) * (second.energy - orbit.energy) > 0 or first.energy == second.energy:
            continue
        share = (orbit.energy - first.energy) / (second.energy - first.energy)
        state = first.state + share * (second.state - first.state)
        period = first.period + share * (second.period - first.period)
        # Members are a few hundredths apart, and the error of a chord is below a tenth of that.
        tolerance = (
            0.1 * max(float(np.abs((second.state - first.state) / scale).max()), abs(second.period / first.period - 1))
            + 1e-6
        )
        difference = max(float(np.abs((state - orbit.state) / scale).max()), abs(period / orbit.period - 1))
        if difference < tolerance:
            return True
    return False


def _change(event: CurveEvent, orbit: RotatingOrbit, downward: bool) -> StabilityChange:
    """Return the change of stability at an event, with sides in the order of the whole family.

    `orbit`: the orbit at the event. `downward`: True if the curve was followed against this order, which exchanges the
    sides.
    """
    critical = 2 * CRITICAL[event.test]
    before, after = (kind_of(float(critical + np.sign(side))) for side in (event.before, event.after))
    return StabilityChange(orbit, critical, *((after, before) if downward else (before, after)))
