"""Charts of several runs on one clock, one colour for each run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dpcontrol.judge.comparison import ComparedRun, RunComparison
from dpcontrol.pages import style
from dpcontrol.pages.chart import Chart, Line
from dpcontrol.pages.run_charts import charts


def compared_charts(comparison: RunComparison) -> tuple[Chart, ...]:
    """Return the common charts with a line for each run.

    The first run's reference and levels are included.
    """
    first = comparison.runs[0].view
    every = [charts(run.view) for run in comparison.runs]
    wanted = [
        ("angles", f"angle_{arm + 1}", f"Arm {arm + 1}'s angle θ{style.number(arm)}", f"arm_{arm + 1}/")
        for arm in range(min(first.arms, 2))
    ]
    wanted += [
        ("cart", "cart", "Cart position", ""),
        ("tracking_error", "tracking_error", "Tracking error, largest of the angles", ""),
        ("acceleration", "acceleration", "Acceleration applied", "applied"),
        ("energy", "energy", "Energy of the pendulum", ""),
        ("nis", "nis", "NIS, means of 50 updates", ""),
    ]
    found = [_chart(comparison, [own.get(source) for own in every], *rest) for source, *rest in wanted]
    return tuple(chart for chart in found if chart is not None and chart.lines)


def _chart(comparison: RunComparison, every: list[Chart | None], key: str, title: str, prefix: str) -> Chart | None:
    """Return one chart of all runs.

    The chart has those of their lines whose keys start with `prefix`. Several such lines of a run, such as errors
    of several arms, are replaced by their largest size at each time.
    """
    lines: list[Line] = []
    for k, (run, own) in enumerate(zip(comparison.runs, every, strict=True)):
        shown = [line for line in own.lines if line.key.startswith(prefix)] if own else []
        lines += [replace(line, key="0_reference", name=f"reference of {run.name}", label="the first's reference",
                          colour=style.REFERENCE) for line in shown if line.role == "reference" and k == 0]  # fmt: skip
        parts = [line for line in shown if line.role == "run"]
        if parts:
            values = parts[0].values if len(parts) == 1 else np.max([np.abs(line.values) for line in parts], axis=0)
            lines.append(Line(run_path(k, run), run.name, "", parts[0].time, values, style.RUNS[k], dashed=k > 0))
    known = next((own for own in every if own), None)
    if known is None:
        return None
    return replace(
        known,
        key=key,
        title=title,
        note="",
        lines=tuple(lines),
        levels=tuple(level for level in known.levels if level.kind == "limit" or key == "energy"),
        cut=(),
        shown=None,
        log=False,
    )


def run_path(k: int, run: ComparedRun) -> str:
    """Return the path of a run in a recording.

    Args:
        k: index of the run, from 0.
        run: run of the comparison.
    """
    return f"{k + 1}_{'_'.join(''.join(c if c.isascii() and c.isalnum() else ' ' for c in run.name).split())}"
