"""Families of Lyapunov orbits, followed along their own curve until they end.

The shooting equations leave a curve in (c, τ); it is followed by pseudo-arclength, y(s + h) on the plane through the
predicted point across the tangent, so that it may turn back in energy. Along it are watched

    dH/ds = 0                                          the energy folds,
    det(M' - σ) = 0, σ = ±1,                           a multiplier crosses σ (M' on ker ∇H modulo the flow),

each located as a root along the curve, every trial point corrected onto it. At σ = 1 a family branches (or folds), at
σ = -1 its period doubles; either way hyperbolicity, and with it the tube, may be lost.

A family that runs into an equilibrium's homoclinics has a period that grows without bound: with μ the equilibrium's
slowest growth rate and two passages to a period, energy - limit ~ exp(-μ T/2); the limit is extrapolated.
Source: Doedel et al., Computation of periodic solutions of conservative systems (2003); Vanderbauwhede & Fiedler,
Homoclinic period blow-up in reversible and conservative systems (1992).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import Progress, no_progress
from dpcontrol.tubes.lyapunov import LyapunovOrbit, described_orbit
from dpcontrol.tubes.symmetric_shooting import LinearCentre, SymmetricShooting, symmetric_shooting

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FamilySettings:
    """How a family is followed. step, smallest_step: along the curve, in scaled units of (c, τ).

    largest_multiplier: of members; beyond it the multipliers at one are off by more than 1e-2 in double. The curve is
    followed `tail` steps on from there, to find out where it leads.
    """

    step: float = 0.05
    smallest_step: float = 1e-6
    most_members: int = 400
    newton_iterations: int = 12
    tolerance: float = 1e-12
    largest_multiplier: float = 1e7
    tail: int = 25


@dataclass(frozen=True)
class FamilyEnd:
    """Where the family was left: energy in J, kind, and the reason as a sentence.

    kind: "saddle", "energy bound", "homoclinics", "hyperbolicity lost" or "not followed further".
    """

    energy: float
    kind: str
    reason: str


@dataclass(frozen=True)
class FamilyEvent:
    """Something on the way: kind "fold", "multiplier +1" or "multiplier -1", located at an orbit of the family."""

    kind: str
    orbit: LyapunovOrbit


@dataclass(frozen=True)
class LyapunovFamily:
    """Members of a family, K in number, in order along its curve from the saddle on.

    ends: the reason on the saddle's side and on the other. converged: every member closes, and neither end is where
    Newton's method failed.
    """

    system: System
    saddle: str
    family: int
    members: tuple[LyapunovOrbit, ...]
    events: tuple[FamilyEvent, ...]
    ends: tuple[FamilyEnd, FamilyEnd]
    converged: bool
    status: str

    @property
    def energies(self) -> Array:
        """Energies (K,) in J."""
        return np.array([m.energy for m in self.members])

    @property
    def periods(self) -> Array:
        """Periods (K,) in s."""
        return np.array([m.period for m in self.members])

    @property
    def states(self) -> Array:
        """States (K, N) at the crossing of the saddle's fixed set."""
        return np.array([m.state for m in self.members])

    @property
    def floquet_multipliers(self) -> NDArray[np.complex128]:
        """Multipliers (K, N), largest first in each row."""
        return np.array([m.floquet_multipliers for m in self.members])


@dataclass(frozen=True)
class _Point:
    """One point of the curve: unknowns and tangent, both (n + 1,); energy; test functions by kind of event."""

    unknowns: Array
    tangent: Array
    energy: float
    residual: float
    tests: dict[str, float]
    multiplier: float


