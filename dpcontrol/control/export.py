"""Export of the tick as C99, as library and as FMI unit.

The library computes the ticks of the loop.

The expression is that of the loop (`dpcontrol.control.tick`). All constants of the run are inserted before CasADi
generates C, so constant subexpressions cost nothing. Constant tables contain the values that change from tick to tick:

    states  the reference: of the tick at which a command acts, and of the tick itself
    law     of each command: feedforward m/s², gains, with a lagging drive the cart's acceleration and the gain on it,
            gains on the extras; constant columns are in the code

They are smooth between the knots of the collocation. The tables therefore hold Chebyshev coefficients of pieces, each
as long as the error of the command allows.
Source: Trefethen, Approximation Theory and Approximation Practice (2013), chapters 3 and 4.

Single precision has a relative resolution of 6e-8, which requires three measures. The covariance is that of the
measured angles (`FilterEquations.carried`), whose entries are not small differences of large ones. The state is stored
as a sum of two numbers. An angle of some turns is rounded to 5e-7 rad or more, whereas the filter differentiates it
with an accuracy of 1e-5, and roundings of a rate add up. Readings count as equal within `SAME_IN_SINGLE`. The scales of
the states need no measure: the cart's variance of 1e-13 m² is far from the end of single precision. Smaller values only
cost time on computers that are slow with subnormal numbers.

The caller owns the controller's memory. Files that are the same for all controllers are templates in the folder
`target`, with placeholders between @. The interface is `target/dpc_controller.h`.

The same C becomes a co-simulation unit of the Functional Mock-up Interface, FMI 2.0 (https://fmi-standard.org).
Simulink, OpenModelica and FMPy all import its co-simulation units, whereas 3.0 is less widely supported and has no
advantage for scalars with a fixed step. `target/fmu.c` is the wrapper. The unit contains the C in `sources`, and a
binary for this platform if a compiler is available. A step of one period computes one tick with the present inputs. Its
command acts from the end of the step, one period after the reading.
"""

import ctypes
import math
import platform
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
import zipfile
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import NDArray

from dpcontrol.control.interface import Controller, GainSchedule, schedule_of
from dpcontrol.control.tick import SETTLING, TickEquations, TickProgram
from dpcontrol.control.tick_parts import Measurement
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import content_hash
from dpcontrol.foundation.version import PROGRAM, VERSION
from dpcontrol.words.runs import kibibytes

_TEMPLATES = Path(__file__).with_name("target")
_VERSION = 3
"""Version of the interface, as in the header."""
MOST_NUMBERS = 5_000_000
"""Maximum size of the tables; larger ones take compilers minutes and gigabytes."""
ACCURACY = {True: 1e-6, False: 3e-10}
"""Error of a command by the tables, in single and in double precision, m/s², for deviations of `_DEVIATION`."""
_DEVIATION = 0.1
"""Deviation of an entry of the state, in its unit, and error of a parameter."""
LARGE, SMALL, LONGEST = 6, 10, 512
"""Terms of a polynomial, the small ones of high degree in single precision, and most ticks of a piece."""
SAME_IN_SINGLE = (1e-5, 1e-7)
"""`SAME` for single precision, which rounds differences of angles of some turns to 2e-6 rad; rad and m."""


class Figures(NamedTuple):
    """Resources that a controller needs on its target, in bytes.

    The result is None if gcc is missing.
    """

    operations: int
    code: int | None
    """Size of the controller with its constants."""
    stack: int | None
    """Stack of a step."""
    memory: int
    """Memory of the caller between ticks."""
    tables: int
    """Total size of the tables."""
    tables_per_second: float
    """Size per second of reference, 0 for a constant law and reference."""
    seconds_a_tick: float | None
    """Duration of a tick from its operations, at the stated clock."""


CYCLES = {True: 5.0, False: 60.0}
"""Clock cycles per operation on a Cortex-M4, in single precision by its instructions, and in double by software."""


