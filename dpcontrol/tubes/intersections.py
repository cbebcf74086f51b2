"""Where an unstable and a stable tube's cuts meet on a section, and what lies inside them.

The stable tube is the unstable one turned around by a reverser. The cuts' polylines give first guesses, also where
they only nearly touch; Newton's method on (phase_u, phase_s) with the variational equations solves
P(W^u(phase_u)) = P(W^s(phase_s)) in the section's coordinates (q, p/p₀). No window, no count is given beforehand.
Beside every crossing others are looked for where the cuts' slopes and bend place them.

Source: Koon, Lo, Marsden, Ross, Heteroclinic connections between periodic orbits and resonance transitions in
celestial mechanics (2000), section 4; Kaheman et al. (2023), section 3.

*The inside of a tube*: a grid over the region that its cut encloses, carried through returns to the section.
Points (q, p/p₀) of a grid inside the unstable cut are turned into states on the section at the tube's energy.
What is inside the unstable tube has come through the saddle's bottleneck, what is inside the stable tube will go
through it; at each return, forward and backward, a point is labelled by the cut that it lies in, if any, and by the
whole turns since the start. The stable tube's interior is the unstable one's turned around in time, never integrated.

Each point keeps an angle about the region's innermost point and a radius, 0 there and 1 on the cut: the hue and the
saturation of a colour wheel. Source: Kaheman et al. (2023), section 3; Koon, Lo, Marsden, Ross (2000), section 4.

Closed cuts as outlines of regions of a section: which points lie inside, and the states that points stand for.

A point (q, p/p₀) becomes a state on the section: with θ(q) and the momentum along the section given, the velocity
across it, v = v₀ + s w, solves the energy's quadratic

    ½ vᵀ M v = H - V(θ),      the root with the asked direction of crossing.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System, momentum_scale
from dpcontrol.foundation.arguments import number
from dpcontrol.foundation.arrays import Array, Flags
from dpcontrol.foundation.budget import SECONDS
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import MOST_SECONDS
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.tubes.cut import Cut, CutSettings, Piece, longest_flight, section_points

_BLOCK = 32
"""Segments of the first curve at a time: compared only with those of the second that their box meets."""

_STRETCH = 8
"""Vertices of one curve that neighbours on another may have nearest to them, where both run beside each other."""


def polyline_crossings(first: Array, second: Array) -> list[tuple[float, float]]:
    """Return (i + s, j + t) where segment i of `first` (K, 2) crosses segment j of `second` (L, 2).

    s and t in [0, 1) are the fractions along the segments.
    """
    a, b = first[:-1], second[:-1]
    da, db = np.diff(first, axis=0), np.diff(second, axis=0)
    low, high = np.minimum(b, second[1:]), np.maximum(b, second[1:])
    starts = np.arange(0, len(b), _BLOCK)
    blocks = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
    # Wider than rounding can move a crossing.
    margin = 1e-9 * max(float(np.abs(first).max(initial=0.0)), float(np.abs(second).max(initial=0.0)))
    found: list[tuple[float, float]] = []
    for start in range(0, len(a), _BLOCK):
        part = slice(start, start + _BLOCK)
        box = first[start : start + _BLOCK + 1]
        least, most = box.min(axis=0) - margin, box.max(axis=0) + margin
        within = np.repeat(((blocks[0] <= most) & (blocks[1] >= least)).all(axis=1), _BLOCK)[: len(b)]
        near = np.flatnonzero(within)
        near = near[((low[near] <= most) & (high[near] >= least)).all(axis=1)]
        if not near.size:
            continue
        cross = da[part, None, 0] * db[None, near, 1] - da[part, None, 1] * db[None, near, 0]
        gap = b[None, near, :] - a[part, None, :]
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (gap[..., 0] * db[None, near, 1] - gap[..., 1] * db[None, near, 0]) / cross
            t = (gap[..., 0] * da[part, None, 1] - gap[..., 1] * da[part, None, 0]) / cross
        hits = (cross != 0) & (s >= 0) & (s < 1) & (t >= 0) & (t < 1)
        found += [(start + i + float(s[i, j]), int(near[j]) + float(t[i, j])) for i, j in np.argwhere(hits)]
    return found


def near_touches(first: Array, second: Array, *, margin: float = 4.0) -> list[tuple[float, float]]:
    """Return vertex pairs (i, j) where two sampled curves come so near that they may touch between their vertices.

    A smooth curve leaves its polyline by about an eighth of the second difference of its vertices (the sagitta). Where
    `first` passes `second` at a locally smallest distance within `margin` times both sagittas, the curves may cross
    twice although no segments do.
    """
    if len(first) < 3 or len(second) < 3:
        return []
    bends = _sagitta(first), _sagitta(second)
    reach = margin * float(bends[0].max() + bends[1].max())
    if ((first.min(axis=0) - reach > second.max(axis=0)) | (first.max(axis=0) + reach < second.min(axis=0))).any():
        return []
    tree = KDTree(second)
    nearest = np.clip(np.asarray(tree.query(first)[1]), 1, len(second) - 2)
    distance = np.minimum(
        _to_segment(first, second[nearest - 1], second[nearest]),
        _to_segment(first, second[nearest], second[nearest + 1]),
    )
    allowed = margin * (bends[0] + bends[1][nearest])
    # Neighbours that are near another stretch of the second curve say nothing about this one.
    along = np.abs(np.diff(nearest)) <= _STRETCH
    before = np.r_[np.inf, np.where(along, distance[:-1], np.inf)]
    after = np.r_[np.where(along, distance[1:], np.inf), np.inf]
    lowest = (distance <= allowed) & (distance <= before) & (distance <= after)
    return [(float(i), float(nearest[i])) for i in np.flatnonzero(lowest)]


def _sagitta(curve: Array) -> Array:
    """Return an eighth of the second difference at each vertex (K,), the ends taking their neighbours'."""
    inner = np.linalg.norm(curve[:-2] - 2 * curve[1:-1] + curve[2:], axis=1) / 8
    return np.r_[inner[:1], inner, inner[-1:]]


