"""An independent decoder of runs to check verdicts, written from the definition with another method.

A run is completed if every symbol has its winding and wraps and the cart stays inside its limits. Over the last full
period, both angles must also be within 0.1 rad of the last orbit.

A tick has a label if the pendulum's angles and rates are near an orbit of the plan, about a saddle on any whole
turns. The labels in order must be the plan's stops, with other labels in between only if the reference also contains
them. Wraps are counted by phase, as turns of (angle, rate) about the stop for the arm with the largest swing. The
periods between the halfway points of the neighbouring flights are compared with those of the reference. Peaks are not
counted, because small swings hide some of them and others belong to the flights.

A reference from rest waits before its first transfer. A run may be anywhere then, but its arms must hang when the
transfer begins.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from dpcontrol.references.content import stored

Array = np.ndarray
Label = tuple[str, tuple[int, ...]]

RATE_UNIT = 8.0
"""Rate equivalent to one rad, rad/s: a swing's frequency makes distances independent of the phase."""
NEAR = 0.5
"""rad, scaled."""
BESIDE = 1.5
"""Distance within which the reference counts as near other orbits, over NEAR."""
LOOKS = 200.0
"""Hz."""
BRIEF = 0.02
"""Duration below which labels are passages, s."""
WAITS, HANGS = 0.5, 1.5
"""Longest wait at rest that no itinerary asks for, s, and the arms' largest angle at its end, rad."""
LAST = 0.1
"""Allowed deviation over the last period, rad."""


@dataclass(frozen=True)
class Plan:
    """The plan's stops and orbits with samples (M, 2n), and the reference's states (K, 2n+2) at `rate` Hz.

    The cart's limits are in m, m/s and m/s².
    """

    notes: dict
    curves: list[Array]
    states: Array
    rate: float
    limits: tuple[float, float, float]

    @property
    def arms(self) -> int:
        return self.states.shape[1] // 2 - 1

    @property
    def stops(self) -> list[Label]:
        return [self.label(stop["saddle"], np.array(stop["angles"])) for stop in self.notes["stops"]]

    @cached_property
    def made(self) -> list[tuple[Label, int, int]]:
        """The labels of the reference."""
        return labels(self, self.states)

    @property
    def waits(self) -> int:
        """Number of ticks at rest before the first transfer."""
        hangs = "up" not in self.notes["stops"][0]["saddle"] and self.notes["transfers"]
        seconds = self.notes["transfers"][0][0] if hangs else 0.0
        return round(seconds * self.rate) if seconds < WAITS + 1 / self.rate else 0

    def label(self, saddle: str, angles: Array) -> Label:
        home = np.array(self.notes["saddles"][saddle]["angles"])
        return saddle, tuple(np.rint((angles - home) / (2 * np.pi)).astype(int).tolist())


def plan_of(reference, rate: float, limits: tuple[float, float, float]) -> Plan:
    times = np.arange(0.0, reference.duration, 1 / rate)
    notes, arrays = stored(reference.content)
    return Plan(
        notes, [arrays[f"orbit_{k}"] for k in range(len(notes["orbits"]))], reference.state(times), rate, limits
    )


def labels(plan: Plan, states: Array, near: float = NEAR) -> list[tuple[Label, int, int]]:
    n, stride = plan.arms, max(1, round(plan.rate / LOOKS))
    states = states[::stride]
    angles, rates = states[:, :n], states[:, n : 2 * n] / RATE_UNIT
    best = np.full(len(states), near)
    which = np.full(len(states), -1)
    found: list[Label] = []
    for orbit, curve in zip(plan.notes["orbits"], plan.curves, strict=True):
        scaled = np.hstack([curve[:, :n], curve[:, n : 2 * n] / RATE_UNIT])
        # Chords connect the samples of fast orbits.
        scaled = np.concatenate([scaled + s * (np.roll(scaled, -1, axis=0) - scaled) for s in (0.0, 0.25, 0.5, 0.75)])
        home = np.array(plan.notes["saddles"][orbit["saddle"]]["angles"])
        tree = cKDTree(scaled)
        # Orbits extend less than a turn from their saddle, so each arm has two candidates.
        lower = np.floor((angles - home) / (2 * np.pi))
        for up in np.ndindex(*(2,) * n):
            turns = lower + np.array(up)
            distance, _ = tree.query(
                np.hstack([angles - 2 * np.pi * turns, rates]), p=np.inf, distance_upper_bound=near
            )
            for row in np.unique(turns[distance < best], axis=0):
                label = (orbit["saddle"], tuple(row.astype(int).tolist()))
                if label not in found:
                    found.append(label)
                here = (distance < best) & (turns == row).all(axis=1)
                which[here], best[here] = found.index(label), distance[here]
    out: list[tuple[Label, int, int]] = []
    edges = np.flatnonzero(np.diff(which)) + 1
    for first, end in zip(np.r_[0, edges], np.r_[edges, len(which)], strict=True):
        if which[first] < 0 or (end - first) * stride < BRIEF * plan.rate:
            continue
        label = found[which[first]]
        if out and out[-1][0] == label:
            out[-1] = (label, out[-1][1], (int(end) - 1) * stride)
        else:
            out.append((label, int(first) * stride, (int(end) - 1) * stride))
    return out


