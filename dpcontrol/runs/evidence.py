"""Does a scene go about its work in the right way? What the charts have found, as remarks on its plan and its run.

*Levels* (`dpcontrol bench levels`): a reference's level is *enough* where, on a plant that is the model, it is flown as
completely as one of the full level and with at most a fifth more effort. A plant's level is enough where the scene's
own runs, with its mismatch, are completed as often as on the fullest plant, and with the same tracking error to a
fifth: that is what a run is asked. Evidence is of a motion, not of a name: parts, ends, energy and arms.

*Flights off the tubes* (`dpcontrol bench payoff`): the table holds flights of the lab's arms, by walk, energy and ends,
that are cheaper than along the tubes. Ends are *orbits*, those that the walk leaves and joins, or *held*: the arms
still at the saddles, where an itinerary must first come onto an orbit, and off it again.
"""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any

from dpcontrol.dynamics.plant import PlantLevel
from dpcontrol.foundation.files import content_hash
from dpcontrol.plans.itinerary import HoldPart, Itinerary, WalkPart, itinerary_from
from dpcontrol.plans.model import load_model

ALLOWED = 0.2
"""Share by which effort or error may change where a level is left out."""
REFERENCE_LEVELS = ("conservative", "cart")
PLANT_LEVELS = tuple(level.value for level in PlantLevel)
LAG, CART_MASS, CART_VISCOUS = 5e-3, 3.0, 5.0
"""Of the evidence's plants: the drive's lag s, the cart's mass kg and its friction N s/m."""
_FILE = "level_evidence.toml"


@dataclass(frozen=True)
class LevelRuns:
    """Runs of a scene at one level: how many completed; effort of the cart, m/s² rms; error of the angles, rad rms."""

    runs: int
    completed: int
    effort: float
    error: float

    def agrees(self, other: "LevelRuns") -> bool:
        """Return whether as many runs complete, and with the same tracking error to a fifth."""
        same = abs(self.error - other.error) <= ALLOWED * max(self.error, other.error)
        return same and (self.completed, self.runs) == (other.completed, other.runs)


@dataclass(frozen=True)
class Evidence:
    """A scene's runs by level: its reference's levels on a plant that is the model, its plant's with its own mismatch.

    motion: what the scene does, as `motion_key` gives it.
    """

    scene: str
    motion: str
    references: Mapping[str, LevelRuns]
    plants: Mapping[str, LevelRuns]

    @property
    def reference_level(self) -> str:
        """The least level of the reference that serves: as many runs completed, at most a fifth more effort."""
        full = self.references["cart"]
        for level in REFERENCE_LEVELS[:-1]:
            runs = self.references.get(level)
            if runs is not None and runs.completed == full.completed and runs.effort <= (1 + ALLOWED) * full.effort:
                return level
        return "cart"

    @property
    def plant_level(self) -> str:
        """The least level of the plant whose runs agree with those of the fullest."""
        full = self.plants[PLANT_LEVELS[-1]]
        return next(level for level in PLANT_LEVELS if self.plants[level].agrees(full))


def motion_key(itinerary: Itinerary) -> str:
    """Return what a scene does and with which arms, as 16 hexadecimal digits: evidence holds for that alone."""
    parts = [asdict(part) for part in itinerary.parts]
    arms = asdict(itinerary.model.arms)
    return content_hash(json.dumps([parts, itinerary.start, itinerary.finish, arms], sort_keys=True))


@cache
def known_evidence() -> Mapping[str, Evidence]:
    """Return the package's evidence by the key of the motion."""
    table = tomllib.loads(files("dpcontrol.runs").joinpath(_FILE).read_text(encoding="utf-8"))
    found = [_evidence(name, entry) for name, entry in table.items()]
    return {evidence.motion: evidence for evidence in found}


def _evidence(name: str, entry: Mapping[str, dict[str, dict[str, Any]]]) -> Evidence:
    references, plants = (
        {level: LevelRuns(**runs) for level, runs in entry[key].items()} for key in ("reference", "plant")
    )
    return Evidence(name, str(entry["motion"]), references, plants)


def plan_remarks(itinerary: Itinerary) -> tuple[str, ...]:
    """Return a sentence if the reference's level is more, or less, than the evidence supports; else nothing."""
    if (evidence := known_evidence().get(motion_key(itinerary))) is None:
        return ()
    runs, level = evidence.references, itinerary.reference.level
    return _remark("[reference] level", level, evidence.reference_level, REFERENCE_LEVELS, runs)


def run_remarks(itinerary: Itinerary) -> tuple[str, ...]:
    """Return a sentence if the plant's level is more, or less, than the evidence supports; else nothing.

    The evidence is of the scene's own bench and controller; of a longer lag than its own, of a lighter cart, or of
    other settings it says nothing.
    """
    if (evidence := known_evidence().get(motion_key(itinerary))) is None:
        return ()
    loop, own = itinerary.loop, itinerary_from(itinerary.text, itinerary.name, itinerary.model).loop
    level = loop.bench.plant(itinerary.model.arms).level.value
    ideal = replace(own.drive, lag=0.0, cart_mass=0.0, cart_viscous=0.0)
    as_own = replace(
        loop, seed=own.seed, drive=replace(loop.drive, lag=0.0, cart_mass=0.0, cart_viscous=0.0)
    ) == replace(own, drive=ideal)
    if not as_own or loop.drive.lag > LAG or 0 < loop.drive.cart_mass < CART_MASS:
        return ()
    return _remark("[run] plant", level, evidence.plant_level, PLANT_LEVELS, evidence.plants)


def _remark(
    what: str, level: str, enough: str, order: tuple[str, ...], runs: Mapping[str, LevelRuns]
) -> tuple[str, ...]:
    if level == enough:
        return ()
    more = order.index(level) > order.index(enough)
    # Where the level is more than needed, the one that suffices is the evidence; where it is less, the level itself.
    shown = enough if more else level
    if shown not in runs:
        return (f'{what} = "{level}" is less than this scene needs: it cannot be made without "{enough}"',)
    verdict = f'more than the evidence supports: "{enough}" is enough' if more else (
        f'less than the evidence asks for, "{enough}"'
    )  # fmt: skip
    found, full = _figures(runs[shown]), _figures(runs[order[-1]])
    return (f'{what} = "{level}" is {verdict}; with "{shown}" {found}, with everything {full}',)


def _figures(runs: LevelRuns) -> str:
    return f"{runs.completed} of {runs.runs} runs completed at {runs.effort:.3g} m/s² and {runs.error:.2g} rad rms"


_FLIGHTS = "off_tubes.toml"
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
    table = tomllib.loads(files("dpcontrol.runs").joinpath(_FLIGHTS).read_text(encoding="utf-8"))
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
