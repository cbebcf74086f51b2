"""dpcontrol run"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from dpcontrol.cli.run_options import run_options
from dpcontrol.cli.score import score_text, shortfall
from dpcontrol.cli.verbs import Answer, file_option, option, verb
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import progress_bar

BENCH = "Bench"
_WITH_FROM = ("source", "out", "as_json")


@verb("run", example="dpcontrol run outer-turn --seed 3 --mismatch 0.05")
@click.argument("itinerary", required=False)
@click.option(
    "--from",
    "source",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Log to repeat, from its attachments alone; exits with 1 if a message differs.",
)
@click.option("--seed", default=0, show_default=True, help="Seed of all that is random.")
@option(
    "--rig",
    "address",
    metavar="ADDRESS",
    group=BENCH,
    help="Run in real time on the bench at udp://HOST:PORT (see `dpcontrol rig`), or, with udp alone, on one started "
    "for the run.",
)
@option("--real-time", is_flag=True, group=BENCH, help="With --rig: ask for priority over all ordinary work.")
@run_options
@file_option("--out", help="Log to write [logs/NAME-SEED.mcap].")
def command(
    *,
    itinerary: str | None,
    source: Path | None,
    seed: int,
    address: str | None,
    real_time: bool,
    out: Path | None,
    **overrides: Any,
) -> Answer:
    """Run an itinerary in closed loop on the simulated bench, or on a rig, and write its log.

    Plans first if the plan is not cached. Exits with 1 if the run is not completed; on a rig, where the true state is
    not known, if it ended early or a symbol was not done by the estimate.
    """
    if source is not None:
        return _repeat(source, out)
    if itinerary is None:
        raise click.UsageError("give an ITINERARY, or a log to repeat with --from")
    if real_time and address is None:
        raise click.UsageError("--real-time is for runs on a rig: give --rig udp as well")
    from dpcontrol.scenes.itinerary import load_itinerary
    from dpcontrol.scenes.levels import run_remarks
    from dpcontrol.scenes.plan import make_plan
    from dpcontrol.scenes.run import default_log, run_plan
    from dpcontrol.scenes.run_options import RunOptions

    scene = load_itinerary(itinerary).with_run(RunOptions(**overrides), seed=seed)
    out = out or default_log(scene)
    with progress_bar("run") as progress:
        plan = make_plan(scene, progress=progress)
        verdict = None if address else run_plan(plan, out, progress=progress).score()
    if verdict is not None:
        for remark in run_remarks(scene):
            click.echo(remark, err=True)
        return Answer(verdict.document(), score_text(verdict), shortfall(verdict))
    # Without a progress bar, whose own thread would take time from the loop's.
    from dpcontrol.scenes.rig_run import run_on_rig

    run = run_on_rig(plan, out, address or "", real_time=real_time)
    verdict, result = run.score, run.result
    document = {**verdict.document(), "ending": result.ending.value, "deadlines": asdict(run.deadlines)}
    done = verdict.symbols_completed == verdict.symbols_total
    reason = "" if result.finished and done else verdict.reason if result.finished else result.reason
    lines = [*score_text(verdict), f"  {run.deadlines.sentence}"]
    return Answer(document, lines, reason and f"not completed: {reason}")


def _repeat(source: Path, out: Path | None) -> Answer:
    """Repeat a run, score it and compare its messages.

    Raises:
        InputError: the log cannot be repeated, or other options ask for another run.
    """
    context = click.get_current_context()
    asked = {p.name: p for p in context.command.params if p.name not in _WITH_FROM}
    given = [p for name, p in asked.items() if context.get_parameter_source(str(name)) is ParameterSource.COMMANDLINE]
    if given:
        names = ", ".join(p.human_readable_name if isinstance(p, click.Argument) else p.opts[0] for p in given)
        raise InputError(f"--from repeats a run as it was: leave out {names}")
    from dpcontrol.scenes.run import repeat_run, repeated_log

    with progress_bar("run") as progress:
        done = repeat_run(source, out or repeated_log(source), progress=progress)
    same, verdict = done.comparison, done.score
    repeated = {"of": str(source), "identical_messages": same.messages, "difference": same.difference}
    lines = [*score_text(verdict), f"  repeats {source}: {same.messages:,} messages are identical"]
    differs = f"not the same run: {same.difference}{f'; {done.versions}' if done.versions else ''}"
    missed = shortfall(verdict) if same.difference is None else differs
    return Answer({**verdict.document(), "repeated": repeated}, lines, missed)
