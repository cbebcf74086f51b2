"""The cut of a tube: the curve in which an unstable manifold first (n-th) meets a Poincaré section.

The curve is sampled over the phase of its seeds and refined by chord length in (q, p/p₀) until neighbouring
points are close. Where it cannot be refined the curve is open: a trajectory grazes the section (its crossing
jumps), or never arrives in the time allowed. Open ends are found by bisection and reported, never bridged.

Samples of a tube's cut: seeds flown to the section, refined in phase until neighbouring points are close.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System, momentum_scale
from dpcontrol.orbits.manifold import UnstableManifold

Array = NDArray[np.float64]

_THOROUGH = 20_000
"""Phases of a thorough cut: windows between them in which trajectories go another way are narrower than 5e-5."""

_NARROWEST = 1e-7
"""Phase between neighbours at which a thorough cut stops: where tubes scatter, narrower windows follow without end."""


@dataclass(frozen=True)
class CutSettings:
    """How a tube is cut.

    chord: between neighbours in (q, p/p₀), in units of the system's section scale; longest: periods of the orbit that
    a trajectory may take, None for the system's own number; most_jumps: more phase intervals than this that stay wide
    below fine_phase_step mean that the curve is not a curve there (its trajectories scatter chaotically before they
    arrive), and refinement stops. grazing: a normal rate below this share of the largest means a grazing crossing.
    """

    first_phases: int = 100
    chord: float = 0.05
    smallest_phase_step: float = 1e-9
    longest: float | None = None
    most_points: int = 20_000
    fine_phase_step: float = 1e-4
    most_jumps: int = 40
    grazing: float = 0.01

    def thoroughly(self) -> "CutSettings":
        """Return settings that sample phases ten thousandths of a turn apart and refine wherever chords stay wide."""
        return replace(
            self,
            first_phases=_THOROUGH,
            most_points=3 * _THOROUGH,
            most_jumps=3 * _THOROUGH,
            smallest_phase_step=_NARROWEST,
        )


def longest_flight(manifold: UnstableManifold, settings: CutSettings) -> float:
    """Return how many periods of its orbit a trajectory of the tube may take to the section."""
    return manifold.orbit.system.flight_periods if settings.longest is None else settings.longest


def section_points(system: System, section: Section, states: Array) -> Array:
    """Return (q, p/p₀), (…, 2), of states (…, N) on a section."""
    states = np.asarray(states, dtype=float)
    q = states @ np.asarray(section.position)
    p = system.numeric.momentum(states) @ np.asarray(section.momentum)
    return np.stack([q, p / momentum_scale(system, section)], axis=-1)


@dataclass(frozen=True)
class Sample:
    """One phase's trajectory: None where it never arrives."""

    phase: float
    state: Array | None
    time: float
    direction: int
    point: Array | None
    normal_rate: float


class Sampler:
    """Flies seeds of one branch to the section."""

    def __init__(
        self, manifold: UnstableManifold, section: Section, hit: int, branch: int, settings: CutSettings
    ) -> None:
        self.manifold, self.section, self.hit, self.branch = manifold, section, hit, branch
        self.settings = settings
        self.scale = momentum_scale(manifold.orbit.system, section)
        self.chord = settings.chord * manifold.orbit.system.section_scale
        self.longest = longest_flight(manifold, settings)

    def fly(self, phases: Array) -> list[Sample]:
        """Return the samples at phases (K,), flown together."""
        system = self.manifold.orbit.system
        seeds, _ = self.manifold.seeds(phases, self.branch)
        longest = self.longest * self.manifold.orbit.period
        crossings = system.propagator.crossings(seeds, self.section, longest=longest, hit=self.hit)
        arrived = [c for c in crossings if c is not None]
        if not arrived:
            return [Sample(float(p), None, np.inf, 0, None, 0.0) for p in phases]
        states = np.array([c.state for c in arrived])
        normal = system.numeric.rate(states) @ np.asarray(self.section.normal)
        q = states @ np.asarray(self.section.position)
        p = system.numeric.momentum(states) @ np.asarray(self.section.momentum) / self.scale
        out, k = [], 0
        for phase, c in zip(phases, crossings, strict=True):
            if c is None:
                out.append(Sample(float(phase), None, np.inf, 0, None, 0.0))
            else:
                point = np.array([q[k], p[k]])
                rate = float(normal[k])
                out.append(Sample(float(phase), c.state, c.time, int(np.sign(rate)), point, rate))
                k += 1
        return out


