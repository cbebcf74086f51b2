"""Where an unstable and a stable tube's cuts meet on a section.

The stable tube is the unstable one turned around by a reverser. The cuts' polylines give first guesses, also where
they only nearly touch; Newton's method on (phase_u, phase_s) with the variational equations solves
P(W^u(phase_u)) = P(W^s(phase_s)) in the section's coordinates (q, p/p₀). No window, no count is given beforehand.
Beside every crossing others are looked for where the cuts' slopes and bend place them.

Source: Koon, Lo, Marsden, Ross, Heteroclinic connections between periodic orbits and resonance transitions in
celestial mechanics (2000), section 4; Kaheman et al. (2023), section 3.

Where two curves in the plane cross or nearly touch: first guesses for Newton's method.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System, momentum_scale
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.tubes.cut import Cut, CutSettings, Piece, longest_flight, section_points

Array = NDArray[np.float64]

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


_BESIDE = 1e-3  # phase over which the cuts' bend is measured, less than the 1/100 between the first samples of a cut
_FARTHEST_PARTNER = 0.05  # phase; the polylines tell partners apart that are farther off
_FARTHEST = 0.2  # phase from a guess to where Newton's method may lead
_CLOSER = 16  # points for each between neighbours of a cut where Newton's method did not converge from them
_AT_REST = 1e-10  # of a phase: Newton's steps where the rounding of seeds, grown with the flight, is what is left


@dataclass(frozen=True)
class ConnectionSettings:
    """distance: of seeds from their orbits, scaled (truncation falls as its cube, rounding grows as its inverse).

    accept: gap between the two tubes' arrivals below which they are taken for a connection before it is refined, as
    they are where only rounding keeps the gap larger; lead: periods of each orbit at least, farthest: scaled distance
    from it at most (its square is left out), nearest: at least (rounding), and segments: nodes per period, in the
    multiple-shooting refinement; near: scaled distance at which a connection is said to have joined its orbit. finest:
    chord to which cuts are refined where closed ones cross unevenly.
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


def search_settings(*, longest: float | None = None, thorough: bool = False) -> ConnectionSettings:
    """Return settings for a search.

    longest: periods of its orbit that a trajectory may take to the section, None for the system's own number; thorough:
    go on where a search is given up after seconds, for up to a minute.
    """
    cut = CutSettings(longest=longest)
    return ConnectionSettings(cut=cut.thoroughly() if thorough else cut)


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

    def points(self, phases: Array) -> Array | None:
        """Fly the seeds at phases (K,); return (q, p/p₀), (K, 2), or None where one does not arrive."""
        system = self.manifold.orbit.system
        seeds, _ = self.manifold.seeds(phases, self.branch)
        crossings = system.propagator.crossings(seeds, self.section, longest=self.longest, hit=self.hit)
        states = [c.state for c in crossings if c is not None]
        if len(states) < len(phases):
            return None
        return section_points(system, self.section, self.turned(np.array(states)))

    def arrive(self, phase: float) -> tuple[Array, Array, float] | None:
        """Fly the seed at `phase`; return (state, ∂state/∂phase on the section, seconds), or None."""
        system = self.manifold.orbit.system
        seeds, slopes = self.manifold.seeds(np.array([phase]), self.branch)
        crossing = system.propagator.crossing(seeds[0], self.section, longest=self.longest, hit=self.hit)
        if crossing is None:
            return None
        _, stm = system.propagator.flow_with_stm(seeds[0], crossing.time)
        slope, rate = stm @ slopes[0], system.numeric.rate(crossing.state)
        normal = np.asarray(self.section.normal)
        slope = slope - rate * (normal @ slope) / (normal @ rate)
        if self.stable:
            slope = self.manifold.orbit.reverser @ slope
        return self.turned(crossing.state), slope, crossing.time


