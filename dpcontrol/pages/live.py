"""Show a run live in a Rerun viewer.

The loop sends rows through a pipe to a separate process.

The loop never waits. Fifty times a second it writes a row of some 300 bytes to a non-blocking pipe, and drops the row
if the pipe is full. Run as a program, this module is the receiving process. Its arguments are a file with the run's
fixed data and the address of a viewer; for an empty address it opens a viewer. It shows rows until the pipe or the
viewer is closed. Failures of this process do not affect the run.
"""

import contextlib
import os
import pickle
import select
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError, remark
from dpcontrol.judge.run_view import RunView, series_of
from dpcontrol.logs import Event, RunLog
from dpcontrol.loop.result import LoopSink, Ticks

if TYPE_CHECKING:
    import rerun as rr


RATE = 50.0
"""Rate of the displayed rows, Hz."""
_MOST = getattr(select, "PIPE_BUF", 512)
"""Largest atomic write to a pipe, bytes."""
_ROOM = 1 << 20
"""Capacity of the pipe, bytes, on systems that can set it: a minute of rows."""
_PAUSE = 0.1
"""Time between two reads of the pipe, s."""
_TAIL = 20
"""Rows drawn again with the next ones, so that the tip's path has no gaps."""
_MEMORY = "1GB"
"""Memory limit of the viewer; beyond it the oldest data are dropped."""


class LiveView(LoopSink):
    """A sink that shows a run live and drops rows under load.

    It is a context manager.

    Args:
        start: log of the run before its first row, with scene, model and reference attached.
        viewer: address of an open viewer; "" opens one.

    Raises:
        InputError: there is no viewer, no display to open it on, or the system is Windows.
    """

    def __init__(self, start: RunLog, *, viewer: str = "") -> None:
        from dpcontrol.pages.picture import LIVE_REMEDY, check_viewer

        if sys.platform == "win32":
            raise InputError("a live view needs pipes as Linux and macOS have them; review the log after the run")
        if not viewer:
            check_viewer(LIVE_REMEDY)
        self._start, self._viewer = start, viewer
        self._every, self._left = max(1, round(start.rate_hz / RATE)), 0
        self._pipe = -1
        self._sent = self._dropped = 0

    def __enter__(self) -> "LiveView":
        handle, name = tempfile.mkstemp(prefix="dpcontrol-live-")
        with os.fdopen(handle, "wb") as file:
            pickle.dump(self._start, file)
        quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        program = [sys.executable, "-m", __name__, name, self._viewer]
        window = subprocess.Popen(program, stdin=subprocess.PIPE, start_new_session=True, **quiet)
        assert window.stdin is not None
        self.process, self._pipe = window.pid, os.dup(window.stdin.fileno())
        window.stdin.close()
        # The process outlives the run and is not waited for.
        window.returncode = 0
        os.set_blocking(self._pipe, False)
        with contextlib.suppress(ImportError, AttributeError, OSError):
            import fcntl

            fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, _ROOM)
        return self

    def __exit__(self, *_: object) -> None:
        if self._pipe < 0:
            remark("the live view ended before the run; the log is complete")
        else:
            os.close(self._pipe)
        if self._dropped:
            remark(f"the live view was behind: {self._dropped:,} of {self._sent:,} rows were left out; the log has all")

    def ticks(self, rows: Ticks) -> None:
        """Show a selection of the next ticks."""
        count = len(rows.times)
        for k in range(self._left, count, self._every):
            parts = [rows.times[k : k + 1], rows.measured[k], rows.estimates[k], rows.references[k], rows.control[k]]
            if rows.truth is not None:
                parts.append(rows.truth[k])
            self._send(np.concatenate(parts))
        self._left = -(count - self._left) % self._every

    def event(self, event: Event) -> None:
        """Show one event.

        Args:
            event: the event.
        """
        self._send(event)

    def _send(self, content: Array | Event) -> None:
        if self._pipe < 0:
            return
        self._sent += 1
        message = pickle.dumps(content, protocol=pickle.HIGHEST_PROTOCOL)
        try:
            # A longer message might be written in part.
            self._dropped += len(message) > _MOST or not os.write(self._pipe, message)
        except BlockingIOError:
            self._dropped += 1
        except OSError:
            os.close(self._pipe)
            self._pipe = -1


