"""Cuts of tubes: curves in which unstable manifolds meet a section.

A cut is sampled over the phase of its seeds and refined by chord length in (q, p/p₀) until neighbouring points are
close. The cut is open if trajectories graze the section, so that the crossing jumps, or do not arrive in time. Open
ends are located by bisection and reported, and gaps are never bridged.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar

import numpy as np

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System, momentum_scale
from dpcontrol.foundation.arrays import Array, Flags
from dpcontrol.foundation.budget import Budget
from dpcontrol.foundation.causes import BranchCause, CutCause, OpenEndCause
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.foundation.shown import Brief, Shown
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.words.searches import Concluded

_THOROUGH = 20_000
"""Number of phases of a thorough cut; undetected windows of other trajectories are narrower than 5e-5."""

_LONG = 12.0
"""Limit of the processor time of a thorough cut, s."""

_NARROWEST = 1e-7
"""Smallest phase step of a thorough cut; tubes that scatter have ever narrower windows."""


MOST_PERIODS = 1000.0
"""Longest flight, in periods of the orbit."""


@dataclass(frozen=True)
class CutSettings:
    """Resolution and limits of tube cuts.

    If more than `most_jumps` phase intervals below `fine_phase_step` have wide chords, the trajectories scatter
    chaotically before they arrive, and refinement stops.

    Attributes:
        first_phases: number of evenly spaced phases with which sampling begins.
        chord: largest distance between neighbours in (q, p/p₀), in the system's section scale.
        smallest_phase_step: phase step below which a wide chord is a jump and not bisected, 1 for a period.
        longest: flight time in periods of the orbit, None for the system's default.
        most_points: number of samples of a branch at which refinement stops.
        grazing: normal rate of a grazing crossing, relative to the largest rate.

    A limit on processor time, `seconds`, also stops refinement.
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
        """Return settings with fine sampling and refinement of all wide chords, for searches that must miss little."""
        return replace(
            self,
            first_phases=_THOROUGH,
            most_points=3 * _THOROUGH,
            most_jumps=3 * _THOROUGH,
            smallest_phase_step=_NARROWEST,
            seconds=_LONG,
        )


def longest_flight(manifold: UnstableManifold, settings: CutSettings) -> float:
    """Return the longest flight time to a section, in periods of the orbit.

    Args:
        manifold: manifold whose tube is cut.
        settings: limit of the flight, or None for the system's.
    """
    return manifold.orbit.system.flight_periods if settings.longest is None else settings.longest


def section_points(system: System, section: Section, states: Array) -> Array:
    """Return the coordinates (q, p/p₀) (…, 2) of states on a section, in which cuts are curves.

    Args:
        system: system of the states.
        section: section that the states are on.
        states: states (…, N).
    """
    states = np.asarray(states, dtype=float)
    q = states @ np.asarray(section.position)
    p = system.numeric.momentum(states) @ np.asarray(section.momentum)
    return np.stack([q, p / momentum_scale(system, section)], axis=-1)


