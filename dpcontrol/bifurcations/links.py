"""Links: connections as points of curves in energy, without a section.

A connection leaves the seed circle γ(φ_u) ± δ v(φ_u) of its source's unstable manifold. After a time T, it reaches the
seed circle of its target's stable manifold at phase φ_s. Let X_u(φ_u, t) and X_s(φ_s, t) be the seeds propagated
forward and backward. Then

    F(φ_u, φ_s, T; H) = X_u(φ_u, T/2) - X_s(φ_s, T/2) - whole turns = 0

are four equations, one of them redundant by energy conservation, for three unknowns at every energy H. They do not
depend on sections, crossings or grazes. The vectors (∂X_u/∂φ_u, f) and (∂X_s/∂φ_s, f) span the tangent spaces of the
two manifolds. The spaces coincide, and the connection is tangent, if

    σ = det[∂X_u/∂φ_u, -∂X_s/∂φ_s, f, ∇H] = 0        (columns scaled to length one).

If a reverser R maps a homoclinic connection to itself, its midpoint is on Fix R (2 equations for φ, T). There R splits
the tangent D = ∂X_u/∂φ into D₊ (fixed by R, normal to ∇H) and D₋ (reversed, modulo f). The tangency σ is a product of
a = D₋ and b = D₊. Two symmetric connections meet at a = 0, and a mirror pair branches off at b = 0.

The curve F(φ_u, φ_s, T; H) = 0 is followed by pseudo-arclength continuation. The predictor is the null vector of
[∂F/∂(φ_u, φ_s, T), ∂F/∂H], and Newton's method corrects on the plane normal to it, so the curve may fold in energy.

The number of section crossings follows from the extrema of the height over the section along the connection.

Source: Champneys & Kuznetsov, Numerical detection and continuation of codimension-two homoclinic bifurcations (1994);
Vanderbauwhede & Fiedler (1992) for the reversible case.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice

import numpy as np

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import GapCause
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.shown import Brief
from dpcontrol.orbits.continuation import (
    SLOPE,
    UNSOLVED,
    Bounds,
    Curve,
    CurvePoint,
    Function,
    Newton,
    differenced,
    stepped,
)
from dpcontrol.orbits.lyapunov import LyapunovOrbit, lyapunov_orbit, nearby_orbit, symmetric_shooting
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.words.searches import Concluded


@dataclass(frozen=True)
class Quantity:
    """A quantity that is followed: the energy, or a parameter at a given energy or height.

    Attributes:
        system: system of the names, scales and symmetries, which are the same at all values.
        quantity: "energy", or the name of the parameter.
        plural: the values in words, such as "energies".
        unit: unit of the quantity, as a suffix of numbers.
        scale: typical size of the quantity.
        at: function from a value to the system and the energy, J.
    """

    system: System
    quantity: str
    plural: str
    unit: str
    scale: float
    at: Callable[[float], tuple[System, float]]

    @classmethod
    def of_energy(cls, system: System) -> "Quantity":
        """Return the energy of a system as the quantity over which connections are followed.

        Args:
            system: system of any energy.
        """
        return cls(system, "energy", "energies", system.unit("J"), system.energy_scale, lambda energy: (system, energy))


@dataclass(frozen=True)
class Link:
    """A connection between a seed of the unstable tube and one of the stable tube.

    Attributes:
        branches: branches of both tubes, ±1.
        phases: phases (φ_u, φ_s) of the seeds on both orbits, 1 for a period.
        duration: flight time T from seed to seed, s.
        turns (N,): whole turns of the coordinates on the way.
    """

    branches: tuple[int, int]
    phases: tuple[float, float]
    duration: float
    turns: tuple[float, ...]

    @property
    def unknowns(self) -> Array:
        """The phases and the duration (φ_u, φ_s, T)."""
        return np.array([*self.phases, self.duration])

    def at(self, unknowns: Sequence[float] | Array) -> "Link":
        """Return the link between the same branches with other phases and another duration.

        Args:
            unknowns: φ_u, φ_s (1 for a period) and T, s (3,).
        """
        return replace(self, phases=(float(unknowns[0]), float(unknowns[1])), duration=float(unknowns[2]))


@dataclass(frozen=True)
class PathPoint:
    """A solved point of a path: a link, the value H of the followed quantity, and the tangency σ of both tubes."""

    link: Link
    value: float
    tangency: float

    @property
    def coordinates(self) -> Array:
        """The link's phases and duration and the followed quantity (φ_u, φ_s, T, H), a point of `LinkCurve`."""
        return np.append(self.link.unknowns, self.value)


