"""Motions on one page or in one recording: a single one from its story (`run_charts`), or several runs on one clock.

A motion is a run, a recording, a reference or an orbit.

The top of a single motion's page shows the verdict, the closest approach to failing, the filter, and the largest values
against their limits. Below are the itinerary as planned and done, and a film of the arms. Phase planes and charts over
time follow. The page of several runs has these at the same instants.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dpcontrol.control.margins import Margins
from dpcontrol.foundation.document import Documented
from dpcontrol.judge.comparison import ComparedRun, RunComparison
from dpcontrol.judge.nearest import closest_approach, limit_uses, nis_reading
from dpcontrol.judge.of_log import reference_view, run_view, sustained_view
from dpcontrol.judge.run_view import RunView, series_of
from dpcontrol.logs import RunLog
from dpcontrol.pages import rerun_recording as recorded, style
from dpcontrol.pages.charts import draw_chart, draw_plane
from dpcontrol.pages.film import add_film, film_times
from dpcontrol.pages.layout import Draw, Page, Stack
from dpcontrol.pages.panels import Bar, bars
from dpcontrol.pages.planes import plane
from dpcontrol.pages.rerun_recording import Sheet, rrb
from dpcontrol.pages.run_charts import Chart, Line, charts, check_charts, extra_charts, motion_charts
from dpcontrol.pages.story import add_story, strips
from dpcontrol.pages.walks import WalkStory, draw_shape
from dpcontrol.plans.plan import Plan
from dpcontrol.references.sustained import SustainedOrbit
from dpcontrol.references.trajectory import LimitUse
from dpcontrol.walks.shadowing import ShadowingOrbit
from dpcontrol.words.runs import conditions_of

_FRAMES = 8
_TALL = 1.5
"""Height of a chart, inches."""
_AROUND, _USE = 0.5, 0.2
"""Heights of the frame of the bars of limits and of a bar, inches."""
_NEAR, _FULL = 0.9, 1.05
"""Share of a limit from which on its bar is red, and the longest bar."""


@dataclass(frozen=True, eq=False)
class Report(Documented):
    """A page on a log, a long run or a campaign.

    Attributes:
        result: `Score` or `Unscored` of a log, `Night` of a long run, or `CampaignSummary`.
        page: file of the page.
        margins: margins of gain, delay and lag along the reference of a log, if requested.
    """

    KEYS: ClassVar[str] = "**result.document margins? picture=page"

    result: Any
    page: Path
    margins: Margins | None = None


def draw(motion: RunView | RunLog | Plan) -> Figure:
    """Return the page of a motion as a figure: verdict, limits, story, film, phase planes and charts over time.

    Args:
        motion: motion to draw.
    """
    view: RunView = view_of(motion)
    page = Page(view.title, view.verdict, view.good).origin(view.path, *conditions_of(view.metadata))
    for sentence in (closest_approach(view), nis_reading(view)):
        page.text(sentence, colour=style.INK, size=style.TEXT)
    if uses := limit_uses(view):
        page.row(partial(_uses, uses=uses), height=_AROUND + _USE * len(uses))
    add_story(page, view)
    if view.arm_lengths:
        add_film(page, view, film_times(view, frames=_FRAMES))
    charts_of_motion = [*motion_charts(view), *check_charts(view), *extra_charts(view)]
    planes = [partial(draw_plane, runs=[(plane(view, arm), style.PLANT)]) for arm in range(min(view.arms, 2))]
    _add_charts(page, charts_of_motion, partial(draw_chart, view=view, span=view.time_range), planes)
    return page.figure()


def _uses(axes: Axes, uses: Sequence[LimitUse]) -> None:
    """Draw the largest values as shares of their limits, red if they are near their limit.

    Args:
        axes: panel to draw on.
        uses: largest values, the one with the largest share first.
    """
    rows = [
        Bar(use.name, min(use.share, _FULL), style.LIMIT if use.share > _NEAR else style.CART, note=use.sentence)
        for use in uses
    ]
    bars(axes, "Largest values, as shares of their limits", rows)
    axes.axvline(1.0, color=style.LIMIT, linewidth=1.1, linestyle=style.DASHED, zorder=0.5)
    axes.set(xlim=(0, _FULL), xticks=[0, 0.25, 0.5, 0.75, 1.0])
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))


def _add_charts(page: Page, charts: Sequence[Chart], drawn: Callable[..., None], planes: Sequence[Draw]) -> None:
    """Add a row of charts in two columns beside the phase planes; only the last chart of a column has a time axis.

    Args:
        page: page to extend.
        charts: charts over time.
        drawn: function that draws the chart `chart` on axes.
        planes: functions that draw the phase planes.
    """
    half = (len(charts) + 1) // 2
    columns = [
        Stack([partial(_chart, chart=chart, drawn=drawn, last=chart is column[-1]) for chart in column], share=1.05)
        for column in (charts[:half], charts[half:])
        if column
    ]
    page.row(*columns, Stack(planes), height=_TALL * max(half, 3))


def _chart(axes: Axes, chart: Chart, drawn: Callable[..., None], *, last: bool) -> None:
    """Draw a chart of a column with `drawn`; charts above the last one share the last one's time axis."""
    drawn(axes, chart)
    if not last:
        axes.set_xlabel("")
        axes.tick_params(labelbottom=False)


