"""Finds texts of a figure that are too small, that overlap, or that leave the page, by their drawn bounding boxes."""

from itertools import combinations

import numpy as np
from matplotlib.axis import Axis
from matplotlib.cbook import _setattr_cm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from mpl_toolkits.mplot3d.art3d import Text3D
from mpl_toolkits.mplot3d.proj3d import proj_transform

SMALLEST = 8.0
"""pt, at print size."""
PAPER = (11.7, 16.5)
"""Width and height of the largest sheet, inches: larger pages are printed smaller."""
SLACK = 1.0
"""pt: boxes contain free space above letters without ascenders, and may touch by that much."""
CROSSED = 3
"""Samples of a curve inside a label's box from which on it counts as covered."""


def _shown_ticks(figure: Figure) -> set[Text]:
    """Return the labels of ticks outside their axis's range, which matplotlib does not draw."""
    hidden: set[Text] = set()
    for axes in figure.axes:
        for axis in (one for one in axes.get_children() if isinstance(one, Axis)):
            drawn = {id(tick) for tick in axis._update_ticks()} if axes.axison and axis.get_visible() else set()
            for tick in (*axis.majorTicks, *axis.minorTicks):
                if id(tick) not in drawn:
                    hidden |= {tick.label1, tick.label2}
    return hidden


def texts_of(figure: Figure) -> list[tuple[Text, Bbox]]:
    """Return the visible texts of a figure and their boxes in points."""
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()
    hidden, found = _shown_ticks(figure), []
    for text in figure.findobj(Text):
        if not text.get_text().strip() or not text.get_visible() or text in hidden:
            continue
        if text.axes is not None and not text.axes.axison and text in _decorations(text.axes):
            continue
        # Keys lie outside their panel and are not clipped, since they have no box to clip to.
        clipped = text.get_clip_on() and text.get_clip_box() is not None
        if text.axes is not None and clipped and not _inside(text, renderer):
            continue
        box = _box(text, renderer)
        found.append((text, Bbox(box.get_points() * 72 / figure.dpi)))
    return found


def _box(text: Text, renderer) -> Bbox:
    """Return the box of a text in pixels; one in space is where it is seen."""
    if not isinstance(text, Text3D):
        return Text.get_window_extent(text, renderer)
    x, y, _ = proj_transform(*text.get_position_3d(), text.axes.get_proj())
    with _setattr_cm(text, _x=x, _y=y):
        return Text.get_window_extent(text, renderer)


def _decorations(axes) -> set[Text]:
    return {text for axis in (axes.xaxis, axes.yaxis) for text in axis.findobj(Text)}


def _inside(text: Text, renderer) -> bool:
    box = Text.get_window_extent(text, renderer)
    return text.axes.get_window_extent(renderer).overlaps(box)


def problems(figure: Figure) -> list[str]:
    """Return the legibility problems of a figure as sentences."""
    width, height = figure.get_size_inches()
    scale = min(1.0, PAPER[0] / width, PAPER[1] / height)
    texts = texts_of(figure)
    page = Bbox([[0, 0], [72 * width, 72 * height]])
    found = []
    for text, box in texts:
        size = scale * text.get_fontsize()
        if size < SMALLEST - 0.01:
            found.append(f"{text.get_text()!r} is printed at {size:.1f} pt")
        if box.x0 < page.x0 - SLACK or box.x1 > page.x1 + SLACK or box.y0 < page.y0 - SLACK or box.y1 > page.y1 + SLACK:
            found.append(f"{text.get_text()!r} leaves the page")
    for (one, a), (other, b) in combinations(texts, 2):
        wide, high = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
        if wide > SLACK and high > SLACK:
            found.append(f"{one.get_text()!r} and {other.get_text()!r} overlap by {wide:.0f} × {high:.0f} pt")
    return found + covered(figure, texts)


def covered(figure: Figure, texts: list[tuple[Text, Bbox]]) -> list[str]:
    """Return the labels that cover curves and have neither a box nor an outline."""
    found = []
    for text, box in texts:
        axes = text.axes
        if axes is None or axes.name == "3d" or text not in axes.texts:
            continue
        if text.get_bbox_patch() or text.get_path_effects():
            continue
        inner = Bbox([[box.x0 + SLACK, box.y0 + SLACK], [box.x1 - SLACK, box.y1 - SLACK]])
        for line in axes.lines:
            if isinstance(line, Line2D) and line.get_visible() and line.get_linestyle() not in ("None", " ", ""):
                path = line.get_transform().transform_path(line.get_path())
                path = path.interpolated(max(4, 400 // max(len(path), 1)))
                points = path.vertices * 72 / figure.dpi
                shown = axes.get_window_extent()
                low, high = shown.min * 72 / figure.dpi, shown.max * 72 / figure.dpi
                inside = ((points > inner.min) & (points < inner.max) & (points >= low) & (points <= high)).all(axis=1)
                if np.count_nonzero(inside) >= CROSSED:
                    found.append(f"{text.get_text()!r} covers a curve")
                    break
    return found
