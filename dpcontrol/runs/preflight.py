"""Preflight: success probability of the first run on a rig, causes of failure, and useful changes.

Runs are drawn like those of a campaign, from the uncertainty of the arms and the bench. This is the model's identified
uncertainty, or an assumed mismatch if its file gives none. Delay, lag, counts and zeros come from [run].

The rate comes with Wilson's interval at 99 %. At 95 %, one itinerary in twenty would lie outside, and more with the
noise of the campaign in the comparison. The border of a trouble is the value that halves the success rate of the
present bench on the same seeds. It is bracketed by doubling and narrowed by interpolation. A value runs on blocks of
seeds until its side of the border is clear. A falling curve is fitted to the points (isotonic regression), and the
border is read off this curve.

The gain of a change is measured on some of the failed seeds and on some of the completed ones. The changes are options
of `dpcontrol run`, the same as in `dpcontrol.runs.remedies`.

All work consists of a campaign's jobs, which are cached. A repeated or interrupted preflight continues from there, and
gives the same figures on any machine.

Source of isotonic regression: Barlow et al., Statistical Inference under Order Restrictions, Wiley 1972, chapter 1.
"""

import json
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.cache import cache_file, keep, kept
from dpcontrol.foundation.errors import remark
from dpcontrol.foundation.parts import Later
from dpcontrol.foundation.processes import in_processes, processors
from dpcontrol.foundation.progress import Cost, Progress, announce, no_progress, part_of
from dpcontrol.foundation.settings import Setting, Settings, leaves_of
from dpcontrol.foundation.statistics import paired, wilson
from dpcontrol.judge.preflight import Assumption, EndingShare, HazardBorder, Improvement, Preflight, ShareAt
from dpcontrol.loop.bench import MechanicsSettings
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.own import OwnPlant
from dpcontrol.plans.cautions import figures_of
from dpcontrol.plans.itinerary import Itinerary, overridden, setting_of
from dpcontrol.plans.overrides import canonical, typed
from dpcontrol.plans.plan import Plan
from dpcontrol.runs.campaign import MOST_TICKS, Case, Job, run_job
from dpcontrol.runs.troubles import TROUBLES, Trouble

optimize = Later("scipy.optimize")


@dataclass(frozen=True)
class SettingChange:
    """A change of a run's settings that may complete more runs.

    Attributes:
        text: the change as a noun phrase.
        options: its options of `dpcontrol run`, by path.
        advice: advice to the user, or "" for a change that preflights do not try.
    """

    text: str
    options: Mapping[str, Any]
    advice: str = ""


def _fewest_counts(itinerary: Itinerary) -> int:
    """Return the counts per turn of the coarsest encoder, which limits the estimate; 0 without rounding."""
    return min(itinerary.loop.counts(itinerary.model.arms.count), default=0)


def changes(itinerary: Itinerary) -> Iterator[Sequence[SettingChange]]:
    """Yield the changes that may complete more runs, by kind, the smallest of a kind first.

    There are kinds for more travel, for each trouble of the bench (half of it, and none), for better encoders, and for
    other settings of the loop.

    Args:
        itinerary: itinerary of the run.
    """
    loop = itinerary.loop
    limit, drive = loop.travel or itinerary.limits.position, loop.drive
    more_travel, *most_travel = map(_short, (1.5 * limit, 2 * limit, max(4 * limit, 2 * itinerary.limits.position)))
    yield (
        SettingChange(f"a travel of ±{more_travel:g} m", {"travel": more_travel}, f"more travel: ±{more_travel:g} m"),
        *(SettingChange(f"a travel of ±{travel:g} m", {"travel": travel}) for travel in most_travel),
    )
    for trouble in TROUBLES:
        present_value, changes_of_trouble = setting_of(loop, trouble.setting), []
        if present_value == trouble.nothing or (
            trouble.setting == "knock_impulse" and not loop.disturbances.knocks_per_minute
        ):
            continue
        if trouble.halves:
            smaller = (
                tuple(_short(number / 2) for number in present_value)
                if isinstance(present_value, tuple)
                else _short((present_value + trouble.nothing) / 2)
            )
            options, text = {trouble.setting: smaller}, f"half the {trouble.name}"
            changes_of_trouble.append(SettingChange(text, options, trouble.remedy and f"{trouble.remedy}: {text}"))
        if trouble.removed:
            changes_of_trouble.append(SettingChange(f"no {trouble.name}", {trouble.setting: trouble.nothing}))
        yield changes_of_trouble
    counts = 4 * _fewest_counts(itinerary)
    # The delay stays the same in seconds.
    delay = {"delay": _short(drive.delay * _QUICK / loop.rate)} if drive.delay else {}
    other_law = "tvlqr" if loop.controller.kind == "adaptive" else "adaptive"
    other_changes = (
        (
            drive.lag and loop.drive_lag != drive.lag,
            SettingChange(
                "a controller with the drive's lag", {"drive_lag": drive.lag}, "give the controller the drive's lag"
            ),
        ),
        (counts, SettingChange(f"{counts} counts a turn", {"counts": counts}, "finer encoders: four times the counts")),
        (loop.rate < _QUICK, SettingChange(f"a rate of {_QUICK:g} Hz", {"rate": _QUICK, **delay})),
        (loop.estimator.kind != "ekf", SettingChange("the ekf as the estimator", {"estimator": "ekf"})),
        (loop.keep != "none", SettingChange("no keeper of the stops", {"keep": "none"})),
        (
            loop.keep == "none" and itinerary.stay is None,
            SettingChange(f"{other_law} as the law", {"controller": other_law}, f"another law: {other_law}"),
        ),
    )
    yield from ((change,) for applies, change in other_changes if applies)


