"""Connections as points of curves in energy: matching without a section.

A connection leaves the seed circle γ(φ_u) ± δ v(φ_u) of its source's unstable manifold and after a time T arrives on
that of its target's stable manifold, at phase φ_s. With X_u(φ_u, t) the seed flown forward and X_s(φ_s, t) backward,

    F(φ_u, φ_s, T; H) = X_u(φ_u, T/2) - X_s(φ_s, T/2) - whole turns = 0,

four equations of which one (energy) is redundant, for three unknowns at every energy H. No section appears: where the
connection meets one, how often, and whether it grazes it, makes no difference here. The tangent spaces of the two
manifolds are spanned by (∂X_u/∂φ_u, f) and (∂X_s/∂φ_s, f); they coincide, and the connection is tangent, where

    σ = det[∂X_u/∂φ_u, -∂X_s/∂φ_s, f, ∇H] = 0        (columns scaled to length one).

A homoclinic that a reverser R carries to itself has its midpoint on Fix R (2 equations for φ, T). There R splits the
tangent D = ∂X_u/∂φ into D₊ (fixed by R, and across ∇H) and D₋ (turned over, modulo f). σ is a product of a = D₋ and
b = D₊: at a = 0 two symmetric connections meet, at b = 0 the symmetric one sheds a mirror pair.

Source: Champneys & Kuznetsov, Numerical detection and continuation of codimension-two homoclinic bifurcations (1994);
Vanderbauwhede & Fiedler (1992) for the reversible case.

The curve F(φ_u, φ_s, T; H) = 0 is followed by pseudo-arclength: predicted along the null vector of
[∂F/∂(φ_u, φ_s, T), ∂F/∂H], corrected by Newton's method on the plane across it, so that it may turn back in energy.

How often a connection crosses its section is counted on its flight's heights over it, extremum by extremum.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.orbits.lyapunov import (
    LyapunovOrbit,
    SymmetricShooting,
    described_orbit,
    lyapunov_orbit,
    symmetric_shooting,
)
from dpcontrol.orbits.manifold import UnstableManifold


@dataclass(frozen=True)
class Link:
    """A connection from seed to seed: branches (±1, ±1), phases φ_u and φ_s, duration T in s, whole turns (N,)."""

    branches: tuple[int, int]
    phases: tuple[float, float]
    duration: float
    turns: tuple[float, ...]

    @property
    def unknowns(self) -> Array:
        """(φ_u, φ_s, T)."""
        return np.array([*self.phases, self.duration])

    def at(self, unknowns: Sequence[float] | Array) -> "Link":
        """Return the link moved to unknowns (3,)."""
        return replace(self, phases=(float(unknowns[0]), float(unknowns[1])), duration=float(unknowns[2]))


@dataclass(frozen=True)
class PathPoint:
    """One solved point of a path: the link, its energy in J, its tangency σ."""

    link: Link
    energy: float
    tangency: float

    @property
    def coordinates(self) -> Array:
        """(φ_u, φ_s, T, H)."""
        return np.append(self.link.unknowns, self.energy)


@dataclass(frozen=True)
class Match:
    """How two tubes meet: gap (N,), scaled; its derivative (N, 3) by (φ_u, φ_s, T); tangency σ; state (N,) midway."""

    gap: Array
    jacobian: Array
    tangency: float
    state: Array


@dataclass(frozen=True)
class MirrorMatch:
    """How a tube meets a fixed set: miss (n,), scaled; a and b as in the module's text."""

    miss: Array
    fold: float
    shedding: float


def phase_gap(first: float, second: float) -> float:
    """Return the difference of phases between -½ and ½."""
    return (first - second + 0.5) % 1.0 - 0.5


