"""dpcontrol import"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dpcontrol.cli.output import json_option, print_json, progress_bar, reports_failure

if TYPE_CHECKING:
    from dpcontrol.recordings.recording import Recording


@click.command("import", epilog="Example:  dpcontrol import swing.csv --mapping my-rig.toml --repair nan,gaps")
@click.argument("file", required=False, type=click.Path(path_type=Path))
@click.option(
    "--simulated", metavar="MODEL", help="In place of a file: free swings of this model, as encoders show them."
)
@click.option("--swings", default=9, show_default=True, help="With --simulated: their number.")
@click.option("--seconds", default=2.667, show_default=True, help="With --simulated: of each.")
@click.option("--seed", default=0, show_default=True, help="With --simulated: of their starts and the encoders' zeros.")
@click.option("--mapping", help="What the columns mean: a name or a TOML file [.mat: by what it holds; else table].")
@click.option("--repair", default="", help="What may be mended, with commas: nan,time,gaps,wrap,spikes,sampling.")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="Log to write [logs/NAME.mcap].")
@json_option
@reports_failure
def command(
    *,
    file: Path | None,
    simulated: str | None,
    swings: int,
    seconds: float,
    seed: int,
    mapping: str | None,
    repair: str,
    out: Path | None,
    as_json: bool,
) -> None:
    """Import a recording of the bench, MATLAB, CSV or Parquet, as a log.

    Gaps, repeated times, missing numbers, wrapped angles and columns that contradict each other are refused with
    their row, and mended only where --repair says so; the log notes what was. Segments count from 0, rows from 1.
    With --simulated the truth is known: to try `identify` and `replay` on.
    """
    from dpcontrol.foundation.files import checked_other_file
    from dpcontrol.recordings.importing import import_recording
    from dpcontrol.recordings.recording import write_recording

    if (file is None) == (simulated is None):
        raise click.UsageError("give a FILE, or a model to swing with --simulated")
    if file is not None and out is not None:
        checked_other_file(out, file, what="the recording to import")
    repairs = [name.strip() for name in repair.split(",") if name.strip()]
    with progress_bar("import") as progress:
        if file is None:
            recording = _swings(str(simulated), swings=swings, seconds=seconds, seed=seed)
        else:
            recording = import_recording(file, mapping, repairs=repairs, progress=progress)
        progress("writing", 0.7)
        log = write_recording(recording, out or Path("logs") / f"{recording.name}.mcap")
    segments: list[dict[str, Any]] = [
        {
            "index": index,
            "start": float(recording.time[first]),
            "samples": end - first,
            "duration": float(recording.time[end - 1] - recording.time[first]),
        }
        for index, (first, end) in enumerate(recording.segments)
    ]
    total = sum(segment["duration"] for segment in segments)
    if as_json:
        print_json(
            {
                "log": str(log),
                "source": str(file or recording.source),
                "arms": recording.arms,
                "samples": len(recording.time),
                "sampling_period": recording.dt,
                "duration": total,
                "rates": recording.rates is not None,
                "cart": recording.cart is not None,
                "segments": segments,
                "notes": recording.notes,
            }
        )
        return
    click.echo(f"{log}")
    arms = "1 arm" if recording.arms == 1 else f"{recording.arms} arms"
    count = "1 segment" if len(segments) == 1 else f"{len(segments)} segments"
    click.echo(f"  {arms}, {count}, {total:.3f} s at {1 / recording.dt:g} Hz; {len(recording.time)} samples")
    for part, there in (("rates", recording.rates), ("cart", recording.cart), ("command", recording.command)):
        click.echo(f"  {part:<8} {'recorded' if there is not None else 'none'}")
    for note in recording.notes:
        click.echo(f"  mended   {note}")


def _swings(model: str, *, swings: int, seconds: float, seed: int) -> "Recording":
    from dpcontrol.recordings.simulated import random_swings
    from dpcontrol.scenes.model import load_model

    loaded = load_model(model)
    return random_swings(loaded.arms, swings=swings, seconds=seconds, seed=seed, name=f"{loaded.name}-swings-{seed}")
