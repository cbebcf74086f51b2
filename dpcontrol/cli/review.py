"""dpcontrol review"""

import tempfile
from pathlib import Path
from typing import Any

import click

from dpcontrol.cli.output import json_option, print_json, progress_bar, reports_failure


@click.command("review", epilog="Example:  dpcontrol review logs/outer-turn-0.mcap --picture outer-turn.png")
@click.argument("log", type=click.Path(path_type=Path))
@click.option("--save", type=click.Path(dir_okay=False, path_type=Path), help="Save a Rerun recording (.rrd).")
@click.option("--picture", type=click.Path(dir_okay=False, path_type=Path), help="Save a picture (.png).")
@json_option
@reports_failure
def command(*, log: Path, save: Path | None, picture: Path | None, as_json: bool) -> None:
    """Open a log in the Rerun viewer: arms with the reference's ghost, angles, rates, command, errors, phase planes.

    With --save or --picture the viewer is not opened; where no renderer is installed the picture is drawn by
    matplotlib, and the message says so.
    """
    from dpcontrol.logs import read_log
    from dpcontrol.scenes.run import review_context

    run = read_log(log)
    context = review_context(run)
    document: dict[str, Any] = {"log": str(log), "recording": None, "picture": None, "status": "done"}
    with progress_bar("review") as progress:
        if save is not None or picture is None:
            from dpcontrol.review.recording import write_recording

            progress("recording", 0.1)
            recording = save or Path(tempfile.mkdtemp(prefix="dpcontrol-")) / f"{log.stem}.rrd"
            write_recording(run, context, recording)
            document["recording"] = str(recording)
        if picture is not None:
            from dpcontrol.review.picture import write_picture

            progress("picture", 0.4)
            drawn = write_picture(run, context, picture)
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
