"""dpcontrol review"""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dpcontrol.cli.verbs import Answer, file_option, verb
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import progress_bar

if TYPE_CHECKING:
    from dpcontrol.review.picture import Picture


@verb("review", example="dpcontrol review logs/outer-turn-0.mcap --picture outer-turn.png")
@click.argument("files", metavar="LOG...|ATLAS|REFERENCE", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--align", default=1, show_default=True, metavar="N", help="Symbol at which several logs are aligned.")
@file_option("--save", suffix=".rrd", help="Save a Rerun recording (.rrd).")
@file_option("--picture", suffix=".png", help="Save a picture (.png).")
def command(*, files: tuple[Path, ...], align: int, save: Path | None, picture: Path | None) -> Answer:
    """Open a log in the Rerun viewer: arms with the reference's ghost, the itinerary as asked and as done, angles,
    rates, command, errors, energy, phase planes with the tubes used. A recording from the bench opens as well.

    Several logs open side by side, each delayed so that all cross the section of symbol N at the same moment. An atlas
    (.npz) opens as its tubes, orbits and flights in space, and its cuts with the connections numbered on them; a
    reference (.npz) as its motion, command and limits. With --save or --picture the viewer is not opened; where no
    renderer is installed the picture is drawn by matplotlib, and the message says so.
    """
    first, *others = files
    document: dict[str, Any] = {"log": str(first), "recording": None, "picture": None, "status": "done"}
    with progress_bar("review") as progress:
        progress("reading", 0.05)
        if others:
            document = {"logs": [str(file) for file in files], **document}
            write_recording, write_picture, document["aligned"] = _comparison_writers(files, align)
        else:
            write_recording, write_picture = _writers(first)
        if save is not None or picture is None:
            progress("recording", 0.2)
            recording = save or Path(tempfile.mkdtemp(prefix="dpcontrol-")) / f"{first.stem}.rrd"
            write_recording(recording)
            document["recording"] = str(recording)
        if picture is not None:
            progress("picture", 0.5)
            drawn = write_picture(picture)
            document |= {"picture": str(drawn.path), "renderer": drawn.renderer, "status": drawn.status}
    if save is None and picture is None:
        from dpcontrol.review.viewer import open_viewer

        open_viewer(Path(document["recording"]))
    kinds = ("recording", "picture", "aligned")
    lines = [f"{kind:<10} {document[kind]}" for kind in kinds if document.get(kind)]
    return Answer(document, lines if picture is None else [*lines, document["status"]])


Writers = tuple[Callable[[Path], None], Callable[[Path], "Picture"]]
"""What writes the recording to a path, and the picture."""


def _writers(file: Path) -> Writers:
    from dpcontrol.foundation.archives import archive_format, is_archive
    from dpcontrol.logs import read_log
    from dpcontrol.references.reference import FORMAT as REFERENCE
    from dpcontrol.review.of_log import run_view
    from dpcontrol.review.of_reference import read_reference_view
    from dpcontrol.review.picture import write_atlas_picture, write_picture

    reference = archive_format(file) == REFERENCE
    if not reference and is_archive(file):
        from dpcontrol.scenes.atlas import load_atlas

        atlas = load_atlas(file)

        def record_atlas(path: Path) -> None:
            from dpcontrol.review.atlas_recording import write_atlas_recording

            write_atlas_recording(atlas, path)

        return record_atlas, lambda path: write_atlas_picture(atlas, path)
    view = read_reference_view(file) if reference else run_view(read_log(file))

    def record(path: Path) -> None:
        from dpcontrol.review.recording import write_recording

        write_recording(view, path)

    return record, lambda path: write_picture(view, path)


def _comparison_writers(files: tuple[Path, ...], symbol: int) -> tuple[Callable, Callable, str]:
    from dpcontrol.logs import read_log
    from dpcontrol.review.comparison import compare
    from dpcontrol.review.of_log import run_view
    from dpcontrol.review.picture import write_comparison_picture

    other = [file for file in files if file.suffix.lower() == ".npz"]
    if other:
        raise InputError(f"{other[0]} is no log: several files are compared only if all are logs; review it alone")
    comparison = compare([run_view(read_log(file)) for file in files], symbol=symbol)

    def record(path: Path) -> None:
        from dpcontrol.review.comparison_recording import write_comparison_recording

        write_comparison_recording(comparison, path)

    return record, lambda path: write_comparison_picture(comparison, path), comparison.status
