"""dpcontrol info"""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.verbs import Answer, TextTable, verb

if TYPE_CHECKING:
    from dpcontrol.logs import LogSummary

_LONG = 200
"""Characters of a metadata value that are shown to people."""


@verb("info", example="dpcontrol info logs/outer-turn-0.mcap")
@click.argument("log", type=click.Path(path_type=Path))
def command(*, log: Path) -> Answer:
    """Show what is in a log: topics, types, units, rates, counts, duration, metadata, attachments.

    All checksums are compared; a log that is cut or damaged is rejected with advice on what to do about it.
    """
    from dpcontrol.logs import summarise

    summary = summarise(log)
    return Answer(asdict(summary), _text(summary))


def _text(summary: "LogSummary") -> Iterator[str | TextTable]:
    yield (
        f"{summary.log}: {summary.duration:.3f} s at {summary.rate_hz:g} Hz, {summary.size / 1e6:.2f} MB, checksums "
        f"agree; layout {summary.format}, by {summary.program}; joints {', '.join(summary.joints)}"
    )
    if summary.recovered:
        yield f"  recovered; lost: {summary.recovered}"
    rows = [
        (t.topic, t.type, t.units, f"{t.count:,}", "" if t.rate_hz is None else f"{t.rate_hz:.6g}")
        for t in summary.topics
    ]
    yield TextTable("", ("topic", "type", "units", "messages", "Hz"), rows)
    for name, size in summary.attachments.items():
        yield f"  attachment {name}: {size:,} bytes"
    for key, value in summary.metadata.items():
        yield f"  {key}: {value if len(value) <= _LONG else f'{value[:_LONG]}…'}"
    for file in summary.partials:
        click.echo(f"  beside it: {file}, of a run that was interrupted or is under way", err=True)
