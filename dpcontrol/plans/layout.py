"""The layout of itinerary files: tables and their settings.

Each setting has a place in a run's settings.

[run] lists the keys of the run, its sensors, drive, disturbances and mechanics side by side. Each setting is declared
once: in the dataclass of its part.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated

from dpcontrol.foundation.settings import Leaf, Setting, Settings, leaves_of
from dpcontrol.loop.bench import DisturbanceSettings, DriveSettings, MechanicsSettings, SensorSettings
from dpcontrol.loop.loop import LoopSettings

BENCH: Mapping[str, type] = {
    "sensors": SensorSettings,
    "drive": DriveSettings,
    "disturbances": DisturbanceSettings,
    "mechanics": MechanicsSettings,
}
"""The parts of the bench, which are fields of a run's settings."""
ENDS = ("orbit", "rest", "hold")
"""Starts and finishes of an itinerary."""
GENTLE, SHORTEST = "gentle", "shortest"
"""Times of a transfer that are not given in seconds."""
Pace = str | float
"""Time of a transfer: `GENTLE`, `SHORTEST` or seconds."""
_TIME = Setting(choices=(GENTLE, SHORTEST), above=0.0, most=600.0, unit="s", help="Time of the transfers.")
_LEADING = Annotated[Pace, replace(_TIME, help="Time of the transfer that leads to the part; by default the file's.")]


@dataclass(frozen=True)
class WalkPart(Settings):
    """A walk at one energy.

    Walk and wraps are those of the file done `repeat` times.
    """

    energy: Annotated[float, Setting(unit="J", help="Energy, zero at the pivot's height.")]
    walk: Annotated[tuple[str, ...], Setting(help="Symbols of the walk.")]
    wraps: Annotated[tuple[int, ...], Setting(least=0, help="Wraps at each interior stop.")] = ()
    repeat: Annotated[int, Setting(least=1, most=10_000, help="Repetitions of a closed walk.")] = 1
    lead_in: Annotated[int, Setting(least=0, help="Wraps on the first orbit.")] = 2
    lead_out: Annotated[int, Setting(least=0, help="Wraps on the last orbit.")] = 2
    transfer: _LEADING = ""


@dataclass(frozen=True)
class HoldPart(Settings):
    """A stay at an equilibrium."""

    hold: Annotated[str, Setting(help="Equilibrium to stay at.")]
    seconds: Annotated[float, Setting(least=0.5, most=3600, unit="s", help="Duration of the stay.")] = 2.0
    cart: Annotated[float, Setting(least=-1e6, most=1e6, unit="m", help="Place of the cart, from the middle.")] = 0.0
    transfer: _LEADING = ""


@dataclass(frozen=True)
class OrbitPart(Settings):
    """A stay on the sustained orbit about a saddle, for whole periods."""

    orbit: Annotated[str, Setting(help="Saddle of the orbit.")]
    energy: Annotated[float, Setting(unit="J", help="Energy, zero at the pivot's height.")]
    seconds: Annotated[float, Setting(least=0.5, most=3600, unit="s", help="Duration of the stay.")] = 10.0
    family: Annotated[int, Setting(least=0, help="Family of Lyapunov orbits about the saddle.")] = 0


Part = WalkPart | HoldPart | OrbitPart


@dataclass(frozen=True)
class Header(Settings):
    """The top level of an itinerary's file, beside its part or parts."""

    title: Annotated[str, Setting(help="Title of pages and logs; by default the file's name.")] = ""
    model: Annotated[str, Setting(help="Model, by name or path.")] = "lab"
    start: Annotated[
        str,
        Setting(
            choices=(*ENDS, "anywhere"), help='State at the start; "anywhere": of a run that begins with a flight.'
        ),
    ] = "orbit"
    finish: Annotated[str, Setting(choices=ENDS, help='State at the end; after a hold by default "hold".')] = "orbit"
    transfer: Annotated[Pace, _TIME] = GENTLE


_ANGLES = Setting(unit="rad", usual=(0.0, 2 * math.pi), help="Readings of the rig's hanging arms.")
ZEROS = Leaf("zeros", Annotated[tuple[float, ...], _ANGLES], ())
_FILE = Setting(help="Model of the plant's own arms and friction, by name or path.")
PLANT = Leaf("plant", Annotated[str, _FILE], "")
"""Keys of [run] that are not settings of the loop: readings of a rig, and the name of a file."""


def _of_run() -> Iterator[tuple[str, Leaf]]:
    """Yield the path in a run's settings and the declaration of each key of [run], the bench's parts included."""
    for name, leaf in leaves_of(LoopSettings).items():
        if name not in ("seed", "keep"):
            yield name, leaf
    yield PLANT.name, PLANT
    for part, kind in BENCH.items():
        for name, leaf in leaves_of(kind).items():
            yield f"{part}.{name}", leaf


KEEP = leaves_of(LoopSettings)["keep"]
"""The key of [controller] that names the law which keeps stops."""
RUN: Mapping[str, tuple[str, Leaf]] = {leaf.name: (path, leaf) for path, leaf in _of_run()}
"""The keys of the table [run], with their paths in a run's settings."""
