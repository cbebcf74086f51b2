"""dpcontrol recover"""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.verbs import Answer, file_option, verb
from dpcontrol.foundation.progress import progress_bar

if TYPE_CHECKING:
    from dpcontrol.logs import Recovery


@verb("recover", example="dpcontrol recover logs/outer-turn-0.mcap.partial")
@click.argument("log", type=click.Path(path_type=Path))
@file_option(
    "--out",
    suffix=".mcap",
    help="Log to write [NAME.mcap for NAME.mcap.partial where that is free, else NAME-recovered.mcap].",
)
def command(*, log: Path, out: Path | None) -> Answer:
    """Rebuild a log that a killed run left, that was cut or that is damaged, and report what is lost.

    What is sound is copied bit for bit, put in order and read back; nothing is made up, and the old file is kept.
    """
    from dpcontrol.logs import recover

    with progress_bar("recover") as progress:
        done = recover(log, out, progress=progress)
    document = {key: str(value) if isinstance(value, Path) else value for key, value in asdict(done).items()}
    return Answer(document, _text(done))


def _text(done: "Recovery") -> Iterator[str]:
    if done.log == done.source:
        yield f"{done.log} is whole: there is nothing to recover"
        return
    kept = f" and {', '.join(done.attachments)}" if done.attachments else ""
    yield f"{done.log}: {done.ticks:,} ticks to {done.end_s:.3f} s{kept}, read back and sound"
    yield f"  lost: {done.lost}" if done.lost else "  nothing is lost"
    yield f"  {done.source} is kept; remove it once you have checked the new log"
