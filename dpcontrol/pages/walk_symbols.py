"""A walk's symbols in words, and the periods near its periodic orbits."""

from dataclasses import dataclass

import numpy as np

from dpcontrol.tubes.connections import Connection


@dataclass(frozen=True)
class Wobble:
    """A period near a periodic orbit, with its number of wraps.

    It lasts from start to end (s) about `saddle`.

    `closing` marks a closed walk's stop between its last and its first symbol.
    """

    start: float
    end: float
    saddle: str
    wraps: int
    closing: bool = False


def symbol_text(connection: Connection) -> str:
    """Return a connection's symbol, such as "down-up > up-down -"."""
    sense = "+" if connection.sense > 0 else "-"
    source, target = connection.source.saddle, connection.target.saddle
    return f"{source} {sense}" if source == target else f"{source} > {target} {sense}"


def symbol_words(connection: Connection) -> str:
    """Return a description of the motion during a symbol."""
    source, target = connection.source.saddle, connection.target.saddle
    if source != target:
        return f"crosses from {source} to {target}"
    if not np.isfinite(connection.source.system.periods).any():
        return f"leaves {source} and comes back"
    count = len(connection.winding)
    arms = ("inner arm", "outer arm") if count == 2 else [f"arm {k + 1}" for k in range(count)]
    turns = []
    for arm, count in zip(arms, connection.winding, strict=True):
        if count:
            often = {1: "once", 2: "twice"}.get(abs(count), f"{abs(count)} times")
            turns.append(f"{arm} turns {often} {'counter-clockwise' if count > 0 else 'clockwise'}")
    return ", ".join(turns) or f"swings away from {source} and back"
