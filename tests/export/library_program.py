"""Ticks of the loop that an exported library computes."""

import ctypes
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from dpcontrol.control.tick import TickProgram
from dpcontrol.foundation.arrays import Array
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.ticker import Ticker


def library_ticker(assembly: Assembly, library: Path) -> Ticker:
    """Return the ticker of a loop whose ticks a library computes."""
    with patch("dpcontrol.loop.assembly.TickProgram", partial(LibraryProgram, library)):
        return assembly.ticker()


def _types(program: TickProgram, real: str) -> tuple[np.dtype, np.dtype]:
    """Return the numpy types of dpc_reading and dpc_report."""
    n, size = program.model.arms, program.model.dimension
    extras = len(program.equations.filter.extra_names)
    reading = [("positions", "f8", (n + 1,)), ("present", "u1", (n + 1,)), ("limit_switch", "i4"), ("age", "f8")]
    whole = {"outcome": "i4", "stopped_by": "i4", "stop": "i4", "done": "i4", "mode": "i4", "saturated": "i4",
             "newly_cut": "i4", "used": "i4", "refused": "i4", "sensor": "i4", "repeats": "l",
             "untrusted": "i4"}  # fmt: skip
    lengths = {"state": size, "sigmas": size + extras, "extra": extras, "reference": size, "ahead": size}
    numbers = [(name, real, (length,)) for name, length in lengths.items() if length]
    scalars = ("wish", "feedforward", "feedback", "acting", "nis", "mean_nis", "error", "silent")
    report = [("command", real), *whole.items(), *numbers, *((name, real) for name in scalars)]
    return np.dtype(reading, align=True), np.dtype(report, align=True)


class _Description(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int) for name in
          ("version", "real_bytes", "controller_bytes", "reading_bytes", "report_bytes", "arms", "states", "extras",
           "lead")),
        ("ticks", ctypes.c_long), ("rate", ctypes.c_double), ("delay", ctypes.c_double),
        ("itinerary", ctypes.c_char_p), ("law", ctypes.c_char_p), ("identity", ctypes.c_char_p),
    )  # fmt: skip


class LibraryProgram(TickProgram):
    """Program whose ticks an exported library computes, for one run."""

    def __init__(self, library: Path, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        # Values that C does not report are zero.
        self._out[:] = 0.0
        self._c = ctypes.CDLL(str(library.resolve()))
        self._c.dpc_describe.restype = ctypes.POINTER(_Description)
        self.described = described = self._c.dpc_describe().contents
        reading, report = _types(self, "f4" if described.real_bytes == 4 else "f8")
        assert (described.reading_bytes, described.report_bytes) == (reading.itemsize, report.itemsize)
        self._reading, self._told = np.zeros((), reading), np.zeros((), report)
        # A copy, aligned like any C structure.
        self._controller = np.zeros(described.controller_bytes // 8 + 2, dtype=np.float64)
        self.controller_address = self._controller.ctypes.data
        real = ctypes.c_float if described.real_bytes == 4 else ctypes.c_double
        for name, result, more in (
            ("dpc_init", None, []), ("dpc_step", real, [ctypes.c_void_p] * 2), ("dpc_sent", ctypes.c_int, [real]),
            ("dpc_status", ctypes.c_int, []),
        ):  # fmt: skip
            function = getattr(self._c, name)
            function.restype, function.argtypes = result, [ctypes.c_void_p, *more]
        self._step = self._c.dpc_step
        self._arguments = (self.controller_address, self._reading.ctypes.data, self._told.ctypes.data)
        self._copied = [(name, part) for name, part in self.report._asdict().items() if name in (report.fields or ())]

    def begin(self, first: Array, queued: Array, *, velocity: float) -> None:
        """Begin a run; see `TickProgram.begin`."""
        super().begin(first, queued, velocity=velocity)
        self._c.dpc_init(self.controller_address)

    @property
    def status(self) -> int:
        """Status after the last tick, from dpc_status."""
        return self._c.dpc_status(self.controller_address)

    def set_sent(self, command: float) -> None:
        """Set the command that the drive received, m/s², if it differs."""
        self._c.dpc_sent(self.controller_address, command)

    def prepare(self, names: Sequence[str]) -> None:
        """Do nothing: the library is already compiled."""

    def tick(self) -> None:
        """Compute a whole tick with the library's table."""
        reading, told, report = self._reading, self._told, self.report
        reading["positions"], reading["present"] = self.reading.measured[:, 0], self.reading.present[:, 0]
        reading["limit_switch"], reading["age"] = self.reading.switch[0, 0], self.reading.age[0, 0]
        self._step(*self._arguments)
        for name, part in self._copied:
            part[:, 0] = told[name]
        report.notable[:] = report.outcome + report.stop
        report.news[:] = report.newly_cut + report.untrusted
