"""Several runs on one clock, on a page and as a Rerun recording."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.comparison import ComparedRun, RunComparison
from dpcontrol.pages import rerun_recording, style
from dpcontrol.pages.page import (
    draw_chart,
    draw_film,
    draw_plane,
    film_times,
    mark_times,
    new_figure,
    story,
    story_rows,
)
from dpcontrol.pages.rerun_recording import rrb
from dpcontrol.pages.series import Chart, Line, charts, plane, strips


def compared_charts(comparison: RunComparison) -> tuple[Chart, ...]:
    """Return the common charts with a line for each run.

    The first run's reference and levels are included.
    """
    first = comparison.runs[0].view
    every = [charts(run.view) for run in comparison.runs]
    track = f", track ±{1000 * first.limits[0]:g}" if first.limits else ""
    wanted = [
        ("angles", f"angle_{arm + 1}", f"Arm {arm + 1}'s angle θ{style.number(arm)} (rad)", f"arm_{arm + 1}/")
        for arm in range(first.arms)
    ]
    wanted += [
        ("cart", "cart", f"Cart position (mm){track}", ""),
        ("tracking_error", "tracking_error", "Tracking error: largest of the angles (rad)", ""),
        ("acceleration", "acceleration", "Acceleration applied (m/s²)", "applied"),
        ("energy", "energy", "Energy of the pendulum (J)", ""),
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
        named=title.replace("(mm)", "(m)").split(", track")[0] + (", reference grey" if legend else ""),
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


_WIDE = 16.0
_FRAMES = 8
_STORY, _FILM, _PANEL, _HEAD = 0.95, 1.75, 1.75, 0.95
"""Heights in inches: of a run's story and film, of a row of panels, and of the title."""
_FILMED = 3
"""Greatest number of runs with films."""


def draw_comparison(comparison: RunComparison) -> Figure:
    """Return the page of a comparison as a figure."""
    runs = comparison.runs
    filmed = _FILM if len(runs) <= _FILMED else 0.0
    tall = _HEAD + len(runs) * (_STORY + filmed + 0.35) + 4 * (_PANEL + 0.5) + 0.35
    figure = new_figure(_WIDE, tall)

    def write(text: str, x: float, y: float, most: int, **look: Any) -> None:
        figure.text(x, y / tall, shorten(text, most, placeholder=" …"), va="center", **look)

    write(comparison.title, 0.022, tall - 0.35, 100, fontsize=16, weight="bold", color=style.INK)
    write(comparison.status, 0.022, tall - 0.68, 190, fontsize=9, color=style.NOTE)
    top = tall - _HEAD
    frames = _frames(comparison)
    for run, colour in zip(runs, style.RUNS, strict=False):
        write(run.name, 0.022, top - 0.12, 100, fontsize=11, weight="bold", color=colour)
        write(run.view.verdict, 0.165, top - 0.12, 150, fontsize=9.5, color=style.verdict_colour(run.view.good))
        if story_rows(run.view, span=comparison.span):
            height = _STORY - 0.5
            axes = figure.add_axes((0.062, (top - 0.42 - height) / tall, 0.925, height / tall))
            story(axes, run.view, span=comparison.span, legend=False)
        top -= _STORY + 0.2
        if filmed:
            axes = figure.add_axes((0.01, (top - filmed) / tall, 0.98, (filmed - 0.05) / tall))
            draw_film(axes, run.view, frames)
            axes.set_aspect("equal")
            top -= filmed
        top -= 0.15
    _panels(figure, comparison, top=top - 0.1, tall=tall)
    return figure


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


def _panels(figure: Figure, comparison: RunComparison, *, top: float, tall: float) -> None:
    arms = min(comparison.runs[0].view.arms, 2)
    shown = [chart for chart in compared_charts(comparison) if chart.key not in ("angle_3", "angle_4", "angle_5")]
    rows = (len(shown) + 1) // 2
    room = (top - 0.35) / rows
    for k, chart in enumerate(shown):
        row, column = k % rows, k // rows
        height = room - 0.5
        axes = figure.add_axes(((0.045, 0.372)[column], (top - row * room - room + 0.5) / tall, 0.285, height / tall))
        draw_chart(axes, chart, comparison.runs[0].view)
        mark_times(axes, [comparison.moment])
        axes.set_xlim(*comparison.span)
        if row == rows - 1 or k == len(shown) - 1:
            axes.set_xlabel("time on the common clock (s)")
    half = (top - 0.35) / arms
    for arm in range(arms):
        bottom = top - (arm + 1) * half + 0.5
        axes = figure.add_axes((0.70, bottom / tall, 0.28, (half - 0.5) / tall))
        planes = [(plane(run.view, arm), style.RUNS[k]) for k, run in enumerate(comparison.runs)]
        draw_plane(axes, planes, tubes=False)


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