@dataclass(frozen=True)
class Match(Brief):
    """The gap between two tubes at a connection's middle.

    Attributes:
        gap (N,): scaled.
        jacobian (N, 3): derivative by (φ_u, φ_s, T).
        tangency: σ, zero if both tubes touch there (see `LinkProblem._match`).
        state (N,): at the middle.
    """

    gap: Array
    jacobian: Array
    tangency: float
    state: Array


@dataclass(frozen=True)
class MirrorMatch(Brief):
    """The scaled gap between the middle of a connection and the fixed set of a reverser.

    Attributes:
        miss (n,): components of the gap off the fixed set; zero for a symmetric connection.
        fold: the function a, zero if two symmetric connections meet.
        shedding: the function b, zero if a mirror pair branches off.
    """

    miss: Array
    fold: float
    shedding: float


def phase_gap(first: float, second: float) -> float:
    """Return the difference of two phases, reduced to -½ to ½.

    Args:
        first: phase, 1 for a period.
        second: phase that is subtracted, 1 for a period.
    """
    return (first - second + 0.5) % 1.0 - 0.5


class LinkProblem:
    """Matching of two saddles' tubes at any value of the followed quantity, with cached orbits.

    `_manifolds` holds the unstable manifolds of all orbits so far, by saddle and value of the followed quantity.
    `match` is the function `_match` with a cache of its last sixteen results.

    Args:
        course: followed quantity of systems with two degrees of freedom.
        source, target: names of the saddles.
        distance: of seeds from their orbits, scaled.
    """

    def __init__(self, course: Quantity, source: str, target: str, *, distance: float) -> None:
        system = course.system
        if system.dimension != 4:
            raise InputError(
                f"{system.name} has {system.dimension // 2} degrees of freedom: connections can be followed only "
                "for two"
            )
        self.course, self.system = course, system
        self.source, self.target, self.distance = source, target, distance
        self._manifolds: dict[tuple[str, float], UnstableManifold] = {}
        # The point of a curve, its tangent and its measures share a match.
        self.match: Callable[[Link, float], Match] = lru_cache(maxsize=16)(self._match)

    def section(self, value: float) -> Section:
        """Return the section between source and target at a value of the followed quantity.

        Args:
            value: value of the followed quantity.
        """
        return self.course.at(value)[0].sections[self.source, self.target]

    def _orbit(self, saddle: str, value: float) -> LyapunovOrbit:
        """Return the orbit about a saddle at a value of the followed energy or parameter.

        It is continued from the nearest orbit in the cache if that is near enough, which is faster than a new search.

        Raises:
            ArithmeticError: it did not converge.
        """
        system, energy = self.course.at(value)
        problem, linear = symmetric_shooting(system, saddle, 0)
        nearest = self._nearest(saddle, value)
        if nearest is not None:
            neighbour = nearest.orbit
            height = neighbour.energy - float(neighbour.system.numeric.hamiltonian(neighbour.centre))
            # Unknowns grow as the square root of the height above the saddle, so the guess must be near.
            if 0.8 < (energy - linear.energy) / height < 1.25:
                orbit = nearby_orbit(problem, neighbour, energy)
                if orbit.converged:
                    return orbit
        orbit = lyapunov_orbit(system, saddle, energy=energy)
        if not orbit.converged:
            unit = system.unit("J")
            raise ArithmeticError(f"the Lyapunov orbit about {saddle} at {energy:.9g}{unit}: {orbit.status}")
        return orbit

    def _nearest(self, saddle: str, value: float) -> UnstableManifold | None:
        """Return the cached manifold of a saddle's orbit whose followed quantity is nearest to a value, or None."""
        manifolds = [
            (abs(cached_value - value), manifold)
            for (name, cached_value), manifold in self._manifolds.items()
            if name == saddle
        ]
        return min(manifolds, key=lambda pair: pair[0], default=(0.0, None))[1]

    def manifold(self, saddle: str, value: float) -> UnstableManifold:
        """Return the unstable manifold of a saddle's orbit, with a vector of the same orientation at all energies.

        Args:
            saddle: name of the saddle.
            value: value of the followed quantity.

        Raises:
            ArithmeticError: the orbit did not converge.
            InputError: no orbit exists at this value.
        """
        if (saddle, value) not in self._manifolds:
            manifold = UnstableManifold(self._orbit(saddle, value), self.distance)
            nearest = self._nearest(saddle, value)
            if nearest is not None and float(np.sum(nearest.vector * manifold.vector / self.system.scale**2)) < 0:
                # A branch must denote the same side of the orbit at all energies.
                manifold = replace(manifold, side=-1)
            self._manifolds[saddle, value] = manifold
        return self._manifolds[saddle, value]

    def manifolds(self, value: float) -> tuple[UnstableManifold, UnstableManifold]:
        """Return the unstable manifolds of source and target, whose seeds begin the tubes; one object if both are one.

        Args:
            value: value of the followed quantity.
        """
        return self.manifold(self.source, value), self.manifold(self.target, value)

    def _flown(self, manifold: UnstableManifold, branch: int, phase: float, seconds: float) -> tuple[Array, Array]:
        """Propagate a seed of an unstable manifold for `seconds` (s), without a section.

        `branch` is the side of the orbit, ±1, and `phase` that of the seed on the orbit, 1 for a period.

        Returns:
            The state (N,) after this time, and its derivative (N,) by the phase.
        """
        seeds, slopes = manifold.seeds(np.array([phase]), branch)
        state, stm = manifold.orbit.system.propagator.flow_with_stm(seeds[0], seconds)
        return state, stm @ slopes[0]

    def turned(self, states: Array, centre: Array) -> Array:
        """Return time-reversed states (…, N) about the target's equilibrium, by which the stable tube follows.

        Args:
            states: states (…, N).
            centre: the target (N,).
        """
        return (states - centre) @ self.system.reversers[0].T + centre

    def _match(self, link: Link, value: float) -> Match:
        """Propagate both tubes to the middle of a connection and return their gap with its derivatives.

        The gap is zero for a connection. The tangency σ is the determinant of both tubes' tangents, the flow and the
        energy's gradient, scaled to length one. It is zero if the tubes touch there.

        Args:
            link: guess or solution.
            value: value of the followed quantity.

        Raises:
            ArithmeticError: an orbit did not converge or a state diverged.
        """
        first, second = self.manifolds(value)
        system, scale = first.orbit.system, self.system.scale
        half = link.duration / 2
        unstable_end, unstable_slope = self._flown(first, link.branches[0], link.phases[0], half)
        reversed_end, stable_slope = self._flown(second, link.branches[1], link.phases[1], half)
        stable_end, stable_slope = self.turned(reversed_end, second.orbit.centre), system.reversers[0] @ stable_slope
        # The stable tube is the time-reversed image of an unstable one.
        gap = (unstable_end - stable_end - np.asarray(link.turns) * system.turn_lengths) / scale
        # Half of the duration T passes on either side, so the gap's derivative by T is the mean of both rates.
        along = (system.numeric.rate(unstable_end) + system.numeric.rate(stable_end)) / 2
        jacobian = np.column_stack([unstable_slope, -stable_slope, along]) / scale[:, None]
        columns = np.column_stack([jacobian, system.numeric.gradient(unstable_end) * scale])
        tangency = float(np.linalg.det(columns / np.linalg.norm(columns, axis=0)))
        return Match(gap, jacobian, tangency, unstable_end)

    def mirror(self, link: Link, value: float, which: int) -> MirrorMatch:
        """Return the scaled vector from a reverser's fixed set to a connection's middle, and two test functions there.

        A reverser is a matrix R (N, N) of time reversal about a saddle, and symmetric connections have their middle on
        its fixed set, R x = x. The tangent of the manifold in the middle has a part that the reverser reverses and one
        that it keeps. `fold` is the first one across the flow, and vanishes where two symmetric connections meet.
        `shedding` is the second one across the energy's gradient, and vanishes where a pair of mirror images branches
        off.

        Args:
            link: guess or solution.
            value: value of the followed quantity.
            which: index of the reverser.
        """
        manifold = self.manifold(self.source, value)
        system, scale = manifold.orbit.system, self.system.scale
        state, slope = self._flown(manifold, link.branches[0], link.phases[0], link.duration / 2)
        reverser = system.reversers[which]
        turned_over = (np.eye(4) - reverser) / 2
        deviation = turned_over @ (state - manifold.orbit.centre)
        # The fixed set repeats every half turn of the angles that the reverser reverses.
        deviation = deviation - system.nearest_turns(2 * deviation) * system.turn_lengths / 2
        # Orthonormal scaled bases (2, 4): `rows` spans what the reverser reverses, and `basis` below what it keeps.
        rows = np.linalg.svd(turned_over / scale[:, None])[0][:, :2].T
        miss = rows @ (deviation / scale)
        rate = turned_over @ system.numeric.rate(state)
        slope_reversed, rate_reversed = rows @ (turned_over @ slope / scale), rows @ (rate / scale)
        basis = np.linalg.svd((np.eye(4) + reverser) / 2 / scale[:, None])[0][:, :2].T
        slope_fixed = basis @ (slope / scale)
        normal = basis @ (system.numeric.gradient(state) * scale)
        # The scale must not be (a, b) itself, which nearly vanishes if both kinds of event coincide.
        size = float(np.linalg.norm(slope / scale))
        fold, shedding = (
            float((slope_part[0] * along[1] - slope_part[1] * along[0]) / np.linalg.norm(along)) / size
            for slope_part, along in ((slope_reversed, rate_reversed), (slope_fixed, normal))
        )
        return MirrorMatch(miss, fold, shedding)

    def symmetry(self, link: Link, within: float = 1e-6) -> int | None:
        """Return the index of the time reversal (reverser) that maps a link to itself, or None if it is not symmetric.

        Args:
            link: solution.
            within: largest distance of its image, see `distance_between`.
        """
        for which in range(len(self.system.reversers)):
            image = self.mirrored(link, which)
            if image is not None and self.distance_between(link, image) < within:
                return which
        return None

    def mirrored(self, link: Link, which: int) -> Link | None:
        """Return the image of a homoclinic link under a time reversal (reverser), or None for a heteroclinic link.

        The stable tube is the image of the unstable one under the first reverser, which therefore exchanges the two
        branches and phases of the link.

        Args:
            link: homoclinic link.
            which: index of the reverser.
        """
        if self.source != self.target:
            return None
        if which == 0:
            return replace(link, branches=link.branches[::-1], phases=link.phases[::-1])
        # The second reverser is the first one followed by the half turn S, a symmetry that advances the orbit by half a
        # period and changes the branch if its sign is -1.
        half_turn = next(iter(self._manifolds.values())).half_turn
        assert half_turn is not None
        sign = int(half_turn[1])
        branches = (sign * link.branches[1], sign * link.branches[0])
        return replace(link, branches=branches, phases=(link.phases[1] + 0.5, link.phases[0] + 0.5))

    def distance_between(self, first: Link, second: Link) -> float:
        """Return the largest difference of two links in phases and relative duration, infinite for different branches.

        Args:
            first: link at any value.
            second: link at any value, whose duration is the unit.
        """
        if first.branches != second.branches:
            return float("inf")
        gaps = [abs(phase_gap(a, b)) for a, b in zip(first.phases, second.phases, strict=True)]
        return max(*gaps, abs(first.duration / second.duration - 1))

    def solved(self, link: Link, value: float) -> PathPoint:
        """Return the connection near a link, for which the gap F of both tubes is zero, at a fixed value.

        The unknowns are the phases φ_u and φ_s of the link's seeds and its duration T.

        Args:
            link: initial guess.
            value: value of the followed quantity.

        Raises:
            ArithmeticError: Newton's method left the neighbourhood or did not converge.
        """

        def equations(unknowns: Array) -> tuple[Array, Array]:
            """Return the scaled gap (N,) and its Jacobian (N, 3) at (φ_u, φ_s, T)."""
            match = self.match(link.at(unknowns), value)
            return match.gap, match.jacobian

        low, high = (bound[:3] for bound in LinkCurve(self, link).bounds(np.append(link.unknowns, value)))
        solution = _AT_ENERGY.solve(equations, link.unknowns, (low, high))
        if solution.residual > _ROUNDED:
            raise ArithmeticError(f"not matched: gap {solution.residual:.1e}")
        link = link.at(solution.unknowns)
        return PathPoint(link, value, self.match(link, value).tangency)