@dataclass
class ShownState:
    """The displayed part of a run.

    It holds recording, log before the first row, plan and last rows (K, D).

    A row holds the time in s, measurement, estimate, reference, the columns of `control_fields` and, if known, the
    true state; units as in `Ticks`.
    """

    recording: "rr.RecordingStream"
    start: RunLog
    planned: RunView
    tail: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @classmethod
    def of(cls, recording: "rr.RecordingStream", start: RunLog) -> "ShownState":
        """Return the initial view, without flight data.

        It shows the plan with its orbits and tubes.

        Args:
            recording: recording of the viewer.
            start: log before the first row.
        """
        from dpcontrol.judge.of_log import reference_view
        from dpcontrol.judge.score import plan_of

        planned = reference_view(plan_of(start), start.path)
        return cls(recording, replace(start, rate_hz=RATE, extras=None), planned)

    def add(self, rows: Array, events: tuple[Event, ...]) -> None:
        """Show new rows and events.

        Args:
            rows: (K, D) new rows.
            events: new events.
        """
        from dpcontrol.pages import rerun_recording as recorded
        from dpcontrol.pages.planes import plane
        from dpcontrol.pages.run_charts import charts
        from dpcontrol.pages.strips import strips

        first, both = not len(self.tail), rows if not len(self.tail) else np.concatenate([self.tail, rows])
        view, drawn = self._view(rows, events), self._view(both, ())
        if first:
            sheets = [recorded.phase_plane(plane(view, arm)) for arm in range(view.arms)]
            self.recording.send_blueprint(recorded.blueprint(view, sheets, growing=True), make_active=True)
            self.recording.send_recording_name(view.title)
            recorded.record_strips(self.recording, "", strips(self.planned), self.planned)
            recorded.record_planes(self.recording, recorded.PLANES, view, sheets)
        for chart in charts(view).values():
            recorded.record_chart(self.recording, chart, view)
        modes = [strip for strip in strips(view, until=float(view.time[-1])) if strip.key == "mode"]
        recorded.record_strips(self.recording, "", modes, view)
        recorded.record_places(self.recording, recorded.PLANES, view)
        recorded.draw_pendulum(self.recording, recorded.SCENE, drawn)
        recorded.record_events(self.recording, view)
        self.tail = both[-_TAIL:]

    def _view(self, rows: Array, events: tuple[Event, ...]) -> RunView:
        """Return rows as a `RunView`."""
        start, n = self.start, len(self.start.arm_lengths)
        width = 2 * n + 2
        sizes = np.cumsum([1, n + 1, width, width, len(start.controls)])
        times, measured, estimate, reference, control, truth = np.split(rows, sizes, axis=1)
        states = {"estimate": estimate, "reference": reference} | ({"truth": truth} if truth.size else {})
        log = replace(
            start,
            time=times[:, 0],
            measured=measured,
            states=states,
            events=events,
            controls=dict(zip(start.controls, control.T, strict=True)),
        )
        view, planned = series_of(log), self.planned.source
        # Means of the NIS need more rows than arrive at once.
        return replace(
            view,
            limits=start.limits,
            plan=self.planned.plan,
            title=f"{self.planned.title}, live",
            nis=None,
            energy=None if planned is None else planned.energies(view.state),
        )


def messages(stream: IO[bytes], viewer: "subprocess.Popen[Any] | None") -> Iterator[tuple[Array, tuple[Event, ...]]]:
    """Yield rows (K, D) and events as they arrive.

    The end is the closing of the stream or the viewer.

    Args:
        stream: pickles of rows and events.
        viewer: process of the viewer; None if it was not opened here.
    """
    queue: SimpleQueue[Any] = SimpleQueue()
    Thread(target=_receive, args=(stream, queue), daemon=True).start()
    items: list[Any] = []
    while not any(item is None for item in items) and (viewer is None or viewer.poll() is None):
        # Rows that arrive in the meantime are shown together.
        time.sleep(_PAUSE)
        items = [queue.get() for _ in range(queue.qsize())]
        rows = [item for item in items if isinstance(item, np.ndarray)]
        events = tuple(item for item in items if isinstance(item, Event))
        if rows or events:
            yield np.array(rows).reshape(len(rows), -1), events


def _receive(stream: IO[bytes], queue: "SimpleQueue[Any]") -> None:
    """Move pickles from a stream to a queue, whose last item is None."""
    with contextlib.suppress(EOFError, pickle.UnpicklingError):
        while True:
            queue.put(pickle.load(stream))
    queue.put(None)


def _opened(address: str) -> "tuple[str, subprocess.Popen[Any] | None]":
    """Return the address of a viewer and its process.

    If no address is given, a viewer is opened.
    """
    if address:
        return address, None
    from dpcontrol.pages.picture import viewer_command

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    silent: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    command, environment = viewer_command("--port", str(port), "--memory-limit", _MEMORY, "--hide-welcome-screen")
    return f"rerun+http://127.0.0.1:{port}/proxy", subprocess.Popen(command, env=environment, **silent)


def show(file: Path, address: str) -> None:
    """Show the data on standard input.

    Args:
        file: pickled log before its first row, deleted after reading.
        address: address of an open viewer; "" opens one.
    """
    with contextlib.suppress(AttributeError, OSError):
        os.nice(10)
        # Linux weighs sessions by this, not by their niceness.
        Path("/proc/self/autogroup").write_text("19")
    start: RunLog = pickle.loads(file.read_bytes())
    file.unlink()
    # The interpreter's own stream would be locked by the receiving thread at the end.
    stream = os.fdopen(sys.stdin.fileno(), "rb", closefd=False)
    address, viewer = _opened(address)
    import rerun as rr

    recording = rr.RecordingStream("dpcontrol")
    recording.connect_grpc(address)
    shown, events = ShownState.of(recording, start), ()
    for rows, more in messages(stream, viewer):
        events += more
        if len(rows):
            shown.add(rows, events)
            events = ()
    recording.flush(timeout_sec=5.0)


if __name__ == "__main__":
    try:
        show(Path(sys.argv[1]), sys.argv[2])
    except (InputError, OSError, KeyboardInterrupt):
        sys.exit(1)
