"""An atlas on one page, and as a Rerun recording: tubes, orbits and flights in space, cuts with their connections.

Space is (first coordinate, second, first rate), for arms (θ₁, θ₂, ω₁). In the recording rates are scaled to make the
tubes about as high as wide. Sections are drawn as (q, p/p₀) with p upwards. Dots move along the flights with time.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.foundation.arrays import Array
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, Panel, Stack, key
from dpcontrol.pages.panels import angle_axis, name_point, quiet, quiet_space, wrapped_runs
from dpcontrol.pages.rerun_recording import Box, page, reading_lines, recording_to, rr, rrb, summary_view
from dpcontrol.walks.atlas import Atlas, AtlasConnection, AtlasCut, AtlasKind, AtlasOrbit, section_axes

BRANCHES = {
    (False, 1): style.UNSTABLE,
    (False, -1): style.PALE_UNSTABLE,
    (True, 1): style.STABLE,
    (True, -1): style.PALE_STABLE,
}
"""Colours by (stable, branch): unstable tubes red, stable ones green; the second branch is pale."""


@dataclass(frozen=True, eq=False)
class TubePart:
    """One branch of a tube in space.

    It has trajectories (M, N) up to its section, and their end points (K, N).

    `sense` is the sign of the final crossing, 0 without one.
    """

    stable: bool
    branch: int
    strands: list[Array]
    ends: list[Array]
    sense: int = 0

    @property
    def colour(self) -> str:
        """Colour of the trajectories."""
        return BRANCHES[self.stable, self.branch]


def section_curves(atlas: Atlas, kind: AtlasKind) -> list[tuple[bool, int, Array]]:
    """Return the cuts of a kind's tubes as runs.

    A run has (stable, sign of the crossing, points (K, 2) within a period).
    """
    found = []
    for stable, saddle, hit in ((False, kind.source, kind.hits[0]), (True, kind.target, kind.hits[1])):
        cut = atlas.cut(saddle, kind.section, hit)
        _, period = section_axes(cut.section, atlas)
        for piece in cut.pieces:
            points = piece.stable_points if stable else piece.points
            closed = np.vstack([points, points[:1]]) if piece.closed else points
            sign = stable_direction(atlas, cut, piece.direction) if stable else piece.direction
            runs = wrapped_runs(closed, (period, None))
            found += [(stable, 1 if sign > 0 else -1, run) for run in runs]
    return found


def section_place(atlas: Atlas, connection: AtlasConnection) -> Array:
    """Return the point (q, p/p₀) of a connection on its section.

    The angle q is within a period.
    """
    _, period = section_axes(connection.section, atlas)
    q, p = connection.point
    return np.array([q - (np.rint(q / period) * period if period else 0.0), p])


def tubes_of_cut(atlas: Atlas, cut: AtlasCut) -> list[TubePart]:
    """Return both branches of a saddle's tubes up to a cut.

    The stable tube is found by time reversal.
    """
    parts = []
    for stable in (False, True):
        for branch in (1, -1):
            strands = list(cut.strands[cut.strand_branches == branch])
            pieces = [piece for piece in cut.pieces if piece.branch == branch]
            closed = [np.vstack([p.states, p.states[:1]]) if p.closed else p.states for p in pieces]
            if stable:
                strands, closed = ([atlas.turned(states, cut.saddle) for states in some] for some in (strands, closed))
            ways = {stable_direction(atlas, cut, p.direction) if stable else p.direction for p in pieces}
            parts.append(TubePart(stable, branch, strands, closed, ways.pop() if len(ways) == 1 else 0))
    return parts


def kind_of(atlas: Atlas, source: str, target: str) -> AtlasKind | None:
    """Return the last kind searched between two saddles, or None.

    Kinds with connections are preferred.
    """
    kinds = [kind for kind in atlas.kinds if (kind.source, kind.target) == (source, target)]
    return kinds[-1] if kinds else None


def connections_of(atlas: Atlas, kind: AtlasKind) -> tuple[AtlasConnection, ...]:
    """Return the connections of a kind."""
    return tuple(c for c in atlas.between(kind.source, kind.target) if c.hits == kind.hits)


def stable_direction(atlas: Atlas, cut: AtlasCut, direction: int) -> int:
    """Return the sign of a stable tube's crossing of the section.

    It follows from its unstable image's.
    """
    normal = np.asarray(cut.section.normal)
    # Under time reversal a crossing changes sides unless the reverser also flips the section.
    return -direction * int(np.sign(normal @ atlas.reverser @ normal))


def colours(connections: tuple[AtlasConnection, ...]) -> dict[str, str]:
    """Return a colour for each connection by name.

    Mirror images (the other sense) share one.
    """
    chosen: dict[str, str] = {}
    keys: list[tuple[object, ...]] = []
    for c in sorted(connections, key=lambda c: -round(c.transversality_angle, 3)):
        # Quantities that mirror images share, rounded as coarsely as in names.
        key = (round(c.transversality_angle, 3), round(c.time_in + c.time_out, 3))
        if key not in keys:
            keys.append(key)
        chosen[c.name] = style.CONNECTIONS[keys.index(key) % len(style.CONNECTIONS)]
    return chosen


def draw_cuts(
    axes: Axes,
    atlas: Atlas,
    kind: AtlasKind,
    *,
    shown: tuple[AtlasConnection, ...] | None = None,
    numbers: dict[str, str] | None = None,
    legend: bool = True,
    sense: int | None = None,
) -> None:
    """Draw both tubes' cuts of a kind and mark its connections.

    Those of `shown` are marked and labelled by `numbers`.

    `sense` selects the crossings to draw; None draws both.
    """
    section = atlas.cut(kind.source, kind.section, kind.hits[0]).section
    coordinate, period = section_axes(section, atlas)
    for is_stable, direction, points in section_curves(atlas, kind):
        if sense not in (None, direction):
            continue
        line = "-" if direction > 0 or sense else (0, (4, 1.6))
        axes.plot(*points.T, color=BRANCHES[is_stable, 1], linewidth=1.3, linestyle=line, zorder=2)
    connections = connections_of(atlas, kind) if shown is None else shown
    look = colours(connections)
    for c in connections:
        place = section_place(atlas, c)
        axes.plot(*place, "o", color=look[c.name], markeredgecolor="white", markersize=7, zorder=4)
        if numbers and c.name in numbers:
            name_point(axes, numbers[c.name], (float(place[0]), float(place[1])), look[c.name])
    quiet(axes, x=f"{coordinate} on the section" + (" (rad)" if period else ""), y="p / p₀" if period else "momentum")
    if period:
        angle_axis(axes, "x")
    if legend:
        key(axes, CUT_KEY)


CUT_KEY: list[tuple[str, str | dict[str, Any]]] = [
    ("tube out", style.UNSTABLE),
    ("tube in", style.STABLE),
    ("connections", {"color": style.INK, "marker": "o", "linestyle": ""}),
    ("backward", {"color": style.CART, "linestyle": (0, (4, 1.6))}),
]
"""Key of a panel of cuts."""


def placed(atlas: Atlas, orbit: AtlasOrbit, winding: Sequence[int] = ()) -> Array:
    """Return an orbit as a closed curve (M, N), shifted by turns."""
    turns = np.zeros(len(atlas.periods))
    turns[: len(winding)] = winding
    return np.vstack([orbit.samples, orbit.samples[:1]]) + turns * atlas.turn_lengths


def one_of_each(connections: tuple[AtlasConnection, ...]) -> list[AtlasConnection]:
    """Return one connection of positive sense for each colour.

    The others are its images.
    """
    look, kept = colours(connections), {}
    for c in connections:
        if c.sense > 0:
            kept.setdefault(look[c.name], c)
    return list(kept.values())


def row_of(
    atlas: Atlas,
    kind: AtlasKind,
    shown: Sequence[AtlasConnection],
    *,
    numbers: dict[str, str],
    marked: tuple[AtlasConnection, ...] | None = None,
    flat: bool = False,
    share: float = 1.65,
) -> list[Panel | Stack]:
    """Return a row of panels: a kind's cuts, and the flights of `shown` with their numbers.

    Args:
        atlas: with the kind.
        kind: of the connections.
        shown: connections with a panel each.
        numbers: labels by connection name.
        marked: connections on the cuts; all by default.
        flat: True to stack the flights.
        share: width of the flights relative to the cuts.
    """
    look = colours(connections_of(atlas, kind) if marked is None else marked)

    def flight(axes: Axes, connection: AtlasConnection, labelled: bool) -> None:
        draw_flight(axes, atlas, connection, look[connection.name], labelled=labelled)
        turns = ", ".join(f"{turn:+d}" if turn else "0" for turn in connection.winding)
        axes.set_title(f"{numbers[connection.name]}  {connection.transversality_angle:.1f}° [{turns}]", loc="left")

    cuts = Panel(partial(draw_cuts, atlas=atlas, kind=kind, shown=marked, numbers=numbers), 1.0)
    flights = [partial(flight, connection=c, labelled=k == 0 or flat) for k, c in enumerate(shown)]
    if flat:
        return [cuts, Stack(flights, share)]
    return [cuts, *(Panel(draw, share / max(len(flights), 1)) for draw in flights)]


def draw_flight(axes: Axes, atlas: Atlas, connection: AtlasConnection, colour: str, *, labelled: bool = True) -> None:
    """Draw a flight with both orbits in the plane of coordinates.

    It starts at its source's named position.
    """
    for saddle, winding in ((connection.source, ()), (connection.target, connection.winding)):
        orbit = next(o for o in atlas.orbits if o.saddle == saddle)
        closed = placed(atlas, orbit, winding)
        axes.plot(closed[:, 0], closed[:, 1], color=style.saddle_colour(saddle), linewidth=3.5, alpha=0.45, zorder=1)
        centre = next(p.state for p in atlas.points if p.name == saddle) + closed[0] - orbit.samples[0]
        axes.plot(centre[0], centre[1], "+", color=style.INK, markersize=7, zorder=1)
    axes.plot(connection.states[:, 0], connection.states[:, 1], color=colour, linewidth=1.3, zorder=3)
    axes.plot(*connection.state[:2], "o", color=colour, markeredgecolor="white", markersize=6, zorder=4)
    quiet(axes)
    x, y = (label.partition(" ")[0] for label in atlas.labels[:2])
    axes.set_xlabel(x, fontsize=style.SMALL)
    axes.set_ylabel(y if labelled else "", fontsize=style.SMALL)
    for which, period in zip("xy", atlas.periods, strict=False):
        if np.isfinite(period):
            angle_axis(axes, which, step=1.0)
    # Turns of the inner arm alone are wide and flat, so their panels are lower.
    flat = connection.source == connection.target and not connection.winding[-1]
    axes.set_aspect("equal", adjustable="box" if flat else "datalim", anchor="W")


def draw_angles(axes: Axes, atlas: Atlas, connection: AtlasConnection) -> None:
    """Draw both angles over time, with the section crossing at zero."""
    for arm in range(len(atlas.periods) // 2):
        axes.plot(connection.times, connection.states[:, arm], color=style.arm_colour(arm), linewidth=1.3)
    for time in (-connection.time_out, connection.time_in):
        if np.isfinite(time):
            axes.axvline(time, color=style.REFERENCE, linewidth=0.9, linestyle=style.DOTTED)
    quiet(axes)
    axes.margins(x=0)
    angle_axis(axes, "y", step=1.0)


FLIGHT = style.INK


def draw_space(
    axes: Axes,
    atlas: Atlas,
    cuts: Iterable[AtlasCut],
    *,
    one_colour: str | None = None,
    flights: tuple[AtlasConnection, ...] = (),
    steps: tuple[float, float] = (1.0, 1.0),
    sense: int | None = None,
    saddles: tuple[str, ...] | None = None,
) -> None:
    """Draw the tubes of cuts, all orbits, and flights in space.

    The axes have ticks every `steps` half turns.

    Flights start at their source's named position. If they end whole turns away, the target orbit is drawn there.

    Args:
        sense: sense of the branches' final crossings; None draws both.
        saddles: saddles of the orbits to draw.
    """
    picked = [0, 1, len(atlas.periods) // 2]
    for tube in (part for cut in cuts for part in tubes_of_cut(atlas, cut) if sense in (None, part.sense)):
        for states in tube.strands:
            axes.plot(*states[:, picked].T, color=tube.colour, linewidth=0.5, alpha=0.8)
        for states in tube.ends:
            axes.plot(*states[:, picked].T, color=style.CUT, linewidth=1.6)
    ends = sorted({(c.target, c.winding) for c in flights if any(c.winding)})
    for c in flights:
        axes.plot(*c.states[:, picked].T, color=FLIGHT, linewidth=0.9, alpha=0.9, zorder=8)
    for orbit in (o for o in atlas.orbits if saddles is None or o.saddle in saddles):
        colour = one_colour or style.saddle_colour(orbit.saddle)
        axes.plot(*placed(atlas, orbit)[:, picked].T, color=colour, linewidth=2.5, zorder=10)
        for winding in (w for saddle, w in ends if saddle == orbit.saddle and orbit.family == 0):
            axes.plot(*placed(atlas, orbit, winding)[:, picked].T, color=colour, linewidth=1.6, alpha=0.6, zorder=9)
    quiet_space(axes, atlas, steps=steps)


def draw_atlas(atlas: Atlas) -> Figure:
    """Return the atlas on one page.

    It shows tubes, orbits and flights in space, and the cuts of every kind.
    """
    kinds = [kind for kind in atlas.kinds if connections_of(atlas, kind)]
    orbits = "1 orbit" if len(atlas.orbits) == 1 else f"{len(atlas.orbits)} orbits"
    title = f"{atlas.title} at {atlas.energy:g}{atlas.unit('J')}: {orbits}, {len(atlas.connections)} connections"
    page = Page(title)
    spaces: list[Panel | Stack] = [Panel(partial(_draw_whole, atlas=atlas), space=True)]
    panels = [partial(_draw_kind, atlas=atlas, kind=kind) for kind in kinds]
    if len(panels) > 1:
        spaces.append(Stack(panels[:2]))
        page.row(*spaces, height=6.4)
    else:
        page.row(*spaces, *panels, height=5.2)
    for first in range(2, len(panels), 2):
        page.row(*panels[first : first + 2], height=3.2)
    return page.figure()


def _draw_whole(axes: Axes, atlas: Atlas) -> None:
    draw_space(axes, atlas, atlas.cuts, flights=atlas.connections)
    looks: list[tuple[str, str | dict[str, Any]]] = [("tubes out", style.UNSTABLE), ("tubes in", style.STABLE)]
    looks += [("cuts", style.CUT), ("connections", FLIGHT)]
    key(axes, looks)
    for k, orbit in enumerate(atlas.orbits):
        look = {"fontsize": style.SMALL, "color": style.saddle_colour(orbit.saddle), "weight": "bold"}
        axes.text2D(0.0, 0.04 * k, f"orbit about {orbit.name}", transform=axes.transAxes, **look)  # type: ignore[attr-defined]
    axes.set_box_aspect(None, zoom=1.1)  # type: ignore[call-arg]


def _draw_kind(axes: Axes, atlas: Atlas, kind: AtlasKind) -> None:
    draw_cuts(axes, atlas, kind)
    quiet_title = f"{kind.source} → {kind.target}: {kind.count} at hits {list(kind.hits)}"
    axes.set_title(quiet_title, loc="left")


TIMELINE = "time_from_section"
"""Time from the section crossing, s, the same for all flights."""
_DARK = [18, 20, 24]
_MOMENTS = 240


def write_atlas_recording(atlas: Atlas, path: Path) -> None:
    """Write the recording of an atlas to `path` (`*.rrd`) with its blueprint.

    Raises:
        InputError: the recording cannot be written.
    """
    shown = _Shown(atlas)
    name = f"{atlas.model} at {atlas.energy:g}{atlas.unit('J')}"
    with recording_to(path, name, _blueprint(atlas, shown), _summary(atlas)) as recording:
        for cut in atlas.cuts:
            for tube in tubes_of_cut(atlas, cut):
                side, way = "stable" if tube.stable else "unstable", "plus" if tube.branch > 0 else "minus"
                word = f"{_home(cut)}/{side}_{way}"
                _space(recording, word, shown, tube.strands, tube.colour, width=0.4, alpha=110)
                _space(recording, f"{word}/cut", shown, tube.ends, style.CUT, width=0.8)
        for orbit in atlas.orbits:
            lifts = {(0,) * shown.rate} | {c.winding for c in atlas.connections if c.target == orbit.saddle}
            copies = [placed(atlas, orbit, winding) for winding in sorted(lifts)]
            labels = [orbit.name, *[""] * (len(copies) - 1)]
            home, colour = f"space/orbits/{_plain(orbit.name)}", style.saddle_colour(orbit.saddle)
            _space(recording, home, shown, copies, colour, width=2.5, labels=labels)
        for kind in atlas.kinds:
            if connections_of(atlas, kind):
                _section(recording, atlas, kind)
                _flights(recording, shown, connections_of(atlas, kind), _key(kind))


class _Shown:
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


def _space(
    recording: rr.RecordingStream, home: str, shown: _Shown, curves: Sequence[Array], colour: str, *, width: float,
    alpha: int = 255, **look: Any,
) -> None:  # fmt: skip
    if curves:
        tints = [(*style.rgb(colour), alpha)]
        places = [shown.places(states) for states in curves]
        drawn = rr.LineStrips3D(places, colors=tints, radii=rr.Radius.ui_points(width), **look)
        recording.log(home, drawn, static=True)


def _key(kind: AtlasKind) -> str:
    return f"{kind.source}_to_{kind.target}_{kind.hits[0]}_{kind.hits[1]}".replace("-", "_")


def _home(cut: AtlasCut) -> str:
    return f"space/tubes/{_plain(cut.saddle)}/hit_{cut.hit}_{_plain(cut.section.name)}"


def _plain(name: str) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in name)


def _flights(recording: rr.RecordingStream, shown: _Shown, connections: tuple[AtlasConnection, ...], key: str) -> None:
    look = colours(connections)
    for k, c in enumerate(connections):
        home = f"space/connections/{key}/{k + 1}_{_plain(c.name)}"
        _space(recording, home, shown, [c.states], look[c.name], width=0.9, labels=[c.name], show_labels=False)
        times = np.linspace(c.times[0], c.times[-1], _MOMENTS)
        states = np.stack([np.interp(times, c.times, column) for column in c.states.T], axis=1)
        dot = rr.Points3D.from_fields(colors=[style.rgb(look[c.name])], radii=rr.Radius.ui_points(4))
        recording.log(f"{home}/now", dot, static=True)
        columns = rr.Points3D.columns(positions=shown.places(states))
        recording.send_columns(f"{home}/now", indexes=[rr.TimeColumn(TIMELINE, duration=times)], columns=columns)


def _section(recording: rr.RecordingStream, atlas: Atlas, kind: AtlasKind) -> None:
    home = f"sections/{_key(kind)}"
    height, box = _frame(atlas, kind)
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
        recording.log(f"{home}/connections/{k + 1}_{_plain(c.name)}", mark, static=True)


def _frame(atlas: Atlas, kind: AtlasKind) -> tuple[float, Box]:
    """Return the scale of p/p₀ and the cuts' bounding box.

    With this scale the cuts are drawn two thirds as high as wide.

    The factor is needed because the viewer's scales are equal.
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
    where = re.sub(r"angle_(\d)", lambda found: f"θ{chr(ord('₀') + int(found[1]))}", kind.section)
    where = where.replace("2 pi k", "2πk")
    hits = "" if kind.hits == (1, 1) else f", hits {kind.hits[0]} and {kind.hits[1]}"
    return f"{kind.source} → {kind.target}: {'p/p₀' if period else 'momentum'} over {coordinate} at {where}{hits}"


def _summary(atlas: Atlas) -> str:
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


def _blueprint(atlas: Atlas, shown: _Shown) -> rrb.Blueprint:
    axes = ", ".join(atlas.labels[k].partition(" ")[0] for k in (0, 1, len(atlas.labels) // 2))
    eye = shown.centre + np.array([-0.9, -1.3, 0.75]) * shown.size * 1.1
    # Only each saddle's tubes to one section are visible at first; all together would hide everything.
    own = {(k.source, k.section, k.hits[0]) for k in atlas.kinds if k.source == k.target}
    hidden = [_home(c) for c in atlas.cuts if own and (c.saddle, c.section.name, c.hit) not in own]
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
            _, box = _frame(atlas, kind)
            bounds = rrb.VisualBounds2D(x_range=box[:2], y_range=box[2:])
            name, origin = _section_title(atlas, kind), f"/sections/{_key(kind)}"
            sections.append(rrb.Spatial2DView(name=name, origin=origin, visual_bounds=bounds, background=_DARK))
    beside = [rrb.Grid(*sections, grid_columns=1 if len(sections) < 3 else 2)] if sections else []
    left = rrb.Vertical(space, summary_view(), row_shares=[3, 1])
    return page([left, *beside], [1, 1], timeline=TIMELINE)
