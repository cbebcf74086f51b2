"""Run an itinerary: its plan, the closed loop, the log.

A run is determined by itinerary, model and reference, which its log contains, by its recorded settings, and by the
program's version. All random numbers come from the seed. So a run can be repeated from its log alone. On the same
version, every message of the new log has the same bytes, apart from the run's pace in the metadata.

On a bench in real time, over UDP, loop and log are the same, and the deadlines are recorded too. Any bench that
implements `dpcontrol.rig.packets` works. The example bench is the simulated one with a real-time clock.
"""

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from dpcontrol.control.estimator_settings import extra_names
from dpcontrol.control.export import (
    ControllerSource,
    controller_source,
    controller_unit,
)
from dpcontrol.control.interface import Controller
from dpcontrol.control.margins import Margins
from dpcontrol.control.tick import UNROLLED, TickProgram, whole_periods
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.cache import commit
from dpcontrol.foundation.checked import Count, Workers, checked
from dpcontrol.foundation.config import log_folder
from dpcontrol.foundation.document import Documented, document_of
from dpcontrol.foundation.errors import GoalMissed, InputError, remark
from dpcontrol.foundation.files import (
    checked_other_file,
    content_hash,
    in_the_way,
    write_folder,
    write_whole,
)
from dpcontrol.foundation.progress import Progress, Reporting, no_progress
from dpcontrol.foundation.rendering import DataFrame
from dpcontrol.foundation.settings import frozen
from dpcontrol.foundation.shipped import folders
from dpcontrol.foundation.shown import Timed, checked_times
from dpcontrol.foundation.toml import Place, table_of, with_values
from dpcontrol.foundation.version import VERSION
from dpcontrol.judge.decoding import stays
from dpcontrol.judge.score import (
    CONSTANTS_METADATA,
    DRAWN_METADATA,
    HARDEST_METADATA,
    MODEL_METADATA,
    PLANT_METADATA,
    REFERENCE_ATTACHMENT,
    THINKING_METADATA,
    Score,
    arms_in,
    lacking,
    plan_of,
    score,
)
from dpcontrol.logs import (
    Comparison,
    Event,
    Extras,
    LogWriter,
    RunLog,
    check_replaced,
    compare_messages,
    control_fields,
    joint_names,
    read_log,
    slow_numbers,
)
from dpcontrol.logs.layout import state_names
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.controllers import CONTROLLERS, ESTIMATORS, filter_of, law_of
from dpcontrol.loop.loop import ControlLoop, LoopSettings
from dpcontrol.loop.own import OwnLaw, OwnObject, OwnRig
from dpcontrol.loop.result import Ending, Events, LogSink, LoopResult, LoopSink, Sinks, SupervisorSettings, Ticks
from dpcontrol.plans.itinerary import BLOWS, Itinerary, planned_itinerary, setting_of
from dpcontrol.plans.layout import BENCH
from dpcontrol.plans.overrides import canonical, paths
from dpcontrol.plans.plan import Plan, plan_key
from dpcontrol.rig.bench import BenchProcess, BenchRecipe, BenchServerSettings, RecordedRig, checked_faults
from dpcontrol.rig.client import Deadlines, PacketRig, UdpRig, parse_address, real_time_priority, without_collecting
from dpcontrol.rig.commissioning import Commissioning, CommissioningSettings, commission
from dpcontrol.rig.packets import shared_key
from dpcontrol.rig.serial_line import SERIAL, SerialRig, parse_line
from dpcontrol.runs.learning import Learnt, learn
from dpcontrol.runs.remedies import Why, why

_SCENE, _MODEL = "scene.toml", "model.toml"
"""Names of the attachments of a log that hold the texts of itinerary and model."""


def default_log(itinerary: Itinerary) -> Path:
    """Return the log of a run without a given name: NAME-SEED.mcap in the folder of logs.

    Args:
        itinerary: itinerary with the seed of the run.
    """
    return log_folder() / f"{itinerary.name}-{itinerary.loop.seed}.mcap"


