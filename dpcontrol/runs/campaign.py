"""Campaigns: success rates of an itinerary over many seeds, in several cases, with confidence intervals.

A case is a controller with values that override those of the itinerary. All cases run the same seeds, so they can be
compared in pairs. Jobs of a few seeds each run in processes of this machine. The table depends
neither on the number of workers nor on workers that die. A job carries all its inputs (reference, parameters,
settings), so a worker needs this package but no files. The same job always gives the same rows.

The rows are one tidy table: the folder NAME.parquet has a file NUMBER-KEY.parquet for each finished job, written
atomically. NUMBER gives the order of the jobs, KEY is the hash of the job's inputs. A campaign that is started again
runs the jobs without a file. `pyarrow.parquet.read_table` reads the folder in the order of the jobs.

The robustness score measures how much of each kind of trouble a controller tolerates. Each kind has 21 levels, in
addition to the disturbances of the itinerary itself. The score of a kind is the share of its runs that complete the
whole itinerary, symbol by symbol, by the true state. The controller's score is the mean over the kinds.

The first six kinds are those of the leaderboard of the dfki double pendulum, which swings up under a torque of at most
6 N m. The last three concern encoders and the cart's drive. Agreement with the leaderboard's definitions:

    velocity noise   Gaussian on the rates given to the controller. There 0 to 0.5 rad/s, here to 3 rad/s.

    response         The same: 0.1 to 2 times the command.

    delay            There 0 to 40 ms. Here to 300 ms, because the loop predicts over its known delay.

    model error      There one parameter at a time, ±25 %. Here all at once, ±25 %, and friction up to ±125 %.

    command noise    There up to 1.1 of 6 N m. Here up to 75 m/s² of a limit of 30.

    pushes           There three per joint, of 0.06 to 1.3 N m s over 0.1 s, on heavier arms, at one level.
                     Here three in all, instantaneous, up to 0.012 N m s, 4 rad/s of the outer arm.


Our ranges are wider where theirs left nearly every run of `tvlqr` and `adaptive` unharmed.

The leaderboard counts a level of noise if more than half of its runs succeed. Here every run counts. Scores of the two
can therefore be compared kind by kind, but their differences mean nothing.

Source: Wiebe et al., Open-source dual-purpose acrobot and pendubot platform (IEEE RAM, 2024), section on benchmarking.
The ranges follow the leaderboard's scripts, robustness version 2, of
github.com/dfki-ric-underactuated-lab/double_pendulum.
"""

import io
import itertools
import json
import math
import threading
import time
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import ArmChainParameters, Uncertainty
from dpcontrol.foundation.checked import is_list
from dpcontrol.foundation.document import Documented, document_of
from dpcontrol.foundation.errors import InputError, Remark
from dpcontrol.foundation.files import (
    content_hash,
    in_the_way,
    write_whole,
)
from dpcontrol.foundation.parts import Later, part
from dpcontrol.foundation.processes import in_processes, processors
from dpcontrol.foundation.progress import Cost, Progress, announce, no_progress, part_of
from dpcontrol.foundation.rendering import DataFrame
from dpcontrol.foundation.settings import Setting, Settings
from dpcontrol.foundation.shown import Brief, Shown, data_frame
from dpcontrol.foundation.statistics import Pairing, Share, paired, share_of, wilson
from dpcontrol.foundation.version import VERSION
from dpcontrol.judge.campaign import METADATA, CampaignSummary, campaign_table, pa, summary_of
from dpcontrol.judge.decoding import stays
from dpcontrol.judge.score import Flown, returns, verdict_on
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.own import OwnExpressions, OwnLaw
from dpcontrol.loop.result import BatchRun, Events
from dpcontrol.plans.itinerary import Itinerary
from dpcontrol.plans.overrides import canonical
from dpcontrol.plans.plan import Plan
from dpcontrol.references.reference import Reference, load_reference
from dpcontrol.runs.troubles import LEVELS, STANDARD

pq, pc = Later("pyarrow.parquet"), Later("pyarrow.compute")

Row = dict[str, Any]
"""Values of one run by the names of `COLUMNS`."""

COLUMNS: dict[str, str] = {
    "itinerary": "string",
    "case": "string",
    "controller": "string",
    "estimator": "string",
    "seed": "int64",
    "mismatch": "double",
    "completed": "bool",
    "symbols_completed": "int32",
    "symbols_total": "int32",
    "symbol": "string",
    "ending": "string",
    "cause": "string",
    "reason": "string",
    "simulated_seconds": "double",
    "rms_tracking_error": "double",
    "max_cart_position": "double",
    "rms_cart_acceleration": "double",
    "rms_feedback": "double",
    "nis_inside_95": "double",
    "returned": "double",
    "path": "string",
    "replays": "bool",
}
"""Columns of a row with their Arrow types, in SI units.

cause: value of a `Cause` for a run that ended early, otherwise of a `Fault`.
symbol: first symbol that was not completed, or empty.
returned: the longest time from a departure to the return to the itinerary, null without a return.
case: varied settings, as name=value.
replays: True if the loop fails tick by tick too; only tried for the first failures of a job, else null.
"""

