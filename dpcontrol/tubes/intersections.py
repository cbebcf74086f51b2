"""Intersections of tube cuts.

The stable tube is the image of the unstable tube under a reverser. Crossings and near touches of the cuts' polylines
give initial guesses. Newton's method on (phase_u, phase_s) with the variational equations solves
P(W^u(phase_u)) = P(W^s(phase_s)) in the section's coordinates (q, p/p₀). Neither a search window nor the number of
solutions is required. Further intersections next to a known one are predicted from the cuts' slope and curvature.

Source: Koon, Lo, Marsden, Ross, Heteroclinic connections between periodic orbits and resonance transitions in
celestial mechanics (2000), section 4.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System, momentum_scale
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.budget import SECONDS
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import MOST_SECONDS
from dpcontrol.foundation.shown import Brief
from dpcontrol.orbits.cut import MOST_PERIODS, Cut, CutSettings, Piece, arrivals, longest_flight, section_points
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.orbits.tube import Tube

_BLOCK = 32
"""Segments of the first curve per bounding box; only segments of the second that meet the box are compared."""

_STRETCH = 8
"""Largest index step between the nearest vertices of neighbours, on curves that run side by side."""


def polyline_crossings(first: Array, second: Array) -> list[tuple[float, float]]:
    """Return the crossings (i + s, j + t) of two polylines, guesses for the intersections of two cuts.

    Segment i of the first crosses segment j of the second, at fractions s and t in [0, 1) of their lengths.

    Args:
        first: vertices (K, 2).
        second: vertices (L, 2).
    """
    first_starts, second_starts = first[:-1], second[:-1]
    first_steps, second_steps = np.diff(first, axis=0), np.diff(second, axis=0)
    low, high = np.minimum(second_starts, second[1:]), np.maximum(second_starts, second[1:])
    starts = np.arange(0, len(second_starts), _BLOCK)
    blocks = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
    # The margin exceeds the effect of rounding on a crossing.
    margin = 1e-9 * max(float(np.abs(first).max(initial=0.0)), float(np.abs(second).max(initial=0.0)))
    crossings: list[tuple[float, float]] = []
    for start in range(0, len(first_starts), _BLOCK):
        part = slice(start, start + _BLOCK)
        box = first[start : start + _BLOCK + 1]
        box_low, box_high = box.min(axis=0) - margin, box.max(axis=0) + margin
        in_block = np.repeat(((blocks[0] <= box_high) & (blocks[1] >= box_low)).all(axis=1), _BLOCK)[
            : len(second_starts)
        ]
        nearby = np.flatnonzero(in_block)
        nearby = nearby[((low[nearby] <= box_high) & (high[nearby] >= box_low)).all(axis=1)]
        if not nearby.size:
            continue
        cross = (
            first_steps[part, None, 0] * second_steps[None, nearby, 1]
            - first_steps[part, None, 1] * second_steps[None, nearby, 0]
        )
        gap = second_starts[None, nearby, :] - first_starts[part, None, :]
        with np.errstate(divide="ignore", invalid="ignore"):
            first_share = (
                gap[..., 0] * second_steps[None, nearby, 1] - gap[..., 1] * second_steps[None, nearby, 0]
            ) / cross
            second_share = (gap[..., 0] * first_steps[part, None, 1] - gap[..., 1] * first_steps[part, None, 0]) / cross
        hits = (cross != 0) & (first_share >= 0) & (first_share < 1) & (second_share >= 0) & (second_share < 1)
        crossings += [
            (start + i + float(first_share[i, j]), int(nearby[j]) + float(second_share[i, j]))
            for i, j in np.argwhere(hits)
        ]
    return crossings


def near_touches(first: Array, second: Array, *, margin: float = 4.0) -> list[tuple[float, float]]:
    """Return vertex pairs (i, j) at which two sampled curves may touch.

    A smooth curve deviates from its polyline by about an eighth of the second difference of its vertices (the sagitta).
    If a local minimum of the distance is below `margin` times both sagittas, the curves may cross twice although no
    segments do.

    Args:
        first: vertices (V, 2) of one curve, in order.
        second: vertices (W, 2) of the other curve, in order.
        margin: factor on both sagittas.
    """
    from scipy.spatial import KDTree

    if len(first) < 3 or len(second) < 3:
        return []
    bends = _sagitta(first), _sagitta(second)
    reach = margin * float(bends[0].max() + bends[1].max())
    if ((first.min(axis=0) - reach > second.max(axis=0)) | (first.max(axis=0) + reach < second.min(axis=0))).any():
        return []
    tree = KDTree(second)
    nearest = np.clip(np.asarray(tree.query(first)[1]), 1, len(second) - 2)
    distance = np.minimum(
        to_segment(first, second[nearest - 1], second[nearest]),
        to_segment(first, second[nearest], second[nearest + 1]),
    )
    touching_distance = margin * (bends[0] + bends[1][nearest])
    # Neighbours near another stretch of the second curve are irrelevant here.
    consecutive = np.abs(np.diff(nearest)) <= _STRETCH
    previous_distance = np.r_[np.inf, np.where(consecutive, distance[:-1], np.inf)]
    next_distance = np.r_[np.where(consecutive, distance[1:], np.inf), np.inf]
    lowest = (distance <= touching_distance) & (distance <= previous_distance) & (distance <= next_distance)
    return [(float(i), float(nearest[i])) for i in np.flatnonzero(lowest)]


def _sagitta(curve: Array) -> Array:
    """Return an eighth of the second difference at each vertex (K,): a smooth curve's distance from its polyline."""
    inner = np.linalg.norm(curve[:-2] - 2 * curve[1:-1] + curve[2:], axis=1) / 8
    return np.r_[inner[:1], inner, inner[-1:]]


