"""Families of periodic orbits, followed along their own curve until they end; and those of Lyapunov orbits.

The shooting equations (module lyapunov) leave a curve in (c, τ). It is followed by pseudo-arclength: the next
point lies on the plane through the predicted point across the tangent, so that the curve may turn back in energy; steps
halve where Newton's method leaves the curve and grow again after. Along a Lyapunov family are watched

    dH/ds = 0                                          the energy folds,
    det(M' - σ) = 0, σ = ±1,                           a multiplier crosses σ (M' on ker ∇H modulo the flow),

each located as a root along the curve, every trial point corrected onto it. At σ = 1 a family branches (or folds), at
σ = -1 its period doubles; either way hyperbolicity, and with it the tube, may be lost.

A family that runs into an equilibrium's homoclinics has a period that grows without bound: with μ the equilibrium's
slowest growth rate and two passages to a period, energy - limit ~ exp(-μ T/2); the limit is extrapolated.

Sources: Doedel et al., Computation of periodic solutions of conservative systems with application to the 3-body problem
(2003); Vanderbauwhede & Fiedler, Homoclinic period blow-up in reversible and conservative systems (1992).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import picked
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.orbits.lyapunov import (
    LinearCentre,
    LyapunovOrbit,
    SymmetricShooting,
    described_orbit,
    symmetric_shooting,
)

SLOPE = "slope"
"""Measure of every point: the energy's derivative along the curve, in energy scales; zero at a fold."""

FIRST_STEP = 0.01
"""Along the curve, scaled: the first step's length at most."""


@dataclass(frozen=True)
class FamilyPoint:
    """One point of the curve: unknowns and tangent, both (n + 1,); energy in J; measures by name."""

    unknowns: Array
    tangent: Array
    energy: float
    residual: float
    measures: Mapping[str, float]

    def reversed(self) -> "FamilyPoint":
        """Return the point as the curve passes it the other way."""
        measures = {**self.measures, SLOPE: -self.measures[SLOPE]}
        return replace(self, tangent=-self.tangent, measures=measures)


@dataclass(frozen=True)
class FamilyCurve:
    """The curve of one shooting problem.

    weights (n + 1,): units of (c, τ). measure: unknowns -> the family's own measures of a point. iterations,
    tolerance: of Newton's method; accept: the largest scaled residual of a point.
    """

    problem: SymmetricShooting
    weights: Array
    measure: Callable[[Array], Mapping[str, float]]
    iterations: int
    tolerance: float
    accept: float

    def point(self, unknowns: Array, heading: Array | None, residual: float) -> FamilyPoint:
        """Describe a point that lies on the curve; the tangent looks along `heading`, or up in energy without one."""
        _, jacobian = self.problem.arc(unknowns)
        tangent = np.linalg.svd(jacobian * self.weights)[2][-1]
        energy, gradient = self.problem.energy(unknowns)
        slope = float((gradient * self.weights) @ tangent) / self.problem.system.energy_scale
        if (slope if heading is None else tangent @ heading) < 0:
            tangent, slope = -tangent, -slope
        return FamilyPoint(unknowns, tangent, energy, residual, {**self.measure(unknowns), SLOPE: slope})

    def step(self, start: FamilyPoint, length: float) -> FamilyPoint | None:
        """Return the curve's point `length` on from `start`, None where Newton's method does not find it."""
        guess = start.unknowns + length * start.tangent * self.weights
        found, residual = self.problem.along(
            guess, start.tangent, self.weights, iterations=self.iterations, tolerance=self.tolerance
        )
        moved = float(np.linalg.norm((found - guess) / self.weights))
        # A correction as long as half the step has left for another curve; so has a tangent that turned by 25 degrees.
        if residual > self.accept or moved > 0.5 * abs(length):
            return None
        try:
            point = self.point(found, start.tangent, residual)
        except (ArithmeticError, np.linalg.LinAlgError):
            return None
        return point if point.tangent @ start.tangent > 0.9 else None

    def followed(
        self,
        start: FamilyPoint,
        *,
        step: float,
        smallest: float,
        too_long: Callable[[FamilyPoint, FamilyPoint], bool] = lambda here, following: False,
    ) -> Iterator[tuple[FamilyPoint, FamilyPoint, float]]:
        """Yield (point, next point, length between) from `start` on; ends where no step of `smallest` converges.

        too_long: whether a step that converged hides what lies within it and is halved, as long as it may be.
        """
        here, length = start, min(step, FIRST_STEP)
        while length >= smallest:
            following = self.step(here, length)
            if following is None or (length > 2 * smallest and too_long(here, following)):
                length /= 2
                continue
            yield here, following, length
            here, length = following, min(step, 1.5 * length)

    def located(self, start: FamilyPoint, length: float, value: Callable[[FamilyPoint], float]) -> FamilyPoint | None:
        """Return the point between `start` and `length` on where `value` vanishes, None if the curve is left."""

        def at(h: float) -> float:
            point = start if h == 0 else self.step(start, h)
            if point is None:
                raise ArithmeticError("left the curve")
            return value(point)

        try:
            return self.step(start, float(brentq(at, 0.0, length, xtol=1e-13)))  # type: ignore[arg-type]
        except (ArithmeticError, ValueError):
            return None


