"""Where seeds of tubes end: too near their orbit, rounding hides where tubes meet; too far, they leave the manifold.

A seed lies δ (scaled) from its orbit along the unstable direction. Rounding η there changes its amplitude by η/δ, which
moves its arrival at the section along the tube by

    (η / (δ ln λ)) ∂P/∂phase:      scatter of the arrivals ∝ 1/δ

Two tubes are said to meet where a step of Newton's method leaves a gap below `accept`. Each step draws the rounding
anew, so that a meeting is found with probability 1 - (1 - p)^n, p that of a gap below `accept` and n the steps: the
border foretold is where all meetings are found as likely as not. The scatter is measured at the default distance, never
at the border.
Too far, the tube's second-order part is left out, an error of δ² at the seed; what that does to cuts has no formula.

Source: for rounding, Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed., section 2.8.
"""

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.edges import Answer, Border, EdgeChart, EdgeMap, find_border
from dpcontrol.foundation.files import Progress
from dpcontrol.scenes.model import load_model
from dpcontrol.tubes.connections import ConnectionSearch, find_connections
from dpcontrol.tubes.cut import Cut, tube_cut
from dpcontrol.tubes.intersections import ConnectionSettings, Intersection, intersect_cuts
from dpcontrol.tubes.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.tubes.vertex import local_manifold

Array = NDArray[np.float64]

SADDLE = "down-up"
ENERGIES = (-0.07, 0.05, 0.2)
QUICK_ENERGIES = (-0.07,)
RIGHT = 1e-9
"""Scaled: how far a connection may lie from the one that the default settings find."""
LUCK = 1.0
"""How far the border of rounding may be from the foretold one: a few dozen draws of rounding decide where it lies."""
_BESIDE = 1e-13
"""Phase between arrivals that differ by rounding: it moves them by less than rounding does."""
_ARRIVALS = 30
_DRAWS = 50_000
_CONVERGING = 4
"""Newton's steps until only rounding is left of a gap."""


def chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: one energy."""
    system = load_model("lab").system
    energies = QUICK_ENERGIES if quick else ENERGIES
    nearest, farthest = [], []
    for k, energy in enumerate(energies):
        progress(f"edges of seeds, {energy:g} J", k / len(energies))
        orbit = lyapunov_orbit(system, SADDLE, energy=energy)
        nearest.append(near_border(orbit))
        farthest.append(far_border(orbit))
    return EdgeChart(
        name="edges-seeds",
        title="Where seeds of tubes end: connections of Down-Up with itself",
        maps=(
            EdgeMap("Too near", "energy, J", "distance of the seeds from the orbit, scaled", tuple(nearest),
                    theory="rounding over the distance hides a gap of 1e-9", far="connections are missing",
                    near="all are found", log_x=False, agrees=LUCK),
            EdgeMap("Too far", "energy, J", "distance of the seeds from the orbit, scaled", tuple(farthest),
                    far="connections are missing", near="all are found", log_x=False),
        ),
        reading=(
            "Left: the nearest seeds, right: the farthest, with which a search finds every connection of that energy.",
            "Beyond either border it says that it has found \"at least\" so many, and why.",
            "Diamonds: from the scatter of arrivals at the default distance, good to a factor of two only, for few "
            "roundings decide. Too far has no formula: none foretold.",
        ),
        chosen="Seeds 1e-4 from the orbit: some eighty times from the nearer border at the highest energy tried.",
    )  # fmt: skip


def search(orbit: LyapunovOrbit, distance: float) -> ConnectionSearch:
    """Return the orbit's connections with itself from seeds at `distance`."""
    return find_connections(orbit, orbit, settings=ConnectionSettings(distance=distance))


def found_all(orbit: LyapunovOrbit, states: Array, distance: float) -> Answer:
    """Return whether a search finds the connections of `states` (K, N), and no others, else what it says."""
    found = search(orbit, distance)
    away = [float(np.min(orbit.system.scaled_distance(states, c.state))) for c in found.connections]
    right = len(away) == len(states) and max(away) < RIGHT
    if right:
        return Answer(True)
    # A search that believes itself complete has reported nothing.
    return Answer(False, "" if found.status.startswith(f"{len(away)} connections") else found.status)


def crossings(orbit: LyapunovOrbit, distance: float) -> tuple[list[Intersection], Cut]:
    """Return where the orbit's tubes from seeds at `distance` meet, no two of them mirror images, and the cut."""
    settings = ConnectionSettings(distance=distance)
    section = orbit.system.section_between(orbit.saddle, orbit.saddle)
    manifold = local_manifold(orbit, distance)
    cut = tube_cut(manifold, section, hit=1, settings=settings.cut)
    return intersect_cuts(orbit.system, section, (manifold, manifold), (cut, cut), settings)[0], cut


def scatter(crossing: Intersection) -> Array:
    """Return the covariance (N, N) of the gap between both tubes' arrivals that rounding alone makes."""
    offsets = _BESIDE * np.arange(-_ARRIVALS // 2, _ARRIVALS // 2)
    gaps = []
    for offset in offsets:
        first, second = (
            side.arrive(float(phase + offset)) for side, phase in zip(crossing.sides, crossing.phases, strict=True)
        )
        if first is not None and second is not None:
            gaps.append(first[0] - second[0] - offset * (first[1] - second[1]))
    return np.cov(np.array(gaps).T)


def nearest_seeds(orbit: LyapunovOrbit) -> float:
    """Return the distance (scaled) of seeds with which all meetings are found as likely as not."""
    settings = ConnectionSettings()
    rng = np.random.default_rng(0)
    meetings, cut = crossings(orbit, settings.distance)
    gaps = []
    for crossing in meetings:
        # A step answers the last rounding and meets a new one.
        draws = rng.multivariate_normal(np.zeros(len(crossing.states[0])), 2 * scatter(crossing), _DRAWS)
        gaps.append(np.sort(np.abs(draws).max(1)))
    tries = settings.newton_iterations - _CONVERGING
    # Closed curves cross evenly: where meetings are missing, the search begins anew with chords half as long.
    again = not cut.open_ends
    searches = 1 + int(np.log2(settings.cut.chord / settings.finest)) if again else 1

    def probability(distance: float) -> float:
        below = settings.accept * distance / settings.distance
        each = [np.searchsorted(g, below) / len(g) for g in gaps]
        return 1 - (1 - float(np.prod([1 - (1 - p) ** tries for p in each]))) ** searches

    grid = settings.distance * np.geomspace(1e-5, 1.0, 2000)
    return float(grid[int(np.argmax([probability(d) >= 0.5 for d in grid]))])


def near_border(orbit: LyapunovOrbit, *, ratio: float = 1.25) -> Border:
    """Return the smallest distance of seeds with which all connections are found."""
    states = np.array([c.state for c in search(orbit, ConnectionSettings().distance).connections])
    predicted = nearest_seeds(orbit)
    return find_border(
        lambda d: found_all(orbit, states, d), x=orbit.energy, line=f"{orbit.energy:g} J",
        near=2.5 * predicted, far=predicted / 4, predicted=predicted, ratio=ratio,
    )  # fmt: skip


def far_border(orbit: LyapunovOrbit, *, ratio: float = 1.25) -> Border:
    """Return the largest distance of seeds with which all connections are found."""
    states = np.array([c.state for c in search(orbit, ConnectionSettings().distance).connections])
    return find_border(
        lambda d: found_all(orbit, states, d),
        x=orbit.energy,
        line=f"{orbit.energy:g} J",
        near=0.15,
        far=0.6,
        ratio=ratio,
    )