@dataclass(frozen=True, eq=False)
class Run(Timed, Documented):
    """A run or a recording of a bench, read from its log.

    See `RunLog` for the arrays.

    Attributes:
        log: log of the run, in memory or of its file.
    """

    log: RunLog

    def __repr__(self) -> str:
        return f"<run {self.log.path}: {self.status}>"

    def score(self) -> Score:
        """Score the run from its log alone.

        Raises:
            InputError: the log carries no plan.
        """
        return self._score

    @cached_property
    def _score(self) -> Score:
        """Score of the run, computed once."""
        return score(self.log)

    @property
    def converged(self) -> bool:
        """True if the itinerary was completed, False if not or unknown."""
        return bool(self._judged and self._judged.completed)

    @property
    def object_failed(self) -> bool:
        """True if a user's object ended the run."""
        return self.log.metadata.get("ending") == Ending.OBJECT_FAILED.value

    @property
    def failure(self) -> str:
        """Reason why the run ended early, or ""."""
        if self.log.metadata.get("ending", Ending.FINISHED.value) == Ending.FINISHED.value:
            return ""
        return next((event.text for event in reversed(self.log.events) if event.level == "error"), self.status)

    @property
    def status(self) -> str:
        """The verdict in one line."""
        return self._judged.sentence if self._judged else f"{len(self.log.time):,} samples, no plan to be judged by"

    @checked
    def why(self, *, workers: Workers = 0, yes: bool = False, progress: Reporting = None) -> Why:
        """Find options of `dpcontrol run` that complete the failed run more often than harmless changes do.

        Args:
            workers: processes, 0 for one per processor.
            yes: accept any duration.
            progress: receiver of progress reports (see `dpcontrol.api`).

        Raises:
            InputError: the log is not of a simulated run, lacks what a repetition needs, or it would take too long.
        """
        plan = _plan(self.log)
        plan_with_options = partial(_with_options, plan, planned_itinerary(plan.content))
        return why(
            self.score(),
            plan_with_options,
            lambda changed: run_plan(changed).score(),
            workers=workers,
            yes=yes,
            progress=progress,
        )

    @checked
    def learn(self, earlier: "Sequence[Run]" = (), *, progress: Reporting = None) -> Learnt:
        """Learn the arms from this run and plan its itinerary again; see `dp.learn`.

        Args:
            earlier: earlier runs on the same rig, in order, from which the arms are learnt as well.
            progress: receiver of progress reports (see `dpcontrol.api`).

        Raises:
            InputError: a log has no estimates of the model's errors, or no plan.
            GoalMissed: there is no plan for the learnt arms.
        """
        return learn([run.log for run in (*earlier, self)], _plan(self.log, repeats=False), progress=progress)

    def margins(self) -> Margins:
        """Return the margins of gain, delay and lag.

        Raises:
            InputError: the log lacks the plan, or its law has no margins.
            GoalMissed: no controller can be made for its reference.
        """
        return assembled(_plan(self.log, repeats=False)).margins()

    @cached_property
    def _judged(self) -> Score | None:
        """Score of the run, or None for a log that lacks what a score needs, such as a recording."""
        return None if lacking(self.log) else self._score

    @property
    def deadlines(self) -> Deadlines | None:
        """Deadlines of a run in real time, None for others."""
        return Deadlines.of(self.log.metadata)

    @property
    def difference(self) -> float | None:
        """Largest difference between the commands of a controlling program and the loop's own, m/s², or None."""
        difference_text = self.log.metadata.get("command_difference")
        return None if difference_text is None else float(difference_text)

    @property
    def missed(self) -> str:
        """Reason for which the run is not known to be completed, or ""."""
        failure = self.failure if "rig" in self.log.metadata or self.object_failed else ""
        run_score = self._score
        return f"{'failed' if run_score.completed else 'not completed'}: {failure}" if failure else run_score.missed

    def document(self) -> dict[str, Any]:
        """Return the JSON output of `dpcontrol run`.

        Raises:
            InputError: the log carries no plan.
        """
        keys = "**_score command_difference?=difference" + " ending=log.metadata.ending deadlines" * bool(
            self.deadlines
        )
        return document_of(self, keys)

    @property
    def plant(self) -> ArmChainParameters | None:
        """The simulated arms as drawn for this run; None for logs of rigs and of early versions.

        Raises:
            InputError: this part of the log is damaged.
        """
        return arms_in(self.log, PLANT_METADATA)

    @property
    def time_range(self) -> tuple[float, float]:
        """First and last time, s."""
        return float(self.log.time[0]), float(self.log.time[-1])

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the N entries of a state."""
        return state_names(len(self.log.arm_lengths), has_cart=self.log.has_cart)

    def states(self, times: Any = None) -> Array:
        """Return the true states of a simulated run, otherwise the estimated ones, interpolated linearly between ticks.

        Args:
            times: times (K,) of the log, s; by default 200 from the first to the last.

        Returns:
            States (K, N). Times outside count as the nearest end.

        Raises:
            InputError: the log has no states, or the times are not finite numbers.
        """
        states = self.log.states.get("truth", self.log.states.get("estimate"))
        if states is None or not len(states):
            raise InputError(f"{self.log.path} has measurements and no states; use frame()")
        if times is None:
            return self.sample()
        return np.stack([np.interp(checked_times(times), self.log.time, column) for column in states.T], axis=-1)

    @checked
    def frame(self, count: Count | None = None) -> DataFrame:
        """Return a pandas table of the run.

        Args:
            count: number of rows of interpolated states; None for one row per tick (see `RunLog.frame`).

        Raises:
            PartMissing: pandas is not installed.
        """
        return self.log.frame() if count is None else super().frame(count)


LiveSink = Callable[[RunLog], AbstractContextManager[LoopSink]]
"""Makes a live view of a run from its log before the first row."""


def assembled(plan: Plan) -> Assembly:
    """Return the parts of a plan's closed loop, which runs, campaigns, margins and export share.

    Args:
        plan: plan of the itinerary.

    Raises:
        InputError: the model's file lacks the uncertainty of a drawn plant.
        GoalMissed: the plan did not converge.
    """
    itinerary = plan.itinerary
    reference = plan.followed().reference
    return Assembly(
        reference, itinerary.model.arms, itinerary.loop, itinerary.uncertainty, stays=stays(reference), cached=True
    )


def run_plan(
    plan: Plan,
    out: Path | None = None,
    *,
    assembly: Assembly | None = None,
    bench: "OwnObject | RigLink | None" = None,
    force: bool = False,
    live: LiveSink | None = None,
    progress: Progress = no_progress,
) -> Run:
    """Run the closed loop of a planned itinerary, write its log if a name is given, and return the run.

    Args:
        plan: plan of the itinerary.
        out: log to write (default none).
        assembly: components shared by many runs.
        bench: a user's rig or the link to a bench in real time (default: the simulated bench).
        force: replace the log of another run.
        live: makes a sink that shows the run.
        progress: receiver of progress reports.

    Raises:
        InputError: the log cannot be written or belongs to another run, the model's file lacks the uncertainty of a
            drawn plant, no bench answers, it needs a key or does not fit the itinerary, or a live view has no display.
        GoalMissed: the plan did not converge, no controller can be made for it, no plant drawn, or the rig failed at
            once.
    """
    plan = plan.followed()
    itinerary, assembly = plan.itinerary, assembly or assembled(plan)
    bench_metadata = bench_record(itinerary, bench)

    # `bench` is None for the simulated bench, a user's rig (`OwnObject`), or the link to a bench in real time.
    def run_loop(sink: LoopSink) -> tuple[Ticks, dict[str, str]]:
        """Run the loop on `bench` with a sink; return its ticks, and ending and deadlines as metadata of the log."""
        if bench is None:
            result = assembly.simulate(sink=sink, progress=progress)
            return result.ticks, outcome(result)
        with assembly.recovery_beside() as recovery:
            loop, deadline_metadata = assembly.loop(sink=sink, recovery=recovery, progress=progress), {}
            if isinstance(bench, OwnObject):
                result = loop.run(OwnRig(bench, arms=itinerary.model.arms.count, period=1 / itinerary.loop.rate))
            else:
                recipe = bench_recipe(plan, assembly)
                with bench.connected(itinerary, recipe, ticks=loop.count, what="the itinerary", loop=loop) as (rig, _):
                    result = loop.run(rig)
                deadline_metadata = rig.deadlines.record()
        if not len(result.ticks.times):
            raise GoalMissed(result.reason)
        return result.ticks, {**outcome(result), **deadline_metadata}

    if out is None:
        events = Events()
        with watched(plan, events, live=live) as sink:
            ticks, ending_metadata = run_loop(sink)
        return Run(_log_in_memory(plan, ticks, events.kept, **bench_metadata, **ending_metadata))
    check_replaced(out, {**run_metadata(itinerary), **bench_metadata}, force=force)
    with log_writer(plan, out, **bench_metadata) as writer, watched(plan, LogSink(writer), live=live) as sink:
        writer.result(**run_loop(sink)[1])
    return Run(read_log(out))


def bench_record(itinerary: Itinerary, bench: "OwnObject | RigLink | None" = None) -> dict[str, str]:
    """Return the metadata of a run that depend on the bench: the rig's name, or the drawn plant of a simulated bench.

    Args:
        itinerary: itinerary with the run's settings.
        bench: a user's rig or the link to one; None for the simulated bench.

    Raises:
        GoalMissed: no plant can be drawn.
    """
    return drawn_metadata(itinerary) if bench is None else {"rig": bench.name}


def run_record(itinerary: Itinerary, bench: "OwnObject | RigLink | None" = None) -> dict[str, str]:
    """Return the metadata that identify a run before it starts, by which a log of the same run is recognised.

    Args:
        itinerary: itinerary with the run's settings.
        bench: a user's rig or the link to one; None for the simulated bench.
    """
    return {**run_metadata(itinerary), **bench_record(itinerary, bench)}


@contextmanager
def watched(plan: Plan, sink: LoopSink, *, live: LiveSink | None) -> Iterator[LoopSink]:
    """Yield the sink of a run, joined with the sink of a live view if one is given.

    Args:
        plan: plan of the run.
        sink: receiver of the ticks and events, such as the writer of the log.
        live: makes a sink that shows the run; None for no view.

    Raises:
        InputError: the live view has no display.
    """
    if live is None:
        yield sink
        return
    no_ticks = Ticks.empty(0, plan.itinerary.model.arms.count, has_truth=True, period=1.0)
    with live(_log_in_memory(plan, no_ticks, ())) as view:
        yield Sinks(sink, view)


def outcome(result: LoopResult) -> dict[str, str]:
    """Return the figures of a finished run as metadata of its log.

    These are the pace, the ending, the computing time of ticks, the hardest drive and the estimated model errors.

    Args:
        result: result of the loop.
    """
    quantiles = np.quantile(result.thinking, [0.5, 0.99]).tolist() if len(result.thinking) else [None, None]
    figures = {
        "real_time_factor": result.real_time_factor,
        HARDEST_METADATA: result.hardest,
        **dict(zip(THINKING_METADATA, quantiles, strict=True)),
    }
    ending = {"ending": result.ending.value}
    if result.constants is not None:
        ending[CONSTANTS_METADATA] = json.dumps(result.constants)
    return ending | {name: repr(value) for name, value in figures.items() if value is not None}


def drawn_metadata(itinerary: Itinerary) -> dict[str, str]:
    """Return the values that are drawn once for a run as metadata of its log, among them the simulated plant.

    Views compare the loop's estimates with them.

    Args:
        itinerary: itinerary with the seed of the run.
    """
    draw = itinerary.loop.draw(itinerary.model.arms, ticks=1, uncertainty=itinerary.uncertainty)
    drawn_values = {"initial_error": draw.initial_error.tolist(), "zeros": draw.zeros.tolist()}
    # A user's own plant is identified by its name in the settings.
    arms = {} if draw.own else {PLANT_METADATA: json.dumps(asdict(draw.plant.arms), sort_keys=True)}
    return {**arms, DRAWN_METADATA: json.dumps(drawn_values)}


def _log_in_memory(plan: Plan, ticks: Ticks, events: Sequence[Event], **more: str) -> RunLog:
    """Return a run as the log that it would have written, for a run without a file or for a live view.

    The name of the run takes the place of a path.

    Args:
        plan: plan of the run.
        ticks: ticks of the run, none for a live view.
        events: events of the run, none for a live view.
        **more: further metadata, text by name.
    """
    itinerary = plan.itinerary
    lengths, limits = itinerary.model.arms.length, itinerary.loop.limits(plan.reference.limits)
    states = {"estimate": ticks.estimates, "reference": ticks.references}
    return RunLog(
        path=Path(f"{itinerary.name}, seed {itinerary.loop.seed}"),
        time=ticks.times,
        measured=ticks.measured,
        rates=None,
        states=states if ticks.truth is None else {**states, "truth": ticks.truth},
        controls=dict(zip(control_fields(len(lengths), has_cart=True), ticks.control.T, strict=True)),
        events=tuple(events),
        metadata={**run_metadata(itinerary), **more},
        attachments=_attachments(plan),
        joint_names=joint_names(len(lengths), has_cart=True),
        arm_lengths=lengths,
        has_cart=True,
        rate_hz=itinerary.loop.rate,
        limits=(limits.position, limits.velocity, limits.acceleration),
        extras=_extras(ticks, extra_names(len(lengths), itinerary.loop.filters.augments)),
    )


def _extras(ticks: Ticks, names: tuple[str, ...]) -> Extras | None:
    """Return the estimates of additional parameters, at the slower rate of a log, or None without such parameters.

    Args:
        ticks: ticks of the run, with the estimates of every tick.
        names: names (E,) of the parameters.
    """
    if ticks.extras is None or not names:
        return None
    # Numbers of the slower rate's intervals, from times in ns; the first tick of each interval is logged.
    slow_ticks = slow_numbers(np.rint(ticks.times * 1e9).astype(np.int64))
    is_logged = np.diff(slow_ticks, prepend=-1) > 0
    sigmas, values = np.split(ticks.extras[is_logged], 2, axis=1)
    return Extras(names, ticks.times[is_logged], values, sigmas)


def log_writer(plan: Plan, out: Path, **more: str) -> LogWriter:
    """Return the writer of a run's log, which contains the plan and the metadata known before the run.

    Args:
        plan: plan of the run.
        out: log to write.
        **more: further metadata, text by name.

    Raises:
        InputError: the log cannot be written.
    """
    itinerary = plan.itinerary
    limits = itinerary.loop.limits(plan.reference.limits)
    return LogWriter(
        out,
        arm_lengths=itinerary.model.arms.length,
        rate_hz=itinerary.loop.rate,
        limits=(limits.position, limits.velocity, limits.acceleration),
        extras=extra_names(itinerary.model.arms.count, itinerary.loop.filters.augments),
        metadata={**run_metadata(itinerary), **more},
        attachments=_attachments(plan),
    )


def _attachments(plan: Plan) -> dict[str, bytes]:
    """Return the files from which the run can be repeated, by their names in the log."""
    return {
        _SCENE: plan.itinerary.text.encode(),
        _MODEL: plan.itinerary.model.text.encode(),
        REFERENCE_ATTACHMENT: plan.archive,
    }


def run_metadata(itinerary: Itinerary) -> Mapping[str, str]:
    """Return the metadata that identify a run: versions, hashes, and all settings with overrides, as JSON.

    Args:
        itinerary: itinerary with the settings of the run.
    """
    return {
        "version": VERSION,
        "commit": commit(),
        "itinerary": itinerary.name,
        "model": itinerary.model.name,
        "seed": str(itinerary.loop.seed),
        "plan": plan_key(itinerary),
        "scene_hash": content_hash(itinerary.text),
        "model_hash": content_hash(itinerary.model.text),
        "run_settings": json.dumps(asdict(itinerary.loop), sort_keys=True, default=str),
        MODEL_METADATA: json.dumps(asdict(itinerary.model.arms), sort_keys=True),
    }


@dataclass(frozen=True)
class Demonstration(Documented):
    """An itinerary that was planned, run, scored and drawn.

    Attributes:
        plan: plan of the itinerary.
        log: path of the log.
        score: score of the run.
        recording: recording for the viewer, None without rerun-sdk.
        picture: path of the page.
        seconds: duration of all steps, s.
    """

    KEYS = "**score recording picture seconds"

    plan: Plan
    log: Path
    score: Score
    recording: Path | None
    picture: Path
    seconds: float

    @property
    def missed(self) -> str:
        """Reason for which the run is not known to be completed, or ""."""
        return self.score.missed


@dataclass(frozen=True)
class Repeat(Documented):
    """Score of a repeated run, compared with the original log.

    Attributes:
        score: score of the repeated run.
        comparison: comparison of its messages with those of the original log.
        versions: remark on another version of the program, or None.
        source: log of the original run.
    """

    KEYS = "**score repeated"

    score: Score
    comparison: Comparison
    versions: str | None
    source: Path

    @property
    def repeated(self) -> dict[str, Any]:
        """The original log, the number of identical messages, and the first difference."""
        comparison = self.comparison
        return {"of": self.source, "identical_messages": comparison.messages, "difference": comparison.difference}

    @property
    def missed(self) -> str:
        """Difference from the original run, reason for an incomplete run, or ""."""
        difference = self.comparison.difference
        if difference is None:
            return self.score.missed
        return f"not the same run: {difference}{f'; {self.versions}' if self.versions else ''}"


def repeated_log(source: Path) -> Path:
    """Return the log of a repetition without a given name: NAME-again.mcap in the folder of logs.

    Args:
        source: log of the original run.
    """
    return log_folder() / f"{source.name.removesuffix('.mcap')}-again.mcap"


def repeat_run(source: Path, out: Path, *, force: bool = False, progress: Progress = no_progress) -> Repeat:
    """Repeat a logged run and compare the two logs message for message.

    Args:
        source: log of the original run.
        out: log to write.
        force: True to replace that file, default False.
        progress: receiver of progress reports.

    Raises:
        InputError: the log cannot be read, lacks what a repetition needs, or `out` is the same file.
        GoalMissed: no controller can be made for its reference.
    """
    log = read_log(source)
    checked_other_file(out, source, what="the log to repeat")
    verdict = run_plan(_plan(log), out, force=force, progress=progress).score()
    log_version, program_version = log.metadata.get("version", "?"), VERSION
    versions = (
        None
        if log_version == program_version
        else f"the log was written by version {log_version}, this is {program_version}"
    )
    return Repeat(verdict, compare_messages(source, out), versions, source)


def _plan(log: RunLog, *, repeats: bool = True) -> Plan:
    """Return the plan of a logged run with its recorded settings, for a repetition, margins or learning.

    With `repeats`, the log must be of a simulated run, since a rig cannot repeat one.

    Raises:
        InputError: the log is of a rig, or lacks the plan or readable settings.
    """
    purpose = "be repeated" if repeats else "have margins"
    if repeats and (log.truth is None or "rig" in log.metadata):
        place = f"the rig at {log.metadata['rig']}" if "rig" in log.metadata else "a rig"
        raise InputError(
            f"{log.path} cannot be repeated: it was made on {place}, and only simulated runs are repeatable; "
            f"`dpcontrol replay` compares it with a model"
        )
    reference = plan_of(log)
    itinerary = _with_settings(planned_itinerary(reference.content), log, cannot=purpose)
    return Plan(itinerary, reference, Path(), cached=True)


def _with_options(plan: Plan, itinerary: Itinerary, change: Mapping[str, Any]) -> Plan:
    """Return the plan of a logged run with options added to its command line, as a user would type them.

    The run's options are the settings that differ from those of the itinerary without options. If these do not explain
    all recorded settings, the options are applied to the recorded settings.

    Args:
        plan: plan of the run with its recorded settings.
        itinerary: its itinerary without options.
        change: options to add, by path.

    Raises:
        InputError: the options are impossible, or do not fit the plan.
    """
    logged_itinerary = plan.itinerary
    pairs = {
        path: (setting_of(itinerary.loop, path), setting_of(logged_itinerary.loop, path))
        for path in paths()
        if path != "plant"
    }
    options = {
        path: logged_value
        for path, (planned_value, logged_value) in pairs.items()
        if logged_value is not None and planned_value != logged_value
    }
    # Another law or filter brings its own defaults.
    dependent_settings = {"controller": ("controller.", "estimator."), "estimator": ("estimator.",)}
    dependent_paths = tuple(
        prefix for role, prefixes in dependent_settings.items() if role in options for prefix in prefixes
    )
    options = (
        {path: logged_value for path, logged_value in options.items() if not path.startswith(dependent_paths)}
        if dependent_paths
        else options
    )
    options_explain_all = itinerary.with_run(options, seed=logged_itinerary.loop.seed).loop == logged_itinerary.loop
    changed_itinerary = (
        itinerary.with_run({**options, **canonical(change)}, seed=logged_itinerary.loop.seed)
        if options_explain_all
        else logged_itinerary.with_run(change)
    )
    changed_itinerary.check_parts(logged_itinerary)
    return replace(plan, itinerary=changed_itinerary)


def _with_settings(itinerary: Itinerary, log: RunLog, *, cannot: str) -> Itinerary:
    """Return the itinerary with the settings that a log has recorded, overrides included.

    `cannot` completes the message about settings that cannot be read.
    """
    try:
        return replace(itinerary, loop=stored_settings(json.loads(log.metadata["run_settings"]), str(log.path)))
    except (InputError, TypeError, ValueError, LookupError) as error:
        version = f"{log.metadata.get('version', '?')} (commit {log.metadata.get('commit') or 'unknown'})"
        message = str(error).partition("\n")[0]
        raise InputError(
            f"{log.path} cannot {cannot}: its run settings, written by version {version}, do not read here: {message}"
        ) from error


def stored_settings(values: Mapping[str, Any], file: str) -> LoopSettings:
    """Return a run's settings from the JSON of a log, with defaults for settings that later versions added.

    Args:
        values: settings as decoded JSON.
        file: name of the log, for messages.

    Raises:
        InputError: an unknown setting or an impossible value.
        LookupError: a user's object, which the log does not hold.
    """
    place, tables = Place(file), {"disturbances": {}, **values}
    kinds_by_name: Any
    # The kind of law or filter decides which settings its table has. `frozen` makes tuples of JSON's lists.
    for name, kinds_by_name in (("controller", CONTROLLERS), ("estimator", ESTIMATORS)):
        kind = tables[name]["kind"]
        if kind not in kinds_by_name:
            raise LookupError(f"{name} = {kind} is a user's object, which is not in the log")
        tables[name] = table_of(kinds_by_name[kind]).read(tables[name], place.within(name))
    tables["disturbances"] = dict(tables["disturbances"])
    blows = tables["disturbances"].pop("explicit", None)
    for name, kind in {**BENCH, "supervisor": SupervisorSettings}.items():
        if name in tables:
            tables[name] = table_of(kind).read(tables[name], place.within(name))
    if tables.get("plant") is not None:
        tables["plant"] = ArmChainParameters(**frozen(tables["plant"]))
    return LoopSettings(**tables).with_(
        {"disturbances.explicit": BLOWS.read(blows, Place(file, "run.blows"))} if blows else {}
    )


def check_exportable(itinerary: Itinerary) -> None:
    """Reject an itinerary whose settings cannot be exported to C, before it is planned.

    Args:
        itinerary: itinerary with the settings of the run.

    Raises:
        InputError: names the setting.
    """
    loop = itinerary.loop
    kind, law_clock, supervisor = loop.controller.kind, getattr(loop.controller, "schedule", "time"), loop.supervisor
    refused_setting = f'schedule = "{law_clock}"' if law_clock != "time" else f'kind = "{kind}"'
    python_law = isinstance(loop.controller, OwnLaw)
    refusals = (
        (
            loop.keeps_by_phase,
            f'run: keep = "{loop.keep}" has an internal clock that C export does not support; export without it',
        ),
        (
            supervisor.hold != "none",
            f'supervisor: hold = "{supervisor.hold}" searches for an orbit to hold, which C export does not support; '
            'export with hold = "none"',
        ),
        (
            supervisor.on_fall != "stop",
            f'supervisor: on_fall = "{supervisor.on_fall}" changes the reference during a run and cannot be exported '
            'to C; export with on_fall = "stop"',
        ),
        (python_law, f"controller = {kind}: Python code cannot be exported to C; use a dp.SymbolicLaw"),
        (
            law_clock != "time" or not (python_law or law_of(loop.controller).symbolic),
            f"controller: {refused_setting} has an internal clock that C export does not support; use "
            '"tvlqr" by time, "adaptive", "feedforward" or "lqr"',
        ),
        (
            (lead := whole_periods(loop.drive.delay)[1]) > UNROLLED,
            f"drive: delay = {lead} periods, but C export predicts at most {UNROLLED} periods ahead; lower the rate, "
            "so that the same delay has fewer periods",
        ),
        (
            not filter_of(loop.estimator).symbolic,
            f'estimator: kind = "{loop.estimator.kind}" cannot be exported to C; use "ekf"',
        ),
    )
    for applies, sentence in refusals:
        if applies:
            raise InputError(sentence)


def export_plan(
    plan: Plan,
    out: Path | None = None,
    *,
    single: bool = False,
    clock: float | None = None,
    force: bool = False,
    progress: Progress = no_progress,
) -> ControllerSource:
    """Return the controller of a planned itinerary as C, and write it if a folder or a unit is given.

    A unit without a binary for this platform causes a remark.

    Args:
        plan: plan of the itinerary.
        out: folder to write, or NAME.fmu for a co-simulation unit.
        single: use single precision.
        clock: clock of a Cortex-M4 that must keep the rate, MHz.
        force: replace files of the same names.
        progress: receiver of progress reports.

    Raises:
        InputError: its law or estimator cannot be exported to C, the target cannot keep the rate, or the folder holds
            something else.
        GoalMissed: the plan did not converge, or no controller can be made for it.
    """
    source, program, controller = _exported(plan, single, progress, clock=clock)
    if out is not None and out.suffix == ".fmu":
        title, delay = plan.itinerary.title, plan.itinerary.loop.drive.delay
        unit = controller_unit(source, program, controller, name=out.stem, title=title, delay=delay)
        if not force and out.exists() and not (out.is_file() and out.read_bytes() == unit.archive):
            raise in_the_way(out, "holds something else")
        write_whole(out, unit.archive)
        if unit.lacks:
            remark(unit.lacks)
    elif out is not None:
        write_folder(out, source.files, force=force)
    return replace(source, place=out)


def _exported(
    plan: Plan, single: bool, progress: Progress, *, clock: float | None
) -> tuple[ControllerSource, TickProgram, Controller]:
    """Return the controller of a plan as C source, the compiled tick that it is made from, and the controller.

    The C source comes with readings and commands of a simulated run, by which a replay checks it on the target. The run
    has no noise on the rates, which a replay cannot know.

    Args:
        plan: plan of the itinerary.
        single: True for single precision.
        progress: receiver of progress reports.
        clock: clock of the target, MHz, None if unknown.
    """
    itinerary, assembly = plan.itinerary, assembled(plan)
    if any(itinerary.zeros):
        remark(
            f"{itinerary.path}: [run] zeros = {list(itinerary.zeros)} is not in the exported program, which uses raw "
            f"readings; set the encoders to zero, or subtract the zeros before a step"
        )
    controller, program, loop = assembly.controller, assembly.ticker().program, itinerary.loop
    noiseless_settings = replace(loop, sensors=replace(loop.sensors, rate_noise=0.0))
    simulated_run = replace(assembly, settings=noiseless_settings, law=controller).simulate(progress=progress)
    names = [f"measured.{name}" for name in joint_names(itinerary.model.arms.count, has_cart=True)]
    # Column 0 of `control` is the command, m/s².
    rows = np.column_stack([simulated_run.ticks.measured, simulated_run.ticks.control[:, 0]]).tolist()
    readings = "".join(f"{','.join(map(repr, row))}\n" for row in rows)
    bare_source = controller_source(
        program, controller, itinerary=itinerary.name, title=itinerary.title, single=single,
        clock=clock, readings=f"{','.join([*names, 'control.command'])}\n{readings}",
    )  # fmt: skip
    source = replace(bare_source, itinerary=itinerary.name, rate=loop.rate, single=single, clock=clock)
    return source, program, controller


OWN_BENCH = "udp"
"""Address of an example bench that is started for the run in a separate process."""
_SPARE = 1.0
"""Time that the example bench can continue after the controller's end, s."""