@dataclass(frozen=True)
class FollowingSettings:
    """How a family is followed. step, smallest_step: along the curve, in scaled units of (c, τ)."""

    step: float = 0.05
    smallest_step: float = 1e-6
    most_members: int = 400
    newton_iterations: int = 12
    tolerance: float = 1e-12


@dataclass(frozen=True)
class CurveEvent:
    """A place on a family's curve at which the measure `test` vanishes, and its values before and after."""

    test: str
    place: FamilyPoint
    before: float
    after: float


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


@dataclass
class Followed:
    """What following a family one way has met: points within the bounds, and events.

    here: the last point of all; first: where it came in, if it began outside; last: where and why it was left, None
    where no step converges.
    """

    here: FamilyPoint
    points: list[FamilyPoint] = field(default_factory=list)
    events: list[CurveEvent] = field(default_factory=list)
    first: FamilyEnd | None = None
    last: FamilyEnd | None = None


def follow(
    curve: FamilyCurve,
    start: FamilyPoint,
    energies: tuple[float, float],
    *,
    tests: Sequence[str],
    settings: FollowingSettings,
    stop: Callable[[FamilyPoint], str],
    losing: Sequence[str] = (),
    born: bool = False,
    too_long: Callable[[FamilyPoint, FamilyPoint], bool] = lambda here, following: False,
    progress: Progress = no_progress,
) -> Followed:
    """Follow a family from a point of its curve until it leaves the bounds `energies` in J, or `stop` gives a reason.

    tests: measures whose zeros are located; `losing`: those of them that end it. born: it starts where the family does.
    """
    low, high = energies
    run = Followed(start)

    def within(energy: float) -> bool:
        return low <= energy <= high

    def at(guess: FamilyPoint, energy: float) -> FamilyPoint | None:
        found, residual = curve.problem.at_energy(
            guess.unknowns, energy, iterations=settings.newton_iterations, tolerance=settings.tolerance
        )
        if residual > curve.accept:
            return None
        return replace(curve.point(found, guess.tangent, residual), energy=energy)

    steps = curve.followed(start, step=settings.step, smallest=settings.smallest_step, too_long=too_long)
    for before, following, length in steps:
        run.here = following
        # At the birth dH/ds = 0 too, which is no fold.
        for test in () if born and before is start else tests:
            sides = (before.measures[test], following.measures[test])
            if sides[0] * sides[1] < 0 and (within(before.energy) or within(following.energy)):
                place = curve.located(before, length, lambda point, test=test: point.measures[test])
                if place is not None and within(place.energy):
                    run.events.append(CurveEvent(test, place, *sides))
                    if test in losing and run.last is None:
                        run.points.append(place)
                        run.last = lost(test, place)
        if run.last is not None:
            return run
        way = 1 if following.energy > before.energy else -1
        for bound in energies[::way]:
            if (before.energy - bound) * (following.energy - bound) < 0 or following.energy == bound:
                place = at(following, bound)
                run.points += [] if place is None else [place]
                end = FamilyEnd(bound, "energy bound", f"left at the asked bound of {bound:g} J; the family goes on")
                if bound == energies[::way][1]:
                    run.last = end
                    return run
                run.first = end
        if within(following.energy):
            run.points.append(following)
            progress("family of orbits", min(1.0, abs(following.energy - start.energy) / (high - low)))
        reason = stop(following)
        if not reason and len(run.points) >= settings.most_members:
            reason = f"left after {settings.most_members} members at {following.energy:.9g} J; allow more"
        if reason:
            run.last = FamilyEnd(following.energy, "not followed further", reason)
            return run
    return run


