"""The tables and the example of the page on packets, and the bench in C, agree with the program."""

import re
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import pytest
from bench_at_hand import LONG

import dpcontrol
from dpcontrol.rig import packets
from dpcontrol.rig.client import UdpRig
from dpcontrol.rig.packets import CommandPacket, Condition, Kind, ReadingPacket, Role, Start, Welcome

GUIDE = Path(dpcontrol.__file__).parent / "guide"
PAGE = (GUIDE / "packets.md").read_text(encoding="utf-8")
BENCH = Path(dpcontrol.__file__).parent / "examples" / "bench.c"
PACKETS = PAGE.split("\n## Packets\n")[1].split("\n## ")[0]
SECTIONS = {text.split("\n", 1)[0]: text for text in PACKETS.split("\n### ")[1:]}
TYPES = {"u8": "B", "u16": "H", "u32": "I", "u64": "Q", "i8": "b", "f64": "d"}
HEAD = {"magic": b"dpcb", "version": 2}
ARMS, SESSION, SEQUENCE = 2, 0x0102030405060708, 9
SENDERS = {"from the loop": Role.LOOP, "from the bench": Role.BENCH, "from either": Role.LOOP}

Row = tuple[str, str, str, str]


def rows(section: str) -> list[Row]:
    """Return offset, bytes, type and name of each field in a section's table."""
    cells = re.findall(r"^\| ([^|]+) \| ([^|]+) \| (\w+) \| (\w+) \| ", SECTIONS[section], re.MULTILINE)
    return [row for row in cells if row[0] != "offset"]


def by_the_page(title: str, count: int, values: dict[str, Any]) -> bytes:
    """Return a packet made from the page's tables alone."""
    kind = int(re.findall(r"kind (\d+)", title)[0])
    known = {**HEAD, "kind": kind, "count": count, "session": SESSION, "sequence": SEQUENCE}
    sizes = {"count": count, "size": len(values.get("text", b""))}
    data = b""
    for table, given in ((rows("Head"), known), (rows(title), values)):
        for offset, size, kind_of, name in table:
            assert eval(offset.replace("·", "*"), {}, sizes) == len(data), (title, name)
            value = given[name]
            many = value if isinstance(value, tuple) else (value,)
            data += value if isinstance(value, bytes) else struct.pack(f"<{len(many)}{TYPES[kind_of]}", *many)
            assert eval(offset.replace("·", "*") + "+" + size.replace("·", "*"), {}, sizes) == len(data), (title, name)
    return data


TEXT = "Ach, die Mühle".encode()
READING = ReadingPacket(9, (0.1, 0.2, 0.3), 8, 4, 0.002, -1, Condition.FAULT, TEXT.decode(), 6, 0.0005)
CASES: dict[Kind, tuple[packets.Message, dict[str, Any]]] = {
    Kind.HELLO: (Kind.HELLO, {}),
    Kind.WELCOME: (Welcome(ARMS, 0.001, 7, 5), {"period": 0.001, "ticks": 7, "session": 5}),
    Kind.START: (packets.Start((0.5, -2.0, 1.0)), {"commands": (0.5, -2.0, 1.0)}),
    Kind.READING: (
        READING,
        {
            "tick": 9, "heard": 8, "held": 4, "ignored": 6, "trip": 0.002, "switch": -1, "condition": 1,
            "size": len(TEXT), "positions": READING.positions, "text": TEXT,
            "age": READING.age,
        },
    ),
    Kind.COMMAND: (packets.CommandPacket(7, -1.5), {"tick": 7, "acceleration": -1.5}),
    Kind.STOP: (Kind.STOP, {}),
    Kind.BYE: (packets.Bye(TEXT.decode()), {"text": TEXT}),
}  # fmt: skip


@pytest.mark.parametrize("kind", Kind)
def test_a_packet_made_from_the_pages_table_is_the_programs_own(kind: Kind) -> None:
    (title,) = [title for title in SECTIONS if title.startswith(f"{kind.name}, kind {kind.value},")]
    (sender,) = [role for text, role in SENDERS.items() if text in title]
    message, values = CASES[kind]
    packed = packets.packed(message, sender, session=SESSION, sequence=SEQUENCE)
    data = by_the_page(title, int.from_bytes(packed[6:8], "little"), values)
    assert data == packed
    assert packets.unpacked(data, sender).content == message


def test_the_example_in_hexadecimal_decodes_to_the_values_in_its_text() -> None:
    (block,) = re.findall(r"```hex\n(.*?)```", PAGE, re.DOTALL)
    heard = {}
    for line in block.splitlines():
        name, digits = line.split(maxsplit=1)
        sender = Role.BENCH if name in ("WELCOME", "READING") else Role.LOOP
        heard[Kind[name]] = packets.unpacked(bytes.fromhex(digits), sender)
    assert set(heard) == set(Kind)
    asked, run = map(int, re.findall(r"session (\d+), the bench (\d+)", PAGE)[0])
    assert heard[Kind.HELLO].session == heard[Kind.WELCOME].session == asked
    assert {heard[kind].session for kind in set(Kind) - {Kind.HELLO, Kind.WELCOME}} == {run}
    assert heard[Kind.WELCOME].content == Welcome(2, 0.001, 600_000, run)
    assert heard[Kind.START].content == Start((0.5,))
    reading = heard[Kind.READING].content
    assert reading == ReadingPacket(7, (0.1, -0.2, 0.05), 6, 0, 0.00025, 0, Condition.WELL, "")
    assert heard[Kind.COMMAND].content == CommandPacket(7, -1.5)


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
def test_the_rig_in_c_keeps_to_the_protocol(tmp_path: Path) -> None:
    source = BENCH.read_text(encoding="utf-8")
    port = free_port()
    (tmp_path / "rig.c").write_text(source.replace("47000", str(port)))
    made = ["cc", "-D_GNU_SOURCE", "-Wall", "-o", str(tmp_path / "rig"), str(tmp_path / "rig.c"), "-lm"]
    subprocess.run(made, check=True, capture_output=True)
    with subprocess.Popen([str(tmp_path / "rig")]) as program:
        try:
            for _ in range(2):
                with UdpRig(("127.0.0.1", port), settings=LONG) as rig:
                    assert (rig.period, rig.welcome.arms) == (0.001, 2)
                    # A busy computer may take many ticks over either.
                    for _ in range(5000):
                        moved = rig.read().positions[-1]
                        rig.command(2.0)
                        if moved > 1e-4:
                            break
                    rig.stop()
                    before, stood = moved, 0
                    while stood < 5 and rig.deadlines.ticks < 10_000:
                        now = rig.read().positions[-1]
                        stood, before = (stood + 1 if now == before else 0), now
                        rig.command(9.0)
                    assert moved > 1e-4
                    assert stood == 5
        finally:
            program.kill()


def free_port() -> int:
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]
