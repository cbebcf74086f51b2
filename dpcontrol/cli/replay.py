"""dpcontrol replay"""

from pathlib import Path
from typing import Any

import click
import numpy as np

from dpcontrol.cli.output import json_option, print_json, print_table, progress_bar, reports_failure
from dpcontrol.foundation.errors import GoalMissed


@click.command("replay", epilog="Example:  dpcontrol replay logs/lab_free_swing.mcap --model lab --estimator ukf")
@click.argument("log", type=click.Path(path_type=Path))
@click.option("--model", default="lab", show_default=True, help="Model that predicts: a name or a path.")
@click.option("--estimator", default="ekf", show_default=True, help="Kind of estimator: ekf, ukf.")
@click.option("--counts", default=40_000, show_default=True, help="Of an encoder per turn: the noise that is assumed.")
@click.option("--mean-over", type=float, help="Of each mean the estimator is given, s [0.015; 0 if the cart moved].")
@click.option("--model-error", default=0.003, show_default=True, help="Share by which the model's accelerations err.")
@click.option("--ahead", default=100, show_default=True, help="Samples ahead of the estimate for the n-step error.")
@click.option("--span", type=float, help="Longest stretch predicted in one piece, s [5; 0.5 if the cart moved].")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="Log to write [logs/NAME-replay.mcap].")
@json_option
@reports_failure
def command(
    *,
    log: Path,
    model: str,
    estimator: str,
    counts: int,
    mean_over: float | None,
    model_error: float,
    ahead: int,
    span: float | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Predict a recording by a model, run an estimator over its angles, and write both beside what was measured.

    Each segment is predicted in one piece from the initial state that fits it best. The log has the prediction as its
    reference: `dpcontrol review` shows both together. Where the cart moved, as in a log of `dpcontrol run`, its command
    or its recorded motion is the model's input. Encoder zeros that the model's file tells are taken off.
    """
    from dpcontrol.foundation.files import checked_other_file
    from dpcontrol.identification.replay import ReplaySettings, filter_settings, replay_recording, write_replay
    from dpcontrol.recordings.recording import load_recording
    from dpcontrol.scenes.model import load_model

    target = out or Path("logs") / f"{log.stem}-replay.mcap"
    checked_other_file(target, log, what="the log to replay")
    settings = ReplaySettings(counts=counts, mean_over=mean_over, ahead=ahead, span=span)
    filters = filter_settings(estimator, model_error=model_error)
    loaded = load_model(model)
    recording = load_recording(log)
    with progress_bar("replay") as progress:
        result = replay_recording(
            recording, loaded.arms, filters, settings, zeros=loaded.encoder_zeros, progress=progress
        )
        written = write_replay(result, target, model=loaded.name, model_text=loaded.text)
    segments: list[dict[str, Any]] = []
    for (index, first, _), fit in zip(result.stretches, result.fits, strict=True):
        own = {f"rms_angle_{i + 1}": float(value) for i, value in enumerate(fit.residual)}
        rms = float(np.sqrt(np.mean(np.square(fit.residual))))
        start = float(recording.time[first])
        segments.append({"index": index, "start": start, **own, "rms": rms, "converged": fit.converged})
    if as_json:
        print_json(
            {
                "log": str(written),
                "model": loaded.name,
                "estimator": estimator,
                "segments": segments,
                "nis_inside_95": result.nis_inside_95,
                "nis_below_95": result.nis_below_95,
                "rms_ahead": {str(samples): rms for samples, rms in result.ahead.items()},
                "rates_rms": result.rates_rms,
                "cart": result.cart,
                "status": result.status,
            }
        )
    else:
        columns = ("segment", "start (s)", *(f"angle {i + 1} (mrad)" for i in range(recording.arms)), "all (mrad)")
        rows = [
            (
                str(segment["index"]),
                f"{segment['start']:.3f}",
                *(f"{1e3 * segment[f'rms_angle_{i + 1}']:.2f}" for i in range(recording.arms)),
                f"{1e3 * segment['rms']:.2f}",
            )
            for segment in segments
        ]
        print_table(f"{loaded.name} over {recording.name}: rms of whole segments", columns, rows)
        if result.cart:
            click.echo(f"  cart      moved by {result.cart}")
        for samples, rms in result.ahead.items():
            said = ", ".join(f"{1e3 * value:.3f}" for value in rms)
            click.echo(f"  {samples} ahead   {said} mrad rms from the estimate")
        if result.rates_rms is not None:
            said = ", ".join(f"{value:.3f}" for value in result.rates_rms)
            click.echo(f"  rates     {said} rad/s rms from those recorded")
        click.echo(
            f"  NIS       {result.nis_inside_95:.1%} inside its 95 % band, {result.nis_below_95:.1%} below its top"
        )
        click.echo(f"{written}")
    if not all(fit.converged for fit in result.fits):
        raise GoalMissed(result.status)
