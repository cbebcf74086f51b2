"""Families of periodic orbits, by continuation along their curve.

The solutions of the shooting equations (module lyapunov) form a curve in (c, τ). Pseudo-arclength continuation places
the next point on the plane through the predicted point, normal to the tangent, so the curve may fold in energy. The
step is halved if Newton's method leaves the curve, and grows afterwards. Along a Lyapunov family, two tests are
evaluated:

    dH/ds = 0                                          a fold in energy,
    det(M' - σ) = 0, σ = ±1,                           a multiplier crosses σ (M' on ker ∇H modulo the flow).

Each root is located along the curve, with every trial point corrected onto it. At σ = 1 a family branches or folds, and
at σ = -1 its period doubles. In both cases the orbit may lose hyperbolicity and its tubes.

If a family ends in the homoclinics of an equilibrium, its period grows without bound. With the equilibrium's slowest
growth rate μ and two passages per period, energy - limit ~ exp(-μ T/2). The limit is extrapolated.

Sources: Doedel et al., Computation of periodic solutions of conservative systems with application to the 3-body problem
(2003); Vanderbauwhede & Fiedler, Homoclinic period blow-up in reversible and conservative systems (1992).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import FamilyEndCause, OrbitCause
from dpcontrol.foundation.checked import checked
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.rendering import DataFrame
from dpcontrol.foundation.settings import check_choice
from dpcontrol.foundation.shown import Brief, Shown, data_frame
from dpcontrol.orbits.lyapunov import (
    LinearCentre,
    LyapunovOrbit,
    OrbitOutcome,
    SymmetricShooting,
    described_orbit,
    symmetric_shooting,
)
from dpcontrol.words.searches import Concluded, family_sentence

SLOPE = "slope"
"""Measure of every point: the scaled derivative of the energy along the curve, zero at a fold."""

FIRST_STEP = 0.01
"""Largest first step along the curve, scaled."""


@dataclass(frozen=True)
class FamilyPoint(Brief):
    """A solution on a family's curve, with its unit tangent.

    Attributes:
        unknowns (n + 1,): (c, τ).
        tangent (n + 1,): unit tangent.
        energy: J.
        measures: values by name.
    """

    unknowns: Array
    tangent: Array
    energy: float
    residual: float
    measures: Mapping[str, float]

    def reversed(self) -> "FamilyPoint":
        """Return the point with the opposite tangent."""
        measures = {**self.measures, SLOPE: -self.measures[SLOPE]}
        return replace(self, tangent=-self.tangent, measures=measures)


@dataclass(frozen=True)
class FamilyCurve(Brief):
    """The curve of solutions of one shooting problem.

    Attributes:
        weights (n + 1,): units of (c, τ).
        measure: function from unknowns to the family's measures.
        tolerance: of Newton's method.
        accept: largest scaled residual of a point.
    """

    problem: SymmetricShooting
    weights: Array
    measure: Callable[[Array], Mapping[str, float]]
    iterations: int
    tolerance: float
    accept: float

    def point(self, unknowns: Array, heading: Array | None, residual: float) -> FamilyPoint:
        """Return a solution with its tangent, energy and measures.

        Args:
            unknowns: solution (n + 1,).
            heading: row (n + 1,) along which the tangent points; None for towards higher energies.
            residual: scaled residual of the solution.
        """
        _, jacobian = self.problem.arc(unknowns)
        tangent = np.linalg.svd(jacobian * self.weights)[2][-1]
        energy, gradient = self.problem.energy(unknowns)
        slope = float((gradient * self.weights) @ tangent) / self.problem.system.energy_scale
        if (slope if heading is None else tangent @ heading) < 0:
            tangent, slope = -tangent, -slope
        return FamilyPoint(unknowns, tangent, energy, residual, {**self.measure(unknowns), SLOPE: slope})

    def step(self, start: FamilyPoint, length: float) -> FamilyPoint | None:
        """Return the next point, None if Newton's method fails.

        Args:
            start: point of the curve.
            length: distance along the tangent, in units of the weights.
        """
        guess = start.unknowns + length * start.tangent * self.weights
        found = self.problem.along(
            guess, start.tangent, self.weights, iterations=self.iterations, tolerance=self.tolerance
        )
        moved = float(np.linalg.norm((found.unknowns - guess) / self.weights))
        # A correction of over half the step, or a tangent turned by 25 degrees, indicates another curve.
        if found.residual > self.accept or moved > 0.5 * abs(length):
            return None
        try:
            point = self.point(found.unknowns, start.tangent, found.residual)
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
        """Yield (point, next point, length) along the curve.

        It ends when no step of `smallest` converges.

        Args:
            start: first point.
            step: longest step, in units of the weights.
            smallest: shortest step, in units of the weights.
            too_long: function of two successive points. If it returns True, a step that converges is still halved, if
                possible.
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
        """Return the zero of a function on the curve, or None.

        Args:
            start: point of the curve.
            length: range of the search from `start`, in units of the weights.
            value: continuous function of a point.
        """

        from scipy.optimize import brentq

        def at(h: float) -> float:
            point = start if h == 0 else self.step(start, h)
            if point is None:
                raise ArithmeticError("no longer on the curve")
            return value(point)

        try:
            return self.step(start, float(brentq(at, 0.0, length, xtol=1e-13)))  # type: ignore[arg-type]
        except (ArithmeticError, ValueError):
            return None


