"""A motion on one page, drawn by matplotlib from its story (`run_charts`).

The motion is a run, a recording, a reference or an orbit.

The top shows the verdict, the closest approach to failing, the filter, and the largest values against their limits.
Below are the itinerary as planned and done, and a film of the arms. Phase planes and charts over time follow.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dpcontrol.control.margins import Margins
from dpcontrol.foundation.document import Documented
from dpcontrol.judge.nearest import closest_approach, limit_uses, nis_reading
from dpcontrol.judge.of_log import reference_view, run_view, sustained_view
from dpcontrol.judge.run_view import RunView, series_of
from dpcontrol.logs import RunLog
from dpcontrol.pages import style
from dpcontrol.pages.charts import draw_chart, draw_plane
from dpcontrol.pages.film import add_film, film_times
from dpcontrol.pages.layout import Page, Stack
from dpcontrol.pages.panels import Bar, bars
from dpcontrol.pages.planes import plane
from dpcontrol.pages.run_charts import Chart, charts, check_charts, extra_charts, motion_charts
from dpcontrol.pages.story import story, story_height
from dpcontrol.pages.walks import WalkStory, draw_shape
from dpcontrol.plans.plan import Plan
from dpcontrol.references.sustained import SustainedOrbit
from dpcontrol.references.trajectory import LimitUse
from dpcontrol.walks.shadowing import ShadowingOrbit

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


def draw(view: RunView) -> Figure:
    """Return the page of a view as a figure.

    Args:
        view: motion to draw.
    """
    charts = [*motion_charts(view), *check_charts(view), *extra_charts(view)]
    half = (len(charts) + 1) // 2
    left, right = (
        [partial(_chart, chart=chart, view=view, last=chart is some[-1]) for chart in some]
        for some in (charts[:half], charts[half:])
    )
    planes = [partial(draw_plane, runs=[(plane(view, arm), style.PLANT)]) for arm in range(min(view.arms, 2))]
    page = Page(view.title, view.verdict, view.good)
    for line in (closest_approach(view), nis_reading(view)):
        page.text(line, colour=style.INK, size=style.TEXT)
    if uses := limit_uses(view):
        page.row(partial(_uses, uses=uses), height=_AROUND + _USE * len(uses))
    if story_height(view):
        page.row(partial(story, view=view), height=story_height(view))
    symbols = enumerate(view.symbols, start=1)
    times = [f"{k} at {at:.2f}{'' if done is None else f' ({done:.2f})'}" for k, (_, at, done) in symbols]
    page.text(f"Symbols as planned (and done), s: {', '.join(times)}" if times else "")
    if view.arm_lengths:
        add_film(page, view, film_times(view, frames=_FRAMES))
    columns = [Stack(column, share=1.05) for column in (left, right) if column]
    page.row(*columns, Stack(planes), height=_TALL * max(half, 3))
    return page.text("   ".join(filter(None, (view.path.name, view.metadata.get("program", ""))))).figure()


def _uses(axes: Axes, uses: Sequence[LimitUse]) -> None:
    """Draw the largest values as shares of their limits.

    The largest share is at the top.
    """
    rows = [
        Bar(use.name, min(use.share, _FULL), style.LIMIT if use.share > _NEAR else style.CART, note=use.sentence)
        for use in uses
    ]
    bars(axes, "Largest values, as shares of their limits", rows)
    axes.axvline(1.0, color=style.LIMIT, linewidth=1.1, linestyle=style.DASHED, zorder=0.5)
    axes.set(xlim=(0, _FULL), xticks=[0, 0.25, 0.5, 0.75, 1.0])
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))


def _chart(axes: Axes, chart: Chart, view: RunView, *, last: bool) -> None:
    draw_chart(axes, chart, view, span=view.time_range)
    if not last:
        axes.set_xlabel("")
        axes.tick_params(labelbottom=False)


def view_of(found: Any) -> Any:
    """Return the motion to draw of a run, a plan, a log, a sustained orbit or a walk, or the object itself."""
    found = getattr(found, "log", found)
    match found:
        case Plan():
            return reference_view(found.reference, found.file)
        case SustainedOrbit():
            return sustained_view(found, found.arms.length)
        case ShadowingOrbit():
            return WalkStory(found).view
        case RunLog():
            return run_view(found) if "reference.npz" in found.attachments else series_of(found)
        case _:
            return found


def angles(axes: Axes, found: Plan | RunLog | SustainedOrbit | ShadowingOrbit) -> None:
    """Draw the angles of a plan, a log, a sustained orbit or a walk over time.

    Args:
        axes: panel to draw on.
        found: motion to draw.
    """
    view = view_of(found)
    draw_chart(axes, charts(view)["angles"], view)


def draw_motion(found: Plan | RunLog) -> Figure:
    """Return the page of a plan or a log as a figure."""
    return draw(view_of(found))


def walk(axes: Axes, found: ShadowingOrbit) -> None:
    """Draw the angles of a walk over time.

    Without angles its orbit is drawn in the plane of positions.

    Args:
        axes: panel to draw on.
        found: orbit of the walk.
    """
    story = WalkStory(found)
    if story.has_angles:
        angles(axes, found)
    else:
        draw_shape(axes, story)
