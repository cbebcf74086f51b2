"""The Rerun viewer, a separate program that is opened for the user: on a review, and on a run while it happens.

The loop sends rows of a run through a pipe to a separate process, which records them for the viewer.

The loop never waits. Fifty times a second it writes a row of some 300 bytes to a non-blocking pipe, and drops the row
if the pipe is full. The process shows rows until the pipe or the viewer is closed. Its failures do not affect the run.
"""

import contextlib
import os
import pickle
import select
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.config import configuration
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError, remark
from dpcontrol.foundation.files import archive_format
from dpcontrol.foundation.parts import installed, part
from dpcontrol.judge.comparison import RunComparison, compare
from dpcontrol.judge.of_log import reference_view, run_view
from dpcontrol.judge.run_view import RunView, series_of
from dpcontrol.judge.score import plan_of
from dpcontrol.logs import Event, RunLog, read_log
from dpcontrol.loop.result import LoopSink, Ticks
from dpcontrol.pages import rerun_recording as recorded
from dpcontrol.pages.planes import plane
from dpcontrol.pages.renderers import record
from dpcontrol.pages.run_charts import charts
from dpcontrol.pages.story import strips
from dpcontrol.plans.atlas import load_atlas
from dpcontrol.references.reference import FORMAT, load_reference
from dpcontrol.walks.atlas import Atlas


def viewer_program() -> Path | None:
    """Return the viewer's executable in the rerun-sdk package, or None."""
    if not installed("rerun_cli"):
        return None
    import rerun_cli

    program = shutil.which("rerun", path=Path(rerun_cli.__file__).parent)
    return None if program is None else Path(program)


_QUIET = {"CI": "1"}
"""Setting against usage reports of the viewer, which it sends except in CI."""
_LOOPBACK = ("--bind", "127.0.0.1")
"""Setting that restricts the viewer to connections from this computer."""
_STARTED = 1.0
"""Time after which a running viewer has found its display, s."""

REVIEW_REMEDY = "write a file with --picture FILE.png or --save FILE.rrd"
LIVE_REMEDY = "leave out --live, and draw the log with `dpcontrol review LOG --picture FILE.png`"


def check_viewer(remedy: str = REVIEW_REMEDY) -> Path:
    """Check that a viewer can be opened here, and return its executable.

    It is the configured one (`viewer` of the configuration), or the one in the rerun-sdk package.

    Args:
        remedy: advice for a user without a display.

    Raises:
        InputError: there is no viewer, or no display to open it on.
        PartMissing: rerun-sdk is not installed.
    """
    part("rerun")
    configured = configuration().viewer
    program = Path(os.path.expanduser(configured)) if configured else viewer_program()
    if configured and not os.access(str(program), os.X_OK):
        raise InputError(
            f"viewer = {configured!r}: there is no such program; correct it (`dpcontrol config` shows where it is set)"
        )
    if program is None:
        raise InputError("the installed rerun-sdk holds no viewer; install rerun-sdk from PyPI again")
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(
            f"there is no display to open the viewer on (neither DISPLAY nor WAYLAND_DISPLAY is set); {remedy}"
        )
    return program


def start_viewer(*arguments: str, **others: Any) -> "subprocess.Popen[Any]":
    """Start a private viewer, which accepts local connections only and reports nothing.

    Args:
        *arguments: further arguments of its program.
        **others: further arguments of the process, such as its input.

    Raises:
        InputError: there is no viewer, or no display to open it on.
    """
    streams: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    command = [str(check_viewer()), *arguments, *_LOOPBACK]
    return subprocess.Popen(command, env={**os.environ, **_QUIET}, **{**streams, **others})


def view_in_window(shown: Any, name: str) -> Path:
    """Open a separate viewer on a review and return the name of its recording, for messages; the file is not kept.

    The viewer outlives this process and accepts local connections only.

    Args:
        shown: run, reference, comparison or atlas.
        name: name of the recording.

    Raises:
        InputError: the viewer or the display is missing, or the viewer ended at once.
        PartMissing: rerun-sdk is not installed.
    """
    check_viewer()
    # The viewer keeps its open file when the folder is removed; Windows keeps the folder instead.
    with tempfile.TemporaryDirectory(prefix="dpcontrol-", ignore_cleanup_errors=True) as folder:
        # Some systems limit names of files to 255 bytes.
        recording = Path(folder) / f"{name[:40]}.rrd"
        record(shown, recording)
        with recording.open("rb") as content:
            viewer = start_viewer("-", stdin=content, start_new_session=True)
    with contextlib.suppress(subprocess.TimeoutExpired):
        if viewer.wait(_STARTED):
            raise InputError(f"the viewer ended at once; {REVIEW_REMEDY}")
    # The viewer runs on independently; with a code, Popen does not warn that it still does.
    viewer.returncode = 0
    return recording