def _short(value: float) -> float:
    """Return a value rounded to four digits, which an option on the command line reproduces exactly."""
    return float(f"{value:.4g}")


_QUICK = 1000.0
"""Rate that slower loops are advised to use, Hz."""


ASSUMED_MISMATCH = 0.05
"""Mismatch of arms without a given uncertainty in the model's file or [run]."""
SAMPLED = 48
"""Most failed seeds, and most completed seeds, on which a change is tried."""


@dataclass(frozen=True)
class PreflightSettings(Settings, table="preflight"):
    """Size of a preflight.

    Attributes:
        runs: seeds for the rate, from `first_seed` on, 0 for as many as two minutes allow.
        confidence: of its interval.
        workers: processes, 0 for one per processor.

    The seeds are far from the first seeds of campaigns.
    """

    runs: Annotated[int, Setting(least=16, most=100_000, zero="as many as two minutes allow")] = 0
    first_seed: Annotated[int, Setting(least=0, most=2**31)] = 1_000_000
    confidence: Annotated[float, Setting(least=0.5, most=0.9999)] = 0.99
    workers: Annotated[int, Setting(least=1, most=1024, zero="one on each processor")] = 0


class RunEnd(NamedTuple):
    """Ending of the run of one seed, as it is cached.

    Attributes:
        seed: seed of the run.
        completed: True if the run completed its plan.
        cause: cause of a failure.
        reason: reason of a failure, a sentence.
    """

    seed: int
    completed: bool
    cause: str
    reason: str


@dataclass(frozen=True)
class Hazard:
    """A trouble whose border is sought: the value that halves the number of completed runs.

    Attributes:
        trouble: row of the table of troubles.
        name: name of the border.
        set: the bench's present value.
        first: first value of the search.
        end: last value of the search.
        shown: factor from the setting to the unit in which the border is shown.
        step: resolution of values, 0 for none.
        besides: further settings.
    """

    trouble: Trouble
    name: str
    set: float
    first: float
    end: float
    shown: float = 1.0
    step: float = 0.0
    besides: tuple[tuple[str, Any], ...] = ()

    def place(self, value: float) -> float:
        """Return a value's place on a logarithmic scale of severity, on which the border is bracketed.

        Args:
            value: value of the setting.

        Returns:
            The place, minus infinity if there is no trouble.
        """
        is_absent = value == 0 or math.isinf(value)
        return -math.inf if is_absent else -math.log(value) if self.trouble.falling else math.log(value)

    def value(self, place: float) -> float:
        """Return the value of the setting at a place on the scale of severity.

        Args:
            place: place on the scale of severity.
        """
        value = math.exp(-place if self.trouble.falling else place)
        return max(round(value / self.step), 1) * self.step if self.step else value


@dataclass(frozen=True)
class _Task:
    """Search for a border or trial of a change, which a worker carries out.

    Attributes:
        of: hazard or change.
        job: seeds of the present bench, or of the changed one.
        completed: True for each of these seeds whose run on the present bench was completed.
        most: largest number of seeds at once.
        block: seeds of the first block of a search.
        rate: share of completed runs on the present bench.
    """

    of: Hazard | SettingChange
    job: Job
    completed: tuple[bool, ...]
    most: int
    block: int = 0
    rate: float = 0.0


