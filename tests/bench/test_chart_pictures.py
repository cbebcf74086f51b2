"""Pictures of charts have legible labels."""

from itertools import combinations

import numpy as np
from matplotlib.text import Annotation

from dpcontrol.bench.chart import ChartPage, Diagram, Point
from dpcontrol.bench.drawing import figure

LEAST = 8.0
"""Points: the smallest text of the visual standard."""


def test_labels_are_legible_and_cover_neither_marks_nor_rings_nor_one_another() -> None:
    rng = np.random.default_rng(4)
    spots = 10.0 ** rng.uniform([-4, -10], [-1, 0], (16, 2))
    points = [Point(f"m{k % 2}", f"1e-{k:02d}", *spot, default=k % 5 == 0) for k, spot in enumerate(spots.tolist())]
    # Two nearly in one place, the first with its ring.
    points.append(Point("m1", "beside", 1.05 * spots[0, 0], spots[0, 1]))
    panels = (Diagram("crowded", "s", "error", tuple(points)),)
    picture = figure(ChartPage("x", "title", ("1", "2", "3"), "", panels), panels)
    picture.draw_without_rendering()
    (axes,) = picture.axes
    labels = {t.get_text(): t for t in axes.texts if isinstance(t, Annotation) and t.get_text()}
    assert {text.split(", ")[-1] for text in labels} == {p.setting for p in points}
    assert min(label.get_fontsize() for label in labels.values()) >= LEAST
    boxes = [label.get_window_extent() for label in labels.values()]
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    unit = axes.figure.dpi / 72
    for point in points:
        spot = axes.transData.transform((point.seconds, point.error))
        radius = unit * (15 / 2 if point.default else 3)
        for box in boxes:
            assert np.hypot(*(spot - np.clip(spot, box.min, box.max))) >= radius
