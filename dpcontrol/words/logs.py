"""Lines of the results that are read from logs."""

import math
from collections.abc import Iterator
from itertools import zip_longest
from typing import Any

from dpcontrol.words.runs import score_lines
from dpcontrol.words.table import Line, table

_LONG = 200
"""Number of characters of a metadata value to print."""


def scores(result: Any) -> Iterator[Line]:
    """Yield the lines of each score or long run.

    Args:
        result: a `Scores`.
    """
    for score, why in zip_longest(result.results, result.whys):
        yield from score.lines() if why is None else score_lines(score, why=why)


def unscored(result: Any) -> Iterator[Line]:
    """Yield a log without a score, and the reason.

    Args:
        result: an `Unscored`.
    """
    yield from (result.log, f"  {result.reason}")


def night(result: Any) -> Iterator[Line]:
    """Yield uptime, falls, cart, drift and interruptions of a long run.

    Args:
        result: a `Night`.
    """
    yield str(result.folder)
    yield f"  {result.sentence}"
    if result.falls:
        yield f"  falls    {', '.join(f'{cause} {count}' for cause, count in result.causes.items())}"
    limit = result.digests[0].limit
    of = f" of {1e3 * limit:.0f}" if limit else ""
    hits = result.stop_hits
    yield (
        f"  cart     {1e3 * result.cart:.1f}{of} mm at most, {hits or 'no'} end stop{'s' if hits > 1 else ''} hit; "
        f"tracking {1e3 * result.tracking:.1f} mrad rms on the itinerary"
    )
    if result.drifts:
        yield f"  drift    {', '.join(f'{d.name} {d.first:+.4f} to {d.last:+.4f}' for d in result.drifts)}"
    if math.isfinite(result.memory_growth):
        yield f"  memory   {result.memory_growth:.0%} of its size after the first file"
    if (finite := result.deadlines) is not None:
        yield (
            f"  rig      {finite['missed']:,} of {finite['ticks']:,} deadlines missed, ticks began up to "
            f"{1e3 * finite['worst']:.3g} ms late; {finite['lost']:,} readings lost, the bench repeated a command "
            f"{finite['held']:,} times"
        )
    for span in result.unlogged:
        yield f"  no log from {span.first / 60:.2f} to {span.end / 60:.2f} minutes"
    for end in result.endings:
        yield f"  ended at {end.time / 60:.2f} minutes: {end.text}"
    for file in result.partials:
        yield f"  beside it: {file}, of a night that was interrupted or is under way"


def campaign(result: Any) -> Iterator[Line]:
    """Yield success rates by group, and the reasons of failures.

    Args:
        result: a `CampaignSummary`.
    """
    yield f"{result.path}\n  {result.status}"
    columns = {
        "runs": "{.label}",
        "completed": "{0.share.successes} of {0.share.runs}",
        "share": "{0.share.rate:.1%}",
        "95 % interval": "{0.share.low:.1%} to {0.share.high:.1%}",
    }
    yield table("", result.groups, columns)
    if result.reasons:
        yield table("", result.reasons[:8], {"reason of failure": "{0[0]}", "runs": "{0[1]}"})


def report(result: Any) -> Iterator[Line]:
    """Yield the result that a page shows, and the page's file.

    Args:
        result: a `Report`.
    """
    yield from result.result.lines()
    if result.margins is not None:
        yield f"  margins  {result.margins.status}"
    yield f"page       {result.page}"


def review(result: Any) -> Iterator[Line]:
    """Yield the files of a review.

    Args:
        result: a `Review`.
    """
    for kind in ("recording", "film", "aligned"):
        if value := getattr(result, kind):
            yield f"{kind:<10} {value}"


def summary(result: Any) -> Iterator[Line]:
    """Yield the content of a log.

    Args:
        result: a `LogSummary`.
    """
    checked = "integrity not checked" if result.rewritten else "checksums agree"
    yield (
        f"{result.log}: {result.duration:.3f} s at {result.rate_hz:g} Hz, {result.size / 1e6:.2f} MB, {checked}; "
        f"layout {result.format}, by {result.program}; joints {', '.join(result.joints)}"
    )
    if result.recovered:
        yield f"  recovered; lost: {result.recovered}"
    columns: dict[str, Any] = {
        "topic": "{.topic}",
        "type": "{.type}",
        "units": "{.units}",
        "messages": "{.count:,}",
        "Hz": lambda topic: "" if topic.rate_hz is None else f"{topic.rate_hz:.6g}",
    }
    yield table("", result.topics, columns)
    for name, size in result.attachments.items():
        yield f"  attachment {name}: {size:,} bytes"
    for key, value in result.metadata.items():
        yield f"  {key}: {value if len(value) <= _LONG else f'{value[:_LONG]}…'}"
    for file in result.partials:
        yield f"  beside it: {file}, of an interrupted or current run"


def recovery(result: Any) -> Iterator[Line]:
    """Yield recovered ticks and losses.

    Args:
        result: a `Recovery`.
    """
    if result.log == result.source:
        yield f"{result.log} is readable as it is: there is nothing to recover"
        return
    attachments = f" and {', '.join(result.attachments)}" if result.attachments else ""
    yield f"{result.log}: {result.ticks:,} ticks to {result.end_s:.3f} s{attachments}, read back and sound"
    yield f"  lost: {result.lost}" if result.lost else "  nothing is lost"
    yield f"  {result.source} is kept; remove it once you have checked the new log"
