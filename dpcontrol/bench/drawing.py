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
"""Arguments of matplotlib for the look of marks and lines."""
Layer = tuple[str, Sequence[tuple[float, float]], Look]
"""Label in the key, or "", places in data, and look."""
MARKS = "osD^v<>Pph*X8d"
"""Marks of matplotlib, one for each method."""
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
    methods = dict.fromkeys(point.method for part in parts if isinstance(part, Diagram) for point in part.points)
    looks: dict[str, Look] = {
        method: {"marker": MARKS[k % len(MARKS)], "color": SERIES[k % len(SERIES)]} for k, method in enumerate(methods)
    }
    panels = [partial(_draw, part=part, looks=looks) for part in parts]
    page_of_panels = Page(page.title, page.chosen).grid(panels, across=min(len(parts), 2), height=3.7)
    return page_of_panels.text("\n".join(page.reading)).figure()


def _draw(axes: Axes, part: Diagram | EdgeMap, looks: dict[str, Look]) -> None:
    """Draw a diagram or a map into axes, with its result as title.

    A layer is a label, the places (x, y) of its marks or line, and their look; a layer without places is left out. A
    map has a row for each border, and the values on the horizontal axis.

    Args:
        axes: axes of one panel.
        part: diagram of errors against times, or map of borders.
        looks: mark and colour of each method.
    """
    is_diagram = isinstance(part, Diagram)
    layers = [layer for layer in (_points(part, looks) if is_diagram else _borders(part)) if layer[1]]
    for _, places, look in layers:
        axes.plot(*np.transpose(places), **look)
    if isinstance(part, Diagram):
        for point in part.points:
            name_point(axes, _label(part, point), _place(part, point), looks[point.method]["color"], weight="normal")
    key(axes, [(label, {**look, "markersize": 6}) for label, _, look in layers if label])
    axes.margins(0.12, 0.1)
    horizontal_label, vertical_label = (part.x_label, part.y_label) if is_diagram else (part.y_label, part.x_label)
    (x_name, x_unit), (y_name, y_unit) = split_label(horizontal_label), split_label(vertical_label)
    axes.set(title=f"{part.title}: {part.finding()}", xlabel=x_name, ylabel=y_name, xscale="log")
    readable_ticks(axes.xaxis, x_unit)
    if not is_diagram:
        name_rows(axes, [border.line for border in part.borders])
    elif part.log_y:
        axes.set_yscale("log")
        readable_ticks(axes.yaxis, y_unit)
    else:
        axes.set(ylim=(-0.05, 1.05), yticks=np.linspace(0.0, 1.0, 6))
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))


def _place(panel: Diagram, point: Point) -> tuple[float, float]:
    """Return the place of a point in data; an error of zero is drawn at `FLOOR` of a logarithmic axis."""
    return point.seconds, max(point.error, panel.floor, FLOOR) if panel.log_y else point.error


def _points(panel: Diagram, looks: dict[str, Look]) -> Iterator[Layer]:
    """Yield the layers of a diagram: its front, lines of joined points, the points, and rings about defaults.

    `looks` has the mark and colour of each method. A layer is its label in the key, "" for none, then the places (x, y)
    of its marks or line, and their look.
    """
    front = [] if panel.joined else [_place(panel, point) for point in panel.front]
    # Between two points, the best error so far stays constant, so the front is a staircase.
    steps = [*front[:1], *(corner for (_, up), (x, y) in pairwise(front) for corner in ((x, up), (x, y)))]
    yield "best at its cost", steps, {"color": FAINT, "linewidth": 4}
    for method in dict.fromkeys(point.method for point in panel.points if panel.joined):
        yield (
            "",
            [_place(panel, point) for point in panel.points if point.method == method],
            {"color": FAINT, "linewidth": 2},
        )
    for point in panel.points:
        face_colour = PAPER if point.outside or point.stored else looks[point.method]["color"]
        yield (
            "",
            [_place(panel, point)],
            {**looks[point.method], "markersize": 6, "markerfacecolor": face_colour, "zorder": 3},
        )
    yield "default of dpcontrol", [_place(panel, point) for point in panel.defaults], {**_DEFAULT, "zorder": 4}


def _borders(edge_map: EdgeMap) -> Iterator[Layer]:
    """Yield the layers of a map: trials that work or fail, measured and predicted borders, and the default.

    Each border has a row k, and values are on the horizontal axis.
    """
    rows = list(enumerate(edge_map.borders))
    marks: Look = {"linestyle": "none", "markersize": 5}
    trials = [(tried_value, k, attempt.works) for k, border in rows for tried_value, attempt in border.trials]
    yield (
        edge_map.near,
        [(tried_value, k) for tried_value, k, works in trials if works],
        {**marks, "marker": "o", "color": GOOD},
    )
    yield (
        edge_map.far,
        [(tried_value, k) for tried_value, k, works in trials if not works],
        {**marks, "marker": "x", "color": LIMIT},
    )
    measured = [(border.measured, k) for k, border in rows if border.measured is not None]
    yield "measured", measured, {**marks, "marker": "|", "color": INK, "markersize": 14}
    predicted = [(border.predicted, k) for k, border in rows if border.predicted is not None]
    yield "predicted", predicted, {**marks, "marker": "D", "color": MARK, "markersize": 7, "markerfacecolor": "none"}
    default_line, value = edge_map.default or (None, 0.0)
    yield "default of dpcontrol", [(value, k) for k, border in rows if border.x == default_line], _DEFAULT


def _label(panel: Diagram, point: Point) -> str:
    """Return a point's text: the method at its first point, and the setting.

    In panels of more than `MOST_LABELS` points, only defaults and points of the front have their settings.
    """
    is_crowded = len(panel.points) > MOST_LABELS
    setting = "" if is_crowded and not point.default and point not in panel.front else point.setting
    is_first_of_method = point is next(other for other in panel.points if other.method == point.method)
    return ", ".join(filter(None, (point.method * is_first_of_method, setting)))


@dataclass(frozen=True)
class DrawnChart(Documented):
    """A finished chart.

    Attributes:
        chart: the chart.
        pictures: files of its pictures.
        data: file of its points and versions.
        seconds: duration of measuring and drawing, s.
    """

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
    chart_names = check_names(tuple(names))
    announce(Cost(counted(len(chart_names), "chart"), len(chart_names) * _SECONDS[quick], 4e8, "bench"), yes=yes)
    # Read before the work, so that later edits of the checkout do not matter.
    provenance = {"quick": quick, "machine": machine(), "versions": versions(), "commit": commit()}
    finished = []
    with one_core():
        for k, name in enumerate(chart_names):
            start = time.perf_counter()
            chart = CHARTS[name](quick, part_of(progress, k / len(chart_names), (k + 1) / len(chart_names)))
            seconds, data = time.perf_counter() - start, Path(folder) / f"{chart.name}.json"
            pictures = {Path(folder) / f"{chart.name}{end}.png": parts for end, parts in chart.pages.items()}
            for picture, parts in pictures.items():
                save_figure(figure(chart, parts), picture)
            document = {**chart.document(), "seconds": seconds, **provenance}
            write_whole(data, json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
            finished.append(DrawnChart(chart, tuple(pictures), data, seconds))
    return DrawnCharts(tuple(finished))


def machine() -> dict[str, Any]:
    """Return processor, cores, load, operating system and Python, which the data of a chart record."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
    }


def _processor() -> str:
    """Return the name of the processor from the system's list, or, if there is none, that of Python, maybe ""."""
    cpu_file = Path("/proc/cpuinfo")
    lines = cpu_file.read_text(encoding="utf-8").splitlines() if cpu_file.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor())