def _to_segment(points: Array, start: Array, end: Array) -> Array:
    """Return the distance (K,) of each point (K, 2) to its segment."""
    along = end - start
    length = np.maximum(np.sum(along**2, axis=1), np.finfo(float).tiny)
    share = np.clip(np.sum((points - start) * along, axis=1) / length, 0.0, 1.0)
    return np.linalg.norm(points - start - share[:, None] * along, axis=1)


_PLACED, _SOLVED, _PAIRED = 0.25, 0.5, 0.6  # of the time left after the cuts: what each step must have ended by
_THOROUGH = 50.0  # what is under way when they have passed takes a few more
_BESIDE = 1e-3  # phase over which the cuts' bend is measured, less than the 1/100 between the first samples of a cut
_FARTHEST_PARTNER = 0.05  # phase; the polylines tell partners apart that are farther off
_FARTHEST = 0.2  # phase from a guess to where Newton's method may lead
_CLOSER = 16  # points for each between neighbours of a cut where Newton's method did not converge from them
_TOGETHER = 256  # places that are solved at once
_AT_REST = 1e-10  # of a phase: Newton's steps where the rounding of seeds, grown with the flight, is what is left


@dataclass(frozen=True)
class ConnectionSettings:
    """distance: of seeds from their orbits, scaled (truncation falls as its cube, rounding grows as its inverse).

    accept: gap between the two tubes' arrivals below which they are taken for a connection before it is refined, as
    they are where only rounding keeps the gap larger; lead: periods of each orbit at least, farthest: scaled distance
    from it at most (its square is left out), nearest: at least (rounding), and segments: nodes per period, in the
    multiple-shooting refinement; near: scaled distance at which a connection is said to have joined its orbit. finest:
    chord to which cuts are refined where closed ones cross unevenly. seconds: of processor time after which a search
    ends with what it has. thorough: whether it goes on for as long as it may, so that to advise it would not help.
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


MOST_PERIODS = 1000.0


def search_settings(
    *, longest: float | None = None, thorough: bool = False, seconds: float | None = None
) -> ConnectionSettings:
    """Return settings for a search.

    longest: periods of its orbit that a trajectory may take to the section, None for the system's own number; thorough:
    go on where a search would be given up, for up to a minute; seconds: of processor time, instead of a minute.

    Raises:
        InputError: no time, or more than the longest.
    """
    seconds = seconds if seconds is None or isinstance(seconds, float) else number("seconds", seconds)
    if seconds is not None and not 0 < seconds <= MOST_SECONDS:
        raise InputError(f"seconds = {seconds:g}: must be positive, and at most {MOST_SECONDS:g} s")
    longest = longest if longest is None or isinstance(longest, float) else number("longest", longest)
    if longest is not None and not 0 < longest <= MOST_PERIODS:
        raise InputError(f"longest = {longest:g}: must be positive, and at most {MOST_PERIODS:g} periods of the orbit")
    cut = CutSettings(longest=longest)
    if thorough:
        # Cuts take what share of a longer time they take of the usual one.
        cut = cut.thoroughly()
        cut = replace(cut, seconds=cut.seconds * (seconds or _THOROUGH) / _THOROUGH)
    return ConnectionSettings(cut=cut, seconds=seconds or (_THOROUGH if thorough else SECONDS), thorough=thorough)


@dataclass(frozen=True)
class TubeSide:
    """One tube as it arrives at the section: the manifold, the reverser for a stable tube, hit and branch."""

    manifold: UnstableManifold
    section: Section
    stable: bool
    hit: int
    branch: int
    longest: float

    def turned(self, states: Array) -> Array:
        """Map states (…, N) of the unstable tube to this tube: themselves, or turned around in time."""
        if not self.stable:
            return states
        reverser, centre = self.manifold.orbit.reverser, self.manifold.orbit.centre
        return (states - centre) @ reverser.T + centre

    def arrive(self, phases: Array) -> tuple[Array, Array, tuple[Array, Array]]:
        """Fly the seeds at phases (K,) to the section.

        Returns states (K, N) and seconds (K,), not a number where one never arrives, and the seeds with their
        derivatives by phase, each (K, N).
        """
        system = self.manifold.orbit.system
        seeds, slopes = self.manifold.seeds(phases, self.branch)
        flown = system.propagator.crossings(seeds, self.section, longest=self.longest, hit=self.hit)
        never = np.full(system.dimension, np.nan)
        states = np.array([never if c is None else c.state for c in flown]).reshape(-1, system.dimension)
        return self.turned(states), np.array([np.nan if c is None else c.time for c in flown]), (seeds, slopes)

    def slopes(self, seeds: tuple[Array, Array], states: Array, times: Array) -> Array:
        """Return the derivatives (K, N) by phase, along the section, of states (K, N) that arrived after times (K,)."""
        system = self.manifold.orbit.system
        _, grown = system.propagator.flows_with_tangents(seeds[0], times, seeds[1])
        normal = np.asarray(self.section.normal)
        if self.stable:
            grown = grown @ self.manifold.orbit.reverser.T
        rates = system.numeric.rate(states)
        return grown - rates * ((grown @ normal) / (rates @ normal))[:, None]


@dataclass(frozen=True)
class Intersection:
    """Where two cuts meet: phases and branches of the seeds, states on the section, whole turns, tangents, times.

    scale: of the place that led here, zero where none did.
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
    """Where two cuts cross, those that a coarse sampling shows first.

    failed: places that led to no crossing although the cuts, looked at closer, cross there; left: pieces not compared,
    places not tried, and crossings beside which none was looked for, as time had run out.
    """

    found: list[Intersection]
    failed: int
    left: int = 0