@dataclass(frozen=True)
class Intersection:
    """Where two cuts meet: phases and branches of the seeds, states on the section, whole turns, tangents, times."""

    sides: tuple[TubeSide, TubeSide]
    phases: Array
    states: tuple[Array, Array]
    turns: Array
    tangents: Array
    times: tuple[float, float]


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
) -> tuple[list[Intersection], int]:
    """Intersect the pieces of two cuts; return distinct intersections and the number that did not converge.

    Where a symmetry exchanges the branches, only one branch of the unstable tube is searched.
    """
    found: list[Intersection] = []
    failed = 0
    mirrored = all(m.branches_are_mirrored for m in manifolds)

    def side(which: int, piece: Piece) -> TubeSide:
        longest = 2 * longest_flight(manifolds[which], settings.cut) * manifolds[which].orbit.period
        return TubeSide(manifolds[which], section, which == 1, cuts[which].hit, piece.branch, longest)

    stable = [(side(1, piece), _turned_piece(system, side(1, piece), piece)) for piece in cuts[1].pieces]
    for u_piece in cuts[0].pieces:
        if mirrored and u_piece.branch < 0:
            continue
        for s_side, s_piece in stable:
            if s_piece.direction != u_piece.direction:
                continue
            sides, here = (side(0, u_piece), s_side), list[Intersection]()
            for shift in _shifts(system, section, u_piece, s_piece, settings.cut.chord * system.section_scale):
                for places, sure in _meetings(u_piece.points, s_piece.points + shift):
                    solutions = _solved(system, sides, (u_piece, s_piece), places, shift, settings)
                    failed += int(sure and not solutions)
                    for solution in solutions:
                        if not _known(system, solution, here, settings):
                            here.append(solution)
                            here += [p for p in _partners(system, solution, settings)
                                     if not _known(system, p, here, settings)]  # fmt: skip
            found += here
    return found, failed


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
    if high[1] < least[1] - margin or low[1] > most[1] + margin:
        return []
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


def _solved(
    system: System,
    sides: tuple[TubeSide, TubeSide],
    pieces: tuple[Piece, Piece],
    places: tuple[float, float],
    shift: Array,
    settings: ConnectionSettings,
) -> list[Intersection]:
    """Solve for the intersections near a place along both pieces.

    Where Newton's method leads elsewhere, as from beside a fold thinner than a chord, the cuts are looked at closer.
    """
    spans = [_span(piece, place) for piece, place in zip(pieces, places, strict=True)]
    guess = [np.interp(k, np.arange(len(p.phases)), p.phases) for k, p in zip(places, pieces, strict=True)]
    # Newton's method may lead past neighbours of a place, but not to where the cuts have nothing to do with it.
    reach = min(_FARTHEST, 20 * max(float(span[-1] - span[0]) for span in spans))
    solution = _newton(system, sides, np.array(guess), settings, reach)
    found = [] if solution is None else [solution]
    if solution is not None and all(s[0] <= p <= s[-1] for s, p in zip(spans, solution.phases, strict=True)):
        return found
    curves = [side.points(span) for side, span in zip(sides, spans, strict=True)]
    if curves[0] is None or curves[1] is None:
        return found
    for closer, _ in _meetings(curves[0], curves[1] + shift):
        guess = [np.interp(k, np.arange(len(span)), span) for k, span in zip(closer, spans, strict=True)]
        solution = _newton(system, sides, np.array(guess), settings, reach)
        if solution is not None:
            found.append(solution)
    return found


def _span(piece: Piece, place: float) -> Array:
    """Return phases along the two segments of a piece on either side of a place, more densely than its own."""
    first, last = max(0, int(place) - 2), min(len(piece.phases) - 1, int(place) + 3)
    along = np.linspace(first, last, _CLOSER * (last - first) + 1)
    return np.interp(along, np.arange(len(piece.phases)), piece.phases)


def _gap(system: System, first: Array, second: Array) -> tuple[Array, Array]:
    """Return (state gap with whole turns removed (N,), whole turns (N,))."""
    difference = first - second
    turns = system.nearest_turns(difference)
    lengths = np.where(np.isfinite(system.periods), system.periods, 0.0)
    return difference - turns * lengths, turns


