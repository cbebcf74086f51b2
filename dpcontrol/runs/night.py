"""Long runs: an itinerary repeated for hours.

Runs continue through falls and interruptions, into a folder of logs.

If the end of the itinerary meets its start, the next repetition follows at once. Otherwise a flight leads to its start.
After a fall the arms fly back to a stop and the failed symbol is repeated (`dpcontrol.loop.recovery`).

A resumed night keeps its random draws: the same plant, the same encoders with their drift, and the blows and noise that
the uninterrupted night would have had from that time on. Arms and cart start again from rest, as on a bench.

On a bench in real time, over UDP, a thread writes the log because a disk can stall for seconds.
"""

import shutil
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from typing import Annotated

from dpcontrol.control.estimator_settings import extra_names
from dpcontrol.foundation.errors import GoalMissed, InputError, remark
from dpcontrol.foundation.files import InTheWay, checked_target
from dpcontrol.foundation.progress import MOST_SECONDS, Cost, Progress, no_progress, size_text
from dpcontrol.foundation.settings import Setting, Settings
from dpcontrol.judge.night import Night, read_night
from dpcontrol.judge.score import CONSTANTS_METADATA
from dpcontrol.logs import LogWriter, check_replaced, partials_of, read_log, recover
from dpcontrol.logs.reader import check_same_run
from dpcontrol.logs.rolling import NIGHT_METADATA, RollingLog
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.own import OwnObject
from dpcontrol.loop.result import LogSink, SinkBeside
from dpcontrol.plans.itinerary import Itinerary
from dpcontrol.plans.overrides import canonical
from dpcontrol.plans.plan import Plan, expected_seconds
from dpcontrol.runs.run import (
    OWN_BENCH,
    LiveSink,
    RigLink,
    Run,
    assembled,
    bench_recipe,
    bench_record,
    log_writer,
    outcome,
    run_metadata,
    run_record,
    watched,
)

_BYTES_A_TICK = 430
"""Bytes per tick of a compressed log of two arms on a cart."""
_SPEED = 12_000
"""Ticks in a second of simulation, logging included, on one core."""
_MEMORY, _MEMORY_A_TICK, _MEMORY_A_STOP = 3.5e8, 3900, 210
"""Memory of a night of any length, bytes, and bytes for each tick of its itinerary: gains and latest rows.

Each stop takes as many again.
"""
MOST_DISK = 2e10
"""Bytes of logs above which a night needs confirmation."""
_SPARE_DISK = 1e9
"""Bytes of disk that must stay free."""


@dataclass(frozen=True)
class NightSettings(Settings, table="night"):
    """Duration and logs of a long run.

    Attributes:
        hours: duration, h.
        file_minutes: length of each log, min.
        keep_every: share of older logs to keep, one in so many.
    """

    hours: Annotated[float, Setting(above=0, most=10_000, unit="h")]
    file_minutes: Annotated[float, Setting(least=0.01, most=1440, unit="min")] = 10.0
    keep_every: Annotated[int, Setting(least=1, most=1_000_000)] = 1

    @property
    def files(self) -> int:
        """Number of logs, including thinned ones."""
        return ceil(60 * self.hours / self.file_minutes - 1e-9)

    def disk(self, rate: float) -> float:
        """Return the expected size of the logs that stay on the disk, bytes.

        Args:
            rate: rate of the loop, Hz.
        """
        file_size = min(self.file_minutes * 60, self.hours * 3600) * rate * _BYTES_A_TICK
        # The current log and the one before it are not thinned.
        return file_size * min(self.files, ceil(self.files / self.keep_every) + 2)


def night_folder(out: Path) -> Path:
    """Return the folder of a long run, whose name is that of a single run's log without its extension.

    Args:
        out: log that a single run would write.
    """
    return out.with_suffix("") if out.suffix == ".mcap" else out


def night_itinerary(itinerary: Itinerary, *, overrides: Mapping[str, object]) -> Itinerary:
    """Return an itinerary with the defaults of long runs, which continue after every fall.

    Settings in `overrides` replace these defaults. A keeper of stops with internal timing is replaced by gains by time.

    Args:
        itinerary: itinerary of a single run.
        overrides: settings by path that override the defaults.
    """
    overrides = canonical(overrides)
    loop, keep = itinerary.loop, itinerary.loop.keep
    supervisor = loop.supervisor
    if supervisor.on_fall == "stop" and "supervisor.on_fall" not in overrides:
        supervisor = replace(supervisor, on_fall="resume")
    if "supervisor.attempts" not in overrides:
        supervisor = replace(supervisor, attempts=0)
    if loop.keeps_by_phase and supervisor.on_fall != "stop" and "controller.keep" not in overrides:
        remark(
            f'{itinerary.path}: [controller] keep = "{keep}" has internal timing and cannot resume after a fall; '
            "this long run keeps its stops with gains by time, as with --set keep=none"
        )
        keep = "none"
    return replace(itinerary, loop=replace(loop, supervisor=supervisor, keep=keep))


