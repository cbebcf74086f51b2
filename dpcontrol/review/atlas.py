"""An atlas as a Rerun recording, and on one page: tubes, orbits and flights in space, cuts with their connections.

Space is (first coordinate, second, first rate), for arms (θ₁, θ₂, ω₁); in the recording rates are scaled so that the
tubes are about as high as wide. On the sections, (q, p/p₀) with p upwards. Dots move along the flights with time.
"""

import re
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from dpcontrol.review import style
from dpcontrol.review.figures.connections import (
    BRANCHES,
    FLIGHT,
    colours,
    connections_of,
    draw_cuts,
    draw_space,
    section_curves,
    section_place,
    tubes_of_cut,
)
from dpcontrol.review.page import new_figure
from dpcontrol.review.rerun_recording import Box, page, reading_lines, recording_to
from dpcontrol.walks.atlas import Atlas, AtlasConnection, AtlasCut, AtlasKind, section_axes

Array = NDArray[np.float64]

TIMELINE = "time_from_section"
"""Seconds from the passage of the section, the same for all flights."""
_DARK = [18, 20, 24]
_MOMENTS = 240


def write_atlas_recording(atlas: Atlas, path: Path) -> None:
    """Write the recording of an atlas to `path` (`*.rrd`) with its blueprint.

    Raises:
        InputError: the recording cannot be written.
    """
    shown = _Shown(atlas)
    with recording_to(path, f"{atlas.model} at {atlas.energy:g} J", _blueprint(atlas, shown)) as recording:
        recording.log("summary", rr.TextDocument(_summary(atlas), media_type="text/markdown"), static=True)
        for cut in atlas.cuts:
            _tubes(recording, atlas, shown, cut)
        _orbits(recording, atlas, shown)
        for kind in atlas.kinds:
            if connections_of(atlas, kind):
                _section(recording, atlas, kind)
                _flights(recording, shown, connections_of(atlas, kind), _key(kind))


class _Shown:
    """How states become places: the rate's scale, and the box in which everything lies."""

    def __init__(self, atlas: Atlas) -> None:
        self.rate = len(atlas.periods) // 2
        parts = [orbit.samples for orbit in atlas.orbits]
        parts += [cut.strands.reshape(-1, len(atlas.periods)) for cut in atlas.cuts]
        states = np.concatenate(parts)[:, [0, 1, self.rate]]
        # Passages close to a body are so fast that they would flatten everything else.
        low, high = np.quantile(states, [0.02, 0.98], axis=0)
        spans = np.maximum(high - low, 1e-12)
        self.factor = float(max(spans[:2]) / spans[2])
        self.centre = (low + high) / 2 * [1, 1, self.factor]
        self.size = float(max(spans[:2]))

    def places(self, states: Array) -> Array:
        """Return (…, 3) of states (…, N)."""
        picked = states[..., [0, 1, self.rate]]
        return picked * [1, 1, self.factor]


def _key(kind: AtlasKind) -> str:
    return f"{kind.source}_to_{kind.target}_{kind.hits[0]}_{kind.hits[1]}".replace("-", "_")


def _lines(colour: str, *, width: float, alpha: int = 255) -> dict[str, object]:
    return {"colors": [(*style.rgb(colour), alpha)], "radii": rr.Radius.ui_points(width)}


def _tubes(recording: rr.RecordingStream, atlas: Atlas, shown: _Shown, cut: AtlasCut) -> None:
    for tube in tubes_of_cut(atlas, cut):
        word = f"{_home(cut)}/{'stable' if tube.stable else 'unstable'}_{'plus' if tube.branch > 0 else 'minus'}"
        strands = rr.LineStrips3D(
            [shown.places(states) for states in tube.strands],
            **_lines(tube.colour, width=0.4, alpha=110),  # type: ignore[arg-type]
        )
        ends = rr.LineStrips3D([shown.places(s) for s in tube.ends], **_lines(style.CUT, width=0.8))  # type: ignore[arg-type]
        for path, drawn, known in ((word, strands, tube.strands), (f"{word}/cut", ends, tube.ends)):
            if known:
                recording.log(path, drawn, static=True)


def _home(cut: AtlasCut) -> str:
    return f"space/tubes/{_plain(cut.saddle)}/hit_{cut.hit}_{_plain(cut.section.name)}"


def _plain(name: str) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in name)


def _orbits(recording: rr.RecordingStream, atlas: Atlas, shown: _Shown) -> None:
    turn = atlas.turn_lengths
    half = len(atlas.periods) // 2
    for orbit in atlas.orbits:
        closed = np.vstack([orbit.samples, orbit.samples[:1]])
        lifts = {(0,) * half} | {c.winding for c in atlas.connections if c.target == orbit.saddle}
        copies = [shown.places(closed + np.r_[np.asarray(w, float), np.zeros(half)] * turn) for w in sorted(lifts)]
        strips = rr.LineStrips3D(
            copies,
            labels=[orbit.name, *[""] * (len(copies) - 1)],
            **_lines(style.saddle_colour(orbit.saddle), width=2.5),  # type: ignore[arg-type]
        )
        recording.log(f"space/orbits/{_plain(orbit.name)}", strips, static=True)


