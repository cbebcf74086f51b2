"""The verbs that run the loop: run, export, rig, commission, campaign, preflight.

Their options override a scene's run settings.
"""

import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
from click.core import ParameterSource

from dpcontrol.cli.completion import COMPLETERS
from dpcontrol.cli.review import score_text, shortfall
from dpcontrol.cli.verbs import (
    FILE,
    OUTPUT,
    WORK,
    YES,
    Answer,
    Option,
    Several,
    TextTable,
    argument,
    claim,
    claim_free,
    draw_result,
    file_option,
    force_option,
    option,
    print_message,
    show,
    table,
    verb,
)
from dpcontrol.foundation.config import log_folder
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import checked_target, write_whole
from dpcontrol.foundation.interrupts import forget_interrupts
from dpcontrol.foundation.parts import part
from dpcontrol.foundation.progress import part_of, progress_bar
from dpcontrol.foundation.rendering import live_view
from dpcontrol.plans.overrides import NAMED, option_of, parsed, paths, resolved, typed, values_in

if TYPE_CHECKING:
    from dpcontrol.judge.preflight import Preflight
    from dpcontrol.runs.campaign import Campaign, StandardScore

SETTINGS = "Run settings"


class _SettingOption(Option):
    """The option of one setting; its help comes from the setting's declaration."""

    def __init__(self, path: str) -> None:
        self.path = path
        name = path.rpartition(".")[2]
        super().__init__(
            [option_of(path), name], type=_Text(path), group=SETTINGS, help="", absent="the itinerary's",
            shell_complete=COMPLETERS.get(("", name)),
        )  # fmt: skip

    def get_help_record(self, ctx: click.Context) -> tuple[str, str]:
        """Return the option, and help, unit and choices of its setting."""
        leaf = paths()[self.path]
        kind = {str: "TEXT", int: "INTEGER"}.get(leaf.hint, "FLOAT")
        return f"{self.opts[0]} {kind}", f"{leaf.sentence} [default: the itinerary's]"


class _Text(click.ParamType):
    """The value of a setting."""

    name = "value"

    def __init__(self, path: str) -> None:
        self.path = path

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return parsed(self.path, str(value))


class _Setting(click.ParamType):
    """PATH=VALUE: a setting of the run."""

    name = "path=value"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, Any]:
        name, equals, text = str(value).partition("=")
        if not name.strip() or not equals or not text.strip():
            self.fail(f"{value!r} is not PATH=VALUE, as in drive.lag=0.005", param, ctx)
        return resolved(name), parsed(name, text)


class _Values(_Setting):
    """PATH=V1,V2,…: a setting of the run and its values."""

    name = "path=v1,v2,…"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, list[Any]]:
        name, equals, texts = str(value).partition("=")
        values = values_in(texts)
        if not name.strip() or not equals or not all(text.strip() for text in values):
            self.fail(f"{value!r} is not PATH=VALUE,VALUE,…, as in mismatch=0.05,0.1", param, ctx)
        resolved(name)
        return name.strip().replace("-", "_"), [parsed(name, text) for text in values]


def run_settings() -> Any:
    """Declare run settings and `--set` as one parameter.

    The parameter is a mapping by path of the named settings.
    """
    help = "Any setting by its path, or by the unique last part; repeatable. See `dpcontrol guide settings`."
    each = Option(
        ["--set", "settings"], type=_Setting(), multiple=True, group=SETTINGS, help=help,
        shell_complete=COMPLETERS["", "over"],
    )  # fmt: skip
    return Several([*map(_SettingOption, NAMED), each], _given)


def _given(settings: Sequence[tuple[str, Any]], **named: Any) -> dict[str, Any]:
    """Return the settings that are given, by path.

    The last value of a path counts, so that a remedy can be appended to a command.

    Raises:
        InputError: a setting is given by its option and by its path.
    """
    given = {resolved(name): value for name, value in named.items() if value is not None}
    for path, value in settings:
        if path in given:
            raise InputError(f"--set {path}={value}: {path} is given twice; give it once")
    return given | dict(settings)


