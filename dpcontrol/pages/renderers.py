"""The table of renderers: the function that draws each type of result.

Keys are qualified class names, values are `module:function` within `dpcontrol.pages`. Modules are imported when they
are needed, so a picture of an orbit does not load the viewer.
"""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

RENDERERS = {
    "dpcontrol.runs.run.Run": "page:draw_run",
    "dpcontrol.logs.reader.RunLog": "page:draw_log",
    "dpcontrol.judge.run_view.RunView": "page:draw",
    "dpcontrol.judge.preflight.Preflight": "preflight:draw_preflight",
    "dpcontrol.judge.campaign.CampaignSummary": "campaign:draw_campaign",
    "dpcontrol.judge.night.Night": "night:draw_night",
    "dpcontrol.judge.comparison.RunComparison": "comparison:draw_comparison",
    "dpcontrol.walks.atlas.Atlas": "atlas:draw_atlas",
}
"""Functions `draw(result) -> Figure`."""
PANELS: dict[str, str] = {}
"""Functions `draw(axes, result)`, for results that fit in one panel."""


RECORDINGS = {
    "dpcontrol.judge.run_view.RunView": "rerun_recording:write_recording",
    "dpcontrol.judge.comparison.RunComparison": "comparison:write_comparison_recording",
    "dpcontrol.walks.atlas.Atlas": "atlas:write_atlas_recording",
}
"""Functions `write(result, path)` of Rerun recordings."""


def record(result: object, path: Path) -> None:
    """Write the Rerun recording of a result."""
    kind = type(result)
    renderer(RECORDINGS[f"{kind.__module__}.{kind.__qualname__}"])(result, path)


def renderer(place: str) -> Callable[..., Any]:
    """Return the function at `module:function` in this package."""
    module, _, name = place.partition(":")
    return getattr(import_module(f"dpcontrol.pages.{module}"), name)