def to_segment(points: Array, start: Array, end: Array) -> Array:
    """Return the distance (K,) of each point from its segment.

    Args:
        points: points (K, 2).
        start: starts (K, 2) of the segments, or (2,) of one.
        end: ends (K, 2) of the segments, or (2,) of one.
    """
    segment = end - start
    length = np.maximum(np.sum(segment**2, axis=-1), np.finfo(float).tiny)
    share = np.clip(np.sum((points - start) * segment, axis=1) / length, 0.0, 1.0)
    return np.linalg.norm(points - start - share[:, None] * segment, axis=1)


_PLACED, _SOLVED, _PAIRED = 0.25, 0.5, 0.6  # deadlines of the steps, as shares of the time left after the cuts
_THOROUGH = 50.0  # the step in progress at the limit takes a few seconds more
_BESIDE = 1e-3  # phase step for the curvature of cuts, below the initial sampling of 1/100
_FARTHEST_PARTNER = 0.05  # phase; polylines resolve partners at larger distances
_FARTHEST = 0.2  # largest distance in phase from a guess to its solution
_CLOSER = 16  # points per chord of a finer sampling after Newton's method has failed
_TOGETHER = 256  # places solved together
_AT_REST = 1e-10  # phase step at which the rounding error of seeds dominates


@dataclass(frozen=True)
class ConnectionSettings:
    """Settings of the search for connections.

    The truncation error of seeds is proportional to the cube of their distance from the orbit, and rounding to its
    inverse. Multiple shooting starts at least `lead` periods earlier, between the scaled distances `nearest` and
    `farthest` from the orbit, with `segments` nodes per period.

    Attributes:
        distance: of seeds from their orbits, scaled.
        cut: settings of the tubes' cuts.
        accept: largest gap between the two arrivals.
        same: scaled distance of states on the section below which two intersections are the same.
        near: scaled distance of departure and arrival.
        finest: smallest chord if closed cuts cross unevenly.
        thorough: True if a longer search would not help.

    The search ends after `seconds` of processor time. A gap above `accept` is allowed if it is due to rounding.
    """

    distance: float = 1e-4
    cut: CutSettings = field(default_factory=CutSettings)
    newton_iterations: int = 24
    accept: float = 1e-9
    same: float = 1e-7
    lead: float = 1.0
    farthest: float = 3e-7
    nearest: float = 1e-10
    segments: int = 8
    near: float = 1e-3
    finest: float = 0.003
    seconds: float = SECONDS
    thorough: bool = False


