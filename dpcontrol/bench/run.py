"""Draw charts: each to NAME.png, and to NAME.json with its points, machine, versions and commit."""

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dpcontrol.bench.machine import machine, versions
from dpcontrol.bench.measure import one_core
from dpcontrol.bench.page import Page
from dpcontrol.bench.registry import CHARTS, check_names
from dpcontrol.foundation.checkout import commit
from dpcontrol.foundation.files import Progress, no_progress, part_of, whole_file, write_whole


@dataclass(frozen=True)
class Drawn:
    """A chart that was made, its files, and the seconds that it took."""

    chart: Page
    picture: Path
    data: Path
    seconds: float


def draw_charts(
    names: Sequence[str], folder: Path, *, quick: bool = False, progress: Progress = no_progress
) -> tuple[Drawn, ...]:
    """Make charts (all where `names` is empty) one after the other in this process, on one core.

    Raises:
        InputError: an unknown name, or a folder that cannot be written to.
    """
    chosen = check_names(tuple(names))
    # Asked before the work, so that a checkout that is edited meanwhile does not mislead.
    made_with = {"quick": quick, "machine": machine(), "versions": versions(), "commit": commit()}
    drawn = []
    for k, name in enumerate(chosen):
        progress(name, k / len(chosen))
        began = time.perf_counter()
        with one_core():
            chart = CHARTS[name](quick, part_of(progress, k / len(chosen), (k + 1) / len(chosen)))
        seconds = time.perf_counter() - began
        picture, data = save(chart, folder, made_with=made_with, seconds=seconds)
        drawn.append(Drawn(chart, picture, data, seconds))
    return tuple(drawn)


def save(chart: Page, folder: Path, *, made_with: Mapping[str, Any], seconds: float) -> tuple[Path, Path]:
    """Write a chart's picture and data to `folder`; return their paths."""
    picture, data = Path(folder) / f"{chart.name}.png", Path(folder) / f"{chart.name}.json"
    with whole_file(picture, suffix=".png") as temporary:
        chart.figure().savefig(temporary, format="png")
    document = {**chart.document(), "seconds": seconds, **made_with}
    write_whole(data, json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    return picture, data