def bench_recipe(plan: Plan, assembly: Assembly | None = None) -> BenchRecipe:
    """Return the recipe from which another process makes the simulated bench of a planned itinerary.

    Args:
        plan: plan of the itinerary.
        assembly: components of the plan, built if not given.

    Raises:
        InputError: the model's file lacks the uncertainty of a drawn plant.
        GoalMissed: the plan did not converge, or no controller can be made for it.
    """
    itinerary, assembly = plan.itinerary, assembly or assembled(plan)
    loop, controller = itinerary.loop, assembly.controller
    return BenchRecipe(
        itinerary.model.arms, loop, assembly.limits, controller.first_state,
        ticks=controller.ticks + round(_SPARE * loop.rate) + 1, uncertainty=itinerary.uncertainty,
        zeros=itinerary.zeros,
        recovering=0 if assembly.recovery is None else round(_RECOVERING * loop.rate),
    )  # fmt: skip


_RECOVERING = 600.0
"""Time that a bench can run beyond its itinerary if runs continue after falls, s."""
_HANGING = 600.0
"""Running time of a bench with hanging arms, s."""


def hanging_recipe(itinerary: Itinerary, *, faults: Sequence[str] = ()) -> BenchRecipe:
    """Return the recipe of the itinerary's simulated bench with hanging arms, for commissioning without a plan.

    Another process makes the bench from it.

    Args:
        itinerary: arms, cart and settings of the bench.
        faults: wiring mistakes for practice, default none.

    Raises:
        InputError: a fault that these arms cannot have, or a drawn plant without a known uncertainty.
    """
    arms, loop = itinerary.model.arms, itinerary.loop
    return BenchRecipe(
        arms, loop, loop.limits(itinerary.limits), np.zeros(2 * arms.count + 2), ticks=round(_HANGING * loop.rate),
        uncertainty=itinerary.uncertainty, zeros=itinerary.zeros, faults=checked_faults(faults, arms.count),
    )  # fmt: skip