RUNNING = 3
"""Version of runs, part of a job's key: raise it whenever a seed ends in another way, or a row has other columns."""
_ONE_AT_A_TIME = threading.Lock()
"""Threads cannot share compiled code."""


@dataclass(frozen=True)
class Case(Brief):
    """One combination of varied values.

    Attributes:
        label: the values in one line, which identifies the case in the table.
        values: names and shown values.
        loop: settings of the case's runs.
    """

    label: str
    values: tuple[tuple[str, float | str], ...]
    loop: LoopSettings


@dataclass(frozen=True)
class Job:
    """Seeds of one case, which a worker runs at once.

    Attributes:
        itinerary: name of the itinerary.
        reference: archive of the plan.
        arms: parameters of the model's arms.
        case: the case.
        seeds: seeds of the runs.
        path: "compiled" for many seeds in lockstep, or "ticks".
        uncertainty: uncertainty of the arms, for cases that draw their plants from it.
        replayed: number of failures in lockstep that are run again tick by tick.
        mismatches: one for each seed, which replaces the case's.
    """

    itinerary: str
    reference: bytes = field(repr=False)
    arms: ArmChainParameters
    case: Case
    seeds: tuple[int, ...]
    path: str
    uncertainty: Uncertainty | None = None
    replayed: int = 4
    mismatches: tuple[float, ...] = ()

    @property
    def key(self) -> str:
        """Hash of the job's inputs, as 16 hexadecimal digits, by which finished jobs are found again."""
        # The repr of a case is one line without its settings.
        return content_hash(
            self.reference, repr(self), repr(self.case.values), repr(self.case.loop), f"running {RUNNING}"
        )


@lru_cache(maxsize=8)
def _prepared(archive: bytes, arms: ArmChainParameters, loop: LoopSettings) -> Assembly:
    """Return the parts of the closed loop for settings that decide the controller, built once in each process.

    The last eight are stored, for other jobs with the same settings. Controller and fallback are built at once.

    Args:
        archive: archive of the plan, which holds its reference.
        arms: parameters of the model's arms.
        loop: settings that decide the controller, without those of the bench.
    """
    reference = load_reference(io.BytesIO(archive))
    assembly = Assembly(reference, arms, loop, stays=stays(reference))
    _ = assembly.controller, assembly.fallback
    return assembly


def run_job(job: Job) -> list[Row]:
    """Run a job's seeds, in lockstep if possible, and return their rows in order.

    Args:
        job: seeds of one case.

    Raises:
        InputError: the settings do not fit the plan.
        GoalMissed: no controller can be made for it.
    """
    with _ONE_AT_A_TIME:
        loop, assembly = job.case.loop, _assembled(job)
        reference = assembly.reference
        mismatches = job.mismatches or (loop.mismatch,) * len(job.seeds)

        def tick_by_tick(seed: int, mismatch: float) -> Row:
            """Return the row of one seed of the job that runs alone, from its start, without lockstep.

            If the settings let it recover from falls, `returned` is the longest time back to the itinerary, s.
            """
            events = Events()
            result = assembly.simulate(draw=assembly.draw(seed=seed, mismatch=mismatch), sink=events)
            row = _row(job, reference, seed, BatchRun.of(result), path="ticks")
            return {**row, "returned": max(returns(events.kept), default=None)}

        if job.path == "ticks" or not assembly.lockstep:
            return [tick_by_tick(seed, mismatch) for seed, mismatch in zip(job.seeds, mismatches, strict=True)]
        runs = assembly.batch(job.seeds, mismatches=mismatches)
        rows = [
            tick_by_tick(seed, mismatch) if run.departed else _row(job, reference, seed, run, path="compiled")
            for seed, mismatch, run in zip(job.seeds, mismatches, runs, strict=True)
        ]
        rows_and_mismatches = zip(rows, mismatches, strict=True)
        failures = [
            (row, run_mismatch)
            for row, run_mismatch in rows_and_mismatches
            if not row["completed"] and row["path"] == "compiled"
        ]
        for row, mismatch in failures[: job.replayed]:
            # A listed failure should also fail when its seed is run separately. For laws with internal timing,
            # rounding decides a few runs.
            row["replays"] = not tick_by_tick(row["seed"], mismatch)["completed"]
        return rows