@dataclass(frozen=True, eq=False)
class ControllerSource:
    """A controller as C: files by name, identity, and resources.

    Attributes:
        itinerary: name of the itinerary.
        rate: ticks per second, Hz.
        clock: clock of the target, MHz, if it was given.
        place: folder or co-simulation unit that was written, if any.
    """

    files: Mapping[str, str]
    identity: str
    figures: Figures
    itinerary: str = ""
    rate: float = math.nan
    single: bool = False
    clock: float | None = None
    place: Path | None = None

    @property
    def precision(self) -> str:
        """Floating-point type of the program."""
        return "single" if self.single else "double"

    def document(self) -> dict[str, Any]:
        """Return the written files and the resources as JSON values."""
        unit = self.place is not None and self.place.suffix == ".fmu"
        return {
            "unit" if unit else "folder": self.place,
            "files": [] if unit else list(self.files),
            "identity": self.identity,
            "precision": self.precision,
            "rate": self.rate,
            **self.figures._asdict(),
        }

    def __repr__(self) -> str:
        return f"<controller in C: {len(self.files)} files, {self.figures.operations:,} operations a tick>"


def identity(program: TickProgram, schedule: GainSchedule) -> str:
    """Return a hash of everything that determines a controller, except the code.

    Args:
        program: initialised program.
        schedule: gains of the law.
    """
    equations = program.equations
    parts = [*equations.numbers.names, *equations.memory.names, *equations.row.names, *equations.filter.extra_names]
    shape = repr((_VERSION, equations.whole, equations.lead, equations.shares, program.period, parts))
    shape += repr(equations.encoders) * (not all(equations.measured))
    if equations.own is not None:
        shape += equations.function().serialize()
    arrays = (program.constants, program.stored[:, 0], schedule.rows, schedule.references, schedule.queued)
    return content_hash(shape, *(np.ascontiguousarray(array, dtype="<f8").tobytes() for array in arrays))


class _Tables(NamedTuple):
    """Values that change from tick to tick, as polynomials in pieces of the reference.

    A row holds the gains and the reference of a tick, see `TickEquations.row`; L is the number of its entries.

    Attributes:
        columns: indices (C,) of the stored entries in a row without the reference's angles; the states are first.
        varying: True for each entry (L,) that changes.
    """

    columns: NDArray[np.intp]
    varying: NDArray[np.bool_]
    constants: Array
    """Entries (L,) of the first row."""
    starts: Array
    """First ticks (P+1,) of the pieces, and the number of rows."""
    terms: Array
    """Coefficients (P, T, C) of Chebyshev polynomials over each piece."""
    names: tuple[str, ...]
    """Names (C,) of the stored entries, such as "gains 2"."""


def _tables(equations: TickEquations, schedule: GainSchedule, *, single: bool) -> _Tables:
    """Return the tables of a schedule without lead: which columns change from tick to tick, and their polynomials.

    A column's accuracy follows from the command's error by a unit of the column: gains by a deviation of the state,
    states by the largest gain. `single`: True for single precision.
    """
    n, states = equations.filter.arms, equations.row.slices.state
    rows = schedule.rows[:, :-n]
    varying = np.ptp(rows, axis=0) > 0
    columns = np.r_[states, np.setdiff1d(np.flatnonzero(varying), np.r_[states])]
    largest = equations.row.of(np.abs(schedule.rows).max(axis=0))
    errors = equations.row.filled(
        feedforward=1.0,
        gains=_DEVIATION,
        state=np.maximum(largest.gains, 1.0),
        drive=largest.drive_gain,
        drive_gain=_DEVIATION,
        extra_gains=_DEVIATION,
        pair_gains=_DEVIATION**2,
    )
    # All rows after the last one that differs are equal, so the tables end with the first of them.
    differing = np.flatnonzero((rows != rows[-1]).any(axis=1))
    moving = rows[: differing[-1] + 2 if len(differing) else 1, columns]
    names = [f"{name} {k + 1}" for name in equations.row.names for k in range(len(getattr(largest, name)))]
    starts, terms = _pieces(moving, errors[columns], ACCURACY[single])
    return _Tables(columns, varying, rows[0], starts, terms, tuple(np.array(names)[columns].tolist()))


@cache
def _basis(length: int) -> tuple[Array, Array]:
    """Return Chebyshev polynomials (L, T) at the ticks of a piece, and their pseudo-inverse (T, L), which fits them."""
    basis = chebvander(np.linspace(-1.0, 1.0, length), LARGE + SMALL - 1)
    # Polynomials of the lowest degree for pieces with fewer ticks than terms.
    inverse = np.pad(np.linalg.pinv(basis[:, :length]), ((0, max(LARGE + SMALL - length, 0)), (0, 0)))
    return np.asarray(basis, dtype=float), np.asarray(inverse, dtype=float)


