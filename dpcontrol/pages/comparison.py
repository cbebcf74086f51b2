"""Several runs on one clock, as a page and as a Rerun recording.

The page shows charts over the common clock, phase planes, and the arms at the same instants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.judge.comparison import ComparedRun, RunComparison
from dpcontrol.pages import rerun_recording as recorded
from dpcontrol.pages import style
from dpcontrol.pages.charts import draw_chart, draw_plane
from dpcontrol.pages.film import add_film, film_times
from dpcontrol.pages.layout import Page, Stack
from dpcontrol.pages.panels import quiet
from dpcontrol.pages.planes import plane
from dpcontrol.pages.rerun_recording import Sheet, rrb
from dpcontrol.pages.run_charts import Chart, Line
from dpcontrol.pages.run_charts import charts as charts_of
from dpcontrol.pages.story import story, story_height, strips

_FRAMES = 8
_PANEL = 1.75
"""Height of a row of panels, inches."""
_FILMED = 3
"""Greatest number of runs with films."""


def draw_comparison(comparison: RunComparison) -> Figure:
    """Return the page of a comparison as a figure."""
    runs = comparison.runs
    page = Page(comparison.title, comparison.status)
    # All films have the times of the run that ends first.
    frames = film_times(min((run.view for run in runs), key=lambda view: view.time_range[1]), frames=_FRAMES)
    for run, colour in zip(runs, style.RUNS, strict=False):
        page.text(run.name, colour=colour, size=style.HEAD)
        page.text(run.view.verdict, colour=style.verdict_colour(run.view.good), size=style.TEXT)
        height = story_height(run.view, span=comparison.span)
        if height:
            page.row(partial(story, view=run.view, span=comparison.span), height=height)
        if len(runs) <= _FILMED:
            add_film(page, run.view, frames)
    charts = compared_charts(comparison)
    half = (len(charts) + 1) // 2
    columns = [
        Stack([partial(_draw, chart=chart, comparison=comparison) for chart in some])
        for some in (charts[:half], charts[half:])
    ]
    planes = [
        partial(draw_plane, runs=[(plane(run.view, arm), style.RUNS[k]) for k, run in enumerate(runs)], tubes=False)
        for arm in range(min(runs[0].view.arms, 2))
    ]
    return page.row(*columns, Stack(planes), height=_PANEL * max(half, 3)).figure()


def _draw(axes: Axes, chart: Chart, comparison: RunComparison) -> None:
    draw_chart(axes, chart, comparison.runs[0].view, span=comparison.span)
    axes.axvline(comparison.moment, color=style.INK, linewidth=1.0, linestyle=style.DOTTED)


def compared_charts(comparison: RunComparison) -> tuple[Chart, ...]:
    """Return the common charts with a line for each run.

    The first run's reference and levels are included.
    """
    first = comparison.runs[0].view
    every = [charts_of(run.view) for run in comparison.runs]
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
        lines += [
            replace(
                line,
                key="0_reference",
                name=f"reference of {run.name}",
                label="the first's reference",
                colour=style.REFERENCE,
            )
            for line in shown
            if line.role == "reference" and k == 0
        ]
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


def write_comparison_recording(comparison: RunComparison, path: Path) -> None:
    """Write the recording of a comparison to `path` (`*.rrd`).

    Args:
        comparison: runs to write.
        path: file, `*.rrd`.

    Raises:
        InputError: it cannot be written.
    """
    runs, charts = comparison.runs, compared_charts(comparison)
    # The sheet of each arm holds all runs.
    sheets = [recorded.phase_plane(*(plane(run.view, arm) for run in runs)) for arm in range(runs[0].view.arms)]
    rows = [f"**{comparison.title}**", "", comparison.status, ""]
    rows += [f"{k + 1}. **{run.name}**: {run.view.verdict}" for k, run in enumerate(runs)]
    blueprint = _blueprint(comparison, charts, sheets)
    with recorded.recording_to(path, comparison.title, blueprint, "\n".join(rows)) as recording:
        for k, run in enumerate(runs):
            recorded.draw_pendulum(recording, f"runs/{k + 1}/scene", run.view)
            recorded.record_planes(recording, f"runs/{k + 1}/planes", run.view, sheets)
            shown = [s for s in strips(run.view, until=comparison.span[1]) if s.key in ("asked", "done")]
            recorded.record_strips(recording, run_path(k, run), shown, run.view)
        for chart in charts:
            recorded.record_chart(recording, chart, runs[0].view)


def _blueprint(comparison: RunComparison, charts: Sequence[Chart], sheets: Sequence[Sheet]) -> rrb.Blueprint:
    runs = comparison.runs
    scenes = [recorded.scene_view(run.view, home=f"/runs/{k + 1}/scene", name=run.name) for k, run in enumerate(runs)]
    planes = [
        sheet.view(f"/runs/{k + 1}/planes/arm_{arm + 1}", name=f"{run.name}: arm {arm + 1}, rate over angle")
        for arm, sheet in enumerate(sheets[:2])
        for k, run in enumerate(runs)
    ]
    middle = recorded.plots([c for c in charts if c.key in ("angle_1", "angle_2", "cart")])
    checks = recorded.plots([c for c in charts if c.key in ("tracking_error", "acceleration", "energy", "nis")])
    if any(run.view.plan.planned for run in runs):
        name = f"Itineraries, aligned at symbol {comparison.symbol}"
        contents = [f"+ /{run_path(k, run)}/**" for k, run in enumerate(runs)]
        middle.insert(0, rrb.StateTimelineView(name=name, contents=contents))
    grid = rrb.Grid(*planes, grid_columns=len(runs))
    left = rrb.Vertical(rrb.Horizontal(*scenes), grid, recorded.summary_view(), row_shares=[3, 4, 1.6])
    return recorded.page([left, *(rrb.Vertical(*views) for views in (middle, checks) if views)], [5, 4, 4])


def comparison(axes: Axes, found: RunComparison) -> None:
    """Draw the angles of all runs on one clock.

    Args:
        axes: panel to draw on.
        found: runs to draw.
    """
    for run in found.runs:
        for arm in range(run.view.arms):
            axes.plot(run.view.time, run.view.state[:, arm], color=style.arm_colour(arm), linewidth=0.9)
    quiet(axes, found.title, x="time (s)", y="angles (rad)")
