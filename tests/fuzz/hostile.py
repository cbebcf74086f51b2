"""Hypothesis strategies for hostile arguments and damaged files.

A trial is a call of the command line with arguments, and files that replace those of the laboratory.
"""

import io
import json
import re
import struct
import tempfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import click
import numpy as np
from hypothesis import strategies as st
from laboratory import SPECIAL, Laboratory
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from dpcontrol.cli import main
from dpcontrol.cli.main import cli
from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import LogWriter, read_log
from dpcontrol.logs.container import sealed

VERBS = [verb for verb in main.VERBS if verb != "planner"]
"""All verbs except the one that serves until it is interrupted."""

NUMBERS = (
    "nan", "sNaN", "-nan", "inf", "-inf", "1e400", "-1e400", "1e300", "-1", "0", "-0", "1e-320", "1e-9", "2", "0.5",
    "7", "99999999999999999999", "-99999999999999999999", "9" * 400, "2147483648", "0x10", "1_0", "½", "١٢", "", " ",
    "1,2", "1e9999999999", "+", "-",
)  # fmt: skip
"""Invalid and problematic numbers."""
TEXTS = (
    "", " ", "-", "--", "~", ".", "..", "[/nope]", "[bold]x", "[link=x]y[/link]", "\x1b[31mred\x1b[0m",
    "\x1b]0;title\x07",
    "n" * 240, "é" * 240, "a\nb", "a\rb", "a\0b", "%s%n{0}", "\u202egpj", "\udcff", "lab", "lab.toml", "nosuch",
    "no/such", "down-up", "up-down", "up-up", "L1", "down-up +", "down-up > up-down", "down-up > outer-rotating",
    "outer-rotating-9",
    "(down-up +)·1·(down-up -)", "(" * 200 + "down-up +" + ")" * 200, "(down-up +)·99999999999999999999·(down-up -)",
    "(down-up +)·" * 60, "down-up + 1 1,9", "aligned", "ekf", "ogy", "nan,gaps", "tvlqr",
)  # fmt: skip
"""Names and symbols, also valid ones, because they are parsed before bad options."""
TOML = (
    *("nan", "inf", "-inf", "1e400", "-1", "0", "1e-300", "1e300", "7", "99999999999999999999", "1" * 5000, "true"),
    *('""', '"[/nope]"', r'"\u001b[31mred"', r'"a\u0000b"'),
    *(f'"{"n" * 240}"', '"a\\nb"', '"lab"', '"down-up"', '"nosuch"', "[]", "[[]]"),
    *("[1, 'a']", "[nan, nan]", "[1e300, 1e300]", "[-1.0, 0.0]", "[1.0]", "[1.0, 1.0, 1.0]", "{}", "{a = 1}"),
    *("1979-05-27T07:32:00Z", "[" * 200 + "]" * 200, '["down-up +"]', '["down-up +", "down-up -"]', "[99999999999999]"),
)
"""Values of TOML."""
FLOATS = (float("nan"), float("inf"), 1e300, -1e300, 0.0, 1e9)
JSON = (
    *(None, True, -1, 0, 7, 10**20, 10**400, 1e300, float("nan"), float("inf"), "", "[/nope]", "\x1b[31m", "n" * 240),
    *([], [[]], {}, {"a": 1}, [1, "a"], [None], "down-up", [10**12], [[10**9, 10**9]]),
)
"""Values of a header."""


@dataclass(frozen=True)
class Trial:
    """Arguments of `dpcontrol`, and contents of replaced files by name."""

    arguments: tuple[str, ...]
    files: Mapping[str, bytes] = field(default_factory=dict)

    def __repr__(self) -> str:
        sizes = {name: f"{len(content)} bytes" for name, content in self.files.items()}
        return f"Trial({' '.join(ascii(a) for a in self.arguments)}{f', {sizes}' if sizes else ''})"