def _assembled(job: Job) -> Assembly:
    """Return the parts of a job's closed loop; jobs whose cases differ only in the bench share the controller."""
    loop = job.case.loop
    # By the inputs of a controller: cases that differ only in the bench share one.
    controller_inputs = LoopSettings(
        seed=0, rate=loop.rate, drive_lag=loop.known_lag, keep=loop.keep, controller=loop.controller,
        estimator=loop.estimator, encoders=loop.encoders,
        supervisor=loop.supervisor, start=loop.start,
    )  # fmt: skip
    return replace(_prepared(job.reference, job.arms, controller_inputs).under(loop), uncertainty=job.uncertainty)


def _row(job: Job, reference: Reference, seed: int, run: BatchRun, *, path: str) -> Row:
    """Return the row of one run for the campaign's table: its verdict against the plan, and figures.

    Args:
        job: job of the run.
        reference: reference of the plan.
        seed: seed of the run.
        run: result of the run.
        path: "compiled" for a run in lockstep, or "ticks" for one that ran alone, tick by tick.
    """
    loop = job.case.loop
    motion = Flown.of(run, rate_hz=loop.rate, limits=loop.limits(reference.limits))
    verdict = verdict_on(motion, reference)
    symbols = [symbol.text for symbol in reference.content.symbols]
    tracking_error = motion.angles - motion.reference_angles
    return {
        "itinerary": job.itinerary,
        "case": job.case.label,
        "controller": loop.controller.kind,
        "estimator": loop.estimator.kind,
        "seed": seed,
        "mismatch": loop.mismatch,
        "completed": verdict.completed,
        "symbols_completed": verdict.symbols,
        "symbols_total": len(symbols),
        "symbol": [*symbols, ""][verdict.symbols],
        "ending": run.ending.value,
        "cause": verdict.cause,
        "reason": "" if verdict.completed else verdict.reason,
        "simulated_seconds": float(run.times[-1]),
        "rms_tracking_error": math.sqrt(float(np.mean(tracking_error**2))),
        "max_cart_position": float(np.abs(run.truth[:, -2]).max()),
        "rms_cart_acceleration": math.sqrt(float(np.mean(run.applied**2))),
        "rms_feedback": run.rms_feedback,
        "nis_inside_95": run.nis_inside_95,
        "returned": None,
        "path": path,
        "replays": True if path == "ticks" else None,
    }


def _schema(cases: Sequence[Case], record: Mapping[str, Any]) -> "pa.Schema":
    """Return the columns of a campaign's tables, with those of the varied numbers.

    The table's metadata hold `record`, by which a campaign is recognised when it is continued.
    """
    varied_columns = dict.fromkeys((name for case in cases for name in _numbers(case)), "double")
    fields = [(name, pa.type_for_alias(kind)) for name, kind in {**COLUMNS, **varied_columns}.items()]
    return pa.schema(fields, metadata={METADATA: json.dumps(record).encode()})


MOST_RUNS = 1_000_000
"""Largest number of runs of a case."""
MOST_CASES = 10_000
"""Largest number of cases of a campaign."""
MOST_PAIRED = 6
"""Largest number of cases that are compared in pairs."""
MOST_TICKS = 5_000_000
"""Ticks of all runs of a job together, at 72 bytes of memory per tick."""
MOST_TICKS_OF_LOOPS = 120_000
"""Ticks of a sequential job, about 15 s of work: the most that a killed campaign loses."""


@dataclass(frozen=True)
class CampaignSettings(Settings, table="campaign"):
    """Size of a campaign and the processes that run it.

    Attributes:
        runs: runs of each case, from seed `first_seed` on.
        path: "compiled" runs many seeds in lockstep, "ticks" the loop itself.
        workers: processes, 0 for one per processor.
        batch: seeds in a job, fewer for long runs.
        replayed: number of a job's failures in lockstep that the loop itself runs again to confirm them.
    """

    runs: Annotated[int, Setting(least=1, most=MOST_RUNS)]
    first_seed: Annotated[int, Setting(least=0, most=2**31)] = 0
    path: Annotated[str, Setting(choices=("compiled", "ticks"))] = "compiled"
    workers: Annotated[int, Setting(least=1, most=1024, zero="one on each processor")] = 0
    batch: Annotated[int, Setting(least=1, most=4096)] = 256
    replayed: Annotated[int, Setting(least=0, most=4096)] = 4


@dataclass(frozen=True)
class CaseResult(Brief):
    """Runs of one case: the completed ones as a share, the others as rows.

    Attributes:
        case: the case.
        completed: share of completed runs.
        failed: rows of the other runs, as Arrow columns.
        returned: median of the times to the itinerary, s, and the time within which 99 % of the runs returned, or None
            without returns.
    """

    case: Case
    completed: Share
    failed: "pa.Table" = field(repr=False)
    returned: tuple[float, float] | None = None

    @property
    def failures(self) -> tuple[Row, ...]:
        """The rows of runs that were not completed."""
        return tuple(self.failed.to_pylist())


