"""Remarks on known flights off the tubes.

These flights are cheaper than an itinerary's walks.

The table holds flights of the lab's arms by walk, energy and ends (`dpcontrol bench payoff`). Ends are *orbits*, those
that the walk leaves and joins, or *held*: the arms rest at the saddles, so the motion must first reach an orbit and
leave it afterwards.
"""

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from dpcontrol.plans.itinerary import HoldPart, Itinerary, WalkPart
from dpcontrol.plans.model import load_model

_FLIGHTS = "off_tubes.toml"
_SAME_ENERGY = 1e-9


@dataclass(frozen=True)
class KnownFlight:
    """A flight off the tubes, cheaper than that along them.

    Attributes:
        walk: symbols of the walk between the same ends.
        energy: energy of the tubes in the comparison, J.
        ends: "orbits" or "held".
        seconds: duration, s.
        effort: ∫u² dt, m²/s³.
        along_seconds: duration along the tubes, s.
        along: effort along the tubes, m²/s³.
    """

    walk: tuple[str, ...]
    energy: float
    ends: str
    seconds: float
    effort: float
    along_seconds: float
    along: float


@cache
def known_flights() -> tuple[KnownFlight, ...]:
    """Return the flights of the table."""
    table = tomllib.loads(files("dpcontrol.runs").joinpath(_FLIGHTS).read_text(encoding="utf-8"))
    return tuple(KnownFlight(**{**entry, "walk": tuple(entry["walk"])}) for entry in table["flight"])


def off_tubes_remarks(itinerary: Itinerary) -> tuple[str, ...]:
    """Return a sentence for each walk with a known cheaper flight.

    The flight has the same ends.

    Args:
        itinerary: itinerary to check; only the lab's arms have known flights.
    """
    if itinerary.model.arms != load_model("lab").arms:
        return ()
    parts, found = itinerary.parts, []
    for k, part in enumerate(parts):
        if not isinstance(part, WalkPart):
            continue
        beside = [parts[j] if 0 <= j < len(parts) else None for j in (k - 1, k + 1)]
        held = all(isinstance(one, HoldPart) for one in beside)
        alone = len(parts) == 1 and (itinerary.start, itinerary.finish) == ("orbit", "orbit")
        ends = "held" if held else "orbits" if alone else ""
        found += [
            _sentence(part, one)
            for one in known_flights()
            if one.ends == ends and one.walk == _forward(part.walk) and abs(one.energy - part.energy) < _SAME_ENERGY
        ]
    return tuple(found)


def _forward(walk: tuple[str, ...]) -> tuple[str, ...]:
    """Return the first in order of a walk and its mirror image.

    The two cost the same.
    """
    mirrored = tuple(s[:-1] + {"+": "-", "-": "+"}[s[-1]] if s[-1] in "+-" else s for s in walk)
    return min(walk, mirrored)


def _sentence(part: WalkPart, one: KnownFlight) -> str:
    held = one.ends == "held"
    where, more = ("from hold to hold" if held else "on these orbits"), " and the way onto the orbit" if held else ""
    along = f"{one.along:.3g} in {one.along_seconds:.3g} s{more}"
    return (
        f"{', '.join(part.walk)!r} at {part.energy:g} J: {where} a flight off the tubes is cheaper, {one.effort:.3g} "
        f"m²/s³ in {one.seconds:.3g} s; along them it takes {along} (bench payoff)"
    )