BASES: dict[str, tuple[tuple[tuple[str, ...], tuple[str, ...]], ...]] = {
    "demo": (((), ("--itinerary=rest.toml", "--folder=made")),),
    "model": ((("lab.toml",), ()), (("triple",), ()), (("three-body",), ())),
    "cache": (((), ()),),
    "guide": (((), ()), (("start",), ())),
    "orbit": (
        (("lab.toml",), ("--saddle=down-up", "--energy=-0.07")),
        (("lab",), ("--rotating=outer", "--energy=0.3")),
        (("triple",), ("--saddle=down-down-up", "--energy=-0.1")),
        (("three-body",), ("--saddle=L1", "--energy=-1.5")),
    ),
    "connect": ((("lab.toml",), ("--from=down-up", "--to=down-up", "--energy=-0.07")),),
    "bifurcations": ((("lab",), ("--from=down-up", "--to=down-up", "--energies", "-0.3", "-0.2", "--samples=2")),),
    "atlas": ((("lab.toml",), ("--energy=-0.07",)),),
    "walk": (
        (("lab.toml",), ("--energy=-0.07",)),
        (("lab",), ("--energy=-0.07", "-s", "down-up +", "-s", "down-up -", "--solve")),
        (("lab",), ("--energy=-0.07", "--random=2")),
        (("lab",), ("--energy=-0.07", "--through=down-up", "--through=down-up")),
        (("lab",), ("--energy=-0.07", "--length=2")),
    ),
    "prove": ((("orbit", "lab.toml"), ("--saddle=down-up", "--energy=-0.07")), (("check", "rest.toml"), ())),
    "plan": ((("rest.toml",), ()),),
    "reference": ((("reference.npz",), ()),),
    "run": ((("rest.toml",), ()), ((), ("--from=run.mcap",))),
    "campaign": ((("rest.toml",), ("--runs=2", "--workers=1")),),
    "commission": ((("rest.toml",), ("--seed=1",)),),
    "preflight": ((("rest.toml",), ("--runs=3", "--workers=1")),),
    "rig": ((("rest.toml",), ("--runs=1",)),),
    "export": ((("rest.toml",), ("--out=exported",)), (("rest.toml",), ("--rate=100", "--out=exported"))),
    "schema": ((("model",), ()), (("itinerary",), ())),
    "config": (((), ()),),
    "score": ((("run.mcap",), ()), (("run.mcap", "swings.mcap"), ())),
    "review": (
        (("run.mcap",), ("--save=out.rrd",)),
        (("reference.npz",), ("--save=out.rrd",)),
        (("atlas.npz",), ("--save=out.rrd",)),
        (("run.mcap", "run.mcap"), ("--save=out.rrd",)),
    ),
    "report": ((("run.mcap",), ()), (("campaign.parquet",), ())),
    "info": ((("run.mcap",), ()),),
    "recover": ((("run.mcap",), ()), (("cut.mcap.partial",), ())),
    "import": (
        (("swing.csv",), ()),
        (("swing.csv",), ("--mapping=mapping.toml", "--repair=nan")),
        ((), ("--simulated=lab.toml", "--swings=2", "--seconds=0.3")),
    ),
    "identify": ((("swings.mcap",), ()),),
    "replay": ((("swings.mcap",), ("--model=lab.toml",)), (("run.mcap",), ())),
    "figures": ((("nosuch",), ()), (("tubes", "nosuch"), ())),
    "bench": ((("nosuch",), ()), (("propagation", "nosuch"), ())),
}
"""Fast or refused calls by verb, as positional arguments and options."""
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
    """Return the click parameters of a verb."""
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
    """Draw a call of a verb with one to three changed parameters."""
    alone, options = draw(st.sampled_from(BASES[verb]))
    positional, given = list(alone), list(options)
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
    """Return bytes with flipped, deleted, repeated, zeroed or inserted parts."""
    changed = bytearray(content)
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, max(0, len(changed) - 1)))
        span = draw(st.sampled_from((1, 2, 8, 100, 4096)))
        match draw(st.sampled_from(("flip", "cut", "lose", "repeat", "zero", "insert", "number"))):
            case "flip" if changed:
                changed[at] ^= 1 << draw(st.integers(0, 7))
            case "cut":
                del changed[at:]
            case "lose":
                del changed[at : at + span]
            case "repeat":
                changed[at:at] = changed[at : at + span]
            case "zero":
                changed[at : at + span] = bytes(len(changed[at : at + span]))
            case "insert":
                changed[at:at] = draw(st.binary(min_size=1, max_size=16))
            case "number":
                changed[at : at + 8] = struct.pack("<Q", draw(st.sampled_from((0, 2**63, 2**64 - 1, 2**32, 1 << 40))))
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
    """Return a table with cells, rows and columns changed."""
    rows = [line.split(",") for line in content.decode().splitlines()]
    for _ in range(draw(st.integers(1, 4))):
        k = draw(st.integers(0, len(rows) - 1))
        column = draw(st.integers(0, max(0, len(rows[0]) - 1)))
        match draw(st.integers(0, 7)):
            case 0:
                rows.insert(k, rows[draw(st.integers(0, len(rows) - 1))])
            case 1:
                del rows[k : k + draw(st.sampled_from((1, 50, 500)))]
                rows = rows or [[""]]
            case 2:
                rows = [[*row, *row[column : column + 1]] for row in rows]
            case 3:
                value = draw(st.sampled_from(NUMBERS))
                rows = [rows[0], *([*row[:column], value, *row[column + 1 :]] for row in rows[1:])]
            case 4:
                rows[k] = rows[k][: draw(st.integers(0, 3))]
            case _ if column < len(rows[k]):
                rows[k][column] = draw(st.sampled_from((*NUMBERS, *TEXTS, '"', "\ufeff")))
    text = "\n".join(",".join(row) for row in rows).encode(errors="surrogatepass")
    return damaged(draw, text) if draw(st.integers(0, 9)) == 0 else text


