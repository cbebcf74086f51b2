"""Pictures and data of charts: pages of at most three diagrams or maps.

Each chart is drawn to NAME.png, an appendix to NAME-more.png. NAME.json has points, machine and versions. Each diagram
has its result as title. The layout engine of pages places them.

A diagram has errors over times, and each method has its name beside its first mark. Settings are beside the other
marks, in full diagrams only beside those on the front and the defaults. A map has a row for each of its lines. Axes
have units with SI prefixes.
"""

import json
import os
import platform
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dpcontrol.bench.chart import CHARTS, ChartPage, Diagram, EdgeMap, Point, check_names, split_label
from dpcontrol.bench.measure import one_core
from dpcontrol.foundation.cache import commit
from dpcontrol.foundation.document import Documented, counted
from dpcontrol.foundation.files import write_whole
from dpcontrol.foundation.parts import versions
from dpcontrol.foundation.progress import Cost, Progress, announce, no_progress, part_of
from dpcontrol.pages.layout import Page, key, save_figure
from dpcontrol.pages.panels import name_point, name_rows, readable_ticks
from dpcontrol.pages.style import FAINT, GOOD, INK, LIMIT, MARK, PAPER, SERIES

Look = dict[str, Any]
Layer = tuple[str, Sequence[tuple[float, float]], Look]
"""Label in the key, or "", places in data, and look."""
MARKS = "osD^v<>Pph*X8d"
FLOOR = 1e-17
"""Drawn position of an error of exactly zero."""
MOST_LABELS = 17
"""Points of a diagram that all have their settings beside them."""
_RING = 15.0
"""Diameter of a ring about a default, points."""
_DEFAULT: Look = {
    "marker": "o",
    "linestyle": "none",
    "markerfacecolor": "none",
    "color": LIMIT,
    "markersize": _RING,
}


def figure(page: ChartPage, parts: Sequence[Any]) -> Figure:
    """Return a picture of some of a chart's diagrams, with one colour and mark for each method throughout.

    Args:
        page: page of the chart.
        parts: diagrams or maps.
    """
    methods = dict.fromkeys(p.method for part in parts if isinstance(part, Diagram) for p in part.points)
    looks: dict[str, Look] = {
        m: {"marker": MARKS[k % len(MARKS)], "color": SERIES[k % len(SERIES)]} for k, m in enumerate(methods)
    }
    panels = [partial(_draw, part=part, looks=looks) for part in parts]
    drawn = Page(page.title, page.chosen).grid(panels, across=min(len(parts), 2), height=3.7)
    return drawn.text("\n".join(page.reading)).figure()


def _draw(axes: Axes, part: Diagram | EdgeMap, looks: dict[str, Look]) -> None:
    of_points = isinstance(part, Diagram)
    layers = [layer for layer in (_points(part, looks) if of_points else _borders(part)) if layer[1]]
    for _, places, look in layers:
        axes.plot(*np.transpose(places), **look)
    if isinstance(part, Diagram):
        for p in part.points:
            name_point(axes, _label(part, p), _place(part, p), looks[p.method]["color"], weight="normal")
    key(axes, [(label, {**look, "markersize": 6}) for label, _, look in layers if label])
    axes.margins(0.12, 0.1)
    across, up = (part.x_label, part.y_label) if of_points else (part.y_label, part.x_label)
    (x, x_unit), (y, y_unit) = split_label(across), split_label(up)
    axes.set(title=f"{part.title}: {part.finding()}", xlabel=x, ylabel=y, xscale="log")
    readable_ticks(axes.xaxis, x_unit)
    if not of_points:
        name_rows(axes, [border.line for border in part.borders])
    elif part.log_y:
        axes.set_yscale("log")
        readable_ticks(axes.yaxis, y_unit)
    else:
        axes.set(ylim=(-0.05, 1.05), yticks=np.linspace(0.0, 1.0, 6))
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))


def _place(panel: Diagram, point: Point) -> tuple[float, float]:
    return point.seconds, max(point.error, panel.floor, FLOOR) if panel.log_y else point.error


def _points(panel: Diagram, looks: dict[str, Look]) -> Iterator[Layer]:
    front = [] if panel.joined else [_place(panel, p) for p in panel.front]
    steps = [*front[:1], *(corner for (_, up), (x, y) in pairwise(front) for corner in ((x, up), (x, y)))]
    yield "best at its cost", steps, {"color": FAINT, "linewidth": 4}
    for method in dict.fromkeys(p.method for p in panel.points if panel.joined):
        yield "", [_place(panel, p) for p in panel.points if p.method == method], {"color": FAINT, "linewidth": 2}
    for p in panel.points:
        face = PAPER if p.outside or p.stored else looks[p.method]["color"]
        yield "", [_place(panel, p)], {**looks[p.method], "markersize": 6, "markerfacecolor": face, "zorder": 3}
    yield "default of dpcontrol", [_place(panel, p) for p in panel.defaults], {**_DEFAULT, "zorder": 4}