@dataclass(frozen=True)
class FollowingSettings:
    """Steps and tolerance of continuation, in scaled units of (c, τ)."""

    step: float = 0.05
    smallest_step: float = 1e-6
    most_members: int = 400
    newton_iterations: int = 12
    tolerance: float = 1e-12


@dataclass(frozen=True)
class CurveEvent:
    """A zero of the measure `test` on a family's curve."""

    test: str
    place: FamilyPoint
    before: float
    after: float


@dataclass(frozen=True)
class FamilyEnd(Concluded):
    """First or last orbit of a family, with the cause of the end.

    Attributes:
        energy: J.
        system: system of the family.
        equilibrium: name of the equilibrium that the orbits approach, if any.
        height: its energy, J.
        distance: its scaled distance from the last orbit.
        period: of the last orbit, s.
        multiplier: largest multiplier of the last orbit, or the critical one.
        limit: limit that was reached, or the extrapolated energy, J.
        residual: scaled residual of the last orbit.
    """

    energy: float
    cause: FamilyEndCause
    system: System = field(repr=False)
    equilibrium: str = ""
    height: float = np.nan
    distance: float = np.nan
    period: float = np.nan
    multiplier: float = np.nan
    limit: float = np.nan
    residual: float = np.nan


@dataclass
class Followed:
    """Result of following a family in one direction.

    Attributes:
        points: those within the bounds.
        here: last point.
        first: entry into the bounds, if it started outside.
        last: end of the family, None if no step converges.
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
    stop: Callable[[FamilyPoint], FamilyEnd | None],
    losing: Sequence[str] = (),
    born: bool = False,
    too_long: Callable[[FamilyPoint, FamilyPoint], bool] = lambda here, following: False,
    progress: Progress = no_progress,
) -> Followed:
    """Follow a family from a point until it leaves the energy bounds.

    Args:
        curve: curve of the family.
        start: first point.
        energies: (lowest, highest), J.
        tests: measures whose zeros are located.
        settings: steps and limits.
        stop: function that returns the end of the family at a point, or None.
        losing: tests that end the family.
        born: True if the family starts at this point.
        too_long: see `FamilyCurve.followed`.
        progress: called with a label and the completed share.
    """
    (low, high), system = energies, curve.problem.system
    run = Followed(start)

    def within(energy: float) -> bool:
        return low <= energy <= high

    def at(guess: FamilyPoint, energy: float) -> FamilyPoint | None:
        found = curve.problem.member(
            guess.unknowns, energy, iterations=settings.newton_iterations, tolerance=settings.tolerance
        )
        if found.residual > curve.accept:
            return None
        return replace(curve.point(found.unknowns, guess.tangent, found.residual), energy=energy)

    steps = curve.followed(start, step=settings.step, smallest=settings.smallest_step, too_long=too_long)
    for before, following, length in steps:
        run.here = following
        # dH/ds also vanishes at the start of the family, which is not a fold.
        for test in () if born and before is start else tests:
            sides = (before.measures[test], following.measures[test])
            if sides[0] * sides[1] < 0 and (within(before.energy) or within(following.energy)):
                place = curve.located(before, length, lambda point, test=test: point.measures[test])
                if place is not None and within(place.energy):
                    run.events.append(CurveEvent(test, place, *sides))
                    if test in losing and run.last is None:
                        run.points.append(place)
                        cause = FamilyEndCause.HYPERBOLICITY_LOST
                        run.last = FamilyEnd(place.energy, cause, system, multiplier=CRITICAL[test])
        if run.last is not None:
            return run
        way = 1 if following.energy > before.energy else -1
        for bound in energies[::way]:
            if (before.energy - bound) * (following.energy - bound) < 0 or following.energy == bound:
                place = at(following, bound)
                run.points += [] if place is None else [place]
                end = FamilyEnd(bound, FamilyEndCause.ENERGY_BOUND, system)
                if bound == energies[::way][1]:
                    run.last = end
                    return run
                run.first = end
        if within(following.energy):
            run.points.append(following)
            progress("family of orbits", min(1.0, abs(following.energy - start.energy) / (high - low)))
        run.last = stop(following)
        if run.last is None and len(run.points) >= settings.most_members:
            cause = FamilyEndCause.MANY_MEMBERS
            run.last = FamilyEnd(following.energy, cause, system, limit=settings.most_members)
        if run.last is not None:
            return run
    return run


SIZE = "size"
"""Measure of a family's point: the modulus of the largest multiplier, at least one."""

