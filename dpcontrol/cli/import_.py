"""dpcontrol import"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dpcontrol.cli.verbs import Answer, file_option, option, verb
from dpcontrol.foundation.progress import progress_bar

if TYPE_CHECKING:
    from dpcontrol.recordings.recording import Recording

SIMULATED = "With --simulated"


@verb("import", example="dpcontrol import swing.csv --mapping my-rig.toml --repair nan,gaps")
@click.argument("file", required=False, type=click.Path(path_type=Path))
@click.option("--mapping", help="Meaning of the columns: a name or a TOML file [.mat: by its contents; else table].")
@click.option("--repair", default="", help="What may be mended, with commas: nan,time,gaps,wrap,spikes,sampling.")
@option(
    "--simulated",
    metavar="MODEL",
    group=SIMULATED,
    help="In place of a file: free swings of this model, as encoders show them.",
)
@option("--swings", default=9, show_default=True, group=SIMULATED, help="Number of swings.")
@option("--seconds", default=2.667, show_default=True, group=SIMULATED, help="Length of each swing, s.")
@option("--seed", default=0, show_default=True, group=SIMULATED, help="Seed of the starts and the encoders' zeros.")
@file_option("--out", help="Log to write [logs/NAME.mcap].")
def command(
    *,
    file: Path | None,
    mapping: str | None,
    repair: str,
    simulated: str | None,
    swings: int,
    seconds: float,
    seed: int,
    out: Path | None,
) -> Answer:
    """Import a recording of the bench, MATLAB, CSV or Parquet, as a log.

    Gaps, repeated times, missing numbers, wrapped angles and columns that contradict each other are rejected with
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
    document = {"log": str(log), "source": str(file or recording.source), **_document(recording)}
    return Answer(document, _text(recording, document))


def _swings(model: str, *, swings: int, seconds: float, seed: int) -> "Recording":
    from dpcontrol.recordings.simulated import random_swings
    from dpcontrol.scenes.model import load_model

    loaded = load_model(model)
    return random_swings(loaded.arms, swings=swings, seconds=seconds, seed=seed, name=f"{loaded.name}-swings-{seed}")


def _document(recording: "Recording") -> dict[str, Any]:
    segments = [
        {
            "index": index,
            "start": float(recording.time[first]),
            "samples": end - first,
            "duration": float(recording.time[end - 1] - recording.time[first]),
        }
        for index, (first, end) in enumerate(recording.segments)
    ]
    return {
        "arms": recording.arms,
        "samples": len(recording.time),
        "sampling_period": recording.dt,
        "duration": sum(segment["duration"] for segment in segments),
        "rates": recording.rates is not None,
        "cart": recording.cart is not None,
        "segments": segments,
        "notes": recording.notes,
    }


def _text(recording: "Recording", document: dict[str, Any]) -> Iterator[str]:
    yield document["log"]
    arms = "1 arm" if recording.arms == 1 else f"{recording.arms} arms"
    segments = len(recording.segments)
    count = "1 segment" if segments == 1 else f"{segments} segments"
    rate = f"{1 / recording.dt:g} Hz; {len(recording.time)} samples"
    yield f"  {arms}, {count}, {document['duration']:.3f} s at {rate}"
    for part, there in (("rates", recording.rates), ("cart", recording.cart), ("command", recording.command)):
        yield f"  {part:<8} {'recorded' if there is not None else 'none'}"
    for note in recording.notes:
        yield f"  mended   {note}"
