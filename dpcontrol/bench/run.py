"""Draw charts to pictures and data.

Each is drawn to NAME.png, an appendix to NAME-more.png. NAME.json has points, machine and versions.
"""

import json
import os
import platform
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from dpcontrol.bench.chart import CHARTS, ChartPage, check_names
from dpcontrol.bench.drawing import save_chart
from dpcontrol.bench.measure import one_core
from dpcontrol.foundation.cache import commit
from dpcontrol.foundation.document import Documented, counted
from dpcontrol.foundation.files import write_whole
from dpcontrol.foundation.parts import versions
from dpcontrol.foundation.progress import Cost, Progress, announce, no_progress, part_of


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
    """Finished charts; with `strict`, a deviation that a chart reports counts as a failure."""

    KEYS: ClassVar[str] = "charts status"

    charts: tuple[DrawnChart, ...]
    strict: bool = False

    def __iter__(self) -> Iterator[DrawnChart]:
        return iter(self.charts)

    @property
    def complaints(self) -> tuple[str, ...]:
        """Defaults off their front, and limits that differ from their prediction."""
        return tuple(text for one in self.charts for text in one.chart.complaints)

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


def charts_cost(names: Sequence[str], *, quick: bool) -> Cost:
    """Return the expected cost of charts.

    Args:
        names: charts to draw.
        quick: shorter measurements.
    """
    return Cost(counted(len(names), "chart"), len(names) * _SECONDS[quick], 4e8, "bench")


def draw_charts(
    names: Sequence[str], folder: Path, *, quick: bool = False, yes: bool = False, progress: Progress = no_progress
) -> DrawnCharts:
    """Draw charts (all if `names` is empty).

    They are drawn one after the other on one core, with the others idle.

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
    announce(charts_cost(chosen, quick=quick), yes=yes)
    # Read before the work, so that later edits of the checkout do not matter.
    made_with = {"quick": quick, "machine": machine(), "versions": versions(), "commit": commit()}
    drawn = []
    with one_core():
        for k, name in enumerate(chosen):
            report = part_of(progress, k / len(chosen), (k + 1) / len(chosen))
            drawn.append(draw_chart(name, folder=folder, made_with=made_with, progress=report))
    return DrawnCharts(tuple(drawn))


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
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor()