def _meeting(
    system: System, sides: tuple[TubeSide, TubeSide], phases: Array
) -> tuple[Intersection, Array, Array] | None:
    """Return how the trajectories from two phases miss each other on the section, None where one does not arrive.

    Returns (the would-be intersection, state gap (N,), gap (2,) in section coordinates).
    """
    section = sides[0].section
    scale = momentum_scale(system, section)
    position, along = np.asarray(section.position), np.asarray(section.momentum)
    forward, backward = sides[0].arrive(float(phases[0])), sides[1].arrive(float(phases[1]))
    if forward is None or backward is None:
        return None
    (xu, du, tu), (xs, ds, ts) = forward, backward
    gap, turns = _gap(system, xu, xs)
    tangents = np.array(
        [[position @ d, along @ (system.numeric.momentum_jacobian(x) @ d) / scale] for x, d in ((xu, du), (xs, ds))]
    ).T
    points = section_points(system, section, np.array([xu, xu - gap]))
    return Intersection(sides, phases.copy(), (xu, xs), turns, tangents, (tu, ts)), gap, points[0] - points[1]


def _slopes(crossing: Intersection) -> Array:
    """Return the derivative (2, 2) of the gap in section coordinates by both phases."""
    return np.column_stack([crossing.tangents[:, 0], -crossing.tangents[:, 1]])


def _newton(
    system: System,
    sides: tuple[TubeSide, TubeSide],
    guess: Array,
    settings: ConnectionSettings,
    reach: float = _FARTHEST,
) -> Intersection | None:
    """Solve for the two phases; None where Newton goes farther than `reach` or does not converge."""
    phases, resting = guess.copy(), np.inf
    for _ in range(settings.newton_iterations):
        met = _meeting(system, sides, phases)
        if met is None:
            return None
        crossing, gap, miss = met
        if float(np.abs(gap).max()) < settings.accept:
            return crossing
        step = np.linalg.lstsq(_slopes(crossing), miss, rcond=1e-12)[0]
        # A step of more than a few hundredths of a phase would leave the guess's neighbourhood.
        longest = float(np.max(np.abs(step)))
        if longest < _AT_REST:
            # Sensitive flights end this far apart from phases that differ by rounding alone.
            if float(np.abs(gap).max()) >= resting:
                return crossing
            resting = float(np.abs(gap).max())
        phases = phases - step * min(1.0, 0.05 / longest if longest else 1.0)
        if np.max(np.abs(phases - guess)) > reach:
            return None
    return None


def _partners(system: System, crossing: Intersection, settings: ConnectionSettings) -> list[Intersection]:
    """Return the crossings within about one chord of the cuts from a known one, which polylines do not tell apart.

    Along the direction in which the gap changes least it is a s + ½ b s² + c s³/6, with a, b, c from its derivative
    there and on both sides: beside a saddle-node a second zero is near -2a/b, beside a pitchfork (b = 0) two more are
    near ±√(-6a/c). The angle between the cuts does not tell: where they bend sharply a pair a hundredth of a phase
    apart may meet at 60°.
    """
    slopes = _slopes(crossing)
    left, _, right = np.linalg.svd(slopes)
    across, flat = left[:, -1], right[-1] / np.abs(right[-1]).max()
    around = [_meeting(system, crossing.sides, crossing.phases + s * _BESIDE * flat) for s in (-1, 1)]
    if around[0] is None or around[1] is None:
        return []
    before, here, after = (float(across @ m @ flat) for m in (_slopes(around[0][0]), slopes, _slopes(around[1][0])))
    zeros = np.roots([(before - 2 * here + after) / (6 * _BESIDE**2), (after - before) / (4 * _BESIDE), here])
    near = [float(s.real) for s in zeros if abs(s.imag) < abs(s.real) and abs(s) < _FARTHEST_PARTNER]
    found = [_newton(system, crossing.sides, crossing.phases + s * flat, settings) for s in near]
    return [f for f in found if f is not None]


def _known(system: System, one: Intersection, found: list[Intersection], settings: ConnectionSettings) -> bool:
    """Whether a solution is one of those found: the same point of the torus."""
    return any(bool(system.scaled_distance(one.states[0], f.states[0]) < settings.same) for f in found)