def search_settings(
    *, longest: float | None = None, thorough: bool = False, seconds: float | None = None
) -> ConnectionSettings:
    """Return the settings of a search for connections, from a user's limits and wish for thoroughness.

    Args:
        longest: flight time to the section in periods of the orbit, None for the system's default.
        thorough: refine further for up to a minute.
        seconds: limit on processor time, s.

    Raises:
        InputError: a time that is not positive or too long.
    """
    if seconds is not None and not 0 < seconds <= MOST_SECONDS:
        raise InputError(f"seconds = {seconds:g}: must be positive and at most {MOST_SECONDS:g} s")
    if longest is not None and not 0 < longest <= MOST_PERIODS:
        raise InputError(f"longest = {longest:g}: must be positive and at most {MOST_PERIODS:g} periods of the orbit")
    cut = CutSettings(longest=longest)
    if thorough:
        # Cuts get the same share of a longer time limit as of the default.
        cut = cut.thoroughly()
        cut = replace(cut, seconds=cut.seconds * (seconds or _THOROUGH) / _THOROUGH)
    return ConnectionSettings(cut=cut, seconds=seconds or (_THOROUGH if thorough else SECONDS), thorough=thorough)


@dataclass(frozen=True)
class TubeSide:
    """One branch of a tube at its crossing number `hit` of a section.

    `manifold` is the unstable manifold of the tube's orbit, from which a stable tube follows by time reversal.
    `longest` is the largest flight time, s.
    """

    manifold: UnstableManifold
    section: Section
    stable: bool
    hit: int
    branch: int
    longest: float

    def turned(self, states: Array) -> Array:
        """Return states of the unstable tube on this tube: unchanged, or reflected onto the stable one.

        Args:
            states: states (…, N).
        """
        if not self.stable:
            return states
        reverser, centre = self.manifold.orbit.reverser, self.manifold.orbit.centre
        return (states - centre) @ reverser.T + centre

    def arrive(self, phases: Array) -> tuple[Array, Array, tuple[Array, Array]]:
        """Return the states and times at which the tube's trajectories from given phases reach the section.

        Args:
            phases: phases (K,) of the orbit, 1 for a period.

        Returns:
            States, times and seeds as those of `arrivals`, the states on this tube.
        """
        states, times, seeds = arrivals(
            self.manifold, self.section, phases, hit=self.hit, branch=self.branch, longest=self.longest
        )
        return self.turned(states), times, seeds

    def slopes(self, seeds: tuple[Array, Array], states: Array, times: Array) -> Array:
        """Return the derivatives (K, N) of arrival states by phase, along the section, for Newton's method.

        Args:
            seeds: seeds and their derivatives by phase, (K, N) each.
            states: arrival states (K, N).
            times: flight times (K,), s.
        """
        system = self.manifold.orbit.system
        _, tangents = system.propagator.flows_with_tangents(seeds[0], times, seeds[1])
        normal = np.asarray(self.section.normal)
        if self.stable:
            tangents = tangents @ self.manifold.orbit.reverser.T
        rates = system.numeric.rate(states)
        return tangents - rates * ((tangents @ normal) / (rates @ normal))[:, None]


@dataclass(frozen=True)
class Intersection(Brief):
    """An intersection of two cuts.

    Attributes:
        sides: branches of the unstable and of the stable tube.
        phases (2,): phases of the seeds on both tubes, 1 for a period.
        states: arrivals (N,) of both tubes at the section.
        turns (N,): whole turns by which the first state is ahead of the second.
        tangents (2, 2): tangents of both cuts, in columns, in (q, p/p₀) by phase.
        times: flight times of both trajectories, s.
        scale: phase step at the polyline crossing that led here, or zero.
    """

    sides: tuple[TubeSide, TubeSide]
    phases: Array
    states: tuple[Array, Array]
    turns: Array
    tangents: Array
    times: tuple[float, float]
    scale: float = 0.0


