"""Where seeds of tubes end: too near their orbit, rounding hides where tubes meet; too far, they leave the manifold.

Too near, chance decides, for each search has rounding of its own: the border is where half of them find all. Too far,
the tube's second-order part is left out, an error of δ² at the seed. Neither border has a formula of a few lines.
"""

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.edges import Attempt, Border, EdgeChart, EdgeMap, find_border, half_of
from dpcontrol.foundation.progress import Progress
from dpcontrol.orbits.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.scenes.model import load_model
from dpcontrol.tubes.connections import ConnectionSearch, find_connections
from dpcontrol.tubes.intersections import ConnectionSettings

Array = NDArray[np.float64]

SADDLE = "down-up"
ENERGIES, QUICK_ENERGIES = (-0.07, 0.05, 0.2), (0.05,)
DEFAULT = ConnectionSettings().distance
RIGHT = 1e-9
"""Scaled: how far a connection may lie from the one that the default settings find."""
ANEW = 1e-6
"""Share of the distance whose change draws all rounding anew, and changes nothing else."""
DRAWS, QUICK_DRAWS = 7, 3


def chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: one energy, fewer searches."""
    system = load_model("lab").system
    energies, draws, ratio = (QUICK_ENERGIES, QUICK_DRAWS, 2.0) if quick else (ENERGIES, DRAWS, 1.25)
    nearest, farthest = [], []
    for k, energy in enumerate(energies):
        progress(f"edges of seeds, {energy:g} J", k / len(energies))
        orbit = lyapunov_orbit(system, SADDLE, energy=energy)
        states = default_states(orbit)
        nearest.append(near_border(orbit, states, draws=draws, ratio=ratio))
        farthest.append(far_border(orbit, states, ratio=ratio))
    words = {"far": "connections are missing", "near": "all are found", "log_x": False}
    y = "distance of the seeds from the orbit, scaled"
    return EdgeChart(
        name="edges-seeds",
        title="Where seeds of tubes end: connections of Down-Up with itself",
        maps=(
            EdgeMap("Too near", "energy, J", y, tuple(nearest), **words),
            EdgeMap("Too far", "energy, J", y, tuple(farthest), **words),
        ),
        reading=(
            "Left: the nearest seeds, right: the farthest, with which a search finds every connection of that energy; "
            "beyond either it says \"at least\" so many, and why.",
            f"Too near, chance decides: of {draws} searches, each with rounding of its own, at least half find all.",
            "Rounding over the distance hides where tubes meet; too far, seeds leave the manifold by the square of "
            "their distance.",
        ),
        chosen="Seeds 1e-4 from the orbit: some ninety times from the nearer border where that is worst.",
    )  # fmt: skip


def search(orbit: LyapunovOrbit, distance: float) -> ConnectionSearch:
    """Return the orbit's connections with itself from seeds at `distance`."""
    return find_connections(orbit, orbit, settings=ConnectionSettings(distance=distance))


def default_states(orbit: LyapunovOrbit) -> Array:
    """Return the states (K, N) of all connections on their section, from seeds at the default distance."""
    return np.array([c.state for c in search(orbit, DEFAULT).connections])


def found_all(orbit: LyapunovOrbit, states: Array, distance: float) -> Attempt:
    """Return whether a search finds the connections of `states` (K, N), and no others, else what it says."""
    found = search(orbit, distance)
    away = [float(np.min(orbit.system.scaled_distance(states, c.state))) for c in found.connections]
    right = len(away) == len(states) and max(away) < RIGHT
    if right:
        return Attempt(True)
    # A search that believes itself complete has reported nothing.
    return Attempt(False, "" if found.status.startswith(f"{len(away)} connections") else found.status)


def near_border(orbit: LyapunovOrbit, states: Array, *, draws: int = DRAWS, ratio: float = 1.25) -> Border:
    """Return the distance of seeds at which half of the searches find all connections, those of `states` (K, N)."""

    def probe(distance: float) -> Attempt:
        answers = [found_all(orbit, states, distance * (1 + ANEW * draw)) for draw in range(draws)]
        return half_of(answers, "searches miss connections")

    return find_border(probe, x=orbit.energy, line=f"{orbit.energy:g} J", near=5e-6, far=1e-9, ratio=ratio)


def far_border(orbit: LyapunovOrbit, states: Array, *, ratio: float = 1.25) -> Border:
    """Return the largest distance of seeds with which all connections are found, those of `states` (K, N)."""
    return find_border(
        lambda distance: found_all(orbit, states, distance), x=orbit.energy, line=f"{orbit.energy:g} J", near=0.15,
        far=0.6, ratio=ratio,
    )  # fmt: skip