BENCH = "Bench"
KEY_HELP = "File with the shared key of bench and loop [the environment's DPCONTROL_RIG_KEY]."
NIGHT = "Long run"
_WITH_FROM = ("source", "out", "force", "as_json")


@verb("run", example="dpcontrol run outer-turn --seed 3 --mismatch 0.05")
def run_command(
    *,
    itinerary: str | None = argument(),
    source: Path | None = option(
        "--from", type=FILE, help="Log to repeat, from its attachments alone. Exit code 1 if a message differs."
    ),
    seed: int = option(default=0, help="Seed of all random numbers."),
    address: str | None = option(
        "--rig",
        metavar="ADDRESS",
        group=BENCH,
        help="Bench for a run in real time: udp://HOST:PORT (see `dpcontrol rig`), or udp to start the example bench. "
        "FILE.py:CLASS is a rig in Python, which runs as fast as it answers. A real bench needs an itinerary with "
        'start = "rest".',
    ),
    program: Path | None = option(
        "--controller-program",
        type=FILE,
        group=BENCH,
        help="With --rig udp: program that controls the run, such as main_udp of `dpcontrol export`.",
    ),
    real_time: bool = option(group=BENCH, help="With --rig: priority over all ordinary processes."),
    key_file: Path | None = option(type=FILE, group=BENCH, help=KEY_HELP),
    insecure: bool = option(group=BENCH, help="With --rig: no key for a bench on another computer."),
    hours: float | None = option(
        group=NIGHT, help="Duration of a long run through falls, h, with the folder logs/NAME-SEED."
    ),
    file_minutes: float = option(default=10.0, group=NIGHT, help="Duration of each log of the folder, min."),
    keep_every: int = option(
        default=1, metavar="N", group=NIGHT, help="Interval of the older logs to keep: each N-th."
    ),
    resume: bool = option(group=NIGHT, help="Continuation of the interrupted run in this folder."),
    settings: dict[str, Any] = run_settings(),
    live: bool = option(group=OUTPUT, help="View of the run while it happens."),
    out: Path | None = file_option(
        suffix=".mcap", help="Log to write [logs/NAME-SEED.mcap]; with --hours the folder of that name without .mcap."
    ),
    force: bool = force_option(),
    yes: bool = YES,
) -> Answer:
    """Run an itinerary in closed loop and write its log.

    The bench is simulated, or is a rig.

    The itinerary is planned first if its plan is not cached. The exit code is 1 if the run is not completed. A rig has
    no true state, so the exit code is 1 if the run ended early, or if by the estimate a symbol was not done. With
    --hours, it repeats the itinerary, seamlessly if its end meets its start, and otherwise from rest. After a fall, the
    arms are calmed and the symbol is repeated, except with another --on-fall.
    """
    if source is not None:
        return _repeat(source, out, force)
    if itinerary is None:
        raise click.UsageError("ITINERARY is missing: give an itinerary, or a log to repeat with --from")
    if address is None and (real_time or key_file or insecure):
        raise click.UsageError("--real-time, --key-file and --insecure apply to runs on a rig: add --rig udp")
    from dpcontrol.loop.own import names_file, own_object

    own = address if address is not None and names_file(address) else None
    if own is not None and (real_time or key_file or insecure or hours is not None):
        raise click.UsageError(
            "--real-time, --key-file, --insecure and --hours apply to benches at udp://: omit them with --rig "
            "FILE.py:CLASS"
        )
    if hours is None and (resume or keep_every != 1 or file_minutes != 10.0):
        raise click.UsageError("--resume, --keep-every and --file-minutes apply to long runs: add --hours")
    if program is not None and (address != "udp" or hours is not None or live):
        raise click.UsageError("--controller-program controls single runs: add --rig udp, and omit --hours and --live")
    if program is not None and not (program.is_file() and os.access(program, os.X_OK)):
        raise InputError(f"--controller-program {program}: no such executable program; compile it first")
    from dpcontrol.logs import check_replaced
    from dpcontrol.pages.picture import LIVE_REMEDY, check_viewer
    from dpcontrol.plans.itinerary import load_itinerary
    from dpcontrol.plans.plan import make_plan
    from dpcontrol.runs.run import default_log, rig_link, run_on_rig, run_plan, run_record, run_with_program

    # Before the plan, which can take minutes.
    if live:
        check_viewer(LIVE_REMEDY)
    shown = live_view if live else None
    address = None if own else address
    link = rig_link(address, key_file=key_file, insecure=insecure, real_time=real_time)
    rig = None if own is None else own_object("rig", own)
    scene = load_itinerary(itinerary).with_run(settings, seed=seed)
    if hours is not None:
        from dpcontrol.runs.night import (
            NightSettings,
            check_folder,
            check_night,
            night_cost,
            night_folder,
            night_itinerary,
            night_plan,
            run_night,
        )

        night = NightSettings(hours, file_minutes, keep_every)
        scene = night_itinerary(scene, given=settings)
        record = run_record(scene, rig=None if link is None else link.address) if resume else {}

        def checked_folder(log: Path) -> Path:
            check_folder(night_folder(log), resume=resume, force=force)
            if resume and out is None:
                check_night(night_folder(log), record)
            return log

        # Before the plan, which can take minutes.
        out = claim_free(default_log(scene), checked_folder) if out is None else checked_folder(claim(out))
        night_cost(scene, night, night_folder(out), real_time=address is not None, yes=yes)
        with progress_bar("night") as progress:
            plan = night_plan(scene, progress=part_of(progress, 0.0, 0.05), yes=yes)
            fly = partial(run_night, plan, out, night, link=link, resume=resume, force=force, live=shown)
            simulated = fly(progress=part_of(progress, 0.05, 1.0)) if link is None else None
        done = simulated or fly()
        return Answer(done.document(), done.lines(), done.failure and f"ended early: {done.failure}")
    if out is None:
        named = None if link is None else link.address
        record = run_record(scene, rig=named if rig is None else rig.name)

        def checked_log(log: Path) -> Path:
            check_replaced(log, record, force=force)
            return log

        out = claim_free(default_log(scene), checked_log)
    else:
        claim(out)
    with progress_bar("run") as progress:
        plan = make_plan(scene, progress=progress, yes=yes)
        if link is None:
            flown = run_plan(plan, out, rig=rig, force=force, live=shown, progress=progress)
            verdict = flown.score()
            failed = flown.failure if rig is not None or flown.object_failed else ""
            return Answer(verdict.document(), score_text(verdict), shortfall(verdict, failed=failed))
    # Without a progress bar, because its thread would take time from the loop.
    if program is not None:
        run = run_with_program(plan, out, program, real_time=real_time, force=force)
    else:
        run = run_on_rig(plan, out, link, force=force, live=shown)
    verdict, result = run.score, run.result
    kept = None if run.deadlines is None else asdict(run.deadlines)
    document = {**verdict.document(), "ending": result.ending.value, "deadlines": kept}
    lines = [*score_text(verdict)]
    if run.deadlines is not None:
        lines.append(f"  {run.deadlines.sentence}")
    if run.difference is not None:
        document["command_difference"] = run.difference
        lines.append(f"  the program's commands differ from the loop's own by {run.difference:.2g} m/s² at most")
    failed = "" if result.finished else result.reason
    return Answer(document, lines, shortfall(verdict, failed=failed))