class LinkProblem:
    """Matching between the tubes of two saddles at any energy; orbits are kept by energy.

    distance: of the seeds from their orbits, scaled. Systems of two degrees of freedom only.
    """

    def __init__(self, system: System, source: str, target: str, *, distance: float) -> None:
        if system.dimension != 4:
            raise InputError(
                f"{system.name} has {system.dimension // 2} degrees of freedom: connections are followed in energy "
                "for two, where tubes are surfaces in a three-dimensional energy level"
            )
        self.system, self.source, self.target, self.distance = system, source, target, distance
        self._shooting: dict[str, SymmetricShooting] = {}
        self._manifolds: dict[tuple[str, float], UnstableManifold] = {}
        self._guesses: dict[str, dict[float, Array]] = {}

    def _orbit(self, saddle: str, energy: float) -> LyapunovOrbit:
        """Return the orbit at `energy`, by Newton's method from the nearest one that is known."""
        if saddle not in self._shooting:
            self._shooting[saddle], _ = symmetric_shooting(self.system, saddle, 0)
        problem, known = self._shooting[saddle], self._guesses.setdefault(saddle, {})
        floor = float(self.system.numeric.hamiltonian(problem.centre))
        near = min(known, key=lambda e: abs(e - energy), default=floor)
        # Unknowns grow as the root of the height above the saddle, so a guess from far off is no guess.
        if near != floor and 0.8 < (energy - floor) / (near - floor) < 1.25:
            found, residual = problem.at_energy(known[near], energy, iterations=10, tolerance=1e-13)
            if residual < 1e-12:
                known[energy] = found
                return described_orbit(
                    problem, found, saddle=saddle, family=0, energy=energy, newton_residual=residual, converged=True,
                    status=f"converged from the orbit at {near:.9g} J",
                )  # fmt: skip
        orbit = lyapunov_orbit(self.system, saddle, energy=energy)
        if not orbit.converged:
            raise ArithmeticError(f"the Lyapunov orbit about {saddle} at {energy:.9g} J: {orbit.status}")
        c = problem.start.T @ (orbit.state - problem.centre)
        known[energy] = np.append(c, orbit.period / problem.quarters)
        return orbit

    def manifold(self, saddle: str, energy: float) -> UnstableManifold:
        """Return the unstable manifold of a saddle's orbit at `energy`, its vector turned as at the first energy.

        Raises:
            ArithmeticError: the orbit did not converge.
            InputError: no orbit exists at that energy.
        """
        if (saddle, energy) not in self._manifolds:
            manifold = UnstableManifold(self._orbit(saddle, energy), self.distance)
            kept = [m for (name, _), m in self._manifolds.items() if name == saddle]
            if kept:
                nearest = min(kept, key=lambda m: abs(m.orbit.energy - energy))
                scale = self.system.scale**2
                if float(np.sum(nearest.vector * manifold.vector / scale)) < 0:
                    # A branch is a side of the orbit; the side may not change its name from energy to energy.
                    manifold.__dict__["vector"] = -manifold.vector
            self._manifolds[saddle, energy] = manifold
        return self._manifolds[saddle, energy]

    def manifolds(self, energy: float) -> tuple[UnstableManifold, UnstableManifold]:
        """Return source's and target's manifolds; one object where they are the same."""
        return self.manifold(self.source, energy), self.manifold(self.target, energy)

    def _flown(self, manifold: UnstableManifold, branch: int, phase: float, seconds: float) -> tuple[Array, Array]:
        """Return the seed's state after `seconds` and its derivative by phase."""
        seeds, slopes = manifold.seeds(np.array([phase]), branch)
        state, stm = self.system.propagator.flow_with_stm(seeds[0], seconds)
        return state, stm @ slopes[0]

    def turned(self, states: Array) -> Array:
        """Return states (…, N) turned around in time about the target."""
        centre = self.system.equilibrium(self.target)
        return (states - centre) @ self.system.reversers[0].T + centre

    def match(self, link: Link, energy: float) -> Match:
        """Fly both tubes to the middle of the connection and compare.

        Raises:
            ArithmeticError: an orbit did not converge or a state became infinite.
        """
        system, scale = self.system, self.system.scale
        first, second = self.manifolds(energy)
        half = link.duration / 2
        xu, du = self._flown(first, link.branches[0], link.phases[0], half)
        back, ds = self._flown(second, link.branches[1], link.phases[1], half)
        xs, ds = self.turned(back), system.reversers[0] @ ds
        gap = (xu - xs - np.asarray(link.turns) * system.turn_lengths) / scale
        along = (system.numeric.rate(xu) + system.numeric.rate(xs)) / 2
        jacobian = np.column_stack([du, -ds, along]) / scale[:, None]
        columns = np.column_stack([jacobian, system.numeric.gradient(xu) * scale])
        tangency = float(np.linalg.det(columns / np.linalg.norm(columns, axis=0)))
        return Match(gap, jacobian, tangency, xu)

    def mirror(self, link: Link, energy: float, which: int) -> MirrorMatch:
        """Fly the unstable tube to the middle of the connection and compare with the fixed set of reverser `which`."""
        system, scale = self.system, self.system.scale
        manifold = self.manifold(self.source, energy)
        x, slope = self._flown(manifold, link.branches[0], link.phases[0], link.duration / 2)
        reverser = system.reversers[which]
        turned_over = (np.eye(4) - reverser) / 2
        off = turned_over @ (x - manifold.orbit.centre)
        half = system.turn_lengths / 2
        off = off - np.rint(np.divide(off, half, out=np.zeros_like(off), where=half > 0)) * half
        rows = np.linalg.svd(turned_over / scale[:, None])[0][:, :2].T
        miss = rows @ (off / scale)
        rate = turned_over @ system.numeric.rate(x)
        d_minus, f_minus = rows @ (turned_over @ slope / scale), rows @ (rate / scale)
        basis = np.linalg.svd((np.eye(4) + reverser) / 2 / scale[:, None])[0][:, :2].T
        d_plus = basis @ (slope / scale)
        normal = basis @ (system.numeric.gradient(x) * scale)
        # Not by (a, b) itself, which all but vanishes where both kinds of event fall together.
        size = float(np.linalg.norm(slope / scale))
        fold, shedding = (
            float((d[0] * along[1] - d[1] * along[0]) / np.linalg.norm(along)) / size
            for d, along in ((d_minus, f_minus), (d_plus, normal))
        )
        return MirrorMatch(miss, fold, shedding)

    def symmetry(self, link: Link, within: float = 1e-6) -> int | None:
        """Return which reverser carries the link to itself, None if none does."""
        for which in range(len(self.system.reversers)):
            image = self.mirrored(link, which)
            if image is not None and self.distance_between(link, image) < within:
                return which
        return None

    def mirrored(self, link: Link, which: int) -> Link | None:
        """Return the image of a homoclinic link under a reverser; None between different saddles."""
        if self.source != self.target:
            return None
        if which == 0:
            return replace(link, branches=link.branches[::-1], phases=link.phases[::-1])
        half = next(iter(self._manifolds.values())).half_turn
        assert half is not None
        sign = int(half[1])
        branches = (sign * link.branches[1], sign * link.branches[0])
        return replace(link, branches=branches, phases=(link.phases[1] + 0.5, link.phases[0] + 0.5))

    def distance_between(self, first: Link, second: Link) -> float:
        """Return how far apart two links are in phases and relative duration; infinite on different branches."""
        if first.branches != second.branches:
            return float("inf")
        gaps = [abs(phase_gap(a, b)) for a, b in zip(first.phases, second.phases, strict=True)]
        return max(*gaps, abs(first.duration / second.duration - 1))

    def solved(self, link: Link, energy: float, *, iterations: int = 12) -> PathPoint:
        """Solve F = 0 for the link nearest to a guess.

        Raises:
            ArithmeticError: Newton's method left the neighbourhood or did not converge.
        """
        best, smallest = None, np.inf
        guess = link.unknowns
        reach = np.array([0.1, 0.1, 0.2 * link.duration])
        for _ in range(iterations):
            match = self.match(link, energy)
            residual = float(np.abs(match.gap).max())
            here = PathPoint(link, energy, match.tangency)
            if best is None or residual < smallest:
                best, smallest = here, residual
            elif smallest < 1e-10:
                break
            step = np.linalg.lstsq(match.jacobian, match.gap, rcond=1e-13)[0]
            # Where multipliers are large, rounding keeps the gap from falling, but moves the solution no more.
            if residual < 1e-8 and np.all(np.abs(step) < 1e-7 * reach):
                return here
            shrink = min(1.0, 0.3 / float(np.max(np.abs(step) / reach)) if np.any(step) else 1.0)
            link = link.at(link.unknowns - shrink * step)
            if np.any(np.abs(link.unknowns - guess) > reach) or link.duration <= 0:
                break
        if best is None or smallest > 1e-9:
            raise ArithmeticError(f"not matched: gap {smallest:.1e}")
        return best


