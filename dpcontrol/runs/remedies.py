"""Remedies of a failed run: options of `dpcontrol run` that complete it more often than harmless changes do.

Almost any change completes a run that failed by chance, even 39,999 instead of 40,000 counts. So a change must beat a
null group. Half of this group are harmless variants of the failed run, whose mismatches differ by a ten-thousandth. The
other half are neighbouring seeds with the present settings. Each change is tried on the same variants and seeds. It is
a remedy if it meets three conditions:

    chance       McNemar's exact test of the pairs rejects chance at `_LEVEL`.
    neighbours   On the neighbouring seeds it rescues at least as many runs as it loses.
    the run      The option also completes the failed run itself.

Changes of one kind are tried from the smallest; the first remedy of a kind ends it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.processes import in_processes, processors
from dpcontrol.foundation.progress import Cost, Progress, announce, no_progress
from dpcontrol.foundation.statistics import paired
from dpcontrol.judge.score import Score
from dpcontrol.plans.overrides import typed as typed_options
from dpcontrol.plans.plan import Plan
from dpcontrol.runs.campaign import Case, Job
from dpcontrol.runs.preflight import SettingChange, changes, outcomes, seconds_of

SAME, SAME_ALONE = 16, 8
"""Variants of the failed run, and as many neighbouring seeds: in lockstep, and sequentially."""
_HARMLESS = 1e-4
"""Share by which the mismatch of one variant differs from that of the one before."""
_LEVEL = 0.02
"""Largest two-sided p of a remedy."""


@dataclass(frozen=True)
class Completed:
    """Numbers of completed runs in the two groups with which changes are compared.

    Attributes:
        same_seed: completed variants of the failed run.
        neighbours: completed runs of neighbouring seeds.
        of: number of runs in each group.
    """

    same_seed: int
    neighbours: int
    of: int

    @property
    def total(self) -> int:
        """Completed runs of both groups."""
        return self.same_seed + self.neighbours


@dataclass(frozen=True)
class TriedChange:
    """One change with its results.

    Attributes:
        change: its text.
        option: its text on the command line.
        completed: True if it completes the failed run.
        verdict: on that run.
        helps: True for a remedy.
        counts: None if the groups were not run.
    """

    change: str
    option: str
    completed: bool
    verdict: str
    helps: bool = False
    counts: Completed | None = None


@dataclass(frozen=True)
class Why(Documented):
    """Changes tried for a failed run, with those that complete it.

    Attributes:
        log: name of the log.
        seed: seed of the run, or None.
        reason: reason of the failure.
        trials: changes in the order of their trials.
        unchanged: completed runs of the null group, None if no change was tried.
    """

    KEYS: ClassVar[str] = "* saves sentence"

    log: str
    seed: int | None
    reason: str
    trials: tuple[TriedChange, ...]
    unchanged: Completed | None = None

    @property
    def remedies(self) -> tuple[TriedChange, ...]:
        """The changes that help, the surest first."""
        return tuple(
            sorted(
                (trial for trial in self.trials if trial.helps),
                key=lambda trial: -trial.counts.total if trial.counts else 0,
            )
        )

    @property
    def saves(self) -> tuple[str, ...]:
        """Options that complete the run."""
        return tuple(trial.option for trial in self.remedies)

    @property
    def sentence(self) -> str:
        """The remedies in one line."""
        if self.unchanged is None:
            return "the run was completed, so no change was tried"
        count = f"{len(self.trials)} change{'s' * (len(self.trials) != 1)}"
        if self.saves:
            return f"completed with {', or with '.join(f'`{option}`' for option in self.saves)} ({count} tried)"
        text = f"none of {count} completes this run more often than harmless changes do"
        if 2 * self.unchanged.same_seed >= self.unchanged.of:
            text += f"; these complete it {self.unchanged.same_seed} times in {self.unchanged.of}, so chance decides"
        return text

    def lines(self) -> list[str]:
        """Return the evidence for each remedy: completed runs of both groups, without and with the change."""
        null = self.unchanged
        if null is None:
            return []
        head = f"unchanged: {null.same_seed} of {null.of} harmless variants, {null.neighbours} of {null.of} other seeds"
        counts = [(trial, trial.counts) for trial in self.remedies if trial.counts is not None]
        return [head] + [
            f"{trial.option}: {completed.same_seed} and {completed.neighbours} of {null.of} ({trial.change})"
            for trial, completed in counts
        ]

    def __repr__(self) -> str:
        return f"<why: {self.sentence}>"


_Group = tuple[Sequence[tuple[SettingChange, Job]], Sequence[bool]]
"""Changes of one kind with their jobs, whose first run is the failed one, and the null group's results."""