def _repeat(source: Path, out: Path | None, force: bool) -> Answer:
    """Repeat a run, score it and compare its messages.

    Raises:
        InputError: the log cannot be repeated, or other options contradict it.
    """
    context = click.get_current_context()
    options = {p.name: p for p in context.command.params if p.name not in _WITH_FROM}
    given = [p for name, p in options.items() if context.get_parameter_source(str(name)) is ParameterSource.COMMANDLINE]
    if given:
        names = ", ".join(p.human_readable_name if isinstance(p, click.Argument) else p.opts[0] for p in given)
        raise InputError(f"--from repeats a run without changes: omit {names}")
    from dpcontrol.runs.run import repeat_run, repeated_log

    with progress_bar("run") as progress:
        repeat = partial(repeat_run, source, force=force, progress=progress)
        done = claim_free(repeated_log(source), repeat) if out is None else repeat(claim(out))
    same, verdict = done.comparison, done.score
    repeated = {"of": source, "identical_messages": same.messages, "difference": same.difference}
    lines = [*score_text(verdict), f"  repeats {source}: {same.messages:,} messages are identical"]
    differs = f"not the same run: {same.difference}{f'; {done.versions}' if done.versions else ''}"
    missed = shortfall(verdict) if same.difference is None else differs
    return Answer({**verdict.document(), "repeated": repeated}, lines, missed)