def _coefficients(rows: Array) -> Array:
    """Return coefficients (T, C) of the polynomials that fit a piece (L, C), the last ones in single precision."""
    terms = _basis(len(rows))[1] @ rows
    terms[LARGE:] = terms[LARGE:].astype(np.float32)
    return terms


def _pieces(rows: Array, errors: Array, accuracy: float) -> tuple[Array, Array]:
    """Return first ticks (P+1,) and coefficients (P, T, C) of the longest pieces with this accuracy of the command.

    `rows` (K, C): the columns at all ticks. `errors` (C,): the command's errors by a unit of each column. `accuracy`:
    largest error of the command, m/s².
    """
    starts, coefficients = [0], []
    while starts[-1] < len(rows):
        remaining = rows[starts[-1] : starts[-1] + LONGEST]

        # The default binds the rows of this piece, not those of the last one.
        def misses(length: int, remaining: Array = remaining) -> bool:
            """Return True if polynomials over the next `length` ticks miss the accuracy."""
            errors_of_rows = _basis(length)[0] @ _coefficients(remaining[:length]) - remaining[:length]
            return bool((np.abs(errors_of_rows) @ errors > accuracy).any())

        length = bisect_left(range(len(remaining) + 1), True, lo=2, key=misses) - 1
        coefficients.append(_coefficients(remaining[:length]))
        starts.append(starts[-1] + length)
    return np.array(starts), np.stack(coefficients)


_ARGUMENTS = ("memory", "measured", "present", "offset", "limit_switch", "age", "acts", "now")
"""Arguments of the C function, in order.

`acts` (C,) are the entries of the row for the tick in which the command acts (`_Tables.columns`), and `now` (N,) is the
reference's state in this tick.
"""


def _function(program: TickProgram, equations: TickEquations, tables: _Tables) -> ca.Function:
    """Return the tick as a function with all constants of the run inserted: `_ARGUMENTS` -> memory and report.

    `tables`: the values that change from tick to tick, which are arguments instead of constants.
    """
    n, size = equations.filter.arms, equations.filter.equations.dimension
    memory, parts = equations.memory.symbols("memory")
    measured, present = ca.SX.sym("measured", n + 1), ca.SX.sym("present", n + 1)
    switch, age = ca.SX.sym("limit_switch"), ca.SX.sym("age")
    acts, now = ca.SX.sym("acts", len(tables.columns)), ca.SX.sym("now", size)
    entries, first = [ca.SX(value) for value in tables.constants.tolist()], equations.row.slices.state.start
    reference_angles = [now[i] if tables.varying[first + i] else entries[first + i] for i in range(n)]
    for place, column in enumerate(tables.columns.tolist()):
        if tables.varying[column]:
            entries[column] = acts[place]
    table_row = ca.vertcat(*entries, *reference_angles)
    # Values that only a fallback changes are constant.
    parts = parts._replace(held=ca.SX(0))
    offset = ca.SX.sym("offset", n + 1)
    reading = equations.reading.joined(Measurement(measured, present, switch, age, ca.SX.zeros(n), offset))
    numbers = ca.SX(ca.DM(program.constants))
    (result,) = equations.function().call([reading, table_row, numbers, equations.memory.joined(parts)], True, False)
    inputs = [memory, measured, present, offset, switch, age, acts, now]
    return ca.Function("tick", inputs, [ca.cse(result)], [*_ARGUMENTS], ["out"], {"cse": True})


def _start(program: TickProgram, equations: TickEquations) -> Array:
    """Return the initial memory (M,), with the state as a sum of two numbers if it is split for single precision."""
    start = program.stored[:, 0].copy()
    if not equations.split:
        return start
    parts = program.equations.memory.of(start)
    state = parts.z[: program.model.dimension]
    origin = state.astype(np.float32).astype(float)
    state -= origin
    return equations.memory.filled(**parts._replace(origin=origin)._asdict())


_READ = re.compile(r"arg\[(\d+)\]\? arg\[\d+\]\[(\d+)\] : 0")
_WRITTEN = re.compile(r"if \(res\[0\]!=0\) res\[0\]\[(\d+)\]=")
_NUMBER = re.compile(r"(?<![\w.])\d+\.\d*(?:e[+-]?\d+)?")
_CALLS = re.compile(r"\b(fabs|sqrt|a?sinh?|a?cosh?|a?tanh?|atan2|exp|log|pow)\(")


