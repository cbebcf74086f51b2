"""Hypothesis strategies for hostile arguments and damaged files.

A trial is a call of the command line with arguments, and files that replace those of the laboratory.
"""

import io
import json
import re
import struct
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import click
import numpy as np
from hypothesis import strategies as st
from laboratory import SPECIAL, Laboratory

from dpcontrol.cli import main
from dpcontrol.cli.main import cli
from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import LogWriter, read_log

VERBS = [verb for verb in main.VERBS if verb != "planner"]
"""All verbs except the one that serves until it is interrupted."""

NUMBERS = (
    "nan", "sNaN", "-inf", "1e400", "1e300", "-1", "0", "-0", "1e-320", "2", "0.5", "99999999999999999999", "9" * 400,
    "2147483648", "0x10", "1_0", "½", "", "1,2", "1e9999999999", "-",
)  # fmt: skip
"""Invalid and problematic numbers."""
TEXTS = (
    "", "-", "--", "~", "..", "[/nope]", "[link=x]y[/link]", "\x1b[31mred\x1b[0m", "\x1b]0;title\x07", "é" * 240,
    "a\nb", "a\rb", "a\0b", "%s%n{0}", "\u202egpj", "\udcff", "lab", "lab.toml", "no/such", "down-up", "up-up", "L1",
    "down-up +", "down-up > up-down", "down-up > outer-rotating", "(" * 200 + "down-up +" + ")" * 200,
    "(down-up +)·99999999999999999999·(down-up -)", "(down-up +)·" * 60, "down-up + 1 1,9", "ekf", "nan,gaps", "tvlqr",
)  # fmt: skip
"""Names and symbols, also valid ones, because they are parsed before bad options."""
TOML = (
    *("nan", "inf", "1e400", "-1", "0", "1e-300", "1e300", "7", "99999999999999999999", "1" * 5000, "true", '""'),
    *('"[/nope]"', r'"\u001b[31mred"', r'"a\u0000b"', f'"{"n" * 240}"', '"lab"', '"down-up"', "[]", "[[]]", "{a = 1}"),
    *("[1, 'a']", "[nan, nan]", "[1e300, 1e300]", "[1.0]", "1979-05-27T07:32:00Z", '["down-up +", "down-up -"]'),
)
"""Values of TOML."""
FLOATS = (float("nan"), float("inf"), 1e300, -1e300, 0.0, 1e9)
JSON = (None, True, -1, 0, 10**400, 1e300, float("nan"), "", "[/nope]", "\x1b[31m", [], {"a": 1}, [None], [10**12])
"""Values of a header."""


@dataclass(frozen=True)
class Trial:
    arguments: tuple[str, ...]
    files: Mapping[str, bytes] = field(default_factory=dict)

    def __repr__(self) -> str:
        sizes = {name: f"{len(content)} bytes" for name, content in self.files.items()}
        return f"Trial({' '.join(ascii(a) for a in self.arguments)}{f', {sizes}' if sizes else ''})"


BASES: dict[str, tuple[str, ...]] = {
    "demo": ("--itinerary=rest.toml --folder=made",),
    "model": ("lab.toml", "three-body", "lab.toml --out=copied.toml"),
    "cache": ("",),
    "guide": ("start",),
    "orbit": ("lab.toml --saddle=down-up --energy=-0.07", "three-body --saddle=L1 --energy=-1.5"),
    "connect": ("lab.toml --from=down-up --to=down-up --energy=-0.07",),
    "bifurcations": ("lab --from=down-up --to=down-up --energies -0.3 -0.2 --samples=2",),
    "atlas": ("lab.toml --energy=-0.07",),
    "walk": ("lab.toml --energy=-0.07", "lab --energy=-0.07 --random=2"),
    "prove": ("orbit lab.toml --saddle=down-up --energy=-0.07", "check rest.toml"),
    "plan": ("rest.toml",),
    "reference": ("reference.npz",),
    "run": ("rest.toml", "--from=run.mcap"),
    "campaign": ("rest.toml --runs=2 --workers=1",),
    "commission": ("rest.toml --seed=1",),
    "learn": ("run.mcap",),
    "preflight": ("rest.toml --runs=3 --workers=1",),
    "rig": ("rest.toml --runs=1",),
    "export": ("rest.toml --out=exported",),
    "schema": ("model",),
    "config": ("",),
    "score": ("run.mcap",),
    "review": ("run.mcap --save=out.rrd", "reference.npz --save=out.rrd"),
    "report": ("run.mcap", "campaign.parquet"),
    "info": ("run.mcap",),
    "recover": ("cut.mcap.partial",),
    "import": ("swing.csv", "--simulated=lab.toml --swings=2 --seconds=0.3"),
    "identify": ("swings.mcap",),
    "replay": ("swings.mcap --model=lab.toml",),
    "figures": ("nosuch",),
    "bench": ("nosuch",),
}
"""Fast or refused calls by verb."""
LEFT = {
    "bifurcations": {"energies"},
    "cache": {"clear"},
    "campaign": {"standard", "workers"},
    "commission": {"address"},
    "preflight": {"runs", "workers"},
    "figures": {"names"},
    "bench": {"names"},
    "run": {"address"},
}
"""Options that start processes, wait for networks or take minutes, with separate tests.
The option --debug prints a traceback.
"""