@verb("export", example="dpcontrol export outer-turn --out controller --float")
def export_command(
    *,
    itinerary: str = argument(),
    single: bool = option("--float", help="Single precision."),
    clock: float | None = option(
        type=click.FloatRange(min=1, max=100_000),
        help="Clock of a Cortex-M4, MHz. Rates beyond its speed are rejected.",
    ),
    unit: bool = option("--fmu", help="Co-simulation unit (FMI 2.0) for Simulink, Modelica tools, FMPy."),
    settings: dict[str, Any] = run_settings(),
    out: Path = option(type=click.Path(path_type=Path), group=OUTPUT, help="Folder to write, or NAME.fmu with --fmu."),
    force: bool = option("--force", group=OUTPUT, help="Replacement of existing files with these names."),
    yes: bool = YES,
) -> Answer:
    """Write the controller of an itinerary as C99.

    The C code has estimator, law and supervisor in one call. The itinerary is planned first if its plan is not cached.
    The folder has a Makefile, a replay program and a page on the wiring. Only laws with gains by time can be exported:
    tvlqr, adaptive, lqr, feedforward. Settings of the bench, such as --mismatch, only change the simulated run that
    `make check` replays.
    """
    from dpcontrol.control.export import kibibytes
    from dpcontrol.plans.itinerary import load_itinerary
    from dpcontrol.plans.plan import make_plan
    from dpcontrol.runs.run import check_exportable, export_plan, export_unit

    if unit and out.suffix != ".fmu":
        raise click.UsageError(f"--out {out}: a co-simulation unit needs a name that ends in .fmu")
    if unit and clock is not None:
        raise click.UsageError("--clock applies to C for a target: omit it with --fmu")
    claim(out, folder=not unit)
    scene = load_itinerary(itinerary).with_run(settings)
    check_exportable(scene)
    with progress_bar("export") as progress:
        plan = make_plan(scene, progress=progress, yes=yes)
        if unit:
            source, lacks = export_unit(plan, out, single=single, force=force)
        else:
            source, lacks = export_plan(plan, out, single=single, clock=clock, force=force), ""
    if lacks:
        print_message(lacks)
    figures, rate = source.figures, scene.loop.rate
    document = {
        "unit" if unit else "folder": out, "files": [] if unit else list(source.files), "identity": source.identity,
        "precision": "single" if single else "double", "rate": rate, **figures._asdict(),
    }  # fmt: skip
    halves = f"at {rate / 2:g} Hz half of it" + ("" if single else ", with --float half")
    grows = f", {kibibytes(figures.tables_per_second)} for each second; {halves}"
    lines = [
        f"{out}: controller of {scene.name} in {document['precision']} precision, {rate:g} Hz",
        f"  code    {kibibytes(figures.code)} by gcc -O2 on this computer, {figures.operations:,} operations a tick",
        f"  stack   {kibibytes(figures.stack)}, memory {kibibytes(figures.memory)}",
        f"  tables  {kibibytes(figures.tables)}" + (grows if figures.tables_per_second else " for a run of any length"),
    ]
    if figures.seconds_a_tick is not None:
        took, share = f"{1e3 * figures.seconds_a_tick:.2g} ms", figures.seconds_a_tick * rate
        lines.append(f"  time    some {took} a tick on a Cortex-M4 at {clock:g} MHz, {share:.0%} of a period")
    return Answer(document, lines)


