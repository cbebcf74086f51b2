"""What the verbs that draw figures and charts print."""

from collections.abc import Iterator
from textwrap import fill
from typing import Any

from dpcontrol.words.table import Line


def figures(found: Any) -> Iterator[Line]:
    """Yield file, caption and difference of each figure.

    Args:
        found: a `DrawnFigures`.
    """
    for one in found:
        yield from (str(one.file), _paragraph(one.caption), _paragraph(f"Differs from the paper: {one.differs}"))
    yield f"captions  {found.captions}"


def charts(found: Any) -> Iterator[Line]:
    """Yield files, tables and findings of each chart.

    Args:
        found: a `DrawnCharts`.
    """
    for one in found:
        yield from map(str, one.pictures)
        for part in one.chart.parts:
            yield from part.text()
        yield from (f"  {line}" for line in one.chart.reading)
        yield _paragraph(f"Chosen: {one.chart.chosen}")
        yield f"  {one.data}, {one.seconds:.0f} s"
    if not found.missed:
        yield found.status


def _paragraph(text: str) -> str:
    return fill(text, 110, initial_indent="  ", subsequent_indent="  ")
