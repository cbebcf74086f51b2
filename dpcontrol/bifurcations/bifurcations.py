"""Bifurcations of the connections between two saddles over the energy or a parameter.

A sweep intersects the cuts of both tubes at a series of values of the followed quantity, which is the energy or a
parameter of the system. Connections are followed by continuation from one value to the next. If the two sets differ,
unmatched connections are followed from both sides until they turn back, branch, or change their number of section
crossings:

    saddle-node        two connections meet and vanish
    pitchfork          a mirror pair branches off a symmetric connection
    section-artefact   the connection touches its section, so that it gains or loses crossings and enters or leaves
                       the list with the requested number of crossings

The events must add up to the change of the count. Otherwise the interval is halved and searched again. Remaining
differences are reported as unexplained.

The unstable tube meets a connection with N section crossings at crossing n_u, and the stable tube at n_s, with
n_u + n_s - 1 = N. First hits, [1, 1], cross once.

The diagram of a sweep is a document of plain numbers, which can be stored and drawn without the sweep.

*A step of the sweep* is a search at both ends of an interval. Newton's method continues connections from one value to
the other. A connection has not turned if the sign of the tangency is unchanged. Unmatched connections on either side
are followed around their turns.

Each kind of event has its own equations. With F, a, b and σ from module links, the height h over the section and its
rate ḣ, Newton's method solves

    saddle-node        F = 0, σ = 0             (φ_u, φ_s, T, H); for symmetric connections  off Fix R = 0, a = 0
    pitchfork          off Fix R = 0, b = 0     (φ, T, H)
    section artefact   F = 0, h = level, ḣ = 0  (φ_u, φ_s, T, time of touch, H)

For section artefacts, ḣ = 0 eliminates the time of touch, and a bracketed secant in H solves the rest. A symmetric
connection may also touch the section at its midpoint, which stays on the section. One crossing then becomes three
although no extremum crosses the section, and the equations are  off Fix R = 0, ḣ = 0  (φ, T, H).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import groupby, pairwise
from typing import ClassVar, NamedTuple

import numpy as np

from dpcontrol.bifurcations.links import (
    Gap,
    Link,
    LinkProblem,
    Path,
    PathPoint,
    Profile,
    Quantity,
    carry,
    first_crossing,
    follow,
    halfway,
    phase_gap,
    profile,
)
from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import GapCause
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.shown import Brief, Shown
from dpcontrol.orbits.continuation import Newton, differenced
from dpcontrol.orbits.cut import Cut, section_points, tube_cut
from dpcontrol.orbits.lyapunov import LyapunovOrbit, equilibrium
from dpcontrol.tubes.intersections import ConnectionSettings, intersect_cuts
from dpcontrol.words.searches import bifurcations_sentence, caveat_sentence

_NEWTON = Newton(10, 1e-9)
_HALVINGS = 8  # largest number of bisections of a path around a turn


@dataclass(frozen=True)
class Located(Brief):
    """A located bifurcation or touch of the section.

    Attributes:
        kind: "saddle-node", "pitchfork" or "section-artefact".
        value: of the followed quantity.
        link: the connection at the event.
        state (N,): representative state of the connection.
        residual: of the equations.
    """

    kind: str
    value: float
    link: Link
    state: Array
    residual: float


def _located(
    problem: LinkProblem,
    kind: str,
    equations: Callable[[Link, float], Array],
    placed: Callable[[Array], Link],
    guess: Array,
) -> Located | None:
    """Return the solution of equations(link, H) = 0 by Newton's method as an event, or None if it does not converge.

    A link describes a connection by the phases of its two seeds, on the orbits that it leaves and joins, and by its
    duration T; H is the followed quantity. One of the equations may be redundant. Derivatives are central differences.

    Args:
        problem: matching of two tubes.
        kind: kind of the event, such as "saddle-node".
        equations: function from a link and the followed quantity H to the residuals.
        placed: function from unknowns to a link: one or two phases (1 for a period) and the duration, s.
        guess: these unknowns and the followed quantity.
    """
    # Phases, duration in s, followed quantity.
    steps = 1e-5 * np.array([*np.ones(len(guess) - 2), guess[-2], problem.course.scale])

    def value_at(unknowns: Array) -> Array:
        """Return the residuals of the equations at unknowns, of which the followed quantity H is the last one."""
        return equations(placed(unknowns[:-1]), float(unknowns[-1]))

    def linearised(unknowns: Array) -> tuple[Array, Array]:
        """Return the residuals and their Jacobian by the unknowns."""
        return value_at(unknowns), differenced(value_at, unknowns, steps)

    # Solutions must be within a tenth of the guess. Orbits may not exist farther away.
    solution = _NEWTON.solve(linearised, guess, (guess - 1e4 * steps, guess + 1e4 * steps))
    if not np.isfinite(solution.residual):
        return None
    link, value = placed(solution.unknowns[:-1]), float(solution.unknowns[-1])
    return Located(kind, value, link, problem.match(link, value).state, solution.residual)


def locate_turn(problem: LinkProblem, path: Path, index: int) -> Located | None:
    """Return the saddle-node or pitchfork at which a path turns after one of its points, or None if it is not found.

    A path turns where the followed quantity has an extremum along it. The event is solved from the two points beside
    the turn, the one farther from the path's start first. If this fails, the interval around the turn is bisected.

    Args:
        problem: matching of two tubes.
        path: solutions in order.
        index: index of the last point before the turn.
    """
    start = path.points[0].value
    before, after = path.points[index : index + 2]
    for _ in range(_HALVINGS):
        for side in sorted((before, after), key=lambda p: -abs(p.value - start)):
            reach = 0.2 * abs(start - side.value) + 1e-3 * problem.course.scale
            event = _turn_from(problem, side, before.link, after.link, reach)
            if event is not None:
                return event
        # At sharp folds, the equations converge only from nearby points. σ changes its sign across the fold.
        middle = halfway(problem, before, after)
        if middle is None or before.tangency * after.tangency > 0:
            return None
        before, after = (middle, after) if middle.tangency * before.tangency > 0 else (before, middle)
    return None


def _turn_from(problem: LinkProblem, extreme: PathPoint, before: Link, after: Link, reach: float) -> Located | None:
    """Return the bifurcation at which a path turns back between two links, solved from a point beside it, or None.

    At a saddle-node, two connections meet and vanish. At a pitchfork, a mirror pair meets a symmetric connection. A
    symmetric connection, which a reverser (a matrix of time reversal) maps to itself, turns at a
    saddle-node only.

    Args:
        problem: matching of two tubes.
        extreme: one of the two points beside the turn, the initial guess.
        before: link before the turn.
        after: link after the turn.
        reach: largest distance of the event from the guess, in the followed quantity.
    """
    reverser = problem.symmetry(extreme.link)
    if reverser is not None:
        return _near(_on_mirror(problem, extreme, reverser, shedding=False), extreme.value, reach)
    pitchfork = None
    for mirror in range(len(problem.system.reversers)):
        image = problem.mirrored(extreme.link, mirror)
        # A pair turns back at the symmetric connection, so a pitchfork is possible only near it.
        if image is not None and problem.distance_between(extreme.link, image) < 0.1:
            pitchfork = _near(_on_mirror(problem, extreme, mirror, shedding=True), extreme.value, reach)
    if pitchfork is not None and _exchanged(problem, before, after):
        return pitchfork
    saddle_node = _near(_tangent(problem, extreme), extreme.value, reach)
    # The saddle-node's equations are degenerate at symmetric connections. If both kinds converge, it is a pitchfork.
    if pitchfork is not None and (
        saddle_node is None or abs(saddle_node.value - pitchfork.value) < 1e-6 * problem.course.scale
    ):
        return pitchfork
    return saddle_node


def _near(event: Located | None, value: float, reach: float) -> Located | None:
    """Return an event if it is solved and within `reach` of a value of the followed quantity, otherwise None."""
    return event if event is not None and event.residual < 1e-8 and abs(event.value - value) < reach else None


def _tangent(problem: LinkProblem, point: PathPoint) -> Located | None:
    """Return the saddle-node near a point of a path, or None if Newton's method does not converge.

    F is the gap between both tubes at the connection's middle, zero for a connection, and σ its tangency, zero if the
    tubes touch. Both are zero at the saddle-node.
    """

    def equations(link: Link, value: float) -> Array:
        """Return F and σ of a link at a value of the followed quantity."""
        match = problem.match(link, value)
        return np.append(match.gap, match.tangency)

    return _located(problem, "saddle-node", equations, point.link.at, point.coordinates)


def _on_mirror(problem: LinkProblem, point: PathPoint, which: int, *, shedding: bool) -> Located | None:
    """Return the event of a symmetric connection near a point of a path, or None if Newton's method does not converge.

    The connection's middle stays on the fixed set of the reverser, a matrix of time reversal, with index `which`. The
    event is a pitchfork if `shedding`, which means that a mirror pair branches off, and otherwise a saddle-node. The
    test functions that are zero there are `shedding` and `fold` of `LinkProblem.mirror`.
    """
    link = point.link
    image = problem.mirrored(link, which)
    assert image is not None
    # The symmetric link lies halfway between a link and its image.
    phase = link.phases[0] + phase_gap(image.phases[0], link.phases[0]) / 2

    def equations(link: Link, value: float) -> Array:
        """Return the gap off the fixed set and the test function of a link at a value of the followed quantity."""
        match = problem.mirror(link, value, which)
        return np.append(match.miss, match.shedding if shedding else match.fold)

    # The unknowns are φ_u, T and H: φ_s of a symmetric link equals φ_u, or for the second reverser φ_u + ½.
    kind, guess = "pitchfork" if shedding else "saddle-node", np.array([phase, link.duration, point.value])
    return _located(
        problem, kind, equations, lambda unknowns: link.at([unknowns[0], unknowns[0] + 0.5 * which, unknowns[1]]), guess
    )


def _exchanged(problem: LinkProblem, before: Link, after: Link) -> bool:
    """Return True if a reverser exchanges the links on the two sides of a turn, as it does at a pitchfork.

    The difference between a link's phase and that of its image under the time reversal then changes its sign.
    """
    for reverser in range(len(problem.system.reversers)):
        images = problem.mirrored(before, reverser), problem.mirrored(after, reverser)
        if images[0] is None or images[1] is None or images[0].branches != before.branches:
            continue
        if phase_gap(before.phases[0], images[0].phases[0]) * phase_gap(after.phases[0], images[1].phases[0]) < 0:
            return True
    return False


def locate_graze(problem: LinkProblem, first: PathPoint, second: PathPoint) -> list[Located]:
    """Return every touch of the section by a connection between two points of a path that does not turn between them.

    The result is in order of value, and empty without a bracket.

    Args:
        problem: matching of two tubes.
        first: point of a path.
        second: later point of the same path.
    """
    middle = _middle_touch(problem, first, second)
    touches = _touches(problem, first, second) if middle is None else [middle]
    return sorted(touches, key=lambda e: e.value)


def _touches(problem: LinkProblem, first: PathPoint, second: PathPoint, halvings: int = 31) -> list[Located]:
    """Return the touches of the section by extrema of the height over it, between two points of a path.

    The height is the signed distance n·x - offset from the section along the connection. If the number of extrema
    differs at the two points, the interval is halved, at most `halvings` times. Intervals are left out if both ends
    have the same number of section crossings, or if the connection between them cannot be solved.
    """
    first_profile, second_profile = (profile(problem, p.link, p.value) for p in (first, second))
    if first_profile.count == second_profile.count:
        return []
    if len(first_profile.heights) == len(second_profile.heights):
        # With the same extrema on both sides, those that crossed a level have touched it in between.
        touches = []
        for extremum in range(1, len(first_profile.heights) - 1):
            low, high = sorted((first_profile.heights[extremum], second_profile.heights[extremum]))
            period = problem.section(first.value).period
            level = np.ceil(low / period) * period if period else 0.0
            if low < level <= high:
                touches.append(_touch(problem, first, second, extremum, float(level), len(first_profile.heights)))
        return [touch for touch in touches if touch is not None]
    if not halvings:
        return []
    try:
        middle = problem.solved(_between(first, second, 0.5), (first.value + second.value) / 2)
    except ArithmeticError:
        return []
    halves = (first, middle), (middle, second)
    return [touch for half in halves for touch in _touches(problem, *half, halvings - 1)]


def _middle_touch(problem: LinkProblem, first: PathPoint, second: PathPoint) -> Located | None:
    """Return the event at which a symmetric connection's midpoint is tangent to the section, or None without one.

    A symmetric connection is mapped to itself by a reverser, a matrix of time reversal, and its midpoint may stay on
    the section. The event is a change of sign of the height's rate ḣ there: one crossing becomes three. The
    result is None if the midpoint is off the section, ḣ keeps its sign, or the event is not between the two points.
    """
    reverser = problem.symmetry(first.link)
    if reverser is None or problem.symmetry(second.link) != reverser:
        return None
    normal = np.asarray(problem.section(first.value).normal)

    def rate(state: Array, value: float) -> float:
        """Return the rate ḣ of the height over the section at a state (N,), in the height's unit per second."""
        return float(normal @ problem.course.at(value)[0].numeric.rate(state))

    states = [(problem.match(p.link, p.value).state, p.value) for p in (first, second)]
    if any(abs(normal @ midpoint - problem.section(value).level(midpoint)) > 1e-6 for midpoint, value in states):
        return None
    rates = [rate(*state) for state in states]
    if rates[0] * rates[1] > 0:
        return None
    share = rates[0] / (rates[0] - rates[1])
    guess = _between(first, second, share)
    # A symmetric link's phases keep their difference.
    offset = guess.phases[1] - guess.phases[0]

    def tangent(link: Link, value: float) -> Array:
        """Return the gap (2,) of a link's middle from the reverser's fixed set, and ḣ there in units of 10/s."""
        state = problem.match(link, value).state
        return np.append(problem.mirror(link, value, reverser).miss, rate(state, value) / 10)

    start = np.array([guess.phases[0], guess.duration, first.value + share * (second.value - first.value)])
    event = _located(
        problem, "section-artefact", tangent, lambda y: guess.at([y[0], y[0] + offset, y[1]]), start
    )  # fmt: skip
    low, high = sorted((first.value, second.value))
    return event if event is not None and event.residual <= 1e-8 and low <= event.value <= high else None


