"""How the viewer arranges a recording: the views, what each shows, and where."""

import numpy as np
import rerun.blueprint as rrb

from dpcontrol.review import series
from dpcontrol.review.context import ReviewContext
from dpcontrol.review.motion import ACTUAL, Motion
from dpcontrol.review.recorded import TIMELINE
from dpcontrol.review.recorded_planes import Box, bounds
from dpcontrol.review.recorded_scene import WORLD
from dpcontrol.review.recorded_series import DRIVEN

PAPER = [250, 251, 252]
Range = tuple[float, float]


def blueprint(motion: Motion, context: ReviewContext, *, from_log: bool) -> rrb.Blueprint:
    """Return the blueprint of a recording; one made `from_log` has the log's own bodies in its scene, and events."""
    ranges = shown_ranges(motion, context)
    named = "arm 1 blue, arm 2 orange" if motion.arms == 2 else "one colour for each arm"
    grey = f", {motion.against} grey" if motion.reference is not None else ""
    plots = [
        plot(f"Angles (rad): {named}{grey}", "/plots/angles"),
        plot("Rates (rad/s)" + (", by differences" if motion.differenced else ""), "/plots/rates"),
    ]
    if motion.has_cart:
        plots.append(plot(f"Cart position (m){grey}", "/plots/cart", shown=ranges.get("cart")))
    if motion.control is not None:
        limit = f"±{context.limits[2]:g} m/s²" if context.limits else "(m/s²)"
        said = ", ".join(text for name, (text, _) in DRIVEN.items() if name in motion.control)
        title = f"Acceleration {limit}: {said}"
        plots.append(plot(title, "/plots/acceleration", shown=ranges.get("acceleration")))
    checks = (
        [plot(f"{motion.error_name} of the angles (rad)", "/plots/tracking_error")]
        if motion.reference is not None
        else []
    )
    if motion.error is not None and motion.sigma is not None:
        title = "Estimation error of the angles (rad), band ±2σ"
        checks.append(plot(title, "/plots/estimation_error", shown=ranges.get("estimation_error")))
    if motion.nis is not None:
        checks.append(
            plot("NIS: means of 50 updates; 95 % belong between the green lines", "/plots/nis", shown=ranges.get("nis"))
        )
    if series.energy_of(motion, context) is not None:
        corner = rrb.Corner2D.RightTop
        checks.append(plot("Energy and saddles (J)", "/plots/energy", legend=corner, shown=ranges.get("energy")))
    planes = [plane_view(motion, context, arm, "/phase_planes") for arm in range(min(motion.arms, 2))]
    texts: list[rrb.View] = [rrb.TextDocumentView(name="Summary", origin="/summary")]
    if motion.events:
        columns = rrb.TextLogColumns(text_log_columns=["loglevel", "body"])
        texts.append(rrb.TextLogView(name="Events", origin="/rosout", columns=columns))
    if len(checks) == 1 and len(plots) > 2:
        plots, checks = [*plots, *checks], []
    middle = [*plots]
    if context.planned or context.symbols or series.mode_spans(motion):
        parts = ["itinerary as asked" + (" and done" if context.done else "")] if context.planned else []
        parts += ["symbols"] if context.symbols else []
        parts += ["controller"] if series.mode_spans(motion) else []
        middle.insert(0, rrb.StateTimelineView(name=", ".join(parts).capitalize(), origin="/states"))
    shares = [2.2 if k == 0 and len(middle) > len(plots) else 2 for k in range(len(middle))]
    columns_of_views = [
        rrb.Vertical(
            scene_view(context, from_log=from_log, name=f"Scene{grey.replace(',', ':')}"),
            rrb.Horizontal(*planes),
            rrb.Horizontal(*texts),
            row_shares=[4, 4, 2.4],
        ),
        rrb.Vertical(*middle, row_shares=shares),
    ]
    if checks:
        columns_of_views.append(rrb.Vertical(*checks))
    return page(rrb.Horizontal(*columns_of_views, column_shares=[5, 4.3, 3.7][: len(columns_of_views)]))


def page(root: rrb.Container) -> rrb.Blueprint:
    """Return a blueprint without side panels."""
    return rrb.Blueprint(
        root,
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def scene_view(context: ReviewContext, *, from_log: bool, home: str = "/scene", name: str = "Scene") -> rrb.View:
    """Return the view of the pendulum in space, seen from the front."""
    reach = sum(context.arm_lengths)
    distance = max(2.4 * reach, 1.9 * context.limits[0] if context.limits else 0.0)
    contents = (
        ["+ /pendulum/**", "+ /reference_pendulum/**", "+ /tf/**", "+ /tip/**"]
        if from_log
        else [f"+ {home}/**", "+ /tip/**"]
    )
    return rrb.Spatial3DView(
        name=name,
        origin="/",
        contents=contents,
        eye_controls=rrb.EyeControls3D(
            position=(0.0, -distance, 0.0), look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0)
        ),
        line_grid=False,
        spatial_information=rrb.SpatialInformation(target_frame=WORLD) if from_log else None,
        background=PAPER,
    )


def plane_view(
    motion: Motion, context: ReviewContext, arm: int, home: str, *, name: str = "", box: Box | None = None
) -> rrb.View:
    """Return the view of an arm's phase plane, in its own box or in one that is given."""
    box = box or bounds(motion, context, arm)
    return rrb.Spatial2DView(
        name=name or f"Arm {arm + 1}: rate over angle",
        origin=f"{home}/arm_{arm + 1}",
        visual_bounds=rrb.VisualBounds2D(x_range=box[:2], y_range=box[2:]),
        background=PAPER,
    )


def plot(name: str, origin: str, *, legend: rrb.Corner2D | None = None, shown: Range | None = None) -> rrb.View:
    """Return the view of a plot; `shown` is its range at first."""
    return rrb.TimeSeriesView(
        name=name,
        origin=origin,
        plot_legend=rrb.PlotLegend(visible=legend is not None, corner=legend),
        axis_y=rrb.ScalarAxis(range=shown) if shown else None,
    )


def shown_ranges(motion: Motion, context: ReviewContext) -> dict[str, Range]:
    """Return what to show at first of each plot whose limits, levels or first instants would flatten the rest."""
    ranges: dict[str, Range] = {}
    if motion.control is not None:
        shown = [motion.control[name] for name in ("applied", ACTUAL) if name in motion.control]
        ranges["acceleration"] = series.padded(np.concatenate(shown or [motion.control["feedforward"]]))
    if motion.has_cart:
        ranges["cart"] = series.padded(motion.state[:, 2 * motion.arms])
    if motion.error is not None:
        most = series.error_reach(motion)
        ranges["estimation_error"] = (-most, most)
    if motion.nis is not None:
        means = series.smoothed_nis(motion)[1]
        most = series.NIS_LOST * motion.sensors
        if len(means) and np.nanmin(means) < most < np.nanmax(means):
            ranges["nis"] = (0.0, most)
    energy = series.energy_of(motion, context)
    if energy is not None:
        ranges["energy"] = series.energy_range(energy, context.saddle_energies)
    return {name: span for name, span in ranges.items() if np.isfinite(span).all()}
