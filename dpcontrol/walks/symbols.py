"""Walks as lists of symbols, each of which denotes one connection.

There are four kinds of symbols:

    "down-up +"              a homoclinic connection of Down-Up whose arm turns forward (-: backward)
    "down-up > up-down"      a heteroclinic connection; "down-up > up-down -" also gives the sense
    a connection's name      as listed by `dpcontrol connect`, on any section and at any hits
    "(A)·2·(B)"              a composite edge: symbols in brackets, with the wraps between them

The first two kinds select one connection of the given sense. Symmetric connections take precedence, then the largest
transversality angle. A plan first passes over connections that ask for more than twice the smallest gain of the
feedback. Composite edges may contain other composite edges. Their full names begin with source, target, winding and
hits: "down-up>down-up[0,0]h1.2@(A)·2·(B)".
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import suggest

if TYPE_CHECKING:
    from dpcontrol.tubes.connections import Connection


def composed(walk: Sequence[str], wraps: Sequence[int]) -> str:
    """Return the text of a composite edge, such as "(down-up +)·2·(down-up -)".

    Args:
        walk: names of the connections (k,).
        wraps: periods at each stop (k - 1,).
    """
    return f"({walk[0]})" + "".join(f"·{count}·({name})" for name, count in zip(walk[1:], wraps, strict=True))


# A connection's name: source>target[winding]h, its two hits (crossing numbers of the section), :section unless it is
# the default, and after @ its place on the section, or the symbols of a composite edge.
_FULL = re.compile(
    r"(?P<source>[\w-]+)>(?P<target>[\w-]+)\[[-\d,]+\]h(?P<out>\d+)\.(?P<back>\d+)(?::(?P<section>[\w-]+))?@(?P<place>.+)"
)
# "down-up +", "down-up > up-down" or "down-up > up-down -".
_SHORT = re.compile(r"(?P<source>[\w-]*\w)(?:\s*>\s*(?P<target>[\w-]*\w))?(?:\s+(?P<sense>[+-]))?")


@dataclass(frozen=True)
class RotatingName:
    """Arm, sense and rank of a rotating orbit among the hyperbolic ones, fastest first."""

    arm: str
    sense: int
    rank: int

    def __str__(self) -> str:
        """Return the name as users type it, such as "inner-rotating-back-2"."""
        return f"{self.arm}-rotating{'' if self.sense > 0 else '-back'}{f'-{self.rank}' if self.rank > 1 else ''}"


_ROTATING = [RotatingName(arm, sense, rank) for arm in ("outer", "inner") for sense in (1, -1) for rank in range(1, 10)]
ROTATING = {str(name): name for name in _ROTATING}
"""Names of rotating orbits as users type them."""


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
    """Return a symbol of a walk from its text: its saddles, sense, hits and section, or its parts if it is composite.

    The hits of a connection are the numbers of the section crossings at which the unstable and the stable tube meet.

    Args:
        text: the symbol.
        saddles: allowed orbit names; "outer-rotating" also allows "outer-rotating-2" and so on.

    Raises:
        InputError: the text is not a symbol, or an orbit is not in `saddles`.
    """
    text = text.strip()
    full_match = _FULL.fullmatch(text)
    if (pieces := _pieces(full_match["place"] if full_match else text)) is not None:
        return _grown(text, pieces, full_match, saddles)
    match = full_match or _SHORT.fullmatch(text)
    groups = {} if match is None else {"sense": None, **match.groupdict()}
    if match is None or not (groups["target"] or groups["sense"]):
        example = saddles[min(1, len(saddles) - 1)]
        raise InputError(
            f'{text!r} is not a symbol; write "{saddles[0]} +", "{saddles[0]} > {example}" or a connection\'s name '
            "from `dpcontrol connect`"
        )
    source = groups["source"]
    target = groups["target"] or source
    # If the fastest orbit of an arm and direction is allowed, so are its slower ones, "-2" and so on.
    rotating = [str(name) for name in _ROTATING if str(replace(name, rank=1)) in saddles]
    for name in (source, target):
        if name not in (*saddles, *rotating):
            raise InputError(f"{text!r}: {name!r} has no tubes; {suggest(name, saddles)}")
    sense = {"+": 1, "-": -1, None: None}[groups.get("sense")]
    if full_match is None and source == target and sense is None:
        raise InputError(f'{text!r} has no direction of rotation; write "{source} +" or "{source} -"')
    hits = (int(full_match["out"]), int(full_match["back"])) if full_match else None
    return Symbol(text, source, target, sense, text if full_match else None, hits, groups.get("section"))


def _pieces(text: str) -> list[str] | None:
    """Split a composite edge "(A)·2·(B)" at its outermost brackets.

    Returns:
        The texts outside and inside the brackets in turn, or None if `text` is no composite edge.

    Raises:
        InputError: the brackets are nested too deeply.
    """
    pieces, depth = [""], 0
    # A closing bracket lowers the depth before the comparison, and an opening one raises it afterwards. Both brackets
    # of an outermost pair are thus met at depth zero and begin a new piece.
    for character in text:
        depth -= character == ")"
        if character in "()" and depth == 0:
            pieces.append("")
        else:
            pieces[-1] += character
        depth += character == "("
        if depth > MOST_NESTED:
            raise InputError(f"{text[:60]!r}…: brackets may be nested at most {MOST_NESTED} deep")
    # The dots are optional, because few keyboards have them.
    outside = [piece.strip(" ·") for piece in pieces[::2]]
    composite = len(pieces) > 2 and depth == 0 and not (outside[0] or outside[-1])
    return pieces if composite and all(count.isdecimal() for count in outside[1:-1]) else None


def _grown(text: str, pieces: list[str], full: re.Match[str] | None, saddles: Sequence[str]) -> Symbol:
    """Return the symbol of a composite edge, such as "(A)·2·(B)", from its parts and the wraps between them.

    `pieces` are its texts outside and inside the brackets in turn, see `_pieces`. `full` matches the edge's full name,
    which begins with its saddles and winding, and is None if the text has brackets only.

    Raises:
        InputError: a text in brackets is no symbol, the symbols are not connected, or the full name has other ends.
    """
    try:
        parts = parse_walk(pieces[1::2], saddles)
    except InputError as error:
        raise InputError(f"{text!r}: {error}") from error
    ends, wraps = (parts[0].source, parts[-1].target), tuple(int(count.strip(" ·")) for count in pieces[2:-1:2])
    if full is not None and full.group("source", "target") != ends:
        raise InputError(f"{text!r}: the symbols in brackets lead from {ends[0]} to {ends[1]}")
    return Symbol(text, *ends, None, None if full is None else text, parts=parts, wraps=wraps)


def parse_walk(texts: Sequence[str], saddles: Sequence[str]) -> tuple[Symbol, ...]:
    """Return the parsed symbols of a walk, after a check that each starts where the one before it ends.

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
    """Return the walk with each composite edge replaced by the elementary symbols and wraps that it consists of.

    A composite edge is a walk in brackets that serves as one symbol, such as "(A)·2·(B)" with two wraps, the periods
    near the orbit between A and B.

    Args:
        symbols: the walk.
        wraps: one count between neighbouring symbols, and one more if the walk closes.

    Returns:
        Texts of the elementary symbols, and the wraps between them.
    """
    texts: list[str] = []
    counts: list[int] = []
    for k, symbol in enumerate(symbols):
        inner = expanded(symbol.parts, symbol.wraps) if symbol.parts else ((symbol.text,), ())
        texts += inner[0]
        counts += [*inner[1], *wraps[k : k + 1]]
    return tuple(texts), tuple(counts)