def _between(first: PathPoint, second: PathPoint, share: float) -> Link:
    """Return the link with phases and duration interpolated linearly between two points, at a `share` from 0 to 1."""
    return first.link.at(first.link.unknowns + share * (second.link.unknowns - first.link.unknowns))


def _touch(
    problem: LinkProblem, first: PathPoint, second: PathPoint, k: int, level: float, extrema: int
) -> Located | None:
    """Return the section artefact at which extremum `k` of the height reaches a level between two points of a path.

    Args:
        problem: matching of two tubes.
        first: point on one side of the touch.
        second: point on the other side.
        k: index of the extremum in the profile of the heights.
        level: height of the sheet of the section that is touched.
        extrema: number of extrema with the two ends, equal at both points.

    Returns:
        The event, or None if the extremum vanishes in between or the bracket fails.
    """
    width = second.value - first.value
    flights: dict[float, tuple[Link, Profile]] = {}

    from scipy.optimize import brentq

    def above(value: float) -> float:
        """Return the height of the extremum over the level at a value of the followed quantity.

        The link and its profile are kept in `flights` for the event.

        Raises:
            ArithmeticError: the connection has no solution at this value, or an extremum vanished.
        """
        link = problem.solved(_between(first, second, (value - first.value) / width), value).link
        flight_profile = profile(problem, link, value)
        if len(flight_profile.heights) != extrema:
            raise ArithmeticError("an extremum vanished")
        flights[value] = (link, flight_profile)
        return float(flight_profile.heights[k] - level)

    try:
        value = float(brentq(above, first.value, second.value, xtol=1e-12, rtol=1e-14))  # type: ignore[arg-type]
        residual = abs(above(value))
    except (ArithmeticError, ValueError):
        return None
    link, flight_profile = flights[value]
    return Located("section-artefact", value, link, flight_profile.states[k], residual)


