"""Several runs as a Rerun recording on one clock."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dpcontrol.judge.comparison import RunComparison
from dpcontrol.pages import rerun_recording as recorded
from dpcontrol.pages.chart import Chart
from dpcontrol.pages.comparison import compared_charts, run_path
from dpcontrol.pages.planes import plane
from dpcontrol.pages.sheet import Sheet, rrb
from dpcontrol.pages.strips import strips


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