@cache
def parameters(verb: str) -> tuple[click.Parameter, ...]:
    command = cli.get_command(click.Context(cli), verb)
    assert command is not None
    return tuple(p for p in command.params if p.name not in {"debug", *LEFT.get(verb, ())})


def paths(laboratory: Laboratory) -> st.SearchStrategy[str]:
    """Return file names: valid, of the wrong kind, devices, links, folders and empty ones."""
    odd = (*SPECIAL, "", ".", "..", "no/such/file", "new.mcap", "new.png", "new.npz", "run.mcap/within", "n" * 240)
    odd += ("n" * 240 + ".npz", "é" * 200 + ".png", "[/nope].png", "\x1b[31m.mcap", "a\nb.toml", "a\0b.npz")
    return st.sampled_from((*odd, *laboratory.names))


def _value(param_type: click.ParamType, laboratory: Laboratory) -> st.SearchStrategy[str]:
    if isinstance(param_type, click.Path):
        return paths(laboratory)
    if isinstance(param_type, click.Choice):
        return st.sampled_from((*map(str, param_type.choices), *TEXTS))
    if isinstance(param_type, click.types.IntParamType | click.types.FloatParamType) or param_type.name == "number":
        return st.sampled_from(NUMBERS)
    return st.sampled_from((*TEXTS, *NUMBERS))


@st.composite
def option_trials(draw: st.DrawFn, verb: str, laboratory: Laboratory) -> Trial:
    words = draw(st.sampled_from(BASES[verb])).split()
    positional, given = [w for w in words if w[0] != "-"], [w for w in words if w[0] == "-"]
    for _ in range(draw(st.integers(1, 3))):
        parameter = draw(st.sampled_from(parameters(verb)))
        if isinstance(parameter, click.Argument):
            text = draw(st.one_of(paths(laboratory), st.sampled_from(TEXTS)))
            positional = [text, *positional[1:]] if draw(st.booleans()) else [*positional, text]
            continue
        assert isinstance(parameter, click.Option)
        name = draw(st.sampled_from((*parameter.opts, *parameter.secondary_opts)))
        if parameter.is_flag:
            given.append(name)
        elif parameter.nargs > 1:
            kind = parameter.type
            kinds = kind.types if isinstance(kind, click.Tuple) else [kind] * parameter.nargs
            given += [name, *(draw(_value(one, laboratory)) for one in kinds)]
        elif name.startswith("--"):
            given.append(f"{name}={draw(_value(parameter.type, laboratory))}")
        else:
            given += [name, draw(_value(parameter.type, laboratory))]
    return Trial((verb, *given, "--", *positional))


Bytes = Callable[[st.DrawFn, bytes], bytes]


def damaged(draw: st.DrawFn, content: bytes) -> bytes:
    """Return bytes with flipped, deleted, repeated, zeroed or replaced parts."""
    changed = bytearray(content)
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, max(0, len(changed) - 1)))
        span = draw(st.sampled_from((1, 2, 8, 100, 4096)))
        part = changed[at : at + span]
        number = struct.pack("<Q", draw(st.sampled_from((0, 2**63, 2**64 - 1, 2**32, 1 << 40))))
        flipped = bytes(byte ^ 1 for byte in part[:1]) + part[1:]
        changed[at : at + span] = draw(st.sampled_from((b"", part + part, bytes(len(part)), number, flipped)))
        if not draw(st.integers(0, 6)):
            del changed[at:]
    return bytes(changed)


_NUMBER = re.compile(r"(?<![\w\"-])-?\d+\.?\d*(?:e-?\d+)?(?![\w\"-])")