@dataclass(frozen=True)
class LinkCurve:
    """The curve of a link's continuation, a problem of module continuation.

    Its unknowns are the phases φ_u and φ_s of both seeds, the duration T, s, and the followed quantity H.

    Attributes:
        problem: matching of two tubes.
        link: a link with the branches and turns of the curve.
        units: factor on the scaled gap, the residual of the curve's equations.
    """

    problem: LinkProblem
    link: Link
    units: float = 1.0

    @property
    def scale(self) -> float:
        """Typical size of the followed quantity."""
        return self.problem.course.scale

    def near(self, guess: Array) -> Function:
        """Return the equations F = 0, whose derivative by the followed quantity is that of the guess.

        Args:
            guess: (φ_u, φ_s, T, H) (4,).

        Returns:
            Function of the unknowns (4,) to the scaled gap (N,) and its derivative (N, 4).
        """
        guessed, width = self.link.at(guess), np.array([1e-5 * self.scale])
        slope = differenced(lambda value: self.problem.match(guessed, float(value[0])).gap, guess[3:], width)

        def equations(unknowns: Array) -> tuple[Array, Array]:
            """Return the scaled gap (N,) and its Jacobian (N, 4) at (φ_u, φ_s, T, H)."""
            match = self.problem.match(self.link.at(unknowns), float(unknowns[3]))
            return match.gap, np.hstack([match.jacobian, slope])

        return equations

    def quantity(self, unknowns: Array) -> tuple[float, Array]:
        """Return the followed quantity of a point on the curve, and its gradient (4,) by the unknowns.

        Args:
            unknowns: (φ_u, φ_s, T, H) (4,).
        """
        return float(unknowns[3]), np.array([0.0, 0.0, 0.0, 1.0])

    def bounds(self, guess: Array) -> Bounds:
        """Return the lowest and highest unknowns (4,) that Newton's method may reach from a guess.

        Args:
            guess: (φ_u, φ_s, T, H) (4,).
        """
        reach = np.array([0.1, 0.1, 0.2 * guess[2], np.inf])
        return guess - reach, guess + reach

    def measure(self, unknowns: Array) -> dict[str, float]:
        """Return the tangency σ of a point on the curve, which continuation records at each step.

        Args:
            unknowns: (φ_u, φ_s, T, H) (4,).
        """
        return {TANGENCY: self.problem.match(self.link.at(unknowns), float(unknowns[3])).tangency}