@dataclass(frozen=True)
class Crossings:
    """Intersections of two cuts, those of the coarse sampling first.

    Attributes:
        found: the intersections.
        failed: places without a solution although finely sampled cuts cross there.
        left: pieces, places and partners not examined before time ran out.
    """

    found: list[Intersection]
    failed: int
    left: int = 0


@dataclass(frozen=True)
class _Place:
    """A place at which two polylines meet, with phases (2,).

    The displacement `shift` (2,) moves the second polyline to the first. `spans` are finely spaced phases of both cuts
    about the place. `sure` is True for a crossing, False for a near touch.
    """

    sides: tuple[TubeSide, TubeSide]
    phases: Array
    spans: tuple[Array, Array]
    shift: Array
    sure: bool

    @property
    def scale(self) -> float:
        """Phase range of the more finely sampled cut at this place."""
        return min(float(span[-1] - span[0]) for span in self.spans)

    @property
    def reach(self) -> float:
        """Largest phase change in Newton's method, beyond neighbours but within the vicinity."""
        return min(_FARTHEST, 20 * max(float(span[-1] - span[0]) for span in self.spans))

    def holds(self, phases: Array) -> bool:
        """Return True if phases (2,) lie within the ranges of both cuts here; others belong to another place."""
        return all(span[0] <= phase <= span[-1] for span, phase in zip(self.spans, phases, strict=True))


@dataclass(frozen=True)
class _Pair:
    """Pieces of the unstable and the stable cut that may meet if `shift` (2,), in (q, p/p₀), moves the second one."""

    sides: tuple[TubeSide, TubeSide]
    pieces: tuple[Piece, Piece]
    shift: Array

    @property
    def scale(self) -> float:
        """Longest phase step of the shorter piece, an upper bound for places."""
        return min(float(np.diff(piece.phases).max()) for piece in self.pieces)

    def places(self) -> list[_Place]:
        """Return the places at which the pieces meet, with their phases interpolated on the polylines."""
        first, second = self.pieces
        return [
            _Place(
                self.sides,
                np.array([np.interp(vertex, np.arange(len(piece.phases)), piece.phases)
                          for vertex, piece in zip(at, self.pieces, strict=True)]),
                (_span(first, at[0]), _span(second, at[1])),
                self.shift,
                sure,
            )
            for at, sure in _meetings(first.points, second.points + self.shift)
        ]  # fmt: skip


Meeting = TypeVar("Meeting", _Place, Intersection)
Spent = Callable[[], float]
"""Function that returns the elapsed share of the time after the cuts."""


def intersect_cuts(
    system: System,
    section: Section,
    manifolds: tuple[UnstableManifold, UnstableManifold],
    cuts: tuple[Cut, Cut],
    settings: ConnectionSettings,
    *,
    spent: Spent = lambda: 0.0,
) -> Crossings:
    """Return the distinct intersections of two cuts, refined by Newton's method.

    If a symmetry exchanges the branches, only one branch of the unstable tube is searched.

    Args:
        system: system of the section.
        section: section of the cuts.
        manifolds: manifolds of both tubes.
        cuts: unstable cuts of both tubes.
        settings: settings of the search.
        spent: see `Spent`.
    """
    mirrored = all(manifold.branches_are_mirrored for manifold in manifolds)
    pairs: list[_Pair] = []
    for branches in ((1, 1), (1, -1)) if mirrored else ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        sides = tuple(
            TubeSide(
                manifold,
                section,
                k == 1,
                cuts[k].hit,
                branches[k],
                2 * longest_flight(manifold, settings.cut) * manifold.orbit.period,
            )
            for k, manifold in enumerate(manifolds)
        )
        pairs += _pairs(system, (sides[0], sides[1]), cuts, settings)
    # Coarse pieces come first in case time runs out, because tubes that scatter have ever finer pieces.
    pairs.sort(key=lambda pair: -pair.scale)
    places: list[_Place] = []
    intersections: list[Intersection] = []
    failed = unsearched = 0
    for k, pair in enumerate(pairs):
        if spent() > _PLACED:
            unsearched += len(pairs) - k
            break
        places += pair.places()
    places.sort(key=lambda place: (-place.scale, not place.sure))
    for batch in _together(places):
        if spent() > _SOLVED:
            unsearched += len(batch)
            continue
        solutions, unsolved = _solved(system, batch, settings, spent)
        failed, unsearched = (failed, unsearched + unsolved) if spent() >= 1 else (failed + unsolved, unsearched)
        _add(system, solutions, intersections, settings)
    for batch in _together(intersections):
        if spent() > _PAIRED:
            unsearched += len(batch)
            continue
        _add(system, _partners(system, batch, settings, spent), intersections, settings)
    return Crossings(sorted(intersections, key=lambda crossing: -crossing.scale), failed, unsearched)


