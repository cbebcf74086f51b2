"""An atlas as a Rerun recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.pages import style
from dpcontrol.pages.atlas_blueprint import (
    TIMELINE,
    ShownTubes,
    atlas_blueprint,
    atlas_summary,
    kind_path,
    path_name,
    saddle_path,
    section_frame,
)
from dpcontrol.pages.atlas_parts import (
    BRANCHES,
    colours,
    connections_of,
    placed,
    section_curves,
    section_place,
    tubes_of_cut,
)
from dpcontrol.pages.rerun_recording import reading_lines, recording_to, rr
from dpcontrol.walks.atlas import Atlas, AtlasConnection, AtlasKind, section_axes

_MOMENTS = 240


def write_atlas_recording(atlas: Atlas, path: Path) -> None:
    """Write the recording of an atlas to `path` (`*.rrd`) with its blueprint.

    Args:
        atlas: atlas to write.
        path: file, `*.rrd`.

    Raises:
        InputError: the recording cannot be written.
    """
    shown = ShownTubes(atlas)
    name = f"{atlas.model} at {atlas.energy:g}{atlas.unit('J')}"
    with recording_to(path, name, atlas_blueprint(atlas, shown), atlas_summary(atlas)) as recording:
        for cut in atlas.cuts:
            for tube in tubes_of_cut(atlas, cut):
                side, way = "stable" if tube.stable else "unstable", "plus" if tube.branch > 0 else "minus"
                word = f"{saddle_path(cut)}/{side}_{way}"
                _space(recording, word, shown, tube.strands, tube.colour, width=0.4, alpha=110)
                _space(recording, f"{word}/cut", shown, tube.ends, style.CUT, width=0.8)
        for orbit in atlas.orbits:
            lifts = {(0,) * shown.rate} | {c.winding for c in atlas.connections if c.target == orbit.saddle}
            copies = [placed(atlas, orbit, winding) for winding in sorted(lifts)]
            labels = [orbit.name, *[""] * (len(copies) - 1)]
            home, colour = f"space/orbits/{path_name(orbit.name)}", style.saddle_colour(orbit.saddle)
            _space(recording, home, shown, copies, colour, width=2.5, labels=labels)
        for kind in atlas.kinds:
            if connections_of(atlas, kind):
                _section(recording, atlas, kind)
                _flights(recording, shown, connections_of(atlas, kind), kind_path(kind))


def _space(
    recording: rr.RecordingStream, home: str, shown: ShownTubes, curves: Sequence[Array], colour: str, *, width: float,
    alpha: int = 255, **look: Any,
) -> None:  # fmt: skip
    if curves:
        tints = [(*style.rgb(colour), alpha)]
        places = [shown.places(states) for states in curves]
        drawn = rr.LineStrips3D(places, colors=tints, radii=rr.Radius.ui_points(width), **look)
        recording.log(home, drawn, static=True)


def _flights(
    recording: rr.RecordingStream, shown: ShownTubes, connections: tuple[AtlasConnection, ...], key: str
) -> None:
    look = colours(connections)
    for k, c in enumerate(connections):
        home = f"space/connections/{key}/{k + 1}_{path_name(c.name)}"
        _space(recording, home, shown, [c.states], look[c.name], width=0.9, labels=[c.name], show_labels=False)
        times = np.linspace(c.times[0], c.times[-1], _MOMENTS)
        states = np.stack([np.interp(times, c.times, column) for column in c.states.T], axis=1)
        dot = rr.Points3D.from_fields(colors=[style.rgb(look[c.name])], radii=rr.Radius.ui_points(4))
        recording.log(f"{home}/now", dot, static=True)
        columns = rr.Points3D.columns(positions=shown.places(states))
        recording.send_columns(f"{home}/now", indexes=[rr.TimeColumn(TIMELINE, duration=times)], columns=columns)


def _section(recording: rr.RecordingStream, atlas: Atlas, kind: AtlasKind) -> None:
    home = f"sections/{kind_path(kind)}"
    height, box = section_frame(atlas, kind)
    cut = atlas.cut(kind.source, kind.section, kind.hits[0])
    turning = section_axes(cut.section, atlas)[1] is not None
    reading_lines(recording, home, box, scale=height, turning=turning, dark=True)
    for stable in (False, True):
        runs = [(sign, points) for which, sign, points in section_curves(atlas, kind) if which == stable]
        tints = [(*style.rgb(BRANCHES[stable, sign]), 255) for sign, _ in runs]
        if runs:
            strips = [points * [1.0, -height] for _, points in runs]
            lines = rr.LineStrips2D(strips, colors=tints, radii=rr.Radius.ui_points(1.2))
            recording.log(f"{home}/{'stable' if stable else 'unstable'}", lines, static=True)
    connections = connections_of(atlas, kind)
    look = colours(connections)
    for k, c in enumerate(connections):
        point, tint = section_place(atlas, c) * [1.0, -height], style.rgb(look[c.name])
        mark = rr.Points2D([point], colors=[tint], labels=[str(k + 1)], radii=rr.Radius.ui_points(4))
        # The viewer shows the path under the pointer, which therefore contains the name.
        recording.log(f"{home}/connections/{k + 1}_{path_name(c.name)}", mark, static=True)