_SHARE = "runs,completed=successes,success_rate=rate,wilson_95=interval"
"""Entries of a share's document."""


@dataclass(frozen=True)
class Transition(Documented):
    """Runs of one transition in one case.

    The number completed and the causes of the other endings.

    Attributes:
        duration: without the rests before and after it, s.
        max_cart_position: farthest position of the cart, m.
        rms_cart_acceleration: mean over the runs, m/s².
    """

    KEYS: ClassVar[str] = f"* **completed:{_SHARE}"

    name: str
    source: str
    target: str
    duration: float
    case: str
    completed: Share
    max_cart_position: float
    rms_cart_acceleration: float
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class Campaign(Shown):
    """Completed shares of a campaign's cases, and all runs.

    Attributes:
        itinerary: name of the itinerary.
        completed: share of all runs.
        results: result of each case, in order.
        pairs: first case, second case and their comparison, for every two of a few cases.
        seconds: duration of the campaign, s.
        simulated_seconds: sum of the durations of the runs, s.
        table: all runs, as Arrow columns.
        file: folder of the table, if it was written.
        alone: parts that were run separately, by name: start, end and duration, s.
        standard: robustness score of each controller, if it was requested.
    """

    itinerary: str
    completed: Share
    results: tuple[CaseResult, ...]
    pairs: tuple[tuple[str, str, Pairing], ...]
    seconds: float
    simulated_seconds: float
    table: "pa.Table"
    file: Path | None
    alone: Mapping[str, tuple[str, str, float]] = field(default_factory=dict)
    standard: tuple["StandardScore", ...] = ()

    def __repr__(self) -> str:
        return f"<campaign of {self.itinerary!r}: {self.status}>"

    @property
    def status(self) -> str:
        """Success rate in one sentence."""
        return self.completed.sentence()

    @cached_property
    def summary(self) -> CampaignSummary:
        """Success rates by group, and causes of failure."""
        return summary_of(self.table, self.file or Path(self.itinerary))

    @property
    def rows(self) -> tuple[Row, ...]:
        """Each run by the names of `COLUMNS`, with the varied numbers."""
        return tuple(self.table.to_pylist())

    @cached_property
    def transitions(self) -> tuple["Transition", ...]:
        """Transitions that were run separately, in order, case by case; none if the whole itinerary was run.

        Their rows have the transition's name as the itinerary. `alone` gives start, end and duration by this name.
        """
        rows: dict[tuple[str, str], list[Row]] = {}
        for row in self.rows if self.alone else ():
            rows.setdefault((row["itinerary"], row["case"]), []).append(row)
        return tuple(
            Transition(
                name,
                *self.alone[name],
                case,
                share_of([row["completed"] for row in runs]),
                max(row["max_cart_position"] for row in runs),
                float(np.mean([row["rms_cart_acceleration"] for row in runs])),
                tuple(dict.fromkeys(row["reason"] for row in runs if not row["completed"])),
            )
            for (name, case), runs in rows.items()
        )

    def frame(self) -> DataFrame:
        """Return a pandas table, one row for each run.

        Raises:
            PartMissing: pandas is not installed.
        """
        return data_frame(self.table.to_pylist())

    def document(self) -> dict[str, Any]:
        """Return the JSON output of `dpcontrol campaign`."""
        columns = [
            *(["itinerary"] if self.transitions else []),
            "seed",
            "symbol",
            "cause",
            "reason",
            "ending",
            "replays",
        ]
        cases = [
            {
                "case": result.case.label,
                **dict(result.case.values),
                **share_document(result.completed),
                "returned": result.returned,
                "failures": result.failed.select(columns).to_pylist(),
            }
            for result in self.results
        ]
        # A single case has the campaign's figures. With several cases, the figures are those of all runs together.
        return {
            "itinerary": self.itinerary,
            **share_document(self.completed),
            "failures": [
                {**failure, "case": case_document["case"]}
                for case_document in cases
                for failure in case_document["failures"]
            ],
            "cases": cases,
            "pairs": [{"first": first, "second": second, **asdict(pair)} for first, second, pair in self.pairs],
            "transitions": self.transitions,
            "standard": [score.document() for score in self.standard],
            "seconds": self.seconds,
            "simulated_seconds": self.simulated_seconds,
            "file": None if self.file is None else str(self.file),
        }


def share_document(share: Share) -> dict[str, Any]:
    """Return counts, rate and interval of a share under the keys of the JSON output.

    Args:
        share: number of runs and of completed ones.
    """
    return document_of(share, _SHARE.replace(",", " "))


