"""Phase planes in a recording: orbits, tubes with their cuts, the run, where it is now, and lines to read them by.

The viewer's y points down and its scales are equal: a rate of 10 rad/s is drawn as long as an angle of 2 rad.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from dpcontrol.review import style
from dpcontrol.review.context import ReviewContext
from dpcontrol.review.motion import Motion
from dpcontrol.review.panel_frame import in_pi
from dpcontrol.review.recorded import times, trace_rows

Array = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""Least and greatest x, least and greatest y, as drawn."""

_RATE = 0.2
_MOST = 20_000
_GRID, _DARK_GRID = (226, 229, 233), (52, 56, 62)
_EACH = 2
"""Of a tube's strands every second is enough here, and quicker to draw without a graphics card."""
_TUBES = (
    (False, style.UNSTABLE, "#f0bdb9", "tubes_from"),
    (True, style.STABLE, "#b3d9c0", "tubes_to"),
)
"""Stable, colours of the cut and of the strands (the viewer's thin lines do not let through), and name."""
_FAR = 60.0
"""rad and rad/s: what lies farther out is not what the view is chosen for."""


def record_planes(
    recording: rr.RecordingStream, home: str, motion: Motion, context: ReviewContext, *, boxes: list[Box] | None = None
) -> None:
    """Record the phase plane of each arm under `home/arm_K`; lines to read by fill the arm's box."""
    for arm in range(motion.arms):
        at = f"{home}/arm_{arm + 1}"
        reading_lines(recording, at, boxes[arm] if boxes else bounds(motion, context, arm), scale=_RATE)
        for stable, colour, pale, name in _TUBES:
            tubes = [tube for tube in context.tubes if tube.stable == stable]
            strands = [_scaled(strand, motion, arm) for tube in tubes for strand in tube.strands[::_EACH]]
            _strips(recording, f"{at}/{name}", strands, [pale] * len(strands), alpha=255, width=0.5)
            cuts = [run for tube in tubes for run in _runs(_scaled(tube.cut, motion, arm))]
            _strips(recording, f"{at}/{name}/cut", cuts, [colour] * len(cuts), alpha=255, width=1.2)
        closed = [np.vstack([orbit.states, orbit.states[:1]]) for orbit in context.orbits]
        tints = [style.saddle_colour(orbit.saddle) for orbit in context.orbits]
        orbits = [_scaled(states, motion, arm) for states in closed]
        _strips(recording, f"{at}/orbits", orbits, tints, alpha=255, width=1.8)
        step = max(1, len(motion.time) // _MOST)
        walked = _scaled(motion.state, motion, arm)
        edges = [0, *motion.breaks.tolist(), len(walked)]
        runs = [run for a, b in pairwise(edges) for run in _runs(walked[a:b][::step])]
        _strips(recording, f"{at}/run", runs, [style.INK] * len(runs), alpha=255, width=0.7)
        rows = trace_rows(motion)
        look = rr.Points2D.from_fields(colors=[style.rgb(style.LIMIT)], radii=rr.Radius.ui_points(5))
        recording.log(f"{at}/now", look, static=True)
        columns = rr.Points2D.columns(positions=walked[rows])
        recording.send_columns(f"{at}/now", indexes=times(motion.time[rows]), columns=columns)


def bounds(motion: Motion, context: ReviewContext, arm: int) -> Box:
    """Return least and greatest x, least and greatest y of an arm's phase plane, as drawn."""
    parts = [motion.state, *(orbit.states for orbit in context.orbits)]
    parts += [strand for tube in context.tubes for strand in tube.strands]
    every = np.concatenate([_scaled(part, motion, arm) for part in parts])
    near = np.isfinite(every).all(axis=1) & (np.abs(every[:, 1]) < _FAR)
    every = every[near] if near.any() else np.zeros((1, 2))
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.08 * float(max(high - low)) + 1e-3
    low, high = low - margin, high + margin
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def common_boxes(runs: Sequence[tuple[Motion, ReviewContext]]) -> list[Box]:
    """Return for each arm the box that holds all runs."""
    boxes = []
    for arm in range(runs[0][0].arms):
        every = np.array([bounds(motion, context, arm) for motion, context in runs])
        (left, _, top, _), (_, right, _, bottom) = every.min(axis=0), every.max(axis=0)
        boxes.append((float(left), float(right), float(top), float(bottom)))
    return boxes


def _scaled(states: Array, motion: Motion, arm: int) -> Array:
    return states[:, [arm, motion.arms + arm]] * [1.0, -_RATE]


def _runs(points: Array) -> list[Array]:
    """Return the stretches of points (K, 2) between those that are nan."""
    known = np.isfinite(points).all(axis=1)
    edges = np.flatnonzero(np.diff(known.astype(int))) + 1
    return [run for run in np.split(points, edges) if len(run) > 1 and np.isfinite(run).all()]


def _strips(
    recording: rr.RecordingStream, at: str, strips: list[Array], colours: list[str], *, alpha: int, width: float
) -> None:
    if strips:
        tints = [(*style.rgb(colour), alpha) for colour in colours]
        recording.log(at, rr.LineStrips2D(strips, colors=tints, radii=rr.Radius.ui_points(width)), static=True)


def reading_lines(
    recording: rr.RecordingStream, at: str, box: Box, *, scale: float, turning: bool = True, dark: bool = False
) -> None:
    """Draw lines to read by, named at their ends: at round values across, and at multiples of π or round ones along.

    scale: what one unit across is drawn as; turning: whether x is an angle; dark: the background.
    """
    left, right, top, bottom = box
    unit = np.pi if turning else 1.0
    turns = max(_round_step((right - left) / unit, 6), 1.0 if turning else 0.0)
    spin = _round_step((bottom - top) / scale, 6)
    strips, places, labels = [], [], []
    if (right - left) > 100 * np.pi:
        return
    for k in np.arange(np.ceil(left / unit / turns), np.floor(right / unit / turns) + 1) * turns:
        strips.append([(k * unit, top), (k * unit, bottom)])
        places.append((k * unit, bottom - 0.04 * (bottom - top)))
        labels.append(in_pi(k) if turning else f"{k + 0.0:.6g}")
    for k in np.arange(np.ceil(-bottom / scale / spin), np.floor(-top / scale / spin) + 1) * spin:
        strips.append([(left, -scale * k), (right, -scale * k)])
        places.append((left + 0.06 * (right - left), -scale * k))
        labels.append(f"{k + 0.0:.6g}")
    if strips:
        look = {"colors": [_DARK_GRID if dark else _GRID], "radii": rr.Radius.ui_points(0.5), "draw_order": -10.0}
        recording.log(f"{at}/grid", rr.LineStrips2D(strips, **look), static=True)  # type: ignore[arg-type]
        ink = (154, 163, 173) if dark else (70, 76, 84)
        names = rr.Points2D(places, labels=labels, colors=[ink], radii=rr.Radius.ui_points(1.0), show_labels=True)
        recording.log(f"{at}/grid/names", names, static=True)


def _round_step(span: float, most: int) -> float:
    """Return the least of 1, 2, 5 times a power of ten of which at most so many go into a span."""
    size = 10.0 ** np.floor(np.log10(max(span, 1e-9) / most))
    return float(next(step * size for step in (1.0, 2.0, 5.0, 10.0) if span / (step * size) <= most))