def _body(function: ca.Function, *, single: bool) -> str:
    """Return the statements of a function in C.

    CasADi generates them; their frame is removed, its names of inputs and outputs become those of the templates, and
    its helpers become the functions of the library.
    """
    generator = ca.CodeGenerator("tick", {"casadi_real": "dpc_real", "with_export": False})
    generator.add(function)
    lines = generator.dump().splitlines()
    begin = next(k for k, line in enumerate(lines) if line.startswith("static int casadi_f0("))
    end = lines.index("  return 0;", begin)
    body = "\n".join("    " + line.strip() for line in lines[begin + 1 : end])
    body = _READ.sub(lambda match: f"{_ARGUMENTS[int(match[1])]}[{match[2]}]", body)
    body = _WRITTEN.sub(r"out[\1]=", body)
    names = {"casadi_real": "dpc_real", "casadi_inf": "(dpc_real)INFINITY", "casadi_fabs(": "fabs("}
    for casadi_name, c_name in {**names, **{f"casadi_{name[4:]}(": f"{name}(" for name in _HELPERS}}.items():
        body = body.replace(casadi_name, c_name)
    body = _NUMBER.sub(lambda match: _c_number(float(match[0]), single=single), body)
    return _CALLS.sub(r"\1f(", body) if single else body


def _c_number(value: float, *, single: bool) -> str:
    """Return a number as C writes it, with the suffix f in single precision; without it, C computes in double."""
    if np.isinf(value):
        return "(dpc_real)INFINITY" if value > 0 else "(dpc_real)-INFINITY"
    text = str(np.float32(value)) if single else repr(float(value))
    text = text if set(text) & set(".e") else f"{text}."
    return f"{text}f" if single else text


def _table(name: str, values: Array, *, single: bool) -> str:
    """Return the declaration of a constant array of any dimension in C."""
    text = re.sub(r"[^][, ]+", lambda match: _c_number(float(match[0]), single=single), str(values.tolist()))
    sizes = "".join(f"[{size}]" for size in values.shape)
    braced = text.translate({ord("["): "{", ord("]"): "}\n"})
    return f"const dpc_real {name}{sizes} = {braced};\n"