def cases_of(itinerary: Itinerary, *, fixed: Mapping[str, Any], over: Mapping[str, Any]) -> tuple[Case, ...]:
    """Return every combination of varied values as a case, whose settings have been checked.

    Names are paths of a run's settings. A value that is not a list counts as a single value.

    Args:
        itinerary: itinerary of all cases.
        fixed: settings of all cases, by path.
        over: values to vary, by path; they have priority over `fixed`.

    Raises:
        InputError: an unknown name, an impossible value or an empty list.
    """
    names = list(over)
    over = {name: values if is_list(values) else [values] for name, values in over.items()}
    count = math.prod(len(values) for values in over.values())
    if not count:
        raise InputError(f"over: {', '.join(name for name, choices in over.items() if not len(choices))} has no values")
    if count > MOST_CASES:
        raise InputError(f"over: {count:,} cases, every combination of the values; at most {MOST_CASES:,} are compared")
    cases = []
    for values in itertools.product(*(zip(choices, _shown(choices), strict=True) for choices in over.values())):
        varied_itinerary = itinerary.with_run(
            {**canonical(fixed), **canonical({name: value for name, (value, _) in zip(names, values, strict=True)})}
        )
        varied_itinerary.check_parts(itinerary)
        shown_values = {name: shown for name, (_, shown) in zip(names, values, strict=True)}
        label = ", ".join(
            f"{key}={number:.12g}" if isinstance(number, float) else f"{key}={number}"
            for key, number in shown_values.items()
        )
        if any(label == case.label for case in cases):
            raise InputError(f"over: {label} is listed twice; list each value once")
        cases.append(Case(label or "as planned", tuple(shown_values.items()), varied_itinerary.loop))
    return tuple(cases)


def _shown(values: Sequence[Any]) -> list[Any]:
    """Return values of a setting as shown in labels and tables, as numbers or texts.

    None is "as planned", a list a text in brackets, and an object, such as a law, the name of its class, with a number
    from the second of a class on.
    """
    names: list[Any] = []
    for choice in values:
        # Numbers of numpy are shown as Python's, and lists as the command line takes them.
        value = "as planned" if choice is None else choice.item() if isinstance(choice, np.generic) else choice
        value = f"[{','.join(map(str, value))}]" if is_list(value) else value
        is_plain = isinstance(value, int | float | str)
        name = value if is_plain else getattr(value, "__name__", type(value).__name__)
        namesakes = 0 if is_plain else sum(str(shown).partition(" ")[0] == name for shown in names)
        names.append(f"{name} {namesakes + 1}" if namesakes else name)
    return names


def transitions_of(plan: Plan) -> tuple[Plan, ...]:
    """Return the transitions of a plan between equilibria, each with the rests before and after it.

    If several connect the same equilibria, only the first is returned. The reference of a transition is the part of the
    plan's from the end of the transfer before it to the begin of the one after it, with times from 0.

    Args:
        plan: plan of an itinerary with holds.

    Raises:
        InputError: the plan has no transition.
    """
    itinerary, reference, content = plan.itinerary, plan.reference, plan.content
    transfer_times = [0.0, *(time for transfer in content.transfers for time in transfer), float(reference.mesh[-1])]
    transitions: list[Plan] = []
    for k, transfer in content.transitions():
        symbol = content.symbols[k]
        name = f"{symbol.source} to {symbol.target}"
        # The times alternate between ends and begins of transfers, so a part includes the holds beside its transfer.
        begin, end = transfer_times[2 * transfer], transfer_times[2 * transfer + 3]
        first, last = np.searchsorted(reference.mesh, (begin - 1e-9, end - 1e-9))
        part_content = replace(
            content,
            itinerary=name,
            title=name,
            wraps=(),
            stops=content.stops[k : k + 2],
            symbols=(replace(symbol, time=symbol.time - begin),),
            transfers=((transfer_times[2 * transfer + 1] - begin, transfer_times[2 * transfer + 2] - begin),),
        )
        part_reference = replace(
            reference,
            mesh=reference.mesh[first : last + 1] - begin,
            states=reference.states[first:last],
            inputs=reference.inputs[first:last],
            plan=part_content,
        )
        transitions.append(Plan(replace(itinerary, name=name, title=name), part_reference, plan.file, cached=True))
    if not transitions:
        raise InputError(f"{itinerary.name} has no transitions: they lead from one equilibrium to another; see twelve")
    return tuple(transitions)


