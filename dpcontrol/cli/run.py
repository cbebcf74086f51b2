"""dpcontrol run"""

from pathlib import Path

import click

from dpcontrol.cli.output import json_option, print_json, progress_bar, reports_failure
from dpcontrol.cli.score import print_score, score_document
from dpcontrol.foundation.errors import GoalMissed


@click.command("run", epilog="Example:  dpcontrol run outer-turn --seed 3 --mismatch 0.05")
@click.argument("itinerary")
@click.option("--seed", default=0, show_default=True, help="Of the plant's parameters and the initial error.")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="Log to write [logs/NAME-SEED.mcap].")
@click.option("--mismatch", type=float, help="Share by which the plant's parameters may be off.")
@click.option("--initial-error", type=float, help="Largest error of each arm's first angle, rad.")
@click.option("--controller", help="Kind of controller: tvlqr, feedforward.")
@json_option
@reports_failure
def command(
    *,
    itinerary: str,
    seed: int,
    out: Path | None,
    mismatch: float | None,
    initial_error: float | None,
    controller: str | None,
    as_json: bool,
) -> None:
    """Run an itinerary in closed loop on the simulated bench and write its log.

    Plans first if the plan is not cached. Exits with 1 if the run is not completed.
    """
    from dpcontrol.scenes.itinerary import load_itinerary
    from dpcontrol.scenes.plan import make_plan
    from dpcontrol.scenes.run import default_log, run_plan

    scene = load_itinerary(itinerary).with_run(
        seed=seed, mismatch=mismatch, initial_error=initial_error, controller=controller
    )
    with progress_bar("run") as progress:
        plan = make_plan(scene, progress=progress)
        verdict = run_plan(plan, out or default_log(scene), progress=progress)
    if as_json:
        print_json(score_document(verdict))
    else:
        print_score(verdict)
    if verdict.completed is False:
        raise GoalMissed(f"not completed: {verdict.reason}")
