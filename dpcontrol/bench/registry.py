"""Charts by name; a chart's module is imported when the chart is drawn."""

import importlib
from collections.abc import Callable

from dpcontrol.bench.chart import ChartPage
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress

Drawer = Callable[[bool, Progress], ChartPage]
"""(quick, progress) -> chart: `quick` takes less of the same work, so that the order on the front stays."""


def _of(module: str, function: str = "chart") -> Drawer:
    def chart(quick: bool, progress: Progress) -> ChartPage:
        return getattr(importlib.import_module(f"dpcontrol.bench.{module}"), function)(quick, progress)

    return chart


CHARTS: dict[str, Drawer] = {
    "propagation": _of("propagation"),
    "connections": _of("connections"),
    "transcription": _of("transcription"),
    "estimation": _of("estimation"),
    "control": _of("control"),
    "logging": _of("logging"),
    "levels": _of("levels"),
    "edges-propagation": _of("edges_propagation"),
    "edges-seeds": _of("edges_seeds"),
    "edges-walks": _of("edges_walks"),
    "edges-references": _of("edges_references"),
    "edges-control": _of("edges_control"),
    "edges-moving": _of("edges_control", "moving_chart"),
    "edges-ogy": _of("edges_ogy"),
    "edges-estimation": _of("edges_estimation"),
}
GROUPS = {"edges": tuple(name for name in CHARTS if name.startswith("edges-"))}
"""Names that stand for several charts."""


def check_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the charts to draw, each once: those named, or all.

    Raises:
        InputError: an unknown name.
    """
    chosen: list[str] = []
    for name in names:
        if name not in CHARTS and name not in GROUPS:
            raise InputError(f"there is no chart {name!r}; choose from {', '.join((*CHARTS, *GROUPS))}")
        chosen += GROUPS.get(name, (name,))
    return tuple(dict.fromkeys(chosen)) or tuple(CHARTS)
