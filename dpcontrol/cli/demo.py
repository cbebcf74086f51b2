"""dpcontrol demo"""

import time
from pathlib import Path

import click

from dpcontrol.cli.score import score_text, shortfall
from dpcontrol.cli.verbs import OUTPUT, Answer, option, verb
from dpcontrol.foundation.progress import part_of, progress_bar


@verb("demo", example="dpcontrol demo --itinerary cross")
@click.option("--itinerary", default="outer-turn", show_default=True, help="Itinerary to show.")
@click.option("--seed", default=0, show_default=True, help="Seed of the plant's parameters and the initial error.")
@option(
    "--folder",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("logs"),
    show_default=True,
    group=OUTPUT,
    help="Where log, recording and picture go.",
)
def command(*, itinerary: str, seed: int, folder: Path) -> Answer:
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
        plan = make_plan(scene, progress=part_of(progress, 0.05, 0.5))
        log = folder / f"{scene.name}-{seed}.mcap"
        run = run_plan(plan, log, progress=part_of(progress, 0.5, 0.75))
        verdict, view = run.score(), run_view(run.log)
        progress("recording", 0.8)
        recording = log.with_suffix(".rrd")
        write_recording(view, recording)
        progress("picture", 0.85)
        picture = write_picture(view, log.with_suffix(".png"))
    seconds = time.perf_counter() - began
    document = {
        **verdict.document(),
        "recording": str(recording),
        "picture": str(picture.path),
        "renderer": picture.renderer,
        "seconds": seconds,
        "status": picture.status,
    }
    lines = [
        f"{scene.title}: {' '.join(repr(symbol['text']) for symbol in plan.notes['symbols'])}",
        f"  planned: {plan.status}",
        *score_text(verdict),
        f"log        {log}",
        f"recording  {recording}     (open it with `rerun {recording}`)",
        f"picture    {picture.path}     ({picture.status})",
        f"{seconds:.1f} s in all; next: `dpcontrol review {log}`, `dpcontrol connect --help`",
    ]
    return Answer(document, lines, shortfall(verdict))