class _Curve:
    """The family as a curve in (c, τ), scaled."""

    def __init__(self, problem: SymmetricShooting, linear: LinearCentre, settings: FamilySettings) -> None:
        self.problem, self.settings = problem, settings
        arc = 2 * np.pi / linear.frequency / problem.quarters
        self.weights = np.append(np.abs(problem.start.T) @ problem.system.scale, arc)
        self.birth = np.append(0.0 * linear.direction, arc)
        tangent = np.append(linear.direction, 0.0) / self.weights
        self.heading = tangent / np.linalg.norm(tangent)

    def point(self, unknowns: Array, heading: Array, residual: float) -> _Point:
        """Describe a point that lies on the curve; `heading` orients the tangent."""
        problem = self.problem
        _, jacobian = problem.arc(unknowns)
        tangent = np.linalg.svd(jacobian * self.weights)[2][-1]
        tangent = tangent if tangent @ heading >= 0 else -tangent
        energy, slope = problem.energy(unknowns)
        state = problem.state(unknowns)
        _, monodromy = problem.system.propagator.flow_with_stm(state, problem.period(unknowns))
        numeric = problem.system.numeric
        plane, _ = np.linalg.qr(np.column_stack([numeric.rate(state), numeric.gradient(state)]))
        rest = np.linalg.svd(plane.T)[2][2:].T
        reduced = rest.T @ monodromy @ rest
        size = max(1.0, float(np.abs(np.linalg.eigvals(reduced)).max()))
        tests = {
            "fold": float((slope * self.weights) @ tangent) / problem.system.energy_scale,
            "multiplier +1": float(np.linalg.det(reduced - np.eye(len(reduced)))) / size,
            "multiplier -1": float(np.linalg.det(reduced + np.eye(len(reduced)))) / size,
        }
        return _Point(unknowns, tangent, energy, residual, tests, size)

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
        moved = np.linalg.norm((found - guess) / self.weights)
        # A correction as long as the step has left for another curve; so has a tangent that turned by 25 degrees.
        if residual > 10 * self.settings.tolerance or moved > 0.5 * abs(length):
            return None
        try:
            point = self.point(found, start.tangent, residual)
        except (ArithmeticError, np.linalg.LinAlgError):
            return None
        return point if point.tangent @ start.tangent > 0.9 else None

    def located(self, start: _Point, length: float, test: str) -> _Point | None:
        """Return the point between `start` and `length` on where a test function vanishes."""

        def value(h: float) -> float:
            point = start if h == 0 else self.step(start, h)
            if point is None:
                raise ArithmeticError("left the curve")
            return point.tests[test]

        try:
            return self.step(start, float(brentq(value, 0.0, length, xtol=1e-13)))  # type: ignore[arg-type]
        except (ArithmeticError, ValueError):
            return None


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
        raise InputError(f"energies {low:g} to {high:g} J: must be two finite numbers, the lower first")
    near, far = (low, high) if linear.sign > 0 else (high, low)
    if (far - linear.energy) * linear.sign <= 0:
        raise InputError(
            f"energies {low:g} to {high:g} J: the Lyapunov orbits about {saddle} exist only "
            f"{'above' if linear.sign > 0 else 'below'} its energy of {linear.energy:.6g} J"
        )
    curve = _Curve(problem, linear, settings)

    def within(energy: float) -> bool:
        return (energy - near) * linear.sign >= 0

    def orbit(point: _Point) -> LyapunovOrbit:
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

    def at_bound(guess: _Point, energy: float) -> _Point | None:
        found, residual = problem.at_energy(
            guess.unknowns, energy, iterations=settings.newton_iterations, tolerance=settings.tolerance
        )
        if residual > 10 * settings.tolerance:
            return None
        return replace(curve.point(found, guess.tangent, residual), energy=energy)

    points: list[_Point] = []
    events: list[FamilyEvent] = []
    # At the saddle the curve meets that of the resting arcs (0, τ): only the linear centre tells the tangent.
    here = replace(curve.point(curve.birth, curve.heading, 0.0), tangent=curve.heading)
    first = FamilyEnd(
        linear.energy, "saddle", f"the orbits shrink to {saddle} itself at its energy of {linear.energy:.9g} J"
    )
    last: FamilyEnd | None = None
    length, at_birth = min(settings.step, 0.01), True
    while last is None:
        following = curve.step(here, length)
        if following is None:
            length /= 2
            if length < settings.smallest_step:
                last = _end(system, points or [here], problem, "not followed further", settings)
            continue
        # At the birth dH/ds = 0 too, which is no fold.
        for test in () if at_birth else following.tests:
            if here.tests[test] * following.tests[test] < 0 and within(following.energy):
                place = curve.located(here, length, test)
                if place is None:
                    continue
                events.append(FamilyEvent(test, orbit(place)))
                if test != "fold" and last is None:
                    points.append(place)
                    last = _lost(test, place)
        if last is not None:
            break
        if not within(here.energy) and within(following.energy):
            bound = at_bound(following, near)
            first = FamilyEnd(near, "energy bound", f"left at the asked bound of {near:g} J; the family goes on")
            points += [] if bound is None else [bound]
        if (following.energy - far) * linear.sign >= 0:
            bound = at_bound(following, far)
            points += [] if bound is None else [bound]
            last = FamilyEnd(far, "energy bound", f"left at the asked bound of {far:g} J; the family goes on")
            break
        if within(following.energy):
            points.append(following)
            progress(f"family of {saddle}", abs((following.energy - linear.energy) / (far - linear.energy)))
        here, at_birth = following, False
        length = min(settings.step, 1.5 * length)
        if here.multiplier > settings.largest_multiplier:
            last = _end(system, [*points, *_tail(curve, here)], problem, "largest multiplier", settings)
            points = [p for p in points if p.multiplier <= settings.largest_multiplier]
        elif len(points) >= settings.most_members:
            reason = f"left after {settings.most_members} members at {here.energy:.9g} J; allow more, or longer steps"
            last = FamilyEnd(here.energy, "not followed further", reason)
    if not points:
        raise InputError(
            f"energies {low:g} to {high:g} J: the family about {saddle} does not reach them; {last.reason}"
        )
    members = tuple(orbit(p) for p in points)
    converged = last.kind != "not followed further"
    status = f"{len(members)} orbits from {members[0].energy:.9g} to {members[-1].energy:.9g} J; {last.reason}"
    return LyapunovFamily(system, saddle, family, members, tuple(events), (first, last), converged, status)