def run_campaign(
    plan: Plan,
    cases: Sequence[Case],
    file: Path | None = None,
    *,
    settings: CampaignSettings,
    transitions: bool = False,
    force: bool = False,
    progress: Progress = no_progress,
    yes: bool = False,
) -> Campaign:
    """Run every case on every seed, write the rows, and return the shares of completed runs.

    If it is interrupted, finished jobs stay in the table, and the next call continues from them.

    Args:
        plan: plan of the itinerary.
        cases: cases to compare.
        file: folder of the table; by default none.
        settings: seeds and processes.
        transitions: run each transfer of an itinerary of holds separately.
        force: replace another campaign there.
        progress: receiver of progress reports.
        yes: accept any duration, default False.

    Raises:
        InputError: the folder cannot be written or holds another campaign, or the settings do not fit the plan.
        GoalMissed: the plan did not converge, or a process died.
    """
    part("pyarrow")
    start = time.perf_counter()
    plans = transitions_of(plan) if transitions else (plan.followed(),)
    announce(_cost(plans, cases, settings), yes=yes)
    if transitions and any(case.loop.supervisor.on_fall != "stop" for case in cases):
        raise InputError("transitions alone end with a fall: leave on_fall at stop, or run the whole itinerary")
    jobs = [job for each_plan in (plans if transitions else (plan,)) for job in _jobs(each_plan, cases, settings)]
    record = campaign_record(plan.itinerary, cases, settings, transitions=transitions)
    if file is not None and not force:
        check_table(file, record)
    # Objects of a script or a notebook cannot be sent to other processes.
    workers = 1 if any(case.loop.own for case in cases) else settings.workers or processors()
    with TemporaryDirectory() as scratch:
        folder = Path(scratch) if file is None else file
        _run_missing(jobs, folder, _schema(cases, record), workers=workers, progress=progress)
        table = campaign_table(folder)
    transition_ends = {
        content.itinerary: (content.symbols[0].source, content.symbols[0].target, float(np.ptp(content.transfers[0])))
        for content in (each_plan.content for each_plan in plans if transitions)
    }
    summary = _summary(plan.itinerary.name, cases, table, seconds=time.perf_counter() - start, file=file)
    return replace(summary, alone=transition_ends)


def _run_missing(jobs: Sequence[Job], folder: Path, schema: "pa.Schema", *, workers: int, progress: Progress) -> None:
    """Run the jobs whose rows are not in the folder, and write the rows of each job to a separate file.

    A file's name is the job's number, in the order of the jobs, and the hash of its inputs (`key`). Files of jobs that
    are in this campaign get their present number, and files of others are removed.

    Args:
        jobs: all jobs of the campaign.
        folder: folder of the table.
        schema: columns of the table.
        workers: number of processes.
        progress: receiver of progress reports.
    """
    files = {job.key: folder / f"{k:06d}-{job.key}.parquet" for k, job in enumerate(jobs)}
    for existing_file in folder.glob("*.parquet"):
        job_file = files.get(existing_file.stem.partition("-")[2])
        if job_file is None:
            existing_file.unlink()
        else:
            existing_file.replace(job_file)
    missing_jobs = [job for job in jobs if not files[job.key].exists()]
    job_of_law = {job.case.loop.controller.kind: job for job in reversed(missing_jobs)}
    # If one of several laws does not fit the plan, no run begins.
    for job in job_of_law.values() if len(job_of_law) > 1 else ():
        _assembled(job)
    job_progress = part_of(progress, 1 - len(missing_jobs) / len(jobs), 1.0)
    for job, rows in in_processes(run_job, missing_jobs, workers, what="jobs", progress=job_progress):
        table, data = pa.Table.from_pylist([{**row, **_numbers(job.case)} for row in rows], schema=schema), io.BytesIO()
        pq.write_table(table, data, compression="zstd", write_page_checksum=True)
        write_whole(files[job.key], data.getvalue())


def check_table(file: Path, record: Mapping[str, Any]) -> None:
    """Reject an existing table unless it is part of the same campaign.

    Args:
        file: folder of the table.
        record: metadata that identify the campaign, see `campaign_record`.

    Raises:
        InTheWay: the folder holds something else, or seeds that this campaign does not run.
    """
    if not file.exists() or (file.is_dir() and not any(file.iterdir())):
        return
    try:
        table = campaign_table(file)
        existing_record = json.loads(table.schema.metadata[METADATA])
        seeds = pc.min_max(table["seed"]).as_py()
    except (InputError, LookupError, TypeError) as error:
        raise in_the_way(file, "is no table of a campaign, or was changed after it was written") from error
    # A table may be continued if its seeds are among those of this campaign, and all decisive entries agree.
    first, is_same_campaign = (
        record["settings"]["first_seed"],
        all(existing_record.get(key) == record.get(key) for key in _DECISIVE),
    )
    if not (is_same_campaign and first <= seeds["min"] and seeds["max"] < first + record["settings"]["runs"]):
        raise in_the_way(file, "holds another campaign, or more runs of this one")