SIZE = "size"
"""Measure of a family's point: the largest multiplier's modulus, at least one."""

LINGERS = 0.05
"""Scaled distance of an equilibrium within which an orbit is said to linger by it."""


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


_TESTS = (SLOPE, "multiplier +1", "multiplier -1")


@dataclass(frozen=True)
class FamilySettings(FollowingSettings):
    """How a family of Lyapunov orbits is followed.

    largest_multiplier: of members; beyond it the multipliers at one are off by more than 1e-2 in double. The curve is
    followed `tail` steps on from there, to find out where it leads.
    """

    largest_multiplier: float = 1e7
    tail: int = 25


Member = TypeVar("Member")


@dataclass(frozen=True, kw_only=True)
class Family(Generic[Member]):
    """Members along a family's curve, K in number; status: how it was followed, in a sentence."""

    members: tuple[Member, ...]
    converged: bool
    status: str

    @property
    def energies(self) -> Array:
        """Energies (K,) in J."""
        return self.column("energy")

    @property
    def periods(self) -> Array:
        """Periods (K,) in s."""
        return self.column("period")

    @property
    def states(self) -> Array:
        """States (K, N) where the members begin."""
        return self.column("state")

    @property
    def floquet_multipliers(self) -> NDArray[np.complex128]:
        """Multipliers (K, …), largest first in each row."""
        return self.column("floquet_multipliers")

    def column(self, name: str) -> NDArray[Any]:
        """Return one of the members' values, (K, …)."""
        return np.array([getattr(member, name) for member in self.members])


@dataclass(frozen=True)
class FamilyEvent:
    """Something on the way: kind "fold", "multiplier +1" or "multiplier -1", located at an orbit of the family."""

    kind: str
    orbit: LyapunovOrbit


@dataclass(frozen=True)
class LyapunovFamily(Family[LyapunovOrbit]):
    """Members of a family, in order along its curve from the saddle on.

    ends: the reason on the saddle's side and on the other. converged: every member closes, and neither end is where
    Newton's method failed.
    """

    system: System
    saddle: str
    family: int
    events: tuple[FamilyEvent, ...]
    ends: tuple[FamilyEnd, FamilyEnd]

    def document(self) -> dict[str, Any]:
        """Return what `dpcontrol orbit --energies --json` prints, the energies that were asked for apart."""
        return {
            "family": [m.document() for m in self.members],
            "ends": [picked(e, "energy", "kind", "reason") for e in self.ends],
            "events": [{"kind": e.kind, **e.orbit.document()} for e in self.events],
            **picked(self, "saddle", "status"),
        }


