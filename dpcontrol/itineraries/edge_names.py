"""Names of edges that were grown: what they are made of, "(A)·2·(B)", connections in brackets and the wraps between.

A connection in it may be a grown edge again. The full name begins like any connection's, with source, target, winding
and hits: "down-up>down-up[0,0]h1.2@(A)·2·(B)".
"""

import re
from collections.abc import Sequence

import numpy as np

_PREFIX = re.compile(r"^(?:(?P<source>[\w-]+)>(?P<target>[\w-]+)\[[-\d,]+\]h\d+\.\d+(?::[\w-]+)?@)?(?=\()")
# People may leave out the dots, which few keyboards have.
_WRAPS = re.compile(r"^(?:\s*·\s*|\s+)(\d+)(?:\s*·\s*|\s+)(?=\()")


def composed(walk: Sequence[str], wraps: Sequence[int]) -> str:
    """Return what a grown edge is made of, from its connections' names and the wraps between them."""
    parts = [f"({walk[0]})"]
    for name, count in zip(walk[1:], wraps, strict=True):
        parts.append(f"·{count}·({name})")
    return "".join(parts)


def components(name: str) -> tuple[tuple[str, ...], tuple[int, ...]] | None:
    """Return (connections' names, wraps between them) of a grown edge's name, full or only what it is made of.

    None where it is no such name.
    """
    prefix = _PREFIX.match(name)
    if prefix is None:
        return None
    rest = name[prefix.end() :]
    names: list[str] = []
    wraps: list[int] = []
    while rest.startswith("("):
        depth = np.cumsum([(c == "(") - (c == ")") for c in rest])
        closed = np.flatnonzero(depth == 0)
        if not closed.size:
            return None
        end = int(closed[0])
        names.append(rest[1:end])
        rest = rest[end + 1 :]
        if not rest:
            return tuple(names), tuple(wraps)
        count = _WRAPS.match(rest)
        if count is None:
            return None
        wraps.append(int(count[1]))
        rest = rest[count.end() :]
    return None


def ends(name: str) -> tuple[str, str] | None:
    """Return the (source, target) with which a grown edge's full name begins; None where it says only its parts."""
    prefix = _PREFIX.match(name)
    return None if prefix is None or prefix["source"] is None else (prefix["source"], prefix["target"])