SERVER = "Server"


FAULT_HELP = (
    "Fault of the example bench, for practice: drive-reversed, cart-reversed, encoder-1-reversed, "
    "encoder-2-reversed, encoders-swapped, angles-not-summed, encoder-1-factor-4, zeros-off, switch-dead, "
    "switches-swapped."
)


@verb("rig", example="dpcontrol rig outer-turn --port 47000 --mismatch 0.05")
def rig_command(
    *,
    itinerary: str = argument(),
    seed: int = option(default=0, help="Seed of all random numbers on the bench."),
    host: str = option(default="127.0.0.1", group=SERVER, help="Address of this computer for connections."),
    port: int = option(type=click.IntRange(0, 65535), default=0, group=SERVER, help="Port; 0 selects a free one."),
    runs: int = option(
        type=click.IntRange(0), default=0, group=SERVER, help="Number of runs to serve; 0 means no limit."
    ),
    real_time: bool = option(group=SERVER, help="Priority over all ordinary processes."),
    watchdog: float = option(default=0.1, group=SERVER, help="Silence of the loop until the cart is stopped, s."),
    key_file: Path | None = option(type=FILE, group=SERVER, help=KEY_HELP),
    insecure: bool = option(group=SERVER, help="No key: anyone with access to --host can drive the cart."),
    hanging: bool = option(help="Hanging arms at the start, without a plan, as for `dpcontrol commission`."),
    fault: tuple[str, ...] = option(metavar="NAME", help=FAULT_HELP),
    settings: dict[str, Any] = run_settings(),
    yes: bool = YES,
) -> None:
    """Start an example bench for runs over UDP in real time.

    The bench simulates the arms and cart of the itinerary. It prints its address for `dpcontrol run ITINERARY --rig
    ADDRESS` and serves one run after another until Ctrl-C. The arms start at the beginning of the itinerary. `dpcontrol
    guide packets` describes the packets. If other computers can reach --host, loops need the key of the bench.
    """
    from dpcontrol.plans.itinerary import load_itinerary
    from dpcontrol.rig.bench import BenchServerSettings
    from dpcontrol.runs.example_bench import BenchAddress, example_bench

    server = BenchServerSettings(watchdog=watchdog, real_time=real_time)
    at = BenchAddress(host, port, key_file, insecure, server)
    scene = load_itinerary(itinerary).with_run(settings, seed=seed)

    def report(text: str) -> None:
        print_message(f"dpcontrol: {text}")

    with progress_bar("rig") as progress:
        served = example_bench(scene, at, hanging=hanging, faults=fault, notify=report, yes=yes, progress=progress)
    with served as bench:
        try:
            show(Answer(bench.document(), [f"bench for {scene.name} at {bench.url}"]))
            # A reader behind a pipe waits for the address.
            sys.stdout.flush()
            bench.serve(runs=runs)
        except KeyboardInterrupt:
            forget_interrupts()