@dataclass(frozen=True)
class RigLink:
    """Connection of a loop to its bench.

    Attributes:
        address: udp://HOST:PORT, serial://PATH?baud=RATE, or `udp` to start an example bench.
        key: key shared with the bench.
        insecure: accept a bench on another computer without a key.
        real_time: request priority from the system.

    Raises:
        InputError: the address is malformed.
    """

    address: str
    key: bytes = b""
    insecure: bool = False
    real_time: bool = False

    def __post_init__(self) -> None:
        """Check the address."""
        if self.address.startswith(SERIAL):
            parse_line(self.address)
        elif self.address != OWN_BENCH:
            parse_address(self.address)

    @property
    def name(self) -> str:
        """Name of the bench in logs: its address."""
        return self.address

    @contextmanager
    def connected(
        self, itinerary: Itinerary, recipe: BenchRecipe, *, ticks: int, what: str, loop: ControlLoop | None = None
    ) -> Iterator[tuple[PacketRig, BenchProcess | None]]:
        """Connect to the bench, check that it fits the itinerary, and yield the rig and the example bench's process.

        The process is None for any other bench. It and the connection end at exit. The bench's welcome gives its number
        of arms, its period and the ticks of its longest run.

        Args:
            itinerary: itinerary of the run.
            recipe: recipe of the example bench for that run.
            ticks: number of ticks for which the rig has time.
            what: name of the motion, for messages.
            loop: loop that is rehearsed first and supplies the commands in flight; None for hanging arms.

        Raises:
            InputError: no bench answers, it needs a key, or it does not fit the itinerary.
        """
        arms, rate, process = itinerary.model.arms.count, itinerary.loop.rate, None
        client_options: dict[str, Any] = {}
        if loop is not None:
            if self.address != OWN_BENCH and itinerary.start == "orbit":
                fastest = np.abs(recipe.start[arms : 2 * arms]).max()
                remark(
                    f'{itinerary.path}: start = "orbit" begins at the orbit\'s exact rates, {fastest:.3g} rad/s, which '
                    'only a simulated bench can; on a rig use an itinerary with start = "rest", such as turn-from-rest'
                )
            loop.ticker.rehearse()
            client_options = {"queued": loop.queued, "zeros": itinerary.zeros}
        with ExitStack() as stack:
            if self.address == OWN_BENCH:
                process = stack.enter_context(BenchProcess(recipe, BenchServerSettings(real_time=self.real_time)))
                client: PacketRig = UdpRig(process.address, key=process.key, **client_options)
            elif self.address.startswith(SERIAL):
                client = SerialRig(self.address, key=self.key, **client_options)
            else:
                client = UdpRig(parse_address(self.address), key=self.key, insecure=self.insecure, **client_options)
            rig = stack.enter_context(client)
            welcome, rig_rate = rig.welcome, 1 / rig.welcome.period
            if welcome.arms != arms:
                raise InputError(f"rig {rig.address} has {welcome.arms} arms, the itinerary's model {arms}")
            if abs(welcome.period * rate - 1) > 1e-6:
                remedy = f"set rate = {rig_rate:g} in [run]" if loop is None else f"run with --rate {rig_rate:g}"
                raise InputError(f"rig {rig.address} ticks at {rig_rate:g} Hz, the loop at {rate:g} Hz; {remedy}")
            if welcome.ticks < ticks:
                advice = "; start the example bench with --hanging" if loop is None else ""
                raise InputError(f"rig {rig.address} can run for {welcome.ticks} ticks, {what} takes {ticks}{advice}")
            stack.enter_context(without_collecting())
            if self.real_time:
                stack.enter_context(real_time_priority())
            yield rig, process