def json_changed(draw: st.DrawFn, value: Any) -> Any:
    """Return a JSON value with one entry changed or removed."""
    if not draw(st.integers(0, 5)) or not isinstance(value, dict | list) or not value:
        return draw(st.sampled_from(JSON))
    if isinstance(value, dict):
        key = draw(st.sampled_from(sorted(value)))
        if not draw(st.integers(0, 9)):
            return {name: one for name, one in value.items() if name != key}
        return {**value, key: json_changed(draw, value[key])}
    k = draw(st.integers(0, len(value) - 1))
    if not draw(st.integers(0, 9)):
        return [*value[:k], *value[k + 1 :]]
    return [*value[:k], json_changed(draw, value[k]), *value[k + 1 :]]


def array_changed(draw: st.DrawFn, array: np.ndarray) -> np.ndarray:
    """Return an array with other values, shape or type."""
    match draw(st.integers(0, 7)):
        case 0 if array.dtype.kind in "if":
            return array.astype(draw(st.sampled_from(("int8", "float16", "complex128", "U5", "bool", "M8[s]", ">f8"))))
        case 1:
            return array[: draw(st.integers(0, 2))] if array.ndim else np.zeros(3)
        case 2:
            return array.reshape(-1) if draw(st.booleans()) else array[None]
        case 3:
            return np.array(draw(st.sampled_from(("", "x", 0.0, float("nan")))))
        case 4 if array.ndim:
            return array[::-1]
        case _ if array.size and array.dtype.kind in "if":
            changed = array.astype(float) if array.dtype.kind == "f" else array.copy()
            worst = (0, -1, 10**9) if array.dtype.kind == "i" else (*FLOATS, -1.0, 1e-320)
            value = draw(st.sampled_from(worst))
            if draw(st.booleans()):
                changed[...] = value
            else:
                changed.flat[draw(st.integers(0, array.size - 1))] = value
            return changed
    return array