LINGERS = 0.05
"""Largest scaled distance between an equilibrium and an orbit that approaches it."""


def nearest_equilibrium(problem: SymmetricShooting, place: FamilyPoint) -> tuple[str, float]:
    """Return the equilibrium nearest to an orbit, and its scaled distance.

    Args:
        problem: shooting problem of the orbit.
        place: point of the family.
    """
    system = problem.system
    arc = system.propagator.sample(problem.state(place.unknowns), np.linspace(0, place.unknowns[-1], 400))
    distances = {name: float(np.min(system.scaled_distance(arc, x))) for name, x in system.equilibria.items()}
    return min(distances.items(), key=lambda item: item[1])


def family_end(
    system: System, points: list[FamilyPoint], problem: SymmetricShooting, *, largest: float | None = None
) -> FamilyEnd:
    """Return the end of a family that could not be followed further.

    Args:
        system: system of the family.
        points: the last members.
        problem: shooting problem of the family.
        largest: limit on multipliers that ended the continuation, if any.
    """
    place = points[-1]
    name, distance = nearest_equilibrium(problem, place)
    goal = float(system.numeric.hamiltonian(system.equilibria[name]))
    limit = _extrapolated(points, problem)
    if distance < LINGERS and limit is not None and abs(limit - goal) < 1e-3 * system.energy_scale:
        period, size = problem.period(place.unknowns), place.measures[SIZE]
        return FamilyEnd(
            place.energy, FamilyEndCause.HOMOCLINICS, system, name, goal, distance, period, multiplier=size, limit=limit
        )
    if largest is not None:
        return FamilyEnd(place.energy, FamilyEndCause.LARGE_MULTIPLIER, system, limit=largest)
    return FamilyEnd(place.energy, FamilyEndCause.STUCK, system, residual=place.residual)