@dataclass(frozen=True)
class _Place:
    """Where two polylines meet: phases (2,), and each cut's phases near it; `shift` (2,) brings the second to the
    first. sure: they really cross."""

    sides: tuple[TubeSide, TubeSide]
    phases: Array
    spans: tuple[Array, Array]
    shift: Array
    sure: bool

    @property
    def scale(self) -> float:
        """How many phases the more finely sampled of the cuts takes here."""
        return min(float(span[-1] - span[0]) for span in self.spans)

    @property
    def reach(self) -> float:
        """How far Newton's method may lead: past neighbours, not to where the cuts have nothing to do with it."""
        return min(_FARTHEST, 20 * max(float(span[-1] - span[0]) for span in self.spans))

    def holds(self, phases: Array) -> bool:
        """Whether phases (2,) lie within both cuts' near the place."""
        return all(span[0] <= phase <= span[-1] for span, phase in zip(self.spans, phases, strict=True))


@dataclass(frozen=True)
class _Pair:
    """Two cuts' pieces that may meet where the second's points are moved by `shift` (2,)."""

    sides: tuple[TubeSide, TubeSide]
    pieces: tuple[Piece, Piece]
    shift: Array

    @property
    def scale(self) -> float:
        """The longer of the shorter piece's steps: at most what its places have."""
        return min(float(np.diff(piece.phases).max()) for piece in self.pieces)

    def places(self) -> list[_Place]:
        """Return where the pieces meet."""
        first, second = self.pieces
        return [
            _Place(
                self.sides,
                np.array([np.interp(k, np.arange(len(p.phases)), p.phases)
                          for k, p in zip(at, self.pieces, strict=True)]),
                (_span(first, at[0]), _span(second, at[1])),
                self.shift,
                sure,
            )
            for at, sure in _meetings(first.points, second.points + self.shift)
        ]  # fmt: skip


Meeting = TypeVar("Meeting", _Place, Intersection)


def _turned_piece(system: System, side: TubeSide, piece: Piece) -> Piece:
    """Return a piece of the stable tube's cut from the unstable tube's."""
    states = side.turned(piece.states)
    normal = system.numeric.rate(states[:1])[0] @ np.asarray(side.section.normal)
    return replace(
        piece,
        states=states,
        points=section_points(system, side.section, states),
        direction=int(np.sign(normal)),
    )