def why(
    failed: Score,
    typed: Callable[[Mapping[str, Any]], Plan],
    flown: Callable[[Plan], Score],
    *,
    workers: int = 0,
    yes: bool = False,
    progress: Progress = no_progress,
) -> Why:
    """Find the changes that complete a logged run more often than harmless changes do.

    Args:
        failed: score of the failed run.
        typed: returns the run's plan with options added to its command line.
        flown: returns the score of a plan's run.
        workers: number of processes, 0 for one per processor.
        yes: accept any duration, default False.
        progress: receiver of progress reports.

    Raises:
        InputError: it would take too long, or the completion of the run is unknown.
        GoalMissed: no controller can be made for the run, or a process died.
    """
    if failed.completed is None:
        raise InputError(f"{failed.log}: {failed.reason}; give the log as `dpcontrol run` wrote it")
    if failed.completed:
        return Why(failed.log, failed.seed, failed.reason, ())
    plan = typed({})
    itinerary, groups = plan.itinerary, [*changes(plan.itinerary)]
    lockstep = itinerary.loop.lockstep
    size = SAME if lockstep else SAME_ALONE
    ticks = max(round(plan.reference.duration * itinerary.loop.rate), 1)
    workers = workers or processors()
    seconds_per_change, change_count = 2 * size * ticks * seconds_of(itinerary.loop), sum(map(len, groups))
    cost = (
        (change_count + 1) * (seconds_per_change + _OVERHEAD) / workers
        if lockstep
        else (change_count * 0.3 + 1) * seconds_per_change / workers
    )
    announce(Cost(f"{change_count} changes", cost, 4e8 * workers, f"--why of {itinerary.name}"), yes=yes)

    def jobs_of_changes(group: Sequence[SettingChange]) -> Iterator[tuple[SettingChange, Job]]:
        """Yield the changes of one kind with their jobs of 2 · `size` runs, if they fit the run's settings."""
        for change in group:
            # The option may contradict the run's other settings.
            with suppress(InputError):
                yield change, _job(typed(change.options), size)

    progress("harmless changes", 0.0)
    null_runs, _ = _tried(([(SettingChange("", {}), _job(plan, size))], ()))[0]
    null_group, trials = Completed(sum(null_runs[:size]), sum(null_runs[size:]), size), list[TriedChange]()

    job_groups: list[_Group] = [
        (jobs_of_group, null_runs) for group in groups if (jobs_of_group := tuple(jobs_of_changes(group)))
    ]
    for (jobs_of, _), results in in_processes(_tried, job_groups, workers, what="kinds of changes", progress=progress):
        for (change, _), (change_runs, verdict) in zip(jobs_of, results, strict=False):
            trials.append(_judged(change, change_runs, verdict, null_runs, lambda options: flown(typed(options))))
    progress("why", 1.0)
    return Why(failed.log, failed.seed, failed.reason, tuple(trials), null_group)


_OVERHEAD = 2.0
"""Time that a lockstep job takes in addition to its ticks, s."""


