"""Draw charts: each to NAME.png, and to NAME.json with its points, machine, versions and commit.

A chart can be compared with an earlier drawing: methods keep their order on each front, defaults their quality.

Two times that differ by less than `TIED` are a tie in either order. A point within this share of a front may be on it
in one drawing and not in the other. Everything else must be unchanged.

A default's time is compared in units of an adjacent yardstick, which runs only other packages. Drawings of different
or busy machines are therefore comparable.
"""

import json
import os
import platform
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import combinations, pairwise
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator, PercentFormatter

from dpcontrol.bench.chart import (
    ALLOWED,
    AT_ONCE,
    CHARTS,
    GROUPS,
    SPREAD,
    ChartPage,
    EdgeMap,
    Panel,
    Point,
    PrecisionChart,
    check_names,
)
from dpcontrol.bench.measure import one_core
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.cache import commit
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import whole_file, write_whole
from dpcontrol.foundation.parts import versions
from dpcontrol.foundation.processes import in_processes, processors
from dpcontrol.foundation.progress import Cost, Progress, announce, no_progress, part_of
from dpcontrol.pages.style import FAINT, INK, LIMIT, REFERENCE, STABLE


@dataclass(frozen=True)
class DrawnChart:
    """A finished chart, its files, and its duration in seconds."""

    chart: ChartPage
    picture: Path
    data: Path
    seconds: float


_SECONDS = {False: (90.0, 1400.0), True: (10.0, 90.0)}
"""Cost of a chart on one processor and on several, s, for full and quick charts."""
_MEMORY = 4e8
"""Memory of a process that draws charts, bytes."""


def charts_cost(names: Sequence[str], *, quick: bool) -> Cost:
    """Return the expected cost of charts."""
    mapped = sum(name in GROUPS["edges"] for name in names)
    at_once = max(min(processors(), mapped), 1)
    spread, many = sum(name in SPREAD for name in names), min(processors(), AT_ONCE)
    turns, (one, several) = len(names) - mapped - spread + mapped / at_once, _SECONDS[quick]
    seconds = turns * one + spread * several / many
    work = f"{len(names)} chart{'s' if len(names) > 1 else ''}"
    return Cost(work, seconds, (many if spread else at_once) * _MEMORY, "bench")


def draw_charts(
    names: Sequence[str], folder: Path, *, quick: bool = False, yes: bool = False, progress: Progress = no_progress
) -> tuple[DrawnChart, ...]:
    """Draw charts (all if `names` is empty).

    Timed charts come first, sequentially in this process, on one core, with the others idle. Maps of failure have no
    times and are drawn in parallel on all cores.

    Args:
        yes: accept any duration.

    Raises:
        InputError: a name is unknown, the folder is not writable, or the charts would take too long.
        GoalMissed: the processes that draw maps failed repeatedly.
    """
    chosen = check_names(tuple(names))
    announce(charts_cost(chosen, quick=quick), yes=yes)
    # Read before the work, so that later edits of the checkout do not matter.
    made_with = {"quick": quick, "machine": machine(), "versions": versions(), "commit": commit()}
    draw = partial(draw_chart, folder=folder, made_with=made_with)
    maps = [name for name in chosen if name in GROUPS["edges"]]
    if len(maps) == 1 or processors() == 1:
        maps = []
    drawn: dict[str, DrawnChart] = {}
    for name in chosen:
        if name not in maps:
            begin, end = len(drawn) / len(chosen), (len(drawn) + 1) / len(chosen)
            progress(name, begin)
            with nullcontext() if name in SPREAD else one_core():
                drawn[name] = draw(name, progress=part_of(_named(name, progress), begin, end))
    if maps:
        progress(f"{len(maps)} maps of failure", len(drawn) / len(chosen))
        remedy = "Finished charts are saved: name the missing ones"
        for name, done in in_processes(draw, maps, min(processors(), len(maps)), remedy=remedy):
            drawn[name] = done
            left = ", ".join(name for name in maps if name not in drawn)
            progress(f"maps left: {left}" if left else "maps", len(drawn) / len(chosen))
    return tuple(drawn[name] for name in chosen)