def intersect_cuts(
    system: System,
    section: Section,
    manifolds: tuple[UnstableManifold, UnstableManifold],
    cuts: tuple[Cut, Cut],
    settings: ConnectionSettings,
    *,
    spent: Callable[[], float] = lambda: 0.0,
) -> Crossings:
    """Intersect the pieces of two cuts; return distinct intersections.

    spent: returns which share of a search's time after the cuts has passed; the connections' refinement takes the rest.
    Where a symmetry exchanges the branches, only one branch of the unstable tube is searched.
    """
    mirrored = all(m.branches_are_mirrored for m in manifolds)
    pairs: list[_Pair] = []
    for branches in ((1, 1), (1, -1)) if mirrored else ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        sides = tuple(
            TubeSide(m, section, k == 1, cuts[k].hit, branches[k], 2 * longest_flight(m, settings.cut) * m.orbit.period)
            for k, m in enumerate(manifolds)
        )
        pairs += _pairs(system, (sides[0], sides[1]), cuts, settings)
    # What a coarse sampling shows comes first, should time run out: where tubes scatter, ever finer pieces follow.
    pairs.sort(key=lambda pair: -pair.scale)
    places: list[_Place] = []
    found: list[Intersection] = []
    failed = left = 0
    for k, pair in enumerate(pairs):
        if spent() > _PLACED:
            left += len(pairs) - k
            break
        places += pair.places()
    places.sort(key=lambda place: (-place.scale, not place.sure))
    for part in _together(places):
        if spent() > _SOLVED:
            left += len(part)
            continue
        solutions, unsolved = _solved(system, part, settings)
        failed += unsolved
        _add(system, solutions, found, settings)
    for part in _together(found):
        if spent() > _PAIRED:
            left += len(part)
            continue
        _add(system, _partners(system, part, settings), found, settings)
    return Crossings(sorted(found, key=lambda one: -one.scale), failed, left)


def _together(many: Sequence[Meeting]) -> list[list[Meeting]]:
    """Split places or crossings, in their order, into parts that are solved at once: of the same branches."""
    parts = []
    for start in range(0, len(many), _TOGETHER):
        within: dict[tuple[int, int], list[Meeting]] = {}
        for one in many[start : start + _TOGETHER]:
            within.setdefault((one.sides[0].branch, one.sides[1].branch), []).append(one)
        parts += within.values()
    return parts


def _pairs(
    system: System, sides: tuple[TubeSide, TubeSide], cuts: tuple[Cut, Cut], settings: ConnectionSettings
) -> list[_Pair]:
    """Return the pieces of one cut's branch and those of the other's that come near each other."""
    section, margin, found = sides[0].section, settings.cut.chord * system.section_scale, []
    first, second = ([piece for piece in cut.pieces if piece.branch == side.branch]
                     for cut, side in zip(cuts, sides, strict=True))  # fmt: skip
    second = [_turned_piece(system, sides[1], piece) for piece in second]
    ways = np.array([piece.direction for piece in second])
    momenta = np.array([(p.points[:, 1].min(), p.points[:, 1].max()) for p in second]).reshape(-1, 2)
    for u in first:
        low, high = u.points[:, 1].min() - margin, u.points[:, 1].max() + margin
        for k in np.flatnonzero((ways == u.direction) & (momenta[:, 0] <= high) & (momenta[:, 1] >= low)):
            s = second[k]
            found += [_Pair(sides, (u, s), shift) for shift in _shifts(system, section, u, s, margin)]
    return found


def balanced(crossings: list[Intersection], cuts: tuple[Cut, Cut]) -> bool:
    """Whether closed cuts cross each other as often one way as the other, as closed curves must.

    Counted for each pair of branches whose cuts are closed and do not go round an angle; others cannot tell. Where the
    counts differ, crossings were missed; that they agree does not prove the contrary, for pairs may be missed.
    Source: Guillemin & Pollack, Differential Topology (1974), section 3.3 (oriented intersection numbers).
    """

    def closed(cut: Cut, branch: int) -> bool:
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
    """Return the whole turns (2,) in (q, p/p₀) that bring one piece to another, or within a margin of it."""
    period = float(system.periods[int(np.argmax(np.abs(section.position)))])
    (low, high), (least, most) = ((p.points.min(axis=0), p.points.max(axis=0)) for p in (u, s))
    if not np.isfinite(period):
        return [np.zeros(2)] if high[0] >= least[0] - margin and low[0] <= most[0] + margin else []
    first = int(np.ceil((low[0] - most[0] - margin) / period))
    last = int(np.floor((high[0] - least[0] + margin) / period))
    return [np.array([k * period, 0.0]) for k in range(first, last + 1)]


def _meetings(first: Array, second: Array) -> list[tuple[tuple[float, float], bool]]:
    """Return places (i, j) along two polylines (K, 2), (L, 2) and whether they really cross there."""
    crossings = polyline_crossings(first, second)
    # A near touch within two segments of a crossing is that crossing.
    touches = [
        (i, j)
        for i, j in near_touches(first, second)
        if not any(abs(i - a) < 2 and abs(j - b) < 2 for a, b in crossings)
    ]
    return [(place, True) for place in crossings] + [(place, False) for place in touches]


