"""Where a flight off the tubes is known to be cheaper than along them: what `dpcontrol bench payoff` found.

The table holds flights of the lab's arms by walk, energy and ends. Ends are *orbits*, those that the walk leaves and
joins, or *held*: the arms still at the saddles, where an itinerary must first come onto an orbit, and off it again.
"""

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from dpcontrol.scenes.itinerary import HoldPart, Itinerary, WalkPart
from dpcontrol.scenes.model import load_model

_FILE = "off_tubes.toml"
_SAME_ENERGY = 1e-9


@dataclass(frozen=True)
class KnownFlight:
    """A flight off the tubes that is cheaper. walk; energy J of the tubes that it was compared with; ends: "orbits" or
    "held"; seconds it takes; effort ∫u² m²/s³; along_seconds, along: those of the flight along tubes.
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
    """Return the package's table."""
    table = tomllib.loads(files("dpcontrol.scenes").joinpath(_FILE).read_text(encoding="utf-8"))
    return tuple(KnownFlight(**{**entry, "walk": tuple(entry["walk"])}) for entry in table["flight"])


def off_tubes_remarks(itinerary: Itinerary) -> tuple[str, ...]:
    """Return a sentence for each walk of an itinerary for whose ends a cheaper flight off the tubes is known."""
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
    """Return a walk or, where it is the lesser, its mirror image, which costs the same."""
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
