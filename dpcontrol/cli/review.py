"""dpcontrol review"""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dpcontrol.cli.output import checked_suffix, json_option, print_json, progress_bar, reports_failure

if TYPE_CHECKING:
    from dpcontrol.review.picture import Picture


@click.command("review", epilog="Example:  dpcontrol review logs/outer-turn-0.mcap --picture outer-turn.png")
@click.argument("log", metavar="LOG|ATLAS", type=click.Path(path_type=Path))
@click.option("--save", type=click.Path(dir_okay=False, path_type=Path), help="Save a Rerun recording (.rrd).")
@click.option("--picture", type=click.Path(dir_okay=False, path_type=Path), help="Save a picture (.png).")
@json_option
@reports_failure
def command(*, log: Path, save: Path | None, picture: Path | None, as_json: bool) -> None:
    """Open a log in the Rerun viewer: arms with the reference's ghost, angles, rates, command, errors, phase planes.

    An atlas (.npz) opens as its tubes, orbits and flights in space, and the cuts with the connections numbered on them.
    With --save or --picture the viewer is not opened; where no renderer is installed the picture is drawn by
    matplotlib, and the message says so.
    """
    from dpcontrol.scenes.atlas_file import is_atlas

    for option, file, suffix in (("--save", save, ".rrd"), ("--picture", picture, ".png")):
        if file is not None:
            checked_suffix(file, suffix, option=option)

    document: dict[str, Any] = {"log": str(log), "recording": None, "picture": None, "status": "done"}
    write_recording, write_picture = _atlas_writers(log) if is_atlas(log) else _log_writers(log)
    with progress_bar("review") as progress:
        if save is not None or picture is None:
            progress("recording", 0.1)
            recording = save or Path(tempfile.mkdtemp(prefix="dpcontrol-")) / f"{log.stem}.rrd"
            write_recording(recording)
            document["recording"] = str(recording)
        if picture is not None:
            progress("picture", 0.4)
            drawn = write_picture(picture)
            document |= {"picture": str(drawn.path), "renderer": drawn.renderer, "status": drawn.status}
    if save is None and picture is None:
        from dpcontrol.review.viewer import open_viewer

        open_viewer(Path(document["recording"]))
    if as_json:
        print_json(document)
        return
    for kind in ("recording", "picture"):
        if document[kind]:
            click.echo(f"{kind:<10} {document[kind]}")
    if picture is not None:
        click.echo(document["status"])


Writers = tuple[Callable[[Path], None], Callable[[Path], "Picture"]]
"""What writes the recording to a path, and the picture."""


def _log_writers(file: Path) -> Writers:
    from dpcontrol.logs import read_log
    from dpcontrol.review.of_log import review_context

    run = read_log(file)
    context = review_context(run)

    def recording(path: Path) -> None:
        from dpcontrol.review.recording import write_recording

        write_recording(run, context, path)

    def picture(path: Path) -> "Picture":
        from dpcontrol.review.picture import write_picture

        return write_picture(run, context, path)

    return recording, picture


def _atlas_writers(file: Path) -> Writers:
    from dpcontrol.scenes.atlas_file import load_atlas

    atlas = load_atlas(file)

    def recording(path: Path) -> None:
        from dpcontrol.review.atlas_recording import write_atlas_recording

        write_atlas_recording(atlas, path)

    def picture(path: Path) -> "Picture":
        from dpcontrol.review.atlas_picture import write_atlas_picture

        return write_atlas_picture(atlas, path)

    return recording, picture
