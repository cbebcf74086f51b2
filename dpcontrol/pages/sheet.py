"""A plane of the viewer, whose scales are equal and whose y axis points down, with grid lines and labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.parts import Later
from dpcontrol.pages import style

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb
else:
    rr, rrb = Later("rerun"), Later("rerun.blueprint")

PAPER, DARK = (250, 251, 252), (18, 20, 24)
"""Backgrounds of views."""
_FAR = np.array([300.0, 300.0])
"""Values beyond which a sheet is not widened."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """A part of a phase plane, with an angle in rad as x.

    Attributes:
        low: least x and y.
        high: greatest x and y.
        scale: drawn length of a unit of y, whose unit of x is 1.
    """

    low: Array
    high: Array
    scale: float

    @classmethod
    def around(cls, curves: Sequence[Array], *, scale: float) -> Sheet:
        """Return a sheet around curves (K, 2), without far outliers.

        Args:
            curves: curves to show.
            scale: as in the class.
        """
        every = np.concatenate([np.zeros((0, 2)), *curves])
        near = every[(np.abs(every) < _FAR).all(axis=1)]
        low, high = (near.min(axis=0), near.max(axis=0)) if len(near) else (np.zeros(2), np.zeros(2))
        wide, tall = np.maximum(high - low, 1e-12)
        margin = 0.1 * max(wide, scale * tall) * np.array([1.0, 1 / scale]) + 1e-3
        return cls(low - margin, high + margin, scale)

    def drawn(self, points: ArrayLike) -> Array:
        """Return points (…, 2) as drawn."""
        return np.asarray(points) * [1.0, -self.scale]

    def curves(
        self, recording: rr.RecordingStream, home: str, curves: Sequence[Array], colours: Sequence[str], width: float
    ) -> None:
        """Record curves (K, 2) under a path.

        Args:
            recording: recording to extend.
            home: path in the recording.
            curves: curves; none are skipped.
            colours: colour of each curve.
            width: width of the curves, points.
        """
        if len(curves):
            look = {"colors": [style.rgb(colour) for colour in colours], "radii": rr.Radius.ui_points(width)}
            recording.log(home, rr.LineStrips2D([self.drawn(curve) for curve in curves], **look), static=True)

    def grid(self, recording: rr.RecordingStream, home: str) -> None:
        """Record grid lines with labels at round rates and at angles that are multiples of π.

        Args:
            recording: recording to extend.
            home: parent path.
        """
        (left, bottom), (right, top) = self.low, self.high
        across, up = np.pi * _round_values(left / np.pi, right / np.pi, integer=True), _round_values(bottom, top)
        lines = [[(x, bottom), (x, top)] for x in across] + [[(left, y), (right, y)] for y in up]
        places = [(x, bottom + 0.04 * (top - bottom)) for x in across]
        places += [(left + 0.06 * (right - left), y) for y in up]
        labels = [style.in_pi(x / np.pi) for x in across] + [f"{y + 0.0:.6g}" for y in up]
        pale, ink = (226, 229, 233), (70, 76, 84)
        if lines:
            thin = rr.Radius.ui_points(0.5)
            grid = rr.LineStrips2D([self.drawn(line) for line in lines], colors=[pale], radii=thin, draw_order=-10.0)
            names = rr.Points2D(self.drawn(places), labels=labels, colors=[ink], radii=thin, show_labels=True)
            recording.log(f"{home}/grid", grid, static=True)
            recording.log(f"{home}/grid/names", names, static=True)

    def view(self, origin: str, *, name: str) -> rrb.View:
        """Return the view of the sheet.

        Args:
            origin: path of its contents.
            name: title of the view.
        """
        (left, top), (right, bottom) = self.drawn([(self.low[0], self.high[1]), (self.high[0], self.low[1])])
        bounds = rrb.VisualBounds2D(x_range=(left, right), y_range=(top, bottom))
        return rrb.Spatial2DView(name=name, origin=origin, visual_bounds=bounds, background=PAPER)


def _round_values(low: float, high: float, *, integer: bool = False) -> Array:
    values = np.asarray(MaxNLocator(6, steps=[1, 2, 5, 10], integer=integer).tick_values(low, high))
    return values[(low <= values) & (values <= high)]
