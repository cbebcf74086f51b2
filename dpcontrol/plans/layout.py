"""The layout of itinerary files: tables and their settings.

Each setting has a place in a run's settings.

[run] lists the keys of sensors, drive, disturbances and mechanics side by side. Its dataclass is made of theirs, so
each setting is declared once: in the dataclass of its part.
"""

from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, make_dataclass
from typing import Any, get_type_hints

from dpcontrol.foundation.settings import Settings, setting
from dpcontrol.loop.bench import DisturbanceSettings, DriveSettings, MechanicsSettings, Push, SensorSettings
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


@dataclass(frozen=True)
class WalkPart(Settings):
    """A walk at one energy.

    Walk and wraps are those of the file done `repeat` times.
    """

    energy: float = setting(unit="J", help="Energy, zero at the pivot's height.")
    walk: tuple[str, ...] = setting(help="Symbols of the walk.")
    wraps: tuple[int, ...] = setting((), least=0, help="Laps at each interior stop.")
    repeat: int = setting(1, least=1, most=10_000, help="Repetitions of a closed walk.")
    lead_in: int = setting(2, least=0, help="Laps on the first orbit.")
    lead_out: int = setting(2, least=0, help="Laps on the last orbit.")


@dataclass(frozen=True)
class HoldPart(Settings):
    """A stay at an equilibrium."""

    hold: str = setting(help="Equilibrium to stay at.")
    seconds: float = setting(2.0, least=0.5, most=3600, unit="s", help="Duration of the stay.")


@dataclass(frozen=True)
class OrbitPart(Settings):
    """A stay on the sustained orbit about a saddle, for whole periods."""

    orbit: str = setting(help="Saddle of the orbit.")
    energy: float = setting(unit="J", help="Energy, zero at the pivot's height.")
    seconds: float = setting(10.0, least=0.5, most=3600, unit="s", help="Duration of the stay.")
    family: int = setting(0, least=0, help="Family of Lyapunov orbits about the saddle.")


Part = WalkPart | HoldPart | OrbitPart


@dataclass(frozen=True)
class Header(Settings):
    """The top level of an itinerary's file, beside its part or parts."""

    title: str = setting("", help="Title of pages and logs; by default the file's name.")
    model: str = setting("lab", help="Model, by name or path.")
    start: str = setting("orbit", choices=ENDS, help="State at the start.")
    finish: str = setting("orbit", choices=ENDS, help='State at the end; after start = "hold" by default "hold".')


def _copied(kind: type, *, without: tuple[str, ...] = ()) -> Iterator[tuple[str, Any, Field[Any]]]:
    """Yield the fields of a dataclass as `make_dataclass` takes them."""
    hints = get_type_hints(kind)
    for one in fields(kind):
        if one.name not in without and one.default is not MISSING:
            yield one.name, hints[one.name], field(default=one.default, metadata=one.metadata)


RunTable: Any = make_dataclass(
    "RunTable",
    [
        *_copied(LoopSettings, without=("plant", "keep")),
        ("plant", str, setting("", help="Model of the plant's own arms and friction, by name or path.")),
        ("zeros", tuple[float, ...], setting((), unit="rad", help="Readings of the rig's hanging arms.")),
        *(one for kind in BENCH.values() for one in _copied(kind, without=("explicit",))),
        ("blows", tuple[Push, ...], setting((), help="Blows at given times.")),
    ],
    bases=(Settings,),
    namespace={"__doc__": "The table [run] of an itinerary's file.", "TABLE": "run"},
    frozen=True,
)