@verb("commission", example="dpcontrol commission outer-turn --fault encoder-2-reversed", note="exits with 1")
def commission_command(
    *,
    itinerary: str = argument(),
    address: str | None = option(
        "--rig",
        metavar="ADDRESS",
        group=BENCH,
        help="Rig at udp://HOST:PORT, FILE.py:CLASS of an own rig, or udp for the example bench in a separate process. "
        "[default: the example bench in simulated time]",
    ),
    switches: float | None = option(
        group=BENCH,
        metavar="METRES",
        help="Distance of the search for limit switches to either side, m, short of the hard stops. "
        "[default: no search]",
    ),
    real_time: bool = option(group=BENCH, help="With --rig: priority over all ordinary processes."),
    key_file: Path | None = option(type=FILE, group=BENCH, help=KEY_HELP),
    insecure: bool = option(group=BENCH, help="With --rig: no key for a bench on another computer."),
    seed: int = option(default=0, help="Seed of all random numbers on the example bench."),
    fault: tuple[str, ...] = option(metavar="NAME", help=FAULT_HELP),
    settings: dict[str, Any] = run_settings(),
    write: bool = option(
        group=OUTPUT, help="Update of [run] in ITINERARY with the measured delay, lag, zeros and counts."
    ),
) -> Answer:
    """Measure a rig before its first run: signs, delay, lag, zeros.

    The arms must hang, and the cart must stand at the centre. The cart moves a few millimetres, then follows a chirp
    within 10 mm. The motion of cart and arms gives signs, order, counts and zeros of the encoders, and direction and
    gain of the drive. Ctrl-C brakes the cart. The exit code is 1 if a finding is wrong. Settings and faults apply to
    the example bench. For more, see `dpcontrol guide commission`.
    """
    from dpcontrol.loop.own import names_file
    from dpcontrol.plans.itinerary import load_itinerary
    from dpcontrol.runs.closed_loop import bench_of
    from dpcontrol.runs.run import OWN_BENCH, commission_rig, measured_text, rig_link

    own = address is not None and names_file(address)
    if (address is None or own) and (real_time or key_file or insecure):
        raise click.UsageError("--real-time, --key-file and --insecure apply to benches at udp://: add --rig udp")
    if address not in (None, OWN_BENCH) and (fault or settings):
        raise click.UsageError("--fault and settings of the bench apply to the example bench: omit them with --rig")
    scene = load_itinerary(itinerary)
    if write:
        # Detect a file that cannot be changed before the cart moves.
        measured_text(scene, {"delay": 1.0, "lag": 0.0, "zeros": [0.0], "counts": 1})
    # A user's rig connects to its hardware here.
    link = None if own else rig_link(address, key_file=key_file, insecure=insecure, real_time=real_time)
    found = commission_rig(
        scene, link or bench_of(address), practice=scene.with_run(settings, seed=seed), faults=fault,
        switches=switches or 0.0, notify=lambda text: print_message(f"dpcontrol: {text}"),
    )  # fmt: skip
    lines = [f"commissioning for {scene.name} on {address or 'the example bench, simulated'}"]
    for finding in found.findings:
        lines.append(f"  {finding.verdict:6}  {finding.step}: {finding.sentence}")
        if finding.remedy:
            lines.append(f"          → {finding.remedy}")
    document, left, unwritten = {**found.document(), "written": None}, found.wrong, ""
    if write and found.changes:
        path, text = measured_text(scene, found.changes)
        try:
            write_whole(path, text)
        except InputError as error:
            # The measurements are shown nevertheless.
            unwritten = str(error)
        else:
            document["written"], left = path, found.blocking
            values = ", ".join(f"{key} = {value}" for key, value in found.changes.items())
            lines.append(f"{path}: [run] now has {values}")
    elif write:
        lines.append(f"{scene.path} is unchanged until the rig has no fault")
    if left and not unwritten:
        unwritten = f"{len(left)} of {len(found.findings)} findings must be fixed; first: {left[0].sentence}"
    return Answer(document, lines, unwritten)


WORKERS = option(
    type=click.IntRange(min=0),
    default=0,
    show_default=False,
    group=WORK,
    help="Number of processes [one per processor].",
)
SHOWN = 10
"""Number of failures to print; all of them are in the file."""