def night_cost(
    itinerary: Itinerary,
    night: NightSettings,
    folder: Path,
    *,
    real_time: bool = False,
    yes: bool = False,
) -> str:
    """Return the cost of a long run in a sentence, after a check that the disk and the user allow it.

    Args:
        itinerary: itinerary of the night.
        night: duration and logs.
        folder: folder of the logs.
        real_time: True on a rig.
        yes: accept a cost beyond the limits.

    Raises:
        InputError: the cost is beyond the limits, or the disk is too full.
    """
    rate = itinerary.loop.rate
    disk, seconds = night.disk(rate), night.hours * 3600 * (1.0 if real_time else rate / _SPEED)
    stops = len(itinerary.walk) + len(itinerary.parts)
    memory = _MEMORY + expected_seconds(itinerary) * rate * (_MEMORY_A_TICK + _MEMORY_A_STOP * stops)
    cost = Cost(f"{night.hours:g} h of {itinerary.name}", seconds, memory, f"--hours {night.hours:g}")
    files = f"{night.files:,} file{'s' if night.files > 1 else ''} of {night.file_minutes:g} minutes"
    thinned = f", of which one in {night.keep_every} is kept" if night.keep_every > 1 else ""
    text = f"{cost.sentence}, and {size_text(disk)} of disk in {folder}: {files}{thinned}"
    existing_folder = next(parent for parent in (folder.absolute(), *folder.absolute().parents) if parent.exists())
    free_bytes = shutil.disk_usage(existing_folder).free
    if disk + _SPARE_DISK > free_bytes:
        raise InputError(
            f"{text}; {size_text(free_bytes)} are free there: thin the logs with --keep-every, or give another --out"
        )
    if not yes and (disk > MOST_DISK or (seconds > MOST_SECONDS and not real_time)):
        raise InputError(
            f"{text}; an hour and {size_text(MOST_DISK)} are begun unasked: thin the logs with --keep-every, ask for "
            "less, or give --yes (yes=True in Python)"
        )
    return text


@dataclass(frozen=True)
class _Resumption:
    """Start of a night or of its next session.

    Attributes:
        session: number of the session, from 1.
        number: number of its first file, from 1.
        begin: time of the night at which it begins, s.
    """

    session: int = 1
    number: int = 1
    begin: float = 0.0


