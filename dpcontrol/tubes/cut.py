"""The cut of a tube: the curve in which an unstable manifold first (n-th) meets a Poincaré section.

The curve is sampled over the phase of its seeds and refined by chord length in (q, p/p₀) until neighbouring
points are close. Where it cannot be refined the curve is open: a trajectory grazes the section (its crossing
jumps), or never arrives in the time allowed. Open ends are found by bisection and reported, never bridged.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System, momentum_scale
from dpcontrol.foundation.arrays import Array, Flags
from dpcontrol.foundation.budget import Budget
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.orbits.manifold import UnstableManifold

_THOROUGH = 20_000
"""Phases of a thorough cut: windows between them in which trajectories go another way are narrower than 5e-5."""

_LONG = 12.0
"""Seconds of processor time after which a thorough cut is refined no further."""

_NARROWEST = 1e-7
"""Phase between neighbours at which a thorough cut stops: where tubes scatter, narrower windows follow without end."""


@dataclass(frozen=True)
class CutSettings:
    """How a tube is cut.

    chord: between neighbours in (q, p/p₀), in units of the system's section scale; longest: periods of the orbit that
    a trajectory may take, None for the system's own number; most_jumps: more phase intervals than this that stay wide
    below fine_phase_step mean that the curve is not a curve there (its trajectories scatter chaotically before they
    arrive), and refinement stops. grazing: a normal rate below this share of the largest means a grazing crossing.
    seconds: of processor time after which refinement stops.
    """

    first_phases: int = 100
    chord: float = 0.05
    smallest_phase_step: float = 1e-9
    longest: float | None = None
    most_points: int = 20_000
    fine_phase_step: float = 1e-4
    most_jumps: int = 40
    grazing: float = 0.01
    seconds: float = np.inf

    def thoroughly(self) -> "CutSettings":
        """Return settings that sample phases ten thousandths of a turn apart and refine wherever chords stay wide."""
        return replace(
            self,
            first_phases=_THOROUGH,
            most_points=3 * _THOROUGH,
            most_jumps=3 * _THOROUGH,
            smallest_phase_step=_NARROWEST,
            seconds=_LONG,
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
class CutSamples:
    """Trajectories of seeds at phases (K,) when they meet the section: not a number, and at infinity, if they never do.

    states (K, N); points (K, 2): (q, p/p₀); times (K,) s; rates (K,): along the section's normal.
    """

    phases: Array
    states: Array
    points: Array
    times: Array
    rates: Array

    def __len__(self) -> int:
        return len(self.phases)

    def __getitem__(self, which: Any) -> "CutSamples":
        return CutSamples(*(getattr(self, one.name)[which] for one in fields(self)))

    @staticmethod
    def joined(parts: "Sequence[CutSamples]") -> "CutSamples":
        """Return several parts as one, in their order."""
        names = [one.name for one in fields(CutSamples)]
        return CutSamples(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    @property
    def arrived(self) -> Flags:
        """Which (K,) meet the section."""
        return np.isfinite(self.times)

    def continuous(self, limit: float) -> Flags:
        """Return which neighbours (K - 1,) are near each other on one curve."""
        same = np.sign(self.rates[1:]) == np.sign(self.rates[:-1])
        return same & (np.linalg.norm(np.diff(self.points, axis=0), axis=1) <= limit)


@dataclass(frozen=True)
class Sampler:
    """Flies seeds of one branch to the section."""

    manifold: UnstableManifold
    section: Section
    hit: int
    branch: int
    settings: CutSettings
    budget: Budget = field(default_factory=lambda: Budget(np.inf))

    @property
    def chord(self) -> float:
        """The longest chord between neighbours, in (q, p/p₀)."""
        return self.settings.chord * self.manifold.orbit.system.section_scale

    @property
    def longest(self) -> float:
        """Periods of its orbit that a trajectory may take."""
        return longest_flight(self.manifold, self.settings)

    def fly(self, phases: Array) -> CutSamples:
        """Return the samples at phases (K,), flown together."""
        system = self.manifold.orbit.system
        seeds, _ = self.manifold.seeds(phases, self.branch)
        longest = self.longest * self.manifold.orbit.period
        crossings = system.propagator.crossings(seeds, self.section, longest=longest, hit=self.hit)
        never = np.full(system.dimension, np.nan)
        states = np.array([never if c is None else c.state for c in crossings])
        return CutSamples(
            phases=np.asarray(phases, dtype=float),
            states=states,
            points=section_points(system, self.section, states),
            times=np.array([np.inf if c is None else c.time for c in crossings]),
            rates=system.numeric.rate(states) @ np.asarray(self.section.normal),
        )

    def arrives_later(self, phases: Array) -> bool:
        """Return whether some of the phases arrive if they are given twice the time that was asked for, or is usual."""
        if self.settings.longest is None:
            return False
        patience = 2 * max(self.longest, self.manifold.orbit.system.flight_periods)
        patient = replace(self, settings=replace(self.settings, longest=patience))
        return bool(patient.fly(_some(phases)).arrived.any())

    def escapes(self, phases: Array) -> bool:
        """Return whether all of the phases leave all that is finite in the time that they are given."""
        propagator, duration = self.manifold.orbit.system.propagator, self.longest * self.manifold.orbit.period
        seeds, _ = self.manifold.seeds(_some(phases), self.branch)
        for seed in seeds:
            try:
                propagator.flow(seed, duration)
                return False
            except ArithmeticError:
                continue
        return True


def _some(phases: Array) -> Array:
    """Return up to `_TRIED` of the phases, evenly chosen."""
    return phases[np.unique(np.linspace(0, len(phases) - 1, _TRIED).round().astype(int))]


_TRIED = 8


def refined(sampler: Sampler, start: float, *, progress: Progress = no_progress) -> tuple[CutSamples, str, bool]:
    """Sample one period from phase `start`, halving until chords are short or phases indistinguishable.

    Returns the samples, why refinement stopped early, empty if it did not, and whether that is because its time was
    over.
    """
    settings = sampler.settings
    budget = sampler.budget.part(settings.seconds)

    def flown(phases: Array) -> CutSamples:
        """Return the samples at the first of the phases, as many as there is time for."""
        parts: list[CutSamples] = []
        for first in range(0, len(phases), _AT_ONCE):
            if parts and budget.spent:
                break
            progress(f"tube of {sampler.manifold.orbit.saddle}", min(budget.share, 1.0))
            parts.append(sampler.fly(phases[first : first + _AT_ONCE]))
        return CutSamples.joined(parts)

    # Coarsely all around first, with both ends, should there be time for no more.
    number = np.arange(settings.first_phases + 1)
    coarse = (number % (settings.first_phases // _AT_ONCE + 1) == 0) | (number == number[-1])
    samples = flown(start + np.concatenate([number[coarse], number[~coarse]]) / settings.first_phases)
    samples = samples[np.argsort(samples.phases, kind="stable")]
    while len(samples) < settings.most_points and not budget.spent:
        phases, arrived, steps = samples.phases, samples.arrived, np.diff(samples.phases)
        wide = (arrived[:-1] | arrived[1:]) & (steps > settings.smallest_phase_step)
        wide &= ~samples.continuous(sampler.chord)
        if not wide.any():
            return samples, "", False
        if np.count_nonzero(steps[wide] < settings.fine_phase_step) > settings.most_jumps:
            return samples, (
                f"branch {sampler.branch:+d} scatters before crossing {sampler.hit}: more than {settings.most_jumps} "
                f"jumps between phases {settings.fine_phase_step:g} apart; allow less time"
            ), False  # fmt: skip
        samples = CutSamples.joined([samples, flown(((phases[:-1] + phases[1:]) / 2)[wide])])
        samples = samples[np.argsort(samples.phases, kind="stable")]
    left = f"branch {sampler.branch:+d}: {len(samples)} points leave wide chords"
    if budget.spent:
        return samples, f"{left} when {budget.seconds:.0f} s of processor time for it were over", True
    return samples, f"{left}; allow less time", False


_AT_ONCE = 64
"""Trajectories flown between two looks at the clock."""


@dataclass(frozen=True)
class OpenEnd:
    """Phases between which a cut is open, and why.

    hides: whether more of the same crossing may lie between them. Nothing does where trajectories graze the section or
    escape, nor where they do not arrive within a time that was asked for. later: whether some arrive after that time.
    escapes: whether they leave all that is finite.
    """

    branch: int
    phase_interval: tuple[float, float]
    reason: str
    hides: bool
    later: bool = False
    escapes: bool = False


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

    trajectories: how many were flown; resolved: whether chords are short everywhere but at open ends. spent: whether
    refinement ended because its time was over.
    """

    section: Section
    hit: int
    pieces: tuple[Piece, ...]
    open_ends: tuple[OpenEnd, ...]
    trajectories: int
    resolved: bool
    status: str
    spent: bool = False


