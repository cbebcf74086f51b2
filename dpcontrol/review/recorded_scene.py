"""Scenes in a recording: the tip's trace behind a log's own bodies; and pendulums drawn from a view alone.

x to the right, z up, as the log's own transforms have it.
"""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from dpcontrol.review import style
from dpcontrol.review.motion import RunView
from dpcontrol.review.recorded import TRACE_RATE, times, trace_rows
from dpcontrol.review.series import arm_points

Array = NDArray[np.float64]

WORLD = "world"
"""The frame that the log's transforms start from."""
_TRACE_SECONDS = 0.4
_DEPTH = -0.05


def trace_tip(recording: rr.RecordingStream, path: str, view: RunView, *, frame: str | None = None) -> None:
    """Trace the tip over the last moments, in the plane in which the outermost arm is drawn.

    frame: of the log's transforms, where there are any.
    """
    rows = trace_rows(view)
    points = _points(view.state[rows], view)
    length = round(_TRACE_SECONDS * TRACE_RATE)
    tips = points[:, -1] + np.array([0.0, _DEPTH, 0.0])
    strips = [tips[max(0, k - length) : k + 1] for k in range(len(rows))]
    colour = style.rgb(style.arm_colour(view.arms - 1))
    recording.log(path, rr.LineStrips3D.from_fields(colors=[colour], radii=rr.Radius.ui_points(1.5)), static=True)
    if frame is not None:
        recording.log(path, rr.CoordinateFrame(frame), static=True)
    recording.send_columns(path, indexes=times(view.time[rows]), columns=rr.LineStrips3D.columns(strips=strips))


def draw_pendulum(recording: rr.RecordingStream, home: str, view: RunView) -> None:
    """Draw the arms as they move, the reference grey behind them, the cart, and the track as long as its limits."""
    rows = trace_rows(view)
    reach = sum(view.arm_lengths)
    if view.has_cart:
        _track(recording, home, view, reach=reach)
    shown = [("arms", view.state, 0.0, 0.028)]
    shown += [("reference", view.reference, 0.03, 0.05)] if view.reference is not None else []
    for name, states, depth, radius in shown:
        points = _points(states[rows], view) + np.array([0.0, depth, 0.0])
        for arm in range(view.arms):
            colour = style.arm_colour(arm) if name == "arms" else style.FAINT
            look = rr.LineStrips3D.from_fields(colors=[style.rgb(colour)], radii=radius * reach / 2)
            at = f"{home}/{name}/arm_{arm + 1}"
            recording.log(at, look, static=True)
            columns = rr.LineStrips3D.columns(strips=list(points[:, arm : arm + 2]))
            recording.send_columns(at, indexes=times(view.time[rows]), columns=columns)
    trace_tip(recording, f"{home}/tip", view)
    if view.has_cart:
        centres = np.column_stack([view.pivot[rows], np.full(len(rows), 0.02), np.zeros(len(rows))])
        at = f"{home}/cart"
        size = [[0.13 * reach, 0.02, 0.05 * reach]]
        look = rr.Boxes3D.from_fields(half_sizes=size, colors=[style.rgb(style.CART)], fill_mode="solid")
        recording.log(at, look, static=True)
        recording.send_columns(at, indexes=times(view.time[rows]), columns=rr.Boxes3D.columns(centers=centres))


def _track(recording: rr.RecordingStream, home: str, view: RunView, *, reach: float) -> None:
    finite = np.abs(view.pivot[np.isfinite(view.pivot)])
    end = view.limits[0] if view.limits else max(float(finite.max()) if finite.size else 0.0, reach)
    rail = [[(-end, 0.05, 0.0), (end, 0.05, 0.0)]]
    stops = [[(x, 0.05, -0.06 * reach), (x, 0.05, 0.06 * reach)] for x in (-end, end)]
    tints = [style.rgb(style.FAINT), style.rgb(style.LIMIT), style.rgb(style.LIMIT)]
    recording.log(f"{home}/track", rr.LineStrips3D(rail + stops, colors=tints, radii=0.012 * reach), static=True)


def _points(states: Array, view: RunView) -> Array:
    """Return (K, n+1, 3) the pivot, elbows and tip in m of states (K, …)."""
    points = arm_points(states[:, : view.arms], view.arm_lengths)
    pivot = states[:, 2 * view.arms] if view.has_cart else np.zeros(len(states))
    return np.stack([points[..., 0] + pivot[:, None], np.zeros(points.shape[:2]), points[..., 1]], axis=-1)