TANGENCY = "tangency"
_MATCHED = 1e-10  # scaled gap
_ROUNDED = 1e-8  # largest scaled gap due to rounding, with large multipliers
_AT_ENERGY = Newton(12, _MATCHED, rounded=_ROUNDED, stride=0.3)
_ON_CURVE = Newton(8, _MATCHED, enough=_MATCHED, rounded=_ROUNDED)


@dataclass(frozen=True)
class Gap(Concluded):
    """Reason for a change of the number of connections that no event explains.

    Attributes:
        values: values of the followed quantity that the cause concerns.
        counts: numbers of connections or crossings that the cause concerns.
        duration: flight of a connection that could not be followed, s.
        error: message of the numerical method.
    """

    course: Quantity
    cause: GapCause
    values: tuple[float, ...] = ()
    counts: tuple[int, ...] = ()
    duration: float = np.nan
    error: str = ""


@dataclass(frozen=True)
class Path:
    """A connection that is followed.

    Attributes:
        points: the connection at each step.
        turns: indices of points before a fold in the quantity.
        returned: True if the path came back to its start, False if it reached the goal.
        gap: why the path was lost, or None.
    """

    points: tuple[PathPoint, ...]
    turns: tuple[int, ...]
    returned: bool = False
    gap: Gap | None = None