def _matched(seen: list[tuple[Label, int, int]], stops: list[Label]) -> list[tuple[int, int]] | None:
    """Return the first and last ticks of each stop, None if one is missing."""
    spans, at = [], 0
    for k, stop in enumerate(stops):
        while at < len(seen) and seen[at][0] != stop:
            at += 1
        if at == len(seen):
            return None
        first, last = seen[at][1:]
        # The stop lasts until the next one begins.
        while at + 1 < len(seen) and (k + 1 == len(stops) or stops[k + 1] not in [s[0] for s in seen[at + 1 : at + 2]]):
            if stop == seen[at + 1][0]:
                last = seen[at + 1][2]
            elif k + 1 < len(stops) and stops[k + 1] == seen[at + 1][0]:
                break
            at += 1
        spans.append((first, last))
        at += 1
    return spans


def _half_way(plan: Plan, states: Array, spans: list[tuple[int, int]], flight: int) -> int:
    here, there = (np.array(stop["angles"]) for stop in plan.notes["stops"][flight : flight + 2])
    first, last = spans[flight][1], spans[flight + 1][0]
    way = there - here
    if last <= first or not np.abs(way).max() > 1.0:
        return (first + last) // 2
    done = (states[first : last + 1, : plan.arms] - here) @ way / (way @ way)
    # The number of ticks on the near half is continuous, unlike the time of a crossing.
    return first + int(np.count_nonzero(done < 0.5))


def phase_turns(plan: Plan, states: Array, spans: list[tuple[int, int]], stop: int) -> float:
    """Return the turns of the phase about a stop between the neighbouring halfway points.

    The phase is that of the arm with the largest swing about its median, so a tilted track has no effect. The middle
    of its range would be off for swings that decay between two flights. In flight, arms may be at rest without a
    phase, so a period of the orbit counts as a turn.
    """
    n, (first, last) = plan.arms, spans[stop]
    index = plan.notes["stops"][stop]["orbit"]
    arm = int(np.argmax(np.ptp(plan.curves[index][:, :n], axis=0)))
    begin, end = (_half_way(plan, states, spans, flight) for flight in (stop - 1, stop))
    rows = states[first : last + 1]
    middle = np.median(rows[:, arm])
    phase = np.unwrap(np.arctan2(-rows[:, n + arm] / RATE_UNIT, rows[:, arm] - middle))
    flown = (first - begin + end - last) / plan.rate / plan.notes["orbits"][index]["period"]
    return float(phase[-1] - phase[0]) / (2 * np.pi) + flown


def faults(plan: Plan, states: Array) -> list[str]:
    """Return the reasons why a run with true states (K, 2n+2) is not completed."""
    out: list[str] = []
    n, stops = plan.arms, plan.stops
    if not np.isfinite(states).all():
        return ["not finite"]
    if len(states) < len(plan.states) - 1 and len(plan.notes["program"]) < 2:
        out.append(f"ended {(len(plan.states) - len(states)) / plan.rate:.3f} s early")
    begin = plan.waits
    if begin and np.abs(states[min(begin, len(states) - 1), :n]).max() > HANGS:
        out.append("does not hang at its first transfer")
    seen, wanted = labels(plan, np.concatenate([plan.states[:begin], states[begin:]])), plan.made
    spans, due = _matched(seen, stops), _matched(wanted, stops)
    if due is None:
        return [*out, f"the reference itself does not make its stops: {[s[0] for s in wanted]}"]
    if spans is None:
        return [*out, f"stops {[s[0] for s in seen]} instead of {stops}"]
    # A run may be near an orbit that the reference only just misses.
    strange = {s[0] for s in seen} - {s[0] for s in labels(plan, plan.states, BESIDE * NEAR)}
    if strange:
        out.append(f"was at {strange}")
    for k, asked in enumerate(plan.notes["wraps"]):
        if asked is None:
            continue
        mine, theirs = (phase_turns(plan, which, one, k + 1) for which, one in ((states, spans), (plan.states, due)))
        if abs(mine - theirs) >= 0.5:
            out.append(f"{mine:.2f} turns of the phase at stop {k + 1} instead of {theirs:.2f}")
    bounds = [("position", states[:, 2 * n]), ("velocity", states[:, 2 * n + 1])]
    for (name, values), bound in zip(bounds, plan.limits, strict=False):
        if np.abs(values).max() > bound + 1e-9:
            out.append(f"{name} {np.abs(values).max():.4f}")
    if (gap := last_gap(plan, states)) > LAST:
        out.append(f"last period {gap:.3f} rad off")
    return out


def last_gap(plan: Plan, states: Array) -> float:
    """Return the distance of the angles from the last orbit over its last period or hold, rad."""
    n, stop = plan.arms, plan.notes["stops"][-1]
    orbit = plan.notes["orbits"][stop["orbit"]]
    home = np.array(plan.notes["saddles"][stop["saddle"]]["angles"])
    count = int(orbit["period"] * plan.rate)
    if plan.notes["transfers"]:
        count = min(count, int((len(plan.states) / plan.rate - plan.notes["transfers"][-1][1]) * plan.rate))
    curve = plan.curves[stop["orbit"]][:, :n]
    shares = np.linspace(0.0, 1.0, 16, endpoint=False)
    dense = np.concatenate([curve + s * (np.roll(curve, -1, axis=0) - curve) for s in shares])
    late = states[-count:, :n] - (np.array(stop["angles"]) - home)
    return float(cKDTree(dense).query(late, p=np.inf)[0].max())
