"""Draw charts to pictures and data.

Each is drawn to NAME.png, an appendix to NAME-more.png. NAME.json has points, machine and versions.

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
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

from dpcontrol.bench.chart import (
    ALLOWED,
    CHARTS,
    GROUPS,
    ChartPage,
    Diagram,
    Point,
    check_names,
)
from dpcontrol.bench.drawing import save_chart
from dpcontrol.bench.measure import one_core
from dpcontrol.foundation.cache import commit
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import write_whole
from dpcontrol.foundation.parts import versions
from dpcontrol.foundation.processes import in_processes, processors
from dpcontrol.foundation.progress import Cost, Progress, announce, no_progress, part_of


@dataclass(frozen=True)
class DrawnChart:
    """A finished chart, its files, and its duration in seconds."""

    chart: ChartPage
    pictures: tuple[Path, ...]
    data: Path
    seconds: float


_SECONDS = {False: 90.0, True: 10.0}
"""Cost of a chart, s of one processor, for full and quick charts."""
_LONGER = {"edges-margins": 2.8}
"""Charts whose full cost is a multiple of the others', and the multiple."""
_MEMORY = 4e8
"""Memory of a process that draws charts, bytes."""


def charts_cost(names: Sequence[str], *, quick: bool) -> Cost:
    """Return the expected cost of charts.

    Args:
        names: charts to draw.
        quick: shorter measurements.
    """
    mapped = sum(1.0 if quick else _LONGER.get(name, 1.0) for name in names if name in GROUPS["edges"])
    at_once = max(min(processors(), sum(name in GROUPS["edges"] for name in names)), 1)
    timed = sum(name not in GROUPS["edges"] for name in names)
    seconds = (timed + mapped / at_once) * _SECONDS[quick]
    work = f"{len(names)} chart{'s' if len(names) > 1 else ''}"
    return Cost(work, seconds, at_once * _MEMORY, "bench")


def draw_charts(
    names: Sequence[str], folder: Path, *, quick: bool = False, yes: bool = False, progress: Progress = no_progress
) -> tuple[DrawnChart, ...]:
    """Draw charts (all if `names` is empty).

    Timed charts come first, sequentially in this process, on one core, with the others idle. Maps of failure have no
    times and are drawn in parallel on all cores.

    Args:
        names: charts or groups of charts.
        folder: folder to write to.
        quick: shorter measurements.
        yes: accept any duration.
        progress: called with a label and the completed share.

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
            with one_core():
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
    """Make one chart and write its pictures and data.

    Args:
        name: name of the chart.
        folder: folder to write to.
        made_with: `quick`, machine and versions, for the data.
        progress: called with a label and the completed share.
    """
    began = time.perf_counter()
    chart = CHARTS[name](made_with["quick"], progress)
    seconds = time.perf_counter() - began
    pictures = {Path(folder) / f"{chart.name}{end}.png": parts for end, parts in chart.pages.items()}
    for picture, parts in pictures.items():
        save_chart(chart, picture, parts)
    data = Path(folder) / f"{chart.name}.json"
    document = {**chart.document(), "seconds": seconds, **made_with}
    write_whole(data, json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    return DrawnChart(chart, tuple(pictures), data, seconds)


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


def earlier_panels(folder: Path, name: str) -> tuple[Diagram, ...]:
    """Return a chart's panels from an earlier drawing.

    Args:
        folder: folder of the drawing.
        name: name of the chart.

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


def _panel(document: Mapping[str, Any]) -> Diagram:
    known = {f.name for f in fields(Point)}
    points = tuple(Point(**{name: value for name, value in p.items() if name in known}) for p in document["points"])
    titles = {name: document[name] for name in ("title", "x_label", "y_label", "floor", "judged", "timed")}
    return Diagram(points=points, **titles)


def changes(before: Sequence[Diagram], after: Sequence[Diagram]) -> tuple[str, ...]:
    """Return a sentence for each changed front, except ties.

    Args:
        before: panels of the earlier drawing.
        after: panels of the new drawing.
    """
    known = {panel.title: panel for panel in before}
    found = []
    for panel in after:
        texts = _changes(known[panel.title], panel) if panel.title in known else ["not in the earlier drawing"]
        found += [f"{panel.title}: {text}" for text in texts]
    return tuple(found)


def _changes(before: Diagram, after: Diagram) -> list[str]:
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


def losses(before: Sequence[Diagram], after: Sequence[Diagram]) -> tuple[str, ...]:
    """Return a sentence for each default that became slower or less accurate.

    Args:
        before: panels of the earlier drawing.
        after: panels of the new drawing.
    """
    return slower(before, after) + less_accurate(before, after)


def slower(before: Sequence[Diagram], after: Sequence[Diagram]) -> tuple[str, ...]:
    """Return a sentence for each default with a larger x value.

    The value is compared with the earlier one.

    Args:
        before: panels of the earlier drawing.
        after: panels of the new drawing.
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


def less_accurate(before: Sequence[Diagram], after: Sequence[Diagram]) -> tuple[str, ...]:
    """Return a sentence for each default with a larger error than before.

    Args:
        before: panels of the earlier drawing.
        after: panels of the new drawing.
    """
    return tuple(
        f"{panel.title}: {now.name} errs by {now.error:.2g}, and did by {was.error:.2g}"
        for panel, was, now in _defaults(before, after)
        if max(now.error, panel.floor) > WORSE * max(was.error, panel.floor)
    )


def _defaults(before: Sequence[Diagram], after: Sequence[Diagram]) -> Iterator[tuple[Diagram, Point, Point]]:
    """Yield each panel with one of its defaults, now and before."""
    known = {(panel.title, p.name): p for panel in before for p in panel.points}
    for panel in after:
        for now in panel.defaults:
            if (panel.title, now.name) in known:
                yield panel, known[panel.title, now.name], now