def run_night(
    plan: Plan,
    out: Path,
    night: NightSettings,
    *,
    link: RigLink | None = None,
    resume: bool = False,
    force: bool = False,
    live: LiveSink | None = None,
    yes: bool = False,
    learn: bool = False,
    progress: Progress = no_progress,
) -> Night:
    """Repeat a planned itinerary for hours.

    The logs are in the folder of `out`. With `learn`, the first repetition is a separate session, and the others
    follow the plan that is learnt from it. A second learning would gain nothing.

    Args:
        plan: plan of an itinerary of `night_itinerary`.
        out: log that a single run would write.
        night: duration and logs.
        link: link to a bench in real time (default: the simulated bench).
        resume: continue the interrupted night of that folder.
        force: replace the night of that folder.
        live: makes a sink that shows the run.
        yes: accept a cost beyond the limits.
        learn: learn the arms from the first repetition, or from that of the night to resume.
        progress: receiver of progress reports.

    Raises:
        InputError: the folder is not writable, holds another night or none to resume, the cost is beyond the limits, or
            no bench fits.
        GoalMissed: the plan did not converge, no controller can be made for it, or no plant drawn.
    """
    folder = night_folder(out)
    if learn:
        if not resume:
            first_lap = replace(night, hours=min(plan.followed().reference.duration / 3600, night.hours / 2))
            run_night(plan, out, first_lap, link=link, force=force, live=live, yes=yes, progress=progress)
        plan = _learnt_plan(folder, plan.itinerary, simulated=link is None or link.address == OWN_BENCH)
        resume = True
    itinerary = plan.followed().itinerary
    settings, arms = itinerary.loop, itinerary.model.arms
    bench_metadata = bench_record(itinerary, link)
    record = {} if learn else {**run_metadata(itinerary), **bench_metadata}
    check_folder(folder, record, resume=resume, force=force)
    remark(night_cost(itinerary, night, folder, real_time=link is not None, yes=yes))
    resumption = _place(folder, record, night, settings.rate, resume=resume, force=force)
    since, until = round(resumption.begin * settings.rate), round(night.hours * 3600 * settings.rate)
    assembly = assembled(plan)
    recovery = assembly.recovery
    if recovery is None:
        raise InputError(
            f'{itinerary.path}: [supervisor] on_fall = "stop": a long run repeats its itinerary, by flights if needed; '
            f'use on_fall = "resume" or "restart"'
        )

    def new_log(path: Path, more: Mapping[str, str]) -> LogWriter:
        """Return the writer of the night's next file."""
        return log_writer(plan, path, **bench_metadata, **more)

    rolling = RollingLog(
        folder, folder.resolve().name, new_log, seconds=60 * night.file_minutes, rate_hz=settings.rate,
        limit=assembly.limits.position, extras=extra_names(arms.count, settings.filters.augments),
        keep_every=night.keep_every, session=resumption.session, number=resumption.number, begin=resumption.begin,
        end=night.hours * 3600,
    )  # fmt: skip
    with rolling:
        try:
            if link is None:
                simulated = assembly.under(_since(settings, resumption.begin))
                with watched(plan, LogSink(rolling), live=live) as sink:
                    result = simulated.simulate(
                        draw=assembly.draw().endless(since=since), sink=sink, recovery=recovery, until=until - since,
                        keep=False, progress=progress,
                    )  # fmt: skip
                # A night is judged by its digests, which do not hold the drive's hardest acceleration.
                rolling.result(**outcome(replace(result, hardest=None)))
            else:
                ticks = until - since + round(_BRAKING * settings.rate)
                recipe = replace(bench_recipe(plan, assembly), recovering=ticks)
                with (
                    assembly.recovery_beside() as recovery,
                    _switching_soon(),
                    SinkBeside(LogSink(rolling)) as log,
                    watched(plan, log, live=live) as sink,
                ):
                    on_rig = assembly.loop(
                        sink=sink, recovery=recovery, until=until - since, keep=False, progress=progress
                    )
                    with link.connected(itinerary, recipe, ticks=ticks, what="the night", loop=on_rig) as (rig, _):
                        result = on_rig.run(rig)
                if not rig.deadlines.ticks:
                    raise GoalMissed(result.reason)
                rolling.result(**outcome(result), **rig.deadlines.record())
        except KeyboardInterrupt:
            remark(f"{folder} ends here; continue it by the same command with --resume")
            raise
    return read_night(folder)


def _learnt_plan(folder: Path, itinerary: Itinerary, *, simulated: bool) -> Plan:
    """Return the plan that is learnt from the last session of a night that ended in order.

    A simulated plant stays that of the itinerary, which is drawn from its own model, and not from the learnt one.

    Args:
        folder: folder of the night.
        itinerary: itinerary of the night.
        simulated: True for a simulated bench.

    Raises:
        InputError: no session of the night ended in order.
    """
    logs = map(read_log, sorted(folder.glob("*.mcap"), reverse=True))
    log = next((log for log in logs if CONSTANTS_METADATA in log.metadata), None)
    if log is None:
        raise InputError(f"{folder}: no session of this night ended in order; omit --learn")
    learnt = Run(log).learn()
    remark(
        f"learnt from {log.path}; effort of the feedback: {learnt.effort_before:.3f} m/s² rms before, "
        f"{learnt.effort_expected:.3f} expected"
    )
    draw = itinerary.loop.draw(itinerary.model.arms, ticks=1, uncertainty=itinerary.uncertainty)
    plant_settings = {"plant": draw.plant.arms, "mismatch": 0.0, "friction": 1.0, "model_uncertainty": 0.0}
    loop = learnt.plan.itinerary.loop.with_(plant_settings if simulated and not draw.own else {})
    return replace(learnt.plan, itinerary=replace(learnt.plan.itinerary, loop=loop))


_BRAKING = 2.0
"""Time that a bench must run beyond the end of a night, for braking the cart, s."""


@contextmanager
def _switching_soon() -> Iterator[None]:
    """Limit the loop's wait for the interpreter to 0.1 ms while a thread writes the log.

    Otherwise the thread could hold the interpreter for several periods of the loop.
    """
    former_interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-4)
    try:
        yield
    finally:
        sys.setswitchinterval(former_interval)