@dataclass(frozen=True)
class Review(Documented):
    """Reviewed files, and what was written.

    Attributes:
        files: logs, an atlas or a reference.
        recording: recording that was saved or opened, or None.
        film: film of the arms, or None.
        aligned: how several logs are aligned, None for one.
    """

    KEYS: ClassVar[str] = "log=files.0 logs=files recording film aligned? status"

    status = "done"
    files: tuple[Path, ...]
    recording: Path | None
    film: Path | None
    aligned: str | None


Shown = RunView | RunComparison | Atlas
"""Objects to review: a run or a reference, several runs, an atlas."""


def opened(files: Sequence[Path], *, symbol: int = 1) -> Shown:
    """Return the content of one or more files for a review: a run, a reference, an atlas, or a comparison of runs.

    Args:
        files: a log, a reference or an atlas; or several logs, which are compared.
        symbol: number of the symbol at which several logs are aligned, from 1.

    Raises:
        InputError: a file is missing or damaged, or one of several files is not a log.
    """
    if not files:
        raise InputError("files = []: give one at least")
    first_file, *more_files = files
    if more_files:
        if array_file := next((file for file in files if file.suffix.lower() == ".npz"), None):
            raise InputError(
                f"{array_file} is not a log: several files can be compared only if all are logs; review it alone"
            )
        return compare([run_view(read_log(file)) for file in files], symbol=symbol)
    if first_file.suffix.lower() == ".npz":
        return (
            reference_view(load_reference(first_file), first_file)
            if archive_format(first_file) == FORMAT
            else load_atlas(first_file)
        )
    return run_view(read_log(first_file))


RATE = 50.0
"""Rate of the displayed rows, Hz."""
_MOST = getattr(select, "PIPE_BUF", 512) - 4
"""Largest atomic message in a pipe, bytes; its length takes four more."""
_PAUSE = 0.1
"""Time between two reads of the pipe, s."""
_LAST = 5.0
"""Longest time to show the last rows after a run, s."""
_TAIL = 20
"""Rows drawn again with the next ones, so that the tip's path has no gaps."""
_MEMORY = "1GB"
"""Memory limit of the viewer; beyond it the oldest data are dropped."""


class LiveView(LoopSink):
    """A sink, and context manager, that shows a run live and drops rows under load.

    Args:
        start: log of the run before its first row, with itinerary, model and reference attached.
        viewer: address of an open viewer; "" opens one.

    Raises:
        InputError: there is no viewer, no display to open it on, or the system is Windows.
    """

    def __init__(self, start: RunLog, *, viewer: str = "") -> None:
        if sys.platform == "win32":
            raise InputError("a live view needs pipes as Linux and macOS have them; review the log after the run")
        if not viewer:
            check_viewer(LIVE_REMEDY)
        # One of every so many ticks is sent; the number to skip before the next one comes second.
        self._every, self._left = max(1, round(start.rate_hz / RATE)), 0
        # Number of rows and events for the viewer, and of those that were dropped.
        self._sent = self._dropped = 0
        context = get_context("spawn")
        self._reading, self.pipe = context.Pipe(duplex=False)
        self.process = context.Process(target=_run, args=(start, viewer, self._reading), daemon=True)

    def __enter__(self) -> "LiveView":
        self.process.start()
        # The other process has its own copy of this end; the pipe is closed when no copy is left.
        self._reading.close()
        # A full pipe must not delay the control loop.
        os.set_blocking(self.pipe.fileno(), False)
        return self

    def __exit__(self, *_: object) -> None:
        if self.pipe.closed:
            remark("the live view ended before the run; the log is complete")
        self.pipe.close()
        self.process.join(_LAST)
        if self._dropped:
            remark(f"the live view was behind: {self._dropped:,} of {self._sent:,} rows were left out; the log has all")

    def ticks(self, rows: Ticks) -> None:
        """Send every few of the next ticks to the viewer's process, so that it gets about 50 rows in each second.

        Args:
            rows: the next ticks of the run.
        """
        count = len(rows.times)
        for k in range(self._left, count, self._every):
            columns = [rows.times[k : k + 1], rows.measured[k], rows.estimates[k], rows.references[k], rows.control[k]]
            if rows.truth is not None:
                columns.append(rows.truth[k])
            self._send(np.concatenate(columns))
        # Number of ticks to skip at the beginning of the next rows, so that the selection stays even.
        self._left = -(count - self._left) % self._every

    def event(self, event: Event) -> None:
        """Send one event to the viewer's process.

        Args:
            event: event of the run.
        """
        self._send(event)

    def _send(self, content: Array | Event) -> None:
        """Send a row of values or an event to the viewer's process, or drop it if the pipe is full.

        If the process has ended, its pipe is closed and everything later is ignored.
        """
        if self.pipe.closed:
            return
        self._sent += 1
        message = pickle.dumps(content, protocol=pickle.HIGHEST_PROTOCOL)
        try:
            # A longer message might be written in part.
            if len(message) > _MOST:
                raise BlockingIOError
            self.pipe.send_bytes(message)
        except BlockingIOError:
            self._dropped += 1
        except OSError:
            self.pipe.close()


