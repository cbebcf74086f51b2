"""Where seeds of tubes end: too near their orbit, rounding hides where tubes meet; too far, they leave the manifold.

Too near, chance decides, for each search has rounding of its own: the border is where half of them find all. It is
measured by the up-and-down method, which tries a nearer distance after a search that finds all and a farther one after
one that does not, and foretold from the rounding of arrivals at the default distance (`seed_rounding`).
Too far, the tube's second-order part is left out, an error of δ² at the seed; what that does to cuts has no formula.

Source: Dixon & Mood, A method for obtaining and analyzing sensitivity data, Journal of the American Statistical
Association 43 (1948).
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.edges import Answer, Border, EdgeChart, EdgeMap, Trial, find_border
from dpcontrol.bench.seed_rounding import ANEW, DEFAULT, Chances, Searches
from dpcontrol.foundation.progress import Progress
from dpcontrol.orbits.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.scenes.model import load_model
from dpcontrol.tubes.connections import ConnectionSearch, find_connections
from dpcontrol.tubes.intersections import ConnectionSettings

Array = NDArray[np.float64]

SADDLE = "down-up"
ENERGIES = (-0.07, 0.05, 0.2)
QUICK_ENERGIES = (0.05,)
RIGHT = 1e-9
"""Scaled: how far a connection may lie from the one that the default settings find."""
DRAWS = 20
QUICK_DRAWS = 10
STEP = 1.3
"""From one distance of the up-and-down method to the next: about as much as chance spreads borders by."""
_MOST_ASKED = 12


def chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: one energy, fewer searches."""
    system = load_model("lab").system
    energies, draws, ratio = (QUICK_ENERGIES, QUICK_DRAWS, 2.0) if quick else (ENERGIES, DRAWS, 1.25)
    nearest, farthest = [], []
    for k, energy in enumerate(energies):
        progress(f"edges of seeds, {energy:g} J", k / len(energies))
        orbit = lyapunov_orbit(system, SADDLE, energy=energy)
        states = default_states(orbit)
        nearest.append(near_border(orbit, states, draws=draws))
        farthest.append(far_border(orbit, states, ratio=ratio))
    return EdgeChart(
        name="edges-seeds",
        title="Where seeds of tubes end: connections of Down-Up with itself",
        maps=(
            EdgeMap("Too near", "energy, J", "distance of the seeds from the orbit, scaled", tuple(nearest),
                    theory="rounding over the distance hides a gap of 1e-9", far="connections are missing",
                    near="all are found", log_x=False),
            EdgeMap("Too far", "energy, J", "distance of the seeds from the orbit, scaled", tuple(farthest),
                    far="connections are missing", near="all are found", log_x=False),
        ),
        reading=(
            "Left: the nearest seeds, right: the farthest, with which a search finds every connection of that energy; "
            "beyond either it says \"at least\" so many, and why.",
            f"Too near, chance decides: the border of {draws} searches, each with rounding of its own, is where half "
            "find all; its sides are a standard error off.",
            "Diamonds: from the rounding of arrivals at the default distance and Newton's steps. Too far has no "
            "formula: none foretold.",
        ),
        chosen="Seeds 1e-4 from the orbit: some ninety times from the nearer border where that is worst.",
    )  # fmt: skip


def search(orbit: LyapunovOrbit, distance: float) -> ConnectionSearch:
    """Return the orbit's connections with itself from seeds at `distance`."""
    return find_connections(orbit, orbit, settings=ConnectionSettings(distance=distance))


def default_states(orbit: LyapunovOrbit) -> Array:
    """Return the states (K, N) of all connections on their section, from seeds at the default distance."""
    return np.array([c.state for c in search(orbit, DEFAULT).connections])


def found_all(orbit: LyapunovOrbit, states: Array, distance: float) -> Answer:
    """Return whether a search finds the connections of `states` (K, N), and no others, else what it says."""
    found = search(orbit, distance)
    away = [float(np.min(orbit.system.scaled_distance(states, c.state))) for c in found.connections]
    right = len(away) == len(states) and max(away) < RIGHT
    if right:
        return Answer(True)
    # A search that believes itself complete has reported nothing.
    return Answer(False, "" if found.status.startswith(f"{len(away)} connections") else found.status)


def up_and_down(works: Callable[[float], bool], *, start: float, draws: int) -> tuple[float | None, list[float]]:
    """Return the value at which half of the answers are yes, by chance, None if none is no; and the values tried.

    After a yes the next value is a step lower, after a no a step higher. What comes before the first no leads there.
    """
    values, first = [start], None
    for k in range(draws):
        works_here = works(values[-1])
        if first is None and not works_here:
            first = k
        values.append(values[-1] / STEP if works_here else values[-1] * STEP)
    # Where the next one would be tried tells as much as where the last one was.
    return None if first is None else float(np.exp(np.mean(np.log(values[first:])))), values[:-1]


def asked(orbit: LyapunovOrbit, states: Array, distance: float, *, wanted: bool) -> Answer | None:
    """Return the first answer that is as wanted from whole searches with rounding drawn anew, None if none is."""
    answers = (found_all(orbit, states, distance * (1 + ANEW * draw)) for draw in range(_MOST_ASKED))
    return next((answer for answer in answers if answer.works == wanted), None)


def near_border(orbit: LyapunovOrbit, states: Array, *, draws: int) -> Border:
    """Return the distance of seeds at which half of the searches find all connections, those of `states` (K, N)."""
    searches = Searches(orbit)
    chances = Chances(searches)
    predicted = chances.distance()
    answers: list[bool] = []

    def works(distance: float) -> bool:
        answers.append(bool(searches.found(distance, len(answers)).all()))
        return answers[-1]

    middle, values = up_and_down(works, start=1.5 * predicted, draws=draws)
    trials = [Trial(value, answer, "") for value, answer in zip(values, answers, strict=True)]
    near, far, says = values[-1], None, ""
    if middle is not None:
        # As of a normal distribution: two deviations from 16 to 84 %, and the border's error is one over √(draws / 2).
        error = float(np.log(chances.distance(0.84) / chances.distance(0.16))) / 2 / np.sqrt(draws / 2)
        near, far = middle * float(np.exp(error)), middle / float(np.exp(error))
        whole = {side: asked(orbit, states, side, wanted=side == near) for side in (near, far)}
        trials += [Trial(side, answer.works, answer.says) for side, answer in whole.items() if answer]
        near, says = near if whole[near] else None, getattr(whole[far], "says", "")
    return Border(
        x=orbit.energy, line=f"{orbit.energy:g} J", near=near, far=far, predicted=predicted, says=says,
        trials=tuple(sorted(trials, key=lambda t: t.y)),
    )  # fmt: skip


def far_border(orbit: LyapunovOrbit, states: Array, *, ratio: float = 1.25) -> Border:
    """Return the largest distance of seeds with which all connections are found, those of `states` (K, N)."""
    return find_border(
        lambda d: found_all(orbit, states, d),
        x=orbit.energy,
        line=f"{orbit.energy:g} J",
        near=0.15,
        far=0.6,
        ratio=ratio,
    )
