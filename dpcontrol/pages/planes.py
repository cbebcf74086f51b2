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
    """Return the middle of each gap in a view's ticks, s."""
    return (view.time[view.breaks] + view.time[view.breaks - 1]) / 2


def extreme_rows(values: Array, *, bins: int) -> NDArray[np.int64]:
    """Return the rows of the extremes of values (N,) in `bins`, and the last row; few values are all returned.

    Args:
        values: (N,) in any unit.
        bins: number of bins.
    """
    size = len(values) // bins
    if size < 3:
        return np.arange(len(values))
    full = len(values) // size * size
    block = values[:full].reshape(-1, size)
    if not np.isfinite(block).all():
        block = np.where(np.isfinite(block), block, 0.0)
    ends = np.sort(np.stack([block.argmin(axis=1), block.argmax(axis=1)], axis=1), axis=1)
    return np.unique(np.concatenate([(ends + size * np.arange(len(block))[:, None]).ravel(), [len(values) - 1]]))


def padded(values: Array) -> Range:
    """Return the range of finite `values`, extended by a tenth."""
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

    arm: counted from zero.
    strands: of the tubes, by stability.
    cuts: of the tubes, by stability.
    orbits: closed, with their colours; a single point for an equilibrium.
    run: the stretches between gaps.
    ends: the run's first and last point, (2, 2).
    """

    arm: int
    strands: dict[bool, list[Array]]
    cuts: dict[bool, list[Array]]
    orbits: list[tuple[str, Array]]
    run: list[Array]
    ends: Array


def plane(view: RunView, arm: int) -> Plane:
    """Return an arm's phase plane with the plan's orbits and tubes.

    Args:
        view: run or reference.
        arm: index of the arm, from 0.
    """
    columns = [arm, view.arms + arm]
    step = max(1, len(view.time) // _MOST)
    walked = view.state[:, columns]
    edges = [0, *view.breaks.tolist(), len(walked)]
    tubes = {stable: [tube for tube in view.plan.tubes if tube.stable == stable] for stable in (False, True)}
    return Plane(
        arm,
        strands={stable: [s[:, columns] for tube in some for s in tube.strands] for stable, some in tubes.items()},
        cuts={stable: [run for tube in some for run in _known(tube.cut[:, columns])] for stable, some in tubes.items()},
        orbits=[
            (style.saddle_colour(orbit.saddle), np.vstack([orbit.curve, orbit.curve[:1]])[:, columns])
            for orbit in view.plan.orbits
        ],
        run=[run for a, b in pairwise(edges) for run in _known(walked[a:b][::step])],
        ends=walked[[0, -1]],
    )


def _known(points: Array) -> list[Array]:
    """Return the stretches of points (K, 2) between nan ones."""
    runs = true_runs(np.all(np.isfinite(points), axis=1))
    return [points[first:end] for first, end in runs if end - first > 1]


def arm_points(angles: Array, arm_lengths: Sequence[float]) -> Array:
    """Return pivot, elbows and tip relative to the pivot, with x to the right and y up.

    Args:
        angles: (K, n) absolute, from hanging, counter-clockwise; rad.
        arm_lengths: (n,) in m.

    Returns:
        (K, n+1, 2) in m.
    """
    steps = np.stack([np.sin(angles), -np.cos(angles)], axis=-1) * np.asarray(arm_lengths)[:, None]
    return np.concatenate([np.zeros((len(angles), 1, 2)), np.cumsum(steps, axis=1)], axis=1)