def _do(task: _Task) -> HazardBorder | Improvement:
    """Run a task in a worker process, and return the border of its hazard, or the improvement by its change."""
    return _change(task, task.of) if isinstance(task.of, SettingChange) else _border(task, task.of)


def outcomes(job: Job, most: int = MOST_TICKS) -> tuple[RunEnd, ...]:
    """Return the endings of a job's seeds, cached if possible.

    Args:
        job: seeds of one case.
        most: number of seeds at once, which limits the memory.
    """
    if len(job.seeds) > most:
        parts = (replace(job, seeds=job.seeds[k : k + most]) for k in range(0, len(job.seeds), most))
        return tuple(row for part in parts for row in outcomes(part, most))
    file = cache_file("preflights", job.itinerary, job.key)
    if (content := kept(file)) is not None:
        return tuple(RunEnd(*row) for row in json.loads(content))
    rows = tuple(
        RunEnd(row_of_run["seed"], row_of_run["completed"], row_of_run["cause"], row_of_run["reason"])
        for row_of_run in run_job(job)
    )
    keep(file, json.dumps(rows).encode())
    return rows


_SURE = 0.98
"""Confidence required to assign a value to one side of the border."""
_NARROW = math.log(1.3)
"""Width of the final bracket of the border, as the logarithm of a ratio."""
_MOST_VALUES = 8
"""Largest number of values of a trouble that are run to bracket its border."""


def _border(search: _Task, hazard: Hazard) -> HazardBorder:
    """Return the border of a hazard: the value that halves the present number of completed runs.

    The border is bracketed by doubling from the first value, then narrowed by interpolation on a logarithmic scale of
    severity (`Hazard.place`). It lies between `good`, where at least half of the present number complete, and `bad`. At
    most `_MOST_VALUES` values are run. If the last value of the search is good, the border is unknown (None). `search`
    has the seeds, and their endings on the present bench.
    """
    points: dict[float, ShareAt] = {}

    def share(place: float) -> float:
        """Return the share of completed runs at a place on the scale of severity, relative to the present bench.

        Each value of the trouble's setting runs once, and its result is stored in `points`.
        """
        value = hazard.value(place)
        if value not in points:
            points[value] = _point(search, hazard, value)
        return points[value].share

    def border_at(places: Sequence[float | None]) -> HazardBorder:
        """Return the border and the ends of its interval in the unit that is shown, with all points that were run.

        `places` are border, lower and upper end on the scale of severity, None if unknown.
        """
        trouble = hazard.trouble
        ends = [None if p is None else hazard.shown * math.exp(-p if trouble.falling else p) for p in places]
        shown = [replace(p, value=hazard.shown * p.value) for p in points.values()]
        return HazardBorder(
            hazard.name, trouble.setting, trouble.unit, hazard.shown * hazard.set, border=ends[0], low=ends[1],
            high=ends[2], end=hazard.shown * hazard.end, falling=trouble.falling,
            points=tuple(sorted(shown, key=lambda p: p.value)),
        )  # fmt: skip

    present, end = hazard.place(hazard.set), hazard.place(hazard.end)
    good = present
    place = max(hazard.place(hazard.first), present + math.log(1.5))
    place = min(place, (present + end) / 2 if math.isfinite(present) else end)
    while share(place) >= 0.5:
        good = place
        if place >= end:
            return border_at([None, None, None])
        place = min(place + math.log(2), end)
    bad = place
    # A bench without the trouble is at minus infinity, so a finite value that is good must be found.
    while math.isinf(good) and len(points) < _MOST_VALUES:
        place = bad - math.log(3)
        good, bad = (place, bad) if share(place) >= 0.5 else (good, place)
    while bad - good > _NARROW and len(points) < _MOST_VALUES:
        share_at_good = 1.0 if good == present else share(good)
        fraction = (share_at_good - 0.5) / (share_at_good - share(bad))
        place = good + float(np.clip(fraction, 0.3, 0.7)) * (bad - good)
        if hazard.value(place) in points:
            break
        good, bad = (place, bad) if share(place) >= 0.5 else (good, place)
    # Both ends of the bracket are run again on all seeds.
    for value in {hazard.value(place) for place in (good, bad) if place != present and math.isfinite(place)}:
        points[value] = _point(search, hazard, value, until_clear=False)
    return border_at(_read_off(hazard, list(points.values())))