def controller_source(
    program: TickProgram,
    controller: Controller,
    *,
    itinerary: str,
    title: str,
    single: bool,
    readings: str,
    clock: float | None = None,
) -> ControllerSource:
    """Return the C code of an initialised program and of its controller's gains.

    Args:
        program: initialised program of one run.
        controller: a law with gains by time.
        itinerary: name of the itinerary.
        title: title of the itinerary.
        single: use single precision.
        readings: readings and commands of a simulated run, in the format of main_replay.c.
        clock: clock of a Cortex-M4 for this rate, MHz.

    Raises:
        InputError: the tables are too large for compilers, or a tick takes too long at this clock.
    """
    double = program.equations
    equations = replace(double, same=SAME_IN_SINGLE, split=True) if single else double
    schedule, reference = (schedule_of(controller, lead) for lead in (program.lead, 0))
    assert schedule is not None
    assert reference is not None
    tables = _tables(equations, reference, single=single)
    if (count := tables.terms.size) > MOST_NUMBERS:
        raise InputError(
            f"export: the tables would have {count:,} numbers, but at most {MOST_NUMBERS:,} are allowed; "
            "lower --rate, or export a shorter itinerary"
        )
    function = _function(program, equations, tables)
    tick_s = None if clock is None else function.n_instructions() * CYCLES[single] / (1e6 * clock)
    if tick_s is not None and not tick_s <= program.period / 2:
        raise InputError(
            f"export: --clock {clock:g}: in {'single' if single else 'double'} precision a tick takes some "
            f"{1e3 * tick_s:.2g} ms at {clock:g} MHz and must leave half of its period of {1e3 * program.period:g} ms: "
            f"{'' if single else 'use --float, '}lower --rate, or choose a faster target"
        )
    placeholders = {
        "TITLE": _comment(f"{itinerary}: {title}"), "ITINERARY_COMMENT": _comment(itinerary),
        "ITINERARY": _string(itinerary), "LAW": _string(controller.kind),
        "IDENTITY": identity(program, schedule), "TICK": _body(function, single=single),
        **_described(program, equations, single=single), **_laid_out(equations),
        "TICKS": len(schedule.rows), "NAMES_OF_VALUES": ", ".join(tables.names),
        "PIECES": len(tables.terms), "LARGE": LARGE, "SMALL": SMALL, "VALUES": len(tables.columns),
    }  # fmt: skip
    placeholders["HELPERS"] = "\n".join(text for name, text in _HELPERS.items() if f"{name}(" in placeholders["TICK"])
    files = {name: _filled(name, placeholders) for name in _SOURCES}
    queued = schedule.queued if equations.lead else np.zeros(1)
    arrays = {"dpc_large": tables.terms[:, :LARGE], "dpc_start": _start(program, equations)}
    text = [_table(name, rows, single=single) for name, rows in {**arrays, "dpc_first_commands": queued}.items()]
    text.append(_table("dpc_small", tables.terms[:, LARGE:], single=True).replace("dpc_real", "float"))
    starts = f"const long dpc_pieces[DPC_PIECES + 1] = {{{', '.join(map(str, tables.starts.tolist()))}}};\n"
    files["dpc_tables.c"] = "\n".join(['#include "dpc_tables.h"\n\n#include <math.h>\n', starts, *text])
    width, seconds = 4 if single else 8, max(len(schedule.rows) - 1, 1) * program.period
    size = len(tables.columns) * len(tables.terms) * (width * LARGE + 4 * SMALL) + 4 * len(tables.starts)
    code, stack = _measured(files)
    figures = Figures(
        operations=function.n_instructions(), code=code, stack=stack,
        memory=width * equations.memory.size + ctypes.sizeof(ctypes.c_long),
        tables=size, tables_per_second=size / seconds if len(tables.terms) > 1 else 0.0,
        seconds_a_tick=tick_s,
    )  # fmt: skip
    placeholders |= {f"BYTES_{name.upper()}": kibibytes(value) for name, value in figures._asdict().items()}
    files |= {"README.md": _filled("README.md", placeholders), "readings.csv": readings}
    return ControllerSource(files, placeholders["IDENTITY"], figures)


def _described(program: TickProgram, equations: TickEquations, *, single: bool) -> dict[str, Any]:
    """Return the placeholders of the templates that describe arms, clock, bounds and arithmetic, by name."""
    n, extras = equations.filter.arms, equations.filter.extra_names
    bounds = {name: getattr(program.numbers, name).item(0)
              for name in ("acceleration", "lost_estimate", "lost_tracking", "missing")}  # fmt: skip
    columns = [*(f"measured.arm_{i + 1}" for i in range(n)), "measured.cart"]
    return {
        "VERSION": VERSION, "REAL": "float" if single else "double",
        "PRECISION": "single" if single else "double", "SPLIT": int(equations.split),
        "TOLERANCE": "2e-3" if single else "1e-9",
        "ARMS": n, "POSITIONS": n + 1, "STATES": equations.filter.equations.dimension,
        "EXTRAS": len(extras), "EXTRA_NAMES": ", ".join(extras) or "nothing",
        "RATE": repr(1 / program.period), "PERIOD": repr(program.period),
        "DELAY": repr(equations.whole + program.numbers.share.item(0)),
        "LEAD": equations.lead, "QUEUED": max(equations.lead, 1),
        **{name.upper(): repr(float(np.float32(bound)) if single else bound) for name, bound in bounds.items()},
        "PERIOD_REAL": _c_number(program.period, single=single), "SETTLING": _c_number(SETTLING, single=single),
        "COLUMNS": ", ".join(columns), "NAMES": ", ".join(f'"{name}"' for name in columns),
    }  # fmt: skip


def _laid_out(equations: TickEquations) -> dict[str, Any]:
    """Return the placeholders for the indices of memory and report, by which the C code reads the tick's results."""
    memory, report = equations.memory, equations.report
    read_in_c = ("z", "velocity", "heading", "stopped", "still", *(["origin"] if equations.split else []))
    places = {
        **{name: getattr(memory.slices, name).start for name in read_in_c},
        "sent_last": memory.slices.sent.stop - 1,
        **{name: memory.size + getattr(report.slices, name).start for name in report.names},
    }
    lines = "\n".join(f"    AT_{name.upper()} = {place}," for name, place in places.items())
    return {"MEMORY": memory.size, "PLACES": lines, "RESULTS": memory.size + report.size}