def _extrapolated(points: list[FamilyPoint], problem: SymmetricShooting) -> float | None:
    """Extrapolate the energy to infinite period, or return None."""
    if len(points) < 9:
        return None
    # The energy is exponential in the period near homoclinics, so the rule needs equal steps in the period.
    periods = np.array([problem.period(p.unknowns) for p in points[-9:]])
    energies = np.array([p.energy for p in points[-9:]])
    if np.any(np.diff(periods) <= 0):
        return None
    rates = np.diff(energies) / np.diff(periods)
    middles = (periods[1:] + periods[:-1]) / 2
    # ln|dE/dT| is linear in T there, so the remaining energy difference is the last rate over its decay.
    decay = -float(np.polyfit(middles, np.log(np.abs(rates)), 1)[0]) if np.all(rates != 0) else 0.0
    if decay <= 0:
        return None
    last = float(rates[-1] * np.exp(-decay * (periods[-1] - middles[-1])))
    return float(energies[-1] + last / decay)


CRITICAL = {"multiplier +1": 1.0, "multiplier -1": -1.0}
"""Multipliers at which hyperbolicity is lost, by the test of their crossing."""
_TESTS = (SLOPE, *CRITICAL)


@dataclass(frozen=True)
class FamilySettings(FollowingSettings):
    """Steps and limits of continuation of Lyapunov orbits.

    Beyond `largest_multiplier`, the multipliers at one have errors above 1e-2 in double precision. The curve is
    followed for another `tail` steps to determine its end.
    """

    largest_multiplier: float = 1e7
    tail: int = 25


_UNFINISHED = (FamilyEndCause.LARGE_MULTIPLIER, FamilyEndCause.MANY_MEMBERS, FamilyEndCause.STUCK)
Member = TypeVar("Member")


@dataclass(frozen=True, kw_only=True)
class Family(Shown, Generic[Member]):
    """K members along a family's curve.

    Attributes:
        members: orbits along the family.
        ends: first and last end.
    """

    members: tuple[Member, ...]
    ends: tuple[FamilyEnd, FamilyEnd]

    @property
    def status(self) -> str:
        """Range and end of the family in words."""
        return family_sentence(self)

    def __repr__(self) -> str:
        return f"<family of orbits: {self.status}>"

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
        """Initial states (K, N) of the members."""
        return self.column("state")

    @property
    def floquet_multipliers(self) -> NDArray[np.complex128]:
        """Floquet multipliers (K, …), largest first in each row."""
        return self.column("floquet_multipliers")

    def frame(self) -> DataFrame:
        """Return a pandas table, one row per member.

        Energy, period and the largest multiplier's modulus.

        Raises:
            PartMissing: pandas is not installed.
        """
        sizes = np.abs(self.floquet_multipliers[:, 0])
        return data_frame({"energy": self.energies, "period": self.periods, "multiplier": sizes})

    @checked
    def column(self, name: str) -> NDArray[Any]:
        """Return one attribute of all members, (K, …).

        Args:
            name: attribute, such as "period".

        Raises:
            InputError: unknown attribute.
        """
        known = [one for one in dir(self.members[0]) if not one.startswith("_")]
        check_choice("attribute", known, name)
        return np.array([getattr(member, name) for member in self.members])


@dataclass(frozen=True)
class FamilyEvent:
    """An event on a family: "fold", "multiplier +1" or "multiplier -1"."""

    kind: str
    orbit: LyapunovOrbit


@dataclass(frozen=True)
class LyapunovFamily(Family[LyapunovOrbit], Documented):
    """Lyapunov orbits along a family's curve, starting at the saddle.

    Attributes:
        system: system of the orbits.
        saddle: saddle of the family.
        family: index of the family at the saddle, from 0.
        events: bifurcations along the family.
        bounds: energies between which it was followed, J.
    """

    KEYS: ClassVar[str] = (
        "family=members ends:energy,cause,reason=status events:kind,**orbit saddle status energies=bounds"
    )

    system: System
    saddle: str
    family: int
    events: tuple[FamilyEvent, ...]
    bounds: tuple[float, float]

    @property
    def converged(self) -> bool:
        """True if the family was followed to its end."""
        return self.ends[1].cause not in _UNFINISHED