def _flights(recording: rr.RecordingStream, shown: _Shown, connections: tuple[AtlasConnection, ...], key: str) -> None:
    look = colours(connections)
    for k, c in enumerate(connections):
        home = f"space/connections/{key}/{k + 1}_{_plain(c.name)}"
        flight = rr.LineStrips3D([shown.places(c.states)], labels=[c.name], show_labels=False,
                                 **_lines(look[c.name], width=0.9))  # type: ignore[arg-type]  # fmt: skip
        recording.log(home, flight, static=True)
        times = np.linspace(c.times[0], c.times[-1], _MOMENTS)
        states = np.stack([np.interp(times, c.times, column) for column in c.states.T], axis=1)
        dot = rr.Points3D.from_fields(colors=[style.rgb(look[c.name])], radii=rr.Radius.ui_points(4))
        recording.log(f"{home}/now", dot, static=True)
        recording.send_columns(
            f"{home}/now",
            indexes=[rr.TimeColumn(TIMELINE, duration=times)],
            columns=rr.Points3D.columns(positions=shown.places(states)),
        )


def _section(recording: rr.RecordingStream, atlas: Atlas, kind: AtlasKind) -> None:
    home, height = f"sections/{_key(kind)}", _height(atlas, kind)
    cut = atlas.cut(kind.source, kind.section, kind.hits[0])
    turning = section_axes(cut.section, atlas.periods)[1] is not None
    reading_lines(recording, home, _box(atlas, kind), scale=height, turning=turning, dark=True)
    for stable in (False, True):
        runs = [(sign, points) for which, sign, points in section_curves(atlas, kind) if which == stable]
        tints = [(*style.rgb(BRANCHES[stable, sign]), 255) for sign, _ in runs]
        if runs:
            strips = [points * [1.0, -height] for _, points in runs]
            lines = rr.LineStrips2D(strips, colors=tints, radii=rr.Radius.ui_points(1.2))
            recording.log(f"{home}/{'stable' if stable else 'unstable'}", lines, static=True)
    connections = connections_of(atlas, kind)
    look = colours(connections)
    points = np.array([section_place(atlas, c) for c in connections])
    for k, (c, point) in enumerate(zip(connections, points * [1.0, -height], strict=True)):
        mark = rr.Points2D(
            [point],
            colors=[style.rgb(look[c.name])],
            labels=[str(k + 1)],
            radii=rr.Radius.ui_points(4),
        )
        # The viewer shows the path of what the pointer is on: it holds the name.
        recording.log(f"{home}/connections/{k + 1}_{_plain(c.name)}", mark, static=True)


def _height(atlas: Atlas, kind: AtlasKind) -> float:
    """Return what scales p/p₀ so that the cuts are two thirds as high as wide: the viewer's scales are equal."""
    points = np.concatenate([run for _, _, run in section_curves(atlas, kind)])
    low, high = np.quantile(points, [0.01, 0.99], axis=0)
    spans = np.maximum(high - low, 1e-12)
    return float(2 / 3 * spans[0] / spans[1])


def _box(atlas: Atlas, kind: AtlasKind) -> Box:
    """Return least and greatest x, least and greatest y of a section's cuts, as drawn."""
    points = np.concatenate([run for _, _, run in section_curves(atlas, kind)])
    points = points * [1.0, -_height(atlas, kind)]
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.12 * float(max(high - low)) + 1e-6
    return float(low[0]) - margin, float(high[0]) + margin, float(low[1]) - margin, float(high[1]) + margin


def _section_title(atlas: Atlas, kind: AtlasKind) -> str:
    section = atlas.cut(kind.source, kind.section, kind.hits[0]).section
    coordinate, period = section_axes(section, atlas.periods)
    where = re.sub(r"angle_(\d)", lambda found: f"θ{chr(ord('₀') + int(found[1]))}", kind.section)
    where = where.replace("2 pi k", "2πk")
    hits = "" if kind.hits == (1, 1) else f", hits {kind.hits[0]} and {kind.hits[1]}"
    return f"{kind.source} → {kind.target}: {'p/p₀' if period else 'momentum'} over {coordinate} at {where}{hits}"


