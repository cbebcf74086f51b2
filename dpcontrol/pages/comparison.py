"""Several runs on one clock, on a page and as a Rerun recording."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.comparison import ComparedRun, RunComparison
from dpcontrol.pages import rerun_recording, style
from dpcontrol.pages.chart import Chart, Line
from dpcontrol.pages.charts import draw_chart, draw_plane
from dpcontrol.pages.filmstrip import draw_film, film_height, film_times
from dpcontrol.pages.layout import Page, Stack
from dpcontrol.pages.planes import plane
from dpcontrol.pages.rerun_recording import rrb
from dpcontrol.pages.series import charts
from dpcontrol.pages.story import story, story_height
from dpcontrol.pages.strips import strips


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
    """Return one chart of all runs from those of their lines whose keys start with `prefix`.

    Of several such lines, such as errors of several arms, the one with the largest size is used.
    """
    lines: list[Line] = []
    for k, (run, own) in enumerate(zip(comparison.runs, every, strict=True)):
        shown = [line for line in own.lines if line.key.startswith(prefix)] if own else []
        lines += [replace(line, key="0_reference", name=f"reference of {run.name}", label="the first's reference",
                          colour=style.REFERENCE) for line in shown if line.role == "reference" and k == 0]  # fmt: skip
        parts = [line for line in shown if line.role == "run"]
        if parts:
            values = parts[0].values if len(parts) == 1 else np.max([np.abs(line.values) for line in parts], axis=0)
            place = f"{k + 1}_{_plain(run.name)}"
            lines.append(Line(place, run.name, "", parts[0].time, values, style.RUNS[k], dashed=k > 0))
    known = next((own for own in every if own), None)
    if known is None:
        return None
    legend = key == "angle_1"
    return replace(
        known,
        key=key,
        title=title,
        note="",
        hint=", reference grey" if legend else "",
        lines=tuple(lines),
        levels=tuple(level for level in known.levels if level.kind == "limit" or key == "energy"),
        cut=(),
        shown=None,
        log=False,
        legend=legend,
    )


def _plain(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9]+", "_", name)


def _home(k: int, run: ComparedRun) -> str:
    """Return the path of a run's strips in a recording."""
    return f"{k + 1}_{_plain(run.name)}"


_FRAMES = 8
_PANEL = 1.75
"""Height of a row of panels, inches."""
_FILMED = 3
"""Greatest number of runs with films."""


def draw_comparison(comparison: RunComparison) -> Figure:
    """Return the page of a comparison as a figure."""
    runs = comparison.runs
    page = Page(comparison.title, comparison.status)
    frames = _frames(comparison)
    for run, colour in zip(runs, style.RUNS, strict=False):
        page.text(run.name, colour=colour, size=style.HEAD)
        page.text(run.view.verdict, colour=style.verdict_colour(run.view.good), size=style.TEXT)
        height = story_height(run.view, span=comparison.span)
        if height:
            page.strip(partial(story, view=run.view, span=comparison.span), height=height)
        if len(runs) <= _FILMED:
            height = film_height(run.view, frames, width=style.WIDTH)
            page.strip(partial(draw_film, view=run.view, times=frames), height=height)
    charts = compared_charts(comparison)
    half = (len(charts) + 1) // 2
    columns = [
        Stack([partial(_draw, chart=chart, comparison=comparison) for chart in some])
        for some in (charts[:half], charts[half:])
    ]
    planes = [partial(_draw_plane, comparison=comparison, arm=arm) for arm in range(min(runs[0].view.arms, 2))]
    return page.row(*columns, Stack(planes), height=_PANEL * max(half, 3)).figure()


def _draw(axes: Axes, chart: Chart, comparison: RunComparison) -> None:
    draw_chart(axes, chart, comparison.runs[0].view, span=comparison.span)
    axes.axvline(comparison.moment, color=style.INK, linewidth=1.0, linestyle=style.DOTTED)