def rig_link(address: str, *, key_file: Path | None = None, insecure: bool = False, real_time: bool = False) -> RigLink:
    """Return the link to a bench.

    Args:
        address: udp://HOST:PORT, serial://PATH?baud=RATE, or `udp` to start an example bench.
        key_file: file with the shared key; None for that of the environment.
        insecure: accept a bench on another computer without a key.
        real_time: request priority from the system.

    Raises:
        InputError: the address is malformed, or the key is not readable.
    """
    link = RigLink(address, insecure=insecure, real_time=real_time)
    return link if address == OWN_BENCH else replace(link, key=shared_key(key_file))


def commission_rig(
    itinerary: Itinerary,
    bench: RigLink | OwnObject | None = None,
    *,
    practice: Itinerary | None = None,
    faults: Sequence[str] = (),
    switches: float = 0.0,
    notify: Callable[[str], None] = lambda text: None,
) -> Commissioning:
    """Check a rig before its first run; see `dpcontrol.rig.commissioning`.

    Args:
        itinerary: itinerary of the rig.
        bench: link to the rig, or the user's rig (default: the example bench in simulated time).
        practice: itinerary with the settings of the example bench (default: `itinerary`).
        faults: wiring mistakes of the example bench, names from `rig.bench.FAULTS`.
        switches: distance to creep to either side until a limit switch responds, m; 0 to skip this.
        notify: receives instructions about the next step.

    Raises:
        InputError: no bench answers, it needs a key or does not fit the itinerary.
    """
    options, rate = CommissioningSettings(), itinerary.loop.rate
    check_rig = partial(
        commission, arms=itinerary.model.arms, settings=itinerary.loop, limits=itinerary.loop.limits(itinerary.limits),
        zeros=itinerary.zeros, switches=switches, options=options, notify=notify,
    )  # fmt: skip
    if isinstance(bench, OwnObject):
        with without_collecting():
            return check_rig(OwnRig(bench, arms=itinerary.model.arms.count, period=1 / rate))
    recipe = hanging_recipe(practice or itinerary, faults=faults)
    if bench is None:
        return check_rig(recipe.rig(()))
    ticks = round((options.seconds + 4 * switches / options.creep) * rate)
    with bench.connected(itinerary, recipe, ticks=ticks, what="commissioning") as (rig, _):
        return check_rig(rig)


