"""Families of periodic orbits, by continuation along their curve.

The solutions of the shooting equations (module lyapunov) form a curve in (c, τ), which is followed by module
continuation. Along it, two tests are evaluated:

    dH/ds = 0                                          a fold in energy,
    det(M' - σ) = 0, σ = ±1,                           a multiplier crosses σ (M' on ker ∇H modulo the flow).

At σ = 1 a family branches or folds, and at σ = -1 its period doubles. In both cases the orbit may lose hyperbolicity
and its tubes.

If a family ends in the homoclinics of an equilibrium, its period grows without bound. With the equilibrium's slowest
growth rate μ and two passages per period, energy - limit ~ exp(-μ T/2). The limit is extrapolated.

Sources: Doedel et al., Computation of periodic solutions of conservative systems with application to the 3-body problem
(2003); Vanderbauwhede & Fiedler, Homoclinic period blow-up in reversible and conservative systems (1992).
"""

from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
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
from dpcontrol.foundation.shown import Shown, data_frame
from dpcontrol.orbits.continuation import SLOPE, TO_ROUNDING, Curve, CurvePoint, Newton
from dpcontrol.orbits.lyapunov import (
    LyapunovOrbit,
    OrbitOutcome,
    SymmetricShooting,
    described_orbit,
    symmetric_shooting,
)
from dpcontrol.words.searches import Concluded, family_sentence

CRITICAL = {"multiplier +1": 1.0, "multiplier -1": -1.0}
"""Multipliers at which hyperbolicity is lost, by the test of their crossing."""

SIZE = "size"
"""Measure of a family's point: the modulus of the largest multiplier, or of the trace, at least one."""

LINGERS = 0.05
"""Largest scaled distance between an equilibrium and an orbit that approaches it."""


@dataclass(frozen=True)
class FollowingSettings:
    """Steps, tolerance and limits of continuation, in scaled units of the unknowns (c, τ) of `SymmetricShooting`.

    Attributes:
        largest_multiplier: largest measure `SIZE`. Beyond 1e7, the multipliers at one have errors above 1e-2 in double
            precision.
        longest: longest period, s.
        tail: number of steps beyond `largest_multiplier` that determine the end of a Lyapunov family.
    """

    step: float = 0.05
    smallest_step: float = 1e-6
    most_members: int = 400
    newton: Newton = TO_ROUNDING
    largest_multiplier: float = 1e7
    longest: float = np.inf
    tail: int = 25