def _named(name: str, progress: Progress) -> Progress:
    """Return a progress whose text begins with a chart's name."""
    return lambda what, done: progress(what if what.startswith(name) else f"{name}: {what}", done)


def draw_chart(
    name: str, *, folder: Path, made_with: Mapping[str, Any], progress: Progress = no_progress
) -> DrawnChart:
    """Make one chart and write its picture and data to `folder`."""
    began = time.perf_counter()
    chart = CHARTS[name](made_with["quick"], progress)
    seconds = time.perf_counter() - began
    picture, data = Path(folder) / f"{chart.name}.png", Path(folder) / f"{chart.name}.json"
    with whole_file(picture, suffix=".png") as temporary:
        figure(chart).savefig(temporary, format="png")
    document = {**chart.document(), "seconds": seconds, **made_with}
    write_whole(data, json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    return DrawnChart(chart, picture, data, seconds)


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
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor()


TIED = ALLOWED
"""Relative difference of times that count as equal; a default this close to a front may leave it."""
SLOWER = 2.0
"""Tolerated ratio of a default's time to the earlier one: machines and their loads differ by less."""
WORSE = 3.0
"""Tolerated ratio of a default's error to the earlier one: rounding differs by less from build to build."""


def earlier_panels(folder: Path, name: str) -> tuple[Panel, ...]:
    """Return a chart's panels from an earlier drawing in `folder`.

    Raises:
        InputError: the drawing is missing or invalid.
    """
    file = Path(folder) / f"{name}.json"
    try:
        return tuple(_panel(panel) for panel in json.loads(file.read_text(encoding="utf-8"))["panels"])
    except OSError as error:
        raise InputError(
            f"no earlier drawing {file}: {error.strerror or error}; draw it with --out {folder}"
        ) from error
    except (ValueError, LookupError, TypeError) as error:
        raise InputError(f"{file} is no drawing of a chart: {error}; draw it again with --out {folder}") from error


def _panel(document: Mapping[str, Any]) -> Panel:
    known = {f.name for f in fields(Point)}
    points = tuple(Point(**{name: value for name, value in p.items() if name in known}) for p in document["points"])
    titles = {name: document[name] for name in ("title", "x_label", "y_label", "floor", "judged", "timed")}
    return Panel(points=points, **titles)


def changes(before: Sequence[Panel], after: Sequence[Panel]) -> tuple[str, ...]:
    """Return a sentence for each changed front, except ties."""
    known = {panel.title: panel for panel in before}
    found = []
    for panel in after:
        texts = _changes(known[panel.title], panel) if panel.title in known else ["not in the earlier drawing"]
        found += [f"{panel.title}: {text}" for text in texts]
    return tuple(found)


def _changes(before: Panel, after: Panel) -> list[str]:
    # Points missing in one drawing were not measured (another package is not installed) and are skipped.
    names = {p.name for p in before.points} & {p.name for p in after.points}
    before, after = (replace(p, points=tuple(x for x in p.points if x.name in names)) for p in (before, after))
    was, now = ({p.name: p for p in panel.points} for panel in (before, after))
    fronts = [{p.name for p in panel.front} for panel in (before, after)]
    left = {name: after.off_front(now[name]) for name in sorted(fronts[0] - fronts[1])}
    joined = {name: before.off_front(was[name]) for name in sorted(fronts[1] - fronts[0])}
    found = [f"{name} was on the front, and is {off:.0%} off it" for name, off in left.items() if off > TIED]
    found += [f"{name} was {off:.0%} off the front, and is on it" for name, off in joined.items() if off > TIED]
    for one, other in combinations(sorted(fronts[0] & fronts[1]), 2):
        ratios = [p[one].seconds / p[other].seconds for p in (was, now)]
        if max(ratios) > 1 + TIED and min(ratios) < 1 / (1 + TIED):
            found.append(f"{one} took {ratios[0]:.2g} times as long as {other}, and takes {ratios[1]:.2g} times")
    return found


def losses(before: Sequence[Panel], after: Sequence[Panel]) -> tuple[str, ...]:
    """Return a sentence for each default that became slower or less accurate."""
    return slower(before, after) + less_accurate(before, after)


def slower(before: Sequence[Panel], after: Sequence[Panel]) -> tuple[str, ...]:
    """Return a sentence for each default with a larger x value.

    It is compared with the earlier one.
    """
    found = []
    for panel, was, now in _defaults(before, after):
        if panel.timed and not (was.yardstick and now.yardstick):
            continue
        unit = now.yardstick / was.yardstick if panel.timed else 1.0
        times = now.seconds / (unit * was.seconds)
        if times > SLOWER:
            found.append(f"{panel.title}: {now.name} takes {times:.2g} times the earlier cost ({panel.x_label})")
    return tuple(found)


def less_accurate(before: Sequence[Panel], after: Sequence[Panel]) -> tuple[str, ...]:
    """Return a sentence for each default with a larger error than before."""
    return tuple(
        f"{panel.title}: {now.name} errs by {now.error:.2g}, and did by {was.error:.2g}"
        for panel, was, now in _defaults(before, after)
        if max(now.error, panel.floor) > WORSE * max(was.error, panel.floor)
    )


def _defaults(before: Sequence[Panel], after: Sequence[Panel]) -> Iterator[tuple[Panel, Point, Point]]:
    """Yield each panel with one of its defaults, now and before."""
    known = {(panel.title, p.name): p for panel in before for p in panel.points}
    for panel in after:
        for now in panel.defaults:
            if (panel.title, now.name) in known:
                yield panel, known[panel.title, now.name], now


MARKS = "osD^v<>Pph*X8d"
COLOURS = ("#1f6fb4", "#d9640d", "#2c8a4b", "#8a4fa3", "#9a6b15", "#c2185b", "#0f8b8d", "#5b6470")
FLOOR = 1e-17
"""Drawn position of an error of exactly zero."""
WIDTH, HEIGHT = 6.4, 5.6
_FEW, _MANY = 6.0, 100.0
"""Ranges of a logarithmic axis: below the first 1, 2, 5 give too few labels, from the second on powers are enough."""
_FOR_LEGEND = 0.3
"""Free share of a map's height above its contents."""


def figure(page: ChartPage) -> Figure:
    """Return a page's picture with its diagrams side by side.

    Each method has one colour and mark throughout.
    """
    columns = 2 if len(page.parts) == 4 and isinstance(page, PrecisionChart) else min(len(page.parts), 3)
    rows = -(-len(page.parts) // columns)
    picture = Figure(figsize=(WIDTH * columns, HEIGHT * rows + 1.0), layout="constrained", dpi=110)
    picture.suptitle(page.title, fontsize=13, color=INK)
    panels = page.parts if isinstance(page, PrecisionChart) else ()
    methods = list(dict.fromkeys(p.method for panel in panels for p in panel.points))
    looks = {m: (MARKS[k % len(MARKS)], COLOURS[k % len(COLOURS)]) for k, m in enumerate(methods)}
    axes = picture.subplots(rows, columns, squeeze=False).ravel()
    for axis, part in zip(axes, page.parts, strict=False):
        axis.margins(0.12, 0.08)
        if isinstance(part, Panel):
            _draw_panel(axis, part, looks)
        else:
            _draw_map(axis, part)
        axis.set_title(part.title, fontsize=10, color=INK)
        axis.set_xlabel(part.x_label)
        axis.set_ylabel(part.y_label)
    for axis in axes[len(page.parts) :]:
        axis.set_visible(False)
    text = [fill(line, int(WIDTH * columns * 13)) for line in page.reading]
    picture.supxlabel("\n".join(text), fontsize=9, color=INK, x=0.01, ha="left")
    if panels:
        # The space for labels is known once the axes have their positions.
        picture.draw_without_rendering()
        for axis, panel in zip(axes, panels, strict=False):
            _label_settings(axis, panel, looks)
    return picture


def _draw_map(axis: Any, one: EdgeMap) -> None:
    for works, mark, colour, label in ((True, "o", STABLE, one.near), (False, "x", LIMIT, one.far)):
        shown = [(b.x, t.y) for b in one.borders for t in b.trials if t.works is works]
        axis.plot([x for x, _ in shown], [y for _, y in shown], mark, color=colour, markersize=5, label=label)
    for places, style in (
        ([(b.x, b.measured) for b in one.borders if b.measured is not None],
         {"marker": "_", "linestyle": "-", "color": INK, "markersize": 16, "label": "measured border"}),
        ([(b.x, b.predicted) for b in one.borders if b.predicted is not None],
         {"marker": "D", "linestyle": "--", "color": REFERENCE, "markersize": 7, "markerfacecolor": "none",
          "markeredgecolor": INK, "label": fill(f"predicted: {one.theory}", 60)}),
    ):  # fmt: skip
        if places:
            axis.plot(*zip(*places, strict=True), linewidth=1.2, **style)
    if one.log_x and all(b.x > 0 for b in one.borders):
        axis.set_xscale("log")
    axis.set_yscale("log")
    names = {b.x: b.line for b in sorted(one.borders, key=lambda b: b.x)}
    # Numbered positions show the lines' names.
    named = not one.log_x and list(names) == list(range(len(names)))
    labels = list(names.values()) if named else [f"{x:.4g}" for x in names]
    axis.set_xticks(list(names), labels, fontsize=8, rotation=20 if named else 0)
    axis.xaxis.set_minor_locator(NullLocator())
    low, high = axis.get_ylim()
    axis.set_ylim(low, high * (high / low) ** _FOR_LEGEND)
    # Most borders span less than a decade, so its parts are labelled too.
    _readable_ticks(axis.yaxis, many=10 * _MANY)
    axis.legend(fontsize=7, loc="upper left", framealpha=0.85)


def _height(panel: Panel, error: float) -> float:
    return max(error, panel.floor, FLOOR) if panel.log_y else error


def _draw_panel(axis: Any, panel: Panel, looks: dict[str, tuple[str, str]]) -> None:
    for method in dict.fromkeys(p.method for p in panel.points):
        mark, colour = looks[method]
        points = sorted((p for p in panel.points if p.method == method), key=lambda p: p.seconds)
        hollow = any(p.outside or p.stored for p in points)
        axis.plot(
            [p.seconds for p in points], [_height(panel, p.error) for p in points], mark, color=colour, markersize=6,
            markerfacecolor="white" if hollow else colour, label=method, zorder=3,
        )  # fmt: skip
    front = panel.front
    axis.plot(
        [p.seconds for p in front], [_height(panel, p.error) for p in front], color=FAINT, linewidth=4, zorder=1,
        drawstyle="steps-post", label="front",
    )  # fmt: skip
    for p in panel.defaults:
        axis.plot(p.seconds, _height(panel, p.error), "o", markersize=_RING, markerfacecolor="none", color=LIMIT,
                  zorder=4)  # fmt: skip
    if panel.defaults:
        standing = "; ".join(dict.fromkeys(panel.standing(p) for p in panel.defaults))
        label = fill(f"default: {standing}", 30) if panel.judged else "default"
        axis.plot([], [], "o", markersize=9, markerfacecolor="none", color=LIMIT, label=label)
    axis.set_xscale("log")
    if panel.log_y:
        axis.set_yscale("log")
    axis.grid(True, which="major", color=FAINT, linewidth=0.5)
    _readable_ticks(axis.xaxis)
    if panel.log_y:
        _readable_ticks(axis.yaxis)
    else:
        _share_axis(axis, max(p.error for p in panel.points))
    axis.legend(fontsize=7.5, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)


def _share_axis(axis: Any, most: float) -> None:
    """Show shares from zero to one on an axis.

    If the maximum is at most a tenth, show slightly more than it.
    """
    top = 1.0 if most > 0.15 or most == 0 else 1.2 * most
    # The axis starts slightly below zero to show whole marks; labels start at zero.
    axis.set_ylim(-0.05 * top, 1.05 * top)
    axis.set_yticks([tick for tick in MaxNLocator(6).tick_values(0.0, top) if 0 <= tick <= 1.001 * top])
    axis.yaxis.set_major_formatter(PercentFormatter(1.0))


_RING, _LABEL, _CLEAR = 15.0, 8.0, 10.0
"""Diameter of a ring, height of a label's letters, and width of a mark, in points."""
_AWAY = np.array([0.0, 6.0, 12.0, 20.0, 30.0, 42.0, 60.0])
"""Tried distances between mark and label, in points; from `_LED` on a line connects them."""
_LED = 10.0
_ALONG = np.linspace(0.3, 0.8, 8)
"""Tested points of the line from a mark to its label, as shares of its length."""
_SIDES = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1), (1, 0), (-1, 0), (0, 1), (0, -1)])