Part = tuple[Array, tuple[Event, ...]]
"""Rows (K, D) and events that arrived together.

A row holds the time in s, measurement, estimate, reference, the columns of `control_fields` and, if known, the true
state; units as in `Ticks`.
"""


def parts_of(pipe: Connection, open_: Callable[[], bool] = lambda: True) -> Iterator[Part]:
    """Yield rows and events as they arrive, until the pipe or the viewer is closed.

    Args:
        pipe: reading end of the pipe.
        open_: function that returns False if the viewer was closed.
    """
    pipe_open = True
    while pipe_open and open_():
        # Rows that arrive in the meantime are shown together.
        time.sleep(_PAUSE)
        items: list[Any] = []
        with contextlib.suppress(EOFError):
            # This stays False if the end of the pipe interrupts the loop.
            pipe_open = False
            while pipe.poll():
                items.append(pipe.recv())
            pipe_open = True
        rows = [item for item in items if isinstance(item, np.ndarray)]
        if items:
            yield np.array(rows).reshape(len(rows), -1), tuple(item for item in items if isinstance(item, Event))


def show(recording: "recorded.rr.RecordingStream", start: RunLog, parts: Iterable[Part]) -> None:
    """Show a run in the viewer: first its plan with orbits and tubes, then each part of the run as it arrives.

    Args:
        recording: recording of the viewer.
        start: log before the first row.
        parts: rows and events that arrived together, see `Part`.
    """
    planned, log = reference_view(plan_of(start), start.path), replace(start, rate_hz=RATE, extras=None)
    last_rows, new_events = None, ()
    for rows, events in parts:
        new_events += events
        if not len(rows):
            continue
        view = _view(log, planned, rows, new_events)
        if last_rows is None:
            sheets = [recorded.Sheet.around(plane(view, arm)) for arm in range(view.arms)]
            recording.send_blueprint(recorded.blueprint(view, sheets, growing=True), make_active=True)
            recording.send_recording_name(view.title)
            recorded.record_strips(recording, "", strips(planned), planned)
            recorded.record_planes(recording, recorded.PLANES, view, sheets)
        for chart in charts(view).values():
            recorded.record_chart(recording, chart, view)
        modes = [strip for strip in strips(view, until=float(view.time[-1])) if strip.key == "mode"]
        recorded.record_strips(recording, "", modes, view)
        recorded.record_places(recording, recorded.PLANES, view)
        drawn_rows = rows if last_rows is None else np.concatenate([last_rows, rows])
        recorded.draw_pendulum(recording, recorded.SCENE, _view(log, planned, drawn_rows, ()))
        recorded.record_events(recording, view)
        last_rows, new_events = drawn_rows[-_TAIL:], ()


def _view(start: RunLog, planned: RunView, rows: Array, events: tuple[Event, ...]) -> RunView:
    """Return rows that arrived as a `RunView`, which the drawing functions of recordings take.

    Args:
        start: log of the run before its first row.
        planned: view of the run's reference.
        rows: (K, D) as in `Part`.
        events: events that arrived with the rows.
    """
    n = len(start.arm_lengths)
    width = 2 * n + 2
    # Ends of the columns of a row: time, measurement, estimate, reference and control; the rest is the true state.
    sizes = np.cumsum([1, n + 1, width, width, len(start.controls)])
    times, measured, estimate, reference, control, truth = np.split(rows, sizes, axis=1)
    states = {"estimate": estimate, "reference": reference} | ({"truth": truth} if truth.size else {})
    controls = dict(zip(start.controls, control.T, strict=True))
    log = replace(start, time=times[:, 0], measured=measured, states=states, events=events, controls=controls)
    view = series_of(log)
    energy = None if planned.source is None else planned.source.energies(view.state)
    # Means of the NIS need more rows than arrive at once.
    live = {"plan": planned.plan, "title": f"{planned.title}, live", "nis": None, "energy": energy}
    return replace(view, limits=start.limits, **live)


def _run(start: RunLog, address: str, pipe: Connection) -> None:
    """Show the rows in a pipe in the viewer; this is the main function of the separate process.

    Args:
        start: log of the run before its first row.
        address: address of an open viewer; "" opens one.
        pipe: reading end of the pipe.
    """
    # Ctrl-C ends the run, and neither this process nor the viewer.
    os.setsid()
    os.nice(10)
    with contextlib.suppress(OSError):
        # Linux weighs sessions by this, not by their niceness.
        Path("/proc/self/autogroup").write_text("19")
    viewer = None
    if not address:
        # The system chooses a free port; the viewer is then started at it.
        with socket.socket() as free_socket:
            free_socket.bind(("127.0.0.1", 0))
            port = str(free_socket.getsockname()[1])
        viewer = start_viewer("--port", port, "--memory-limit", _MEMORY, "--hide-welcome-screen")
        address = f"rerun+http://127.0.0.1:{port}/proxy"
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())
    recording = recorded.rr.RecordingStream("dpcontrol")
    recording.connect_grpc(address)
    show(recording, start, parts_of(pipe, lambda: viewer is None or viewer.poll() is None))
    recording.flush(timeout_sec=_LAST)