@verb("campaign", example="dpcontrol campaign outer-turn --runs 200 --mismatch 0.05 --lag 0.005")
def campaign_command(
    *,
    itinerary: str = argument(),
    runs: int | None = option(type=click.IntRange(min=1), help="Number of seeds per case [100, or 8 with --standard]."),
    seed_from: int = option(type=click.IntRange(min=0), default=0, help="First seed."),
    over: tuple[Any, ...] = option(type=_Values(), help="Vary a setting: one case for each value."),
    standard: bool = option(help="Robustness score: nine kinds of disturbances at 21 levels each."),
    transitions: bool = option(help="Separate runs of each transfer from hold to hold."),
    how: Literal["compiled", "ticks"] = option(
        "--path",
        default="compiled",
        group=WORK,
        help="Method of simulation: many seeds in lockstep, or the loop itself.",
    ),
    workers: int = WORKERS,
    fixed: dict[str, Any] = run_settings(),
    out: Path | None = file_option(suffix=".parquet", help="Table to write [logs/NAME.parquet]."),
    force: bool = force_option(),
    yes: bool = YES,
) -> Answer:
    """Run an itinerary with many seeds and count the completed runs.

    Every case runs the same seeds. An interrupted campaign resumes with the same command. `dpcontrol run --seed` with
    the seed of a failure and the same settings repeats it. --standard applies to every controller of
    `--over controller=…`, or to that of the itinerary.
    """
    from dpcontrol.plans.itinerary import load_itinerary
    from dpcontrol.plans.plan import make_plan
    from dpcontrol.runs.campaign import (
        CampaignSettings,
        campaign_record,
        cases_of,
        check_parts,
        run_campaign,
        standard_cases,
        standard_scores,
    )

    scene = load_itinerary(itinerary)
    settings = CampaignSettings(
        runs=runs or (8 if standard else 100),
        first_seed=seed_from,
        path=how,
        workers=workers,
        # A score needs no list of confirmed failures.
        replayed=0 if standard else CampaignSettings.replayed,
    )
    varied = dict(over)
    if len(varied) != len(over):
        raise InputError("--over: a setting is given twice; list its values once, separated by commas")
    if standard and transitions:
        raise InputError("--transitions: the robustness score needs the whole itinerary; omit --standard")
    if standard:
        controllers = varied.pop("controller", [fixed.get("controller") or scene.loop.controller.kind])
        if varied:
            raise InputError(f"--over {next(iter(varied))}: with --standard only controllers can be varied")
        cases = standard_cases(scene, fixed=fixed, controllers=controllers)
    else:
        cases = cases_of(scene, fixed=fixed, over=varied)
    record = campaign_record(scene, cases, settings, transitions=transitions)

    def checked_table(file: Path) -> Path:
        if not force:
            check_parts(file, record)
        return file

    named = log_folder() / f"{scene.name}{'-transitions' if transitions else ''}.parquet"
    file = claim_free(named, checked_table) if out is None else claim(out)
    # Check for the writer of the table before the plan, which can take minutes.
    part("pyarrow")
    with progress_bar("campaign") as progress:
        plan = make_plan(scene, progress=part_of(progress, 0.0, 0.05), yes=yes)
        rest = part_of(progress, 0.05, 1.0)
        found = run_campaign(
            plan, cases, file, settings=settings, transitions=transitions, force=force, yes=yes, progress=rest
        )
    scores = standard_scores(found.results) if standard else ()
    document = {**found.document(), "standard": [score.document() for score in scores]}
    return Answer(document, _text(found, scores))


def _text(found: "Campaign", scores: Sequence["StandardScore"]) -> Iterator[str | TextTable]:
    if scores:
        rates = {kind: f"{{0.kinds[{kind}].rate:.2f}}" for kind in scores[0].kinds}
        columns = {"controller": "{.controller}", "score": "{.total:.3f}", **rates}
        yield table(f"Robustness of {found.itinerary}", scores, columns)
    else:
        yield table(f"Campaign of {found.itinerary}", found.results, {
            "case": "{0.case.label}",
            "completed": "{0.completed.successes} of {0.completed.runs}",
            "share": lambda r: f"{100 * r.completed.rate:.1f} %",
            "95 % (Wilson)": lambda r: f"{100 * r.completed.low:.1f} … {100 * r.completed.high:.1f} %",
        })  # fmt: skip
        for first, second, pair in found.pairs:
            yield (
                f"  same seeds: only {first!r} completed {pair.only_first}, only {second!r} {pair.only_second} "
                f"(McNemar p = {pair.p_value:.2g})"
            )
        if found.transitions:
            yield table("Each alone", found.transitions, {
                "from": "{.source}", "to": "{.target}", "s": "{.duration:.3g}", "case": "{.case}",
                "completed": "{0.completed.successes} of {0.completed.runs}",
                "cart at most (m)": "{.max_cart_position:.3f}", "rms (m/s²)": "{.rms_cart_acceleration:.2f}",
            })  # fmt: skip
        failures = [row for r in found.results for row in r.failures]
        for failure in failures[:SHOWN]:
            which = f"{failure['itinerary']}, " if found.transitions else ""
            yield f"  {which}seed {failure['seed']}: {failure['reason']}"
        if len(failures) > SHOWN:
            yield f"  … and {len(failures) - SHOWN} more in the file"
    pace = found.simulated_seconds / max(found.seconds, 1e-9)
    took = f"{found.simulated_seconds:.0f} s simulated in {found.seconds:.1f} s"
    yield f"{found.file}  ({took}, {pace:.0f} × real time)"


