"""Several runs as one Rerun recording: a scene for each, their curves in the same plots, their stories as strips."""

import re
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from dpcontrol.review.blueprint import page, plane_view, plots, scene_view
from dpcontrol.review.comparison import RunComparison, compared_charts
from dpcontrol.review.recorded import record_chart, record_strips
from dpcontrol.review.recorded_planes import Box, bounds, record_planes
from dpcontrol.review.recorded_scene import draw_pendulum
from dpcontrol.review.recording import recording_to
from dpcontrol.review.series import plane, strips


def write_comparison_recording(comparison: RunComparison, path: Path) -> None:
    """Write the recording of a comparison to `path` (`*.rrd`).

    Raises:
        InputError: it cannot be written.
    """
    boxes = _boxes(comparison)
    with recording_to(path, comparison.title, _blueprint(comparison, boxes)) as recording:
        document = rr.TextDocument(_summary(comparison), media_type="text/markdown")
        recording.log("summary", document, static=True)
        for k, run in enumerate(comparison.runs):
            draw_pendulum(recording, f"runs/{k + 1}/scene", run.view)
            record_planes(recording, f"runs/{k + 1}/planes", run.view, boxes=boxes)
            told = [s for s in strips(run.view, until=comparison.span[1]) if s.key in ("1_asked", "2_done")]
            record_strips(recording, f"states/{k + 1}_{re.sub(r'[^A-Za-z0-9]+', '_', run.name)}", told, run.view)
        for chart in compared_charts(comparison):
            record_chart(recording, "plots", chart, comparison.runs[0].view)


def _boxes(comparison: RunComparison) -> list[Box]:
    """Return for each arm the box that holds all runs."""
    runs = comparison.runs
    return [bounds(*(plane(run.view, arm) for run in runs)) for arm in range(runs[0].view.arms)]


def _summary(comparison: RunComparison) -> str:
    rows = [f"**{comparison.title}**", "", comparison.status, ""]
    rows += [f"{k + 1}. **{run.name}**: {run.view.verdict}" for k, run in enumerate(comparison.runs)]
    return "\n".join(rows)


def _blueprint(comparison: RunComparison, boxes: list[Box]) -> rrb.Blueprint:
    runs = comparison.runs
    scenes = [
        scene_view(run.view, from_log=False, home=f"/runs/{k + 1}/scene", name=run.name) for k, run in enumerate(runs)
    ]
    planes = [
        plane_view(arm, f"/runs/{k + 1}/planes", boxes[arm], name=f"{run.name}: arm {arm + 1}, rate over angle")
        for arm in range(min(runs[0].view.arms, 2))
        for k, run in enumerate(runs)
    ]
    charts = compared_charts(comparison)
    middle = plots([c for c in charts if c.key in ("angle_1", "angle_2", "cart")])
    checks = plots([c for c in charts if c.key in ("tracking_error", "acceleration", "energy", "nis")])
    if any(run.view.plan.planned for run in runs):
        name = f"Itineraries, aligned at symbol {comparison.symbol}"
        middle.insert(0, rrb.StateTimelineView(name=name, origin="/states"))
    summary = rrb.TextDocumentView(name="Summary", origin="/summary")
    left = rrb.Vertical(
        rrb.Horizontal(*scenes), rrb.Grid(*planes, grid_columns=len(runs)), summary, row_shares=[3, 4, 1.6]
    )
    columns: list[rrb.Container] = [left, rrb.Vertical(*middle)]
    if checks:
        columns.append(rrb.Vertical(*checks))
    return page(rrb.Horizontal(*columns, column_shares=[5, 4, 4][: len(columns)]))