_LIES = (
    "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }",
    "{'descr': '<U999999999', 'fortran_order': False, 'shape': (), }",
    "{'descr': '|O', 'fortran_order': False, 'shape': (3,), }",
    "{'descr': [('a', '<f8'), ('a', '<f8')], 'fortran_order': True, 'shape': (2,), }",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999999999999999,), }",
    "{'descr': '<f8', 'fortran_order': False, 'shape': " + "(" * 150 + ")" * 150 + ", }",
    "{'descr': '<f8'",
    "[" * 9000,
)
"""Headers of arrays that do not match their data."""


def npz_changed(draw: st.DrawFn, content: bytes) -> bytes:
    """Return an archive with changed header, arrays or bytes."""
    if draw(st.integers(0, 3)) == 0:
        return damaged(draw, content)
    with zipfile.ZipFile(io.BytesIO(content)) as file:
        whole = {name: file.read(name) for name in file.namelist()}
    entries = dict(whole)
    for _ in range(draw(st.integers(1, 2))):
        name = draw(st.sampled_from(sorted(entries)))
        if draw(st.booleans()):
            name = "header.npy"
        if name not in entries:
            continue
        try:
            array = np.load(io.BytesIO(whole[name]))
        except (ValueError, EOFError, SyntaxError):
            # An earlier change has left no array.
            continue
        match draw(st.integers(0, 9)):
            case 0:
                del entries[name]
                continue
            case 1:
                lie = draw(st.sampled_from(_LIES)).encode()
                entries[name] = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(lie) + 1) + lie + b"\n" + bytes(64)
                continue
            case 2 if name == "header.npy":
                deep = "[" * 5000, '{"a":' * 2000
                array = np.array(draw(st.sampled_from(("", "{", "{}", "null", '"x"', "NaN", *deep))))
            case _ if name == "header.npy":
                array = np.array(json.dumps(json_changed(draw, json.loads(str(array)))))
            case _:
                array = array_changed(draw, array)
        buffer = io.BytesIO()
        np.save(buffer, array)
        entries[name] = buffer.getvalue()
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", draw(st.sampled_from((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)))) as file:
        for name, data in entries.items():
            file.writestr(name, data)
    return packed.getvalue()


def log_changed(draw: st.DrawFn, content: bytes) -> bytes:
    """Return a log that is damaged, or rewritten with other contents."""
    match draw(st.integers(0, 5)):
        case 0:
            return damaged(draw, content)
        case 1 | 2:
            return _written_again(draw, content)
    return _written_by_us(draw, content)


def _written_by_us(draw: st.DrawFn, content: bytes) -> bytes:
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
        for _ in range(draw(st.integers(1, 2))):
            match draw(st.sampled_from(("metadata", "attachment", "rate", "limits", "lengths", "time", "rows"))):
                case "metadata":
                    metadata = _metadata_changed(draw, metadata)
                case "attachment" if attachments:
                    file = draw(st.sampled_from(sorted(attachments)))
                    attachments[file] = _attachment_changed(draw, file, attachments[file])
                    if not draw(st.integers(0, 3)):
                        del attachments[file]
                case "rate":
                    rate = draw(st.sampled_from((1e-9, 1.0, 100.0, 1e5)))
                case "limits":
                    limits = draw(st.sampled_from((None, (0.0, 0.0, 0.0), (1e300, 1.0, 1.0), (-1.0, -1.0, -1.0))))
                case "lengths":
                    lengths = draw(st.sampled_from(((0.0,), (1e300,), (-1.0,), (float("nan"),)))) * len(lengths)
                case "time":
                    shift = draw(st.sampled_from((0.0, 0.5, 1.0, -1.0, 1e-9, 1e3, 1e8)))
                    time = draw(st.sampled_from((time[::-1], shift * time, time + shift)))
                case "rows":
                    part = draw(st.sampled_from(sorted(p for p, values in rows.items() if values is not None)))
                    values = rows[part].copy()
                    if values.size:
                        where = slice(draw(st.integers(0, len(values) - 1)), draw(st.sampled_from((None, len(values)))))
                        column = draw(st.integers(0, values.shape[1] - 1))
                        values[where, column] = draw(st.sampled_from(FLOATS))
                    rows[part] = None if part != "measured" and not draw(st.integers(0, 5)) else values
        try:
            with LogWriter(
                path, arm_lengths=lengths, rate_hz=rate, has_cart=log.has_cart, limits=limits,
                metadata={key: value for key, value in metadata.items() if key != "crc32"}, attachments=attachments,
            ) as writer:  # fmt: skip
                writer.ticks(time, **rows)
                for event in log.events:
                    writer.event(event.time, event.level, event.name, draw(st.sampled_from((event.text, *TEXTS[:20]))))
        except (ValueError, InputError, struct.error, ArithmeticError):
            # The writer itself refuses it.
            return damaged(draw, content)
        return path.read_bytes()