def view_of(result: Any) -> Any:
    """Return the motion of a result as a `RunView`, which pages and films draw, or the object itself if it has none.

    Args:
        result: run, plan, log, sustained orbit or walk, for example; a `RunView` is returned unchanged.
    """
    # A run is drawn from its log.
    result = getattr(result, "log", result)
    match result:
        case Plan():
            return reference_view(result.reference, result.file)
        case SustainedOrbit():
            return sustained_view(result, result.arms.length)
        case ShadowingOrbit():
            return WalkStory(result).view
        case RunLog():
            return run_view(result) if "reference.npz" in result.attachments else series_of(result)
        case _:
            return result


def angles(axes: Axes, motion: Plan | RunLog | SustainedOrbit | ShadowingOrbit) -> None:
    """Draw the angles of a plan, a log, a sustained orbit or a walk over time, or a walk without angles in the plane.

    Args:
        axes: panel to draw on.
        motion: motion to draw.
    """
    if isinstance(motion, ShadowingOrbit) and not WalkStory(motion).has_angles:
        draw_shape(axes, WalkStory(motion))
        return
    view = view_of(motion)
    draw_chart(axes, charts(view)["angles"], view)


_FILMED = 2
"""Greatest number of runs with films: a page with three films does not fit on A3."""


def draw_comparison(comparison: RunComparison) -> Figure:
    """Return the page of several runs on one clock, on which a symbol's crossing has the same time in all.

    Each run has its verdict and story, two runs also have films. Charts and phase planes show all runs together.
    """
    runs = comparison.runs
    page = Page(comparison.title, comparison.status)
    # All films have the times of the run that ends first.
    frames = film_times(min((run.view for run in runs), key=lambda view: view.time_range[1]), frames=_FRAMES)
    for run, colour in zip(runs, style.RUNS, strict=False):
        page.text(run.name, colour=colour, size=style.HEAD)
        page.text(run.view.verdict, colour=style.verdict_colour(run.view.good), size=style.TEXT)
        page.origin(run.view.path, *conditions_of(run.view.metadata))
        add_story(page, run.view, span=comparison.span)
        if len(runs) <= _FILMED:
            add_film(page, run.view, frames)
    planes = [
        partial(draw_plane, runs=[(plane(run.view, arm), style.RUNS[k]) for k, run in enumerate(runs)], tubes=False)
        for arm in range(min(runs[0].view.arms, 2))
    ]
    _add_charts(page, compared_charts(comparison), partial(_draw_compared, comparison=comparison), planes)
    return page.figure()


def _draw_compared(axes: Axes, chart: Chart, comparison: RunComparison) -> None:
    """Draw a chart of several runs on one clock, with a dotted line at the moment at which the runs are aligned."""
    draw_chart(axes, chart, comparison.runs[0].view, span=comparison.span)
    axes.axvline(comparison.moment, color=style.INK, linewidth=1.0, linestyle=style.DOTTED)


def compared_charts(comparison: RunComparison) -> tuple[Chart, ...]:
    """Return the charts of a comparison, with a line for each run, and reference and levels of the first run.

    Charts without lines are left out.
    """
    # Each quantity: the chart that has it, key and title of the new chart, and the beginning of its lines' keys.
    charts_of_runs = [charts(run.view) for run in comparison.runs]
    quantities = [
        ("angles", f"angle_{arm + 1}", f"Arm {arm + 1}'s angle θ{style.number(arm)}", f"arm_{arm + 1}/")
        for arm in range(min(comparison.runs[0].view.arms, 2))
    ] + [
        ("cart", "cart", "Cart position", ""),
        ("tracking_error", "tracking_error", "Tracking error, largest of the angles", ""),
        ("acceleration", "acceleration", "Acceleration applied", "applied"),
        ("energy", "energy", "Energy of the pendulum", ""),
        ("nis", "nis", "NIS, means of 50 updates", ""),
    ]
    compared = [
        _compared_chart(comparison, [charts_of_run.get(source) for charts_of_run in charts_of_runs], *attributes)
        for source, *attributes in quantities
    ]
    return tuple(chart for chart in compared if chart is not None and chart.lines)


