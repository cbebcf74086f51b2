"""The tubes that a plan uses: from a stop's orbit to the section of the symbol that leaves it, and on to the next stop.

A plan notes each connection's name, which holds the hits and the section, and the section's lifted height. The unstable
tube of the stop's orbit is flown to that section (`tubes.manifold`); the stable one of the next stop is such a tube
turned around in time. Of both only the branch that meets the section at the plan's height is kept.
Source: Kaheman et al. (2023), section 3.
"""

import re
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.review.context import TubeCurve

Array = NDArray[np.float64]

PHASES = 96
STRANDS = 24
INSTANTS = 160
_HEIGHT = 1e-6
_CHORD = 0.2
"""rad, a rad/s counting a fifth: between neighbours of a cut; where halving the phases brings none, the cut is open."""
_HALVINGS = 5
_NAME = re.compile(r"h(?P<unstable>\d+)\.(?P<stable>\d+)(?::(?P<section>[\w-]+))?@")


def tubes_of(notes: dict[str, Any], system: System) -> tuple[TubeCurve, ...]:
    """Return the tubes of a plan's notes, each once; none for a symbol whose tubes cannot be made."""
    made: dict[tuple[Any, ...], TubeCurve] = {}
    flown: dict[tuple[Any, ...], list[TubeCurve]] = {}
    for k, symbol in enumerate(notes["symbols"]):
        name = _NAME.search(str(symbol["name"] or ""))
        if name is None or symbol["section"] is None:
            continue
        section = system.section_between(symbol["source"], symbol["target"], name["section"])
        height = float(symbol["section"]["value"])
        for stable, stop, hit in (
            (False, notes["stops"][k], int(name["unstable"])),
            (True, notes["stops"][k + 1], int(name["stable"])),
        ):
            index = stop.get("arrived_on", stop["orbit"]) if stable else stop["orbit"]
            entry = notes["orbits"][index]
            tube = (entry["saddle"], entry["energy"], section.name, hit, stable)
            if tube not in flown:
                flown[tube] = list(_flown(system, entry, section=section, hit=hit, stable=stable))
            lift = np.asarray(stop["angles"]) - np.asarray(notes["saddles"][stop["saddle"]]["angles"])
            key = (*tube, *np.rint(lift).tolist(), round(height, 6))
            if key not in made:
                made |= {(*key, b): c for b, c in enumerate(_at(flown[tube], section, lift=lift, height=height))}
    return tuple(made.values())


def _flown(
    system: System, orbit_note: dict[str, Any], *, section: Section, hit: int, stable: bool
) -> Iterator[TubeCurve]:
    """Yield both branches of an orbit's tube at the orbit's own place."""
    try:
        orbit = lyapunov_orbit(system, orbit_note["saddle"], energy=float(orbit_note["energy"]))
    except InputError:
        return
    manifold = UnstableManifold(orbit)
    longest = system.flight_periods * orbit.period
    for branch in (1, -1):
        seeds, _ = manifold.seeds(np.arange(PHASES) / PHASES, branch)
        crossings = system.propagator.crossings(seeds, section, longest=longest, hit=hit)
        strands = [
            system.propagator.sample(seeds[k], np.linspace(0.0, crossing.time, INSTANTS))
            for k in range(0, PHASES, PHASES // STRANDS)
            if (crossing := crossings[k]) is not None
        ]
        if strands:
            ends_of = partial(_ends, manifold, section, branch=branch, longest=longest, hit=hit)
            states, ends = np.array(strands), _resolved(ends_of)
            if stable:
                turn, centre = system.reversers[0].T, orbit.centre
                states, ends = (states - centre) @ turn + centre, (ends - centre) @ turn + centre
            yield TubeCurve(stable, states, ends)


def _ends(
    manifold: UnstableManifold, section: Section, phases: Array, *, branch: int, longest: float, hit: int
) -> Array:
    """Return where the trajectories of these phases (K,) meet the section (K, 2n), nan where they do not."""
    seeds, _ = manifold.seeds(phases, branch)
    system = manifold.orbit.system
    found = system.propagator.crossings(seeds, section, longest=longest, hit=hit)
    return np.array([c.state if c else np.full(system.dimension, np.nan) for c in found])


def _resolved(ends_of: Callable[[Array], Array]) -> Array:
    """Return a cut (C, 2n) in order of phase, its first point again at the end, nan between points that lie apart."""
    phases: Array = np.arange(PHASES + 1) / PHASES
    ends = ends_of(phases[:-1])
    ends = np.vstack([ends, ends[:1]])
    for _ in range(_HALVINGS):
        far = np.flatnonzero(_chords(ends) > _CHORD)
        if not len(far):
            break
        between = (phases[far] + phases[far + 1]) / 2
        ends = np.insert(ends, far + 1, ends_of(between), axis=0)
        phases = np.insert(phases, far + 1, between)
    apart = np.flatnonzero(_chords(ends) > _CHORD)
    return np.insert(ends, apart + 1, np.nan, axis=0)


def _chords(ends: Array) -> Array:
    half = ends.shape[1] // 2
    steps = np.diff(ends, axis=0) * np.repeat([1.0, 0.2], half)
    return np.asarray(np.linalg.norm(steps, axis=1), dtype=np.float64)


def _at(curves: list[TubeCurve], section: Section, *, lift: Array, height: float) -> Iterator[TubeCurve]:
    """Yield those parts of the tubes, moved by whole turns (n,), that meet the section at a lifted height."""
    move = np.concatenate([lift, np.zeros_like(lift)])
    normal = np.asarray(section.normal)
    for curve in curves:
        strands, cut = curve.strands + move, curve.cut + move
        kept = np.abs(strands[:, -1] @ normal - height) < _HEIGHT
        if kept.any():
            there = np.abs(cut @ normal - height) < _HEIGHT
            yield TubeCurve(curve.stable, strands[kept], np.where(there[:, None], cut, np.nan))