def _point(search: _Task, hazard: Hazard, value: float, *, until_clear: bool = True) -> ShareAt:
    """Run one value of a trouble, and return its completed runs beside those of the present bench.

    Args:
        search: task with the seeds, and their endings on the present bench.
        hazard: trouble with the setting that is varied, and settings that go with it.
        value: value of that setting.
        until_clear: run blocks of seeds until it is clear on which side of the border the value is; otherwise all
            seeds.
    """
    job = search.job
    loop = overridden(job.case.loop, {hazard.trouble.setting: value, **dict(hazard.besides)})
    completed = reference = seeds_used = 0
    while seeds_used < len(job.seeds):
        block = slice(seeds_used, len(job.seeds) if seeds_used else min(search.block, len(job.seeds)))
        seeds = replace(job, case=replace(job.case, loop=loop), seeds=job.seeds[block])
        completed += sum(row.completed for row in outcomes(seeds, search.most))
        reference += sum(search.completed[block])
        seeds_used = block.stop
        interval = wilson(min(completed, reference), reference, confidence=_SURE)
        if until_clear and reference and not interval.low <= 0.5 <= interval.high:
            break
    return ShareAt(value, seeds_used, completed, reference)


def _read_off(hazard: Hazard, points: Sequence[ShareAt]) -> list[float | None]:
    """Return the places on the scale of severity at which three curves are one half, None for a curve that is not.

    The curves are the share of completed runs, relative to the present bench, and the lower and upper ends of its 95 %
    interval. A falling curve is fitted to the points, because more of a trouble cannot help. At the present bench, the
    share is 1.
    """
    ordered = sorted(points, key=lambda point: hazard.place(point.value))
    places = [hazard.place(point.value) for point in ordered]
    weights = [max(point.reference, 1) for point in ordered]
    shares = optimize.isotonic_regression([point.share for point in ordered], weights=weights, increasing=False).x
    bands = [wilson(min(point.completed, point.reference), point.reference) for point in ordered]
    low = np.minimum.accumulate([band.low for band in bands])
    high = np.maximum.accumulate([band.high for band in bands][::-1])[::-1]
    present = hazard.place(hazard.set)
    start = [present] if math.isfinite(present) and present < places[0] else []
    severities = np.array([*start, *places])
    return [_crossing(severities, np.concatenate([np.ones(len(start)), curve])) for curve in (shares, low, high)]


def _crossing(x: NDArray[np.float64], falls: NDArray[np.float64]) -> float | None:
    """Return the place at which a falling, piecewise linear curve is one half; None if it starts below or stays above.

    Args:
        x: places (M,), rising.
        falls: values (M,) of the curve.
    """
    below = np.flatnonzero(falls < 0.5)
    if not below.size or not below[0]:
        return None
    row = int(below[0])
    fraction = (falls[row - 1] - 0.5) / (falls[row - 1] - falls[row])
    return float(x[row - 1] + fraction * (x[row] - x[row - 1]))


def _change(trial: _Task, change: SettingChange) -> Improvement:
    """Return the improvement by a change: the runs that it rescues and loses on the seeds of its trial.

    `trial` has these seeds with the change, their endings on the present bench, and the success rate there.
    """
    present_runs = trial.completed
    pairs = paired(present_runs, [row.completed for row in outcomes(trial.job, trial.most)])
    return Improvement(
        change.advice, dict(change.options), pairs.only_second, present_runs.count(False), pairs.only_first,
        present_runs.count(True), trial.rate, typed(change.options),
    )  # fmt: skip


_TICK, _TICK_ALONE = 5e-6, 2e-4
"""Processor time of a tick of one run in lockstep, and of one separate run, s."""
_AHEAD = 0.15
"""Additional share of this time for each period of predicted delay."""


def seconds_of(loop: LoopSettings) -> float:
    """Return the processor time of one tick with these settings, s, by which costs are announced.

    Args:
        loop: settings of the run.
    """
    return _TICK * (1 + _AHEAD * loop.drive.delay) if loop.lockstep else _TICK_ALONE


_AFFORD, _AFFORD_DELAY = 150.0, 40.0
"""Processor time of a preflight and of its search for the border of delay, s.

This is two minutes of two processors, less start-up and compilation.
"""


