"""Damage to a log's bytes, drawn from a seed: what disks, copies and people do to files."""

import numpy as np
from mcap.opcode import Opcode

KINDS = ("flip", "flips", "cut", "swap", "repeat", "index", "zeros", "missing", "foreign", "tail", "head", "joined")


def records(data: bytes) -> list[tuple[int, int, int]]:
    found, place = [], 8
    while place < len(data) - 8:
        end = place + 9 + int.from_bytes(data[place + 1 : place + 9], "little")
        found.append((data[place], place, end))
        place = end
    return found


def damaged(data: bytes, kind: str, seed: int) -> bytes:
    rng = np.random.default_rng(seed)
    chunks = [(a, b) for opcode, a, b in records(data) if opcode == Opcode.CHUNK]
    closing = next(a for opcode, a, _ in records(data) if opcode == Opcode.DATA_END)
    changed = bytearray(data)
    place = int(rng.integers(len(data)))
    span = int(min(2 ** rng.uniform(0, 13), len(data) - place))
    match kind:
        case "flip":
            changed[place] ^= 1 << int(rng.integers(8))
        case "flips":
            for at in rng.integers(0, len(data), int(rng.integers(2, 9))):
                changed[at] ^= 1 << int(rng.integers(8))
        case "cut":
            del changed[place:]
        case "swap":
            (a, b), (c, d) = sorted(chunks[i] for i in rng.choice(len(chunks), 2, replace=False))
            changed = changed[:a] + changed[c:d] + changed[b:c] + changed[a:b] + changed[d:]
        case "repeat":
            (a, b), (_, to) = (chunks[i] for i in rng.choice(len(chunks), 2))
            changed[to:to] = data[a:b]
        case "index":
            at = int(rng.integers(closing, len(data)))
            changed[at] ^= int(rng.integers(1, 256))
        case "zeros":
            changed[place : place + span] = bytes(span)
        case "missing":
            del changed[place : place + span]
        case "foreign":
            changed[place : place + span] = rng.bytes(span)
        case "tail":
            changed += rng.bytes(span) if rng.integers(2) else bytes(span)
        case "head":
            changed[: int(rng.integers(1, 2000))] = b""
        case "joined":
            changed += data[: int(rng.integers(9, len(data) + 1))]
    return bytes(changed)
