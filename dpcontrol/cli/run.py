"""dpcontrol run"""

from pathlib import Path
from typing import Any

import click

from dpcontrol.cli.output import json_option, print_json, progress_bar, reports_failure
from dpcontrol.cli.run_again import repeat
from dpcontrol.cli.run_options import run_options
from dpcontrol.cli.score import print_score, score_document
from dpcontrol.foundation.errors import GoalMissed


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
@run_options
@json_option
@reports_failure
def command(
    *,
    itinerary: str | None,
    source: Path | None,
    seed: int,
    out: Path | None,
    as_json: bool,
    **overrides: Any,
) -> None:
    """Run an itinerary in closed loop on the simulated bench and write its log.

    Plans first if the plan is not cached. Exits with 1 if the run is not completed.
    """
    if source is not None:
        repeat(source, out, as_json=as_json)
        return
    if itinerary is None:
        raise click.UsageError("give an ITINERARY, or a log to repeat with --from")
    from dpcontrol.scenes.itinerary import load_itinerary
    from dpcontrol.scenes.plan import make_plan
    from dpcontrol.scenes.run import default_log, run_plan

    scene = load_itinerary(itinerary).with_run(seed=seed, **overrides)
    with progress_bar("run") as progress:
        plan = make_plan(scene, progress=progress)
        verdict = run_plan(plan, out or default_log(scene), progress=progress)
    if as_json:
        print_json(score_document(verdict))
    else:
        print_score(verdict)
    if verdict.completed is False:
        raise GoalMissed(f"not completed: {verdict.reason}")