def carry(problem: LinkProblem, point: PathPoint, goal: float, *, smallest: float = 1 / 32) -> PathPoint | None:
    """Continue a connection to another value of the followed quantity, or return None if it may turn.

    Each step is predicted along ∂(φ_u, φ_s, T)/∂H, the derivative of the phases of its two seeds and its duration by
    the followed quantity H, and solved at fixed value. The tangency σ must keep its sign, which changes at a turn, and
    the connection its symmetry. This is cheaper than `follow`, which handles turns.

    Args:
        problem: matching of two tubes.
        point: solution at its value.
        goal: the other value.
        smallest: shortest step, as a share of the whole way.
    """
    distance = abs(goal - point.value)

    def following(point: PathPoint, _: float, value: float) -> PathPoint | None:
        """Return the connection at the next value, or None if it may have turned on the way or cannot be solved.

        The second argument is the value of `point`, which it holds itself.
        """
        try:
            match, curve = problem.match(point.link, point.value), LinkCurve(problem, point.link)
            by_value = curve.near(point.coordinates)(point.coordinates)[1][:, 3]
            slope = -np.linalg.lstsq(match.jacobian, by_value, rcond=1e-13)[0]
            guess = point.link.at(point.link.unknowns + slope * (value - point.value))
            arrived = problem.solved(guess, value)
        except UNSOLVED:
            return None
        reach = 0.02 * np.array([1.0, 1.0, arrived.link.duration])
        far = np.any(np.abs(arrived.link.unknowns - guess.unknowns) > reach)
        turned = arrived.tangency * point.tangency <= 0
        return None if far or turned or problem.symmetry(arrived.link) != problem.symmetry(point.link) else arrived

    last, reached = stepped(point, (point.value, goal), following, longest=distance, smallest=smallest * distance)
    return last if reached == goal else None


