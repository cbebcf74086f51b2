"""Transfers from rest to the stops of an itinerary.

The arms hang at rest. The transfers serve the recovery from falls.

Each stop has a transfer from rest to a state of the plan's reference at which the arms pass the saddle's angles. The
state is early in the stay, so that the feedback settles before the stay ends. A stop at rest needs none.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.document import picked
from dpcontrol.foundation.errors import GoalMissed, remark
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.judge.decoding import Visit, decode_run
from dpcontrol.plans.itinerary import Itinerary
from dpcontrol.plans.pieces import ways_round
from dpcontrol.plans.transfers import kept_transfer
from dpcontrol.references.content import PlanStart
from dpcontrol.references.reference import Reference

_RATE = 100.0
"""Sampling rate of a stop's places, Hz: joints are whole ticks at usual rates."""
_PLACES = 3
"""Places tried for each stop."""
_STILL = 1e-6
"""Tolerance of a state at rest: rad, rad/s, m and m/s."""


def planned_starts(
    itinerary: Itinerary,
    reference: Reference,
    *,
    found: Callable[[PlanStart], None] | None = None,
    progress: Progress = no_progress,
) -> tuple[PlanStart, ...]:
    """Return the possible starts, which lead to an itinerary's stops in order.

    A stop that cannot be reached from rest is skipped with a remark, and the one before it is used.

    Args:
        itinerary: arms, limits and settings.
        reference: reference of the plan.
        found: called with each planned start.
        progress: receiver of progress reports.

    Raises:
        GoalMissed: the first stop cannot be reached.
    """
    stops, n = reference.content.stops, itinerary.model.arms.count
    times = np.arange(0.0, reference.duration, 1 / _RATE)
    states = reference.state(times)
    starts: list[PlanStart] = []
    stays = decode_run(times, states[:, :n], reference).visits
    for number, stay in enumerate(stays):
        here = part_of(progress, number / len(stays), (number + 1) / len(stays))
        try:
            start = _start(itinerary, number, states[stay.first : stay.last + 1], stay, here)
        except GoalMissed as error:
            text = f"from rest to stop {number + 1} ({stops[number].saddle}): {error}"
            if not starts:
                raise GoalMissed(f"{itinerary.path}: on_fall: {text}") from error
            remark(f"{itinerary.path}: on_fall: {text}; after a fall, the run returns to the stop before it")
            continue
        starts.append(start)
        if found is not None:
            found(start)
    return tuple(starts)


def _start(itinerary: Itinerary, number: int, states: Array, stay: Visit, progress: Progress) -> PlanStart:
    """Return the start to a stop with states (K, N) of its stay."""
    n = itinerary.model.arms.count
    places = _places(states, np.array(stay.angles))
    first = states[places[0]]
    turns = np.rint(first[:n] / (2 * np.pi))
    if np.abs(first - np.pad(2 * np.pi * turns, (0, n + 2))).max() <= _STILL:
        at = (stay.first + int(places[0])) * (1 / _RATE)
        return PlanStart(number, at, tuple(turns.astype(int).tolist()), "at rest")
    lead_in, place, short = _transfer(itinerary, states, places, progress)
    return PlanStart(
        number, (stay.first + place) * (1 / _RATE), short, **picked(lead_in, "status", "mesh", "states", "inputs")
    )


def _places(states: Array, angles: Array) -> NDArray[np.intp]:
    """Return rows of a stay's states for a transfer to join.

    The states are (K, N). The best row is the first.

    angles (n,): the saddle's. Arms on an orbit pass these angles twice a period. A constant stay is joined in its
    middle.
    """
    n = len(angles)
    if np.abs(states[:, n : 2 * n]).max() <= _STILL:
        # A stop at rest is equivalent to hanging from the beginning.
        return np.array([0 if not angles.any() else len(states) // 2])
    away = np.abs(states[:, :n] - angles).max(axis=1)
    inner = np.flatnonzero((away[1:-1] <= away[:-2]) & (away[1:-1] < away[2:])) + 1
    near = inner[away[inner] < 2 * away[inner].min() + 0.1] if len(inner) else inner
    begins = [0] if away[0] <= away[1] else []
    found = np.concatenate([np.array(begins, dtype=np.intp), near])
    return (found if len(found) else np.array([int(np.argmin(away))]))[:_PLACES]


def _transfer(
    itinerary: Itinerary, states: Array, places: Sequence[int] | NDArray[np.intp], progress: Progress
) -> tuple[Reference, int, tuple[int, ...]]:
    """Return a transfer from rest to one of several places.

    The places are those of states (K, N). The place and the missing turns follow.
    """
    n = itinerary.model.arms.count
    candidates: list[tuple[int, tuple[int, ...], Array]] = []
    for place in places:
        for turns in ways_round(-states[place, :n] / (2 * np.pi)):
            end = states[place].copy()
            end[:n] += 2 * np.pi * turns
            candidates.append((int(place), tuple(-int(turn) for turn in turns), end))
    limits = itinerary.limits
    if itinerary.loop.travel:
        limits = replace(limits, position=min(limits.position, itinerary.loop.travel))
    found = kept_transfer(
        replace(itinerary, limits=limits), np.zeros(2 * n + 2), [end for *_, end in candidates], progress=progress
    )
    landed = found.state(found.duration)
    place, turns, _ = candidates[int(np.argmin([np.abs(landed - end).max() for *_, end in candidates]))]
    return found, place, turns
