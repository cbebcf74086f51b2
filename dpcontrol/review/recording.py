"""A run as a Rerun recording: the log's own messages, series derived from them, and a blueprint that arranges them.

The log alone can be opened in the viewer as well, but then without arrangement. Times are durations from the start.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import McapReader

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import whole_file
from dpcontrol.review.blueprint import blueprint
from dpcontrol.review.motion import RunView
from dpcontrol.review.recorded import record_chart, record_strips, times
from dpcontrol.review.recorded_planes import record_planes
from dpcontrol.review.recorded_scene import WORLD, draw_pendulum, trace_tip
from dpcontrol.review.series import check_charts, motion_charts, strips

_APPLICATION = "dpcontrol"
_TOPICS = ["^/tf$", "^/robot_description$", "^/reference/robot_description$", "^/rosout$"]
"""Taken as they are; the numbers of the other topics go into curves with names and colours."""
_LONG = 120.0
"""Seconds beyond which a log's scene is drawn from its series: to read its messages in the viewer's way takes 10 s of
computing and a gigabyte for ten minutes."""
SCENE = "scene"


def write_recording(view: RunView, path: Path) -> None:
    """Write the recording of a view to `path` (`*.rrd`); a log's file must still be where it was read from.

    Raises:
        InputError: the recording cannot be written, or the log has gone.
    """
    from_log = view.what != "reference"
    if from_log and not view.path.is_file():
        raise InputError(f"there is no log {view.path} any more; put it back and try again")
    from_log = from_log and view.time[-1] - view.time[0] <= _LONG
    with recording_to(path, view.title, blueprint(view, from_log=from_log)) as recording:
        summary = rr.TextDocument(_summary(view), media_type="text/markdown")
        recording.log("summary", summary, static=True)
        record_strips(recording, "states", strips(view), view)
        for chart in (*motion_charts(view), *check_charts(view)):
            record_chart(recording, "plots", chart, view)
        record_planes(recording, "phase_planes", view)
        if from_log:
            recording.send_chunks(McapReader(view.path, timeline_type="duration", include_topic_regex=_TOPICS).stream())
            trace_tip(recording, "tip", view, frame=WORLD)
        else:
            draw_pendulum(recording, SCENE, view)
            _events(recording, view)


@contextmanager
def recording_to(path: Path, name: str, view: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """Yield a recording with a blueprint that becomes the file `path` when the block ends without an error.

    Raises:
        InputError: it cannot be written.
    """
    with whole_file(Path(path), suffix=".rrd") as temporary:
        recording = rr.RecordingStream(_APPLICATION, send_properties=True)
        recording.save(temporary, default_blueprint=view)
        recording.send_recording_name(name)
        yield recording
        recording.flush()
        recording.disconnect()


def _events(recording: rr.RecordingStream, view: RunView) -> None:
    if view.events:
        columns = rr.TextLog.columns(
            text=[f"[{event.name}] {event.text}" for event in view.events],
            level=[event.level.upper() for event in view.events],
        )
        recording.send_columns("rosout", indexes=times(np.array([e.time for e in view.events])), columns=columns)


def _summary(view: RunView) -> str:
    rows = [f"**{view.verdict}**" if view.verdict else "", ""]
    for i, (name, at, done) in enumerate(view.symbols):
        seen = "" if done is None else f", done at {done:.3f} s"
        rows.append(f"{i + 1}. {name}: planned at {at:.3f} s{seen}")
    if view.plan.orbits:
        flown = "the reference" if view.what == "reference" else "the run"
        rows += ["", f"Phase planes, rad/s over rad: orbits thick; tubes from them red, to them green; {flown} black."]
    rows += ["", f"{view.title} ({view.path.name})", "", "| | |", "|---|---|"]
    # Long values, such as settings as JSON, would push everything else out of sight.
    rows += [f"| {key} | {value} |" for key, value in view.metadata.items() if value and len(value) < 60]
    return "\n".join(rows)