def continuous(a: Sample, b: Sample, limit: float) -> bool:
    """Whether two neighbouring samples are near each other on one curve."""
    if a.point is None or b.point is None or a.direction != b.direction:
        return False
    return math.dist(a.point, b.point) <= limit


def refined(sampler: Sampler, start: float) -> tuple[list[Sample], str]:
    """Sample one period from phase `start`, halving until chords are short or phases indistinguishable.

    Returns the samples and why refinement stopped early, empty if it did not.
    """
    settings = sampler.settings
    samples = sampler.fly(start + np.arange(settings.first_phases + 1) / settings.first_phases)
    while len(samples) < settings.most_points:
        wide = [
            k
            for k in range(len(samples) - 1)
            if not (samples[k].point is None and samples[k + 1].point is None)
            and samples[k + 1].phase - samples[k].phase > settings.smallest_phase_step
            and not continuous(samples[k], samples[k + 1], sampler.chord)
        ]
        if not wide:
            return samples, ""
        jumps = sum(samples[k + 1].phase - samples[k].phase < settings.fine_phase_step for k in wide)
        if jumps > settings.most_jumps:
            return samples, (
                f"branch {sampler.branch:+d} scatters before crossing {sampler.hit}: more than {settings.most_jumps} "
                f"jumps between phases {settings.fine_phase_step:g} apart; allow less time"
            )
        middles = sampler.fly(np.array([(samples[k].phase + samples[k + 1].phase) / 2 for k in wide]))
        merged, fresh = [], dict(zip(wide, middles, strict=True))
        for k, sample in enumerate(samples):
            merged.append(sample)
            if k in fresh:
                merged.append(fresh[k])
        samples = merged
    return samples, f"branch {sampler.branch:+d}: {settings.most_points} points leave wide chords; allow more"


@dataclass(frozen=True)
class OpenEnd:
    """Phases between which a cut is open, and why.

    hides: whether more of the same crossing may lie between them. Nothing does where trajectories graze the section,
    nor where they do not arrive within a time that was asked for.
    """

    branch: int
    phase_interval: tuple[float, float]
    reason: str
    hides: bool


@dataclass(frozen=True)
class Piece:
    """One connected piece of a cut.

    phases (K,) increasing, not wrapped; points (K, 2) are (q, p/p₀), q continuous; states (K, N) lifted; times
    (K,) s of flight; direction: sign of the crossing. closed: the last point continues to the first.
    """

    branch: int
    phases: Array
    points: Array
    states: Array
    times: Array
    direction: int
    closed: bool


@dataclass(frozen=True)
class Cut:
    """All pieces in which both branches of a tube meet a section, and where they are open.

    trajectories: how many were flown; resolved: whether chords are short everywhere but at open ends.
    """

    section: Section
    hit: int
    pieces: tuple[Piece, ...]
    open_ends: tuple[OpenEnd, ...]
    trajectories: int
    resolved: bool
    status: str


def _jump(a: Sample, b: Sample, sampler: Sampler, grazing: float) -> OpenEnd:
    """Return the end between two indistinguishable phases that arrive far apart."""
    slow, interval = min(abs(a.normal_rate), abs(b.normal_rate)), (a.phase % 1, b.phase % 1)
    if slow > grazing:
        reason = (
            f"jumps: neighbouring trajectories part before crossing {sampler.hit} (normal rates {a.normal_rate:.3g} "
            f"and {b.normal_rate:.3g}); they pass near another orbit or were not refined further"
        )
        return OpenEnd(sampler.branch, interval, reason, hides=True)
    reason = f"grazes the section: crossing {sampler.hit} jumps where the normal rate falls to {slow:.1e} rad/s"
    return OpenEnd(sampler.branch, interval, reason, hides=False)