def measured_text(itinerary: Itinerary, values: Mapping[str, Any]) -> tuple[Path, str]:
    """Return the file that commissioning writes for an itinerary, and its text with measured values in [run].

    The file is that of the itinerary, or, for a shipped one, a file of its name in the working folder's `itineraries`.

    Args:
        itinerary: itinerary from a TOML file.
        values: values by key of [run].

    Raises:
        InputError: its text cannot be changed.
    """
    if itinerary.stored is not None:
        raise InputError(f"{itinerary.stored} is a plan and is not changed; give the itinerary's .toml")
    text = itinerary.path.read_bytes().decode("utf-8-sig")
    own_folder, shipped = folders("itineraries")
    path = itinerary.path.resolve()
    if path.is_relative_to(shipped.resolve()) and not path.is_relative_to(own_folder.resolve()):
        path = own_folder / path.name
    return path, with_values(text, "run", values)


def written(commissioning: Commissioning, itinerary: Itinerary) -> Commissioning:
    """Write the measured values of a commissioning into [run] of the itinerary, and return it with the file's path.

    If the rig has a fault, there are no values. Then, or if the file cannot be written, the result has the reason in
    `unwritten`.

    Args:
        commissioning: findings on the itinerary's rig, and the measured values as `changes`.
        itinerary: itinerary whose file, or a copy of it, is changed; see `measured_text`.
    """
    if not commissioning.changes:
        return replace(commissioning, unwritten=f"{itinerary.path} is unchanged until the rig has no fault")
    path, text = measured_text(itinerary, commissioning.changes)
    try:
        write_whole(path, text)
    except InputError as error:
        # The measurements are shown nevertheless.
        return replace(commissioning, unwritten=str(error))
    return replace(commissioning, written=path)


