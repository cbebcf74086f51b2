"""Layout of an atlas in the Rerun viewer.

It consists of views, their ranges and the summary.
"""

from __future__ import annotations

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.pages.atlas_parts import connections_of, section_curves
from dpcontrol.pages.rerun_recording import Box, page, rrb, summary_view
from dpcontrol.walks.atlas import Atlas, AtlasCut, AtlasKind, section_axes

TIMELINE = "time_from_section"
"""Time from the section crossing, s, the same for all flights."""
_DARK = [18, 20, 24]


class ShownTubes:
    """Mapping of states to space: scale of the rate, and bounding box."""

    def __init__(self, atlas: Atlas) -> None:
        self.rate = len(atlas.periods) // 2
        parts = [orbit.samples for orbit in atlas.orbits]
        parts += [cut.strands.reshape(-1, len(atlas.periods)) for cut in atlas.cuts]
        states = np.concatenate(parts)[:, [0, 1, self.rate]]
        # Fast passages close to a body would otherwise flatten the rest.
        low, high = np.quantile(states, [0.02, 0.98], axis=0)
        spans = np.maximum(high - low, 1e-12)
        self.factor = float(max(spans[:2]) / spans[2])
        self.centre = (low + high) / 2 * [1, 1, self.factor]
        self.size = float(max(spans[:2]))

    def places(self, states: Array) -> Array:
        """Return positions (…, 3) of states (…, N)."""
        return states[..., [0, 1, self.rate]] * [1, 1, self.factor]


def kind_path(kind: AtlasKind) -> str:
    return f"{kind.source}_to_{kind.target}_{kind.hits[0]}_{kind.hits[1]}".replace("-", "_")


def saddle_path(cut: AtlasCut) -> str:
    return f"space/tubes/{path_name(cut.saddle)}/hit_{cut.hit}_{path_name(cut.section.name)}"


def path_name(name: str) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in name)


def section_frame(atlas: Atlas, kind: AtlasKind) -> tuple[float, Box]:
    """Return the scale of p/p₀ and the cuts' bounding box.

    With this scale the cuts are drawn two thirds as high as wide.

    The factor is needed because the viewer's scales are equal.

    Args:
        atlas: atlas with the kind.
        kind: kind of connection.
    """
    points = np.concatenate([run for _, _, run in section_curves(atlas, kind)])
    spans = np.maximum(np.ptp(np.quantile(points, [0.01, 0.99], axis=0), axis=0), 1e-12)
    height = float(2 / 3 * spans[0] / spans[1])
    points = points * [1.0, -height]
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.12 * float(max(high - low)) + 1e-6
    return height, (float(low[0]) - margin, float(high[0]) + margin, float(low[1]) - margin, float(high[1]) + margin)


def _section_title(atlas: Atlas, kind: AtlasKind) -> str:
    section = atlas.cut(kind.source, kind.section, kind.hits[0]).section
    coordinate, period = section_axes(section, atlas)
    hits = "" if kind.hits == (1, 1) else f", hits {kind.hits[0]} and {kind.hits[1]}"
    return (
        f"{kind.source} → {kind.target}: {'p/p₀' if period else 'momentum'} over {coordinate} at {kind.section}{hits}"
    )


def atlas_summary(atlas: Atlas) -> str:
    kinds = "\n".join(
        f"| {k.source} → {k.target} | {list(k.hits)} | {k.count} | {'closed' if k.complete else 'open'} |"
        for k in atlas.kinds
    )
    found = "\n".join(
        f"| {k + 1} | {c.name} | {c.transversality_angle:.2f} |"
        for kind in atlas.kinds
        for k, c in enumerate(connections_of(atlas, kind))
    )
    return f"""# {atlas.title}, {atlas.energy:g}{atlas.unit("J")}

{atlas.status}

| from → to | hits | count | cuts |
|---|---|---|---|
{kinds}

Red: unstable tubes, green: stable ones, pale: the other branch; on the sections pale curves are crossed backward. \
Connections carry their numbers in this list; a dot moves along each flight.

| | connection | angle (°) |
|---|---|---|
{found}"""


def atlas_blueprint(atlas: Atlas, shown: ShownTubes) -> rrb.Blueprint:
    axes = ", ".join(atlas.labels[k].partition(" ")[0] for k in (0, 1, len(atlas.labels) // 2))
    eye = shown.centre + np.array([-0.9, -1.3, 0.75]) * shown.size * 1.1
    # Only each saddle's tubes to one section are visible at first; all together would hide everything.
    own = {(k.source, k.section, k.hits[0]) for k in atlas.kinds if k.source == k.target}
    hidden = [saddle_path(c) for c in atlas.cuts if own and (c.saddle, c.section.name, c.hit) not in own]
    space = rrb.Spatial3DView(
        name=f"Space ({axes}): orbits thick, tubes from them red, to them green, where these end golden",
        origin="/space",
        eye_controls=rrb.EyeControls3D(position=tuple(eye), look_target=tuple(shown.centre), eye_up=(0.0, 0.0, 1.0)),
        line_grid=False,
        background=_DARK,
        overrides={path: rrb.EntityBehavior(visible=False) for path in hidden},
    )
    sections = []
    for kind in atlas.kinds:
        if connections_of(atlas, kind):
            _, box = section_frame(atlas, kind)
            bounds = rrb.VisualBounds2D(x_range=box[:2], y_range=box[2:])
            name, origin = _section_title(atlas, kind), f"/sections/{kind_path(kind)}"
            sections.append(rrb.Spatial2DView(name=name, origin=origin, visual_bounds=bounds, background=_DARK))
    beside = [rrb.Grid(*sections, grid_columns=1 if len(sections) < 3 else 2)] if sections else []
    left = rrb.Vertical(space, summary_view(), row_shares=[3, 1])
    return page([left, *beside], [1, 1], timeline=TIMELINE)
