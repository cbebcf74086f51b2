"""Draw charts: each to NAME.png, and to NAME.json with its points, machine, versions and commit.

A chart drawn again, held against an earlier drawing: methods keep their order on each front, defaults their worth.

Two times that differ by less than `TIED` are a tie: either may come first, and a point that stands off a front by no
more may be on it in one drawing and not in the other. Everything else must be as it was.

A default's time is compared in units of a yardstick's beside it, work of other packages only, so that drawings of
different machines, and of a busy one, can be held against each other.
"""

import json
import os
import platform
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from importlib.metadata import PackageNotFoundError, version
from itertools import combinations
from pathlib import Path
from typing import Any

from dpcontrol import __version__
from dpcontrol.bench.chart import ALLOWED, CHARTS, GROUPS, ChartPage, Panel, Point, check_names
from dpcontrol.bench.measure import one_core
from dpcontrol.foundation.cache import commit
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import whole_file, write_whole
from dpcontrol.foundation.processes import in_processes, processors
from dpcontrol.foundation.progress import Progress, no_progress, part_of

PACKAGES = ("numpy", "scipy", "casadi", "heyoka", "filterpy", "control", "mcap", "zstandard", "matplotlib")


@dataclass(frozen=True)
class DrawnChart:
    """A chart that was made, its files, and the seconds that it took."""

    chart: ChartPage
    picture: Path
    data: Path
    seconds: float


@dataclass(frozen=True)
class Order:
    """A chart to be drawn: its name, where to, and what all charts of one drawing were made on and with."""

    name: str
    folder: Path
    quick: bool
    made_with: Mapping[str, Any]


def draw_charts(
    names: Sequence[str], folder: Path, *, quick: bool = False, progress: Progress = no_progress
) -> tuple[DrawnChart, ...]:
    """Make charts (all where `names` is empty).

    Those with times are made first, one after the other in this process, on one core, the others idle. Maps of failure
    hold none: as many are drawn at once as there are cores.

    Raises:
        InputError: an unknown name, or a folder that cannot be written to.
        GoalMissed: processes that draw maps died again and again.
    """
    chosen = check_names(tuple(names))
    # Asked before the work, so that a checkout that is edited meanwhile does not mislead.
    made_with = {"quick": quick, "machine": machine(), "versions": versions(), "commit": commit()}
    maps = [name for name in chosen if name in GROUPS["edges"]]
    together = len(maps) if len(maps) > 1 and processors() > 1 else 0
    alone = [name for name in chosen if not together or name not in maps]
    drawn: dict[str, DrawnChart] = {}
    for k, name in enumerate(alone):
        progress(name, k / len(chosen))
        part = part_of(_named(name, progress), k / len(chosen), (k + 1) / len(chosen))
        with one_core():
            drawn[name] = draw_chart(Order(name, folder, quick, made_with), part)
    if together:
        orders = [Order(name, folder, quick, made_with) for name in maps]
        progress(f"{together} maps of failure", len(alone) / len(chosen))
        for done in _at_once(orders):
            drawn[done.chart.name] = done
            left = ", ".join(name for name in maps if name not in drawn)
            progress(f"maps left: {left}" if left else "maps", len(drawn) / len(chosen))
    return tuple(drawn[name] for name in chosen)


def _named(name: str, progress: Progress) -> Progress:
    """Return a progress whose words begin with a chart's name."""
    return lambda what, done: progress(what if what.startswith(name) else f"{name}: {what}", done)


def draw_chart(order: Order, progress: Progress = no_progress) -> DrawnChart:
    """Make one chart and save it."""
    began = time.perf_counter()
    chart = CHARTS[order.name](order.quick, progress)
    seconds = time.perf_counter() - began
    # matplotlib takes half a second to import.

    picture, data = save(chart, order.folder, made_with=order.made_with, seconds=seconds)
    return DrawnChart(chart, picture, data, seconds)


def _at_once(orders: Sequence[Order]) -> Iterator[DrawnChart]:
    remedy = "Charts that were done are saved: name those that are missing"
    for _, done in in_processes(draw_chart, orders, min(processors(), len(orders)), remedy=remedy):
        yield done


