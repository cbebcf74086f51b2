"""Walks: lists of symbols, each standing for one connection.

A symbol is written in one of four ways:

    "down-up +"              a homoclinic of Down-Up whose turning arm turns forward (-: backward)
    "down-up > up-down"      a heteroclinic; "down-up > up-down -" asks for a sense
    a connection's own name  as `dpcontrol connect` lists it, on any section and at any hits
    "(A)·2·(B)"              an edge grown from a walk: symbols in brackets, and the wraps between them

The first two stand for one connection each: among those of the sense asked for, the symmetric ones if there are any,
and of these the most transversal. A connection in a grown edge may be a grown edge again; its full name begins like any
connection's, with source, target, winding and hits: "down-up>down-up[0,0]h1.2@(A)·2·(B)".
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from dpcontrol.foundation.errors import InputError

if TYPE_CHECKING:
    from dpcontrol.tubes.connections import Connection

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

    None for any other name.
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


_HOMOCLINIC = re.compile(r"^(?P<source>[\w-]*\w)\s+(?P<sense>[+-])$")
_HETEROCLINIC = re.compile(r"^(?P<source>[\w-]*\w)\s*>\s*(?P<target>[\w-]*\w)(?:\s+(?P<sense>[+-]))?$")
_NAME = re.compile(
    r"^(?P<source>[\w-]+)>(?P<target>[\w-]+)\[[-\d,]+\]h(?P<out>\d+)\.(?P<in>\d+)(?::(?P<section>[\w-]+))?@\S+$"
)
_NUMBERED = re.compile(r"(?<=-rotating)(-back)?-[2-9]$")


@dataclass(frozen=True)
class Symbol:
    """What a symbol asks for. sense +1, -1 or None (either); name, hits and section, where one connection is named.

    section: its short name, None for the saddles' own. parts, wraps: of a grown edge, its own symbols and the wraps
    between them.
    """

    text: str
    source: str
    target: str
    sense: int | None
    name: str | None
    hits: tuple[int, int] | None = None
    section: str | None = None
    parts: tuple["Symbol", ...] = ()
    wraps: tuple[int, ...] = ()

    @property
    def simple(self) -> tuple["Symbol", ...]:
        """The symbol itself, or of a grown edge the symbols at the bottom of it."""
        return tuple(s for part in self.parts for s in part.simple) if self.parts else (self,)


MOST_NESTED = 20
"""Brackets within brackets in a symbol: each is an edge grown from walks of others."""


def parse_symbol(text: str, saddles: Sequence[str]) -> Symbol:
    """Read one symbol.

    saddles: names of the orbits that may be left and joined; of rotating ones the others, "outer-rotating-2", go along.

    Raises:
        InputError: the text is not a symbol, or names a saddle that is not among `saddles`.
    """
    if not isinstance(text, str):
        raise InputError(f"a symbol is a text such as 'down-up +', not {type(text).__name__}")
    text = text.strip()
    if "(" in text and np.cumsum([(c == "(") - (c == ")") for c in text]).max() > MOST_NESTED:
        raise InputError(f"{text[:60]!r}…: symbols in brackets may be nested {MOST_NESTED} deep at most")
    if components(text) is not None:
        return _grown(text, saddles)
    named = _NAME.match(text)
    match = named or _HOMOCLINIC.match(text) or _HETEROCLINIC.match(text)
    if match is None:
        other = saddles[min(1, len(saddles) - 1)]
        raise InputError(
            f'{text!r} is not a symbol; write "{saddles[0]} +", "{saddles[0]} > {other}" or a connection\'s name '
            "from `dpcontrol connect`"
        )
    parts = match.groupdict()
    source = parts["source"]
    target = parts.get("target") or source
    for saddle in (source, target):
        if _NUMBERED.sub(r"\1", saddle) not in saddles:
            same = {one.casefold(): one for one in saddles}.get(saddle.casefold())
            if same is not None:
                raise InputError(f"{text!r}: the case of letters matters; write {text.replace(saddle, same)!r}")
            raise InputError(f"{text!r} names {saddle!r}, which has no tubes; choose from {', '.join(saddles)}")
    sense = {"+": 1, "-": -1, None: None}[parts.get("sense")]
    if not named and source == target and sense is None:
        raise InputError(f'{text!r} does not say which way to turn; write "{source} +" or "{source} -"')
    hits = (int(parts["out"]), int(parts["in"])) if named else None
    return Symbol(text, source, target, sense, text if named else None, hits, parts.get("section"))


def _grown(text: str, saddles: Sequence[str]) -> Symbol:
    made_of = components(text)
    assert made_of is not None
    try:
        parts = parse_walk(made_of[0], saddles)
    except InputError as error:
        raise InputError(f"{text!r}: {error}") from error
    own, said = (parts[0].source, parts[-1].target), ends(text)
    if said not in (None, own):
        raise InputError(f"{text!r}: what it is made of leads from {own[0]} to {own[1]}")
    return Symbol(text, *own, None, None if said is None else text, parts=parts, wraps=made_of[1])


def parse_walk(texts: Sequence[str], saddles: Sequence[str]) -> tuple[Symbol, ...]:
    """Read a walk and check that each symbol starts where the one before it ends.

    Raises:
        InputError: no symbols, a text that is not a symbol, or a walk that is not connected.
    """
    if not texts:
        raise InputError("walk = []: a walk has at least one symbol")
    symbols = tuple(parse_symbol(text, saddles) for text in texts)
    for k, (before, after) in enumerate(pairwise(symbols), start=1):
        if before.target != after.source:
            raise InputError(
                f"the walk is not connected: symbol {k} ({before.text!r}) ends at {before.target}, symbol {k + 1} "
                f'({after.text!r}) starts at {after.source}; put "{before.target} > {after.source}" between them'
            )
    return symbols


def expanded(symbols: Sequence[Symbol], wraps: Sequence[int]) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Return the texts and wraps of a walk with its grown edges, if any, written out as the walks that they are.

    wraps: one between each two symbols, and perhaps one more after the last.
    """
    texts: list[str] = []
    counts: list[int] = []
    for k, symbol in enumerate(symbols):
        inner = expanded(symbol.parts, symbol.wraps) if symbol.parts else ((symbol.text,), ())
        texts += inner[0]
        counts += [*inner[1], *wraps[k : k + 1]]
    return tuple(texts), tuple(counts)


def choose(symbol: Symbol, connections: "Sequence[Connection]") -> "Connection":
    """Return the connection that a symbol stands for.

    Raises:
        InputError: no connection fits; says what there is instead.
    """
    if symbol.name is not None:
        for connection in connections:
            if connection.name == symbol.name:
                return connection
        known = ", ".join(sorted(c.name for c in connections)) or "none"
        raise InputError(f"no connection is named {symbol.name!r} at this energy; there are: {known}")
    fitting = [c for c in connections if symbol.sense is None or c.sense == symbol.sense]
    if not fitting:
        raise InputError(
            f"{symbol.text!r}: no such connection at this energy; `dpcontrol connect` lists those there are"
        )
    symmetric = [c for c in fitting if c.symmetric] or fitting
    # Mirror images have the same angle up to rounding; of those the positive sense is taken.
    return max(symmetric, key=lambda c: (round(c.transversality_angle, 6), c.sense, c.name))