Loss = Callable[["Connection"], float]
"""Loss of a connection for its feedback, such as its peak gain."""
_LIKE = 2.0
"""Factor on the smallest loss below which connections count as equally good."""


def choose(symbol: Symbol, connections: "Sequence[Connection]", loss: Loss | None = None) -> "Connection":
    """Return the connection that a symbol selects among those between its stops at one energy.

    Args:
        symbol: selection by name, or by stops and sense.
        connections: connections at one energy.
        loss: cost of a connection; those of more than twice the smallest are passed over.

    Raises:
        InputError: no connection matches.
    """
    if symbol.name is not None:
        for connection in connections:
            if connection.name == symbol.name:
                return connection
        names = ", ".join(sorted(candidate.name for candidate in connections)) or "none"
        raise InputError(f"no connection is named {symbol.name!r} at this energy; available: {names}")
    matching = [candidate for candidate in connections if symbol.sense is None or candidate.sense == symbol.sense]
    if not matching:
        raise InputError(
            f"{symbol.text!r}: no such connection at this energy; `dpcontrol connect` lists the available ones"
        )
    if loss is not None and len(matching) > 1:
        losses = [loss(candidate) for candidate in matching]
        matching = [
            candidate for candidate, value in zip(matching, losses, strict=True) if value <= _LIKE * min(losses)
        ]
    symmetric = [candidate for candidate in matching if candidate.symmetric] or matching
    # Mirror images have the same angle up to rounding; the positive sense takes precedence.
    return max(
        symmetric, key=lambda candidate: (round(candidate.transversality_angle, 6), candidate.sense, candidate.name)
    )
