"""Phase planes in a recording: orbits, tubes with their cuts, the run, where it is now, and lines to read them by.

The viewer's y points down and its scales are equal: a rate of 10 rad/s is drawn as long as an angle of 2 rad.
"""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from dpcontrol.review import style
from dpcontrol.review.motion import RunView
from dpcontrol.review.recorded import times, trace_rows
from dpcontrol.review.series import Plane, plane

Array = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""Least and greatest x, least and greatest y, as drawn."""

_RATE = 0.2
_SCALE = np.array([1.0, -_RATE])
_GRID, _DARK_GRID = (226, 229, 233), (52, 56, 62)
_EACH = 2
"""Of a tube's strands every second is enough here, and quicker to draw without a graphics card."""
_TUBES = (
    (False, style.UNSTABLE, style.PALE_UNSTABLE, "tubes_from"),
    (True, style.STABLE, style.PALE_STABLE, "tubes_to"),
)
"""Stable, colours of the cut and of the strands (the viewer's thin lines do not let through), and name."""
_FAR = 60.0
"""rad and rad/s: what lies farther out is not what the view is chosen for."""


def record_planes(recording: rr.RecordingStream, home: str, view: RunView, *, boxes: list[Box] | None = None) -> None:
    """Record the phase plane of each arm under `home/arm_K`; lines to read by fill the arm's box."""
    rows = trace_rows(view)
    for arm in range(view.arms):
        at, shown = f"{home}/arm_{arm + 1}", plane(view, arm)
        reading_lines(recording, at, boxes[arm] if boxes else bounds(shown), scale=_RATE)
        for stable, colour, pale, name in _TUBES:
            strands = shown.strands[stable][::_EACH]
            _strips(recording, f"{at}/{name}", strands, [pale] * len(strands), width=0.5)
            _strips(recording, f"{at}/{name}/cut", shown.cuts[stable], [colour] * len(shown.cuts[stable]), width=1.2)
        _strips(recording, f"{at}/orbits", [p for _, p in shown.orbits], [c for c, _ in shown.orbits], width=1.8)
        _strips(recording, f"{at}/run", shown.run, [style.INK] * len(shown.run), width=0.7)
        look = rr.Points2D.from_fields(colors=[style.rgb(style.LIMIT)], radii=rr.Radius.ui_points(5))
        recording.log(f"{at}/now", look, static=True)
        columns = rr.Points2D.columns(positions=view.state[rows][:, [arm, view.arms + arm]] * _SCALE)
        recording.send_columns(f"{at}/now", indexes=times(view.time[rows]), columns=columns)


def bounds(*planes: Plane) -> Box:
    """Return least and greatest x, least and greatest y of an arm's phase planes, as drawn: of all that lies near."""
    parts = [points for plane in planes for _, points in plane.orbits]
    parts += [points for plane in planes for some in (plane.run, *plane.strands.values()) for points in some]
    every = np.concatenate([part * _SCALE for part in parts]) if parts else np.zeros((1, 2))
    near = np.isfinite(every).all(axis=1) & (np.abs(every[:, 1]) < _FAR)
    every = every[near] if near.any() else np.zeros((1, 2))
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.08 * float(max(high - low)) + 1e-3
    low, high = low - margin, high + margin
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def _strips(recording: rr.RecordingStream, at: str, strips: list[Array], colours: list[str], *, width: float) -> None:
    if strips:
        tints = [(*style.rgb(colour), 255) for colour in colours]
        drawn = rr.LineStrips2D([s * _SCALE for s in strips], colors=tints, radii=rr.Radius.ui_points(width))
        recording.log(at, drawn, static=True)


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
        labels.append(style.in_pi(k) if turning else f"{k + 0.0:.6g}")
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