def _written_again(draw: st.DrawFn, content: bytes) -> bytes:
    """Return a log with valid checksums, rewritten by the mcap package with changed records."""
    out = io.BytesIO()
    writer = Writer(out, enable_data_crcs=draw(st.booleans()))
    writer.start("ros2", library="a tool of theirs")
    what = draw(st.sampled_from(("metadata", "attachment", "time", "payload", "topic", "schema", "drop", "few")))
    place = draw(st.floats(0, 1))
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    records = list(StreamReader(io.BytesIO(content), record_size_limit=None).records)
    topics = sorted({r.topic for r in records if isinstance(r, Channel)})
    topic = draw(st.sampled_from(topics))
    chosen = {r.id for r in records if isinstance(r, Channel) and r.topic == topic}
    messages = sum(isinstance(r, Message) for r in records)
    metadata = sorted({r.name for r in records if isinstance(r, Metadata)})
    attachments = sorted({r.name for r in records if isinstance(r, Attachment)})
    record_name = draw(st.sampled_from(metadata or [""]))
    attachment_name = draw(st.sampled_from(attachments or [""]))
    count = 0
    for record in records:
        match record:
            case Metadata(name=name, metadata=values):
                if what == "metadata" and name == record_name:
                    values = _metadata_changed(draw, {k: v for k, v in values.items() if k != "crc32"})
                    values = sealed(name, values) if "crc32" not in values else values
                writer.add_metadata(name, values)
            case Attachment(name=name, data=data):
                if what == "attachment" and name == attachment_name:
                    data = _attachment_changed(draw, name, data)
                writer.add_attachment(0, 0, name, record.media_type, data)
            case Schema() if record.id not in schemas:
                data = damaged(draw, record.data) if what == "schema" else record.data
                name = draw(st.sampled_from((record.name, "x", ""))) if what == "schema" else record.name
                schemas[record.id] = writer.register_schema(name, record.encoding, data)
            case Channel() if record.id not in channels:
                renamed = what == "topic" and record.id in chosen
                name = draw(st.sampled_from(("", "/x", "[/nope]"))) if renamed else record.topic
                channels[record.id] = writer.register_channel(
                    name, record.message_encoding, schemas.get(record.schema_id, 0), record.metadata
                )
            case Message():
                count += 1
                share = count / max(messages, 1)
                data, when = record.data, record.log_time
                if what == "drop" and record.channel_id in chosen and share >= place:
                    continue
                if what == "few" and share > place / 8:
                    continue
                if what == "time" and share >= place:
                    when = draw(st.sampled_from((0, 2**63, 2**64 - 1))) if record.channel_id in chosen else 10**9 - when
                    when = max(when, 0)
                    what = draw(st.sampled_from(("time", "")))
                if what == "payload" and record.channel_id in chosen and share >= place:
                    data = _payload_changed(draw, data)
                    what = draw(st.sampled_from(("payload", "", "")))
                writer.add_message(channels[record.channel_id], when, data, when)
    writer.finish()
    return out.getvalue()


def _attachment_changed(draw: st.DrawFn, name: str, content: bytes) -> bytes:
    change = toml_changed if name.endswith(".toml") else npz_changed if name.endswith(".npz") else damaged
    return change(draw, content)


