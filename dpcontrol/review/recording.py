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
from dpcontrol.logs import RunLog
from dpcontrol.review import series
from dpcontrol.review.blueprint import blueprint
from dpcontrol.review.context import ReviewContext
from dpcontrol.review.motion import Motion, motion_of
from dpcontrol.review.recorded import times
from dpcontrol.review.recorded_planes import record_planes
from dpcontrol.review.recorded_scene import WORLD, draw_pendulum, trace_tip
from dpcontrol.review.recorded_series import record_checks, record_motion, record_story

_APPLICATION = "dpcontrol"
_TOPICS = ["^/tf$", "^/robot_description$", "^/reference/robot_description$", "^/rosout$"]
"""Taken as they are; the numbers of the other topics go into curves with names and colours."""
_LONG = 120.0
"""Seconds beyond which a log's scene is drawn from its series: to read its messages in the viewer's way takes 10 s of
computing and a gigabyte for ten minutes."""
SCENE = "scene"


def write_recording(log: RunLog, context: ReviewContext, path: Path) -> None:
    """Write the recording of `log`, whose file must still be where it was read from, to `path` (`*.rrd`).

    Raises:
        InputError: the recording cannot be written, or the log has gone.
    """
    if not log.path.is_file():
        raise InputError(f"there is no log {log.path} any more; put it back and try again")
    motion = motion_of(log)
    if motion.time[-1] - motion.time[0] > _LONG:
        write_motion_recording(motion, context, path)
        return
    with recording_to(path, context.title, blueprint(motion, context, from_log=True)) as recording:
        recording.send_chunks(McapReader(log.path, timeline_type="duration", include_topic_regex=_TOPICS).stream())
        _record(recording, motion, context)
        trace_tip(recording, "tip", motion, context, frame=WORLD)


def write_motion_recording(motion: Motion, context: ReviewContext, path: Path) -> None:
    """Write the recording of a motion that has no log, such as a reference, to `path` (`*.rrd`).

    Raises:
        InputError: the recording cannot be written.
    """
    with recording_to(path, context.title, blueprint(motion, context, from_log=False)) as recording:
        _record(recording, motion, context)
        draw_pendulum(recording, SCENE, motion, context)
        _events(recording, motion)


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


def _record(recording: rr.RecordingStream, motion: Motion, context: ReviewContext) -> None:
    recording.log("summary", rr.TextDocument(_summary(motion, context), media_type="text/markdown"), static=True)
    record_story(recording, "states", motion, context)
    record_motion(recording, "plots", motion, context)
    record_checks(recording, "plots", motion, context, energy=series.energy_of(motion, context))
    record_planes(recording, "phase_planes", motion, context)


def _events(recording: rr.RecordingStream, motion: Motion) -> None:
    if motion.events:
        columns = rr.TextLog.columns(
            text=[f"[{event.name}] {event.text}" for event in motion.events],
            level=[event.level.upper() for event in motion.events],
        )
        recording.send_columns("rosout", indexes=times(np.array([e.time for e in motion.events])), columns=columns)


def _summary(motion: Motion, context: ReviewContext) -> str:
    rows = [f"**{context.verdict}**" if context.verdict else "", ""]
    actual = (*context.crossings, *[None] * len(context.symbols))
    for i, ((at, name), done) in enumerate(zip(context.symbols, actual, strict=False)):
        seen = "" if done is None else f", done at {done:.3f} s"
        rows.append(f"{i + 1}. {name}: planned at {at:.3f} s{seen}")
    if context.orbits:
        flown = "the reference" if motion.what == "reference" else "the run"
        rows += ["", f"Phase planes, rad/s over rad: orbits thick; tubes from them red, to them green; {flown} black."]
    rows += ["", f"{context.title} ({motion.path.name})", "", "| | |", "|---|---|"]
    # Long values, such as settings as JSON, would push everything else out of sight.
    rows += [f"| {key} | {value} |" for key, value in motion.metadata.items() if value and len(value) < 60]
    return "\n".join(rows)
