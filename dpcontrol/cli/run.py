"""dpcontrol run"""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dpcontrol.cli.output import json_option, print_json, progress_bar, reports_failure
from dpcontrol.cli.run_again import repeat
from dpcontrol.cli.run_options import run_options
from dpcontrol.cli.score import print_score
from dpcontrol.foundation.errors import GoalMissed

if TYPE_CHECKING:
    from dpcontrol.scenes.plan import Plan


@click.command("run", epilog="Example:  dpcontrol run outer-turn --seed 3 --mismatch 0.05")
@click.argument("itinerary", required=False)
@click.option(
    "--from",
    "source",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Log to repeat, from its attachments alone; exits with 1 if a message differs.",
)
@click.option("--seed", default=0, show_default=True, help="Of all that is random.")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="Log to write [logs/NAME-SEED.mcap].")
@click.option(
    "--rig",
    "address",
    metavar="ADDRESS",
    help="Run in real time on the bench at udp://HOST:PORT (see "
    "`dpcontrol rig`), or, with udp alone, on one started for the run.",
)
@click.option("--real-time", is_flag=True, help="With --rig: ask the system for priority over all ordinary work.")
@run_options
@json_option
@reports_failure
def command(
    *,
    itinerary: str | None,
    source: Path | None,
    seed: int,
    out: Path | None,
    address: str | None,
    real_time: bool,
    as_json: bool,
    **overrides: Any,
) -> None:
    """Run an itinerary in closed loop on the simulated bench, or on a rig, and write its log.

    Plans first if the plan is not cached. Exits with 1 if the run is not completed; on a rig, where the true state is
    not known, if it ended early or a symbol was not done by the estimate.
    """
    if source is not None:
        repeat(source, out, as_json=as_json)
        return
    if itinerary is None:
        raise click.UsageError("give an ITINERARY, or a log to repeat with --from")
    from dpcontrol.scenes.itinerary import load_itinerary
    from dpcontrol.scenes.levels import run_remarks
    from dpcontrol.scenes.plan import make_plan
    from dpcontrol.scenes.run import default_log, run_plan
    from dpcontrol.scenes.run_options import RunOptions

    if real_time and address is None:
        raise click.UsageError("--real-time is for runs on a rig: give --rig udp as well")
    scene = load_itinerary(itinerary).with_run(RunOptions(**overrides), seed=seed)
    with progress_bar("run") as progress:
        plan = make_plan(scene, progress=progress)
        verdict = None if address else run_plan(plan, out or default_log(scene), progress=progress).score()
    if verdict is None:
        _on_rig(plan, out or default_log(scene), address or "", real_time=real_time, as_json=as_json)
        return
    for remark in run_remarks(scene):
        click.echo(remark, err=True)
    if as_json:
        print_json(verdict.document())
    else:
        print_score(verdict)
    if verdict.completed is False:
        raise GoalMissed(f"not completed: {verdict.reason}")


def _on_rig(plan: "Plan", out: Path, address: str, *, real_time: bool, as_json: bool) -> None:
    """Run on a rig without a progress bar, whose own thread would take time from the loop's."""
    from dpcontrol.scenes.rig_run import run_on_rig

    run = run_on_rig(plan, out, address, real_time=real_time)
    verdict = run.score
    if as_json:
        print_json({**verdict.document(), "ending": run.result.ending.value, "deadlines": asdict(run.deadlines)})
    else:
        print_score(verdict)
        click.echo(f"  {run.deadlines.sentence}")
    if not run.result.finished:
        raise GoalMissed(f"not completed: {run.result.reason}")
    if verdict.symbols_completed < verdict.symbols_total:
        raise GoalMissed(f"not completed: {verdict.reason}")