class _Amounts(NamedTuple):
    """Numbers of runs of a preflight.

    Attributes:
        rate: seeds for the rate.
        block: seeds for the first points of a border.
        border: seeds for its last points.
        change: failed seeds for each change, and as many completed ones.
        kinds: number of borders.
    """

    rate: int
    block: int
    border: int
    change: int
    kinds: int

    @classmethod
    def of(cls, rate: int, kinds: int = 10) -> "_Amounts":
        """Return the amounts that suit `rate` seeds for the rate and a search for `kinds` borders."""
        if rate <= _FEW:
            return cls(rate, min(24, rate), min(48, rate), max(rate // 8, 8), kinds)
        return cls(rate, 64, rate // 2, min(SAMPLED, rate // 4), kinds)

    @property
    def runs(self) -> int:
        """Approximate upper bound of all runs, from which the cost is estimated."""
        runs_of_changes = _CHANGES * min(2 * self.change, self.rate) if self.kinds else 0
        return self.rate + self.kinds * (3 * self.block + 2 * self.border) + runs_of_changes


_FEW = 128
"""Seeds for the rate up to which borders and changes use the fewest informative seeds."""
_CHANGES = 9
"""Number of changes that a preflight usually tries."""
_CHOICES = (
    *map(_Amounts.of, (320, 256, 192, 160, 128, 96, 64, 48, 32)),
    *(_Amounts.of(32, kinds) for kinds in (6, 4, 2, 1)),
    *(_Amounts.of(rate, 0) for rate in (128, 64, 32, 16)),
)
"""Amounts to choose from, best first. Those of long itineraries have few borders or none."""


def _amounts(seeds: int, seconds: float, *, lockstep: bool) -> _Amounts:
    """Return the numbers of runs for a requested number of seeds for the rate, or the best of `_CHOICES` in time.

    In time are those whose runs take at most `_AFFORD` s; if none is, the last choice is returned.

    Args:
        seeds: requested seeds for the rate, 0 for as many as are affordable.
        seconds: processor time of a run, s.
        lockstep: False for runs that are too slow to search for borders.
    """
    if seeds:
        return _Amounts.of(seeds)
    choices = (amounts if lockstep else amounts._replace(kinds=0) for amounts in _CHOICES)
    return next((amounts for amounts in choices if amounts.runs * seconds <= _AFFORD), _CHOICES[-1])


_STARTED = 3.0
"""Processor time of a process before its first job, s."""
_FIRST = 8
"""Seeds of the first job, which compiles and is not measured."""


def _seconds(job: Job, amounts: _Amounts, most: int, workers: int) -> float:
    """Return the likely duration of a preflight on this machine, s, measured on its first seeds.

    The first `_FIRST` seeds include the compilation; then all seeds of the job are measured.

    Args:
        job: first seeds of the rate, the share of completed runs on the present bench.
        amounts: numbers of runs of the whole preflight.
        most: largest number of seeds at once.
        workers: number of processes.
    """
    clock_times = [time.process_time()]
    for seeds in (job.seeds[:_FIRST], job.seeds):
        outcomes(replace(job, seeds=seeds), most)
        clock_times.append(time.process_time())
    first_seconds, job_seconds = np.diff(clock_times).tolist()
    # Two groups of processes follow one another. Each compiles, and the second does so for several delays.
    startup = 2 * (_STARTED + 2 * first_seconds) if workers > 1 else 2 * first_seconds
    return amounts.runs * job_seconds / len(job.seeds) / workers + startup


def preflight(
    plan: Plan,
    options: Mapping[str, Any] | None = None,
    *,
    settings: PreflightSettings | None = None,
    progress: Progress = no_progress,
    yes: bool = False,
) -> Preflight:
    """Predict the success rate of a planned itinerary on its bench, causes of failure, and useful changes.

    Args:
        plan: plan of the itinerary.
        options: run settings that override the itinerary's.
        settings: size of the preflight.
        progress: receiver of progress reports.
        yes: accept any duration.

    Raises:
        InputError: an impossible setting, or it would take too long.
        GoalMissed: the plan did not converge, no controller can be made for it, or a process died.
    """
    began, options, settings = time.perf_counter(), options or {}, settings or PreflightSettings()
    itinerary, errors = with_known_errors(plan.followed().itinerary, options)
    loop, name = itinerary.loop, itinerary.name
    ticks = max(round(plan.reference.duration * loop.rate), 1)
    lockstep, tick = loop.lockstep, seconds_of(loop)
    amounts = _amounts(settings.runs, ticks * tick, lockstep=lockstep)
    workers = settings.workers or processors()
    work, seconds = f"up to {amounts.runs:,} runs of {ticks / loop.rate:.1f} s", amounts.runs * ticks * tick / workers
    cost = Cost(work, seconds, 4e8 * workers, f"preflight of {name}")
    announce(cost, yes=yes, above=math.inf)
    seeds = tuple(range(settings.first_seed, settings.first_seed + amounts.rate))
    case = Case("preflight", (), loop)
    job = Job(name, plan.archive, itinerary.model.arms, case, seeds, "compiled", itinerary.uncertainty, replayed=0)

    # At most the memory of a campaign's jobs.
    most = max(min(MOST_TICKS // ticks, 256), 1)
    size = min(128 if amounts.rate > _FEW else 64, most) if lockstep else 4
    jobs = [replace(job, seeds=job.seeds[k : k + size]) for k in range(0, amounts.rate, size)]
    if kept(cache_file("preflights", name, jobs[0].key)) is None:
        remark(replace(cost, seconds=_seconds(jobs[0], amounts, most, workers)).sentence)
    parts = in_processes(outcomes, jobs, workers, what="jobs for the rate", progress=part_of(progress, 0.0, 0.15))
    ends = sorted(row for _, part in parts for row in part)
    completed = [row.completed for row in ends]
    share = wilson(sum(completed), len(completed), confidence=settings.confidence)
    notes = _notes(itinerary, loop)
    most_delay = _AFFORD_DELAY / (3 * amounts.block * ticks * _TICK * _AHEAD)
    kinds = hazards(plan, itinerary, most_delay=most_delay)
    tasks: list[_Task] = []
    if amounts.kinds:
        tasks += _searches(kinds[: amounts.kinds], job, completed, amounts, most, notes)
        tasks += _trials(itinerary, job, completed, amounts.change, most)
    if omitted := ", ".join(kind.name for kind in kinds[amounts.kinds :]):
        notes.append(f"two minutes do not suffice for the borders of {omitted}: --runs 32 finds them")
    work = in_processes(_do, tasks, workers, what="borders and changes", progress=part_of(progress, 0.15, 1.0))
    results = [result for _, result in work]
    borders = [b for b in results if isinstance(b, HazardBorder)]
    return Preflight(
        itinerary=name,
        title=itinerary.title,
        model=itinerary.model.name,
        share=share,
        confidence=settings.confidence,
        known=tuple(errors),
        notes=tuple(notes),
        endings=endings(ends),
        borders=tuple(sorted(borders, key=lambda b: (b.margin is None, b.margin or 0.0, b.name))),
        changes=tuple(sorted((c for c in results if isinstance(c, Improvement)), key=lambda c: (-c.gain, c.text))),
        seconds=time.perf_counter() - began,
        warnings=figures_of(itinerary, plan.reference) if share.rate < 1 else (),
    )


def endings(ends: Sequence[RunEnd]) -> tuple[EndingShare, ...]:
    """Return the causes of failed runs with an example of each, the most frequent first.

    Args:
        ends: endings of all runs.
    """
    groups: dict[str, list[RunEnd]] = {}
    for row in ends:
        if not row.completed:
            groups.setdefault(row.cause, []).append(row)
    ordered = sorted(groups.items(), key=lambda item: -len(item[1]))
    return tuple(EndingShare(cause, len(rows), rows[0].seed, rows[0].reason) for cause, rows in ordered)


def with_known_errors(itinerary: Itinerary, options: Mapping[str, Any]) -> tuple[Itinerary, list[Assumption]]:
    """Return the itinerary whose runs are drawn from the known errors of arms and bench, and a list of these errors.

    Arms are drawn from the model's identified uncertainty, unless settings give other errors. If the model has none
    and no setting draws the arms, a mismatch of `ASSUMED_MISMATCH` is assumed. Each error of the list has its source.

    Args:
        itinerary: itinerary of the run.
        options: settings by path that override those of the itinerary.

    Raises:
        InputError: an impossible setting.
    """
    set_names = {path.rpartition(".")[2] for path in canonical(options)}
    is_identified = itinerary.model.uncertainty is not None
    drawn_itinerary = itinerary.with_run(options)
    if is_identified and not {"mismatch", "model_uncertainty"} & set_names and not itinerary.loop.model_uncertainty:
        drawn_itinerary = drawn_itinerary.with_run({"model_uncertainty": 1.0, "mismatch": 0.0})
    is_drawn = (
        drawn_itinerary.loop.model_uncertainty
        or drawn_itinerary.loop.mismatch
        or drawn_itinerary.loop.plant is not None
    )
    assumes_mismatch = not is_drawn and "mismatch" not in set_names
    drawn_itinerary = drawn_itinerary.with_run({"mismatch": ASSUMED_MISMATCH}) if assumes_mismatch else drawn_itinerary
    loop, file = drawn_itinerary.loop, f"[run] of {itinerary.path.name}"

    def source_of(*names: str) -> str:
        """Return "given" if one of these settings is among the options, otherwise the itinerary's [run]."""
        return "given" if any(name in set_names for name in names) else file

    drive, sensors, blows = loop.drive, loop.sensors, loop.disturbances
    limit, counts = loop.travel or itinerary.limits.position, _fewest_counts(itinerary)
    remark_on_model = "" if is_identified else f"; {itinerary.model.path.name} has no [uncertainty]"
    source = ("assumed" if assumes_mismatch else source_of("mismatch")) + remark_on_model
    identified_by = f"identified: {itinerary.model.path.name}"
    mechanics = {key: np.atleast_1d(getattr(loop.mechanics, key)) for key in _MECHANICS}
    units = {key: leaves_of(MechanicsSettings)[key].bounds.unit for key in _MECHANICS}
    rows = [
        (loop.model_uncertainty, "arms", f"standard errors × {loop.model_uncertainty:g}", identified_by),
        (loop.plant is not None, "plant", "other arms", source_of("plant")),
        (
            loop.mismatch or not loop.model_uncertainty,
            "arms",
            f"each parameter off by up to ±{loop.mismatch:.3g}",
            source,
        ),
        (True, "start", f"each angle off by up to ±{loop.initial_error:g} rad", source_of("initial_error")),
        (True, "delay", f"{1e3 * drive.delay / loop.rate:.3g} ms at {loop.rate:g} Hz", source_of("delay")),
        (True, "lag", f"{1e3 * drive.lag:.3g} ms", source_of("lag")),
        (True, "encoders", f"{counts:,} counts a turn" if counts else "not rounded", source_of("counts")),
        (True, "zeros", f"off by up to ±{sensors.zero_error:g} rad", source_of("zero_error")),
        (True, "travel", f"±{limit:g} m", source_of("travel") if loop.travel else f"[limits] of {itinerary.path.name}"),
        (drive.command_noise, "command noise", f"{drive.command_noise:g} m/s²", source_of("command_noise")),
        (sensors.noise, "encoder noise", f"{sensors.noise:g} rad", source_of("noise")),
        (blows.tilt, "tilt", f"{blows.tilt:g} rad", source_of("tilt")),
        (blows.pushes and blows.push_impulse, "blows", f"{blows.push_impulse:g} N m s", source_of("push_impulse")),
        *(
            (
                values.any(),
                key.replace("_", " "),
                f"{' and '.join(f'{value:g}' for value in values)} {units[key]}",
                source_of(key),
            )
            for key, values in mechanics.items()
        ),
        (True, "control", f"{loop.controller.kind} with {loop.estimator.kind}", source_of("controller", "estimator")),
    ]
    return drawn_itinerary, [Assumption(*row) for is_listed, *row in rows if is_listed]


_MECHANICS = ("belt", "play", "cable_torque", "cable_stiffness", "stiction", "initial_rate", "initial_cart")
"""Settings of the mechanics that are listed if they are not zero."""


def _notes(itinerary: Itinerary, loop: LoopSettings) -> list[str]:
    """Return warnings about settings that make the forecast too favourable, as sentences; none if there are none."""
    measured = {"lag": loop.drive.lag, "zero_error": loop.sensors.zero_error}
    unmeasured = [name for name, value in measured.items() if not value]
    notes = (
        (
            itinerary.start == "orbit",
            'start = "orbit": runs begin at the orbit\'s exact rates, which a rig cannot; plan from "rest"',
        ),
        (
            unmeasured,
            f"{' and '.join(unmeasured)} = 0 in [run]: a bench is never ideal; measure it with `dpcontrol commission "
            f"{itinerary.name} --rig ADDRESS --write`, or give an estimate",
        ),
    )
    return [note for applies, note in notes if applies]


def _searches(
    kinds: Sequence[Hazard], job: Job, completed: Sequence[bool], amounts: _Amounts, most: int, notes: list[str]
) -> list[_Task]:
    """Return the searches for borders, or none if too few runs complete; the reason is then added to `notes`.

    Args:
        kinds: hazards in order of importance.
        job: all seeds of the rate on the present bench.
        completed: True for each of these seeds whose run was completed.
        amounts: numbers of runs of the preflight, of which those of a border are used.
        most: largest number of seeds at once.
        notes: list that receives the reason.
    """
    completed_runs = sum(completed)
    if completed_runs < _FEWEST:
        notes.append(
            f"only {completed_runs} of {len(completed)} runs complete: too few to find borders; see the useful changes"
        )
        return []
    # If few runs complete, more seeds give the same number of completed runs. Each new delay needs its own code, so
    # its search gets a block of seeds only.
    count = min(math.ceil(amounts.border * max(1.0, 0.6 * len(completed) / completed_runs)), len(completed))
    counts = [amounts.block if kind.trouble.in_periods else count for kind in kinds]
    return [
        _Task(kind, replace(job, seeds=job.seeds[:seeds]), tuple(completed[:seeds]), most, amounts.block)
        for kind, seeds in zip(kinds, counts, strict=True)
    ]


_FEWEST = 8
"""Completed runs required for a search of borders."""


def hazards(plan: Plan, itinerary: Itinerary, *, most_delay: float) -> list[Hazard]:
    """Return the troubles whose borders are sought, with the bench's present values.

    Prediction over a delay takes time in proportion, and each delay needs separate code. Its border is therefore sought
    within 40 ms and on few seeds.

    Args:
        plan: plan of the itinerary.
        itinerary: itinerary with known errors.
        most_delay: largest delay, in periods, that the computing time allows.
    """
    loop = itinerary.loop
    python_plant = isinstance(loop.plant, OwnPlant) and not loop.plant.own.symbolic
    pushes, mechanics = loop.disturbances.pushes, loop.mechanics
    travel, reference_travel = loop.limits(plan.reference.limits).position, plan.reference.max_cart_position
    # The loop's model of the bench stays unchanged.
    corrections = (
        ("known_belt", loop.known_belt),
        ("known_play", mechanics.of_each("known_play", itinerary.model.arms.count)),
    )
    besides = {"push_impulse": (("pushes", pushes or 2),), "belt": corrections, "play": corrections}
    present = {
        "push_impulse": loop.disturbances.push_impulse if pushes else 0.0,
        "counts": _fewest_counts(itinerary) or math.inf,
        "travel": travel,
        "belt": mechanics.belt or math.inf,
    }
    searches = []
    for trouble in TROUBLES:
        value = present.get(trouble.setting, setting_of(loop, trouble.setting))
        value = max(value) if isinstance(value, tuple) else value
        if (
            not trouble.border
            or not (trouble.always or value)
            or (python_plant and trouble.setting not in _WITH_OWN_PLANT)
        ):
            continue
        first, end, display_factor = trouble.first, trouble.last, trouble.shown
        if trouble.in_periods:
            first, display_factor = first * loop.rate, display_factor / loop.rate
            end = max(min(end * loop.rate, most_delay), 2 * value, 2)
        elif trouble.setting == "travel":
            # A reference whose cart stays at the centre needs some travel as well.
            end = max(reference_travel, 1e-3 * travel)
        step = 1.0 if trouble.in_periods or trouble.setting == "counts" else 0.0
        name = trouble.border.format(pushes=pushes or 2)
        searches.append(
            Hazard(trouble, name, abs(value), first, end, display_factor, step, besides.get(trouble.setting, ()))
        )
    return searches


_WITH_OWN_PLANT = ("delay", "push_impulse", "zero_error", "counts", "travel", "initial_rate", "initial_cart")
"""Settings that remain if a user's plant replaces arms, cart and drive."""


def _trials(itinerary: Itinerary, job: Job, completed: Sequence[bool], count: int, most: int) -> list[_Task]:
    """Return the trials of all changes with advice, each on the same failed and completed seeds of the present bench.

    The first `count` of either are used. There are no trials if every run completes.

    Args:
        itinerary: itinerary with known errors.
        job: all seeds of the rate on the present bench.
        completed: True for each of these seeds whose run was completed.
        count: largest number of failed seeds, and of completed ones.
        most: largest number of seeds at once.
    """
    if all(completed):
        return []
    failed = [k for k, is_completed in enumerate(completed) if not is_completed][:count]
    successful = [k for k, is_completed in enumerate(completed) if is_completed][:count]
    indices = sorted([*failed, *successful])
    seeds, present_endings = tuple(job.seeds[k] for k in indices), tuple(completed[k] for k in indices)
    rate = sum(completed) / len(completed)
    advised_changes = [change for group in changes(itinerary) for change in group if change.advice]
    changed_cases = [replace(job.case, loop=itinerary.with_run(change.options).loop) for change in advised_changes]
    return [
        _Task(change, replace(job, case=case, seeds=seeds), present_endings, most, rate=rate)
        for change, case in zip(advised_changes, changed_cases, strict=True)
    ]
