"""How the viewer arranges a recording: the views, what each shows, and where."""

from dataclasses import dataclass

import rerun as rr
import rerun.blueprint as rrb

from dpcontrol.review import style

TIMELINE = "message_log_time"
"""The timeline of the log's own messages, a duration from the start; derived series go on the same."""

_PAPER = [250, 251, 252]
WORLD = "world"
"""The frame that the log's transforms start from."""


@dataclass(frozen=True)
class Arrangement:
    """What the blueprint depends on.

    Attributes:
        arm_lengths: (n,) in m.
        has_cart: whether the pivot is on a cart.
        has_truth: whether the estimate's error is known.
        has_energy: whether the energy was given.
        bounds: for each phase plane, least and greatest x, least and greatest y, as drawn.
        ranges: least and greatest value to show at first, for plots whose limits lie far out, by name.
    """

    arm_lengths: tuple[float, ...]
    has_cart: bool
    has_truth: bool
    has_energy: bool
    bounds: tuple[tuple[float, float, float, float], ...]
    ranges: dict[str, tuple[float, float]]


def blueprint(arrangement: Arrangement) -> rrb.Blueprint:
    """Return the blueprint of a recording."""
    distance = 2.4 * sum(arrangement.arm_lengths)
    scene = rrb.Spatial3DView(
        name="Scene",
        origin="/",
        contents=["+ /pendulum/**", "+ /reference_pendulum/**", "+ /tf/**", "+ /tip/**"],
        eye_controls=rrb.EyeControls3D(
            position=(0.0, -distance, 0.0), look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0)
        ),
        line_grid=False,
        spatial_information=rrb.SpatialInformation(target_frame=WORLD),
        background=_PAPER,
    )
    planes = [
        rrb.Spatial2DView(
            name=f"Phase plane of arm {arm + 1}",
            origin=f"/phase_planes/arm_{arm + 1}",
            visual_bounds=rrb.VisualBounds2D(x_range=bounds[:2], y_range=bounds[2:]),
            background=_PAPER,
        )
        for arm, bounds in enumerate(arrangement.bounds)
    ]
    ranges = arrangement.ranges
    plots = [
        _plot("Angles (rad)", "/plots/angles", legend=rrb.Corner2D.LeftTop),
        _plot("Rates (rad/s): reference grey", "/plots/rates", legend=None),
    ]
    if arrangement.has_cart:
        plots.append(_plot("Cart position (m): reference grey", "/plots/cart", legend=None, shown=ranges.get("cart")))
    plots.append(_plot("Acceleration (m/s²)", "/plots/acceleration", shown=ranges.get("acceleration")))
    checks = [_plot("NIS: means of 50 ticks, and where 95 % of them belong", "/plots/nis", legend=None)]
    if arrangement.has_truth:
        title = "Estimation error in angles (rad), band 2σ"
        checks.insert(0, _plot(title, "/plots/estimation_error", shown=ranges.get("estimation_error")))
    if arrangement.has_energy:
        checks.append(_plot("Energy and saddles (J)", "/plots/energy", shown=ranges.get("energy")))
    summary = rrb.TextDocumentView(name="Summary", origin="/summary")
    events = rrb.TextLogView(name="Events", origin="/rosout")
    states = rrb.StateTimelineView(name="Controller and itinerary", origin="/states")
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(scene, rrb.Horizontal(*planes), rrb.Horizontal(summary, events), row_shares=[4, 3, 2]),
            rrb.Vertical(states, *plots, row_shares=[1.3, *([2] * len(plots))]),
            rrb.Vertical(*checks),
            column_shares=[5, 4, 4],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _plot(
    name: str,
    origin: str,
    *,
    legend: rrb.Corner2D | None = rrb.Corner2D.RightTop,
    shown: tuple[float, float] | None = None,
) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        name=name,
        origin=origin,
        plot_legend=rrb.PlotLegend(visible=legend is not None, corner=legend),
        axis_y=rrb.ScalarAxis(range=shown) if shown else None,
    )


def line(colour: str, name: str, *, width: float = 1.3) -> rr.SeriesLines:
    """Return the look of one curve."""
    return rr.SeriesLines(colors=[style.rgb(colour)], names=[name], widths=[width])
