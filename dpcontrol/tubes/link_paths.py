"""Following one connection in energy, round every turn.

The curve F(φ_u, φ_s, T; H) = 0 (module links) is followed by pseudo-arclength: predicted along the null vector of
[∂F/∂(φ_u, φ_s, T), ∂F/∂H], corrected by Newton's method on the plane across it, so that it may turn back in energy.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.tubes.links import Link, LinkProblem

Array = NDArray[np.float64]

_MATCHED = 1e-10  # scaled gap
_ROUNDED = 1e-8  # scaled gap that rounding alone may leave
_AT_REST = 1e-7  # of a step of Newton's method, in units of the weights


@dataclass(frozen=True)
class PathPoint:
    """One solved point of a path: the link, its energy in J, its tangency σ."""

    link: Link
    energy: float
    tangency: float


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
        by_energy = _energy_slope(problem, here.link, here.energy, 1e-5 * problem.system.energy_scale)
        slope = -np.linalg.lstsq(match.jacobian, by_energy, rcond=1e-13)[0]
        guess = here.link.at(here.link.unknowns + slope * (energy - here.energy))
        link, match = problem.solved(guess, energy)
    except (ArithmeticError, InputError, np.linalg.LinAlgError):
        return None
    moved = np.abs(link.unknowns - guess.unknowns) / np.array([0.02, 0.02, 0.02 * link.duration])
    if np.any(moved > 1.0) or match.tangency * here.tangency <= 0:
        return None
    if problem.symmetry(link) != problem.symmetry(here.link):
        return None
    return PathPoint(link, energy, match.tangency)


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
        link, match = problem.solved(link, start)
        points.append(PathPoint(link, start, match.tangency))
        symmetry = problem.symmetry(link)
        tangent = _tangent(problem, link, start, weights, np.array([0.0, 0.0, 0.0, np.sign(way)]))
        length = 0.25
        for _ in range(steps):
            here = np.append(points[-1].link.unknowns, points[-1].energy)
            arrived = _corrected(problem, link, here + length * tangent * weights, tangent, weights)
            bent = arrived is not None and _bend(arrived[0] - here, tangent, weights) < 0.9
            # A first step that ends behind the start has overrun a turn next to it.
            overrun = arrived is not None and len(points) == 1 and (arrived[0][3] - start) * way <= 0
            # Next to a pitchfork a long step changes from the pair to the symmetric connection, or back.
            switched = arrived is not None and problem.symmetry(link.at(arrived[0][:3])) != symmetry
            if arrived is None or bent or overrun or switched:
                length /= 2
                if length < 1e-5:
                    return _lost(points, turns, problem, "Newton's method fails at the smallest step")
                continue
            unknowns, tangency = arrived
            energy = float(unknowns[3])
            for bound, outcome in ((goal, "reached"), (start, "back")):
                if (energy - bound) * (bound - points[-1].energy) >= 0 and points[-1].energy != bound:
                    share = (bound - points[-1].energy) / (energy - points[-1].energy)
                    last, match = problem.solved(link.at((here + share * (unknowns - here))[:3]), bound)
                    points.append(PathPoint(last, bound, match.tangency))
                    return Path(tuple(points), tuple(turns), outcome, "")
            following = _tangent(problem, link.at(unknowns[:3]), energy, weights, tangent)
            if following[3] * tangent[3] < 0:
                turns.append(len(points) - 1)
            points.append(PathPoint(link.at(unknowns[:3]), energy, tangency))
            tangent = following
            length = min(1.4 * length, 0.5)
    except (ArithmeticError, InputError, np.linalg.LinAlgError) as error:
        return _lost(points, turns, problem, str(error))
    return _lost(points, turns, problem, f"not arrived after {steps} steps")


def halfway(problem: LinkProblem, first: PathPoint, second: PathPoint) -> PathPoint | None:
    """Return the point of a path on the plane halfway between two of its points and across their chord; None where
    Newton's method does not find it."""
    start = np.append(first.link.unknowns, first.energy)
    chord = np.append(second.link.unknowns, second.energy) - start
    weights = np.maximum(np.abs(chord), 1e-3 * np.array([1.0, 1.0, first.link.duration, problem.system.energy_scale]))
    tangent = chord / weights / np.linalg.norm(chord / weights)
    try:
        arrived = _corrected(problem, first.link, start + chord / 2, tangent, weights)
    except (ArithmeticError, InputError, np.linalg.LinAlgError):
        return None
    if arrived is None:
        return None
    return PathPoint(first.link.at(arrived[0][:3]), float(arrived[0][3]), arrived[1])


def _lost(points: list[PathPoint], turns: list[int], problem: LinkProblem, why: str) -> Path:
    if not points:
        return Path((), (), "lost", f"a connection could not be matched: {why}")
    last = points[-1]
    reason = f"a connection with a flight of {last.link.duration:.3g} s could not be followed beyond "
    return Path(tuple(points), tuple(turns), "lost", reason + f"{last.energy:.9g} J: {why}")


def _bend(step: Array, tangent: Array, weights: Array) -> float:
    scaled = step / weights
    return float(scaled @ tangent / np.linalg.norm(scaled))


def _energy_slope(problem: LinkProblem, link: Link, energy: float, width: float) -> Array:
    """Return ∂F/∂H (N,) by a central difference; Newton's method needs no more."""
    difference = problem.match(link, energy + width).gap - problem.match(link, energy - width).gap
    return difference / (2 * width)


def _extended(problem: LinkProblem, link: Link, energy: float, weights: Array) -> tuple[Array, Array, float]:
    """Return gap (N,), scaled derivative (N, 4) by (φ_u, φ_s, T, H) and σ."""
    match = problem.match(link, energy)
    slope = _energy_slope(problem, link, energy, 1e-5 * problem.system.energy_scale)
    return match.gap, np.column_stack([match.jacobian, slope]) * weights, match.tangency


def _tangent(problem: LinkProblem, link: Link, energy: float, weights: Array, heading: Array) -> Array:
    """Return the unit tangent (4,) of the curve, scaled, along `heading`: the last singular vector."""
    _, jacobian, _ = _extended(problem, link, energy, weights)
    tangent = np.linalg.svd(jacobian)[2][-1]
    return tangent if tangent @ heading >= 0 else -tangent


def _corrected(
    problem: LinkProblem, link: Link, guess: Array, tangent: Array, weights: Array
) -> tuple[Array, float] | None:
    """Return (unknowns (4,), σ) of the curve's point on the plane through `guess`, None where it is not found."""
    unknowns, slope = guess, None
    for _ in range(8):
        here = link.at(unknowns[:3])
        match = problem.match(here, float(unknowns[3]))
        off = float(tangent @ ((unknowns - guess) / weights))
        residual = float(np.abs(match.gap).max())
        if residual < _MATCHED and abs(off) < 1e-8:
            return unknowns, match.tangency
        if slope is None:
            slope = _energy_slope(problem, here, float(unknowns[3]), 1e-5 * problem.system.energy_scale)
        jacobian = np.vstack([np.column_stack([match.jacobian, slope]) * weights, tangent])
        step = np.linalg.lstsq(jacobian, -np.append(match.gap, off), rcond=1e-13)[0]
        length = float(np.linalg.norm(step))
        if length > 2.0:
            return None
        if length < _AT_REST and residual < _ROUNDED and abs(off) < 1e-8:
            # Where multipliers are large, rounding keeps the gap from falling, but moves the solution no more.
            return unknowns, match.tangency
        unknowns = unknowns + step * weights
    return None
