"""Lines of the guide and of the demonstration."""

from collections.abc import Iterator
from typing import Any

from dpcontrol.words.runs import score_lines
from dpcontrol.words.table import Line, Markdown


def page(text: Any) -> Iterator[Line]:
    """Yield a page of the guide, or the list of its pages.

    Args:
        text: a `GuidePage`.
    """
    if text.topic is not None:
        yield Markdown(text)
        return
    width = max(map(len, text.topics))
    yield "The guide, in reading order:"
    yield from (f"  {name:{width}}  {about}" for name, about in text.topics.items())
    yield ""
    yield "`dpcontrol guide TOPIC` shows a page."


def demonstration(result: Any) -> Iterator[Line]:
    """Yield the plan, the score and the files of a demonstration.

    Args:
        result: a `Demonstration`.
    """
    plan, log = result.plan, result.log
    yield f"{plan.itinerary.title}: {' '.join(repr(symbol.text) for symbol in plan.content.symbols)}"
    yield f"  planned: {plan.status}"
    yield from score_lines(result.score)
    yield f"log        {log}"
    if result.recording:
        yield f"recording  {result.recording}     (open it with `rerun {result.recording}`)"
    yield f"picture    {result.picture}"
    yield f"{result.seconds:.1f} s in all; next: `dpcontrol review {log}`, `dpcontrol connect --help`"
