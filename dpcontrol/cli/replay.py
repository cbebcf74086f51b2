"""dpcontrol replay"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.verbs import Answer, TextTable, file_option, option, verb
from dpcontrol.foundation.progress import progress_bar

if TYPE_CHECKING:
    from dpcontrol.identification.replay import Replay

ESTIMATOR = "Estimator"


@verb("replay", example="dpcontrol replay logs/lab_free_swing.mcap --model lab --estimator ukf")
@click.argument("log", type=click.Path(path_type=Path))
@click.option("--model", default="lab", show_default=True, help="Model that predicts: a name or a path.")
@click.option("--ahead", default=100, show_default=True, help="Samples ahead of the estimate for the n-step error.")
@click.option("--span", type=float, help="Longest stretch predicted in one piece, s [5; 0.5 if the cart moved].")
@option("--estimator", default="ekf", show_default=True, group=ESTIMATOR, help="Kind of estimator: ekf, ukf.")
@option("--counts", default=40_000, show_default=True, group=ESTIMATOR, help="Encoder counts per turn: assumed noise.")
@option("--mean-over", type=float, group=ESTIMATOR, help="Length of its means, s [0.015; 0 if the cart moved].")
@option("--model-error", default=0.003, show_default=True, group=ESTIMATOR, help="Relative error of the accelerations.")
@file_option("--out", help="Log to write [logs/NAME-replay.mcap].")
def command(
    *,
    log: Path,
    model: str,
    ahead: int,
    span: float | None,
    estimator: str,
    counts: int,
    mean_over: float | None,
    model_error: float,
    out: Path | None,
) -> Answer:
    """Predict a recording by a model, run an estimator over its angles, and write both beside what was measured.

    Each segment is predicted in one piece from the initial state that fits it best. The log has the prediction as its
    reference: `dpcontrol review` shows both together. Where the cart moved, as in a log of `dpcontrol run`, its command
    or its recorded motion is the model's input. Encoder zeros given in the model's file are subtracted.
    """
    from dpcontrol.foundation.files import checked_other_file
    from dpcontrol.identification.replay import ReplaySettings, filter_settings, replay_recording, write_replay
    from dpcontrol.recordings.recording import load_recording
    from dpcontrol.scenes.model import load_model

    target = out or Path("logs") / f"{log.stem}-replay.mcap"
    checked_other_file(target, log, what="the log to replay")
    settings = ReplaySettings(counts=counts, mean_over=mean_over, ahead=ahead, span=span)
    filters = filter_settings(estimator, model_error=model_error)
    loaded, recording = load_model(model), load_recording(log)
    with progress_bar("replay") as progress:
        result = replay_recording(
            recording, loaded.arms, filters, settings, zeros=loaded.encoder_zeros, progress=progress
        )
        written = write_replay(result, target, model=loaded.name, model_text=loaded.text)
    document = {"log": str(written), "model": loaded.name, "estimator": estimator, **result.document()}
    missed = "" if all(fit.converged for fit in result.fits) else result.status
    return Answer(document, _text(result, loaded.name, written), missed)


def _text(result: "Replay", model: str, written: Path) -> Iterator[str | TextTable]:
    arms = range(1, result.recording.arms + 1)
    columns = ("segment", "start (s)", *(f"angle {i} (mrad)" for i in arms), "all (mrad)")
    rows = [
        (
            str(one["index"]),
            f"{one['start']:.3f}",
            *(f"{1e3 * one[f'rms_angle_{i}']:.2f}" for i in arms),
            f"{1e3 * one['rms']:.2f}",
        )
        for one in result.stretch_errors
    ]
    yield TextTable(f"{model} over {result.recording.name}: rms of whole segments", columns, rows)
    if result.cart:
        yield f"  cart      moved by {result.cart}"
    for samples, rms in result.ahead.items():
        yield f"  {samples} ahead   {', '.join(f'{1e3 * value:.3f}' for value in rms)} mrad rms from the estimate"
    if result.rates_rms is not None:
        yield f"  rates     {', '.join(f'{value:.3f}' for value in result.rates_rms)} rad/s rms from those recorded"
    yield f"  NIS       {result.nis_inside_95:.1%} inside its 95 % band, {result.nis_below_95:.1%} below its top"
    yield str(written)
