"""What an itinerary consists of: walks, each at one energy, and holds at equilibria; read from its TOML.

Either the file's top level gives one part's keys, or [[parts]] lists several:

    energy, walk, wraps, repeat, lead_in, lead_out      a walk
    hold = "up-up", seconds = 2.0                       a stay at an equilibrium
    orbit = "down-up", energy = -0.07, seconds = 60     a stay on a periodic orbit; the only part of its itinerary
"""

from dataclasses import dataclass

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.tables import Table, suggest
from dpcontrol.itineraries.edges import saddles_with_tubes
from dpcontrol.itineraries.walk import expanded, parse_walk
from dpcontrol.scenes.model import Model
from dpcontrol.tubes.equilibria import equilibria


@dataclass(frozen=True)
class WalkPart:
    """A walk at one energy in J; walk and wraps are those of the file done `repeat` times."""

    energy: float
    walk: tuple[str, ...]
    wraps: tuple[int, ...]
    repeat: int
    lead_in: int
    lead_out: int


@dataclass(frozen=True)
class HoldPart:
    """A stay at an equilibrium, s."""

    hold: str
    seconds: float


@dataclass(frozen=True)
class OrbitPart:
    """A stay on the sustained orbit about a saddle, energy in J, for about `seconds` s: whole periods."""

    orbit: str
    energy: float
    seconds: float
    family: int


Part = WalkPart | HoldPart | OrbitPart


def read_parts(table: Table, model: Model) -> tuple[Part, ...]:
    """Return the parts of an itinerary's file.

    Raises:
        InputError: a walk, wraps, energy or hold that nothing could save; names file, table, key, value and remedy.
    """
    listed = table.tables("parts")
    if not listed:
        return (_part(table, model),)
    for key in ("walk", "energy", "wraps", "hold", "orbit"):
        if key in table:
            raise InputError(f"{table.where(key)}: the file lists [[parts]]; the key belongs into one of them")
    parts = []
    for one in listed:
        parts.append(_part(one, model))
        if isinstance(parts[-1], OrbitPart):
            raise InputError(f"{one.where('orbit')}: an orbit is kept in an itinerary of its own, without [[parts]]")
        one.finish()
    return tuple(parts)


def _part(table: Table, model: Model) -> Part:
    if "hold" in table:
        return _hold(table, model)
    if "orbit" in table:
        return _orbit(table, model)
    energy = table.number("energy")
    saddles = saddles_with_tubes(model.system)
    walk, wraps, repeat = _walk(table, saddles)
    _check_energy(table, walk, saddles, model, energy)
    return WalkPart(energy, walk, wraps, repeat, table.integer("lead_in", 2), table.integer("lead_out", 2))


def _orbit(table: Table, model: Model) -> OrbitPart:
    for key in ("walk", "hold"):
        if key in table:
            raise InputError(
                f"{table.where('orbit')}: an itinerary that keeps an orbit has no {key}; remove one of them"
            )
    saddles = saddles_with_tubes(model.system)
    name = table.text("orbit", allowed=saddles)
    energy, point = table.number("energy"), equilibria(model.system)[name]
    if energy <= point.energy:
        raise InputError(
            f"{table.where('energy')} = {energy!r} J: {name} has Lyapunov orbits only above its own "
            f"{point.energy!r} J; choose a higher energy"
        )
    return OrbitPart(name, energy, _seconds(table, 10.0), table.integer("family", 0))


def _seconds(table: Table, default: float) -> float:
    seconds = table.number("seconds", default)
    if not 0.5 <= seconds <= 3600:
        raise InputError(f"{table.where('seconds')} = {seconds!r}: must be 0.5 to 3600 s")
    return seconds


def _hold(table: Table, model: Model) -> HoldPart:
    if "walk" in table:
        raise InputError(f"{table.where('hold')}: this part has a walk as well; give each its own [[parts]]")
    points = equilibria(model.system)
    name = table.text("hold")
    if name not in points:
        raise InputError(f"{table.where('hold')} = {name!r}: {suggest(name, points)}")
    return HoldPart(name, _seconds(table, 2.0))


def _walk(table: Table, saddles: list[str]) -> tuple[tuple[str, ...], tuple[int, ...], int]:
    """Return the walk and its wraps, grown edges written out, repeated as often as asked, and how often that is.

    Raises:
        InputError: a walk or wraps that no energy could save; before anything is computed.
    """
    walk, wraps, repeat = table.texts("walk"), table.integers("wraps", ()), table.integer("repeat", 1, least=1)
    try:
        symbols = parse_walk(walk, saddles)
    except InputError as error:
        raise InputError(f"{table.where('walk')}: {error}") from error
    if repeat == 1 and len(wraps) != len(walk) - 1:
        raise InputError(
            f"{table.where('wraps')} = {list(wraps)}: a walk of {len(walk)} symbols has {len(walk) - 1} interior "
            f"stops; give one whole number for each{table.misspelt('wraps')}"
        )
    if repeat == 1:
        return *expanded(symbols, wraps), repeat
    if symbols[0].source != symbols[-1].target:
        raise InputError(
            f"{table.where('repeat')} = {repeat}: the walk starts at {symbols[0].source} and ends at "
            f"{symbols[-1].target}; only a walk that ends where it starts can be repeated"
        )
    if len(wraps) != len(walk):
        raise InputError(
            f"{table.where('wraps')} = {list(wraps)}: a walk of {len(walk)} symbols that is repeated has {len(walk)} "
            "stops, the last from its last symbol back to its first; give one whole number for each"
            f"{table.misspelt('wraps')}"
        )
    walk, wraps = expanded(symbols, wraps)
    return walk * repeat, (wraps * repeat)[:-1], repeat


def _check_energy(table: Table, walk: tuple[str, ...], saddles: list[str], model: Model, energy: float) -> None:
    """Refuse an energy at which a saddle of the walk has no orbits."""
    points = equilibria(model.system)
    for saddle in {name for s in parse_walk(walk, saddles) for name in (s.source, s.target)}:
        if energy <= points[saddle].energy:
            raise InputError(
                f"{table.where('energy')} = {energy!r} J: {saddle} has Lyapunov orbits only above its own "
                f"{points[saddle].energy!r} J; choose a higher energy"
            )
