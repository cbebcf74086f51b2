"""An atlas as a Rerun recording: tubes, orbits and flights in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.pages import style
from dpcontrol.pages.atlas import colours, connections_of, placed, tubes_of_cut
from dpcontrol.pages.rerun_recording import DARK, page, recording_to, rr, rrb, summary_view
from dpcontrol.walks.atlas import Atlas, AtlasCut, AtlasKind

TIMELINE = "time_from_section"
"""Time from the section crossing, s, the same for all flights."""
_MOMENTS = 240


@dataclass(frozen=True, eq=False)
class _Space:
    """The atlas's states as points of a recording: (first coordinate, second, scaled first rate).

    Attributes:
        recording: recording to extend.
        picked: indices of the shown coordinates.
        factor: scale of the rate.
    """

    recording: rr.RecordingStream
    picked: list[int]
    factor: float

    def places(self, states: Array) -> Array:
        """Return positions (…, 3) of states (…, N)."""
        return states[..., self.picked] * [1, 1, self.factor]

    def curves(self, home: str, curves: Sequence[Array], colour: str, width: float, **look: Any) -> None:
        """Record curves (K, N) under a path.

        Args:
            home: path in the recording.
            curves: curves; none are skipped.
            colour: colour of the curves.
            width: width of the curves, points.
            **look: further fields of Rerun's line strips.
        """
        if curves:
            look = {"colors": [style.rgb(colour)], "radii": rr.Radius.ui_points(width), **look}
            self.recording.log(home, rr.LineStrips3D([self.places(part) for part in curves], **look), static=True)


def write_atlas_recording(atlas: Atlas, path: Path) -> None:
    """Write the recording of an atlas to `path` (`*.rrd`) with its blueprint.

    Args:
        atlas: atlas to write.
        path: file, `*.rrd`.

    Raises:
        InputError: the recording cannot be written.
    """
    rate = len(atlas.periods) // 2
    states = np.concatenate(
        [o.samples for o in atlas.orbits] + [c.strands.reshape(-1, len(atlas.periods)) for c in atlas.cuts]
    )
    # Fast passages close to a body would otherwise flatten the rest.
    low, high = np.quantile(states[:, [0, 1, rate]], [0.02, 0.98], axis=0)
    size, spans = float(max((high - low)[:2])), np.maximum(high - low, 1e-12)
    factor = size / float(spans[2])
    view = _blueprint(atlas, centre=(low + high) / 2 * [1, 1, factor], size=size)
    name = f"{atlas.model} at {atlas.energy:g}{atlas.unit('J')}"
    with recording_to(path, name, view, _summary(atlas)) as recording:
        space = _Space(recording, [0, 1, rate], factor)
        for cut in atlas.cuts:
            for tube in tubes_of_cut(atlas, cut):
                side, way = "stable" if tube.stable else "unstable", "plus" if tube.branch > 0 else "minus"
                home = f"{_tube_path(cut)}/{side}_{way}"
                pale = [(*style.rgb(tube.colour), 110)]
                space.curves(home, tube.strands, tube.colour, 0.4, colors=pale)
                space.curves(f"{home}/cut", tube.ends, style.CUT, 0.8)
        for orbit in atlas.orbits:
            lifts = {(0,) * rate} | {c.winding for c in atlas.connections if c.target == orbit.saddle}
            copies = [placed(atlas, orbit, winding) for winding in sorted(lifts)]
            labels = [orbit.name, *[""] * (len(copies) - 1)]
            colour = style.saddle_colour(orbit.saddle)
            space.curves(f"space/orbits/{_path(orbit.name)}", copies, colour, 2.5, labels=labels)
        for kind in atlas.kinds:
            _connections(space, atlas, kind)


def _path(name: str) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in name)


def _tube_path(cut: AtlasCut) -> str:
    return f"space/tubes/{_path(cut.saddle)}/hit_{cut.hit}_{_path(cut.section.name)}"


def _connections(space: _Space, atlas: Atlas, kind: AtlasKind) -> None:
    """Record the flights of a kind, each with a moving dot."""
    home = f"space/connections/{_path(kind.source)}_to_{_path(kind.target)}_{kind.hits[0]}_{kind.hits[1]}"
    connections = connections_of(atlas, kind)
    look = colours(connections)
    for k, c in enumerate(connections):
        # The viewer shows the path under the pointer, which therefore contains the name.
        flight, recording = f"{home}/{k + 1}_{_path(c.name)}", space.recording
        space.curves(flight, [c.states], look[c.name], 0.9, labels=[c.name], show_labels=False)
        times = np.linspace(c.times[0], c.times[-1], _MOMENTS)
        states = np.stack([np.interp(times, c.times, column) for column in c.states.T], axis=1)
        dot = rr.Points3D.from_fields(colors=[style.rgb(look[c.name])], radii=rr.Radius.ui_points(4))
        recording.log(f"{flight}/now", dot, static=True)
        columns = rr.Points3D.columns(positions=space.places(states))
        recording.send_columns(f"{flight}/now", indexes=[rr.TimeColumn(TIMELINE, duration=times)], columns=columns)


def _blueprint(atlas: Atlas, *, centre: Array, size: float) -> rrb.Blueprint:
    """Return the layout: space with the summary beside it.

    Only each saddle's tubes to one section are visible at first; all together would hide everything.
    """
    axes = ", ".join(atlas.labels[k].partition(" ")[0] for k in (0, 1, len(atlas.labels) // 2))
    eye = centre + np.array([-1.0, -1.4, 0.8]) * size
    own = {(k.source, k.section, k.hits[0]) for k in atlas.kinds if k.source == k.target}
    hidden = [_tube_path(c) for c in atlas.cuts if own and (c.saddle, c.section.name, c.hit) not in own]
    space = rrb.Spatial3DView(
        name=f"Space ({axes}): orbits thick, tubes from them red, to them green, where these end golden",
        origin="/space",
        eye_controls=rrb.EyeControls3D(position=tuple(eye), look_target=tuple(centre), eye_up=(0.0, 0.0, 1.0)),
        line_grid=False,
        background=DARK,
        overrides={path: rrb.EntityBehavior(visible=False) for path in hidden},
    )
    return page([space, summary_view()], [3, 1], timeline=TIMELINE)


def _summary(atlas: Atlas) -> str:
    kinds = "\n".join(
        f"| {k.source} → {k.target} | {list(k.hits)} | {k.count} | {'closed' if k.complete else 'open'} |"
        for k in atlas.kinds
    )
    connections = "\n".join(
        f"| {k + 1} | {c.name} | {c.transversality_angle:.2f} |"
        for kind in atlas.kinds
        for k, c in enumerate(connections_of(atlas, kind))
    )
    return f"""# {atlas.title}, {atlas.energy:g}{atlas.unit("J")}

{atlas.status}

| from → to | hits | count | cuts |
|---|---|---|---|
{kinds}

Red: unstable tubes, green: stable ones, pale: the other branch. A dot moves along each flight.

| | connection | angle (°) |
|---|---|---|
{connections}"""