def _gap(samples: CutSamples, sampler: Sampler, grazing: float) -> OpenEnd:
    """Return the end between two indistinguishable phases that arrive far apart, or over phases that never arrive."""
    hit, interval = sampler.hit, (float(samples.phases[0] % 1), float(samples.phases[-1] % 1))
    if not samples.arrived[0]:
        reason = (
            f"never arrives: {len(samples)} phases do not reach crossing {hit} of {sampler.section.name} within "
            f"{sampler.longest:g} periods"
        )
        if sampler.budget.spent:
            return OpenEnd(sampler.branch, interval, reason, hides=True)
        if sampler.escapes(samples.phases):
            reason = f"escapes: {len(samples)} phases leave for good and never reach {sampler.section.name}"
            return OpenEnd(sampler.branch, interval, reason, hides=False, escapes=True)
        later = sampler.arrives_later(samples.phases)
        return OpenEnd(sampler.branch, interval, reason, hides=sampler.settings.longest is None, later=later)
    first, second = samples.rates
    slow = min(abs(first), abs(second))
    if slow > grazing:
        reason = (
            f"jumps: neighbouring trajectories part before crossing {hit} (normal rates {first:.3g} and {second:.3g}); "
            "they pass near another orbit or were not refined further"
        )
        return OpenEnd(sampler.branch, interval, reason, hides=True)
    reason = f"grazes the section: crossing {hit} jumps where the normal rate falls to {slow:.1e} rad/s"
    return OpenEnd(sampler.branch, interval, reason, hides=False)


