"""A walk's symbols in words, and the periods near its periodic orbits."""

from dataclasses import dataclass

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
