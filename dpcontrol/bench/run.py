"""Draw charts: each to NAME.png, and to NAME.json with its points, machine, versions and commit."""

import json
import os
import platform
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from dpcontrol import __version__
from dpcontrol.bench.chart import ChartPage
from dpcontrol.bench.measure import one_core
from dpcontrol.bench.registry import CHARTS, GROUPS, check_names
from dpcontrol.foundation.checkout import commit
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