def follow(problem: LinkProblem, link: Link, start: float, goal: float, *, steps: int = 120) -> Path:
    """Follow a connection over the quantity, around all its turns, until it arrives at the goal or returns.

    If it does neither within `steps`, or if Newton's method fails, the path has a `gap` with the cause. It then ends
    at the last point that was solved, and has no points if there is none at the start.

    Args:
        problem: matching of two tubes.
        link: connection solved at value `start`.
        start: initial value of the followed quantity.
        goal: final value.
        steps: largest number of steps.
    """
    way = goal - start
    # Turns are parabolas, so the change in phase is the square root of a small change in the quantity.
    phase_step = 0.05 * min(1.0, float(np.sqrt(100 * abs(way) / problem.course.scale)))
    points: list[PathPoint] = []
    turns: list[int] = []
    try:
        points.append(problem.solved(link, start))
        link, symmetry, heading = points[0].link, problem.symmetry(points[0].link), np.sign(way) * np.eye(4)[3]
        # The coordinates of the curve are φ_u, φ_s, T and the followed quantity. Its tangent first points along
        # `heading`, towards the goal, and lengths are measured in `weights`.
        curve_of_links = LinkCurve(problem, link)
        weights = np.array([phase_step, phase_step, phase_step * link.duration, abs(way)])
        curve = Curve(curve_of_links, weights, _ON_CURVE, _ROUNDED, curve_of_links.measure)
        first = curve.point(points[0].coordinates, heading, 0.0)

        def refused(point: CurvePoint, following: CurvePoint) -> bool:
            """Return True if a step of the continuation must be repeated with a shorter length."""
            # A first step that ends behind the start has skipped a turn. Near a pitchfork, a long step may jump between
            # the pair and the symmetric connection.
            skipped = point is first and (following.value - start) * way <= 0
            return skipped or problem.symmetry(link.at(following.unknowns)) != symmetry

        stretches = curve.followed(first, step=0.5, smallest=1e-5, first=0.25, growth=1.4, refused=refused)
        for before, after, _ in islice(stretches, steps):
            # The path ends at the first of the two bounds that lies between two points.
            for bound, returned in ((goal, False), (start, True)):
                if (after.value - bound) * (bound - before.value) >= 0 and before.value != bound:
                    share = (bound - before.value) / (after.value - before.value)
                    guess = link.at(before.unknowns + share * (after.unknowns - before.unknowns))
                    return Path((*points, problem.solved(guess, bound)), tuple(turns), returned)
            if before.measures[SLOPE] * after.measures[SLOPE] < 0:
                turns.append(len(points) - 1)
            points.append(PathPoint(link.at(after.unknowns), after.value, after.measures[TANGENCY]))
    except UNSOLVED as error:
        if not points:
            return Path((), (), gap=Gap(problem.course, GapCause.UNMATCHED, error=str(error)))
    last = points[-1]
    gap = Gap(problem.course, GapCause.UNFOLLOWED, values=(last.value,), duration=last.link.duration)
    return Path(tuple(points), tuple(turns), gap=gap)


