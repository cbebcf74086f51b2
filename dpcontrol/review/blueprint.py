"""How the viewer arranges a recording: the views, what each shows, and where."""

from collections.abc import Sequence

import rerun.blueprint as rrb

from dpcontrol.review.motion import RunView
from dpcontrol.review.recorded import TIMELINE
from dpcontrol.review.recorded_planes import Box, bounds
from dpcontrol.review.recorded_scene import WORLD
from dpcontrol.review.series import Chart, check_charts, motion_charts, plane, strips

PAPER = [250, 251, 252]


def blueprint(view: RunView, *, from_log: bool) -> rrb.Blueprint:
    """Return the blueprint of a recording; one made `from_log` has the log's own bodies in its scene, and events."""
    grey = f": {view.against} grey" if view.reference is not None else ""
    middle, checks = plots(motion_charts(view)), plots(check_charts(view))
    if len(checks) == 1 and len(middle) > 2:
        middle, checks = [*middle, *checks], []
    shares = [2.0] * len(middle)
    told = {strip.key: strip.name or "symbols" for strip in strips(view)}
    if told:
        words = ["itinerary as asked and done" if view.done else "itinerary as asked"] if "1_asked" in told else []
        words += [name for name in told.values() if name not in ("asked", "done")]
        middle.insert(0, rrb.StateTimelineView(name=", ".join(words).capitalize(), origin="/states"))
        shares.insert(0, 2.2)
    planes = [
        plane_view(arm, "/phase_planes", bounds(plane(view, arm)), name=f"Arm {arm + 1}: rate over angle")
        for arm in range(min(view.arms, 2))
    ]
    texts: list[rrb.View] = [rrb.TextDocumentView(name="Summary", origin="/summary")]
    if view.events:
        columns = rrb.TextLogColumns(text_log_columns=["loglevel", "body"])
        texts.append(rrb.TextLogView(name="Events", origin="/rosout", columns=columns))
    scene = scene_view(view, from_log=from_log, name=f"Scene{grey}")
    left = rrb.Vertical(scene, rrb.Horizontal(*planes), rrb.Horizontal(*texts), row_shares=[4, 4, 2.4])
    columns_of_views = [left, rrb.Vertical(*middle, row_shares=shares)]
    if checks:
        columns_of_views.append(rrb.Vertical(*checks))
    return page(rrb.Horizontal(*columns_of_views, column_shares=[5, 4.3, 3.7][: len(columns_of_views)]))


def page(root: rrb.Container, *, timeline: str = TIMELINE) -> rrb.Blueprint:
    """Return a blueprint without side panels."""
    return rrb.Blueprint(
        root,
        rrb.TimePanel(state="collapsed", timeline=timeline),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def scene_view(view: RunView, *, from_log: bool, home: str = "/scene", name: str = "Scene") -> rrb.View:
    """Return the view of the pendulum in space, seen from the front."""
    reach = sum(view.arm_lengths)
    distance = max(2.4 * reach, 1.9 * view.limits[0] if view.limits else 0.0)
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


def plane_view(arm: int, home: str, box: Box, *, name: str) -> rrb.View:
    """Return the view of an arm's phase plane."""
    return rrb.Spatial2DView(
        name=name,
        origin=f"{home}/arm_{arm + 1}",
        visual_bounds=rrb.VisualBounds2D(x_range=box[:2], y_range=box[2:]),
        background=PAPER,
    )


def plots(charts: Sequence[Chart]) -> list[rrb.View]:
    """Return the views of charts; one with named levels, or of several runs, has a legend."""
    corner = rrb.Corner2D.RightTop
    return [
        rrb.TimeSeriesView(
            name=chart.named,
            origin=f"/plots/{chart.key}",
            plot_legend=rrb.PlotLegend(visible=chart.legend, corner=corner if chart.legend else None),
            axis_y=rrb.ScalarAxis(range=chart.shown) if chart.shown else None,
        )
        for chart in charts
        if chart.key
    ]
