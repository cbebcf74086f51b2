"""The equations that locate where a connection is born, splits, or grazes its section.

With F, a, b and σ of module links, h the height over the section and ḣ its rate, Newton's method solves

    saddle-node        F = 0, σ = 0             (φ_u, φ_s, T, H); for symmetric connections  off Fix R = 0, a = 0
    pitchfork          off Fix R = 0, b = 0     (φ, T, H)
    section artefact   F = 0, h = level, ḣ = 0  (φ_u, φ_s, T, time of touch, H)

of the last, the time of touch is eliminated by ḣ = 0, and the rest solved by a bracketed secant in H. A symmetric
connection may also touch with its midpoint, which stays on the section: there one crossing becomes three without an
extremum that moves across, and the equations are  off Fix R = 0, ḣ = 0  (φ, T, H).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from dpcontrol.bifurcations.links import (
    Link,
    LinkProblem,
    Path,
    PathPoint,
    Profile,
    fly_whole,
    halfway,
    phase_gap,
    profile,
)
from dpcontrol.dynamics.propagator import Section
from dpcontrol.foundation.errors import InputError

Array = NDArray[np.float64]

_HALVINGS = 8  # of the stretch of a path around a turn, before it is given up


@dataclass(frozen=True)
class Located:
    """A solved event: kind, energy in J, the link there, the state (N,) that shows it, residual of its equations."""

    kind: str
    energy: float
    link: Link
    state: Array
    residual: float


def _newton(function: Callable[[Array], Array], guess: Array, steps: Array) -> tuple[Array, float]:
    """Solve function(y) = 0 by Newton's method with central differences of width `steps`; best (y, residual).

    There may be more equations than unknowns, one being redundant.
    """
    y, best, smallest = guess, guess, np.inf
    for _ in range(10):
        value = function(y)
        residual = float(np.abs(value).max())
        if residual < smallest:
            best, smallest = y, residual
        elif smallest < 1e-9:
            break
        columns = [(function(y + h) - function(y - h)) / (2 * s) for h, s in zip(np.diag(steps), steps, strict=True)]
        y = y - np.linalg.lstsq(np.column_stack(columns), value, rcond=1e-13)[0]
        if np.any(np.abs(y - guess) > 1e4 * steps):
            # Farther than a tenth of everything is no solution near the guess; beyond it orbits may not even exist.
            break
    return best, smallest


def locate_turn(problem: LinkProblem, path: Path, index: int) -> Located | None:
    """Locate the turn after point `index` of a path, by the equations of its kind; None where they do not converge."""
    start = path.points[0].energy
    before, after = path.points[index : index + 2]
    for _ in range(_HALVINGS):
        for side in sorted((before, after), key=lambda p: -abs(p.energy - start)):
            reach = 0.2 * abs(start - side.energy) + 1e-3 * problem.system.energy_scale
            event = _turn_from(problem, side, before.link, after.link, reach)
            if event is not None:
                return event
        # Where the fold is sharp its equations converge from nearer points only: σ changes its sign across it.
        middle = halfway(problem, before, after)
        if middle is None or before.tangency * after.tangency > 0:
            return None
        before, after = (middle, after) if middle.tangency * before.tangency > 0 else (before, middle)
    return None


def _turn_from(problem: LinkProblem, extreme: PathPoint, before: Link, after: Link, reach: float) -> Located | None:
    """Locate a turn from one of the points beside it."""
    which = problem.symmetry(extreme.link)
    if which is not None:
        return _near(_on_mirror(problem, extreme, which, shedding=False), extreme.energy, reach)
    shed = None
    for mirror in range(len(problem.system.reversers)):
        image = problem.mirrored(extreme.link, mirror)
        # A pair turns back on the mirror; far from it there is no pitchfork to look for.
        if image is not None and problem.distance_between(extreme.link, image) < 0.1:
            shed = _near(_on_mirror(problem, extreme, mirror, shedding=True), extreme.energy, reach)
    if shed is not None and _exchanged(problem, before, after):
        return shed
    turned = _near(_tangent(problem, extreme), extreme.energy, reach)
    # On the mirror a saddle-node's equations are degenerate: where both kinds are solved there, it is a pitchfork.
    if shed is not None and (turned is None or abs(turned.energy - shed.energy) < 1e-6 * problem.system.energy_scale):
        return shed
    return turned


def _near(event: Located | None, energy: float, reach: float) -> Located | None:
    return event if event is not None and event.residual < 1e-8 and abs(event.energy - energy) < reach else None


def _widths(problem: LinkProblem, link: Link) -> Array:
    """Return the widths (4,) of differences by (φ_u, φ_s, T, H)."""
    return 1e-5 * np.array([1.0, 1.0, link.duration, problem.system.energy_scale])


def _tangent(problem: LinkProblem, point: PathPoint) -> Located | None:
    """Solve F = 0, σ = 0 from a point near."""
    link = point.link

    def equations(y: Array) -> Array:
        match = problem.match(link.at(y[:3]), float(y[3]))
        return np.append(match.gap, match.tangency)

    try:
        y, residual = _newton(equations, np.append(link.unknowns, point.energy), _widths(problem, link))
        state = problem.match(link.at(y[:3]), float(y[3])).state
    except (ArithmeticError, InputError, np.linalg.LinAlgError):
        return None
    return Located("saddle-node", float(y[3]), link.at(y[:3]), state, residual)


def _on_mirror(problem: LinkProblem, point: PathPoint, which: int, *, shedding: bool) -> Located | None:
    """Solve off Fix R = 0 with b = 0 (shedding) or a = 0, from a symmetric connection or one of a pair near."""
    link = point.link
    image = problem.mirrored(link, which)
    assert image is not None
    # Halfway between a link and its image lies the symmetric one.
    phase = link.phases[0] + phase_gap(image.phases[0], link.phases[0]) / 2

    def placed(y: Array) -> Link:
        return link.at(np.array([y[0], y[0] + 0.5 * which, y[1]]))

    def equations(y: Array) -> Array:
        mirror = problem.mirror(placed(y), float(y[2]), which)
        return np.append(mirror.miss, mirror.shedding if shedding else mirror.fold)

    try:
        guess = np.array([phase, link.duration, point.energy])
        y, residual = _newton(equations, guess, _widths(problem, link)[[0, 2, 3]])
        state = problem.match(placed(y), float(y[2])).state
    except (ArithmeticError, InputError, np.linalg.LinAlgError):
        return None
    return Located("pitchfork" if shedding else "saddle-node", float(y[2]), placed(y), state, residual)


def _exchanged(problem: LinkProblem, before: Link, after: Link) -> bool:
    """Whether a reverser carries one side of a turn towards the other, as at a pitchfork."""
    for which in range(len(problem.system.reversers)):
        image, other = problem.mirrored(before, which), problem.mirrored(after, which)
        if image is None or other is None or image.branches != before.branches:
            continue
        first = phase_gap(before.phases[0], image.phases[0])
        second = phase_gap(after.phases[0], other.phases[0])
        if first * second < 0:
            return True
    return False


def locate_graze(problem: LinkProblem, section: Section, first: PathPoint, second: PathPoint) -> list[Located]:
    """Locate every touch of the section between two points of one path that differ in their crossings.

    The path must not turn between them. Returned in order of energy; empty where nothing brackets a touch.
    """
    middle = _middle_touch(problem, section, first, second)
    if middle is not None:
        return [middle]
    found: list[Located] = []
    _graze(problem, section, first, second, found, 0)
    return sorted(found, key=lambda e: e.energy)


def _graze(
    problem: LinkProblem, section: Section, first: PathPoint, second: PathPoint, found: list[Located], depth: int
) -> None:
    a, b = (profile(problem, p.link, p.energy, section) for p in (first, second))
    if a.count == b.count:
        return
    if len(a.levels) == len(b.levels):
        # The same extrema on both sides: those that changed their side of a level have touched it between.
        period = section.period or np.inf
        for k in range(1, len(a.heights) - 1):
            low, high = sorted((a.heights[k], b.heights[k]))
            level = np.ceil(low / period) * period if section.period else 0.0
            if low < level <= high:
                touch = _touch(problem, section, first, second, k, float(level), len(a.heights))
                if touch is not None:
                    found.append(touch)
        return
    if depth > 30:
        return
    energy = (first.energy + second.energy) / 2
    guess = first.link.at((first.link.unknowns + second.link.unknowns) / 2)
    try:
        link, match = problem.solved(guess, energy)
    except ArithmeticError:
        return
    middle = PathPoint(link, energy, match.tangency)
    _graze(problem, section, first, middle, found, depth + 1)
    _graze(problem, section, middle, second, found, depth + 1)


def _middle_touch(problem: LinkProblem, section: Section, first: PathPoint, second: PathPoint) -> Located | None:
    """Locate where a symmetric connection's midpoint turns tangent to the section; None where it does not."""
    which = problem.symmetry(first.link)
    if which is None or problem.symmetry(second.link) != which:
        return None
    normal, system = np.asarray(section.normal), problem.system
    states = [problem.match(p.link, p.energy).state for p in (first, second)]
    period = section.period or np.inf
    heights = [float(section.height(x)) for x in states]
    if any(abs(h - (np.rint(h / period) * period if section.period else 0.0)) > 1e-6 for h in heights):
        return None
    rates = [float(normal @ system.numeric.rate(x)) for x in states]
    if rates[0] * rates[1] > 0:
        return None
    share = rates[0] / (rates[0] - rates[1])
    guess = first.link.at(first.link.unknowns + share * (second.link.unknowns - first.link.unknowns))
    offset = guess.phases[1] - guess.phases[0]

    def placed(y: Array) -> Link:
        return guess.at(np.array([y[0], y[0] + offset, y[1]]))

    def tangent(y: Array) -> Array:
        energy = float(y[2])
        state = problem.match(placed(y), energy).state
        return np.append(problem.mirror(placed(y), energy, which).miss, normal @ system.numeric.rate(state) / 10)

    width = 1e-5
    start = np.array([guess.phases[0], guess.duration, first.energy + share * (second.energy - first.energy)])
    steps = np.array([width, width * guess.duration, width * system.energy_scale])
    try:
        y, residual = _newton(tangent, start, steps)
        low, high = sorted((first.energy, second.energy))
        if residual > 1e-8 or not low <= y[2] <= high:
            return None
        state = problem.match(placed(y), float(y[2])).state
    except (ArithmeticError, InputError, np.linalg.LinAlgError):
        return None
    return Located("section-artefact", float(y[2]), placed(y), state, residual)


def _touch(
    problem: LinkProblem, section: Section, first: PathPoint, second: PathPoint, k: int, level: float, length: int
) -> Located | None:
    """Solve for the energy at which the k-th extremum of the height lies on a level."""
    width = second.energy - first.energy
    kept: dict[float, tuple[Link, Profile]] = {}

    def above(energy: float) -> float:
        share = (energy - first.energy) / width
        guess = first.link.at(first.link.unknowns + share * (second.link.unknowns - first.link.unknowns))
        link, _ = problem.solved(guess, energy)
        flown = profile(problem, link, energy, section)
        if len(flown.heights) != length:
            raise ArithmeticError("an extremum vanished")
        kept[energy] = (link, flown)
        return float(flown.heights[k] - level)

    try:
        energy = float(brentq(above, first.energy, second.energy, xtol=1e-12, rtol=1e-14))  # type: ignore[arg-type]
        residual = abs(above(energy))
    except (ArithmeticError, ValueError):
        return None
    link, flown = kept[energy]
    times, states = fly_whole(problem, link, energy)
    near = int(np.searchsorted(times, flown.times[k], side="right")) - 1
    state = problem.system.propagator.flow(states[near], float(flown.times[k] - times[near]))
    return Located("section-artefact", energy, link, state, residual)