def _solved(system: System, places: list[_Place], settings: ConnectionSettings) -> tuple[list[Intersection], int]:
    """Solve for the intersections near places of the same sides; return them, and how many led to none.

    Where Newton's method leads elsewhere, as from beside a fold thinner than a chord, the cuts are looked at closer.
    Curves that run beside each other nearer than their chords follow them may not cross there at all.
    """
    sides = places[0].sides
    solutions = _newton(
        system, sides, np.array([p.phases for p in places]), settings, np.array([p.reach for p in places])
    )
    found = [replace(one, scale=place.scale) for place, one in zip(places, solutions, strict=True) if one is not None]
    astray = [k for k, one in enumerate(solutions) if one is None or not places[k].holds(one.phases)]
    if not astray:
        return found, 0
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
    again = _newton(
        system, sides, np.array(guesses).reshape(-1, 2), settings, np.array([places[k].reach for k in owners])
    )
    for k, one in zip(owners, again, strict=True):
        if one is not None:
            found.append(replace(one, scale=places[k].scale))
            unsolved.discard(k)
    return found, len(unsolved)


def _span(piece: Piece, place: float) -> Array:
    """Return phases along the two segments of a piece on either side of a place, more densely than its own."""
    first, last = max(0, int(place) - 2), min(len(piece.phases) - 1, int(place) + 3)
    along = np.linspace(first, last, _CLOSER * (last - first) + 1)
    return np.interp(along, np.arange(len(piece.phases)), piece.phases)


@dataclass(frozen=True)
class _Approach:
    """A would-be intersection: the largest component of its state gap, its gap (2,) in section coordinates, and whether
    both trajectories cross the section the same way."""

    crossing: Intersection
    gap: float
    miss: Array
    same_way: bool


def _approaches(system: System, sides: tuple[TubeSide, TubeSide], phases: Array) -> list[_Approach | None]:
    """Return how trajectories from pairs of phases (K, 2) miss each other, None where one does not arrive."""
    section = sides[0].section
    position, along = np.asarray(section.position), np.asarray(section.momentum) / momentum_scale(system, section)
    found: list[_Approach | None] = [None] * len(phases)
    flown = [side.arrive(phases[:, which]) for which, side in enumerate(sides)]
    both = np.flatnonzero(np.isfinite(flown[0][1]) & np.isfinite(flown[1][1]))
    if not both.size:
        return found
    states, times = [flown[k][0][both] for k in (0, 1)], [flown[k][1][both] for k in (0, 1)]
    tangents = []
    for which, side in enumerate(sides):
        seeds, seed_slopes = flown[which][2]
        slopes = side.slopes((seeds[both], seed_slopes[both]), states[which], times[which])
        momenta = np.einsum("kij,kj->ki", system.numeric.momentum_jacobian(states[which]), slopes)
        tangents.append(np.stack([slopes @ position, momenta @ along], axis=-1))
    turns = system.nearest_turns(states[0] - states[1])
    gaps = states[0] - states[1] - turns * system.turn_lengths
    miss = section_points(system, section, states[0]) - section_points(system, section, states[0] - gaps)
    ways = [np.sign(system.numeric.rate(arrived) @ np.asarray(section.normal)) for arrived in states]
    for j, k in enumerate(both):
        crossing = Intersection(
            sides=sides,
            phases=phases[k].copy(),
            states=(states[0][j], states[1][j]),
            turns=turns[j],
            tangents=np.column_stack([tangents[0][j], tangents[1][j]]),
            times=(float(times[0][j]), float(times[1][j])),
        )
        found[k] = _Approach(crossing, float(np.abs(gaps[j]).max()), miss[j], bool(ways[0][j] == ways[1][j]))
    return found


def _slopes(crossing: Intersection) -> Array:
    """Return the derivative (2, 2) of the gap in section coordinates by both phases."""
    return np.column_stack([crossing.tangents[:, 0], -crossing.tangents[:, 1]])


def _newton(
    system: System, sides: tuple[TubeSide, TubeSide], guesses: Array, settings: ConnectionSettings, reach: Array
) -> list[Intersection | None]:
    """Solve for pairs of phases from guesses (K, 2); None where Newton goes farther than `reach` (K,) or never ends."""
    phases, resting = guesses.copy(), np.full(len(guesses), np.inf)
    found: list[Intersection | None] = [None] * len(guesses)
    going = np.arange(len(guesses))
    for _ in range(settings.newton_iterations):
        if not going.size:
            break
        on = []
        for k, one in zip(going, _approaches(system, sides, phases[going]), strict=True):
            if one is None:
                continue
            if one.gap < settings.accept:
                found[k] = one.crossing
                continue
            step = np.linalg.lstsq(_slopes(one.crossing), one.miss, rcond=1e-12)[0]
            longest = float(np.max(np.abs(step)))
            if longest < _AT_REST:
                # Sensitive flights end this far apart from phases that differ by rounding alone.
                if one.gap >= resting[k]:
                    found[k] = one.crossing if one.same_way else None
                    continue
                resting[k] = one.gap
            # A step of more than a few hundredths of a phase would leave the guess's neighbourhood.
            phases[k] -= step * min(1.0, 0.05 / longest if longest else 1.0)
            if np.max(np.abs(phases[k] - guesses[k])) <= reach[k]:
                on.append(k)
        going = np.array(on, dtype=np.intp)
    return found