UNSOLVED = (ArithmeticError, InputError, np.linalg.LinAlgError)
"""What Newton's method may fail by where it is led astray: beyond some energies there are not even orbits."""
_MATCHED = 1e-10  # scaled gap
_ROUNDED = 1e-8  # scaled gap that rounding alone may leave
_AT_REST = 1e-7  # of a step of Newton's method, in units of the weights


@dataclass(frozen=True)
class Path:
    """A connection followed in energy. outcome: "reached" the goal, came "back" to the start, or "lost" with a reason.

    turns: indexes of points after which the path turns back in energy.
    """

    points: tuple[PathPoint, ...]
    turns: tuple[int, ...]
    outcome: str
    reason: str


def carry(problem: LinkProblem, point: PathPoint, goal: float, *, smallest: float = 1 / 32) -> PathPoint | None:
    """Carry a solved connection to energy `goal` where it does not turn on the way, None where it may.

    Each step is predicted along ∂(φ_u, φ_s, T)/∂H and solved at fixed energy; the tangency σ must keep its sign, as it
    does not across a turn. Cheaper than `follow`, which rounds turns.
    """
    way = goal - point.energy
    done, share, here = 0.0, 1.0, point
    while done < 1.0:
        following = min(1.0, done + share)
        energy = goal if following == 1.0 else point.energy + following * way
        arrived = _stepped(problem, here, energy)
        if arrived is None:
            share /= 2
            if share < smallest:
                return None
            continue
        here, done = arrived, following
        share *= 2
    return here