def _pieces(samples: list[Sample], sampler: Sampler) -> tuple[list[Piece], list[OpenEnd]]:
    """Split refined samples into connected pieces and the gaps between them."""
    joins = [continuous(a, b, sampler.chord) for a, b in pairwise(samples)]
    grazing = sampler.settings.grazing * max(abs(s.normal_rate) for s in samples)
    gaps: list[OpenEnd] = []
    runs: list[list[Sample]] = [[]]
    never: list[float] = []
    for k, sample in enumerate(samples):
        if sample.point is None:
            never.append(sample.phase)
        else:
            runs[-1].append(sample)
        if k < len(joins) and not joins[k]:
            following = samples[k + 1]
            both_missing = sample.point is None and following.point is None
            if not both_missing:
                if runs[-1]:
                    runs.append([])
                if sample.point is not None and following.point is not None:
                    gaps.append(_jump(sample, following, sampler, grazing))
            if following.point is not None and never:
                gaps.append(_never(never, sampler))
                never = []
    if never:
        gaps.append(_never(never, sampler))
    runs = [run for run in runs if len(run) > 1]
    # An orbit that crosses the section itself: its seeds gain a crossing where they pass it, and phases no circle.
    circle = not sampler.manifold.orbit.laps
    closed = circle and all(joins) and bool(runs)
    if circle and not closed and len(runs) > 1 and samples[-1].point is not None and samples[0].point is not None:
        # Phases are a circle: the last run continues into the first.
        head, tail = runs[0], runs[-1]
        if head[0].phase == samples[0].phase and tail[-1].phase == samples[-1].phase:
            shifted = [Sample(s.phase + 1, s.state, s.time, s.direction, s.point, s.normal_rate) for s in head[1:]]
            runs = [*runs[1:-1], tail + shifted]
    return [_piece(run, sampler.branch, closed) for run in runs], gaps


def _never(phases: list[float], sampler: Sampler) -> OpenEnd:
    reason = (
        f"never arrives: {len(phases)} phases do not reach crossing {sampler.hit} of {sampler.section.name} within "
        f"{sampler.longest:g} periods"
    )
    return OpenEnd(sampler.branch, (phases[0] % 1, phases[-1] % 1), reason, hides=sampler.settings.longest is None)


def _piece(run: list[Sample], branch: int, closed: bool) -> Piece:
    return Piece(
        branch=branch,
        phases=np.array([s.phase for s in run]),
        points=np.array([s.point for s in run]),
        states=np.array([s.state for s in run]),
        times=np.array([s.time for s in run]),
        direction=run[0].direction,
        closed=closed,
    )


def _mirrored(manifold: UnstableManifold, section: Section, piece: Piece) -> Piece:
    """Return the other branch's piece by the symmetry S about the saddle."""
    assert manifold.half_turn is not None
    system, centre = manifold.orbit.system, manifold.orbit.centre
    symmetry = manifold.half_turn[0]
    states = (piece.states - centre) @ symmetry.T + centre
    turned = np.asarray(section.normal) @ symmetry @ np.asarray(section.normal)
    return Piece(
        branch=-piece.branch,
        phases=piece.phases + 0.5,
        points=section_points(system, section, states),
        states=states,
        times=piece.times,
        direction=piece.direction * int(np.sign(turned)),
        closed=piece.closed,
    )


def tube_cut(manifold: UnstableManifold, section: Section, *, hit: int = 1, settings: CutSettings | None = None) -> Cut:
    """Cut both branches of an unstable tube at the `hit`-th crossing of a section."""
    settings = settings or CutSettings()
    pieces: list[Piece] = []
    gaps: list[OpenEnd] = []
    flown, unresolved = 0, ""
    branches = (1,) if manifold.branches_are_mirrored else (1, -1)
    for branch in branches:
        sampler = Sampler(manifold, section, hit, branch, settings)
        samples, stopped = refined(sampler, 0.0)
        unresolved += f"; {stopped}" if stopped else ""
        flown += len(samples)
        found, open_ends = _pieces(samples, sampler)
        pieces += found
        gaps += open_ends
        if manifold.branches_are_mirrored:
            pieces += [_mirrored(manifold, section, piece) for piece in found]
            gaps += [
                replace(g, branch=-g.branch, phase_interval=tuple((p + 0.5) % 1 for p in g.phase_interval))
                for g in open_ends
            ]
    if not pieces:
        status = (
            f"no trajectory of the tube reaches crossing {hit} of {section.name} within "
            f"{longest_flight(manifold, settings):g} periods; allow more time or another energy"
        )
    elif unresolved:
        status = f"not resolved by {flown} trajectories{unresolved}"
    else:
        status = f"resolved to chords of {settings.chord:g} by {flown} trajectories"
    return Cut(section, hit, tuple(pieces), tuple(gaps), flown, not unresolved, status)