def _together(many: Sequence[Meeting]) -> list[list[Meeting]]:
    """Return places or intersections in batches of the same pair of branches, which are solved together, in order.

    `many`: places or intersections, the most important ones first. A batch has at most `_TOGETHER` of them.
    """
    parts = []
    for start in range(0, len(many), _TOGETHER):
        by_branches: dict[tuple[int, int], list[Meeting]] = {}
        for intersection in many[start : start + _TOGETHER]:
            by_branches.setdefault((intersection.sides[0].branch, intersection.sides[1].branch), []).append(
                intersection
            )
        parts += by_branches.values()
    return parts


def _pairs(
    system: System, sides: tuple[TubeSide, TubeSide], cuts: tuple[Cut, Cut], settings: ConnectionSettings
) -> list[_Pair]:
    """Return the pairs of pieces on two branches that may intersect.

    They cross the section in the same direction, and their momenta and coordinates overlap up to the length of a chord.
    `sides`: branches of the unstable and the stable tube. `cuts`: unstable cuts of both orbits.
    """
    section, margin, pairs = sides[0].section, settings.cut.chord * system.section_scale, []
    first, second = ([piece for piece in cut.pieces if piece.branch == side.branch]
                     for cut, side in zip(cuts, sides, strict=True))  # fmt: skip
    second = [Tube(sides[1].manifold.orbit, stable=True).placed(piece, section) for piece in second]
    crossing_directions = np.array([piece.direction for piece in second])
    momenta = np.array(
        [(second_piece.points[:, 1].min(), second_piece.points[:, 1].max()) for second_piece in second]
    ).reshape(-1, 2)
    for u in first:
        low, high = u.points[:, 1].min() - margin, u.points[:, 1].max() + margin
        for k in np.flatnonzero(
            (crossing_directions == u.direction) & (momenta[:, 0] <= high) & (momenta[:, 1] >= low)
        ):
            s = second[k]
            pairs += [_Pair(sides, (u, s), shift) for shift in _shifts(system, section, u, s, margin)]
    return pairs


def balanced(crossings: list[Intersection], cuts: tuple[Cut, Cut]) -> bool:
    """Return True if closed cuts cross equally often in both directions.

    The test covers each pair of branches with closed cuts that do not wind around an angle. Different counts mean that
    crossings were missed. Equal counts do not prove completeness, because a pair may be missed.

    Source: Guillemin & Pollack, Differential Topology (1974), section 3.3 (oriented intersection numbers).

    Args:
        crossings: intersections found.
        cuts: cuts of the two tubes.
    """

    def closed(cut: Cut, branch: int) -> bool:
        """Return True if a branch's pieces are closed and do not wind around an angle."""
        pieces = [piece for piece in cut.pieces if piece.branch == branch]
        ends = [piece.points[[0, -1], 0] for piece in pieces]
        return all(piece.closed for piece in pieces) and all(abs(last - first) < 1.0 for first, last in ends)

    totals: dict[tuple[int, int], int] = {}
    for crossing in crossings:
        key = (crossing.sides[0].branch, crossing.sides[1].branch)
        sign = int(np.sign(np.linalg.det(crossing.tangents)))
        totals[key] = totals.get(key, 0) + sign
    return all(
        total == 0
        for (unstable, stable), total in totals.items()
        if closed(cuts[0], unstable) and closed(cuts[1], stable)
    )