def lyapunov_family(
    system: System,
    saddle: str,
    *,
    energies: tuple[float, float],
    family: int = 0,
    settings: FamilySettings | None = None,
    progress: Progress = no_progress,
) -> LyapunovFamily:
    """Follow a family of Lyapunov orbits from its saddle.

    Continuation ends at the far bound, at a loss of hyperbolicity, in an equilibrium's homoclinics, or if no step
    converges.

    Args:
        system: Hamiltonian system with reversers.
        saddle: name of the equilibrium.
        energies: (lowest, highest), J.
        family: number of the family, slowest first.
        settings: steps and limits.
        progress: called with a label and the completed share.

    Raises:
        InputError: unknown saddle or family, or no member within the bounds.
    """
    settings = settings or FamilySettings()
    problem, linear = symmetric_shooting(system, saddle, family)
    low, high = energies
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise InputError(f"energies {low:g} to {high:g}: must be two finite numbers in ascending order")
    far = high if linear.sign > 0 else low
    if (far - linear.energy) * linear.sign <= 0:
        raise InputError(
            f"energies {low:g} to {high:g}{system.unit('J')}: the Lyapunov orbits about {saddle} exist only "
            f"{'above' if linear.sign > 0 else 'below'} its energy of {linear.energy:.6g}{system.unit('J')}"
        )
    curve = _curve(problem, linear, settings)

    def orbit(point: FamilyPoint) -> LyapunovOrbit:
        return described_orbit(
            problem,
            point.unknowns,
            saddle=saddle,
            family=family,
            energy=point.energy,
            outcome=OrbitOutcome(OrbitCause.MEMBER, point.residual),
        )

    def stop(point: FamilyPoint) -> FamilyEnd | None:
        large = point.measures[SIZE] > largest
        return FamilyEnd(point.energy, FamilyEndCause.LARGE_MULTIPLIER, system, limit=largest) if large else None

    tangent = np.append(linear.direction, 0.0) / curve.weights
    birth, heading = np.append(0.0 * linear.direction, _birth_arc(problem, linear)), tangent / np.linalg.norm(tangent)
    # At the saddle the curve meets that of the resting arcs (0, τ), so its tangent comes from the linear centre.
    here = replace(curve.point(birth, heading, 0.0), tangent=heading)
    largest = settings.largest_multiplier
    run = follow(
        curve, here, energies, tests=_TESTS, losing=_TESTS[1:], settings=settings, born=True, progress=progress,
        stop=stop,
    )  # fmt: skip
    first = run.first or FamilyEnd(linear.energy, FamilyEndCause.SADDLE, system, saddle)
    last, points = run.last, run.points
    if last is None:
        last = family_end(system, points or [run.here], problem)
    elif last.cause is FamilyEndCause.LARGE_MULTIPLIER:
        last = family_end(system, [*points, *_tail(curve, run.here, settings)], problem, largest=largest)
        points = [p for p in points if p.measures[SIZE] <= largest]
    if not points:
        span = f"energies {low:g} to {high:g}{system.unit('J')}"
        raise InputError(f"{span}: the family about {saddle} does not reach them; {last.status}")
    members = tuple(orbit(p) for p in points)
    events = tuple(FamilyEvent("fold" if e.test == SLOPE else e.test, orbit(e.place)) for e in run.events)
    return LyapunovFamily(system, saddle, family, events, energies, members=members, ends=(first, last))


def _curve(problem: SymmetricShooting, linear: LinearCentre, settings: FamilySettings) -> FamilyCurve:
    """Return the family's curve with measures of the Floquet multipliers."""
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


def _tail(curve: FamilyCurve, start: FamilyPoint, settings: FamilySettings) -> list[FamilyPoint]:
    """Follow the curve for at most `tail` more steps."""
    points = [start]
    for _ in range(settings.tail):
        following = curve.step(points[-1], settings.step)
        if following is None:
            break
        points.append(following)
    return points[1:]