@dataclass(frozen=True)
class CutSamples(Brief):
    """Section crossings of trajectories from seeds at given phases.

    If a trajectory does not arrive, its time is infinite and other values are NaN.

    Attributes:
        phases (K,): of the seeds.
        states (K, N): at the crossing.
        points (K, 2): (q, p/p₀).
        times (K,): of flight, s.
        rates (K,): along the section's normal.
    """

    phases: Array
    states: Array
    points: Array
    times: Array
    rates: Array

    def __len__(self) -> int:
        return len(self.phases)

    def __getitem__(self, which: Any) -> "CutSamples":
        """Return the samples at these indices or with this mask."""
        return CutSamples(*(getattr(self, entry.name)[which] for entry in fields(self)))

    @staticmethod
    def joined(parts: "Sequence[CutSamples]") -> "CutSamples":
        """Return the samples of several parts as one, in order.

        Args:
            parts: samples of one branch.
        """
        names = [entry.name for entry in fields(CutSamples)]
        return CutSamples(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    @property
    def arrived(self) -> Flags:
        """True (K,) for trajectories that meet the section."""
        return np.isfinite(self.times)

    def continuous(self, limit: float) -> Flags:
        """Return True (K - 1,) for neighbours on one curve: they cross in the same direction, and their chord is short.

        Args:
            limit: largest distance of neighbours in (q, p/p₀).
        """
        one_sided = np.sign(self.rates[1:]) == np.sign(self.rates[:-1])
        return one_sided & (np.linalg.norm(np.diff(self.points, axis=0), axis=1) <= limit)


def arrivals(
    manifold: UnstableManifold, section: Section, phases: Array, *, hit: int, branch: int, longest: float
) -> tuple[Array, Array, tuple[Array, Array]]:
    """Return the states and times at which trajectories from a manifold's seeds reach a section.

    Args:
        manifold: manifold of the seeds.
        section: section of the orbit's system.
        phases: phases (K,) of the orbit, 1 for a period.
        hit: number of the crossing, from 1.
        branch: +1 or -1.
        longest: time limit, s.

    Returns:
        States (K, N) and times (K,) in s, NaN and infinite for trajectories that do not arrive, and the seeds and their
        derivatives by phase, (K, N) each.
    """
    system, seeds = manifold.orbit.system, manifold.seeds(phases, branch)
    return *system.propagator.crossings(seeds[0], section, longest=longest, hit=hit), seeds


@dataclass(frozen=True)
class Sampler(Brief):
    """Propagation of one branch's seeds to the section, of which a cut's samples are made.

    Attributes:
        manifold: local manifold whose tube is cut.
        hit: number of the crossing, from 1.
        branch: +1 or -1.
        budget: processor time, unlimited by default.
    """

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
        """The longest flight time, in periods of the orbit."""
        return longest_flight(self.manifold, self.settings)

    def fly(self, phases: Array) -> CutSamples:
        """Return the section crossings of the seeds at given phases, which are propagated together.

        Args:
            phases: phases (K,) of the orbit, 1 for a period.
        """
        system, longest = self.manifold.orbit.system, self.longest * self.manifold.orbit.period
        states, times, _ = arrivals(
            self.manifold, self.section, phases, hit=self.hit, branch=self.branch, longest=longest
        )
        return CutSamples(
            phases=np.asarray(phases, dtype=float),
            states=states,
            points=section_points(system, self.section, states),
            times=times,
            rates=system.numeric.rate(states) @ np.asarray(self.section.normal),
        )

    def arrives_later(self, phases: Array) -> bool:
        """Return True if some of the phases arrive within twice the time, so that a longer search would find more.

        Args:
            phases: phases (K,) of the orbit, 1 for a period.
        """
        patience = 2 * max(self.longest, self.manifold.orbit.system.flight_periods)
        longer_sampler = replace(self, settings=replace(self.settings, longest=patience))
        return bool(longer_sampler.fly(_some(phases)).arrived.any())

    def departs(self, phases: Array) -> bool:
        """Return True if all trajectories leave for ever, so that an open end hides no crossings.

        Within the flight time they diverge, or move away at a constant rate.

        Args:
            phases: phases (K,) of the orbit, 1 for a period.
        """
        propagator, duration = self.manifold.orbit.system.propagator, self.longest * self.manifold.orbit.period
        times = np.linspace(0.0, duration, max(_FOLLOWED, int(np.ceil(self.longest))) + 1)[1:]
        seeds, _ = self.manifold.seeds(_some(phases), self.branch)
        for seed in seeds:
            states = propagator.followed(seed, times)
            if self.budget.spent or (len(states) == len(times) and not self._moves_away(states[len(times) // 2 :])):
                return False
        return True

    def _moves_away(self, states: Array) -> bool:
        """Return True if the trajectory leaves steadily along a coordinate that is no angle, so that it cannot return.

        Over states (K, N), the coordinate's rate is constant, and its change is many times the size of the orbit.
        """
        system = self.manifold.orbit.system
        rates, line_coordinates = system.numeric.rate(states), np.flatnonzero(~np.isfinite(system.periods))
        steady = np.ptp(rates[:, line_coordinates], axis=0) <= _STEADY * np.abs(rates[-1, line_coordinates])
        size = float((np.ptp(self.manifold.frame(np.arange(8) / 8).states, axis=0) / system.scale).max())
        return bool((steady & (np.abs(states[-1] - states[0]) / system.scale > _AWAY * size)[line_coordinates]).any())


def _some(phases: Array) -> Array:
    """Return up to `_TRIED` evenly spaced samples of the phases (K,), enough to examine an open end."""
    return phases[np.unique(np.linspace(0, len(phases) - 1, _TRIED).round().astype(int))]


_TRIED = 8
_FOLLOWED = 24  # smallest number of states at which a trajectory is examined
_STEADY, _AWAY = 1e-3, 10.0  # largest change of a constant rate, relative; distance in sizes of the orbit


@dataclass(frozen=True)
class UnresolvedBranch(Concluded):
    """A branch of a cut whose refinement stopped early.

    Attributes:
        sampler: the branch, with section, crossing and settings.
        points: number of points when it stopped.
    """

    cause: BranchCause
    sampler: Sampler
    points: int


def refined(
    sampler: Sampler, start: float, *, progress: Progress = no_progress
) -> tuple[CutSamples, UnresolvedBranch | None]:
    """Return the samples of one period of phases, bisected until all chords are short.

    Args:
        sampler: branch, section and settings.
        start: first phase, 1 for a period.
        progress: called with a label and the completed share.

    Returns:
        The samples, and the branch with the cause if refinement stopped early, else None.
    """
    settings = sampler.settings
    budget = sampler.budget.part(settings.seconds)

    def flown(phases: Array) -> CutSamples:
        """Return the samples at the phases (K,), in order, or as many as time permits."""
        parts: list[CutSamples] = []
        for first in range(0, len(phases), _AT_ONCE):
            if parts and budget.spent:
                break
            progress(f"tube of {sampler.manifold.orbit.saddle}", min(budget.share, 1.0))
            parts.append(sampler.fly(phases[first : first + _AT_ONCE]))
        return CutSamples.joined(parts)

    # A coarse sampling of the whole period comes first, in case time runs out.
    numbers = np.arange(settings.first_phases + 1)
    coarse = (numbers % (settings.first_phases // _AT_ONCE + 1) == 0) | (numbers == numbers[-1])
    samples = flown(start + np.concatenate([numbers[coarse], numbers[~coarse]]) / settings.first_phases)
    samples = samples[np.argsort(samples.phases, kind="stable")]
    while len(samples) < settings.most_points and not budget.spent:
        phases, arrived, steps = samples.phases, samples.arrived, np.diff(samples.phases)
        # A chord is wide between neighbours of which only one arrives, or which are not on one curve.
        wide = (arrived[:-1] | arrived[1:]) & (steps > settings.smallest_phase_step)
        wide &= ~samples.continuous(sampler.chord)
        if not wide.any():
            return samples, None
        if np.count_nonzero(steps[wide] < settings.fine_phase_step) > settings.most_jumps:
            return samples, UnresolvedBranch(BranchCause.SCATTERS, sampler, len(samples))
        samples = CutSamples.joined([samples, flown(((phases[:-1] + phases[1:]) / 2)[wide])])
        samples = samples[np.argsort(samples.phases, kind="stable")]
    return samples, UnresolvedBranch(BranchCause.TIME if budget.spent else BranchCause.POINTS, sampler, len(samples))


_AT_ONCE = 64
"""Trajectories propagated between checks of the time limit."""


@dataclass(frozen=True)
class OpenEnd(Brief, Concluded):
    """A phase interval in which a cut is open.

    Attributes:
        branch: branch of the tube, +1 or -1.
        phase_interval: first and last phase in [0, 1), 1 for a period; the first is larger across phase zero.
        cause: why the cut is open there.
        hides: True if it may contain more of the same crossing. Grazing and escaping trajectories hide nothing, nor
            do those that exceed a requested flight time.
        later: True if some arrive after that time, or may arrive after the default one.
        sampler: the branch, with section and crossing.
        samples: trajectories without a crossing, or the two on either side.
    """

    branch: int
    phase_interval: tuple[float, float]
    cause: OpenEndCause
    hides: bool
    later: bool
    sampler: Sampler = field(repr=False, compare=False)
    samples: CutSamples = field(repr=False, compare=False)


@dataclass(frozen=True)
class Piece(Brief):
    """One connected piece of a cut.

    Attributes:
        branch: branch of the tube, +1 or -1.
        phases (K,): of the seeds, 1 for a period, increasing and unwrapped.
        points (K, 2): (q, p/p₀), with continuous q.
        states (K, N): lifted.
        times (K,): of flight, s.
        direction: sign of the crossing.
        closed: True if the ends join.
    """

    branch: int
    phases: Array
    points: Array
    states: Array
    times: Array
    direction: int
    closed: bool


@dataclass(frozen=True)
class Cut(Shown, Documented, Concluded):
    """The pieces and open ends of a tube's cut, both branches.

    Attributes:
        hit: number of the crossing of the section, from 1.
        trajectories: number of propagated trajectories.
        chord: longest chord of a resolved cut, in the system's section scale.
        longest: longest flight, in periods of the orbit.
        unresolved: branches whose refinement stopped early.
        stable: True for the image on the stable tube.
        spent: True if time ran out.
        seconds: limit of the processor time of this cut alone, s; infinite if there is none.
    """

    KEYS: ClassVar[str] = (
        "hit stable trajectories resolved status section=section.name pieces:branch,direction,closed,phases,points "
        "open_ends:branch,phase_interval,reason=status partial=spent"
    )

    section: Section
    hit: int
    pieces: tuple[Piece, ...]
    open_ends: tuple[OpenEnd, ...]
    trajectories: int
    chord: float
    longest: float
    unresolved: tuple[UnresolvedBranch, ...] = ()
    spent: bool = False
    stable: bool = False
    seconds: float = np.inf

    def __repr__(self) -> str:
        kind = "stable" if self.stable else "unstable"
        return f"<cut of the {kind} tube at crossing {self.hit} of {self.section.name}: {self.status}>"

    @property
    def cause(self) -> CutCause:
        """How the cut ended."""
        if self.pieces:
            return CutCause.UNRESOLVED if self.unresolved else CutCause.RESOLVED
        escapes = self.open_ends and all(end.cause is OpenEndCause.ESCAPES for end in self.open_ends)
        return CutCause.ESCAPES if escapes else CutCause.NEVER_ARRIVES

    @property
    def resolved(self) -> bool:
        """True if all chords are short except at open ends."""
        return not self.unresolved


def _gap(samples: CutSamples, sampler: Sampler, grazing: float) -> OpenEnd:
    """Return the open end of a cut, with its cause, at a jump between two arrivals or between phases without arrival.

    `samples`: the two arrivals, or all trajectories of the gap. `grazing`: rate along the section's normal below which
    a crossing grazes.
    """
    interval = (float(samples.phases[0] % 1), float(samples.phases[-1] % 1))

    def end(cause: OpenEndCause, *, hides: bool, later: bool = False) -> OpenEnd:
        """Return the open end of this interval with a cause."""
        return OpenEnd(sampler.branch, interval, cause, hides, later, sampler, samples)

    if samples.arrived[0]:
        jumps = float(np.abs(samples.rates).min()) > grazing
        return end(OpenEndCause.JUMPS if jumps else OpenEndCause.GRAZES, hides=jumps)
    if sampler.budget.spent:
        return end(OpenEndCause.NEVER_ARRIVES, hides=True)
    requested, departs = sampler.settings.longest is not None, sampler.departs(samples.phases)
    later = (requested or departs) and sampler.arrives_later(samples.phases)
    if departs and not later:
        return end(OpenEndCause.ESCAPES, hides=False)
    return end(OpenEndCause.NEVER_ARRIVES, hides=not requested, later=later or not requested)


def _pieces(samples: CutSamples, sampler: Sampler) -> tuple[list[Piece], list[OpenEnd]]:
    """Return the connected pieces of a branch's cut, and the open ends between them, from refined samples.

    `samples`: of one period, in the order of their phases. `sampler`: branch, section and settings of the cut.
    """
    arrived, connected = samples.arrived, samples.continuous(sampler.chord)
    grazing = sampler.settings.grazing * float(np.abs(samples.rates[arrived]).max(initial=0.0))
    # Stretches are parts of one curve, or of phases that never arrive.
    breaks = np.flatnonzero(~connected & (arrived[1:] | arrived[:-1])) + 1
    stretches = np.split(np.arange(len(samples)), breaks)
    gaps: list[OpenEnd] = []
    for k, stretch in enumerate(stretches):
        if not arrived[stretch[0]]:
            gaps.append(_gap(samples[stretch], sampler, grazing))
        elif k and arrived[stretch[0] - 1]:
            gaps.append(_gap(samples[stretch[0] - 1 : stretch[0] + 1], sampler, grazing))
    runs = [samples[stretch] for stretch in stretches if arrived[stretch[0]] and len(stretch) > 1]
    # If the orbit crosses the section, its seeds gain a crossing there, and the phases do not form a circle.
    circle = not sampler.manifold.orbit.laps
    closed = circle and bool(connected.all())
    if circle and not closed and len(runs) > 1:
        # Phases are a circle: the last run continues into the first.
        first_run, last_run = runs[0], runs[-1]
        if first_run.phases[0] == samples.phases[0] and last_run.phases[-1] == samples.phases[-1]:
            runs = [*runs[1:-1], CutSamples.joined([last_run, replace(first_run, phases=first_run.phases + 1)[1:]])]
    pieces = [
        Piece(sampler.branch, run.phases, run.points, run.states, run.times, int(np.sign(run.rates[0])), closed)
        for run in runs
    ]
    return pieces, gaps


def _mirrored(manifold: UnstableManifold, section: Section, piece: Piece) -> Piece:
    """Return the other branch's piece without integration, by the symmetry S of `UnstableManifold.half_turn`.

    `piece`: piece of the manifold's cut by the section.
    """
    assert manifold.half_turn is not None
    system, centre = manifold.orbit.system, manifold.orbit.centre
    symmetry = manifold.half_turn[0]
    states = (piece.states - centre) @ symmetry.T + centre
    alignment = np.asarray(section.normal) @ symmetry @ np.asarray(section.normal)
    return Piece(
        branch=-piece.branch,
        phases=piece.phases + 0.5,
        points=section_points(system, section, states),
        states=states,
        times=piece.times,
        direction=piece.direction * int(np.sign(alignment)),
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
    """Return the cut of both branches of an unstable tube at a section, with its open ends.

    Args:
        manifold: local manifold of the orbit.
        section: section of the orbit's system.
        hit: number of the crossing, from 1.
        settings: sampling of the cut.
        budget: processor time; unlimited by default.
        progress: called with a label and the completed share.
    """
    settings, budget = settings or CutSettings(), budget or Budget(np.inf)
    pieces: list[Piece] = []
    gaps: list[OpenEnd] = []
    unresolved: list[UnresolvedBranch] = []
    trajectories, time_ran_out = 0, False
    branches = (1,) if manifold.branches_are_mirrored else (1, -1)
    for k, branch in enumerate(branches):
        # Each branch gets half of the time, less a reserve for open ends.
        sampling_budget = budget.until(0.9 * (k + 1) / len(branches))
        branch_progress = part_of(progress, k / len(branches), (k + 1) / len(branches))
        samples, early_stop = refined(
            Sampler(manifold, section, hit, branch, settings, sampling_budget), 0.0, progress=branch_progress
        )
        # Open ends are examined with the time that is left in all.
        sampler = Sampler(manifold, section, hit, branch, settings, budget)
        unresolved += [] if early_stop is None else [early_stop]
        trajectories += len(samples)
        branch_pieces, open_ends = _pieces(samples, sampler)
        pieces += branch_pieces
        gaps += open_ends
        out_of_time = early_stop is not None and early_stop.cause is BranchCause.TIME
        time_ran_out = time_ran_out or out_of_time or (budget.spent and any(end.hides for end in open_ends))
        if manifold.branches_are_mirrored:
            pieces += [_mirrored(manifold, section, piece) for piece in branch_pieces]
            gaps += [
                replace(
                    gap, branch=-gap.branch, phase_interval=tuple((phase + 0.5) % 1 for phase in gap.phase_interval)
                )
                for gap in open_ends
            ]
    return Cut(
        section,
        hit,
        tuple(pieces),
        tuple(gaps),
        trajectories,
        settings.chord,
        longest_flight(manifold, settings),
        unresolved=tuple(unresolved),
        spent=time_ran_out,
    )