PROGRAM_WATCHDOG = 0.03
"""Silence after which the example bench stops a program's cart, s: programs do not stall as Python can."""


def run_with_program(plan: Plan, out: Path, program: Path, *, real_time: bool = False, force: bool = False) -> Run:
    """Run and score a planned itinerary on an example bench, with an external program as the controller.

    The log is written after the run: the loop processes the recorded readings, which gives its estimates and demands.
    The log contains the true states and differs from that of a simulated run by the effects of real time.

    Args:
        plan: plan of the itinerary.
        out: log to write.
        program: program to start.
        real_time: request priority from the system and from the program.
        force: True to replace that file, default False.

    Raises:
        InputError: the program cannot be run or does not fit the itinerary, or the log cannot be written.
        GoalMissed: the plan did not converge, or no controller can be made for it.
    """
    if not (program.is_file() and os.access(program, os.X_OK)):
        raise InputError(f"program = {program}: no such executable program; compile it first")
    check_replaced(out, run_record(plan.itinerary, RigLink(OWN_BENCH)), force=force)
    loop = plan.itinerary.loop
    # A program neither restarts after a fall nor subtracts zeros from its readings.
    loop_that_stops = replace(loop, supervisor=replace(loop.supervisor, on_fall="stop"))
    assembly, settings = assembled(plan), BenchServerSettings(real_time=real_time, watchdog=PROGRAM_WATCHDOG)
    bench_process, deadlines = BenchProcess(replace(bench_recipe(plan, assembly), zeros=()), settings), None
    assembly = assembly.under(loop_that_stops)
    try:
        with bench_process:
            deadlines = bench_process.controlled_by(program, *(["--real-time"] if real_time else []))
    except KeyboardInterrupt:
        if bench_process.record is not None:
            _log_recorded(plan, out, program, assembly, bench_process, deadlines)
        raise
    return _log_recorded(plan, out, program, assembly, bench_process, deadlines)