def _draw_plane(axes: Axes, comparison: RunComparison, arm: int) -> None:
    planes = [(plane(run.view, arm), style.RUNS[k]) for k, run in enumerate(comparison.runs)]
    draw_plane(axes, planes, tubes=False)


def _frames(comparison: RunComparison) -> Array:
    """Return the times of all films, about the symbols.

    If the first run ends early, half of them lie before its end.

    The longest run supplies the symbol times.
    """
    longest = max((run.view for run in comparison.runs), key=lambda view: view.time_range[1])
    begin, end = min((run.view.time_range for run in comparison.runs), key=lambda span: span[1])
    chosen = film_times(longest, frames=_FRAMES)
    if (chosen <= end).mean() >= 0.5:
        return chosen
    half = _FRAMES // 2
    later = film_times(longest, frames=_FRAMES - half)
    return np.sort(np.concatenate([np.linspace(begin, end, half + 1)[1:], later]))


def write_comparison_recording(comparison: RunComparison, path: Path) -> None:
    """Write the recording of a comparison to `path` (`*.rrd`).

    Raises:
        InputError: it cannot be written.
    """
    runs = comparison.runs
    # The box of each arm holds all runs.
    boxes = [rerun_recording.bounds(*(plane(run.view, arm) for run in runs)) for arm in range(runs[0].view.arms)]
    compared = compared_charts(comparison)
    rows = [f"**{comparison.title}**", "", comparison.status, ""]
    rows += [f"{k + 1}. **{run.name}**: {run.view.verdict}" for k, run in enumerate(runs)]
    blueprint = _blueprint(comparison, compared, boxes)
    with rerun_recording.recording_to(path, comparison.title, blueprint, "\n".join(rows)) as recording:
        for k, run in enumerate(runs):
            rerun_recording.draw_pendulum(recording, f"runs/{k + 1}/scene", run.view)
            rerun_recording.record_planes(recording, f"runs/{k + 1}/planes", run.view, boxes=boxes)
            shown = [s for s in strips(run.view, until=comparison.span[1]) if s.key in ("asked", "done")]
            rerun_recording.record_strips(recording, _home(k, run), shown, run.view)
        for chart in compared:
            rerun_recording.record_chart(recording, "plots", chart, runs[0].view)


def _blueprint(comparison: RunComparison, charts: Sequence[Chart], boxes: list[rerun_recording.Box]) -> rrb.Blueprint:
    runs = comparison.runs
    scenes = [
        rerun_recording.scene_view(run.view, from_log=False, home=f"/runs/{k + 1}/scene", name=run.name)
        for k, run in enumerate(runs)
    ]
    planes = [
        rerun_recording.plane_view(
            arm,
            f"/runs/{k + 1}/planes",
            boxes[arm],
            name=f"{run.name}: arm {arm + 1}, rate over angle",
            free=0.2,
        )
        for arm in range(min(runs[0].view.arms, 2))
        for k, run in enumerate(runs)
    ]
    middle = rerun_recording.plots([c for c in charts if c.key in ("angle_1", "angle_2", "cart")])
    checks = rerun_recording.plots([c for c in charts if c.key in ("tracking_error", "acceleration", "energy", "nis")])
    if any(run.view.plan.planned for run in runs):
        name = f"Itineraries, aligned at symbol {comparison.symbol}"
        contents = [f"+ /{_home(k, run)}/**" for k, run in enumerate(runs)]
        middle.insert(0, rrb.StateTimelineView(name=name, contents=contents))
    beside = rrb.Grid(*planes, grid_columns=len(runs))
    left = rrb.Vertical(rrb.Horizontal(*scenes), beside, rerun_recording.summary_view(), row_shares=[3, 4, 1.6])
    return rerun_recording.page([left, *(rrb.Vertical(*views) for views in (middle, checks) if views)], [5, 4, 4])
