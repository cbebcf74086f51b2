"""Curves to draw of a run: rows that suffice, ranges of axes and times, phase planes, and the points of the arms."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array, true_runs
from dpcontrol.judge.run_view import RunView
from dpcontrol.pages import style

Range = tuple[float, float]


def gap_times(view: RunView) -> Array:
    """Return the middle of each gap in the ticks of a run, s, where drawn lines are interrupted.

    `view.breaks` are the ticks that follow a gap.
    """
    return (view.time[view.breaks] + view.time[view.breaks - 1]) / 2


def extreme_rows(values: Array, *, bins: int) -> NDArray[np.int64]:
    """Return the rows of the least and the greatest value in each bin, and the last row, which suffice to draw a line.

    If there are few values, all rows are returned.

    Args:
        values: (N,) in any unit.
        bins: number of bins.
    """
    size = len(values) // bins
    if size < 3:
        return np.arange(len(values))
    binned = len(values) // size * size
    block = values[:binned].reshape(-1, size)
    if not np.isfinite(block).all():
        block = np.where(np.isfinite(block), block, 0.0)
    extremes = np.sort(np.stack([block.argmin(axis=1), block.argmax(axis=1)], axis=1), axis=1)
    return np.unique(np.concatenate([(extremes + size * np.arange(len(block))[:, None]).ravel(), [len(values) - 1]]))


def padded(values: Array) -> Range:
    """Return the range of the finite values, extended by a tenth on either side, for an axis."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    margin = 0.1 * (high - low) or 0.1 * abs(high) or 1e-3
    return low - margin, high + margin


_MOST = 20_000
"""Number of points of a run in a phase plane."""


@dataclass(frozen=True, eq=False)
class Plane:
    """An arm's phase plane.

    Curves (K, 2) have angles in rad and rates in rad/s, with whole turns counted.

    Attributes:
        arm: number of the arm, counted from zero.
        strands: trajectories of the tubes, by stability.
        cuts: curves where the tubes meet the section, by stability.
        orbits: closed orbits with their colours; an equilibrium is a single point.
        run: the stretches of the run between gaps.
        ends: the run's first and last point, (2, 2).
    """

    arm: int
    strands: dict[bool, list[Array]]
    cuts: dict[bool, list[Array]]
    orbits: list[tuple[str, Array]]
    run: list[Array]
    ends: Array


def plane(view: RunView, arm: int) -> Plane:
    """Return an arm's phase plane, its rate over its angle, with the plan's orbits and tubes and the run.

    Args:
        view: run or reference.
        arm: index of the arm, from 0.
    """
    columns = [arm, view.arms + arm]
    # Long runs are thinned.
    step = max(1, len(view.time) // _MOST)
    arm_states = view.state[:, columns]
    edges = [0, *view.breaks.tolist(), len(arm_states)]
    tubes = {stable: [tube for tube in view.plan.tubes if tube.stable == stable] for stable in (False, True)}
    return Plane(
        arm,
        strands={
            stable: [strand[:, columns] for tube in tubes_of_kind for strand in tube.strands]
            for stable, tubes_of_kind in tubes.items()
        },
        cuts={
            stable: [stretch for tube in tubes_of_kind for stretch in _known(tube.cut[:, columns])]
            for stable, tubes_of_kind in tubes.items()
        },
        orbits=[
            (style.saddle_colour(orbit.saddle), np.vstack([orbit.curve, orbit.curve[:1]])[:, columns])
            for orbit in view.plan.orbits
        ],
        run=[stretch for first, end in pairwise(edges) for stretch in _known(arm_states[first:end][::step])],
        ends=arm_states[[0, -1]],
    )


def _known(points: Array) -> list[Array]:
    """Return the stretches of points (K, 2) between missing ones (nan), of two points at least, which can be drawn."""
    runs = true_runs(np.all(np.isfinite(points), axis=1))
    return [points[first:end] for first, end in runs if end - first > 1]


def arm_points(angles: Array, arm_lengths: Sequence[float]) -> Array:
    """Return pivot, elbows and tip of the arms relative to the pivot, with x to the right and y up, to draw them.

    Args:
        angles: (K, n) absolute, from hanging, counter-clockwise; rad.
        arm_lengths: (n,) in m.

    Returns:
        (K, n+1, 2) in m.
    """
    arm_vectors = np.stack([np.sin(angles), -np.cos(angles)], axis=-1) * np.asarray(arm_lengths)[:, None]
    return np.concatenate([np.zeros((len(angles), 1, 2)), np.cumsum(arm_vectors, axis=1)], axis=1)
