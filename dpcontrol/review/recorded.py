"""The story of a run in a recording: charts with their levels and bands, strips of states, their common timeline."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from dpcontrol.review import style
from dpcontrol.review.motion import RunView
from dpcontrol.review.series import Chart, Line, Span, Strip, telling_rows

Array = NDArray[np.float64]

TIMELINE = "message_log_time"
"""The timeline of the log's own messages, a duration from the start; derived series go on the same."""
TRACE_RATE = 50.0
"""Hz at which poses and places are recorded: enough for the eye."""
_BINS = 30_000
"""A curve of more than three times as many points is recorded by its least and greatest in each of so many."""
_ON_THE_WAY = "on the way"
_BAND_POINTS = 4000
_EDGE = np.array([-1e-6, 0.0, 1e-6])
"""s: about an end of a band."""


def times(time: Array) -> list[rr.TimeColumn]:
    """Return instants (K,) s as the recording's index."""
    return [rr.TimeColumn(TIMELINE, duration=time)]


def trace_rows(view: RunView) -> NDArray[np.int64]:
    """Return the ticks at which poses are recorded."""
    return np.arange(0, len(view.time), max(1, round(view.rate_hz / TRACE_RATE)))


def record_chart(recording: rr.RecordingStream, home: str, chart: Chart, view: RunView) -> None:
    """Record a chart's lines and levels under `home` and its key."""
    if not chart.key:
        return
    home = f"{home}/{chart.key}"
    for line in chart.lines:
        _line(recording, f"{home}/{line.key}", line)
    for level in chart.levels:
        ends = np.array([view.time[0], view.time[-1]])
        _line(
            recording, f"{home}/{level.key}", Line("", level.name, "", ends, np.full(2, level.value), level.colour, 1.0)
        )
    if chart.cut:
        # The viewer joins what falls into one pixel: a band between few points would be drawn as wedges.
        edges = np.array(chart.cut)
        time = np.union1d(np.linspace(*view.time_range, _BAND_POINTS), np.add.outer(edges, _EDGE).ravel())
        inside = np.searchsorted(edges[:, 0], time, side="right") > np.searchsorted(edges[:, 1], time, side="left")
        height = max(float(np.nanmax(np.abs(line.values))) for line in chart.lines if line.key == "applied")
        reach = np.where(inside, height, 0.0)
        name = "cut at a limit"
        _line(recording, f"{home}/cut", Line("", name, "", time, np.zeros(len(time)), style.LIMIT, 1.0, reach=reach))


def _line(recording: rr.RecordingStream, path: str, line: Line) -> None:
    """Record a line under a path, of a long one the telling points, for the log keeps all; with its band if it has one.

    Ink becomes pale on the viewer's dark plots, and a reference grey.
    """
    colour = {style.INK: style.PALE_INK, style.CART: style.PALE_INK}.get(line.colour, line.colour)
    tint = style.rgb(style.REFERENCE if line.role == "reference" else colour)
    rows = telling_rows(line.values, bins=_BINS)
    look: rr.SeriesLines | rr.Measurements
    if line.reach is None:
        look = rr.SeriesLines(colors=[tint], names=[line.name], widths=[line.width])
        columns = rr.Scalars.columns(scalars=line.values[rows])
    else:
        look = rr.Measurements.from_fields(names=[line.name], colors=[tint], widths=[line.width])
        # The viewer's band is one standard deviation of what it is given.
        columns = rr.Measurements.columns(values=line.values[rows], variances=line.reach[rows] ** 2)
    recording.log(path, look, static=True)
    recording.send_columns(path, indexes=times(line.time[rows]), columns=columns)


def record_strips(recording: rr.RecordingStream, home: str, strips: Sequence[Strip], view: RunView) -> None:
    """Record strips of named states: from when (s), and which."""
    for strip in strips:
        changes, colours = _changes(strip.spans, view)
        if not changes:
            continue
        path = f"{home}/{strip.key}"
        values = list(dict.fromkeys(name for _, name in changes))
        tints = [(*style.rgb(colours[value]), 255) for value in values]
        recording.log(path, rr.StateConfiguration(values=values, colors=tints), static=True)
        columns = rr.StateChange.columns(state=[name for _, name in changes])
        recording.send_columns(path, indexes=times(np.array([at for at, _ in changes])), columns=columns)


def _changes(spans: Sequence[Span], view: RunView) -> tuple[list[tuple[float, str]], dict[str, str]]:
    """Return spans as changes of a state, with what lies between stays as "on the way", and colours by name."""
    begin, end = view.time_range
    changes: list[tuple[float, str]] = []
    colours = {_ON_THE_WAY: style.FAINT}
    for span in spans:
        if span.kind == "transfer":
            continue
        text = f"not asked for: {span.text}" if span.kind == "astray" else span.text
        colours[text] = span.colour
        at = max(span.first, begin)
        if changes and changes[-1][0] >= at:
            changes.pop()
        changes.append((at, text))
        if span.kind in ("stay", "astray"):
            changes.append((span.last, _ON_THE_WAY))
    # The last stay lasts to the end, be it the plan's.
    if changes and changes[-1][1] == _ON_THE_WAY and changes[-1][0] > end - 2 / view.rate_hz:
        changes.pop()
    return changes, colours