def _pieces(samples: CutSamples, sampler: Sampler) -> tuple[list[Piece], list[OpenEnd]]:
    """Split refined samples into connected pieces and the gaps between them."""
    arrived, joins = samples.arrived, samples.continuous(sampler.chord)
    grazing = sampler.settings.grazing * float(np.abs(samples.rates[arrived]).max(initial=0.0))
    # Stretches of one curve, and of phases that never arrive.
    breaks = np.flatnonzero(~joins & (arrived[1:] | arrived[:-1])) + 1
    stretches = np.split(np.arange(len(samples)), breaks)
    gaps: list[OpenEnd] = []
    for k, stretch in enumerate(stretches):
        if not arrived[stretch[0]]:
            gaps.append(_gap(samples[stretch], sampler, grazing))
        elif k and arrived[stretch[0] - 1]:
            gaps.append(_gap(samples[stretch[0] - 1 : stretch[0] + 1], sampler, grazing))
    runs = [samples[stretch] for stretch in stretches if arrived[stretch[0]] and len(stretch) > 1]
    # An orbit that crosses the section itself: its seeds gain a crossing where they pass it, and phases no circle.
    circle = not sampler.manifold.orbit.laps
    closed = circle and bool(joins.all())
    if circle and not closed and len(runs) > 1:
        # Phases are a circle: the last run continues into the first.
        head, tail = runs[0], runs[-1]
        if head.phases[0] == samples.phases[0] and tail.phases[-1] == samples.phases[-1]:
            runs = [*runs[1:-1], CutSamples.joined([tail, replace(head, phases=head.phases + 1)[1:]])]
    return [_piece(run, sampler.branch, closed) for run in runs], gaps


def _piece(run: CutSamples, branch: int, closed: bool) -> Piece:
    return Piece(branch, run.phases, run.points, run.states, run.times, int(np.sign(run.rates[0])), closed)


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


def tube_cut(
    manifold: UnstableManifold,
    section: Section,
    *,
    hit: int = 1,
    settings: CutSettings | None = None,
    budget: Budget | None = None,
    progress: Progress = no_progress,
) -> Cut:
    """Cut both branches of an unstable tube at the `hit`-th crossing of a section, as finely as a budget allows."""
    settings, budget = settings or CutSettings(), budget or Budget(np.inf)
    pieces: list[Piece] = []
    gaps: list[OpenEnd] = []
    flown, unresolved, late = 0, "", False
    branches = (1,) if manifold.branches_are_mirrored else (1, -1)
    for k, branch in enumerate(branches):
        # The first of two branches leaves the other half of the time, and both some for their ends.
        allowed = budget.until(0.9 * (k + 1) / len(branches))
        within = part_of(progress, k / len(branches), (k + 1) / len(branches))
        samples, stopped, over = refined(
            Sampler(manifold, section, hit, branch, settings, allowed), 0.0, progress=within
        )
        sampler, late = Sampler(manifold, section, hit, branch, settings, budget), late or over
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
    if not pieces and gaps and all(gap.escapes for gap in gaps):
        status = f"escapes: none of its trajectories comes back to {section.name}"
    elif not pieces:
        status = (
            f"no trajectory of the tube reaches crossing {hit} of {section.name} within "
            f"{longest_flight(manifold, settings):g} periods; allow more time or another energy"
        )
    elif unresolved:
        status = f"not resolved by {flown} trajectories{unresolved}"
    else:
        status = f"resolved to chords of {settings.chord:g} by {flown} trajectories"
    return Cut(section, hit, tuple(pieces), tuple(gaps), flown, not unresolved, status, late)