_SOURCES = (
    "dpc_controller.h", "dpc_controller.c", "dpc_tables.h", "main_replay.c", "main_udp.c", "Makefile", "CMakeLists.txt"
)  # fmt: skip
_HELPERS = {
    "dpc_sq": "static dpc_real dpc_sq(dpc_real x) { return x * x; }",
    "dpc_fmin": "static dpc_real dpc_fmin(dpc_real x, dpc_real y) { return x < y ? x : y; }",
    "dpc_fmax": "static dpc_real dpc_fmax(dpc_real x, dpc_real y) { return x > y ? x : y; }",
}


def _filled(name: str, known: Mapping[str, Any]) -> str:
    """Return a template with its placeholders between @ filled in by the values of `known`."""
    return re.sub(r"@([A-Z_]+)@", lambda match: str(known[match[1]]), (_TEMPLATES / name).read_text(encoding="utf-8"))


def _comment(text: str) -> str:
    """Return a text that is valid within a C comment."""
    plain = " ".join(text.split()).encode("ascii", "backslashreplace").decode()
    return plain.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").rstrip("\\")


def _string(text: str) -> str:
    """Return a text as a C string, with all but harmless characters in octal."""
    safe = frozenset(b"-_ .,:+()")
    return "".join(chr(byte) if (chr(byte).isalnum() and byte < 128) or byte in safe else f"\\{byte:03o}"
                   for byte in text.encode("utf-8", "replace"))  # fmt: skip


def _measured(files: Mapping[str, str]) -> tuple[int | None, int | None]:
    """Return the sizes of the controller's code and of a step's stack from gcc, in bytes.

    Both are None if gcc is missing or fails. `files`: texts of the C files by name.
    """
    with TemporaryDirectory(prefix="dpcontrol-") as name:
        folder = Path(name)
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8")
        flags = ["-std=c99", "-O2", "-ffp-contract=off", "-fno-asynchronous-unwind-tables", "-fstack-usage", "-c"]
        try:
            for command in (["gcc", *flags, "dpc_controller.c"], ["size", "dpc_controller.o"]):
                process = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=True)
            code = int(process.stdout.splitlines()[1].split()[0])
            usage = (folder / "dpc_controller.su").read_text(encoding="utf-8").splitlines()
            step_stack = sum(
                int(size)
                for place, size, *_ in (line.split("\t") for line in usage)
                if re.search(r":dpc_(step|tick)\b", place)
            )
        except (OSError, ValueError, LookupError, subprocess.SubprocessError):
            return None, None
    return code, step_stack


_COMPILED = ("dpc_controller.c", "dpc_tables.c", "fmu.c")
_IN_UNIT = ("dpc_controller.h", "dpc_controller.c", "dpc_tables.h", "dpc_tables.c")
_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared")
_PLATFORMS = {("Linux", "x86_64"): ("linux64", ".so"), ("Darwin", "x86_64"): ("darwin64", ".dylib")}
"""Folder and suffix of binaries on platforms that FMI 2.0 names and Unix compilers support."""
_EPOCH = (1980, 1, 1, 0, 0, 0)
_UNITS = {"rad": {"rad": 1}, "rad/s": {"rad": 1, "s": -1}, "m": {"m": 1}, "m/s": {"m": 1, "s": -1},
          "m/s2": {"m": 1, "s": -2}, "s": {"s": 1}}  # fmt: skip


@dataclass(frozen=True)
class Variable:
    """An input or output.

    kind: Real, Integer or Boolean; start: of an input.
    """

    name: str
    kind: str
    text: str
    unit: str = ""
    start: str = ""