_DECISIVE = ("itinerary", "model", "scene_hash", "model_hash", "path", "cases", "transitions")
"""Entries of a campaign's record that must agree for a table to be continued."""


_PACES = {"compiled": 100.0, "ticks": 5.0}
"""Speed of one process relative to real time, by path, at 1 kHz."""
_ROW_BYTES = 1000.0
"""Memory of a row of the table, bytes."""


def _cost(plans: Sequence[Plan], cases: Sequence[Case], settings: CampaignSettings) -> Cost:
    """Return the estimated time, s, and memory, bytes, of a campaign on this machine; a user must agree to a large one.

    The time is that of all ticks of `plans` and `cases` at the pace of the path, divided among the processes.
    """
    runs = settings.runs * len(cases) * len(plans)
    ticks = settings.runs * sum(case.loop.rate for case in cases) * sum(plan.reference.duration for plan in plans)
    seconds = ticks / 1000 / _PACES[settings.path] / (settings.workers or processors())
    key = f"{runs:,} runs of {len(cases):,} case{'s' if len(cases) > 1 else ''}"
    return Cost(f"{ticks:,.2g} ticks of the loop", seconds, _ROW_BYTES * runs, key)


def _jobs(plan: Plan, cases: Sequence[Case], settings: CampaignSettings) -> list[Job]:
    """Return the jobs of a plan's cases, each with at most `batch` seeds, and as many as fit in a worker's memory.

    A job that runs tick by tick has fewer seeds, so that a killed campaign loses little.
    """
    archive = plan.archive
    seeds = range(settings.first_seed, settings.first_seed + settings.runs)
    # Batches do not depend on the number of runs, so that a longer campaign reuses the jobs of a shorter one.
    name, arms = plan.itinerary.name, plan.itinerary.model.arms
    jobs = []
    for case in cases:
        ticks = max(round(plan.reference.duration * case.loop.rate), 1)
        lockstep = settings.path == "compiled" and case.loop.lockstep
        size = max(min(settings.batch, (MOST_TICKS if lockstep else MOST_TICKS_OF_LOOPS) // ticks), 1)
        uncertainty = plan.itinerary.model.identified_uncertainty if case.loop.model_uncertainty else None
        jobs += [
            Job(name, archive, arms, case, tuple(seeds[k : k + size]), settings.path, uncertainty, settings.replayed)
            for k in range(0, settings.runs, size)
        ]
    return jobs


def _numbers(case: Case) -> dict[str, float]:
    """Return the varied numbers of a case, which become columns of the table; the mismatch has its own column."""
    return {name: float(value) for name, value in case.values if not isinstance(value, str) and name != "mismatch"}


def campaign_record(
    itinerary: Itinerary, cases: Sequence[Case], settings: CampaignSettings, *, transitions: bool = False
) -> dict[str, Any]:
    """Return the metadata that identify a campaign before it starts, so that it can be continued later.

    Args:
        itinerary: itinerary of all cases.
        cases: cases of the campaign.
        settings: number of runs and their distribution.
        transitions: True if each transition is run separately, default False.
    """
    return {
        **({"transitions": True} if transitions else {}),
        "version": VERSION,
        "itinerary": itinerary.name,
        "model": itinerary.model.name,
        "scene_hash": content_hash(itinerary.text),
        "model_hash": content_hash(itinerary.model.text),
        "settings": asdict(settings),
        "path": settings.path,
        "cases": {case.label: json.loads(json.dumps(asdict(case.loop), default=str)) for case in cases},
    }


def _summary(name: str, cases: Sequence[Case], table: "pa.Table", *, seconds: float, file: Path | None) -> Campaign:
    """Return the campaign's result from the rows of all runs: shares by case, and cases compared in pairs.

    Args:
        name: name of the itinerary.
        cases: cases in order.
        table: rows of all runs.
        seconds: duration of the campaign, s.
        file: folder of the table, if it was written.
    """
    # For all K rows of the table, True if the run was completed.
    completed = table["completed"].to_numpy()

    def rows_of_case(case: Case) -> NDArray[np.bool_]:
        """Return True (K,) for the rows of the table that belong to a case, which is recognised by its label."""
        return pc.equal(table["case"], case.label).to_numpy()

    def returned(rows: NDArray[np.bool_]) -> tuple[float, float] | None:
        """Return median and 99 % quantile of the times back to the itinerary in some rows of the table, s.

        `rows` (K,) is True for these rows. The result is None if none of their runs returned to the itinerary.
        """
        times = table["returned"].filter(pa.array(rows)).drop_null().to_numpy()
        return (float(np.median(times)), float(np.quantile(times, 0.99))) if len(times) else None

    results = tuple(
        CaseResult(
            c,
            share_of(completed[rows_of_case(c)]),
            table.filter(pa.array(rows_of_case(c) & ~completed)),
            returned(rows_of_case(c)),
        )
        for c in cases
    )
    pairs = tuple(
        (first.label, second.label, paired(completed[rows_of_case(first)], completed[rows_of_case(second)]))
        for first, second in itertools.combinations(cases if len(cases) <= MOST_PAIRED else (), 2)
    )
    simulated_seconds = sum(table["simulated_seconds"].to_pylist())
    return Campaign(name, share_of(completed), results, pairs, seconds, simulated_seconds, table, file)


def standard_cases(itinerary: Itinerary, *, fixed: Mapping[str, Any], controllers: Sequence[Any]) -> tuple[Case, ...]:
    """Return the cases of the robustness score: every controller with every kind and level of trouble.

    Each kind of `STANDARD` has `LEVELS` levels, values of its setting, and further settings (`besides`). Levels in
    seconds become periods of the loop if the setting counts periods (`in_periods`).

    Args:
        itinerary: itinerary of all cases.
        fixed: settings of all cases, by path.
        controllers: kinds of controllers, or users' laws.

    Raises:
        InputError: an unknown controller.
    """
    cases = []
    for controller, controller_name in zip(controllers, _shown(controllers), strict=True):
        for kind in STANDARD:
            for k in range(LEVELS):
                value = kind.levels[k] * (itinerary.loop.rate if kind.in_periods else 1)
                level = {"controller": controller, kind.setting: value, **dict(kind.besides)}
                with warnings.catch_warnings():
                    # The levels are far beyond usual values.
                    warnings.simplefilter("ignore", Remark)
                    (case,) = cases_of(itinerary, fixed={**canonical(fixed), **canonical(level)}, over={})
                label = f"{controller_name}, {kind.score} {k} of {LEVELS - 1}"
                case_values = (("controller", controller_name), ("kind", kind.score), ("level", float(k)))
                cases.append(Case(label, case_values, case.loop))
    return tuple(cases)


STANDARD_CAMPAIGN = CampaignSettings(runs=8, replayed=0)
"""Settings of the standard score, which needs no confirmed failures."""


@dataclass(frozen=True)
class StandardScore(Documented):
    """Robustness score of one controller.

    Attributes:
        controller: name of the controller.
        kinds: share of completed runs by kind of trouble.
        total: mean of these shares, 0 to 1.
    """

    KEYS: ClassVar[str] = f"controller score=total kinds:{_SHARE}"

    controller: str
    kinds: Mapping[str, Share]
    total: float


def asked_cases(
    itinerary: Itinerary, *, fixed: Mapping[str, Any], over: Mapping[str, Any], standard: bool, transitions: bool
) -> tuple[Case, ...]:
    """Return the cases that a user requests: combinations of values, or those of the robustness score.

    Args:
        itinerary: itinerary of all cases.
        fixed: settings of all cases, by path.
        over: values to vary, by path; only controllers for the standard score.
        standard: True for the standard score.
        transitions: True if each transition is run separately.

    Raises:
        InputError: an unknown name, an impossible value, or a combination that has no meaning.
    """
    if not standard:
        return cases_of(itinerary, fixed=fixed, over=over)
    if transitions:
        raise InputError("transitions: the robustness score needs the whole itinerary; omit standard or transitions")
    if other_names := [name for name in over if name != "controller"]:
        raise InputError(
            f"over {other_names[0]}: the robustness score compares controllers only; omit {other_names[0]}"
        )
    law = itinerary.loop.controller
    planned_controller = law.own.source or law.own.thing if isinstance(law, OwnLaw | OwnExpressions) else law.kind
    controllers = over.get("controller", [fixed.get("controller") or planned_controller])
    return standard_cases(itinerary, fixed=fixed, controllers=controllers)


def standard_scores(results: Sequence[CaseResult]) -> tuple[StandardScore, ...]:
    """Return each controller's robustness score from the results of `standard_cases`.

    The share of a kind of trouble is that of all runs at all levels, and the score is the mean of these shares.

    Args:
        results: results of all cases of `standard_cases`.
    """
    counts: dict[str, dict[str, Counter[str]]] = {}
    for result in results:
        values, share = dict(result.case.values), result.completed
        counts_of_kind = counts.setdefault(str(values["controller"]), {}).setdefault(str(values["kind"]), Counter())
        counts_of_kind.update(successes=share.successes, runs=share.runs)
    shares = {
        name: {kind: wilson(**counts_of_kind) for kind, counts_of_kind in kinds.items()}
        for name, kinds in counts.items()
    }
    return tuple(
        StandardScore(name, kinds, sum(share_of_kind.rate for share_of_kind in kinds.values()) / len(kinds))
        for name, kinds in shares.items()
    )
