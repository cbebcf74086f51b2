"""dpcontrol info"""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.output import json_option, print_json, print_table, reports_failure

if TYPE_CHECKING:
    from dpcontrol.logs import LogSummary

_LONG = 200
"""Characters of a metadata value that are shown to people."""


@click.command("info", epilog="Example:  dpcontrol info logs/outer-turn-0.mcap")
@click.argument("log", type=click.Path(path_type=Path))
@json_option
@reports_failure
def command(*, log: Path, as_json: bool) -> None:
    """Show what is in a log: topics, types, units, rates, counts, duration, metadata, attachments.

    All checksums are compared; a log that is cut or damaged is refused with what to do about it.
    """
    from dpcontrol.logs import summarise

    summary = summarise(log)
    if as_json:
        print_json(asdict(summary))
    else:
        _print(summary)


def _print(summary: "LogSummary") -> None:
    click.echo(
        f"{summary.log}: {summary.duration:.3f} s at {summary.rate_hz:g} Hz, {summary.size / 1e6:.2f} MB, checksums "
        f"agree; layout {summary.format}, by {summary.program}; joints {', '.join(summary.joints)}"
    )
    if summary.recovered:
        click.echo(f"  recovered; lost: {summary.recovered}")
    rows = [
        (t.topic, t.type, t.units, f"{t.count:,}", "" if t.rate_hz is None else f"{t.rate_hz:.6g}")
        for t in summary.topics
    ]
    print_table("", ("topic", "type", "units", "messages", "Hz"), rows)
    for name, size in summary.attachments.items():
        click.echo(f"  attachment {name}: {size:,} bytes")
    for key, value in summary.metadata.items():
        shown = value if len(value) <= _LONG else f"{value[:_LONG]}…"
        click.echo(f"  {key}: {shown}")
    for file in summary.partials:
        click.echo(f"  beside it: {file}, of a run that was interrupted or is under way", err=True)