def lyapunov_family(
    system: System,
    saddle: str,
    *,
    energies: tuple[float, float],
    family: int = 0,
    settings: FamilySettings | None = None,
    progress: Progress = no_progress,
) -> LyapunovFamily:
    """Follow a family of Lyapunov orbits from its saddle through `energies` (lowest, highest) in J.

    The family is left where it passes the far bound, loses hyperbolicity, runs into an equilibrium's homoclinics, or
    cannot be followed.

    Raises:
        InputError: unknown saddle or family, or bounds between which there is no orbit of the family.
    """
    settings = settings or FamilySettings()
    problem, linear = symmetric_shooting(system, saddle, family)
    low, high = energies
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise InputError(f"energies {low:g} to {high:g}: must be two finite numbers, the lower first")
    far = high if linear.sign > 0 else low
    if (far - linear.energy) * linear.sign <= 0:
        raise InputError(
            system.worded(
                f"energies {low:g} to {high:g} J: the Lyapunov orbits about {saddle} exist only "
                f"{'above' if linear.sign > 0 else 'below'} its energy of {linear.energy:.6g} J"
            )
        )
    curve = _curve(problem, linear, settings)

    def orbit(point: FamilyPoint) -> LyapunovOrbit:
        return described_orbit(
            problem,
            point.unknowns,
            saddle=saddle,
            family=family,
            energy=point.energy,
            newton_residual=point.residual,
            converged=True,
            status=f"converged to a residual of {point.residual:.1e}, as a member of its family",
        )

    birth, heading = _birth(linear, curve)
    # At the saddle the curve meets that of the resting arcs (0, τ): only the linear centre tells the tangent.
    here = replace(curve.point(birth, heading, 0.0), tangent=heading)
    largest = settings.largest_multiplier
    run = follow(
        curve, here, energies, tests=_TESTS, losing=_TESTS[1:], settings=settings, born=True, progress=progress,
        stop=lambda point: SIZE if point.measures[SIZE] > largest else "",
    )  # fmt: skip
    at_saddle = f"the orbits shrink to {saddle} itself at its energy of {linear.energy:.9g} J"
    first = run.first or FamilyEnd(linear.energy, "saddle", at_saddle)
    last, points = run.last, run.points
    if last is None:
        last = family_end(system, points or [run.here], problem)
    elif last.reason == SIZE:
        last = family_end(system, [*points, *_tail(curve, run.here, settings)], problem, largest=largest)
        points = [p for p in points if p.measures[SIZE] <= largest]
    if not points:
        raise InputError(
            system.worded(
                f"energies {low:g} to {high:g} J: the family about {saddle} does not reach them; {last.reason}"
            )
        )
    members = tuple(orbit(p) for p in points)
    converged = last.kind != "not followed further"
    first, last = (replace(end, reason=system.worded(end.reason)) for end in (first, last))
    ends = f"{members[0].energy:.9g} to {members[-1].energy:.9g} J"
    status = system.worded(f"{len(members)} orbits from {ends}; {last.reason}")
    events = tuple(FamilyEvent("fold" if e.test == SLOPE else e.test, orbit(e.place)) for e in run.events)
    return LyapunovFamily(
        system, saddle, family, events, (first, last), members=members, converged=converged, status=status
    )


def _curve(problem: SymmetricShooting, linear: LinearCentre, settings: FamilySettings) -> FamilyCurve:
    """Return the family's curve, on which both multipliers' crossings and the largest multiplier are measured."""
    system = problem.system

    def measure(unknowns: Array) -> dict[str, float]:
        state = problem.state(unknowns)
        _, monodromy = system.propagator.flow_with_stm(state, problem.period(unknowns))
        plane, _ = np.linalg.qr(np.column_stack([system.numeric.rate(state), system.numeric.gradient(state)]))
        rest = np.linalg.svd(plane.T)[2][2:].T
        reduced = rest.T @ monodromy @ rest
        size = max(1.0, float(np.abs(np.linalg.eigvals(reduced)).max()))
        one = np.eye(len(reduced))
        return {
            "multiplier +1": float(np.linalg.det(reduced - one)) / size,
            "multiplier -1": float(np.linalg.det(reduced + one)) / size,
            SIZE: size,
        }

    return FamilyCurve(
        problem,
        weights=np.append(np.abs(problem.start.T) @ system.scale, _birth_arc(problem, linear)),
        measure=measure,
        iterations=settings.newton_iterations,
        tolerance=settings.tolerance,
        accept=10 * settings.tolerance,
    )


def _birth_arc(problem: SymmetricShooting, linear: LinearCentre) -> float:
    return 2 * np.pi / linear.frequency / problem.quarters


def _birth(linear: LinearCentre, curve: FamilyCurve) -> tuple[Array, Array]:
    """Return the unknowns (n + 1,) of the resting orbit at the saddle and the tangent (n + 1,) there."""
    tangent = np.append(linear.direction, 0.0) / curve.weights
    return np.append(0.0 * linear.direction, _birth_arc(curve.problem, linear)), tangent / np.linalg.norm(tangent)


def _tail(curve: FamilyCurve, start: FamilyPoint, settings: FamilySettings) -> list[FamilyPoint]:
    """Follow the curve on as far as it goes, at most `tail` steps."""
    points = [start]
    for _ in range(settings.tail):
        following = curve.step(points[-1], settings.step)
        if following is None:
            break
        points.append(following)
    return points[1:]