def _summary(atlas: Atlas) -> str:
    rows = [f"# {atlas.title}, {atlas.energy:g} J", "", atlas.status, "", "| from → to | hits | count | cuts |",
            "|---|---|---|---|"]  # fmt: skip
    rows += [
        f"| {k.source} → {k.target} | {list(k.hits)} | {k.count} | {'closed' if k.complete else 'open'} |"
        for k in atlas.kinds
    ]
    rows += ["", "Red: unstable tubes, green: stable ones, pale: the other branch; on the sections pale curves are "
             "crossed backward. Connections carry their numbers in this list; a dot moves along each flight.", "",
             "| | connection | angle (°) |", "|---|---|---|"]  # fmt: skip
    rows += [
        f"| {k + 1} | {c.name} | {c.transversality_angle:.2f} |"
        for kind in atlas.kinds
        for k, c in enumerate(connections_of(atlas, kind))
    ]
    return "\n".join(rows)


def _hidden(atlas: Atlas) -> list[str]:
    """Return the tubes that are not shown at first: all but each saddle's to its own section, else nothing is seen."""
    own = {(k.source, k.section, k.hits[0]) for k in atlas.kinds if k.source == k.target}
    wanted = own or {(c.saddle, c.section.name, c.hit) for c in atlas.cuts}
    return [_home(c) for c in atlas.cuts if (c.saddle, c.section.name, c.hit) not in wanted]


def _blueprint(atlas: Atlas, shown: _Shown) -> rrb.Blueprint:
    axes = "θ₁, θ₂, ω₁" if np.isfinite(atlas.periods).any() else "x, y, x rate"
    eye = shown.centre + np.array([-0.9, -1.3, 0.75]) * shown.size * 1.1
    space = rrb.Spatial3DView(
        name=f"Space ({axes}): orbits thick, tubes from them red, to them green, where these end golden",
        origin="/space",
        eye_controls=rrb.EyeControls3D(position=tuple(eye), look_target=tuple(shown.centre), eye_up=(0.0, 0.0, 1.0)),
        line_grid=False,
        background=_DARK,
        overrides={path: rrb.EntityBehavior(visible=False) for path in _hidden(atlas)},
    )
    sections = []
    for kind in atlas.kinds:
        if not connections_of(atlas, kind):
            continue
        left, right, top, bottom = _box(atlas, kind)
        sections.append(
            rrb.Spatial2DView(
                name=_section_title(atlas, kind),
                origin=f"/sections/{_key(kind)}",
                visual_bounds=rrb.VisualBounds2D(x_range=(left, right), y_range=(top, bottom)),
                background=_DARK,
            )
        )
    summary = rrb.TextDocumentView(name="Summary", origin="/summary")
    beside = [rrb.Grid(*sections, grid_columns=1 if len(sections) < 3 else 2)] if sections else []
    left = rrb.Vertical(space, summary, row_shares=[3, 1])
    return page(rrb.Horizontal(left, *beside, column_shares=[1, 1][: 1 + len(beside)]), timeline=TIMELINE)


def draw_atlas(atlas: Atlas) -> Figure:
    """Return the atlas on one page: tubes, orbits and flights in space, and the cuts of every kind."""
    kinds = [kind for kind in atlas.kinds if connections_of(atlas, kind)]
    title = f"{atlas.title} at {atlas.energy:g} J: {len(atlas.orbits)} orbits, {len(atlas.connections)} connections"
    figure = new_figure(16, 8.6, title)
    wide = 0.42 if kinds else 0.9
    space = figure.add_axes((0.03, 0.0, wide - 0.03, 0.95), projection="3d")
    draw_space(space, atlas, hit_of=lambda cut: cut.hit, flights=atlas.connections)
    looks = (
        (style.UNSTABLE, "unstable tubes"),
        (style.STABLE, "stable tubes"),
        (style.CUT, "cuts"),
        (FLIGHT, "connections"),
    )
    handles = [Line2D([], [], color=colour, label=label) for colour, label in looks]
    handles += [Line2D([], [], color=style.saddle_colour(o.saddle), linewidth=2.5, label=f"orbit about {o.name}")
                for o in atlas.orbits]  # fmt: skip
    figure.legend(handles=handles, loc="lower left", fontsize=8.5, frameon=False, ncols=3)
    columns = 1 if len(kinds) < 2 else 2
    rows = (len(kinds) + columns - 1) // columns
    for k, kind in enumerate(kinds):
        row, column = divmod(k, columns)
        tall, broad = 0.9 / rows, (0.99 - wide) / columns
        axes = figure.add_axes(
            (wide + 0.045 + column * broad, 0.94 - (row + 1) * tall + 0.065, broad - 0.05, tall - 0.15)
        )
        draw_cuts(axes, atlas, kind)
        axes.set_title(f"{kind.source} → {kind.target}: {kind.count} at hits {list(kind.hits)}", loc="left",
                       fontsize=10, pad=27)  # fmt: skip
    return figure
