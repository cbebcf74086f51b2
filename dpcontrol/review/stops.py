"""Where a pendulum stopped on its way, and how often it wobbled there, from its angles and a plan's notes.

The lattice of saddles (each saddle's angles plus whole turns) is searched for the point nearest to the pendulum, and a
point counts as visited once it has been nearest for half a period of the quickest orbit. Boxes at the equilibria would
not do: at H = 0.2 the Down-Up orbit swings the inner arm by 1.8 rad, and a turning arm passes near other lattice points
on its way, but quickly. While a plan has it on a transfer, such as a swing-up, it is nowhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

REST = "down-down"
_SAME = 1e-4
"""rad."""


@dataclass(frozen=True)
class Visit:
    """A stay at one lattice point: its angles (n,), first and last tick."""

    angles: tuple[float, ...]
    first: int
    last: int


def _same(a: Sequence[float], b: Sequence[float]) -> bool:
    """Tell whether two lattice points are the same; those of one lattice are a fair part of a turn apart."""
    return all(abs(x - y) <= _SAME for x, y in zip(a, b, strict=True))


def settled_ticks(time: Array, notes: dict[str, Any]) -> NDArray[np.bool_]:
    """Return at which ticks (K,) a plan has the pendulum on an orbit, a connection or at rest: not on a transfer."""
    settled = np.ones(len(time), dtype=bool)
    for begin, end in notes.get("transfers", []):
        settled &= (time <= begin) | (time >= end)
    return settled


def decode_stops(angles: Array, saddles: Array, *, dwell: int, settled: NDArray[np.bool_] | None = None) -> list[Visit]:
    """Return the lattice points visited by angles (K, n), in order.

    saddles (S, n): angles of the saddles; any whole turns of them are lattice points. dwell: ticks for which a point
    must stay nearest to count; shorter stays belong to the way between. settled (K,): ticks that are looked at.
    """
    ticks = np.arange(len(angles)) if settled is None else np.flatnonzero(settled)
    if not ticks.size:
        return []
    # One row for each arm: rows are worked on several times as fast as columns of two or three.
    seen = np.ascontiguousarray(angles[ticks].T)
    distances = np.empty((len(saddles), len(ticks)))
    turns = np.empty((*saddles.shape, len(ticks)))
    for k, saddle in enumerate(saddles):
        np.rint((seen - saddle[:, None]) / (2 * np.pi), out=turns[k])
        distances[k] = np.sqrt(np.add.reduce((seen - (saddle[:, None] + 2 * np.pi * turns[k])) ** 2, axis=0))
    nearest = np.argmin(distances, axis=0)
    turned = np.take_along_axis(turns, nearest[None, None], axis=0)[0]
    changed = nearest[1:] != nearest[:-1]
    for arm in turned:
        changed |= arm[1:] != arm[:-1]
    starts = np.r_[0, np.flatnonzero(changed) + 1]
    ends = np.r_[starts[1:], len(ticks)] - 1
    visits: list[Visit] = []
    for first, last in zip(starts, ends, strict=True):
        point = tuple((saddles[nearest[first]] + 2 * np.pi * turned[:, first]).tolist())
        if visits and _same(visits[-1].angles, point):
            visits[-1] = Visit(point, visits[-1].first, int(ticks[last]))
        elif last - first + 1 >= dwell:
            visits.append(Visit(point, int(ticks[first]), int(ticks[last])))
    return visits


def without_detours(visits: list[Visit], planned: list[Visit], wanted: list[tuple[float, ...]]) -> list[Visit]:
    """Return a run's visits without those that the reference makes too, although they are no stops of its plan.

    A connection may pass close by another saddle for as long as a stop takes. planned: the visits decoded from the
    reference itself; wanted: the angles of the plan's stops. A run need not make a detour that the reference makes.
    """
    stops: list[bool] = []
    for visit in planned:
        due = sum(stops)
        stops.append(due < len(wanted) and _same(visit.angles, wanted[due]))
    if sum(stops) < len(wanted):
        return visits
    kept: list[Visit] = []
    place = 0
    for k, visit in enumerate(visits):
        ahead = place
        while ahead < len(planned) and not stops[ahead] and not _same(planned[ahead].angles, visit.angles):
            ahead += 1
        if ahead == len(planned) or not _same(planned[ahead].angles, visit.angles):
            return kept + visits[k:]
        if stops[ahead]:
            kept.append(visit)
        place = ahead + 1
    return kept


def orbit_index(notes: dict[str, Any], stop: dict[str, Any]) -> int:
    """Return the index of a stop's orbit among the plan's."""
    if "orbit" in stop:
        return int(stop["orbit"])
    return [o["saddle"] for o in notes["orbits"]].index(stop["saddle"])


def section_crossings(
    time: Array, angles: Array, notes: dict[str, Any], visits: list[Visit]
) -> tuple[float | None, ...]:
    """Return when each symbol between `visits`, the stops that were reached, crossed its section, in s.

    None for a transfer, which has no section. It ends before the first symbol whose crossing is not found.
    """
    symbols = notes["symbols"]
    crossings: list[float | None] = []
    for k, (before, after) in enumerate(pairwise(visits)):
        section = symbols[k]["section"]
        if section is None:
            crossings.append(None)
            continue
        height = angles @ np.asarray(section["normal"][: angles.shape[1]]) - section["value"]
        middle, end = (before.first + before.last) // 2, (after.first + after.last) // 2
        signs = np.flatnonzero(height[middle:end] * height[middle + 1 : end + 1] <= 0) + middle
        if signs.size == 0:
            break
        if "program" in notes:
            # Stays last as long as the plant's own period makes them: where it crosses tells which crossing it is.
            i = signs[np.argmin(np.abs(angles[signs] - section["angles"]).max(axis=1))]
        else:
            i = signs[np.argmin(np.abs(time[signs] - symbols[k]["time"]))]
        share = height[i] / (height[i] - height[i + 1]) if height[i] != height[i + 1] else 0.0
        crossings.append(float(time[i] + share * (time[i + 1] - time[i])))
    return tuple(crossings)


def count_wraps(crossings: tuple[float | None, ...], notes: dict[str, Any]) -> tuple[int | None, ...]:
    """Count the wraps at each interior stop that was reached, from the times of the sections' crossings.

    None beside a transfer, and where the orbit is changed at a stop.
    """
    symbols, stops = notes["symbols"], notes["stops"]
    counts: list[int | None] = []
    for k, (arrived, left) in enumerate(pairwise(crossings)):
        stop = stops[k + 1]
        if arrived is None or left is None or "arrived_on" in stop:
            counts.append(None)
            continue
        arriving, leaving = symbols[k], symbols[k + 1]
        gap = (leaving["phase_out"] - arriving["phase_in"]) % 1.0
        spare = left - arrived - arriving["time_in"] - leaving["time_out"]
        counts.append(round(spare / notes["orbits"][orbit_index(notes, stop)]["period"] - gap))
    return tuple(counts)


@dataclass(frozen=True)
class Decoded:
    """What a run's angles say: visits in order, how many of the plan's stops they match from the first on, when each
    symbol crossed its section (s, None for a transfer) and the wraps at each interior stop that was reached.
    """

    visits: tuple[Visit, ...]
    matched: int
    crossings: tuple[float | None, ...]
    wraps: tuple[int | None, ...]


def decode_run(time: Array, angles: Array, reference: Array, *, notes: dict[str, Any], rate_hz: float) -> Decoded:
    """Decode angles (K, n) at times (K,) s that were to follow reference angles (K, n) by a plan's notes."""
    used = {stop["saddle"] for stop in notes["stops"]}
    lattice = np.array([s["angles"] for name, s in notes["saddles"].items() if name in used])
    dwell = max(1, int(0.5 * min(o["period"] for o in notes["orbits"]) * rate_hz))
    settled = settled_ticks(time, notes)
    visits = decode_stops(angles, lattice, dwell=dwell, settled=settled)
    wanted = [tuple(stop["angles"]) for stop in notes["stops"]]
    # Decoding the reference takes as long as the run; a run that made the plan's stops and no other has no detours.
    if len(visits) != len(wanted) or not all(_same(v.angles, w) for v, w in zip(visits, wanted, strict=True)):
        # What the reference barely visits, a run may visit a little longer.
        planned = decode_stops(reference, lattice, dwell=int(0.8 * dwell), settled=settled)
        visits = without_detours(visits, planned, wanted)
    matched = 0
    while matched < min(len(visits), len(wanted)) and _same(visits[matched].angles, wanted[matched]):
        matched += 1
    crossings = section_crossings(time, angles, notes, visits[:matched])
    return Decoded(tuple(visits), matched, crossings, count_wraps(crossings, notes))