def _stepped(problem: LinkProblem, here: PathPoint, energy: float) -> PathPoint | None:
    """Return the connection at a nearby energy, None where the prediction was poor or the tangency changed its sign."""
    try:
        match = problem.match(here.link, here.energy)
        by_energy = _energy_slope(problem, here.link, here.energy)
        slope = -np.linalg.lstsq(match.jacobian, by_energy, rcond=1e-13)[0]
        guess = here.link.at(here.link.unknowns + slope * (energy - here.energy))
        arrived = problem.solved(guess, energy)
    except UNSOLVED:
        return None
    reach = 0.02 * np.array([1.0, 1.0, arrived.link.duration])
    poor = np.any(np.abs(arrived.link.unknowns - guess.unknowns) > reach)
    turned = arrived.tangency * here.tangency <= 0
    return None if poor or turned or problem.symmetry(arrived.link) != problem.symmetry(here.link) else arrived


def follow(problem: LinkProblem, link: Link, start: float, goal: float, *, steps: int = 120) -> Path:
    """Follow a connection that is solved at energy `start` towards `goal`, round every turn, until it arrives there
    or comes back."""
    way = goal - start
    # Turns are parabolas: over a small stretch of energy phases move as its root.
    size = 0.05 * min(1.0, float(np.sqrt(100 * abs(way) / problem.system.energy_scale)))
    weights = np.array([size, size, size * link.duration, abs(way)])
    points: list[PathPoint] = []
    turns: list[int] = []
    try:
        points.append(problem.solved(link, start))
        link = points[0].link
        symmetry = problem.symmetry(link)
        tangent = _tangent(problem, link, start, weights, np.array([0.0, 0.0, 0.0, np.sign(way)]))
        length = 0.25
        for _ in range(steps):
            here = points[-1].coordinates
            arrived = _corrected(problem, link, here + length * tangent * weights, tangent, weights)
            moved = np.zeros(4) if arrived is None else (arrived.coordinates - here) / weights
            if (
                arrived is None
                or moved @ tangent < 0.9 * np.linalg.norm(moved)
                # A first step that ends behind the start has overrun a turn next to it.
                or (len(points) == 1 and (arrived.energy - start) * way <= 0)
                # Next to a pitchfork a long step changes from the pair to the symmetric connection, or back.
                or problem.symmetry(arrived.link) != symmetry
            ):
                length /= 2
                if length < 1e-5:
                    raise ArithmeticError("Newton's method fails at the smallest step")
                continue
            energy = arrived.energy
            for bound, outcome in ((goal, "reached"), (start, "back")):
                if (energy - bound) * (bound - points[-1].energy) >= 0 and points[-1].energy != bound:
                    share = (bound - points[-1].energy) / (energy - points[-1].energy)
                    points.append(problem.solved(link.at((here + share * (arrived.coordinates - here))[:3]), bound))
                    return Path(tuple(points), tuple(turns), outcome, "")
            following = _tangent(problem, arrived.link, energy, weights, tangent)
            if following[3] * tangent[3] < 0:
                turns.append(len(points) - 1)
            points.append(arrived)
            tangent = following
            length = min(1.4 * length, 0.5)
        raise ArithmeticError(f"not arrived after {steps} steps")
    except UNSOLVED as error:
        reason = f"a connection could not be matched: {error}"
        if points:
            last = points[-1]
            reason = (
                f"a connection with a flight of {last.link.duration:.3g} s could not be followed beyond "
                f"{last.energy:.9g} J: {error}"
            )
        return Path(tuple(points), tuple(turns), "lost", reason)


