"""Pictures of charts have legible labels and no negative shares."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.text import Annotation

from dpcontrol.bench.chart import Diagram, Point, PrecisionChart
from dpcontrol.bench.drawing import figure

LEAST = 8.0
"""Points: the smallest text of the visual standard."""


def drawn(*panels: Diagram):
    """Return the picture's axes, laid out as when it is saved."""
    picture = figure(PrecisionChart("x", "title", ("1", "2", "3"), "", panels), panels)
    picture.draw_without_rendering()
    return picture.axes


def test_labels_are_legible_and_cover_neither_marks_nor_rings_nor_one_another() -> None:
    rng = np.random.default_rng(4)
    spots = 10.0 ** rng.uniform([-4, -10], [-1, 0], (16, 2))
    points = [Point(f"m{k % 2}", f"1e-{k:02d}", *spot, default=k % 5 == 0) for k, spot in enumerate(spots.tolist())]
    # Two nearly in one place, the first with its ring.
    points.append(Point("m1", "beside", 1.05 * spots[0, 0], spots[0, 1]))
    (axes,) = drawn(Diagram("crowded", "s", "error", tuple(points)))
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


def test_a_page_of_many_methods_names_each_beside_a_mark_and_has_no_legend_of_them() -> None:
    points = tuple(Point(f"method {k}", "", 10.0**-k, 10.0 ** (k - 6), default=k == 2) for k in range(6))
    (axes,) = drawn(Diagram("many", "time of a tick, s", "error", points))
    names = [t.get_text() for t in axes.texts if isinstance(t, Annotation) and t.get_text()]
    assert sorted(names) == [f"method {k}" for k in range(6)]
    assert [t.get_text() for t in axes.get_legend().get_texts()] == ["best at its cost", "default of dpcontrol"]


def test_axes_have_units_with_prefixes_and_the_title_states_the_result() -> None:
    points = (Point("ours", "", 8e-6, 1e-3, default=True), Point("theirs", "", 2.4e-5, 1e-3))
    (axes,) = drawn(Diagram("A tick", "time of a tick, s", "error of the angles, rad", points))
    assert axes.get_xlabel() == "time of a tick"
    assert {t.get_text().split()[-1] for t in axes.get_xticklabels() if t.get_text()} == {"µs"}
    assert {t.get_text().split()[-1] for t in axes.get_yticklabels() if t.get_text()} <= {"mrad", "µrad"}
    title = " ".join(axes.get_title(loc="left").split())
    assert title == "A tick: theirs does as well as ours at 3 times its time of a tick"


def test_a_fourth_diagram_is_on_the_appendix() -> None:
    panels = tuple(Diagram(f"{k}", "s", "error", (Point("m", "", 1.0, 1.0, default=True),)) for k in range(4))
    page = PrecisionChart("x", "title", ("1", "2", "3"), "", panels)
    assert page.pages == {"": panels[:3], "-more": panels[3:]}


@pytest.mark.slow
def test_a_long_appendix_has_several_sheets_that_fit_on_paper() -> None:
    panels = tuple(Diagram(f"{k}", "s", "error", (Point("m", "", 1.0, 1.0, default=True),)) for k in range(12))
    page = PrecisionChart("x", "title", ("1", "2", "3"), "", panels)
    assert page.pages == {"": panels[:3], "-more": panels[3:6], "-more-2": panels[6:9], "-more-3": panels[9:]}
    assert figure(page, page.pages["-more"]).get_figheight() < 16.5


@pytest.mark.parametrize("shares", [(0.0, 0.0), (0.0, 0.4), (0.0, 0.12)])
def test_axes_of_shares_start_at_zero(shares: tuple[float, float]) -> None:
    points = tuple(Point("m", f"{k}", 1.0 + k, share, default=k == 0) for k, share in enumerate(shares))
    (axes,) = drawn(Diagram("failures", "s", "share that fails", points, log_y=False))
    ticks = axes.get_yticks()
    assert ticks.min() == 0.0
    assert 0.1 <= ticks.max() <= 1.0
    assert axes.get_ylim()[0] > -0.1 * axes.get_ylim()[1]
    assert axes.yaxis.get_major_formatter()(0.4).endswith("%")