def _metadata_changed(draw: st.DrawFn, values: Mapping[str, str]) -> dict[str, str]:
    changed = dict(values)
    key = draw(st.sampled_from(sorted(changed) or ["x"]))
    match draw(st.integers(0, 3)):
        case 0:
            changed.pop(key, None)
        case 1 if changed.get(key, "")[:1] in ("{", "[") and _is_json(changed[key]):
            changed[key] = json.dumps(json_changed(draw, json.loads(changed[key])))
        case _:
            long = "[" * 5000, "9" * 5000, "n" * 240
            worst = ("", "[/nope]", "\x1b[31m", "{", "1e400", "nan", "-1", "0", "null", *long)
            changed[key] = draw(st.sampled_from(worst))
    return changed


def _is_json(text: str) -> bool:
    """Return whether a text, which may have been replaced before, is JSON."""
    try:
        json.loads(text)
    except (ValueError, RecursionError):
        return False
    return True


def _payload_changed(draw: st.DrawFn, data: bytes) -> bytes:
    """Return a message with a replaced number or damage."""
    if len(data) < 20 or draw(st.booleans()):
        return damaged(draw, data)
    at = 4 + 8 * draw(st.integers(1, (len(data) - 4) // 8 - 1 or 1))
    number = struct.pack("<d", draw(st.sampled_from(FLOATS)))
    return data[:at] + number + data[at + 8 :]


@dataclass(frozen=True)
class Kind:
    """A kind of file with its changes and the calls that read it."""

    file: str
    change: Bytes
    calls: Sequence[Sequence[str]]


_LOG_CALLS = (
    "info {}", "score {}", "recover {} --out=new.mcap", "review {} --save=new.rrd", "report {} --picture=new.png",
    "run --from={}", "replay {} --out=new.mcap", "identify {} --out=new.toml", "review {} run.mcap --save=new.rrd",
)  # fmt: skip


def _calls(*lines: str) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(line.split()) for line in lines)


KINDS = {
    "scene": Kind("rest.toml", toml_changed, _calls("plan {}", "run {}", "campaign {} --runs=2 --workers=1")),
    "walk": Kind("turn.toml", toml_changed, _calls("plan {}")),
    "model": Kind(
        "lab.toml",
        toml_changed,
        _calls("model {}", "model {}", "orbit {} --saddle=down-up --energy=-0.07", "run with-model.toml"),
    ),
    "three-body": Kind("moon.toml", toml_changed, _calls("model {}", "orbit {} --saddle=L1 --energy=-1.5")),
    "table": Kind("swing.csv", csv_changed, _calls("import {}", "import {} --repair=nan,time,gaps,wrap,spikes")),
    "mapping": Kind("mapping.toml", toml_changed, _calls("import swing.csv --mapping={}")),
    "reference": Kind(
        "reference.npz",
        npz_changed,
        _calls("reference {}", "review {} --save=new.rrd", "reference {} --picture=new.png"),
    ),
    "atlas": Kind("atlas.npz", npz_changed, _calls("review {} --save=new.rrd")),
    "log": Kind("run.mcap", log_changed, _calls(*_LOG_CALLS)),
    "recording": Kind("swings.mcap", log_changed, _calls(*_LOG_CALLS)),
    "campaign": Kind("campaign.parquet", damaged, _calls("report {} --picture=new.png")),
}
"""Kinds of file by name."""


@st.composite
def file_trials(draw: st.DrawFn, kind: str, laboratory: Laboratory) -> Trial:
    """Draw a call that reads a changed file of this kind."""
    chosen = KINDS[kind]
    call = draw(st.sampled_from(chosen.calls))
    content = chosen.change(draw, laboratory.files[chosen.file])
    return Trial(tuple(part.format(chosen.file) for part in call), {chosen.file: content})


def all_trials(laboratory: Laboratory) -> st.SearchStrategy[Trial]:
    """Return trials of every verb and every kind of file."""
    options = [option_trials(verb, laboratory) for verb in VERBS]
    files = [file_trials(kind, laboratory) for kind in KINDS]
    # Files have more possible errors than options.
    return st.one_of(*options, *files, *files)