def variables(first: Sequence[float], extras: Sequence[str]) -> list[Variable]:
    """Return a unit's variables, by kind in the order of `target/fmu.c`.

    Args:
        first: first state (2n+2,) of the reference.
        extras: names of the extra quantities.
    """
    n = len(first) // 2 - 1
    joints = [f"arm_{i + 1}" for i in range(n)] + ["cart"]
    starts = [*first[:n], first[2 * n]]
    states = [(f"{what}_{i + 1}", unit) for what, unit in (("angle", "rad"), ("rate", "rad/s")) for i in range(n)]
    states += [("cart_position", "m"), ("cart_velocity", "m/s")]
    deviations = [*states, *((name, "") for name in extras)]
    numbers = [
        ("command", "m/s2", "to the drive: the cart's acceleration for one period"),
        ("wish", "m/s2", "before limits: feedforward and feedback"),
        ("feedforward", "m/s2", "the reference's own"),
        ("feedback", "m/s2", "gains times the deviation"),
        ("acting", "m/s2", "in the next period, from pending commands"),
        ("nis", "", "normalised innovation squared"),
        ("mean_nis", "", "for each position, mean over 0.2 s"),
        ("error", "rad", "largest distance of an angle from the reference, mean over 1 s"),
        ("silent", "s", "since the position that is missing longest was measured"),
    ]
    return [
        *(Variable(f"measured_{joint}", "Real", "absolute position", "m" if joint == "cart" else "rad", repr(float(at)))
          for joint, at in zip(joints, starts, strict=True)),
        *(Variable(name, "Real", text, unit) for name, unit, text in numbers),
        *(Variable(name, "Real", "estimated", unit) for name, unit in states),
        *(Variable(f"reference_{name}", "Real", "of this tick", unit) for name, unit in states),
        *(Variable(f"ahead_{name}", "Real", "predicted for when the command acts", unit) for name, unit in states),
        *(Variable(f"sigma_{name}", "Real", "standard deviation", unit) for name, unit in deviations),
        *(Variable(name, "Real", "estimated") for name in extras),
        Variable("limit_switch", "Integer", "not 0 while a limit switch is touched", start="0"),
        Variable("outcome", "Integer", "of this step, enum dpc_outcome of dpc_controller.h"),
        Variable("stopped_by", "Integer", "the outcome that ended the run, else 0"),
        Variable("mode", "Integer", "enum dpc_mode"),
        Variable("used", "Integer", "positions in this step's estimate"),
        Variable("refused", "Integer", "values of this step's reading that are no readings"),
        Variable("sensor", "Integer", "number of a stuck sensor, from 1"),
        Variable("repeats", "Integer", "steps with the same reading"),
        Variable("untrusted", "Integer", "number of an extra beyond its trusted range, from 1"),
        Variable("status", "Integer", "enum dpc_run"),
        *(Variable(f"present_{joint}", "Boolean", "true if measured", start="true") for joint in joints),
        Variable("stop", "Boolean", "true while the cart brakes"),
        Variable("done", "Boolean", "true after 50 ms at rest"),
        Variable("saturated", "Boolean", "true if the command was cut"),
        Variable("newly_cut", "Boolean", "true at the first such step"),
    ]  # fmt: skip


def model_description(
    known: Sequence[Variable], *, name: str, identifier: str, guid: str, title: str, period: float, delay: float,
    ticks: int,
) -> bytes:  # fmt: skip
    """Return modelDescription.xml.

    Args:
        known: inputs and outputs of the unit.
        name: name of the model.
        identifier: name of its functions and binaries.
        guid: identity of the unit.
        title: title of the itinerary.
        period: duration of a step, s.
        delay: assumed delay of the commands, in periods.
        ticks: number of ticks.
    """
    advice = f"; let it act {delay - 1:g} periods later" if delay > 1 else ""
    root = ET.Element("fmiModelDescription", {
        "fmiVersion": "2.0", "modelName": name, "guid": guid, "variableNamingConvention": "flat",
        "generationTool": PROGRAM,
        "description": f"{title}: estimator, control law and supervisor, one tick per step of {period!r} s. Commands "
        f"must act {delay:g} periods after their readings; a step gives the command after one{advice}.",
    })  # fmt: skip
    unit = ET.SubElement(root, "CoSimulation", {"modelIdentifier": identifier})
    files = ET.SubElement(unit, "SourceFiles")
    for file in _COMPILED:
        ET.SubElement(files, "File", {"name": file})
    units = ET.SubElement(root, "UnitDefinitions")
    for text, powers in _UNITS.items():
        base = ET.SubElement(units, "Unit", {"name": text})
        ET.SubElement(base, "BaseUnit", {key: str(power) for key, power in powers.items()})
    ET.SubElement(ET.SubElement(root, "LogCategories"), "Category", {"name": "logStatusError"})
    experiment = {"startTime": "0", "stopTime": repr((ticks - 1) * period), "stepSize": repr(period)}
    ET.SubElement(root, "DefaultExperiment", experiment)
    variable_list = ET.SubElement(root, "ModelVariables")
    counts, outputs = {"Real": 0, "Integer": 0, "Boolean": 0}, []
    for k, variable in enumerate(known):
        role = {"causality": "input"} if variable.start else {"causality": "output", "initial": "calculated"}
        attributes = {"name": variable.name, "valueReference": str(counts[variable.kind]), "description": variable.text}
        element = ET.SubElement(variable_list, "ScalarVariable", {**attributes, **role, "variability": "discrete"})
        type_attributes = {"unit": variable.unit} if variable.unit else {}
        ET.SubElement(
            element, variable.kind, {**type_attributes, **({"start": variable.start} if variable.start else {})}
        )
        counts[variable.kind] += 1
        if not variable.start:
            outputs.append(str(k + 1))
    structure = ET.SubElement(root, "ModelStructure")
    for part in ("Outputs", "InitialUnknowns"):
        unknowns = ET.SubElement(structure, part)
        for index in outputs:
            # Outputs depend on the inputs of the previous step.
            ET.SubElement(unknowns, "Unknown", {"index": index, "dependencies": ""})
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True)