@dataclass(frozen=True)
class SweepSettings:
    """Values, bisections and tolerances of a search for bifurcations.

    Energies within `closest` of a saddle's, relative to the value scale, are excluded, because the tubes are thinner
    there than the distance of their seeds.

    Attributes:
        samples: initial number of values.
        halvings: of an unexplained interval.
        same: largest phase difference between equal links.
    """

    samples: int = 24
    halvings: int = 3
    same: float = 1e-4
    closest: float = 1e-4
    search: ConnectionSettings = field(default_factory=ConnectionSettings)


@dataclass(frozen=True)
class Found:
    """Solved links at one value of the followed quantity, without images under the symmetry S.

    Attributes:
        value: value of the followed quantity.
        energy: energy of the orbits, J.
        points: the solved links.
        weight: number of connections for which each link stands: 2 with its image under S, else 1.
        unmatched: number of crossings of the cuts that are no connections.
        failed: number of crossings that did not converge.
        unresolved: cuts that are not resolved.
        orbits: those of both saddles, one if they are the same; none if an orbit or its tube does not exist.
    """

    value: float
    energy: float
    points: tuple[PathPoint, ...]
    weight: int
    unmatched: int
    failed: int
    unresolved: tuple[Cut, ...]
    orbits: tuple[LyapunovOrbit, ...] = ()

    @property
    def complete(self) -> bool:
        """True if each crossing of resolved cuts is a connection."""
        return bool(self.orbits) and not (self.unmatched or self.failed or self.unresolved)

    @property
    def caveat(self) -> str:
        """Reasons for an incomplete search, in words."""
        return caveat_sentence(self)

    @property
    def count(self) -> int:
        """Number of connections on the torus."""
        return self.weight * len(self.points)


