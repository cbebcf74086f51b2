"""Walks as lists of symbols, each of which denotes one connection.

There are four kinds of symbols:

    "down-up +"              a homoclinic connection of Down-Up whose arm turns forward (-: backward)
    "down-up > up-down"      a heteroclinic connection; "down-up > up-down -" also gives the sense
    a connection's name      as listed by `dpcontrol connect`, on any section and at any hits
    "(A)·2·(B)"              a composite edge: symbols in brackets, with the wraps between them

The first two kinds select one connection of the given sense. Symmetric connections take precedence, then the largest
transversality angle. Composite edges may contain other composite edges. Their full names begin with source, target,
winding and hits: "down-up>down-up[0,0]h1.2@(A)·2·(B)".
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
# The dots are optional, because few keyboards have them.
_WRAPS = re.compile(r"^(?:\s*·\s*|\s+)(\d+)(?:\s*·\s*|\s+)(?=\()")


def composed(walk: Sequence[str], wraps: Sequence[int]) -> str:
    """Return the text of a composite edge from names and wraps.

    Args:
        walk: names of the connections (k,).
        wraps: periods at each stop (k - 1,).
    """
    parts = [f"({walk[0]})"]
    for name, count in zip(walk[1:], wraps, strict=True):
        parts.append(f"·{count}·({name})")
    return "".join(parts)


def components(name: str) -> tuple[tuple[str, ...], tuple[int, ...]] | None:
    """Return the names and wraps of a composite edge, or None.

    Args:
        name: text of the edge, with or without source, target, winding and hits.
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
    """Return (source, target) of a composite edge's full name, or None.

    Args:
        name: name of a composite edge.
    """
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
    """Saddles, sense, hits and section of a walk's symbol.

    Attributes:
        sense: +1, -1 or None (either).
        name: connection's name, if given.
        section: short name, None for the saddles' default.
        parts: symbols of a composite edge.
        wraps: wraps between the parts.
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
        """The symbol itself, or the elementary symbols of a composite edge."""
        return tuple(s for part in self.parts for s in part.simple) if self.parts else (self,)


MOST_NESTED = 20
"""Largest depth of nested brackets in a symbol."""


def parse_symbol(text: str, saddles: Sequence[str]) -> Symbol:
    """Return the saddles, sense, hits and section that a symbol names.

    Args:
        text: the symbol.
        saddles: allowed orbit names; "outer-rotating" also allows "outer-rotating-2" and so on.

    Raises:
        InputError: the text is not a symbol, or an orbit is not in `saddles`.
    """
    if not isinstance(text, str):
        raise InputError(f"a symbol must be text such as 'down-up +', not {type(text).__name__}")
    text = text.strip()
    if "(" in text and np.cumsum([(c == "(") - (c == ")") for c in text]).max() > MOST_NESTED:
        raise InputError(f"{text[:60]!r}…: brackets may be nested at most {MOST_NESTED} deep")
    if (made_of := components(text)) is not None:
        return _grown(text, made_of, saddles)
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
    unknown = [one for one in (source, target) if _NUMBERED.sub(r"\1", one) not in saddles]
    spelt, meant = {one.casefold(): one for one in saddles}, text
    for saddle in unknown:
        if saddle.casefold() not in spelt:
            raise InputError(f"{text!r}: {saddle!r} has no tubes; choose from {', '.join(saddles)}")
        meant = meant.replace(saddle, spelt[saddle.casefold()])
    if unknown:
        raise InputError(f"{text!r}: the case of letters matters; write {meant!r}")
    sense = {"+": 1, "-": -1, None: None}[parts.get("sense")]
    if not named and source == target and sense is None:
        raise InputError(f'{text!r} has no direction of rotation; write "{source} +" or "{source} -"')
    hits = (int(parts["out"]), int(parts["in"])) if named else None
    return Symbol(text, source, target, sense, text if named else None, hits, parts.get("section"))


def _grown(text: str, made_of: tuple[tuple[str, ...], tuple[int, ...]], saddles: Sequence[str]) -> Symbol:
    """Return the symbol of a composite edge from its names and wraps."""
    try:
        parts = parse_walk(made_of[0], saddles)
    except InputError as error:
        raise InputError(f"{text!r}: {error}") from error
    own, stated = (parts[0].source, parts[-1].target), ends(text)
    if stated not in (None, own):
        raise InputError(f"{text!r}: the symbols in brackets lead from {own[0]} to {own[1]}")
    return Symbol(text, *own, None, None if stated is None else text, parts=parts, wraps=made_of[1])


def parse_walk(texts: Sequence[str], saddles: Sequence[str]) -> tuple[Symbol, ...]:
    """Parse a walk and check that its symbols are connected.

    Args:
        texts: symbols of the walk.
        saddles: names of possible stops.

    Raises:
        InputError: the walk is empty or not connected, or a text is not a symbol.
    """
    if not texts:
        raise InputError("walk = []: must have at least one symbol")
    symbols = tuple(parse_symbol(text, saddles) for text in texts)
    for k, (before, after) in enumerate(pairwise(symbols), start=1):
        if before.target != after.source:
            raise InputError(
                f"the walk is not connected: symbol {k} ({before.text!r}) ends at {before.target}, symbol {k + 1} "
                f'({after.text!r}) starts at {after.source}; put "{before.target} > {after.source}" between them'
            )
    return symbols


def expanded(symbols: Sequence[Symbol], wraps: Sequence[int]) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Return the texts and wraps with all composite edges expanded.

    Args:
        symbols: the walk.
        wraps: one count between neighbouring symbols, and one more if the walk closes.
    """
    texts: list[str] = []
    counts: list[int] = []
    for k, symbol in enumerate(symbols):
        inner = expanded(symbol.parts, symbol.wraps) if symbol.parts else ((symbol.text,), ())
        texts += inner[0]
        counts += [*inner[1], *wraps[k : k + 1]]
    return tuple(texts), tuple(counts)


def choose(symbol: Symbol, connections: "Sequence[Connection]") -> "Connection":
    """Return the connection that a symbol selects.

    Args:
        symbol: selection by name, or by stops and sense.
        connections: connections at one energy.

    Raises:
        InputError: no connection matches.
    """
    if symbol.name is not None:
        for connection in connections:
            if connection.name == symbol.name:
                return connection
        names = ", ".join(sorted(c.name for c in connections)) or "none"
        raise InputError(f"no connection is named {symbol.name!r} at this energy; available: {names}")
    fitting = [c for c in connections if symbol.sense is None or c.sense == symbol.sense]
    if not fitting:
        raise InputError(
            f"{symbol.text!r}: no such connection at this energy; `dpcontrol connect` lists the available ones"
        )
    symmetric = [c for c in fitting if c.symmetric] or fitting
    # Mirror images have the same angle up to rounding; the positive sense takes precedence.
    return max(symmetric, key=lambda c: (round(c.transversality_angle, 6), c.sense, c.name))
