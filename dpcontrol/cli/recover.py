"""dpcontrol recover"""

from dataclasses import asdict
from pathlib import Path

import click

from dpcontrol.cli.output import checked_suffix, json_option, print_json, progress_bar, reports_failure


@click.command("recover", epilog="Example:  dpcontrol recover logs/outer-turn-0.mcap.partial")
@click.argument("log", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Log to write [NAME.mcap of a NAME.mcap.partial where that is free, else NAME-recovered.mcap].",
)
@json_option
@reports_failure
def command(*, log: Path, out: Path | None, as_json: bool) -> None:
    """Rebuild a log that a killed run left, that was cut or that is damaged; say what is lost.

    What is sound is copied bit for bit, put in order and read back; nothing is made up, and the old file is kept.
    """
    from dpcontrol.logs import recover

    if out is not None:
        checked_suffix(out, ".mcap", option="--out")
    with progress_bar("recover") as progress:
        done = recover(log, out, progress=progress)
    if as_json:
        print_json({key: str(value) if isinstance(value, Path) else value for key, value in asdict(done).items()})
    elif done.log == done.source:
        click.echo(f"{done.log} is whole: there is nothing to recover")
    else:
        kept = f" and {', '.join(done.attachments)}" if done.attachments else ""
        click.echo(f"{done.log}: {done.ticks:,} ticks to {done.end_s:.3f} s{kept}, read back and sound")
        click.echo(f"  lost: {done.lost}" if done.lost else "  nothing is lost")
        click.echo(f"  {done.source} is kept: remove it when you have looked")