def _partners(system: System, crossings: list[Intersection], settings: ConnectionSettings) -> list[Intersection]:
    """Return the crossings within about one chord of the cuts from known ones, which polylines do not tell apart.

    Along the direction in which the gap changes least it is a s + ½ b s² + c s³/6, with a, b, c from its derivative
    there and on both sides: beside a saddle-node a second zero is near -2a/b, beside a pitchfork (b = 0) two more are
    near ±√(-6a/c). The angle between the cuts does not tell: where they bend sharply a pair a hundredth of a phase
    apart may meet at 60°.
    """
    sides, across, flat = crossings[0].sides, [], []
    for crossing in crossings:
        left, _, right = np.linalg.svd(_slopes(crossing))
        across.append(left[:, -1])
        flat.append(right[-1] / np.abs(right[-1]).max())
    phases = np.array([crossing.phases for crossing in crossings])
    beside = [_approaches(system, sides, phases + sign * _BESIDE * np.array(flat)) for sign in (-1, 1)]
    owners, guesses = [], []
    for k, (crossing, *pair) in enumerate(zip(crossings, *beside, strict=True)):
        if pair[0] is None or pair[1] is None:
            continue
        around = (_slopes(c) for c in (pair[0].crossing, crossing, pair[1].crossing))
        before, here, after = (float(across[k] @ m @ flat[k]) for m in around)
        zeros = np.roots([(before - 2 * here + after) / (6 * _BESIDE**2), (after - before) / (4 * _BESIDE), here])
        near = [float(s.real) for s in zeros if abs(s.imag) < abs(s.real) and abs(s) < _FARTHEST_PARTNER]
        guesses += [crossing.phases + s * flat[k] for s in near]
        owners += [crossing] * len(near)
    start = np.array(guesses).reshape(-1, 2)
    solved = _newton(system, sides, start, settings, np.full(len(start), _FARTHEST))
    return [replace(one, scale=owner.scale) for owner, one in zip(owners, solved, strict=True) if one is not None]


def _add(
    system: System, solutions: list[Intersection], found: list[Intersection], settings: ConnectionSettings
) -> None:
    """Add to those found the solutions that are none of them: other points of the torus."""
    known = np.array([other.states[0] for other in found]).reshape(-1, system.dimension)
    for one in solutions:
        if not (system.scaled_distance(known, one.states[0]) < settings.same).any():
            found.append(one)
            known = np.vstack([known, one.states[0]])


Labels = NDArray[np.int8]


@dataclass(frozen=True)
class Outline:
    """A closed cut in (q, p/p₀): vertices (V, 2); branch of its tube; direction of crossing, +1 or -1."""

    vertices: Array
    branch: int
    direction: int
    stable: bool


def outlines_of(cut: Cut, manifold: UnstableManifold) -> tuple[Outline, ...]:
    """Return the closed pieces of a tube's cut and of the stable tube's, which is the cut turned around in time."""
    system, section = manifold.orbit.system, cut.section
    found = []
    for stable in (False, True):
        for piece in cut.pieces:
            if not piece.closed:
                continue
            states = TubeSide(manifold, section, stable, cut.hit, piece.branch, 0.0).turned(piece.states)
            points = section_points(system, section, states)
            rate = float(system.numeric.rate(states[0]) @ np.asarray(section.normal))
            if np.linalg.norm(points[0] - points[-1]) > np.abs(np.diff(points, axis=0)).max() * 4:
                continue  # winds around the torus: it has no inside
            found.append(Outline(points, piece.branch, int(np.sign(rate)), stable))
    return tuple(found)


def inside(points: Array, vertices: Array) -> Flags:
    """Tell which points (K, 2) lie inside a closed polygon (V, 2), by counting the edges that a ray crosses."""
    result = np.zeros(len(points), dtype=bool)
    x, y = points[:, 0], points[:, 1]
    for (x0, y0), (x1, y1) in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        if y0 == y1:
            continue
        spans = (y0 > y) != (y1 > y)
        result ^= spans & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return result


def labels(
    system: System, section: Section, outlines: tuple[Outline, ...], points: Array, direction: NDArray[Any]
) -> Labels:
    """Return the branch of the outline that each point (K, 2), crossing in `direction` (K,), lies in, or 0."""
    found = np.zeros(len(points), dtype=np.int8)
    period = position_period(system, section)
    for outline in outlines:
        q = points[:, 0]
        if period is not None:
            middle = (outline.vertices[:, 0].min() + outline.vertices[:, 0].max()) / 2
            q = q - np.rint((q - middle) / period) * period
        hit = inside(np.column_stack([q, points[:, 1]]), outline.vertices) & (direction == outline.direction)
        found[hit] = outline.branch
    return found