def _log_recorded(
    plan: Plan, out: Path, program: Path, assembly: Assembly, process: BenchProcess, deadlines: Deadlines | None
) -> Run:
    """Write the log of a run by an external program, from the readings that the example bench has recorded.

    The loop computes its estimates and commands for these readings again, to compare its commands with the program's.

    Args:
        plan: plan of the itinerary.
        out: log to write.
        program: the external program, whose hash the log stores.
        assembly: components of the loop.
        process: the example bench with its record.
        deadlines: deadlines of the program, None if it was interrupted.

    Raises:
        GoalMissed: the bench has no record, or no tick was recorded.
    """
    if process.record is None:
        raise GoalMissed("the example bench did not end its run in order")
    with log_writer(plan, out, **drawn_metadata(plan.itinerary)) as writer:
        loop = assembly.loop(sink=LogSink(writer))
        rig = RecordedRig(process.record, loop.ticker.program)
        result = loop.run(rig)
        if not len(result.ticks.times):
            raise GoalMissed(result.reason)
        # The computing time of this replay is not that of the program.
        result = replace(result, elapsed=float(result.ticks.times[-1]) + rig.period, thinking=np.zeros(0))
        writer.result(
            **outcome(result), rig=f"udp://{process.address[0]}:{process.address[1]}",
            controller_program=content_hash(program.read_bytes()), command_difference=repr(rig.difference),
            **(deadlines.record() if deadlines else {}),
        )  # fmt: skip
    return Run(read_log(out))