def _shifts(system: System, section: Section, u: Piece, s: Piece, margin: float) -> list[Array]:
    """Return the shifts (2,) by whole turns of the coordinate after which piece `s` may meet piece `u`.

    `margin`: length of a chord in (q, p/p₀), by which the pieces' boxes may be apart.
    """
    period = float(system.periods[int(np.argmax(np.abs(section.position)))])
    (low, high), (second_low, second_high) = ((piece.points.min(axis=0), piece.points.max(axis=0)) for piece in (u, s))
    if not np.isfinite(period):
        return [np.zeros(2)] if high[0] >= second_low[0] - margin and low[0] <= second_high[0] + margin else []
    first = int(np.ceil((low[0] - second_high[0] - margin) / period))
    last = int(np.floor((high[0] - second_low[0] + margin) / period))
    return [np.array([k * period, 0.0]) for k in range(first, last + 1)]


def _meetings(first: Array, second: Array) -> list[tuple[tuple[float, float], bool]]:
    """Return meeting places (i, j) of two polylines (K, 2) and (L, 2): True for crossings, False for near touches.

    i and j are fractional indices of vertices, as in `polyline_crossings`.
    """
    crossings = polyline_crossings(first, second)
    # A near touch within two segments of a crossing is the same one.
    touches = [
        (i, j)
        for i, j in near_touches(first, second)
        if not any(abs(i - crossing_i) < 2 and abs(j - crossing_j) < 2 for crossing_i, crossing_j in crossings)
    ]
    return [(place, True) for place in crossings] + [(place, False) for place in touches]


def _solved(
    system: System, places: list[_Place], settings: ConnectionSettings, spent: Spent
) -> tuple[list[Intersection], int]:
    """Return the intersections near places of the same sides, and the number of crossings without a solution.

    If Newton's method leaves the place, for example next to a fold thinner than a chord, the cuts are sampled more
    finely. Curves that are closer than the accuracy of their chords may not cross at all. `spent`: see `Spent`.
    """
    sides = places[0].sides
    solutions = _newton(
        system,
        sides,
        np.array([meeting_place.phases for meeting_place in places]),
        settings,
        np.array([meeting_place.reach for meeting_place in places]),
        spent,
    )
    accepted = [
        replace(solution, scale=place.scale)
        for place, solution in zip(places, solutions, strict=True)
        if solution is not None
    ]
    astray = [k for k, solution in enumerate(solutions) if solution is None or not places[k].holds(solution.phases)]
    if not astray:
        return accepted, 0
    curves = []
    for which, side in enumerate(sides):
        states, *_ = side.arrive(np.concatenate([places[k].spans[which] for k in astray]))
        ends = np.cumsum([len(places[k].spans[which]) for k in astray])[:-1]
        curves.append(np.split(section_points(system, side.section, states), ends))
    owners, guesses = [], []
    unsolved = {k for k in astray if places[k].sure and solutions[k] is None}
    for k, first, second in zip(astray, *curves, strict=True):
        if np.isfinite(first).all() and np.isfinite(second).all():
            meetings = _meetings(first, second + places[k].shift)
            if not any(sure for _, sure in meetings):
                unsolved.discard(k)
            for closer, _ in meetings:
                owners.append(k)
                guesses.append([np.interp(j, np.arange(len(span)), span)
                                for j, span in zip(closer, places[k].spans, strict=True)])  # fmt: skip
    finer_solutions = _newton(
        system, sides, np.array(guesses).reshape(-1, 2), settings, np.array([places[k].reach for k in owners]), spent
    )
    for k, solution in zip(owners, finer_solutions, strict=True):
        if solution is not None:
            accepted.append(replace(solution, scale=places[k].scale))
            unsolved.discard(k)
    return accepted, len(unsolved)