def halfway(problem: LinkProblem, first: PathPoint, second: PathPoint) -> PathPoint | None:
    """Return the point of a path on the plane halfway along the chord of two points and normal to it, or None.

    It bisects a path around a turn, at which the path is no function of the followed quantity. The result is None if
    Newton's method fails.

    Args:
        problem: matching of two tubes.
        first: point of a path.
        second: another point of the same path.
    """
    start, curve_of_links = first.coordinates, LinkCurve(problem, first.link)
    chord = second.coordinates - start
    weights = np.maximum(np.abs(chord), 1e-3 * np.array([1.0, 1.0, first.link.duration, curve_of_links.scale]))
    tangent = chord / weights / np.linalg.norm(chord / weights)
    try:
        solution = Curve(curve_of_links, weights, _ON_CURVE, _ROUNDED).onto(start + chord / 2, tangent)
    except UNSOLVED:
        return None
    link, value = first.link.at(solution.unknowns), float(solution.unknowns[3])
    return PathPoint(link, value, problem.match(link, value).tangency) if solution.residual < _ROUNDED else None


_SAMPLES = 300  # per half of a flight, about twenty per swing of an arm


@dataclass(frozen=True)
class Profile(Brief):
    """Heights of a connection over its section.

    Attributes:
        heights (M,): at the ends and all extrema.
        states (M, N): same points.
        count: number of crossings.
    """

    heights: Array
    states: Array
    count: int


def fly_whole(problem: LinkProblem, link: Link, value: float) -> tuple[Array, Array]:
    """Return the whole flight of a connection from the seed of its source's tube to that of its target's.

    A seed is a state at a small distance from the periodic orbit, along its unstable vector or the image of this vector
    under time reversal.

    Args:
        problem: matching of two tubes.
        link: solution.
        value: value of the followed quantity.

    Returns:
        Times (M,), s, and states (M, N).
    """
    half, manifolds = np.linspace(0.0, link.duration / 2, _SAMPLES + 1), problem.manifolds(value)
    source_half, target_half = (
        manifold.orbit.system.propagator.sample(manifold.seeds(np.array([phase]), branch)[0][0], half)
        for manifold, phase, branch in zip(manifolds, link.phases, link.branches, strict=True)
    )
    target_half = (
        problem.turned(target_half, manifolds[1].orbit.centre) + np.asarray(link.turns) * problem.system.turn_lengths
    )
    return np.concatenate([half, link.duration - half[::-1][1:]]), np.vstack([source_half, target_half[::-1][1:]])


