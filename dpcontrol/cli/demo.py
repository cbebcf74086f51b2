"""dpcontrol demo"""

import time
from pathlib import Path

import click

from dpcontrol.cli.output import json_option, print_json, progress_bar, reports_failure
from dpcontrol.cli.score import print_score
from dpcontrol.foundation.errors import GoalMissed


@click.command("demo", epilog="Example:  dpcontrol demo --itinerary cross")
@click.option("--itinerary", default="outer-turn", show_default=True, help="Itinerary to show.")
@click.option("--seed", default=0, show_default=True, help="Of the plant's parameters and the initial error.")
@click.option(
    "--folder",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("logs"),
    show_default=True,
    help="Where log, recording and picture go.",
)
@json_option
@reports_failure
def command(*, itinerary: str, seed: int, folder: Path, as_json: bool) -> None:
    """Plan, run, score and picture one itinerary: a full turn of the outer arm at no cost of energy.

    Everything is computed here and now: the Lyapunov orbit, its tube, the connections, the reference with friction
    and cart, and a closed loop with encoders, an estimator and a plant that differs from the model.
    """
    began = time.perf_counter()
    with progress_bar("demo") as progress:
        progress("loading", 0.0)
        from dpcontrol.review.of_log import run_view
        from dpcontrol.review.picture import write_picture
        from dpcontrol.review.recording import write_recording
        from dpcontrol.scenes.itinerary import load_itinerary
        from dpcontrol.scenes.plan import make_plan
        from dpcontrol.scenes.run import run_plan
        from dpcontrol.scenes.run_options import RunOptions

        scene = load_itinerary(itinerary).with_run(RunOptions(), seed=seed)
        plan = make_plan(scene, progress=lambda what, done: progress(what, 0.05 + 0.45 * done))
        log = folder / f"{scene.name}-{seed}.mcap"
        run = run_plan(plan, log, progress=lambda what, done: progress("closed loop", 0.5 + 0.25 * done))
        verdict, view = run.score(), run_view(run.log)
        progress("recording", 0.8)
        recording = log.with_suffix(".rrd")
        write_recording(view, recording)
        progress("picture", 0.85)
        picture = write_picture(view, log.with_suffix(".png"))
    seconds = time.perf_counter() - began
    if as_json:
        document = verdict.document()
        document |= {"recording": str(recording), "picture": str(picture.path), "renderer": picture.renderer}
        print_json(document | {"seconds": seconds, "status": picture.status})
    else:
        symbols = plan.notes["symbols"]
        click.echo(f"{scene.title}: {' '.join(repr(symbol['text']) for symbol in symbols)}")
        click.echo(f"  planned: {plan.status}")
        print_score(verdict)
        click.echo(f"log        {log}")
        click.echo(f"recording  {recording}     (open it with `rerun {recording}`)")
        click.echo(f"picture    {picture.path}     ({picture.status})")
        click.echo(f"{seconds:.1f} s in all; next: `dpcontrol review {log}`, `dpcontrol connect --help`")
    if verdict.completed is False:
        raise GoalMissed(f"not completed: {verdict.reason}")