@dataclass(frozen=True)
class Unit:
    """A co-simulation unit: bytes of the archive, and in `lacks` the reason why the binary is missing, else ""."""

    archive: bytes
    lacks: str


def controller_unit(
    source: ControllerSource, program: TickProgram, controller: Controller, *, name: str, title: str, delay: float
) -> Unit:
    """Return the unit of a controller's C code.

    Args:
        source: C code of the controller.
        program: program that it was made from.
        controller: the law.
        name: name of the unit.
        title: title of the itinerary.
        delay: delay of the commands, in periods.
    """
    template = (_TEMPLATES / "fmu.c").read_text(encoding="utf-8")
    sources = {file: text for file, text in source.files.items() if file in _IN_UNIT}
    guid = content_hash(template, *sources.values())
    sources["fmu.c"] = template.replace("@GUID@", guid)
    identifier = re.sub(r"\W", "_", name, flags=re.ASCII)
    identifier = identifier if identifier[:1].isalpha() else f"dpc_{identifier}"
    unit_variables = variables(controller.first_state.tolist(), program.equations.filter.extra_names)
    description = model_description(
        unit_variables, name=name, identifier=identifier, guid=guid, title=title, period=program.period, delay=delay,
        ticks=controller.ticks + 1,
    )  # fmt: skip
    binary, lacks = _binary(sources)
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        _add(archive, "modelDescription.xml", description)
        for file, text in sources.items():
            _add(archive, f"sources/{file}", text.encode())
        if binary is not None:
            folder, ending = _PLATFORMS[_here()]
            _add(archive, f"binaries/{folder}/{identifier}{ending}", binary)
    return Unit(stream.getvalue(), lacks)


def _here() -> tuple[str, str]:
    """Return the names of the operating system and of the processor, as in `_PLATFORMS`."""
    return platform.system(), platform.machine()


def _add(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    """Add a file to an archive, with a constant date, so that the same content gives the same bytes."""
    entry = zipfile.ZipInfo(name, _EPOCH)
    entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
    archive.writestr(entry, content)


def _binary(sources: Mapping[str, str]) -> tuple[bytes | None, str]:
    """Return the shared library of a unit for this platform, and "", or None and the reason for its absence.

    `sources`: texts of the C files by name.
    """
    if _here() not in _PLATFORMS:
        return None, f"FMI 2.0 has no name for a binary of {' '.join(_here())}: the unit has its sources only"
    compiler = next(filter(None, map(shutil.which, ("gcc", "cc", "clang"))), None)
    if compiler is None:
        return None, "there is no C compiler here: the unit has its sources only, which tools can compile"
    with TemporaryDirectory(prefix="dpcontrol-") as name:
        folder = Path(name)
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8")
        command = [compiler, *_FLAGS, "-o", "unit", *_COMPILED, "-lm"]
        process = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if process.returncode:
            reason = (process.stderr.strip().splitlines() or ["it gave no reason"])[0]
            return None, f"{compiler} did not compile the unit ({reason}): it has its sources only"
        return (folder / "unit").read_bytes(), ""
