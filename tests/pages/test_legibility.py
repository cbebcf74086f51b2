"""Crowded pages and figures of the paper can be read: texts have at least 8 pt and neither overlap nor cover curves."""

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from matplotlib.axis import Axis
from matplotlib.cbook import _setattr_cm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from mpl_toolkits.mplot3d.art3d import Text3D
from mpl_toolkits.mplot3d.proj3d import proj_transform

import dpcontrol as dp
from dpcontrol.foundation.progress import no_progress
from dpcontrol.foundation.statistics import wilson
from dpcontrol.judge.campaign import campaign_summary
from dpcontrol.judge.of_log import run_view
from dpcontrol.judge.preflight import Assumption, EndingShare, HazardBorder, Improvement, Preflight, ShareAt
from dpcontrol.pages.figures import FIGURES
from dpcontrol.pages.film import draw_transitions
from dpcontrol.pages.layout import new_figure
from dpcontrol.pages.many_runs import draw_campaign, draw_preflight
from dpcontrol.pages.page import draw
from dpcontrol.plans.itinerary import itinerary_from
from dpcontrol.plans.model import load_model
from dpcontrol.plans.plan import make_plan
from tests.pages.test_campaign_report import rows

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
    found = [] if width <= PAPER[0] else [f"the page is {width:.1f} inches wide"]
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


LAB = load_model("lab")
FEW_GUESSES = '[reference]\nmethod = "radau-5"\ninterval = 0.1\ntolerance = 1e-3\n'


def run_of_many_symbols(_: Path) -> Figure:
    view = run_view(dp.run("outer-turn", seed=1).log)
    steps = tuple((0.2 + 0.2 * k, f"symbol {k + 1} of a long walk") for k in range(24))
    return draw(replace(view, plan=replace(view.plan, symbols=steps), verdict="stopped: " + "why " * 70, good=False))


def campaign(folder: Path) -> Figure:
    (folder / "campaign").mkdir()
    pq.write_table(pa.Table.from_pylist(rows()), folder / "campaign" / "0.parquet")
    return draw_campaign(campaign_summary(folder / "campaign"))


def preflight(_: Path) -> Figure:
    units = {"mismatch": "share of each parameter", "drive lag": "ms", "encoder counts": "per turn", "jitter": "ms"}
    points = tuple(ShareAt(v, 40, c, 38) for v, c in ((0.01, 37), (0.02, 30), (0.03, 22), (0.04, 12)))
    borders = tuple(
        HazardBorder(name, name, unit, 0.01, 0.029, 0.025, 0.033, 0.08, name == "encoder counts", points)
        for name, unit in units.items()
    )
    change = Improvement("identify the arms: half the mismatch", {}, 12, 20, 0, 20, 0.8)
    known = tuple(Assumption(name, "a value with its unit", "[run] or the model's file") for name in units)
    ending = EndingShare("tracking lost", 31, 12, "tracking lost at t = 2.31 s: the arms were 1.52 rad off")
    share = wilson(158, 200, confidence=0.99)
    title = "Turn the outer arm once"
    return draw_preflight(
        Preflight("outer-turn", title, "lab", share, 0.99, known, ("assumed",), (ending,), borders, (change,), 33.0)
    )


def transitions(_: Path) -> Figure:
    parts = "".join(f'[[parts]]\nhold = "{name}"\nseconds = 0.5\n' for name in ("down-down", "down-up", "down-down"))
    text = f'start = "rest"\nfinish = "rest"\n{parts}{FEW_GUESSES}'
    return draw_transitions(make_plan(itinerary_from(text, "tour", LAB)).reference)


SLOW = (run_of_many_symbols, preflight, transitions)


@pytest.mark.parametrize(
    "make", [campaign, *(pytest.param(make, marks=pytest.mark.slow) for make in SLOW)], ids=lambda make: make.__name__
)
def test_a_page_is_legible_in_print(make: Callable[[Path], Figure], tmp_path: Path) -> None:
    assert problems(make(tmp_path)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in FIGURES if name != "branches"])
def test_a_figure_of_the_paper_is_legible_in_print(name: str) -> None:
    assert problems(FIGURES[name](no_progress).figure) == []


def test_the_check_finds_small_overlapping_and_covering_texts() -> None:
    figure = new_figure(4.0, 3.0)
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1])
    axes.text(0.5, 0.5, "covers the line", ha="center", va="center", fontsize=9)
    axes.text(0.1, 0.8, "one label", fontsize=9)
    axes.text(0.12, 0.8, "another", fontsize=9)
    axes.text(0.7, 0.1, "tiny", fontsize=5)
    said = "\n".join(problems(figure))
    assert "'covers the line' covers a curve" in said
    assert "'one label' and 'another' overlap" in said
    assert "'tiny' is printed at 5.0 pt" in said