def section_states(
    system: System, section: Section, points: Array, *, energy: float, direction: int, level: float
) -> tuple[Array, Flags]:
    """Return states (K, N) at (q, p/p₀) (K, 2) on n·x = level with an energy and a direction, and which exist."""
    n = system.dimension // 2
    normal, position = np.asarray(section.normal)[:n], np.asarray(section.position)[:n]
    along = np.asarray(section.momentum)
    q = np.linalg.solve(np.array([normal, position]), np.array([np.full(len(points), level), points[:, 0]])).T
    still = np.hstack([q, np.zeros_like(q)])
    mass = system.numeric.mass_matrix(still)
    momentum = points[:, 1] * momentum_scale(system, section)
    # Any momentum with the given part along the section, and the direction that leaves that part alone.
    base = np.outer(momentum / (along @ along), along) - system.numeric.momentum(still)
    across = np.broadcast_to(np.array([-along[1], along[0]]), base.shape)
    v0, w = (np.linalg.solve(mass, part[..., None])[..., 0] for part in (base, across))
    a = np.einsum("ki,kij,kj->k", w, mass, w) / 2
    b = np.einsum("ki,kij,kj->k", v0, mass, w)
    c = np.einsum("ki,kij,kj->k", v0, mass, v0) / 2 + system.numeric.hamiltonian(still) - energy
    discriminant = b * b - 4 * a * c
    exists = discriminant >= 0
    root = np.sqrt(np.where(exists, discriminant, 0.0))
    chosen: Array = np.asarray(np.hstack([q, v0]), dtype=float)
    fits = np.zeros(len(points), dtype=bool)
    for sign in (1, -1):
        velocity = v0 + ((-b + sign * root) / (2 * a))[:, None] * w
        right = exists & (np.sign(velocity @ normal) == direction)
        chosen[right, n:] = velocity[right]
        fits |= right
    return chosen, fits


def position_period(system: System, section: Section) -> float | None:
    """Return the period of the section's coordinate q, or None on a line."""
    period = float(system.periods[int(np.argmax(np.abs(section.position)))])
    return period if np.isfinite(period) else None


def place_on_section(system: System, section: Section, states: Array) -> tuple[Array, Labels]:
    """Return (q, p/p₀) with q within half a period of zero, and the direction of crossing, of states (…, N)."""
    points = section_points(system, section, states)
    period = position_period(system, section)
    if period is not None:
        points[..., 0] -= np.rint(points[..., 0] / period) * period
    direction = np.sign(system.numeric.rate(states) @ np.asarray(section.normal))
    return points, direction.astype(np.int8)


SKIP = 1e-6
"""Seconds flown before the next return is looked for, so that the start is not taken for it."""


_AT_ONCE = 200
"""Points flown to a return at once."""


@dataclass(frozen=True)
class InteriorSettings:
    """across: grid points over the cut's width and over its height; returns: either way; longest: periods to each."""

    across: int = 60
    returns: int = 3
    longest: float = 12.0


@dataclass(frozen=True)
class Returns:
    """Where K points are at each of R returns in one direction of time; entries count only where `arrived`.

    states (K, R, N) lifted; points (K, R, 2): (q, p/p₀), q within half a period of zero; seconds (K, R) since the
    start, positive either way; winding (K, R, n): whole turns of the angles since the start, nearest; direction
    (K, R): sign of the crossing; in_unstable, in_stable (K, R): branch of the cut that the point lies in, or 0.
    """

    arrived: Flags
    states: Array
    points: Array
    seconds: Array
    winding: NDArray[np.int64]
    direction: Labels
    in_unstable: Labels
    in_stable: Labels


@dataclass(frozen=True)
class TubeInterior:
    """A grid of K points inside one tube's cut, and its returns.

    branch: of the unstable tube. points (K, 2), states (K, N); angle (K,) rad and radius (K,) from 0 to 1: hue and
    saturation. outlines: the closed cuts of both tubes. status: a sentence.
    """

    orbit: LyapunovOrbit
    section: Section
    branch: int
    points: Array
    states: Array
    angle: Array
    radius: Array
    forward: Returns
    backward: Returns
    outlines: tuple[Outline, ...]
    status: str


