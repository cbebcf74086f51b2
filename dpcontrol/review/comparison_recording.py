"""Several runs as one Rerun recording: a scene for each, their curves in the same plots, their stories as strips."""

import re
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from dpcontrol.review import series, style
from dpcontrol.review.blueprint import page, plane_view, plot, scene_view
from dpcontrol.review.comparison import ComparedRun, Comparison
from dpcontrol.review.recorded import curve, level, line, states, stay_changes
from dpcontrol.review.recorded_planes import Box, common_boxes, record_planes
from dpcontrol.review.recorded_scene import draw_pendulum
from dpcontrol.review.recording import recording_to


def write_comparison_recording(comparison: Comparison, path: Path) -> None:
    """Write the recording of a comparison to `path` (`*.rrd`).

    Raises:
        InputError: it cannot be written.
    """
    with recording_to(path, comparison.title, _blueprint(comparison)) as recording:
        document = rr.TextDocument(_summary(comparison), media_type="text/markdown")
        recording.log("summary", document, static=True)
        boxes = _boxes(comparison)
        for k, run in enumerate(comparison.runs):
            home = f"runs/{k + 1}"
            draw_pendulum(recording, f"{home}/scene", run.motion, run.context)
            record_planes(recording, f"{home}/planes", run.motion, run.context, boxes=boxes)
            _curves(recording, run, k)
            _strips(recording, run, k)
        first = comparison.runs[0]
        if first.motion.reference is not None:
            look = line(style.REFERENCE, f"reference of {first.name}", width=3.0)
            for arm in range(first.motion.arms):
                values = first.motion.reference[:, arm]
                at = f"plots/angle_{arm + 1}/0_reference"
                curve(recording, at, time=first.motion.time, values=values, look=look)
        for name, value in first.context.saddle_energies.items():
            at, colour = f"plots/energy/{name.replace('-', '_')}", style.saddle_colour(name)
            level(recording, at, first.motion, value=value, colour=colour, name=name)


def _boxes(comparison: Comparison) -> list[Box]:
    return common_boxes([(run.motion, run.context) for run in comparison.runs])


def _key(run: ComparedRun, k: int) -> str:
    return f"{k + 1}_{re.sub(r'[^A-Za-z0-9]+', '_', run.name)}"


def _curves(recording: rr.RecordingStream, run: ComparedRun, k: int) -> None:
    motion, look = run.motion, line(run.colour, run.name, width=1.5)
    n = motion.arms
    found = {f"angle_{arm + 1}": motion.state[:, arm] for arm in range(n)}
    if motion.has_cart:
        found["cart"] = motion.state[:, 2 * n]
    if motion.control is not None and "applied" in motion.control:
        found["acceleration"] = motion.control["applied"]
    if motion.reference is not None:
        found["tracking_error"] = np.abs(motion.state[:, :n] - motion.reference[:, :n]).max(axis=1)
    energy = series.energy_of(motion, run.context)
    if energy is not None:
        found["energy"] = energy
    for name, values in found.items():
        curve(recording, f"plots/{name}/{_key(run, k)}", time=motion.time, values=values, look=look)
    if motion.nis is not None:
        time, means, _ = series.smoothed_nis(motion)
        curve(recording, f"plots/nis/{_key(run, k)}", time=time, values=means, look=look)


def _strips(recording: rr.RecordingStream, run: ComparedRun, k: int) -> None:
    begin, end = run.motion.time_range
    asked, colours = stay_changes(run.context.planned, begin=begin)
    states(recording, f"states/{_key(run, k)}/1_asked", asked[:-1], colours)
    done, colours = stay_changes(run.context.done, begin=begin)
    done = [change for change in done if change[0] < end - 2 / run.motion.rate_hz]
    states(recording, f"states/{_key(run, k)}/2_done", [*done, (end, "ended")] if done else [], colours)


def _summary(comparison: Comparison) -> str:
    rows = [f"**{comparison.title}**", "", comparison.status, ""]
    rows += [f"{k + 1}. **{run.name}**: {run.context.verdict}" for k, run in enumerate(comparison.runs)]
    return "\n".join(rows)


def _blueprint(comparison: Comparison) -> rrb.Blueprint:
    runs, boxes = comparison.runs, _boxes(comparison)
    scenes = [
        scene_view(run.context, from_log=False, home=f"/runs/{k + 1}/scene", name=run.name)
        for k, run in enumerate(runs)
    ]
    arms = runs[0].motion.arms
    planes = [
        plane_view(
            run.motion,
            run.context,
            arm,
            f"/runs/{k + 1}/planes",
            name=f"{run.name}: arm {arm + 1}, rate over angle",
            box=boxes[arm],
        )
        for arm in range(min(arms, 2))
        for k, run in enumerate(runs)
    ]
    corner = rrb.Corner2D.RightTop
    middle = [plot("Arm 1's angle (rad), reference grey", "/plots/angle_1", legend=corner)]
    middle += [plot(f"Arm {arm + 1}'s angle (rad)", f"/plots/angle_{arm + 1}") for arm in range(1, min(arms, 2))]
    if any(run.motion.has_cart for run in runs):
        middle.append(plot("Cart position (m)", "/plots/cart"))
    checks = []
    if any(run.motion.reference is not None for run in runs):
        checks.append(plot("Tracking error, largest of the angles (rad)", "/plots/tracking_error"))
    if any(run.motion.control is not None for run in runs):
        checks.append(plot("Acceleration applied (m/s²)", "/plots/acceleration"))
    if any(series.energy_of(run.motion, run.context) is not None for run in runs):
        checks.append(plot("Energy and saddles (J)", "/plots/energy"))
    if any(run.motion.nis is not None for run in runs):
        checks.append(plot("NIS, means of 50 updates", "/plots/nis"))
    if any(run.context.planned for run in runs):
        name = f"Itineraries, aligned at symbol {comparison.symbol}"
        middle.insert(0, rrb.StateTimelineView(name=name, origin="/states"))
    summary = rrb.TextDocumentView(name="Summary", origin="/summary")
    columns: list[rrb.Container] = [
        rrb.Vertical(
            rrb.Horizontal(*scenes), rrb.Grid(*planes, grid_columns=len(runs)), summary, row_shares=[3, 4, 1.6]
        ),
        rrb.Vertical(*middle),
    ]
    if checks:
        columns.append(rrb.Vertical(*checks))
    return page(rrb.Horizontal(*columns, column_shares=[5, 4, 4][: len(columns)]))