def save(chart: ChartPage, folder: Path, *, made_with: Mapping[str, Any], seconds: float) -> tuple[Path, Path]:
    """Write a chart's picture and data to `folder`; return their paths."""
    # matplotlib takes half a second to import.
    from dpcontrol.bench.drawing import figure

    picture, data = Path(folder) / f"{chart.name}.png", Path(folder) / f"{chart.name}.json"
    with whole_file(picture, suffix=".png") as temporary:
        figure(chart).savefig(temporary, format="png")
    document = {**chart.document(), "seconds": seconds, **made_with}
    write_whole(data, json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    return picture, data


def machine() -> dict[str, Any]:
    """Return processor, cores, load, operating system and Python."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
    }


def versions() -> dict[str, str]:
    """Return the versions of this package and of those it measures; "" for one that is not installed."""
    return {"dpcontrol": __version__} | {name: _version(name) for name in PACKAGES}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor()


TIED = ALLOWED
"""Share by which two times may differ and count as equal: what is off a front by no more may be a default, too."""

SLOWER = 2.0
"""Times what it took that a default may take: machines and their loads differ by less."""
WORSE = 3.0
"""Times its earlier error that its error may be: rounding differs by less from build to build."""

_POINT = {f.name for f in fields(Point)}


def earlier_panels(folder: Path, name: str) -> tuple[Panel, ...]:
    """Return a chart's panels as an earlier drawing in `folder` has them.

    Raises:
        InputError: there is no earlier drawing, or it is not one.
    """
    file = Path(folder) / f"{name}.json"
    try:
        return tuple(_panel(panel) for panel in json.loads(file.read_text(encoding="utf-8"))["panels"])
    except OSError as error:
        raise InputError(
            f"no earlier drawing {file}: {error.strerror or error}; draw it with --out {folder}"
        ) from error
    except (ValueError, LookupError, TypeError) as error:
        raise InputError(f"{file} is no drawing of a chart: {error}; draw it anew with --out {folder}") from error


def _panel(document: Mapping[str, Any]) -> Panel:
    points = tuple(Point(**{name: value for name, value in p.items() if name in _POINT}) for p in document["points"])
    return Panel(
        document["title"], document["x_label"], document["y_label"], points, floor=document["floor"],
        judged=document["judged"], timed=document["timed"],
    )  # fmt: skip


def changes(before: Sequence[Panel], after: Sequence[Panel]) -> tuple[str, ...]:
    """Return a sentence for each front that is not as it was, ties apart."""
    known = {panel.title: panel for panel in before}
    found = []
    for panel in after:
        if panel.title not in known:
            found.append(f"{panel.title}: not in the earlier drawing")
        else:
            found += [f"{panel.title}: {text}" for text in _changes(known[panel.title], panel)]
    return tuple(found)


def losses(before: Sequence[Panel], after: Sequence[Panel]) -> tuple[str, ...]:
    """Return a sentence for each default that became slower or less accurate than its namesake was."""
    return slower(before, after) + less_accurate(before, after)


def slower(before: Sequence[Panel], after: Sequence[Panel]) -> tuple[str, ...]:
    """Return a sentence for each default that takes more of what its panel has along x than its namesake did."""
    found = []
    for panel, was, now in _defaults(before, after):
        if panel.timed and not (was.yardstick and now.yardstick):
            continue
        unit = now.yardstick / was.yardstick if panel.timed else 1.0
        times = now.seconds / (unit * was.seconds)
        if times > SLOWER:
            found.append(f"{panel.title}: {now.name} takes {times:.2g} times what it took ({panel.x_label})")
    return tuple(found)


def less_accurate(before: Sequence[Panel], after: Sequence[Panel]) -> tuple[str, ...]:
    """Return a sentence for each default that errs by more than its namesake did."""
    return tuple(
        f"{panel.title}: {now.name} errs by {now.error:.2g}, and did by {was.error:.2g}"
        for panel, was, now in _defaults(before, after)
        if max(now.error, panel.floor) > WORSE * max(was.error, panel.floor)
    )


def _defaults(before: Sequence[Panel], after: Sequence[Panel]) -> Iterator[tuple[Panel, Point, Point]]:
    """Yield each panel with a default of it and what that was before."""
    known = {panel.title: {p.name: p for p in panel.points} for panel in before}
    for panel in after:
        for now in panel.defaults:
            was = known.get(panel.title, {}).get(now.name)
            if was is not None:
                yield panel, was, now


def _changes(before: Panel, after: Panel) -> list[str]:
    # What one drawing lacks was not measured (another package that is not installed), and has no place.
    names = {p.name for p in before.points} & {p.name for p in after.points}
    before, after = (replace(p, points=tuple(x for x in p.points if x.name in names)) for p in (before, after))
    was, now = ({p.name: p for p in panel.points} for panel in (before, after))
    fronts = [{p.name for p in panel.front} for panel in (before, after)]
    left = {name: after.off_front(now[name]) for name in sorted(fronts[0] - fronts[1])}
    came = {name: before.off_front(was[name]) for name in sorted(fronts[1] - fronts[0])}
    found = [f"{name} was on the front, and is {off:.0%} off it" for name, off in left.items() if off > TIED]
    found += [f"{name} was {off:.0%} off the front, and is on it" for name, off in came.items() if off > TIED]
    for one, other in combinations(sorted(fronts[0] & fronts[1]), 2):
        ratios = [p[one].seconds / p[other].seconds for p in (was, now)]
        low, high = sorted(ratios)
        if high > 1 + TIED and low < 1 / (1 + TIED):
            found.append(f"{one} took {ratios[0]:.2g} times as long as {other}, and takes {ratios[1]:.2g} times")
    return found