def toml_changed(draw: st.DrawFn, content: bytes) -> bytes:
    """Return TOML with values, keys and lines changed."""
    lines = content.decode().splitlines()
    keyed = [k for k, line in enumerate(lines) if "=" in line and not line.lstrip().startswith("#")]
    for _ in range(draw(st.integers(1, 3))):
        k = draw(st.sampled_from(keyed))
        key = lines[k].partition("=")[0]
        match draw(st.integers(0, 7)):
            case 0:
                lines[k] = ""
            case 1:
                lines[k] = f"{lines[k]}\n{lines[k]}"
            case 3 | 4 if numbers := list(_NUMBER.finditer(lines[k].partition("#")[0])):
                found = draw(st.sampled_from(numbers))
                scaled = float(found[0]) * draw(st.sampled_from((-1, 0, 0.3, 0.999, 1.2, 2, 30, 1e6, 1e-6, 1e-300)))
                lines[k] = f"{lines[k][: found.start()]}{scaled!r}{lines[k][found.end() :]}"
            case 2:
                lines[k] = f"[{draw(st.sampled_from(('run', 'limits', '/nope', 'parts', '[parts]', 'x' * 240, '')))}]"
            case _:
                lines[k] = f"{key}= {draw(st.sampled_from(TOML))}"
    text = "\n".join(lines).encode(errors="surrogatepass")
    return damaged(draw, text) if draw(st.integers(0, 9)) == 0 else text


def csv_changed(draw: st.DrawFn, content: bytes) -> bytes:
    """Return a table with a cell, row or column changed."""
    rows = [line.split(",") for line in content.decode().splitlines()]
    for _ in range(draw(st.integers(1, 4))):
        k, column = draw(st.integers(0, len(rows) - 1)), draw(st.integers(0, 3))
        match draw(st.integers(0, 3)):
            case 0:
                rows.insert(k, rows[draw(st.integers(0, len(rows) - 1))])
            case 1:
                value = draw(st.sampled_from(NUMBERS))
                rows = [rows[0], *([*row[:column], value, *row[column + 1 :]] for row in rows[1:])]
            case 2:
                rows[k] = rows[k][:column]
            case _ if column < len(rows[k]):
                rows[k][column] = draw(st.sampled_from((*NUMBERS, *TEXTS, '"', "\ufeff")))
    text = "\n".join(",".join(row) for row in rows).encode(errors="surrogatepass")
    return damaged(draw, text) if draw(st.integers(0, 9)) == 0 else text


def json_changed(draw: st.DrawFn, value: Any) -> Any:
    """Return a JSON value with one entry changed or removed."""
    if not draw(st.integers(0, 5)) or not isinstance(value, dict) or not value:
        return draw(st.sampled_from(JSON))
    key = draw(st.sampled_from(sorted(value)))
    if not draw(st.integers(0, 9)):
        return {name: one for name, one in value.items() if name != key}
    return {**value, key: json_changed(draw, value[key])}


def array_changed(draw: st.DrawFn, array: np.ndarray) -> np.ndarray:
    """Return an array with another value, shape or type."""
    match draw(st.integers(0, 4)):
        case 0 if array.dtype.kind in "if":
            return array.astype(draw(st.sampled_from(("int8", "complex128", "U5", "M8[s]", ">f8"))))
        case 1:
            return array[: draw(st.integers(0, 2))] if array.ndim else np.zeros(3)
        case 2:
            return array.reshape(-1) if draw(st.booleans()) else array[None]
        case _ if array.size and array.dtype.kind in "if":
            changed = array.copy()
            worst = (0, -1, 10**9) if array.dtype.kind == "i" else FLOATS
            changed.flat[draw(st.integers(0, array.size - 1))] = draw(st.sampled_from(worst))
            return changed
    return array


_LIES = (
    "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }",
    "{'descr': '|O', 'fortran_order': False, 'shape': (3,), }",
    "[" * 9000,
)
"""Headers of arrays that do not match their data."""


def npz_changed(draw: st.DrawFn, content: bytes) -> bytes:
    if draw(st.integers(0, 3)) == 0:
        return damaged(draw, content)
    with zipfile.ZipFile(io.BytesIO(content)) as file:
        entries = {name: file.read(name) for name in file.namelist()}
    name = "header.npy" if draw(st.booleans()) and "header.npy" in entries else draw(st.sampled_from(sorted(entries)))
    array, buffer = np.load(io.BytesIO(entries[name])), io.BytesIO()
    match draw(st.integers(0, 9)):
        case 0:
            del entries[name]
        case 1:
            lie = draw(st.sampled_from(_LIES)).encode()
            entries[name] = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(lie) + 1) + lie + b"\n" + bytes(64)
        case choice:
            if choice == 2 and name == "header.npy":
                array = np.array(draw(st.sampled_from(("", "{", "null", '"x"', "NaN", "[" * 5000))))
            elif name == "header.npy":
                array = np.array(json.dumps(json_changed(draw, json.loads(str(array)))))
            else:
                array = array_changed(draw, array)
            np.save(buffer, array)
            entries[name] = buffer.getvalue()
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as file:
        for entry, data in entries.items():
            file.writestr(entry, data)
    return packed.getvalue()


def log_changed(draw: st.DrawFn, content: bytes) -> bytes:
    return damaged(draw, content) if draw(st.integers(0, 3)) == 0 else _written_again(draw, content)