def _job(plan: Plan, size: int) -> Job:
    """Return the job of a failed run's variants, the run itself first, and of as many neighbouring seeds.

    `size` is the number of runs in each of these groups. Variants have the seed of the failed run and a mismatch that
    differs harmlessly, by multiples of `_HARMLESS`.
    """
    itinerary, loop = plan.itinerary, plan.itinerary.loop
    seeds = (*[loop.seed] * size, *range(loop.seed + 1, loop.seed + 1 + size))
    # The first variant is the failed run itself.
    variants = [loop.mismatch * (1 - _HARMLESS * k) if loop.mismatch else 1e-2 * _HARMLESS * k for k in range(size)]
    return Job(
        itinerary.name, plan.archive, itinerary.model.arms, Case("why", (), loop), seeds, "compiled",
        itinerary.uncertainty, replayed=0, mismatches=(*variants, *[loop.mismatch] * size),
    )  # fmt: skip


def _tried(group: _Group) -> list[tuple[tuple[bool, ...], str]]:
    """Return completed runs and the first run's verdict of each job, up to the first job that beats the null group.

    `group` has the changes of one kind with their jobs, and for each run of the null group True if it was completed.
    The latter are empty if the job is the null group itself. A job that cannot run has no completed runs, and the
    reason as its verdict. If runs are sequential, the rest of a job runs only if its first run, the failed one with the
    change, is completed.
    """
    verdicts: list[tuple[tuple[bool, ...], str]] = []
    (changes_and_jobs, null_runs), failed_run = group, slice(1)
    for _, job in changes_and_jobs:
        first_job = replace(job, seeds=job.seeds[failed_run], mismatches=job.mismatches[failed_run])
        try:
            run_ends = outcomes(first_job if null_runs and not job.case.loop.lockstep else job)
            if run_ends[0].completed and len(run_ends) == 1:
                run_ends = outcomes(job)
        except (GoalMissed, InputError) as failure:
            verdicts.append(((), str(failure)))
            continue
        completed = tuple(row.completed for row in run_ends)
        verdicts.append((completed, run_ends[0].reason))
        if completed[0] and _beats(completed, null_runs):
            break
    return verdicts


def _beats(done: Sequence[bool], before: Sequence[bool]) -> bool:
    """Return True if a change completes runs significantly more often than the null group, compared pair by pair.

    The null group are the same runs without the change. On neighbouring seeds, the change must rescue at least as many
    runs as it loses.

    Args:
        done: True for each run with the change that was completed: first the failed run, then its variants, then as
            many neighbouring seeds. If some were not tried, the result is False.
        before: True for each run of the null group that was completed, in the same order.
    """
    if len(done) != len(before):
        return False
    group_size = len(done) // 2
    all_pairs, neighbours = paired(before, done), paired(before[group_size:], done[group_size:])
    is_significant = all_pairs.only_second > all_pairs.only_first and all_pairs.p_value <= _LEVEL
    return is_significant and neighbours.only_second >= neighbours.only_first


def _judged(
    change: SettingChange,
    done: Sequence[bool],
    verdict: str,
    before: Sequence[bool],
    alone: Callable[[Mapping[str, Any]], Score],
) -> TriedChange:
    """Return a change with its verdict; if it beats the null group, the failed run is simulated again with it.

    The null group are the same runs without the change. The change helps only if that repetition, outside lockstep, is
    completed too; the verdict is then that of the repetition.

    Args:
        change: the tried change of the settings.
        done: True for each run with the change that was completed: first the failed run, then its variants, then the
            neighbouring seeds. It has the failed run alone if the others were not tried, and is empty if none could
            run.
        verdict: why the failed run with the change was completed or not, or why no run could be made.
        before: True for each run of the null group that was completed, in the same order.
        alone: function of options that repeats the failed run with them, outside lockstep, and returns its score.

    Returns:
        The change with its option, verdict and counts of completed runs; the counts are None unless all runs were
            tried.
    """
    group_size = len(before) // 2
    counts = Completed(sum(done[:group_size]), sum(done[group_size:]), group_size) if len(done) == len(before) else None
    completed = any(done[:1])
    if helps := completed and _beats(done, before):
        score = alone(change.options)
        completed, verdict = bool(score.completed), score.reason
    option = typed_options(change.options)
    return TriedChange(change.text, option, completed, verdict, helps and completed, counts)