@verb("preflight", example="dpcontrol preflight turn-from-rest --lag 0.005 --picture preflight.pdf")
def preflight_command(
    *,
    itinerary: str = argument(),
    runs: int = option(
        type=click.IntRange(min=0),
        default=0,
        show_default=False,
        help="Number of seeds for the rate, 16 or more; 0 for as many as two minutes allow [0].",
    ),
    seed_from: int = option(type=click.IntRange(min=0), default=1_000_000, help="First seed."),
    workers: int = WORKERS,
    fixed: dict[str, Any] = run_settings(),
    picture: Path | None = file_option(suffix=(".pdf", ".png"), help="Page to write [logs/NAME-preflight.pdf]."),
    yes: bool = YES,
) -> Answer:
    """Predict whether the first run on a rig completes.

    The arms are drawn from the identified uncertainty of the model, or from a mismatch if the model file has none. The
    bench is that of [run], which `dpcontrol commission --write` fills with measurements. The limit of a disturbance is
    the value at which the itinerary completes half as often. A repeated command resumes after an interruption.
    """
    from dpcontrol.plans.itinerary import load_itinerary
    from dpcontrol.plans.plan import make_plan
    from dpcontrol.runs.preflight import PreflightSettings, preflight

    scene = load_itinerary(itinerary)
    settings = PreflightSettings(runs=runs, first_seed=seed_from, workers=workers)
    scene.with_run(fixed)
    named = log_folder() / f"{scene.name}-preflight.pdf"
    page = claim_free(named, checked_target) if picture is None else claim(picture)
    with progress_bar("preflight") as progress:
        plan = make_plan(scene, progress=part_of(progress, 0.0, 0.05), yes=yes)
        found = preflight(plan, fixed, settings=settings, progress=part_of(progress, 0.05, 1.0), yes=yes)
    draw_result(found, page)
    return Answer({**found.document(), "picture": page}, [*_preflight_text(found), f"page  {page}"])


def _preflight_text(found: "Preflight") -> Iterator[str | TextTable]:
    yield f"{found.itinerary}: {found.status}"
    yield f"  {found.advice}"
    for one in found.notes:
        yield f"  mind: {one}"
    yield table("", found.known, {"known of the bench": "{.name}", "": "{.value}", "from": "{.source}"})
    if found.endings:
        runs = found.share.runs
        yield table("", found.endings[:SHOWN], {
            "what ends it otherwise": "{.cause}", "of all runs": lambda e: f"{e.runs / runs:.1%}",
            "for example seed": "{.seed}",
        })  # fmt: skip
    if found.borders:
        yield table("", found.borders, {
            "half as often at": "{.name}", "set": "{.own}", "border": "{.sentence}",
            "95 %": lambda b: b.interval, "margin": lambda b: "" if b.margin is None else f"{b.margin:.1f} ×",
        })  # fmt: skip
    if helping := [one for one in found.changes if one.gain > 2 * one.error]:
        yield table(
            "",
            helping,
            {
                "what would help": "{.text}",
                "option": lambda c: typed(c.options),
                "gain": lambda c: f"{100 * c.gain:+.1f} ± {200 * c.error:.1f} points",
                "rescued": "{0.rescued} of {0.failing}",
                "lost": "{0.lost} of {0.completing}",
            },
        )