def halfway(problem: LinkProblem, first: PathPoint, second: PathPoint) -> PathPoint | None:
    """Return the point of a path on the plane halfway between two of its points and across their chord; None where
    Newton's method does not find it."""
    start = first.coordinates
    chord = second.coordinates - start
    weights = np.maximum(np.abs(chord), 1e-3 * np.array([1.0, 1.0, first.link.duration, problem.system.energy_scale]))
    tangent = chord / weights / np.linalg.norm(chord / weights)
    try:
        return _corrected(problem, first.link, start + chord / 2, tangent, weights)
    except UNSOLVED:
        return None


def _energy_slope(problem: LinkProblem, link: Link, energy: float) -> Array:
    """Return ∂F/∂H (N,) by a central difference; Newton's method needs no more."""
    width = 1e-5 * problem.system.energy_scale
    difference = problem.match(link, energy + width).gap - problem.match(link, energy - width).gap
    return difference / (2 * width)


def _tangent(problem: LinkProblem, link: Link, energy: float, weights: Array, heading: Array) -> Array:
    """Return the unit tangent (4,) of the curve, scaled, along `heading`: the last singular vector."""
    jacobian = np.column_stack([problem.match(link, energy).jacobian, _energy_slope(problem, link, energy)])
    tangent = np.linalg.svd(jacobian * weights)[2][-1]
    return tangent if tangent @ heading >= 0 else -tangent


def _corrected(
    problem: LinkProblem, link: Link, guess: Array, tangent: Array, weights: Array
) -> PathPoint | None:  # fmt: skip
    """Return the curve's point on the plane through `guess` (4,), None where it is not found."""
    unknowns, slope = guess, None
    for _ in range(8):
        here = PathPoint(link.at(unknowns[:3]), float(unknowns[3]), 0.0)
        match = problem.match(here.link, here.energy)
        off = float(tangent @ ((unknowns - guess) / weights))
        residual = float(np.abs(match.gap).max())
        if residual < _MATCHED and abs(off) < 1e-8:
            return replace(here, tangency=match.tangency)
        if slope is None:
            slope = _energy_slope(problem, here.link, here.energy)
        jacobian = np.vstack([np.column_stack([match.jacobian, slope]) * weights, tangent])
        step = np.linalg.lstsq(jacobian, -np.append(match.gap, off), rcond=1e-13)[0]
        length = float(np.linalg.norm(step))
        if length > 2.0:
            return None
        if length < _AT_REST and residual < _ROUNDED and abs(off) < 1e-8:
            # Where multipliers are large, rounding keeps the gap from falling, but moves the solution no more.
            return replace(here, tangency=match.tangency)
        unknowns = unknowns + step * weights
    return None


