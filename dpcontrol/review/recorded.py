"""What recordings are made of: curves, levels, bands, strips of states, and the timeline that they share."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from dpcontrol.review import series, style
from dpcontrol.review.context import Stay
from dpcontrol.review.motion import Motion

Array = NDArray[np.float64]

TIMELINE = "message_log_time"
"""The timeline of the log's own messages, a duration from the start; derived series go on the same."""
TRACE_RATE = 50.0
"""Hz at which poses and places are recorded: enough for the eye."""
BINS = 30_000
"""A curve of more than three times as many points is recorded by its least and greatest in each of so many."""
ON_THE_WAY = "on the way"


def times(time: Array) -> list[rr.TimeColumn]:
    """Return instants (K,) s as the recording's index."""
    return [rr.TimeColumn(TIMELINE, duration=time)]


def line(colour: str, name: str, *, width: float = 1.3) -> rr.SeriesLines:
    """Return the look of one curve."""
    return rr.SeriesLines(colors=[style.rgb(colour)], names=[name], widths=[width])


def curve(recording: rr.RecordingStream, path: str, *, time: Array, values: Array, look: rr.SeriesLines) -> None:
    """Record a series (K,) under a path; of a long one the telling points, for the log keeps all."""
    recording.log(path, look, static=True)
    rows = series.telling_rows(values, bins=BINS)
    recording.send_columns(path, indexes=times(time[rows]), columns=rr.Scalars.columns(scalars=values[rows]))


def level(recording: rr.RecordingStream, path: str, motion: Motion, *, value: float, colour: str, name: str) -> None:
    """Record a constant over the motion's time."""
    ends = motion.time[[0, -1]]
    curve(recording, path, time=ends, values=np.full(2, value), look=line(colour, name, width=1.0))


def band(
    recording: rr.RecordingStream, path: str, *, time: Array, values: Array, reach: Array, colour: str, name: str
) -> None:
    """Record a series (K,) with a band of `reach` (K,) on either side."""
    look = rr.Measurements.from_fields(names=[name], colors=[style.rgb(colour)], widths=[1.0])
    recording.log(path, look, static=True)
    # The viewer's band is one standard deviation of what it is given.
    rows = series.telling_rows(values, bins=BINS)
    columns = rr.Measurements.columns(values=values[rows], variances=reach[rows] ** 2)
    recording.send_columns(path, indexes=times(time[rows]), columns=columns)


def states(
    recording: rr.RecordingStream, path: str, changes: Sequence[tuple[float, str]], colours: dict[str, str]
) -> None:
    """Record a strip of named states: from when (s), and which; `colours` by name."""
    if not changes:
        return
    values = list(dict.fromkeys(name for _, name in changes))
    tints = [(*style.rgb(colours.get(value, style.FAINT)), 255) for value in values]
    recording.log(path, rr.StateConfiguration(values=values, colors=tints), static=True)
    columns = rr.StateChange.columns(state=[name for _, name in changes])
    recording.send_columns(path, indexes=times(np.array([at for at, _ in changes])), columns=columns)


def stay_changes(stays: Sequence[Stay], *, begin: float) -> tuple[list[tuple[float, str]], dict[str, str]]:
    """Return stays as changes of a state, with what lies between as "on the way", and colours by name."""
    changes: list[tuple[float, str]] = []
    colours = {ON_THE_WAY: style.FAINT}
    for stay in stays:
        text = stay.text if stay.wanted else f"not asked for: {stay.text}"
        colours[text] = style.saddle_colour(stay.saddle) if stay.wanted else style.LIMIT
        at = max(stay.first, begin)
        if changes and changes[-1][0] >= at:
            changes.pop()
        changes += [(at, text), (stay.last, ON_THE_WAY)]
    return changes, colours


def trace_rows(motion: Motion) -> NDArray[np.int64]:
    """Return the ticks at which poses are recorded."""
    return np.arange(0, len(motion.time), max(1, round(motion.rate_hz / TRACE_RATE)))
