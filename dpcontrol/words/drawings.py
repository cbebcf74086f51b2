"""Lines of the results that draw figures and charts."""

from collections.abc import Iterator
from textwrap import fill
from typing import Any

from dpcontrol.words.table import Line


def figures(result: Any) -> Iterator[Line]:
    """Yield file, caption and difference from the paper of each figure, as a verb prints them.

    Args:
        result: a `DrawnFigures`.
    """
    for figure in result:
        yield from (
            str(figure.file),
            _paragraph(figure.caption),
            _paragraph(f"Differs from the paper: {figure.differs}"),
        )


def charts(result: Any) -> Iterator[Line]:
    """Yield files, tables and findings of each benchmark chart, as a verb prints them.

    Args:
        result: a `DrawnCharts`.
    """
    for chart in result:
        yield from map(str, chart.pictures)
        for part in chart.chart.parts:
            yield from part.text()
        yield from (f"  {line}" for line in chart.chart.reading)
        yield _paragraph(f"Chosen: {chart.chart.chosen}")
        yield f"  {chart.data}, {chart.seconds:.0f} s"
    if not result.missed:
        yield result.status


def _paragraph(text: str) -> str:
    """Return a text wrapped to 110 characters and indented, as a paragraph below the name of a file."""
    return fill(text, 110, initial_indent="  ", subsequent_indent="  ")