def _written_again(draw: st.DrawFn, content: bytes) -> bytes:
    """Return a log by the program's writer, with values that no run would log."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "run.mcap"
        path.write_bytes(content)
        log = read_log(path)
        keep = slice(None, draw(st.sampled_from((None, None, None, 0, 1, 2, 17))))
        metadata, attachments, rate, limits = dict(log.metadata), dict(log.attachments), log.rate_hz, log.limits
        lengths, time = log.arm_lengths, log.time[keep]
        rows: dict[str, np.ndarray | None] = {"measured": log.measured, "rates": log.rates, **log.states}
        rows["control"] = np.column_stack(list(log.controls.values())) if log.controls else None
        rows = {part: None if values is None else values[keep] for part, values in rows.items()}
        match draw(st.sampled_from(("metadata", "attachment", "rate", "limits", "lengths", "time", "rows"))):
            case "metadata":
                key = draw(st.sampled_from(sorted(metadata)))
                worst = ("", "[/nope]", "\x1b[31m", "{", "1e400", "nan", "-1", "null", "[" * 5000, "9" * 5000)
                metadata[key] = draw(st.sampled_from(worst))
            case "attachment" if attachments:
                file = draw(st.sampled_from(sorted(attachments)))
                change = {"toml": toml_changed, "npz": npz_changed}.get(file.rpartition(".")[2], damaged)
                attachments[file] = change(draw, attachments[file])
            case "rate":
                rate = draw(st.sampled_from((1e-9, 1.0, 100.0, 1e5)))
            case "limits":
                limits = draw(st.sampled_from((None, (0.0, 0.0, 0.0), (1e300, 1.0, 1.0), (-1.0, -1.0, -1.0))))
            case "lengths":
                lengths = draw(st.sampled_from(((0.0,), (1e300,), (-1.0,), (float("nan"),)))) * len(lengths)
            case "time":
                shift = draw(st.sampled_from((0.0, 0.5, 1.0, -1.0, 1e-9, 1e3, 1e8)))
                time = draw(st.sampled_from((time[::-1], shift * time, time + shift)))
            case "rows" if len(time):
                part = draw(st.sampled_from(sorted(p for p, values in rows.items() if values is not None)))
                values = rows[part].copy()
                values[draw(st.integers(0, len(values) - 1)) :] = draw(st.sampled_from(FLOATS))
                rows[part] = values if part == "measured" or draw(st.integers(0, 5)) else None
        try:
            with LogWriter(
                path, arm_lengths=lengths, rate_hz=rate, has_cart=log.has_cart, limits=limits,
                metadata={key: value for key, value in metadata.items() if key != "crc32"}, attachments=attachments,
            ) as writer:  # fmt: skip
                writer.ticks(time, **rows)
                for event in log.events:
                    writer.event(replace(event, words=draw(st.sampled_from((event.text, *TEXTS[:20])))))
        except (ValueError, InputError, struct.error, ArithmeticError):
            # The writer itself refuses it.
            return damaged(draw, content)
        return path.read_bytes()


_LOG_CALLS = (
    "info {}", "score {}", "recover {} --out=new.mcap", "review {} --save=new.rrd", "report {} --picture=new.png",
    "run --from={}", "replay {} --out=new.mcap", "identify {} --out=new.toml",
)  # fmt: skip
KINDS: dict[str, tuple[str, Bytes, tuple[str, ...]]] = {
    "scene": ("rest.toml", toml_changed, ("plan {}", "run {}", "campaign {} --runs=2 --workers=1")),
    "walk": ("turn.toml", toml_changed, ("plan {}",)),
    "model": ("lab.toml", toml_changed, ("model {}", "orbit {} --saddle=down-up --energy=0.1", "run with-model.toml")),
    "three-body": ("moon.toml", toml_changed, ("model {}", "orbit {} --saddle=L1 --energy=-1.5")),
    "table": ("swing.csv", csv_changed, ("import {}", "import {} --repair=nan,time,gaps,wrap,spikes")),
    "mapping": ("mapping.toml", toml_changed, ("import swing.csv --mapping={}",)),
    "reference": ("reference.npz", npz_changed, ("reference {}", "review {} --save=new.rrd")),
    "log": ("run.mcap", log_changed, _LOG_CALLS),
    "recording": ("swings.mcap", log_changed, _LOG_CALLS),
    "campaign": ("campaign.parquet/0.parquet", damaged, ("report campaign.parquet --picture=new.png",)),
}
"""Kinds of file: its name in the laboratory, its changes, and the calls that read it."""


@st.composite
def file_trials(draw: st.DrawFn, kind: str, laboratory: Laboratory) -> Trial:
    file, change, calls = KINDS[kind]
    call = draw(st.sampled_from(calls))
    return Trial(tuple(call.format(file).split()), {file: change(draw, laboratory.files[file])})