def profile(problem: LinkProblem, link: Link, value: float) -> Profile:
    """Return a solved connection's heights over its section at all extrema, and its number of section crossings.

    The height is the signed distance n·x - offset from the section. It is zero, or a multiple of the section's period,
    at a crossing. Crossings are counted between extrema, since the height is monotonic there.

    Args:
        problem: matching of two tubes.
        link: solution.
        value: value of the followed quantity.
    """
    times, states = fly_whole(problem, link, value)
    system, section = problem.course.at(value)[0], problem.section(value)
    rates = system.numeric.rate(states) @ np.asarray(section.normal)
    extremum_samples = np.flatnonzero(np.sign(rates[:-1]) * np.sign(rates[1:]) < 0)
    extrema = [
        _extremum(system, states[k], times[k + 1] - times[k], rates[k] / (rates[k] - rates[k + 1]), section)
        for k in extremum_samples
    ]
    knots, heights = np.array([states[0], *extrema, states[-1]]), section.height(states)
    ends = [0, *extremum_samples.tolist(), len(times) - 1]
    levels, count = section.height(knots), 0
    for k in range(len(levels) - 1):
        low, high = sorted(levels[k : k + 2])
        period = section.period
        crossed = int(np.floor(high / period) - np.floor(low / period)) if period else int(low < 0 <= high)
        if crossed and section.side is not None:
            # On a one-sided section, the state at the crossing decides.
            nearest_sample = int(np.argmin(np.abs(heights[ends[k] : ends[k + 1] + 2]))) + ends[k]
            crossed = int(section.admits(states[nearest_sample]))
        count += crossed
    return Profile(levels, knots, count)


def first_crossing(problem: LinkProblem, link: Link, value: float) -> Array | None:
    """Return the state (N,) at which a connection first crosses its section, with whole turns counted.

    The result is None if it never crosses on the side where crossings count.

    Args:
        problem: matching of two tubes.
        link: solution.
        value: value of the followed quantity.
    """
    system, section = problem.course.at(value)[0], problem.section(value)
    _, states = fly_whole(problem, link, value)
    heights, sheets = section.height(states), section.sheets(states)
    for k in np.flatnonzero(np.diff(sheets)):
        height = max(sheets[k], sheets[k + 1]) * section.period if section.period else 0.0
        crossing = states[k] + (states[k + 1] - states[k]) * (height - heights[k]) / (heights[k + 1] - heights[k])
        # Three Newton steps in time refine the linear interpolation between samples.
        for _ in range(3):
            rate = float(system.numeric.rate(crossing) @ section.normal)
            crossing = system.propagator.flow(crossing, float(height - section.height(crossing)) / rate)
        if section.admits(crossing):
            return crossing
    return None


def _extremum(system: System, state: Array, span: float, share: float, section: Section) -> Array:
    """Return the state (N,) at an extremum of the height over a section, found by Newton's method in time.

    Args:
        system: system of the trajectory.
        state (N,): first of two samples around the extremum.
        span: time between the samples, s.
        share: initial guess as a share of the span.
        section: section from which the height is measured.
    """
    numeric, propagator, normal = system.numeric, system.propagator, np.asarray(section.normal)
    step = share * span
    for _ in range(4):
        trial = propagator.flow(state, step)
        rate = numeric.rate(trial)
        step = float(np.clip(step - (normal @ rate) / (normal @ (numeric.jacobian(trial) @ rate)), 0.0, span))
    return propagator.flow(state, step)