@dataclass(frozen=True)
class Change:
    """An event and the number of links gained with increasing value."""

    event: Located
    gain: int


class Branch(NamedTuple):
    """A connection with the required number of section crossings, which is followed.

    Attributes:
        values (K,): of the followed quantity along the branch.
        points (K, 2): first crossing in (q, p/p₀).
    """

    values: Array
    points: Array


@dataclass(frozen=True)
class Interval:
    """Changes of the connections between two values.

    Attributes:
        changes: located events.
        gaps: causes of unexplained changes.
        runs: connections that were followed.
    """

    changes: tuple[Change, ...]
    gaps: tuple[Gap, ...]
    runs: tuple[Branch, ...]

    @property
    def gain(self) -> int:
        """Number of links gained with increasing value."""
        return sum(c.gain for c in self.changes)


class Sweep:
    """The problem of a sweep, with cached searches.

    `_found` holds the searches by the value of the followed quantity; connections that a search missed are added later.
    `_intervals` holds the explanations of changes by the lowest and highest value of their interval, and loses those at
    a value whose search was amended. `_counts` holds numbers of section crossings by link and value.
    """

    def __init__(self, course: Quantity, source: str, target: str, crossings: int, settings: SweepSettings) -> None:
        """Prepare searches for connections from `source` to `target` that cross their section `crossings` times.

        `course` is the quantity over which they are followed.
        """
        self.problem = LinkProblem(course, source, target, distance=settings.search.distance)
        self.crossings, self.settings = crossings, settings
        self._found: dict[float, Found] = {}
        self._intervals: dict[tuple[float, float], Interval] = {}
        self._counts: dict[tuple[Link, float], int] = {}

    def search(self, value: float) -> Found:
        """Find the links with the required crossings at a value of the followed quantity.

        Links are connections as phases of their seeds and a duration. If an orbit or its tube does not exist at this
        value, the result has none and no orbits. Results are cached, and later finds are added. If intersections of
        the cuts do not converge, for example next to a graze, the search is repeated with finer cuts. Cuts that scatter
        are excluded, because finer ones stop earlier and have fewer intersections.

        Args:
            value: value of the followed quantity.
        """
        if value not in self._found:
            searched, resolved = self._searched(value, 1.0)
            if resolved and not searched.complete:
                searched, _ = self._searched(value, 0.25)
            self._found[value] = searched
        return self._found[value]

    def _searched(self, value: float, fineness: float) -> tuple[Found, bool]:
        """Search for links by intersecting the tubes' cuts at a value of the followed quantity.

        Args:
            value: value of the followed quantity.
            fineness: factor on the chords of the cuts, 1 for the settings' own.

        Returns:
            The links, and True if both cuts are resolved, so that finer cuts may help.
        """
        system, energy = self.problem.course.at(value)
        section = self.problem.section(value)
        try:
            manifolds = self.problem.manifolds(value)
        except (ArithmeticError, InputError):
            return Found(value, energy, (), 1, 0, 0, ()), False
        settings = self.settings.search
        settings = replace(settings, cut=replace(settings.cut, chord=fineness * settings.cut.chord))
        # The crossing numbers of both tubes satisfy n_u + n_s - 1 = crossings. Equal ones give similar flight times.
        hits = (self.crossings // 2 + 1, self.crossings - self.crossings // 2)
        unstable = tube_cut(manifolds[0], section, hit=hits[0], settings=settings.cut)
        same_cut = manifolds[0] is manifolds[1] and hits[0] == hits[1]
        stable = unstable if same_cut else tube_cut(manifolds[1], section, hit=hits[1], settings=settings.cut)
        crossed = intersect_cuts(system, section, manifolds, (unstable, stable), settings)
        points: list[PathPoint] = []
        unmatched = 0
        for intersection in crossed.found:
            branches = (intersection.sides[0].branch, intersection.sides[1].branch)
            phases = (float(intersection.phases[0]) % 1.0, float(intersection.phases[1]) % 1.0)
            guess = Link(
                branches,
                phases,
                float(sum(intersection.times)),
                tuple(float(turn) + 0.0 for turn in intersection.turns),
            )
            try:
                point = self.problem.solved(guess, value)
            except ArithmeticError:
                unmatched += 1
                continue
            if self.among(point.link, points) is None:
                points.append(point)
        # If the symmetry S exchanges the branches, each link stands for itself and its image.
        weight = 2 if all(m.branches_are_mirrored for m in manifolds) else 1
        unresolved = tuple(cut for cut in (unstable, stable) if not cut.resolved)
        orbits = tuple({manifold.orbit.saddle: manifold.orbit for manifold in manifolds}.values())
        searched = Found(value, energy, tuple(points), weight, unmatched, crossed.failed, unresolved, orbits)
        return searched, not unresolved

    def among(self, link: Link, points: list[PathPoint] | tuple[PathPoint, ...]) -> int | None:
        """Return the index of the point whose link is the given one, or None if none of them is.

        Args:
            link: link to find.
            points: points at the value of the link.
        """
        distances = [self.problem.distance_between(link, p.link) for p in points]
        if not distances or min(distances) > self.settings.same:
            return None
        return int(np.argmin(distances))

    def count(self, point: PathPoint) -> int:
        """Return the number of section crossings of a solved link, computed once.

        Args:
            point: solution at its value.
        """
        key = (point.link, point.value)
        if key not in self._counts:
            self._counts[key] = profile(self.problem, point.link, point.value).count
        return self._counts[key]

    def place(self, event: Located) -> tuple[float, float]:
        """Return the point (q, p/p₀) at which an event is drawn on the section: its first crossing, or its touch.

        Args:
            event: located bifurcation or section artefact.
        """
        artefact = event.kind == "section-artefact"
        q, p = self._placed(event.state, event.value) if artefact else self._first_crossing(event.link, event.value)
        return float(q), float(p)

    def _placed(self, state: Array, value: float) -> Array:
        """Return the point (q, p/p₀) of a state (N,) on the section at a value of the followed quantity."""
        return section_points(self.problem.course.at(value)[0], self.problem.section(value), state)

    def _first_crossing(self, link: Link, value: float) -> Array:
        """Return the point (q, p/p₀) at which a connection first crosses the section, nan if it does not."""
        state = first_crossing(self.problem, link, value)
        return np.full(2, np.nan) if state is None else self._placed(state, value)

    def _runs(self, points: Sequence[PathPoint]) -> list[Branch]:
        """Return the stretches of a path with the required number of crossings, as branches to draw.

        Points that do not cross the section are left out, and so are stretches of a single point.
        """
        has_crossings = [self.count(point) == self.crossings for point in points]
        stretches = [
            list(stretch)
            for required, stretch in groupby(zip(has_crossings, points, strict=True), lambda pair: pair[0])
            if required
        ]
        branches = []
        for stretch in stretches:
            values = np.array([point.value for _, point in stretch])
            places = np.array([self._first_crossing(point.link, point.value) for _, point in stretch])
            on_section = np.isfinite(places[:, 0])
            if np.count_nonzero(on_section) > 1:
                branches.append(Branch(values[on_section], places[on_section]))
        return branches

    def between(self, low: float, high: float) -> Interval:
        """Return the events and unexplained changes between two neighbouring searches, from the cache if possible.

        Connections that continuation reveals and a search has missed are added to that search. The interval is then
        explained again.

        Args:
            low: value of the first search.
            high: value of the second search.
        """
        before, after = self.search(low), self.search(high)
        if (low, high) not in self._intervals:
            interval, missed = self._changes(before, after)
            amended = [
                self._amend(value, [p for p in missed if p.value == value])
                for value in sorted({p.value for p in missed})
            ]
            if any(amended):
                return self.between(low, high)
            if missed:
                gap = Gap(self.problem.course, GapCause.UNSEARCHED, counts=(len(missed),))
                interval = replace(interval, gaps=(*interval.gaps, gap))
            self._intervals[low, high] = interval
        return self._intervals[low, high]

    def explained(self, low: float, high: float) -> bool:
        """Return True if `between` has an explanation of an interval that later finds have not invalidated.

        Args:
            low: lowest value of the interval.
            high: highest value of the interval.
        """
        return (low, high) in self._intervals

    def _amend(self, value: float, missed: list[PathPoint]) -> bool:
        """Add missed connections and their mirror images to the search at a value, and return True if any is new.

        Explanations of intervals that end at this value are dropped, since they are out of date.
        """
        points = list(self._found[value].points)
        old_count = len(points)
        for point in missed:
            images = [self.problem.mirrored(point.link, k) for k in range(len(self.problem.system.reversers))]
            for link in [point.link, *(image for image in images if image is not None)]:
                # An image that leaves on a branch without solutions is left out: images under the symmetry S are those
                # that searches do not hold.
                known_branch = any(link.branches[0] == solution.link.branches[0] for solution in [*points, point])
                if known_branch and self.among(link, points) is None:
                    points.append(PathPoint(link, value, point.tangency))
        self._found[value] = replace(self._found[value], points=tuple(points))
        self._intervals = {k: interval for k, interval in self._intervals.items() if value not in k}
        return len(points) > old_count

    def _changes(self, before: Found, after: Found) -> tuple[Interval, list[PathPoint]]:
        """Explain the differences between two neighbouring searches by following their unmatched connections.

        Connections are first carried from the lower value to the higher one. Those without a partner on the other side
        (`lost` and `born`) are then followed around their turns.

        `before` is the search at the lower value of the followed quantity, and `after` the one at the higher value. A
        path is `returned` if it turned back to the value at which it began.

        Returns:
            The interval with its events, causes of unexplained changes and branches to draw (`runs`), and connections
                that the searches should have found.
        """
        runs: list[Branch] = []
        missed: list[PathPoint] = []
        lost, born = set(range(len(before.points))), set(range(len(after.points)))
        for k, point in enumerate(before.points):
            arrived = carry(self.problem, point, after.value)
            match = None if arrived is None else self.among(arrived.link, after.points)
            # Both searches have this connection, so nothing happened to it.
            if match is not None and match in born:
                lost.discard(k)
                born.discard(match)
                runs += self._runs((point, after.points[match]))
            elif arrived is not None and match is None and self.count(arrived) == self.crossings:
                # It did not turn and has the required crossings, so the search missed it.
                lost.discard(k)
                missed.append(arrived)
        changes: list[Change] = []
        gaps: list[Gap] = []
        for unmatched, start, goal in ((lost, before, after), (born, after, before)):
            while unmatched:
                k = min(unmatched)
                unmatched.discard(k)
                path = follow(self.problem, start.points[k].link, start.value, goal.value)
                if path.gap is not None:
                    gaps.append(path.gap)
                    continue
                end = path.points[-1]
                arrived = self.among(end.link, (start if path.returned else goal).points)
                if path.returned and arrived is not None:
                    unmatched.discard(arrived)
                elif not path.returned and arrived is not None and goal is after:
                    # Paths in the other direction come second, when no lost connection is left.
                    born.discard(arrived)
                elif arrived is None and self.count(end) == self.crossings:
                    missed.append(end)
                self._along(path, changes, gaps)
                runs += self._runs(path.points)
        return Interval(tuple(self._distinct(changes)), tuple(gaps), tuple(runs)), missed

    def _along(self, path: Path, changes: list[Change], gaps: list[Gap]) -> None:
        """Append the events along a followed path to `changes`, and the places where none was located to `gaps`.

        `path.turns` holds the indices of the points before a turn. Only events that change the number of connections
        with the required crossings of the section count. The gain of a change is the number of such connections that
        appear with increasing value. A gap is the cause for which an event is missing. It keeps the sweep from claiming
        that the counts add up.
        """
        points, gap = path.points, partial(Gap, self.problem.course)
        counts = [self.count(p) for p in points]
        for k in range(len(points) - 1):
            if k in path.turns:
                event = locate_turn(self.problem, path, k)
                if event is None:
                    gaps.append(gap(GapCause.TURN, (points[k].value,)))
                    continue
                if counts[k] != counts[k + 1]:
                    gaps.append(gap(GapCause.TOUCH_AT_TURN, (event.value,)))
                if counts[k] == self.crossings:
                    # The partners are on the side from which the path came.
                    came_from = points[k].value if points[k].value != event.value else points[k - 1].value
                    changes.append(Change(event, 2 if came_from > event.value else -2))
            elif counts[k] != counts[k + 1]:
                touches = locate_graze(self.problem, points[k], points[k + 1])
                gain = (counts[k + 1] == self.crossings) - (counts[k] == self.crossings)
                if gain and not touches:
                    values = points[k].value, points[k + 1].value
                    gaps.append(gap(GapCause.TOUCH, values, (counts[k], counts[k + 1])))
                elif gain:
                    rising = 1 if points[k + 1].value > points[k].value else -1
                    # Of several touches, the one next to the required count changed it.
                    near_end = points[k + 1].value if gain > 0 else points[k].value
                    event = min(touches, key=lambda touch: abs(touch.value - near_end))
                    changes.append(Change(event, gain * rising))

    def _distinct(self, changes: list[Change]) -> list[Change]:
        """Return the changes without duplicates, since each of the connections that meet at an event finds it."""

        def same(a: Located, b: Located) -> bool:
            """Return True if two events agree in kind, value and link up to the errors of their solutions."""
            is_near = abs(a.value - b.value) < 1e-7 * self.problem.course.scale
            return (
                a.kind == b.kind and is_near and self.problem.distance_between(a.link, b.link) < 10 * self.settings.same
            )

        distinct: list[Change] = []
        for change in changes:
            if not any(same(c.event, change.event) for c in distinct):
                distinct.append(change)
        return distinct


@dataclass(frozen=True)
class Bifurcation:
    """An event with its counts, which are those of connections on the torus with the required crossings.

    The state is on the section if the connection touches it, and otherwise at half of the flight time.

    Attributes:
        value: of the followed quantity.
        energy: J.
        kind: "saddle-node", "pitchfork" or "section-artefact".
        point: first section crossing, (q, p/p₀).
        count_below, count_above: counts on either side.
        at_least: True if counts are lower bounds.
        state (N,): of the connection.
        residual: of the event's equations.
        connections: number involved, with images.
        symmetric: True if a reverser maps the connection to itself.
    """

    value: float
    energy: float
    kind: str
    point: tuple[float, float]
    count_below: int
    count_above: int
    at_least: bool
    state: Array
    residual: float
    connections: int
    symmetric: bool
    link: Link

    @property
    def winding(self) -> tuple[int, ...]:
        """Whole turns (n,) of each coordinate from source to target."""
        return tuple(round(k) for k in self.link.turns[: len(self.link.turns) // 2])


@dataclass(frozen=True)
class UnexplainedChange:
    """A change of the count between two values that located events do not explain."""

    values: tuple[float, float]
    gaps: tuple[Gap, ...]

    @property
    def causes(self) -> list[GapCause]:
        """Causes of the gaps."""
        return [gap.cause for gap in self.gaps]

    @property
    def reason(self) -> str:
        """The gaps as sentences."""
        return "; ".join(gap.status for gap in self.gaps)


@dataclass(frozen=True)
class BifurcationSearch(Shown, Documented):
    """Bifurcations in order of value, with the counts they explain.

    Above `scatters_from`, no search is complete, because trajectories of a tube scatter before they arrive and
    connections accumulate without end. Counts are then lower bounds. If a symmetry exchanges the tubes' branches,
    `runs` has one of each pair of connections.

    Attributes:
        course: quantity that is followed.
        source: saddle that the connections leave.
        target: saddle that they join.
        section: section of the connections.
        crossings: crossing numbers of the tubes.
        events: bifurcations in order of the followed quantity.
        counts: number of connections at each tried value, with the orbits.
        unexplained: changes of the count between values without a located event.
        runs: connections that were followed.
        scatters_from: value of the followed quantity, or None.
        born: energy of the higher saddle, J, if the sweep starts just above it.
        values: lowest and highest value of the search.
        complete: True if no change is unexplained and every search is complete.
    """

    KEYS: ClassVar[str] = (
        "events:value,energy,kind,state,count_below,count_above,at_least,symmetric,winding,residual,point "
        "counts:value,energy,count,complete,caveat,orbits unexplained:values,causes,reason scatters_from complete "
        "status section=section.name from=source to=target hits=crossings quantity=course.quantity values energies "
        "branches=runs:values,points"
    )

    course: Quantity
    source: str
    target: str
    section: Section
    crossings: int
    events: tuple[Bifurcation, ...]
    counts: tuple[Found, ...]
    unexplained: tuple[UnexplainedChange, ...]
    runs: tuple[Branch, ...]
    scatters_from: float | None
    born: float | None
    values: tuple[float, float]

    @property
    def system(self) -> System:
        """System of the names and scales."""
        return self.course.system

    @property
    def energies(self) -> tuple[float, float]:
        """Energies at the lowest and highest value, J."""
        low, high = self.values
        return self.course.at(low)[1], self.course.at(high)[1]

    @property
    def missed(self) -> str:
        """Sentence on the changes of the count that were not located, empty if there are none."""
        return f"not every change of the count was located: {self.status}" if self.unexplained else ""

    @property
    def complete(self) -> bool:
        """True if every search is complete and every change of the count is explained."""
        return not self.unexplained and all(count.complete for count in self.counts)

    @property
    def status(self) -> str:
        """The outcome in words."""
        return bifurcations_sentence(self)

    def __repr__(self) -> str:
        return f"<bifurcations: {self.status}>"


def find_bifurcations(
    course: Quantity,
    source: str,
    target: str,
    *,
    values: tuple[float, float],
    crossings: int = 1,
    settings: SweepSettings | None = None,
    progress: Progress = no_progress,
) -> BifurcationSearch:
    """Find the values of a quantity at which connections between two saddles appear, split or change.

    Args:
        course: followed quantity of systems of two degrees of freedom.
        source: name of the saddle that connections leave.
        target: name of the saddle that they approach.
        values: (lowest, highest).
        crossings: number of section crossings, 1 for first hits.
        settings: settings of the sweep.
        progress: called with a label and the completed share.

    Raises:
        InputError: an unknown saddle, no section between the saddles, bounds without orbits, or a system without two
            degrees of freedom.
    """
    settings, system = settings or SweepSettings(), course.system
    if (source, target) not in system.sections:
        raise InputError(f"{system.name} has no section between {source} and {target}")
    low, high = values
    start, born = _beginning(course, (source, target), (low, high), settings.closest)
    sweep = Sweep(course, source, target, crossings, settings)
    grid = [float(e) for e in np.linspace(start, high, settings.samples)]
    # The factor prevents another halving due to rounding.
    narrowest = 1.001 * (grid[1] - grid[0]) / 2**settings.halvings
    k = 0
    while k < len(grid) - 1:
        progress(f"{source} → {target} at {course.quantity} = {grid[k]:.4f}", (grid[k] - start) / (high - start))
        ends = grid[k], grid[k + 1]
        searched = all(sweep.search(value).complete for value in ends)
        if not _adds_up(sweep, *ends) and ends[1] - ends[0] > narrowest and searched:
            grid.insert(k + 1, sum(ends) / 2)
            continue
        # New finds of a search may invalidate the explanation of an earlier interval.
        k = k - 1 if k > 0 and not sweep.explained(grid[k - 1], grid[k]) else k + 1
    progress("bifurcations", 1.0)
    counts = tuple(sweep.search(value) for value in grid)
    pairs = list(pairwise(grid))
    unexplained = tuple(_unexplained(sweep, a, b) for a, b in pairs if not _adds_up(sweep, a, b))
    events = _with_counts(sweep, [c for a, b in pairs for c in sweep.between(a, b).changes], counts)
    # From this value on, no search is complete.
    scatters_from = next((c.value for k, c in enumerate(counts) if not any(d.complete for d in counts[k:])), None)
    return BifurcationSearch(
        course=course,
        source=source,
        target=target,
        section=system.sections[source, target],
        crossings=crossings,
        events=events,
        counts=counts,
        unexplained=unexplained,
        runs=tuple(run for a, b in pairs for run in sweep.between(a, b).runs),
        scatters_from=scatters_from,
        born=born,
        values=(low, high),
    )


def _beginning(
    course: Quantity, saddles: tuple[str, str], values: tuple[float, float], closest: float
) -> tuple[float, float | None]:
    """Return the first value of a sweep, and the energy of the higher saddle if the sweep starts just above it.

    A sweep of energies cannot start below the higher of its saddles, where orbits do not exist.

    Args:
        course: followed quantity.
        saddles: names of source and target.
        values: lowest and highest value requested.
        closest: least height above the saddle, relative to the energy scale.

    Raises:
        InputError: the values are not in ascending order, or both orbits do not exist there.
    """
    (low, high), joule = values, course.system.unit("J")
    if not low < high:
        raise InputError(f"{course.quantity} {low:g} to {high:g}: must be two finite numbers in ascending order")
    systems = [course.at(value)[0] for value in values]
    saddle_energies = [max(equilibrium(system, name).energy for name in saddles) for system in systems]
    lowest_energies = [
        saddle_energy + closest * system.energy_scale
        for saddle_energy, system in zip(saddle_energies, systems, strict=True)
    ]
    # Of one system, only energies above both saddles have connections.
    start = max(low, lowest_energies[0]) if systems[0] is systems[1] else low
    for value, lowest_energy, saddle_energy in zip((start, high), lowest_energies, saddle_energies, strict=True):
        if course.at(value)[1] < lowest_energy or start >= high:
            raise InputError(
                f"{course.quantity} {low:g} to {high:g}{course.unit}: both orbits, and thus connections, exist only "
                f"above {saddle_energy:.6g}{joule}, and not at {course.quantity} = {min(value, high):g}{course.unit}"
            )
    return start, saddle_energies[0] if start > low else None


def _adds_up(sweep: Sweep, low: float, high: float) -> bool:
    """Return True if the located events explain the change of the number of links between two searched values.

    The gain of an interval is the number of links that its events add with increasing value. The result is also False
    if an event is missing, which a gap reports. The sweep halves such an interval.
    """
    interval = sweep.between(low, high)
    # Searches are read last, because continuation may have added to them.
    lower_search, upper_search = sweep.search(low), sweep.search(high)
    return not interval.gaps and len(lower_search.points) + interval.gain == len(upper_search.points)


def _unexplained(sweep: Sweep, low: float, high: float) -> UnexplainedChange:
    """Return the report of an interval whose events do not explain the change of its count, with up to three causes.

    `low` and `high` are the searched values of the followed quantity at its ends.
    """
    interval, lower_search, upper_search = sweep.between(low, high), sweep.search(low), sweep.search(high)
    counts = lower_search.count, upper_search.count, interval.gain * upper_search.weight
    return UnexplainedChange(
        (low, high), (Gap(sweep.problem.course, GapCause.COUNT, counts=counts), *interval.gaps[:2])
    )


def _with_counts(sweep: Sweep, changes: Sequence[Change], counts: Sequence[Found]) -> tuple[Bifurcation, ...]:
    """Return the bifurcations in order of value, with the number of connections on either side of each.

    Events of the same kind at the same value are images of one another under a symmetry and become one bifurcation.

    Args:
        sweep: sweep that found the events.
        changes: events with the number of links gained at each.
        counts: searches at all values of the sweep, in order.
    """
    weight = max((c.weight for c in counts), default=1)
    tolerance = 1e-8 * sweep.problem.course.scale
    groups: list[list[Change]] = []
    for change in sorted(changes, key=lambda c: c.event.value):
        kind, value = change.event.kind, change.event.value
        images_of_event = (g for g in groups if g[0].event.kind == kind and abs(g[0].event.value - value) < tolerance)
        group = next(images_of_event, None)
        if group is None:
            groups.append([change])
        else:
            group.append(change)
    events: list[Bifurcation] = []
    for group in groups:
        event = group[0].event
        below, above = ([c for c in counts if (c.value <= event.value) is side] for side in (True, False))
        # The count restarts at each search, so that an unexplained interval has no effect on the rest.
        running = events[-1].count_above if events else 0
        if below and not (events and events[-1].value > below[-1].value):
            running = below[-1].count
        link = replace(event.link, phases=(event.link.phases[0] % 1.0, event.link.phases[1] % 1.0))
        events.append(
            Bifurcation(
                value=event.value,
                energy=sweep.problem.course.at(event.value)[1],
                kind=event.kind,
                point=sweep.place(event),
                count_below=running,
                count_above=running + weight * sum(c.gain for c in group),
                at_least=not all(c.complete for c in [*below[-1:], *above[:1]]),
                state=event.state,
                residual=max(c.event.residual for c in group),
                connections=weight * sum(abs(c.gain) for c in group),
                symmetric=sweep.problem.symmetry(event.link) is not None,
                link=link,
            )
        )
    return tuple(events)