def _span(piece: Piece, place: float) -> Array:
    """Return finely spaced phases of a piece at a place and its neighbouring vertices, for a finer search there.

    `place`: fractional index of a vertex.
    """
    first, last = max(0, int(place) - 2), min(len(piece.phases) - 1, int(place) + 3)
    indices = np.linspace(first, last, _CLOSER * (last - first) + 1)
    return np.interp(indices, np.arange(len(piece.phases)), piece.phases)


@dataclass(frozen=True)
class _Approach:
    """A candidate intersection during Newton's method.

    Attributes:
        gap: largest component of the state difference.
        miss (2,): difference in section coordinates.
        same_way: True if both trajectories cross in the same direction.
    """

    crossing: Intersection
    gap: float
    miss: Array
    same_way: bool


def _approaches(system: System, sides: tuple[TubeSide, TubeSide], phases: Array) -> list[_Approach | None]:
    """Return the candidates for phases (K, 2) of the two tubes, from which Newton's method steps.

    A candidate is None if one of the trajectories does not arrive, or if its derivatives are not finite.
    """
    section = sides[0].section
    position, momentum = np.asarray(section.position), np.asarray(section.momentum) / momentum_scale(system, section)
    approaches: list[_Approach | None] = [None] * len(phases)
    arrivals = [side.arrive(phases[:, which]) for which, side in enumerate(sides)]
    both_arrive = np.flatnonzero(np.isfinite(arrivals[0][1]) & np.isfinite(arrivals[1][1]))
    if not both_arrive.size:
        return approaches
    states, times = [arrivals[k][0][both_arrive] for k in (0, 1)], [arrivals[k][1][both_arrive] for k in (0, 1)]
    tangents = []
    for which, side in enumerate(sides):
        seeds, seed_slopes = arrivals[which][2]
        slopes = side.slopes((seeds[both_arrive], seed_slopes[both_arrive]), states[which], times[which])
        momenta = np.einsum("kij,kj->ki", system.numeric.momentum_jacobian(states[which]), slopes)
        tangents.append(np.stack([slopes @ position, momenta @ momentum], axis=-1))
    turns = system.nearest_turns(states[0] - states[1])
    gaps = states[0] - states[1] - turns * system.turn_lengths
    miss = section_points(system, section, states[0]) - section_points(system, section, states[0] - gaps)
    crossing_directions = [np.sign(system.numeric.rate(arrived) @ np.asarray(section.normal)) for arrived in states]
    for j, k in enumerate(both_arrive):
        if not np.isfinite([tangents[0][j], tangents[1][j]]).all():
            continue
        crossing = Intersection(
            sides=sides,
            phases=phases[k].copy(),
            states=(states[0][j], states[1][j]),
            turns=turns[j],
            tangents=np.column_stack([tangents[0][j], tangents[1][j]]),
            times=(float(times[0][j]), float(times[1][j])),
        )
        approaches[k] = _Approach(
            crossing,
            float(np.abs(gaps[j]).max()),
            miss[j],
            bool(crossing_directions[0][j] == crossing_directions[1][j]),
        )
    return approaches


def _slopes(crossing: Intersection) -> Array:
    """Return the derivative (2, 2) of the gap between two arrivals by both phases, from the tangents of the cuts."""
    return np.column_stack([crossing.tangents[:, 0], -crossing.tangents[:, 1]])