def _label_settings(axis: Any, panel: Panel, looks: dict[str, tuple[str, str]]) -> None:
    """Write each setting beside its mark.

    The place has the least overlap with marks, rings, the front and other labels.
    """
    unit = axis.figure.dpi / 72
    renderer = axis.figure._get_renderer()

    def pixels(points: Sequence[Point]) -> Array:
        return axis.transData.transform([(p.seconds, _height(panel, p.error)) for p in points])

    spots, front = pixels(panel.points), pixels(panel.front)
    clear = [unit * (_RING + 2 if p.default else _CLEAR) for p in panel.points]
    taken = [_box(spot, size) for spot, size in zip(spots, clear, strict=True)]
    labels: list[Array] = []
    for one, other in pairwise(front):
        corner = np.array([other[0], one[1]])
        taken += [_box((a + b) / 2, np.abs(b - a) + 4 * unit) for a, b in ((one, corner), (corner, other))]
    for p, spot, size in zip(panel.points, spots, clear, strict=True):
        if not p.setting:
            continue
        look = {"textcoords": "offset points", "xy": (p.seconds, _height(panel, p.error)), "in_layout": False}
        colour = looks[p.method][1]
        text = axis.annotate(p.setting, xytext=(0, 0), fontsize=_LABEL, color=colour, ha="center", va="center", **look)
        extent = np.array([*text.get_window_extent(renderer).size])
        away = np.repeat(_AWAY, len(_SIDES))
        offsets = np.tile(_SIDES, (len(_AWAY), 1)) * (size / 2 + unit * away[:, None] + extent / 2)
        boxes = np.array([_box(spot + offset, extent) for offset in offsets])
        outside = extent.prod() - _common(boxes, axis.bbox.extents)
        # A line to a label must not cross other labels, and conversely.
        dots = np.array([[_box(spot + share * offset, 3 * unit) for share in _ALONG] for offset in offsets])
        crossed = sum(_common(dots.reshape(-1, 4), label).reshape(len(offsets), -1).sum(axis=1) for label in labels)
        covered = sum(_common(boxes, other) for other in taken)
        cost = 10 * (covered + outside) + away + crossed * (away >= _LED)
        best = int(np.argmin(cost))
        text.set_position(offsets[best] / unit)
        labels.append(boxes[best])
        taken.append(boxes[best])
        if away[best] >= _LED:
            line = {"arrowstyle": "-", "color": colour, "linewidth": 0.5, "shrinkA": 1, "shrinkB": 3}
            nearest = np.clip(0.0, offsets[best] - extent / 2, offsets[best] + extent / 2)
            axis.annotate("", xytext=nearest / unit, arrowprops=line, **look)


def _box(middle: Array, size: Array | float) -> Array:
    """Return left, bottom, right and top."""
    return np.concatenate([middle - np.divide(size, 2), middle + np.divide(size, 2)])


def _common(boxes: Array, other: Array) -> Array:
    """Return the overlap areas of boxes (K, 4) with another."""
    return np.clip(np.minimum(boxes[:, 2:], other[2:]) - np.maximum(boxes[:, :2], other[:2]), 0, None).prod(axis=1)


def _readable_ticks(axis: Any, many: float = _MANY) -> None:
    """Thin labels of a logarithmic axis.

    Powers of ten remain, with 1, 2, 5 on short ranges, otherwise a few round numbers.
    """
    low, high = axis.get_view_interval()
    axis.set_minor_formatter(NullFormatter())
    if high / low >= many:
        return
    few = high / low < _FEW
    axis.set_major_locator(MaxNLocator(4, min_n_ticks=2) if few else LogLocator(subs=(1.0, 2.0, 5.0)))
    if few:
        axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
