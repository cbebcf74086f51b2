"""Write a run's log: one `tick` per period of the loop, `event` for what happens in between.

Ticks are collected as rows of numbers and turned into messages some twenty milliseconds at a time, so that a run
that is killed loses no more than that. The file grows as `NAME.mcap.partial` and gets its name when complete.
"""

import mimetypes
import os
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import cdr, layout, schemas, urdf
from dpcontrol.logs.blocks import REFERENCE_PREFIX, ChunkEncoder, Note, TickRows
from dpcontrol.logs.container import McapFile

_CHUNK_SECONDS = 0.02
_CHUNK_ROWS = 20


class LogWriter:
    """Writes the log of one run; a context manager.

    Leaving the block normally completes the file and renames it; leaving it by an exception keeps what was written
    as `NAME.mcap.partial`, for a look at what went wrong.

    Args:
        path: the log, by convention `*.mcap`; an older one is replaced when this one is complete.
        arm_lengths: (n,) in m.
        rate_hz: rate of the loop in Hz.
        has_cart: whether the pivot is on a cart; without one, states have 2n and measurements n entries.
        limits: the cart's greatest distance from the centre in m, velocity in m/s, acceleration in m/s².
        metadata: text by name: version, commit, seed, hashes, whatever tells this run from others.
        attachments: content by file name: scene, model, reference.

    Raises:
        InputError: the file cannot be written.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        arm_lengths: Sequence[float],
        rate_hz: float,
        has_cart: bool = True,
        limits: tuple[float, float, float] | None = None,
        metadata: Mapping[str, str] | None = None,
        attachments: Mapping[str, bytes] | None = None,
    ):
        self.path = Path(path)
        self.partial = self.path.with_name(self.path.name + ".partial")
        self._lengths = tuple(float(length) for length in arm_lengths)
        self._has_cart = has_cart
        self._limits = limits
        self._metadata = dict(metadata or {})
        self._attachments = dict(attachments or {})
        self._rate = float(rate_hz)
        self._arms = len(self._lengths)
        if self._arms < 1 or not self._rate > 0:
            raise ValueError(f"a log needs arms and a positive rate; got {self._arms} arms at {rate_hz} Hz")
        self._size = 2 * self._arms + 2 * has_cart
        self._joints = self._arms + has_cart
        self._width = len(layout.control_fields(self._arms, has_cart=has_cart))
        self._rows = max(_CHUNK_ROWS, round(_CHUNK_SECONDS * self._rate))
        self._time = np.zeros(self._rows)
        self._measured = np.zeros((self._rows, self._joints))
        self._estimate = np.zeros((self._rows, self._size))
        self._reference = np.zeros((self._rows, self._size))
        self._truth = np.zeros((self._rows, self._size))
        self._control = np.zeros((self._rows, self._width))
        self._filled = 0
        self._has_truth: bool | None = None
        self._last = 0.0
        self._notes: list[Note] = []
        self._result: dict[str, str] = {}
        self._encoder: ChunkEncoder | None = None
        self._file: McapFile | None = None
        self._stream: BinaryIO | None = None

    def __enter__(self) -> "LogWriter":
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if self.path.is_dir():
                raise InputError(f"cannot write {self.path}: it is a folder; choose another file name")
            self._stream = self._open()
            self._start(self._stream)
        except OSError as error:
            raise self._unwritable(error) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._stream is None or self._file is None:
            return
        try:
            empty = kind is not None and not self._filled and self._encoder is None
            if not empty:
                self._write_chunk()
            if kind is None:
                if self._result:
                    self._file.add_metadata(layout.RESULT_RECORD, self._result)
                self._file.finish()
            self._stream.close()
            if kind is None:
                self.partial.replace(self.path)
            elif empty:
                # A run that failed before its first tick leaves nothing worth a look.
                self.partial.unlink(missing_ok=True)
        except OSError as failure:
            raise self._unwritable(failure) from failure
        finally:
            self._stream.close()
            self._stream = self._file = None

    def _open(self) -> BinaryIO:
        """Open the partial file; where another run writes the same log, one of this process's own."""
        try:
            return self.partial.open("xb")
        except FileExistsError:
            self.partial = self.path.with_name(f"{self.path.name}.{os.getpid()}.partial")
            return self.partial.open("wb")

    def _unwritable(self, error: OSError) -> InputError:
        return InputError(f"cannot write {self.path}: {error.strerror or error}; choose another file or folder")

    def _start(self, stream: BinaryIO) -> None:
        program = f"dpcontrol {version('dpcontrol')}"
        self._file = McapFile(stream, library=program)
        described = {
            "format": "1",
            "arm_lengths": " ".join(repr(length) for length in self._lengths),
            "has_cart": "1" if self._has_cart else "0",
            "rate_hz": repr(self._rate),
            "limits": " ".join(repr(float(limit)) for limit in self._limits or ()),
            "program": program,
        }
        self._file.add_metadata(layout.LAYOUT_RECORD, described)
        self._file.add_metadata(layout.RUN_RECORD, self._metadata)
        for name, data in self._attachments.items():
            kind = "application/toml" if name.endswith(".toml") else mimetypes.guess_type(name)[0]
            self._file.add_attachment(name, data, media_type=kind or "application/octet-stream")

    def tick(
        self,
        time_s: float,
        *,
        measured: NDArray[np.float64],
        estimate: NDArray[np.float64],
        reference: NDArray[np.float64],
        truth: NDArray[np.float64] | None,
        control: NDArray[np.float64],
    ) -> None:
        """Log one period of the loop.

        Args:
            time_s: time since the start in s, not before that of the last tick.
            measured: (n+1,) positions as the sensors gave them: rad, and m for the cart.
            estimate: (2n+2,) in state order: rad, rad/s, m, m/s.
            reference: (2n+2,) likewise.
            truth: (2n+2,) likewise, the plant's own state; None in every tick of a run that has none.
            control: (13,) for a double pendulum on a cart: the row of `layout.control_fields`.

        Raises:
            ValueError: an array of another length, a time before the last, or truth in some ticks only.
            InputError: the file cannot be written.
        """
        row = self._filled
        if (truth is not None) is not self._has_truth:
            self._decide_truth(truth is not None)
        if (
            len(measured) != self._joints
            or len(estimate) != self._size
            or len(reference) != self._size
            or len(control) != self._width
        ):
            raise ValueError(
                f"a tick needs measured ({self._joints},), estimate and reference ({self._size},), control "
                f"({self._width},); got {len(measured)}, {len(estimate)}, {len(reference)}, {len(control)}"
            )
        if not time_s >= self._last:
            raise ValueError(f"tick at {time_s} s after one at {self._last} s")
        self._time[row] = self._last = time_s
        self._measured[row] = measured
        self._estimate[row] = estimate
        self._reference[row] = reference
        if truth is not None:
            self._truth[row] = truth
        self._control[row] = control
        self._filled = row + 1
        if self._filled == self._rows:
            self._write_chunk()

    def ticks(
        self,
        time_s: ArrayLike,
        *,
        measured: NDArray[np.float64],
        estimate: NDArray[np.float64],
        reference: NDArray[np.float64],
        truth: NDArray[np.float64] | None,
        control: NDArray[np.float64],
    ) -> None:
        """Log K periods at once, for loops that run as compiled code: arguments as in `tick`, with K rows each."""
        times = np.asarray(time_s, float)
        arrays = [measured, estimate, reference, control] + ([] if truth is None else [truth])
        widths = [self._joints, self._size, self._size, self._width, self._size]
        for array, width in zip(arrays, widths, strict=False):
            if np.shape(array) != (len(times), width):
                raise ValueError(f"expected rows of shape {(len(times), width)}, got {np.shape(array)}")
        if len(times) and not (times[0] >= self._last and (np.diff(times) >= 0).all()):
            raise ValueError("the times of ticks must not decrease")
        if (truth is not None) is not self._has_truth:
            self._decide_truth(truth is not None)
        done = 0
        while done < len(times):
            count = min(self._rows - self._filled, len(times) - done)
            to, since = slice(self._filled, self._filled + count), slice(done, done + count)
            self._time[to] = times[since]
            self._measured[to] = measured[since]
            self._estimate[to] = estimate[since]
            self._reference[to] = reference[since]
            self._control[to] = control[since]
            if truth is not None:
                self._truth[to] = truth[since]
            self._filled += count
            done += count
            self._last = float(times[done - 1])
            if self._filled == self._rows:
                self._write_chunk()

    def result(self, **values: str) -> None:
        """Note how the run went, as metadata at the end of the log: what need not be the same when it is repeated."""
        self._result.update(values)

    def _decide_truth(self, has_truth: bool) -> None:
        if self._has_truth is not None:
            raise ValueError("truth must be given in every tick of a run or in none")
        self._has_truth = has_truth

    def event(self, time_s: float, level: str, name: str, text: str) -> None:
        """Log an event: `level` is debug, info, warn, error or fatal, `name` the part it came from."""
        if level not in layout.LEVELS:
            raise ValueError(f"event level {level!r}: must be one of {', '.join(layout.LEVELS)}")
        time_ns = round(time_s * 1e9)
        message = cdr.log(time_ns, layout.LEVELS[level], name=name, text=text)
        self._notes.append(Note(row=self._filled, topic=layout.EVENTS, time_ns=time_ns, content=message))

    def _prepare(self, file: McapFile) -> ChunkEncoder:
        # Done with the first chunk: only then is it known whether the run has a truth.
        tick = layout.TickLayout(self._arms, self._has_cart, bool(self._has_truth))
        channels = {topic: file.add_channel(topic, tick.schemas[topic]) for topic in tick.messages}
        channels[layout.TRANSFORMS] = file.add_channel(layout.TRANSFORMS, schemas.TF_MESSAGE)
        channels[layout.EVENTS] = file.add_channel(layout.EVENTS, schemas.LOG)
        first = round(self._time[0] * 1e9) if self._filled else 0
        for topic, prefix in {layout.ROBOT: "", layout.GHOST: REFERENCE_PREFIX}.items():
            channels[topic] = file.add_channel(topic, schemas.STRING, latched=True)
            text = urdf.robot_description(
                self._lengths,
                has_cart=self._has_cart,
                limits=self._limits,
                prefix=prefix,
                ghost=topic == layout.GHOST,
            )
            self._notes.insert(0, Note(row=0, topic=topic, time_ns=first, content=cdr.string(text)))
        return ChunkEncoder(tick, self._lengths, channels=channels, rows=self._rows)

    def _write_chunk(self) -> None:
        if self._file is None:
            raise ValueError(f"the log {self.path} is not open: use LogWriter in a with statement")
        if self._encoder is None:
            self._encoder = self._prepare(self._file)
        count = self._filled
        if not count and not self._notes:
            return
        rows = TickRows(
            time_ns=np.rint(self._time[:count] * 1e9).astype(np.int64),
            measured=self._measured[:count],
            estimate=self._estimate[:count],
            reference=self._reference[:count],
            truth=self._truth[:count] if self._has_truth else None,
            control=self._control[:count],
        )
        try:
            self._file.add_chunk(*self._encoder.encode(rows, self._notes))
        except OSError as error:
            raise self._unwritable(error) from error
        self._notes.clear()
        self._filled = 0