def _newton(
    system: System,
    sides: tuple[TubeSide, TubeSide],
    guesses: Array,
    settings: ConnectionSettings,
    reach: Array,
    spent: Spent,
) -> list[Intersection | None]:
    """Return the intersections to which Newton's method leads from phases `guesses` (K, 2), None for failures.

    The two phases are changed until the arrivals of both tubes at the section are the same state. A failure leaves the
    range of phases `reach` (K,) about its guess, does not arrive, or does not converge in time. `spent`: see `Spent`.
    """
    phases, smallest_gaps = guesses.copy(), np.full(len(guesses), np.inf)
    results: list[Intersection | None] = [None] * len(guesses)
    active = np.arange(len(guesses))
    for _ in range(settings.newton_iterations):
        if not active.size or spent() >= 1:
            break
        continuing = []
        for k, approach in zip(active, _approaches(system, sides, phases[active]), strict=True):
            if approach is None:
                continue
            if approach.gap < settings.accept:
                results[k] = approach.crossing
                continue
            step = np.linalg.lstsq(_slopes(approach.crossing), approach.miss, rcond=1e-12)[0]
            longest = float(np.max(np.abs(step)))
            if longest < _AT_REST:
                # On sensitive flights, rounding of the phases alone causes a gap of this size.
                if approach.gap >= smallest_gaps[k]:
                    results[k] = approach.crossing if approach.same_way else None
                    continue
                smallest_gaps[k] = approach.gap
            # Steps are limited, because a larger one would leave the neighbourhood of the guess.
            phases[k] -= step * min(1.0, 0.05 / longest if longest else 1.0)
            if np.max(np.abs(phases[k] - guesses[k])) <= reach[k]:
                continuing.append(k)
        active = np.array(continuing, dtype=np.intp)
    return results


def _partners(
    system: System, crossings: list[Intersection], settings: ConnectionSettings, spent: Spent
) -> list[Intersection]:
    """Return further intersections within about one chord of known ones, the `crossings`, all of the same sides.

    Polylines do not resolve them. Along the direction of least change, the gap is a s + ½ b s² + c s³/6, with a, b, c
    from its derivatives at the known intersection and on both sides. Next to a saddle-node, a second zero is near
    -2a/b. Next to a pitchfork (b = 0), two more are near ±√(-6a/c). The angle between the cuts is no criterion: if they
    bend sharply, a pair within a hundredth of a phase may meet at 60°. `spent`: see `Spent`.
    """
    sides, gap_directions, phase_directions = crossings[0].sides, [], []
    for crossing in crossings:
        gap_vectors, _, phase_vectors = np.linalg.svd(_slopes(crossing))
        gap_directions.append(gap_vectors[:, -1])
        phase_directions.append(phase_vectors[-1] / np.abs(phase_vectors[-1]).max())
    phases = np.array([crossing.phases for crossing in crossings])
    neighbours = [_approaches(system, sides, phases + sign * _BESIDE * np.array(phase_directions)) for sign in (-1, 1)]
    owners, guesses = [], []
    for k, (crossing, *pair) in enumerate(zip(crossings, *neighbours, strict=True)):
        if pair[0] is None or pair[1] is None:
            continue
        derivatives = (_slopes(candidate) for candidate in (pair[0].crossing, crossing, pair[1].crossing))
        slope_before, slope, slope_after = (
            float(gap_directions[k] @ derivative @ phase_directions[k]) for derivative in derivatives
        )
        zeros = np.roots(
            [
                (slope_before - 2 * slope + slope_after) / (6 * _BESIDE**2),
                (slope_after - slope_before) / (4 * _BESIDE),
                slope,
            ]
        )
        roots = [
            float(root.real) for root in zeros if abs(root.imag) < abs(root.real) and abs(root) < _FARTHEST_PARTNER
        ]
        guesses += [crossing.phases + root * phase_directions[k] for root in roots]
        owners += [crossing] * len(roots)
    start = np.array(guesses).reshape(-1, 2)
    solved = _newton(system, sides, start, settings, np.full(len(start), _FARTHEST), spent)
    return [
        replace(solution, scale=owner.scale)
        for owner, solution in zip(owners, solved, strict=True)
        if solution is not None
    ]


def _add(
    system: System, solutions: list[Intersection], intersections: list[Intersection], settings: ConnectionSettings
) -> None:
    """Add solutions to the list `intersections` if their states differ from all previous ones, modulo whole turns.

    `settings`: the scaled distance `same` of equal states.
    """
    states = np.array([intersection.states[0] for intersection in intersections]).reshape(-1, system.dimension)
    for solution in solutions:
        if not (system.scaled_distance(states, solution.states[0]) < settings.same).any():
            intersections.append(solution)
            states = np.vstack([states, solution.states[0]])