def _compared_chart(
    comparison: RunComparison, every: list[Chart | None], key: str, title: str, prefix: str
) -> Chart | None:
    """Return one chart of all runs with those of their lines whose keys start with `prefix`.

    Several of these lines of a run, such as errors of several arms, are replaced by their largest size at each time.
    Of the levels, the limits are kept, and those of the energy. If no run has such a chart, the result is None.

    Args:
        comparison: compared runs.
        every: chart of each run, or None for a run without such a chart.
        key: path of the new chart in a recording.
        title: title of the new chart.
        prefix: beginning of the keys of lines.
    """
    first_lines = every[0].lines if every[0] else ()
    names = {"key": "0_reference", "name": f"reference of {comparison.runs[0].name}", "label": "the first's reference"}
    lines = [
        replace(line, colour=style.REFERENCE, **names)
        for line in first_lines
        if line.role == "reference" and line.key.startswith(prefix)
    ]
    for k, (run, run_chart) in enumerate(zip(comparison.runs, every, strict=True)):
        matching = [line for line in run_chart.lines if line.key.startswith(prefix)] if run_chart else []
        run_lines = [line for line in matching if line.role == "run"]
        if run_lines:
            values = (
                run_lines[0].values
                if len(run_lines) == 1
                else np.max([np.abs(line.values) for line in run_lines], axis=0)
            )
            lines.append(Line(run_path(k, run), run.name, "", run_lines[0].time, values, style.RUNS[k], dashed=k > 0))
    first_chart = next((run_chart for run_chart in every if run_chart), None)
    if first_chart is None:
        return None
    return replace(
        first_chart,
        key=key,
        title=title,
        note="",
        lines=tuple(lines),
        levels=tuple(level for level in first_chart.levels if level.kind == "limit" or key == "energy"),
        shown=None,
        log=False,
    )


def run_path(k: int, run: ComparedRun) -> str:
    """Return the path of a run in a recording, whose number keeps the runs in order in the viewer.

    Args:
        k: index of the run, from 0.
        run: run of the comparison.
    """
    return f"{k + 1}_{'_'.join(''.join(c if c.isascii() and c.isalnum() else ' ' for c in run.name).split())}"


def write_comparison_recording(comparison: RunComparison, path: Path) -> None:
    """Write the comparison of several runs as a recording for the Rerun viewer, with all runs in the same charts.

    Args:
        comparison: runs to write.
        path: file, `*.rrd`.

    Raises:
        InputError: it cannot be written.
    """
    runs, compared = comparison.runs, compared_charts(comparison)
    # The sheet of each arm holds all runs.
    sheets = [Sheet.around(*(plane(run.view, arm) for run in runs)) for arm in range(runs[0].view.arms)]
    verdicts = [f"{k + 1}. **{run.name}**: {run.view.verdict}" for k, run in enumerate(runs)]
    summary = "\n".join([f"**{comparison.title}**", "", comparison.status, "", *verdicts])
    with recorded.recording_to(path, comparison.title, _blueprint(comparison, compared, sheets), summary) as recording:
        for k, run in enumerate(runs):
            recorded.draw_pendulum(recording, f"runs/{k + 1}/scene", run.view)
            recorded.record_planes(recording, f"runs/{k + 1}/planes", run.view, sheets)
            itinerary_strips = [
                strip for strip in strips(run.view, until=comparison.span[1]) if strip.key in ("asked", "done")
            ]
            recorded.record_strips(recording, run_path(k, run), itinerary_strips, run.view)
        for chart in compared:
            recorded.record_chart(recording, chart, runs[0].view)


def _blueprint(comparison: RunComparison, charts: Sequence[Chart], sheets: Sequence[Sheet]) -> rrb.Blueprint:
    """Return the layout of the recording of a comparison in the viewer.

    Args:
        comparison: compared runs.
        charts: charts of all runs.
        sheets: phase plane of each arm.
    """
    runs = comparison.runs
    scenes = [recorded.scene_view(run.view, home=f"/runs/{k + 1}/scene", name=run.name) for k, run in enumerate(runs)]
    planes = [
        sheet.view(f"/runs/{k + 1}/planes/arm_{arm + 1}", name=f"{run.name}: arm {arm + 1}, rate over angle")
        for arm, sheet in enumerate(sheets[:2])
        for k, run in enumerate(runs)
    ]
    middle = recorded.plots([chart for chart in charts if chart.key in ("angle_1", "angle_2", "cart")])
    checks = recorded.plots(
        [chart for chart in charts if chart.key in ("tracking_error", "acceleration", "energy", "nis")]
    )
    if any(run.view.plan.planned for run in runs):
        name = f"Itineraries, aligned at symbol {comparison.symbol}"
        contents = [f"+ /{run_path(k, run)}/**" for k, run in enumerate(runs)]
        middle.insert(0, rrb.StateTimelineView(name=name, contents=contents))
    grid = rrb.Grid(*planes, grid_columns=len(runs))
    left = rrb.Vertical(rrb.Horizontal(*scenes), grid, recorded.summary_view(), row_shares=[3, 4, 1.6])
    return recorded.page([left, *(rrb.Vertical(*views) for views in (middle, checks) if views)], [5, 4, 4])


def comparison(axes: Axes, compared: RunComparison) -> None:
    """Draw the inner arm's angle of all runs on one clock.

    Args:
        axes: panel to draw on.
        compared: runs to draw.
    """
    _draw_compared(axes, compared_charts(compared)[0], compared)