def tube_interior(
    manifold: UnstableManifold,
    cut: Cut,
    *,
    branch: int = 1,
    settings: InteriorSettings | None = None,
) -> TubeInterior:
    """Carry a grid of the inside of an unstable tube's cut through returns, forward and backward.

    Raises:
        InputError: a branch that is not +1 or -1 or whose cut is not closed, or a system that has not two degrees of
            freedom.
    """
    settings = settings or InteriorSettings()
    orbit, section = manifold.orbit, cut.section
    system = orbit.system
    if branch not in (1, -1):
        raise InputError(f"branch = {branch}: must be +1 or -1")
    if system.dimension != 4:
        raise InputError(
            f"{system.name} has {system.dimension // 2} degrees of freedom: a cut encloses an area for two"
        )
    outlines = outlines_of(cut, manifold)
    own = [o for o in outlines if o.branch == branch and not o.stable]
    if not own:
        ends = [end.reason for end in cut.open_ends if end.branch == branch]
        reason = ends[0] if ends else cut.status
        raise InputError(
            f"branch {branch:+d} has no closed cut at crossing {cut.hit} of {section.name}, so no inside: {reason}; "
            "use another section, crossing or energy"
        )
    piece = next(p for p in cut.pieces if p.branch == branch and p.closed)
    level = float(piece.states[0] @ np.asarray(section.normal))
    points = _grid(own[0].vertices, settings.across)
    states, fits = section_states(system, section, points, energy=orbit.energy, direction=own[0].direction, level=level)
    points, states = points[fits], states[fits]
    if not len(points):
        raise InputError(f"the cut of branch {branch:+d} is too thin for {settings.across} points across; ask for more")
    angle, radius = _wheel(points, own[0].vertices)
    runs = [_carried(orbit, section, states, sign, outlines, settings) for sign in (1, -1)]
    back = [int(np.count_nonzero(run.arrived[:, -1])) for run in runs]
    status = f"{len(points)} points; {back[0]} return {settings.returns} times forward, {back[1]} backward"
    return TubeInterior(orbit, section, branch, points, states, angle, radius, runs[0], runs[1], outlines, status)


def _carried(
    orbit: LyapunovOrbit,
    section: Section,
    states: Array,
    sign: int,
    outlines: tuple[Outline, ...],
    settings: InteriorSettings,
) -> Returns:
    """Fly every state to its returns in one direction of time."""
    system = orbit.system
    shape = (len(states), settings.returns)
    arrived = np.zeros(shape, dtype=bool)
    flown = np.repeat(states[:, None, :], settings.returns, axis=1)
    seconds = np.zeros(shape)
    longest = settings.longest * orbit.period
    here, elapsed, going = states, np.zeros(len(states)), np.arange(len(states))
    for r in range(settings.returns):
        following = []
        for part in np.array_split(going, max(1, len(going) // _AT_ONCE)):
            started = np.array([system.propagator.flow(here[k], sign * SKIP) for k in part]).reshape(
                -1, system.dimension
            )
            crossings = system.propagator.crossings(started, section, longest=sign * longest)
            for k, crossing in zip(part, crossings, strict=True):
                if crossing is None:
                    continue
                elapsed[k] += SKIP + abs(crossing.time)
                arrived[k, r], flown[k, r], seconds[k, r] = True, crossing.state, elapsed[k]
                following.append(k)
        going = np.array(following, dtype=int)
        here = flown[:, r]
    points, direction = place_on_section(system, section, flown)
    n = system.dimension // 2
    winding = system.nearest_turns(flown - states[:, None, :])[..., :n].astype(np.int64)
    found = [
        labels(
            system,
            section,
            tuple(o for o in outlines if o.stable is stable),
            points.reshape(-1, 2),
            direction.ravel(),
        ).reshape(shape)
        for stable in (False, True)
    ]
    return Returns(
        arrived=arrived,
        states=flown,
        points=np.where(arrived[..., None], points, 0.0),
        seconds=seconds,
        winding=np.where(arrived[..., None], winding, 0),
        direction=np.where(arrived, direction, 0).astype(np.int8),
        in_unstable=np.where(arrived, found[0], 0).astype(np.int8),
        in_stable=np.where(arrived, found[1], 0).astype(np.int8),
    )


def _grid(vertices: Array, across: int) -> Array:
    """Return the points (K, 2) of a grid over the bounding box that lie inside."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    axes = [np.linspace(a, b, across + 2)[1:-1] for a, b in zip(low, high, strict=True)]
    mesh = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    return mesh[inside(mesh, vertices)]


def _wheel(points: Array, vertices: Array) -> tuple[Array, Array]:
    """Return angles about the innermost point, in rad, and radii: 0 there, 1 on the cut."""
    span = np.ptp(vertices, axis=0)
    x, edge = points / span, np.vstack([vertices, vertices[:1]]) / span
    depth = np.full(len(x), np.inf)
    for a, b in pairwise(edge):
        along = b - a
        length = float(along @ along)
        share = np.clip((x - a) @ along / length, 0, 1) if length else np.zeros(len(x))
        depth = np.minimum(depth, np.linalg.norm(x - a - share[:, None] * along, axis=1))
    centre = x[np.argmax(depth)]
    gap = x - centre
    return np.arctan2(gap[:, 1], gap[:, 0]) % (2 * np.pi), 1 - depth / depth.max()