def name_check(
    itinerary: Itinerary,
    bench: RigLink | OwnObject | None,
    night: NightSettings | None,
    *,
    resume: bool,
    free: bool,
    force: bool,
    yes: bool,
) -> Callable[[Path], None]:
    """Return a function that checks the name of a run's log or folder, which is called before planning.

    The function gets the path of the log, and raises an `InputError` if the run cannot be written there.

    Args:
        itinerary: itinerary of the run.
        bench: rig of the run, None for the simulated bench.
        night: settings of a long run, None for a single one.
        resume: True to continue the long run there.
        free: True if free names are tried.
        force: True to replace an existing log or long run.
        yes: accept a cost beyond the limits.
    """
    record = run_record(itinerary, bench)

    def check(file: Path) -> None:
        """Check the name of a log, or of the folder that a long run derives from it, and the cost of the long run."""
        if night is None:
            check_replaced(checked_target(file), record, force=force)
            return
        check_folder(night_folder(file), record if free else {}, resume=resume, force=force)
        night_cost(itinerary, night, night_folder(file), real_time=bench is not None, yes=yes)

    return check


def check_folder(folder: Path, record: Mapping[str, str], *, resume: bool, force: bool) -> list[Path]:
    """Return the files of the long run in a folder, or refuse a folder that cannot be used.

    The check comes before planning, which takes long.

    Args:
        folder: folder of the logs.
        record: metadata that identify the run to resume, or none if the folder was named.
        resume: True to continue the long run there.
        force: True to replace it.

    Raises:
        InTheWay: a long run is there that is neither resumed nor replaced, or another one to resume.
        InputError: there is none to resume, or its last log is unreadable.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is not a folder; a long run writes a folder: choose another --out")
    name = folder.resolve().name
    existing_files = [file for file in folder.glob(f"{name}-[0-9]*") if file.suffix in (".mcap", ".json", ".partial")]
    if existing_files and not resume and not force:
        raise InTheWay(
            f"{folder} already holds a long run; continue it with --resume, choose another --out, or replace it "
            "with --force"
        )
    if resume and not existing_files:
        raise InputError(f"{folder} holds no long run to resume; omit --resume to begin one")
    for log in sorted(folder.glob(f"{name}-[0-9]*.mcap"))[-1:] if resume and record else ():
        check_same_run(log, record, also=(NIGHT_METADATA,))
    return existing_files


def _since(settings: LoopSettings, begin: float) -> LoopSettings:
    """Return the settings of a bench that resumes after `begin` s of a night, with times of a stuck sensor from there.

    A fault that was over by then does not occur again: the sensor is stuck at an infinite time.
    """
    sensors = settings.sensors
    first, end = max(sensors.stuck_at - begin, 0.0), sensors.stuck_at + sensors.stuck_for - begin
    stuck_sensor = (
        {"stuck_at": first, "stuck_for": end - first}
        if first < float("inf") and end > 0
        else {"stuck_at": float("inf")}
    )
    return replace(settings, sensors=replace(sensors, **stuck_sensor))


def _place(
    folder: Path, metadata: Mapping[str, str], night: NightSettings, rate: float, *, resume: bool, force: bool
) -> _Resumption:
    """Return the start of the next session, after closing the logs of an interrupted one.

    Without `resume`, the folder is emptied for a new night.

    Args:
        folder: folder of the night.
        metadata: metadata that identify the night.
        night: duration and logs.
        rate: rate of the loop, Hz.
        resume: continue the night of the folder.
        force: replace the night of the folder.

    Raises:
        InputError: the folder holds another, a complete or no night, or one that must not be resumed.
    """
    name = folder.resolve().name
    existing_files = check_folder(folder, metadata, resume=resume, force=force)
    if not resume:
        for file in existing_files:
            file.unlink()
        return _Resumption()
    for partial_log in partials_of(folder / name):
        log = folder / f"{partial_log.name.partition('.mcap')[0]}.mcap"
        if not log.exists():
            try:
                recover(partial_log, log)
            except InputError as error:
                # A session that ended before its first tick left no log to recover.
                remark(f"{error}; the night continues without it")
    last_digest = read_night(folder).digests[-1]
    if last_digest.end >= night.hours * 3600 - 1 / rate:
        raise InputError(
            f"{folder} is complete: {last_digest.end / 3600:.4g} of {night.hours:g} hours; raise --hours to continue"
        )
    # Names of files are NAME-NUMBER followed by their extensions.
    number = max(int(file.name[len(name) + 1 :].partition(".")[0]) for file in existing_files)
    return _Resumption(last_digest.session + 1, number + 1, ceil(last_digest.end * rate - 1e-6) / rate)
