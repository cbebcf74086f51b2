"""Several runs as a Rerun recording on one clock."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dpcontrol.judge.comparison import RunComparison
from dpcontrol.pages import rerun_recording
from dpcontrol.pages.chart import Chart
from dpcontrol.pages.compared_charts import compared_charts, run_path
from dpcontrol.pages.planes import plane
from dpcontrol.pages.rerun_recording import rrb
from dpcontrol.pages.strips import strips


def write_comparison_recording(comparison: RunComparison, path: Path) -> None:
    """Write the recording of a comparison to `path` (`*.rrd`).

    Args:
        comparison: runs to write.
        path: file, `*.rrd`.

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
            rerun_recording.record_strips(recording, run_path(k, run), shown, run.view)
        for chart in compared:
            rerun_recording.record_chart(recording, "plots", chart, runs[0].view)


def _blueprint(comparison: RunComparison, charts: Sequence[Chart], boxes: list[rerun_recording.Box]) -> rrb.Blueprint:
    runs = comparison.runs
    scenes = [
        rerun_recording.scene_view(run.view, home=f"/runs/{k + 1}/scene", name=run.name) for k, run in enumerate(runs)
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
        contents = [f"+ /{run_path(k, run)}/**" for k, run in enumerate(runs)]
        middle.insert(0, rrb.StateTimelineView(name=name, contents=contents))
    beside = rrb.Grid(*planes, grid_columns=len(runs))
    left = rrb.Vertical(rrb.Horizontal(*scenes), beside, rerun_recording.summary_view(), row_shares=[3, 4, 1.6])
    return rerun_recording.page([left, *(rrb.Vertical(*views) for views in (middle, checks) if views)], [5, 4, 4])
