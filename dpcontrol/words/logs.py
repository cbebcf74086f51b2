"""What the verbs that read logs print."""

import math
from collections.abc import Iterator
from itertools import zip_longest
from typing import Any

from dpcontrol.words.runs import score_lines
from dpcontrol.words.table import Line, table

_LONG = 200
"""Number of characters of a metadata value to print."""


def scores(found: Any) -> Iterator[Line]:
    """Yield the lines of each score or long run.

    Args:
        found: a `Scores`.
    """
    for one, why in zip_longest(found.results, found.whys):
        yield from one.lines() if why is None else score_lines(one, why=why)


def unscored(found: Any) -> Iterator[Line]:
    """Yield a log without a score, and the reason.

    Args:
        found: an `Unscored`.
    """
    yield from (found.log, f"  {found.reason}")


def night(found: Any) -> Iterator[Line]:
    """Yield uptime, falls, cart, drift and interruptions of a long run.

    Args:
        found: a `Night`.
    """
    yield str(found.folder)
    yield f"  {found.sentence}"
    if found.falls:
        yield f"  falls    {', '.join(f'{cause} {count}' for cause, count in found.causes.items())}"
    limit = found.digests[0].limit
    of = f" of {1e3 * limit:.0f}" if limit else ""
    hits = found.stop_hits
    yield (
        f"  cart     {1e3 * found.cart:.1f}{of} mm at most, {hits or 'no'} end stop{'s' if hits > 1 else ''} hit; "
        f"tracking {1e3 * found.tracking:.1f} mrad rms on the itinerary"
    )
    if found.drifts:
        yield f"  drift    {', '.join(f'{d.name} {d.first:+.4f} to {d.last:+.4f}' for d in found.drifts)}"
    if math.isfinite(found.memory_growth):
        yield f"  memory   {found.memory_growth:.0%} of its size after the first file"
    if (kept := found.deadlines) is not None:
        yield (
            f"  rig      {kept['missed']:,} of {kept['ticks']:,} deadlines missed, ticks began up to "
            f"{1e3 * kept['worst']:.3g} ms late; {kept['lost']:,} readings lost, the bench repeated a command "
            f"{kept['held']:,} times"
        )
    for span in found.unlogged:
        yield f"  no log from {span.first / 60:.2f} to {span.end / 60:.2f} minutes"
    for end in found.endings:
        yield f"  ended at {end.time / 60:.2f} minutes: {end.text}"
    for file in found.partials:
        yield f"  beside it: {file}, of a night that was interrupted or is under way"


def campaign(found: Any) -> Iterator[Line]:
    """Yield success rates by group, and the reasons of failures.

    Args:
        found: a `CampaignSummary`.
    """
    yield f"{found.path}\n  {found.status}"
    columns = {
        "runs": "{.label}",
        "completed": "{0.share.successes} of {0.share.runs}",
        "share": "{0.share.rate:.1%}",
        "95 % interval": "{0.share.low:.1%} to {0.share.high:.1%}",
    }
    yield table("", found.groups, columns)
    if found.reasons:
        yield table("", found.reasons[:8], {"reason of failure": "{0[0]}", "runs": "{0[1]}"})


def report(found: Any) -> Iterator[Line]:
    """Yield what a page shows, and its file.

    Args:
        found: a `Report`.
    """
    yield from found.result.lines()
    if found.margins is not None:
        yield f"  margins  {found.margins.status}"
    yield f"page       {found.page}"


def review(found: Any) -> Iterator[Line]:
    """Yield the files of a review.

    Args:
        found: a `Review`.
    """
    for kind in ("recording", "film", "aligned"):
        if value := getattr(found, kind):
            yield f"{kind:<10} {value}"


def summary(found: Any) -> Iterator[Line]:
    """Yield the content of a log.

    Args:
        found: a `LogSummary`.
    """
    checked = "integrity not checked" if found.rewritten else "checksums agree"
    yield (
        f"{found.log}: {found.duration:.3f} s at {found.rate_hz:g} Hz, {found.size / 1e6:.2f} MB, {checked}; "
        f"layout {found.format}, by {found.program}; joints {', '.join(found.joints)}"
    )
    if found.recovered:
        yield f"  recovered; lost: {found.recovered}"
    columns: dict[str, Any] = {
        "topic": "{.topic}",
        "type": "{.type}",
        "units": "{.units}",
        "messages": "{.count:,}",
        "Hz": lambda topic: "" if topic.rate_hz is None else f"{topic.rate_hz:.6g}",
    }
    yield table("", found.topics, columns)
    for name, size in found.attachments.items():
        yield f"  attachment {name}: {size:,} bytes"
    for key, value in found.metadata.items():
        yield f"  {key}: {value if len(value) <= _LONG else f'{value[:_LONG]}…'}"
    for file in found.partials:
        yield f"  beside it: {file}, of an interrupted or current run"


def recovery(found: Any) -> Iterator[Line]:
    """Yield recovered ticks and losses.

    Args:
        found: a `Recovery`.
    """
    if found.log == found.source:
        yield f"{found.log} is readable as it is: there is nothing to recover"
        return
    kept = f" and {', '.join(found.attachments)}" if found.attachments else ""
    yield f"{found.log}: {found.ticks:,} ticks to {found.end_s:.3f} s{kept}, read back and sound"
    yield f"  lost: {found.lost}" if found.lost else "  nothing is lost"
    yield f"  {found.source} is kept; remove it once you have checked the new log"
