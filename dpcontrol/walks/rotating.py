"""Rotating orbits as vertices that a walk asks for by name, as "outer-rotating" or "inner-rotating-back-2".

The name says which arm turns, "-back" that it turns clockwise, and the number which of the hyperbolic ones is meant,
the fastest first. Nothing looks for them unless they are named: they are many, and their connections with saddles'
orbits are found among the laps of their tubes. A wrap at such a stop is a turn.

Source: Kaheman et al. (2023), section 4.
"""

import re
from dataclasses import replace

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.orbits.curve import HyperbolicOrbit, rotating_vertex
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.orbits.rotating import can_rotate, rotating_orbits
from dpcontrol.tubes.connections import ConnectionSearch
from dpcontrol.tubes.lap_connections import find_lap_connections, grown_crossing, own_crossings

_ROTATING = re.compile(r"^(?P<arm>inner|outer)-rotating(?P<back>-back)?(?:-(?P<number>[2-9]))?$")
_LONGER = 3
"""Crossings tried after the first: with each the tube's cut is longer by |λ|, and its search slower."""
_ARMS = {"inner": 1, "outer": 2}


def rotating_names(system: System) -> list[str]:
    """Return the names under which a system's fastest rotating orbits may be asked for."""
    return [f"{arm}-rotating{back}" for arm in ("outer", "inner") for back in ("", "-back")] * can_rotate(system)


def is_rotating(name: str) -> bool:
    """Tell whether a vertex's name is that of a rotating orbit."""
    return _ROTATING.match(name) is not None


def rotating_named(system: System, name: str, energy: float) -> HyperbolicOrbit:
    """Return the rotating orbit of that name at `energy` (J).

    Raises:
        InputError: no such orbit is found, or the system has no two arms.
    """
    match = _ROTATING.match(name)
    if match is None:
        raise InputError(f"{name!r} is no rotating orbit: they are {', '.join(rotating_names(system))}")
    arm, number = match["arm"], int(match["number"] or 1)
    orbits = rotating_orbits(system, _ARMS[arm], energy, sense=-1 if match["back"] else 1)
    hyperbolic = [orbit for orbit in reversed(orbits) if "hyperbolic" in orbit.kind]
    if number > len(hyperbolic):
        raise InputError(
            f"there is no {name!r} at {energy:g} J: of {len(orbits)} orbits found that turn the {arm} arm that way, "
            f"{len(hyperbolic)} are hyperbolic; try another energy (`dpcontrol orbit --rotating {arm}` lists them)"
        )
    return rotating_vertex(hyperbolic[number - 1], name=name)


def rotating_connections(
    source: LyapunovOrbit, target: LyapunovOrbit, *, section: str | None = None, progress: Progress = no_progress
) -> ConnectionSearch:
    """Find connections between a rotating orbit and a saddle's, either way.

    section: short name of the one to search on; by default the first that the rotating orbit crosses and the other
    does not, of its arm hanging straight down and both arms aligned. The rotating orbit's tube is followed until it
    has grown large, and up to three of its crossings longer if it meets nothing there.

    Raises:
        InputError: both rotate, or there is no such section.
    """
    lapping = [orbit for orbit in (source, target) if isinstance(orbit, HyperbolicOrbit)]
    if len(lapping) != 1:
        raise InputError(
            f"{source.saddle} > {target.saddle}: connections are found between a rotating orbit and a saddle's; go by "
            "way of a saddle"
        )
    home = target if lapping[0] is source else source
    searched = _section(lapping[0], home, section)
    first = crossing = grown_crossing(lapping[0], searched)
    found = find_lap_connections(source, target, section=searched, crossings=(crossing,), progress=progress)
    while not found.connections and crossing < first + _LONGER:
        crossing += 1
        found = find_lap_connections(source, target, section=searched, crossings=(crossing,), progress=progress)
    if found.connections:
        return found
    never = f"none where {lapping[0].saddle}'s tube crosses {searched.name} for the {first}. to {crossing}. time"
    return replace(found, status=f"{never}; there may be some later")


def _section(lapping: HyperbolicOrbit, home: LyapunovOrbit, name: str | None) -> Section:
    system = lapping.system
    if name is not None:
        candidates = [system.section_between(home.saddle, home.saddle, name)]
    else:
        match = _ROTATING.match(lapping.saddle)
        arm = "outer" if match is None else match["arm"]
        candidates = [system.named_sections[key] for key in (f"{arm}-down", "aligned")]
    for section in candidates:
        if own_crossings(lapping, section) and not own_crossings(home, section):
            return section
    raise InputError(
        f"{lapping.saddle} and {home.saddle}: the first must cross the section of their connections itself and the "
        f"second must not, which holds for none of {', '.join(s.name for s in candidates)}; go by way of another saddle"
    )
