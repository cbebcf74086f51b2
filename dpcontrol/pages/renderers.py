"""The table of renderers: the function that draws each type of result.

Keys are qualified class names, values are `module:function` within `dpcontrol.pages`. Modules are imported when they
are needed, so a picture of an orbit does not load the viewer.
"""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from matplotlib import rc_context

from dpcontrol.pages import style

RENDERERS = {
    "dpcontrol.logs.reader.RunLog": "page:draw",
    "dpcontrol.judge.run_view.RunView": "page:draw",
    "dpcontrol.judge.preflight.Preflight": "many_runs:draw_preflight",
    "dpcontrol.judge.campaign.CampaignSummary": "many_runs:draw_campaign",
    "dpcontrol.judge.night.Night": "many_runs:draw_night",
    "dpcontrol.judge.comparison.RunComparison": "page:draw_comparison",
    "dpcontrol.walks.atlas.Atlas": "atlas:draw_atlas",
    "dpcontrol.orbits.family.LyapunovFamily": "orbits:draw_family",
    "dpcontrol.orbits.rotating.RotatingFamilies": "orbits:draw_rotating_families",
    "dpcontrol.walks.shadowing.ShadowingOrbit": "walks:draw_walk",
    "dpcontrol.plans.plan.Plan": "page:draw",
    "dpcontrol.identification.identify.Identification": "identification:draw_identification",
}
"""Functions `draw(result) -> Figure`."""
PANELS: dict[str, str] = {
    "dpcontrol.orbits.lyapunov.LyapunovOrbit": "orbits:orbit",
    "dpcontrol.orbits.rotating.RotatingOrbit": "orbits:orbit",
    "dpcontrol.references.sustained.SustainedOrbit": "page:angles",
    "dpcontrol.control.flight.Flight": "single:flight",
    "dpcontrol.orbits.family.LyapunovFamily": "orbits:family",
    "dpcontrol.orbits.rotating.RotatingFamily": "orbits:family",
    "dpcontrol.orbits.tube.Tube": "single:tube",
    "dpcontrol.orbits.cut.Cut": "single:cut",
    "dpcontrol.tubes.connections.ConnectionSearch": "single:search",
    "dpcontrol.tubes.connections.Connection": "single:flown",
    "dpcontrol.tubes.symmetric.SymmetricSearch": "single:flown",
    "dpcontrol.bifurcations.bifurcations.BifurcationSearch": "paper.branches:bifurcations",
    "dpcontrol.walks.shadowing.ShadowingOrbit": "page:angles",
    "dpcontrol.walks.edges.Edges": "single:edges",
    "dpcontrol.walks.atlas.Atlas": "atlas:atlas",
    "dpcontrol.plans.plan.Plan": "page:angles",
    "dpcontrol.logs.reader.RunLog": "page:angles",
    "dpcontrol.judge.campaign.CampaignSummary": "many_runs:draw_groups",
    "dpcontrol.judge.night.Night": "many_runs:draw_causes",
    "dpcontrol.judge.comparison.RunComparison": "page:comparison",
    "dpcontrol.judge.preflight.Preflight": "many_runs:whole_preflight",
    "dpcontrol.identification.identify.Identification": "identification:draw_candidates",
    "dpcontrol.recordings.recording.Recording": "single:recording",
}
"""Functions `draw(axes, result)`, for results that fit in one panel."""
PARTS = {
    "dpcontrol.runs.run.Run": "log",
    "dpcontrol.runs.closed_loop.ClosedLoop": "plan",
    "dpcontrol.runs.campaign.Campaign": "summary",
}
"""Attributes that are drawn in place of their results."""


RECORDINGS = {
    "dpcontrol.judge.run_view.RunView": "rerun_recording:write_recording",
    "dpcontrol.judge.comparison.RunComparison": "page:write_comparison_recording",
    "dpcontrol.walks.atlas.Atlas": "atlas:write_atlas_recording",
}
"""Functions `write(result, path)` of Rerun recordings."""


def record(result: object, path: Path) -> None:
    """Write the recording of a result for the Rerun viewer, by the function for its class in `RECORDINGS`.

    Args:
        result: run, reference, comparison or atlas.
        path: file, `*.rrd`.

    Raises:
        InputError: it cannot be written, or the log was removed.
    """
    renderer(RECORDINGS[f"{type(result).__module__}.{type(result).__qualname__}"])(result, path)


def new_axes(width: float, height: float) -> Any:
    """Return matplotlib's axes of a new figure of this size, in the style of pages.

    Args:
        width: width in inches.
        height: height in inches.
    """
    with rc_context(style.PRINTED):
        return renderer("layout:new_figure")(width, height).add_subplot()


def alone(result: Any, place: str) -> Any:
    """Return the figure of a page with the only panel of a result, and its model and energy if it has them.

    Args:
        result: result to draw, of a class in `PANELS`; its source, its orbit or itself may have a system and an energy.
        place: function that draws it, `module:function` as in `PANELS`.
    """
    orbit = getattr(result, "source", getattr(result, "orbit", result))
    page = renderer("layout:Page")("", width=7.0).row(lambda axes: renderer(place)(axes, result), height=4.8)
    has_conditions = hasattr(orbit, "system") and hasattr(orbit, "energy")
    return page.origin(
        None, *(renderer("orbits:conditions")(orbit.system, [orbit.energy]) if has_conditions else ())
    ).figure()


def renderer(place: str) -> Callable[..., Any]:
    """Return a drawing function of this package, which runs with the settings of pages.

    Its module is imported only now, because the modules of pages load slowly.

    Args:
        place: `module:function`.
    """
    module, _, name = place.partition(":")
    return rc_context(style.PRINTED)(getattr(import_module(f"dpcontrol.pages.{module}"), name))