def _tail(curve: _Curve, start: _Point) -> list[_Point]:
    """Follow the curve on as far as it goes, at most `tail` steps."""
    points = [start]
    for _ in range(curve.settings.tail):
        following = curve.step(points[-1], curve.settings.step)
        if following is None:
            break
        points.append(following)
    return points[1:]


def _lost(test: str, place: _Point) -> FamilyEnd:
    what = "a branch leaves the family or it folds" if test.endswith("+1") else "the period doubles"
    reason = f"hyperbolicity is lost at {place.energy:.12g} J: a multiplier crosses {test.split()[1]}, where {what}"
    return FamilyEnd(place.energy, "hyperbolicity lost", reason)


def _end(
    system: System, points: list[_Point], problem: SymmetricShooting, kind: str, settings: FamilySettings
) -> FamilyEnd:
    """Say why the family could not be followed on: homoclinics of an equilibrium, or not known."""
    place = points[-1]
    arc = system.propagator.sample(problem.state(place.unknowns), np.linspace(0, place.unknowns[-1], 400))
    distances = {name: float(np.min(system.scaled_distance(arc, x))) for name, x in system.equilibria.items()}
    name = min(distances, key=lambda k: distances[k])
    goal = float(system.numeric.hamiltonian(system.equilibria[name]))
    limit = _extrapolated(points, problem)
    if distances[name] < 0.05 and limit is not None and abs(limit - goal) < 1e-3 * system.energy_scale:
        return FamilyEnd(
            place.energy,
            "homoclinics",
            f"ends in the homoclinics of {name}: the period grows without bound (followed to "
            f"{problem.period(place.unknowns):.3g} s, multiplier {place.multiplier:.1e}) as the energy tends to "
            f"{limit:.6g} J, extrapolated; {name} has {goal:.6g} J",
        )
    if kind == "largest multiplier":
        reason = (
            f"left at {place.energy:.9g} J: multipliers above {settings.largest_multiplier:g} are rounding in double"
        )
    else:
        reason = f"could not be followed beyond {place.energy:.9g} J (residual {place.residual:.1e})"
    return FamilyEnd(place.energy, "not followed further", reason)


def _extrapolated(points: list[_Point], problem: SymmetricShooting) -> float | None:
    """Return the energy's limit as the period grows, by Aitken's rule on the last three points, None if none."""
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
