"""How often a connection crosses its section: its flight's heights over the section, extremum by extremum."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.tubes.links import Link, LinkProblem

Array = NDArray[np.float64]

_SAMPLES = 300  # of each half of a flight: about twenty to an arm's swing


@dataclass(frozen=True)
class Profile:
    """How a connection's flight runs over the section's heights.

    times (M,) s from the seed and heights (M,) of its ends and of every extremum between; levels (M - 1,): how many
    levels each monotonic part crosses; count: crossings in all.
    """

    times: Array
    heights: Array
    levels: tuple[int, ...]
    count: int


def fly_whole(problem: LinkProblem, link: Link, energy: float) -> tuple[Array, Array]:
    """Return times (M,) s from the seed and states (M, N) of the whole flight, from seed to seed."""
    first, second = problem.manifolds(energy)
    half = np.linspace(0.0, link.duration / 2, _SAMPLES + 1)
    propagator = problem.system.propagator
    out = propagator.sample(first.seeds(np.array([link.phases[0]]), link.branches[0])[0][0], half)
    back = propagator.sample(second.seeds(np.array([link.phases[1]]), link.branches[1])[0][0], half)
    back = (back - problem.centre(problem.target)) @ problem.system.reversers[0].T + problem.centre(problem.target)
    back = back + np.asarray(link.turns) * problem.lengths
    return np.concatenate([half, link.duration - half[::-1][1:]]), np.vstack([out, back[::-1][1:]])


def profile(problem: LinkProblem, link: Link, energy: float, section: Section) -> Profile:
    """Count a solved connection's crossings of a section, monotonic part by monotonic part."""
    system = problem.system
    times, states = fly_whole(problem, link, energy)
    normal = np.asarray(section.normal)
    rates = system.numeric.rate(states) @ normal
    heights = section.height(states)
    knots_t, knots_h, levels = [times[0]], [heights[0]], []
    ends = [0]
    for k in np.flatnonzero(np.sign(rates[:-1]) * np.sign(rates[1:]) < 0):
        time, height = _extremum(problem, states[k], times[k], rates[k], rates[k + 1], times[k + 1], normal, section)
        knots_t.append(time)
        knots_h.append(height)
        ends.append(int(k))
    knots_t.append(times[-1])
    knots_h.append(heights[-1])
    ends.append(len(times) - 1)
    for k in range(len(knots_h) - 1):
        low, high = sorted((knots_h[k], knots_h[k + 1]))
        period = section.period
        crossed = int(np.floor(high / period) - np.floor(low / period)) if period else int(low < 0 <= high)
        if crossed and section.side is not None:
            # With a side to it the crossing's own state decides.
            part = slice(ends[k], ends[k + 1] + 2)
            at = int(np.argmin(np.abs(heights[part]))) + ends[k]
            crossed = int(section.admits(states[at]))
        levels.append(crossed)
    return Profile(np.array(knots_t), np.array(knots_h), tuple(levels), sum(levels))


def crossing_states(problem: LinkProblem, link: Link, energy: float, section: Section) -> Array:
    """Return the states (C, N) at which a solved connection crosses a section, in order of time, on the lift."""
    system = problem.system
    _, states = fly_whole(problem, link, energy)
    heights = section.height(states)
    level = np.floor(heights / section.period) if section.period else (heights >= 0).astype(float)
    crossed = []
    for k in np.flatnonzero(np.diff(level)):
        height = max(level[k], level[k + 1]) * section.period if section.period else 0.0
        x = states[k] + (states[k + 1] - states[k]) * (height - heights[k]) / (heights[k + 1] - heights[k])
        for _ in range(3):
            x = system.propagator.flow(
                x, float((height - section.height(x)) / (system.numeric.rate(x) @ section.normal))
            )
        if section.side is None or section.admits(x):
            crossed.append(x)
    return np.array(crossed).reshape(-1, system.dimension)


def _extremum(
    problem: LinkProblem,
    state: Array,
    start: float,
    rate: float,
    next_rate: float,
    stop: float,
    normal: Array,
    section: Section,
) -> tuple[float, float]:
    """Return (time, height) of the extremum of the section's height between two samples, by Newton on its rate."""
    numeric, propagator = problem.system.numeric, problem.system.propagator
    span = stop - start
    step = span * rate / (rate - next_rate)
    x = state
    for _ in range(4):
        x = propagator.flow(state, step)
        f = numeric.rate(x)
        step = float(np.clip(step - (normal @ f) / (normal @ (numeric.jacobian(x) @ f)), 0.0, span))
    return start + step, float(section.height(propagator.flow(state, step)))
