"""Phase planes of a run, and the points of the arms."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.run_view import RunView
from dpcontrol.pages import style

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
    known = np.isfinite(points).all(axis=1)
    edges = np.flatnonzero(np.diff(known.astype(int))) + 1
    return [run for run in np.split(points, edges) if len(run) > 1 and np.isfinite(run).all()]


def arm_points(angles: Array, arm_lengths: Sequence[float]) -> Array:
    """Return pivot, elbows and tip relative to the pivot.

    The x axis points right and y up.

    Args:
        angles: (K, n) absolute, from hanging, counter-clockwise; rad.
        arm_lengths: (n,) in m.

    Returns:
        (K, n+1, 2) in m.
    """
    lengths = np.asarray(arm_lengths)
    steps = np.stack([np.sin(angles), -np.cos(angles)], axis=-1) * lengths[:, None]
    return np.concatenate([np.zeros((len(angles), 1, 2)), np.cumsum(steps, axis=1)], axis=1)