_SAMPLES = 300  # of each half of a flight: about twenty to an arm's swing


@dataclass(frozen=True)
class Profile:
    """How a connection's flight runs over the section's heights.

    heights (M,) and states (M, N): at its ends and at every extremum between; count: crossings in all.
    """

    heights: Array
    states: Array
    count: int


def fly_whole(problem: LinkProblem, link: Link, energy: float) -> tuple[Array, Array]:
    """Return times (M,) s from the seed and states (M, N) of the whole flight, from seed to seed."""
    half = np.linspace(0.0, link.duration / 2, _SAMPLES + 1)
    out, back = (
        problem.system.propagator.sample(manifold.seeds(np.array([phase]), branch)[0][0], half)
        for manifold, phase, branch in zip(problem.manifolds(energy), link.phases, link.branches, strict=True)
    )
    back = problem.turned(back) + np.asarray(link.turns) * problem.system.turn_lengths
    return np.concatenate([half, link.duration - half[::-1][1:]]), np.vstack([out, back[::-1][1:]])


def profile(problem: LinkProblem, link: Link, energy: float, section: Section) -> Profile:
    """Count a solved connection's crossings of a section, monotonic part by monotonic part."""
    times, states = fly_whole(problem, link, energy)
    rates = problem.system.numeric.rate(states) @ np.asarray(section.normal)
    turning = np.flatnonzero(np.sign(rates[:-1]) * np.sign(rates[1:]) < 0)
    extrema = [
        _extremum(problem, states[k], times[k + 1] - times[k], rates[k] / (rates[k] - rates[k + 1]), section)
        for k in turning
    ]
    knots, heights = np.array([states[0], *extrema, states[-1]]), section.height(states)
    ends = [0, *turning.tolist(), len(times) - 1]
    levels, count = section.height(knots), 0
    for k in range(len(levels) - 1):
        low, high = sorted(levels[k : k + 2])
        period = section.period
        crossed = int(np.floor(high / period) - np.floor(low / period)) if period else int(low < 0 <= high)
        if crossed and section.side is not None:
            # With a side to it the crossing's own state decides.
            at = int(np.argmin(np.abs(heights[ends[k] : ends[k + 1] + 2]))) + ends[k]
            crossed = int(section.admits(states[at]))
        count += crossed
    return Profile(levels, knots, count)


def first_crossing(problem: LinkProblem, link: Link, energy: float, section: Section) -> Array | None:
    """Return the state (N,) at which a solved connection first crosses a section, on the lift."""
    system = problem.system
    _, states = fly_whole(problem, link, energy)
    heights, sheets = section.height(states), section.sheets(states)
    for k in np.flatnonzero(np.diff(sheets)):
        height = max(sheets[k], sheets[k + 1]) * section.period if section.period else 0.0
        x = states[k] + (states[k + 1] - states[k]) * (height - heights[k]) / (heights[k + 1] - heights[k])
        for _ in range(3):
            rate = float(system.numeric.rate(x) @ section.normal)
            x = system.propagator.flow(x, float(height - section.height(x)) / rate)
        if section.admits(x):
            return x
    return None


def _extremum(problem: LinkProblem, state: Array, span: float, share: float, section: Section) -> Array:
    """Return the state (N,) at the extremum of the section's height between two samples, by Newton on its rate.

    span: s between the samples, of which `state` is the first; share: of it, to begin with.
    """
    numeric, propagator, normal = problem.system.numeric, problem.system.propagator, np.asarray(section.normal)
    step = share * span
    for _ in range(4):
        x = propagator.flow(state, step)
        f = numeric.rate(x)
        step = float(np.clip(step - (normal @ f) / (normal @ (numeric.jacobian(x) @ f)), 0.0, span))
    return propagator.flow(state, step)