def _borders(edge_map: EdgeMap) -> Iterator[Layer]:
    rows = list(enumerate(edge_map.borders))
    marks: Look = {"linestyle": "none", "markersize": 5}
    trials = [(y, k, attempt.works) for k, b in rows for y, attempt in b.trials]
    yield edge_map.near, [(y, k) for y, k, works in trials if works], {**marks, "marker": "o", "color": GOOD}
    yield edge_map.far, [(y, k) for y, k, works in trials if not works], {**marks, "marker": "x", "color": LIMIT}
    measured = [(b.measured, k) for k, b in rows if b.measured is not None]
    yield "measured", measured, {**marks, "marker": "|", "color": INK, "markersize": 14}
    predicted = [(b.predicted, k) for k, b in rows if b.predicted is not None]
    yield "predicted", predicted, {**marks, "marker": "D", "color": MARK, "markersize": 7, "markerfacecolor": "none"}
    x, value = edge_map.default or (None, 0.0)
    yield "default of dpcontrol", [(value, k) for k, b in rows if b.x == x], _DEFAULT


def _label(panel: Diagram, point: Point) -> str:
    """Return a point's text: the method at its first point, the setting, in full panels only on the front."""
    full = len(panel.points) > MOST_LABELS
    setting = "" if full and not point.default and point not in panel.front else point.setting
    named = point is next(p for p in panel.points if p.method == point.method)
    return ", ".join(filter(None, (point.method * named, setting)))


@dataclass(frozen=True)
class DrawnChart(Documented):
    """A finished chart, its files, and its duration in seconds."""

    KEYS: ClassVar[str] = "**chart file=pictures.0 files=pictures data seconds"

    chart: ChartPage
    pictures: tuple[Path, ...]
    data: Path
    seconds: float


@dataclass(frozen=True)
class DrawnCharts(Documented):
    """Finished charts; with `strict`, a deviation that a chart reports counts as a failure.

    Attributes:
        charts: finished charts, in order.
        strict: True if a deviation counts as a failure.
    """

    KEYS: ClassVar[str] = "charts status"

    charts: tuple[DrawnChart, ...]
    strict: bool = False

    def __iter__(self) -> Iterator[DrawnChart]:
        return iter(self.charts)

    @property
    def complaints(self) -> tuple[str, ...]:
        """Defaults off their front, and limits that differ from their prediction."""
        return tuple(text for drawn in self.charts for text in drawn.chart.complaints)

    @property
    def status(self) -> str:
        """Number of charts, and their complaints."""
        return f"{len(self.charts)} charts drawn; {'; '.join(self.complaints) or 'every default stands where it may'}"

    @property
    def missed(self) -> str:
        """The complaints of strict charts, or ""."""
        return self.status if self.strict and self.complaints else ""


_SECONDS = {False: 150.0, True: 25.0}
"""Cost of a chart, s of one processor, for full and quick charts."""


def draw_charts(
    names: Sequence[str], folder: Path, *, quick: bool = False, yes: bool = False, progress: Progress = no_progress
) -> DrawnCharts:
    """Draw charts (all if `names` is empty) one after the other on one core, with the others idle.

    Args:
        names: charts or groups of charts.
        folder: folder to write to.
        quick: shorter measurements.
        yes: accept any duration.
        progress: called with a label and the completed share.

    Raises:
        InputError: a name is unknown, the folder is not writable, or the charts would take too long.
    """
    chosen = check_names(tuple(names))
    announce(Cost(counted(len(chosen), "chart"), len(chosen) * _SECONDS[quick], 4e8, "bench"), yes=yes)
    # Read before the work, so that later edits of the checkout do not matter.
    made_with = {"quick": quick, "machine": machine(), "versions": versions(), "commit": commit()}
    drawn = []
    with one_core():
        for k, name in enumerate(chosen):
            began = time.perf_counter()
            chart = CHARTS[name](quick, part_of(progress, k / len(chosen), (k + 1) / len(chosen)))
            seconds, data = time.perf_counter() - began, Path(folder) / f"{chart.name}.json"
            pictures = {Path(folder) / f"{chart.name}{end}.png": parts for end, parts in chart.pages.items()}
            for picture, parts in pictures.items():
                save_figure(figure(chart, parts), picture)
            document = {**chart.document(), "seconds": seconds, **made_with}
            write_whole(data, json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
            drawn.append(DrawnChart(chart, tuple(pictures), data, seconds))
    return DrawnCharts(tuple(drawn))


def machine() -> dict[str, Any]:
    """Return processor, cores, load, operating system and Python."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor())