@dataclass(frozen=True)
class CurveEvent:
    """A zero of the measure `test` at `place` on a family's curve.

    `before` and `after` are the measure's values at the two points between which the zero was found, in the direction
    of continuation.
    """

    test: str
    place: CurvePoint
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
        events: folds and critical multipliers within the bounds.
        first: entry into the bounds, if it started outside, else None.
        last: end of the family, None if no step converges.
    """

    here: CurvePoint
    points: list[CurvePoint] = field(default_factory=list)
    events: list[CurveEvent] = field(default_factory=list)
    first: FamilyEnd | None = None
    last: FamilyEnd | None = None


def follow(
    curve: Curve,
    problem: SymmetricShooting,
    start: CurvePoint,
    energies: tuple[float, float],
    *,
    settings: FollowingSettings,
    born: bool = False,
    progress: Progress = no_progress,
) -> Followed:
    """Return the points and events of a family's curve from a point until it leaves the energy bounds or ends.

    Args:
        curve: curve of the family.
        problem: shooting problem of the family.
        start: first point.
        energies: (lowest, highest), J.
        settings: steps and limits.
        born: True if the family starts at this point, and ends at the loss of hyperbolicity.
        progress: called with a label and the completed share.
    """
    (low, high), result = energies, Followed(start)
    # At the birth, the energy's derivative along the curve vanishes too, which is not a fold.
    birth = start if born else None
    end = partial(FamilyEnd, system=problem.system)

    def within(energy: float) -> bool:
        """Return True if an energy, J, is within the bounds."""
        return low <= energy <= high

    def crossed(test: str, point: CurvePoint, following: CurvePoint) -> bool:
        """Return True if a measure changes its sign from a point to the following one."""
        return point.measures[test] * following.measures[test] < 0

    steps = curve.followed(
        start,
        step=settings.step,
        smallest=settings.smallest_step,
        # A step across the whole elliptic range would miss both of its ends.
        refused=lambda here, following: (
            here is not birth and all(crossed(test_name, here, following) for test_name in CRITICAL)
        ),
    )
    for previous, following, length in steps:
        result.here = following
        for test in () if previous is birth else (SLOPE, *CRITICAL):
            if crossed(test, previous, following) and (within(previous.value) or within(following.value)):
                place = curve.located(previous, length, lambda point, test=test: point.measures[test])
                if place is not None and within(place.value):
                    result.events.append(CurveEvent(test, place, previous.measures[test], following.measures[test]))
                    if born and test in CRITICAL and result.last is None:
                        result.points.append(place)
                        result.last = end(place.value, FamilyEndCause.HYPERBOLICITY_LOST, multiplier=CRITICAL[test])
        if result.last is not None:
            break
        direction = 1 if following.value > previous.value else -1
        # The bound behind comes first, at which a family can enter; at the bound ahead it ends.
        for bound in energies[::direction]:
            if (previous.value - bound) * (following.value - bound) < 0 or following.value == bound:
                place = curve.at(following, bound)
                result.points += [] if place is None else [place]
                if bound == energies[::direction][1]:
                    result.last = end(bound, FamilyEndCause.ENERGY_BOUND)
                    return result
                result.first = end(bound, FamilyEndCause.ENERGY_BOUND)
        if within(following.value):
            result.points.append(following)
            progress("family of orbits", min(1.0, abs(following.value - start.value) / (high - low)))
        period, too_many = problem.period(following.unknowns), len(result.points) >= settings.most_members
        if period > settings.longest:
            result.last = end(following.value, FamilyEndCause.LONG_PERIOD, period=period)
        elif following.measures[SIZE] > settings.largest_multiplier:
            result.last = end(following.value, FamilyEndCause.LARGE_MULTIPLIER, limit=settings.largest_multiplier)
        elif too_many:
            result.last = end(following.value, FamilyEndCause.MANY_MEMBERS, limit=settings.most_members)
        if result.last is not None:
            break
    return result


def nearest_equilibrium(problem: SymmetricShooting, place: CurvePoint) -> tuple[str, float]:
    """Return the name of the equilibrium nearest to an orbit, and its scaled distance, to describe a family's end.

    Args:
        problem: shooting problem of the orbit.
        place: point of the family.
    """
    system = problem.system
    arc = system.propagator.sample(problem.state(place.unknowns), np.linspace(0, place.unknowns[-1], 400))
    distances = {name: float(np.min(system.scaled_distance(arc, state))) for name, state in system.equilibria.items()}
    return min(distances.items(), key=lambda item: item[1])


def family_end(points: list[CurvePoint], problem: SymmetricShooting, *, largest: float | None = None) -> FamilyEnd:
    """Return the end of a family that could not be followed further, with its cause.

    The cause is found from the equilibrium nearest to the last orbit, and from the energy that the family approaches.

    Args:
        points: the last members.
        problem: shooting problem of the family.
        largest: limit on multipliers that ended the continuation; None if no step converged.
    """
    place, system, tolerance = points[-1], problem.system, 1e-3 * problem.scale
    name, distance = nearest_equilibrium(problem, place)
    height = float(system.numeric.hamiltonian(system.equilibria[name]))
    limit = _extrapolated(points, problem)
    if distance < LINGERS and limit is not None and abs(limit - height) < tolerance:
        cause = FamilyEndCause.HOMOCLINICS
    elif largest is not None:
        cause, limit = FamilyEndCause.LARGE_MULTIPLIER, largest
    else:
        passes = distance <= LINGERS and abs(height - place.value) <= tolerance
        cause = FamilyEndCause.PASSES_EQUILIBRIUM if passes else FamilyEndCause.STUCK
    period, size, limit = problem.period(place.unknowns), place.measures[SIZE], np.nan if limit is None else limit
    return FamilyEnd(place.value, cause, system, name, height, distance, period, size, limit, place.residual)


def _extrapolated(points: list[CurvePoint], problem: SymmetricShooting) -> float | None:
    """Return the energy, J, that the last members approach as their period grows without bound, or None.

    `points`: the last members in order, of which nine are used. The energy is that of an equilibrium if the family ends
    in the equilibrium's homoclinics. The result is None if the members are too few or their energies do not converge.
    """
    if len(points) < 9:
        return None
    # The energy is exponential in the period near homoclinics, so the rule needs equal steps in the period.
    periods = np.array([problem.period(point.unknowns) for point in points[-9:]])
    energies = np.array([point.value for point in points[-9:]])
    if np.any(np.diff(periods) <= 0):
        return None
    rates = np.diff(energies) / np.diff(periods)
    middles = (periods[1:] + periods[:-1]) / 2
    # ln|dE/dT| is linear in T there, so the remaining energy difference is the last rate over its decay.
    decay = -float(np.polyfit(middles, np.log(np.abs(rates)), 1)[0]) if np.all(rates != 0) else 0.0
    if decay <= 0:
        return None
    last_rate = float(rates[-1] * np.exp(-decay * (periods[-1] - middles[-1])))
    return float(energies[-1] + last_rate / decay)


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
        """Return a pandas table with one row per member: energy, period and the largest multiplier's modulus.

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
        attributes = [attribute for attribute in dir(self.members[0]) if not attribute.startswith("_")]
        check_choice("attribute", attributes, name)
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
    settings: FollowingSettings | None = None,
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
    settings = settings or FollowingSettings()
    problem, linear = symmetric_shooting(system, saddle, family)
    low, high = energies
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise InputError(f"energies {low:g} to {high:g}: must be two finite numbers in ascending order")
    goal = high if linear.sign > 0 else low
    if (goal - linear.energy) * linear.sign <= 0:
        raise InputError(
            f"energies {low:g} to {high:g}{system.unit('J')}: the Lyapunov orbits about {saddle} exist only "
            f"{'above' if linear.sign > 0 else 'below'} its energy of {linear.energy:.6g}{system.unit('J')}"
        )
    birth, weights = problem.birth(linear)
    curve = Curve(problem, weights, settings.newton, 10 * settings.newton.tolerance, partial(floquet_measures, problem))
    tangent = np.append(linear.direction, 0.0) / weights
    heading = tangent / np.linalg.norm(tangent)
    # At the saddle the curve meets that of the resting arcs (0, τ), so its tangent comes from the linear centre.
    start = replace(curve.point(birth, heading, 0.0), tangent=heading)
    run = follow(curve, problem, start, energies, settings=settings, born=True, progress=progress)
    first = run.first or FamilyEnd(linear.energy, FamilyEndCause.SADDLE, system, saddle)
    last, points, largest, step = run.last, run.points, settings.largest_multiplier, settings.step
    if last is None:
        last = family_end(points or [run.here], problem)
    elif last.cause is FamilyEndCause.LARGE_MULTIPLIER:
        tail = islice(curve.followed(run.here, step=step, smallest=step, first=step), settings.tail)
        last = family_end([*points, *(following for _, following, _ in tail)], problem, largest=largest)
        points = [place for place in points if place.measures[SIZE] <= largest]
    if not points:
        span = f"energies {low:g} to {high:g}{system.unit('J')}"
        raise InputError(f"{span}: the family about {saddle} does not reach them; {last.status}")

    def orbit(point: CurvePoint) -> LyapunovOrbit:
        """Return the orbit at a point of the curve."""
        outcome = OrbitOutcome(OrbitCause.MEMBER, point.residual)
        return described_orbit(
            problem, point.unknowns, saddle=saddle, family=family, energy=point.value, outcome=outcome
        )

    members = tuple(orbit(place) for place in points)
    events = tuple(
        FamilyEvent("fold" if event.test == SLOPE else event.test, orbit(event.place)) for event in run.events
    )
    return LyapunovFamily(system, saddle, family, events, energies, members=members, ends=(first, last))


def floquet_measures(problem: SymmetricShooting, unknowns: Array) -> dict[str, float]:
    """Return the tests of the Floquet multipliers by name, zero at a critical multiplier, and the largest modulus.

    Args:
        problem: shooting problem of the family.
        unknowns: solution (n + 1,).
    """
    system, state = problem.system, problem.state(unknowns)
    _, monodromy = system.propagator.flow_with_stm(state, problem.period(unknowns))
    # The complement of flow and energy gradient, on which the multipliers other than one act.
    plane, _ = np.linalg.qr(np.column_stack([system.numeric.rate(state), system.numeric.gradient(state)]))
    reduced_basis = np.linalg.svd(plane.T)[2][2:].T
    reduced = reduced_basis.T @ monodromy @ reduced_basis
    size = max(1.0, float(np.abs(np.linalg.eigvals(reduced)).max()))
    identity = np.eye(len(reduced))
    tests = {test: float(np.linalg.det(reduced - critical * identity)) / size for test, critical in CRITICAL.items()}
    return {**tests, SIZE: size}
