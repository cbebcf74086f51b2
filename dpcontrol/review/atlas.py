"""An atlas on one page, and as a Rerun recording: tubes, orbits and flights in space, cuts with their connections.

Space is (first coordinate, second, first rate), for arms (θ₁, θ₂, ω₁); in the recording rates are scaled so that the
tubes are about as high as wide. On the sections, (q, p/p₀) with p upwards. Dots move along the flights with time.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from dpcontrol.review import style
from dpcontrol.review.page import angle_axis, new_figure, quiet, wrapped_runs
from dpcontrol.review.rerun_recording import Box, page, reading_lines, recording_to
from dpcontrol.walks.atlas import Atlas, AtlasConnection, AtlasCut, AtlasKind, section_axes

Array = NDArray[np.float64]


BRANCHES = {
    (False, 1): style.UNSTABLE,
    (False, -1): style.PALE_UNSTABLE,
    (True, 1): style.STABLE,
    (True, -1): style.PALE_STABLE,
}
"""(stable, branch): red leaves the orbit, green comes to it; the second branch is pale."""


@dataclass(frozen=True, eq=False)
class TubePart:
    """One branch of a tube in space: trajectories (M, N) up to its section, and where they end (K, N)."""

    stable: bool
    branch: int
    strands: list[Array]
    ends: list[Array]

    @property
    def colour(self) -> str:
        """Of the trajectories."""
        return BRANCHES[self.stable, self.branch]


def section_curves(atlas: Atlas, kind: AtlasKind) -> list[tuple[bool, int, Array]]:
    """Return the cuts of a kind's tubes as runs: (stable, sign of the crossing, points (K, 2) within a period)."""
    found = []
    for stable, saddle, hit in ((False, kind.source, kind.hits[0]), (True, kind.target, kind.hits[1])):
        cut = atlas.cut(saddle, kind.section, hit)
        _, period = section_axes(cut.section, atlas.periods)
        for piece in cut.pieces:
            points = piece.stable_points if stable else piece.points
            closed = np.vstack([points, points[:1]]) if piece.closed else points
            sign = stable_direction(atlas, cut, piece.direction) if stable else piece.direction
            runs = wrapped_runs(closed, (period, None))
            found += [(stable, 1 if sign > 0 else -1, run) for run in runs]
    return found


def section_place(atlas: Atlas, connection: AtlasConnection) -> Array:
    """Return where a connection meets its section (q, p/p₀), q within a period."""
    _, period = section_axes(connection.section, atlas.periods)
    q, p = connection.point
    return np.array([q - (np.rint(q / period) * period if period else 0.0), p])


def tubes_of_cut(atlas: Atlas, cut: AtlasCut) -> list[TubePart]:
    """Return both branches of a saddle's tubes up to a cut: unstable as flown, stable turned around in time."""
    parts = []
    for stable in (False, True):
        for branch in (1, -1):
            strands = list(cut.strands[cut.strand_branches == branch])
            pieces = [piece for piece in cut.pieces if piece.branch == branch]
            closed = [np.vstack([p.states, p.states[:1]]) if p.closed else p.states for p in pieces]
            if stable:
                strands, closed = ([atlas.turned(states, cut.saddle) for states in some] for some in (strands, closed))
            parts.append(TubePart(stable, branch, strands, closed))
    return parts


def kind_of(atlas: Atlas, source: str, target: str) -> AtlasKind | None:
    """Return the last kind searched between two saddles (the one with connections, if any has), or None."""
    kinds = [kind for kind in atlas.kinds if (kind.source, kind.target) == (source, target)]
    return kinds[-1] if kinds else None


def connections_of(atlas: Atlas, kind: AtlasKind) -> tuple[AtlasConnection, ...]:
    """Return the connections of a kind."""
    return tuple(c for c in atlas.between(kind.source, kind.target) if c.hits == kind.hits)


def stable_direction(atlas: Atlas, cut: AtlasCut, direction: int) -> int:
    """Return the sign of a stable tube's crossing of the section, given its unstable image's."""
    normal = np.asarray(cut.section.normal)
    # Turned around in time, a crossing changes sides unless the reverser turns the section over.
    return -direction * int(np.sign(normal @ atlas.reverser @ normal))


def colours(connections: tuple[AtlasConnection, ...]) -> dict[str, str]:
    """Return a colour for each connection by name; images under the mirror (the other sense) share one."""
    chosen: dict[str, str] = {}
    keys: list[tuple[object, ...]] = []
    for c in sorted(connections, key=lambda c: -round(c.transversality_angle, 3)):
        # What a mirror image shares; rounding as coarse as names.
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
) -> None:
    """Draw both tubes' cuts of a kind and mark its connections (those of `shown`), labelled by `numbers`."""
    section = atlas.cut(kind.source, kind.section, kind.hits[0]).section
    coordinate, period = section_axes(section, atlas.periods)
    for is_stable, direction, points in section_curves(atlas, kind):
        line = "-" if direction > 0 else (0, (4, 1.6))
        axes.plot(*points.T, color=BRANCHES[is_stable, 1], linewidth=1.3, linestyle=line, zorder=2)
    connections = connections_of(atlas, kind) if shown is None else shown
    look = colours(connections)
    for c in connections:
        place = section_place(atlas, c)
        axes.plot(*place, "o", color=look[c.name], markeredgecolor="white", markersize=7, zorder=4)
        if numbers and c.name in numbers:
            axes.annotate(
                numbers[c.name], tuple(place), xytext=(5, 5), textcoords="offset points",
                fontsize=8.5, color=look[c.name], weight="bold", zorder=5,
                path_effects=[withStroke(linewidth=2.5, foreground="white")],
            )  # fmt: skip
    quiet(axes)
    axes.set_xlabel(f"{coordinate} on the section" + (" (rad)" if period else ""), fontsize=9)
    axes.set_ylabel("p / p₀" if period else "momentum", fontsize=9)
    if period:
        angle_axis(axes, "x")
    if legend:
        axes.legend(
            handles=[
                Line2D([], [], color=style.UNSTABLE, label=f"unstable tube of {kind.source}"),
                Line2D([], [], color=style.STABLE, label=f"stable tube of {kind.target}"),
                Line2D([], [], color=style.INK, marker="o", linestyle="", label="connections"),
                Line2D([], [], color=style.CART, linestyle=(0, (4, 1.6)), label="crossed backward"),
            ],
            fontsize=7.5, labelspacing=0.2, frameon=False, loc="lower left", bbox_to_anchor=(-0.02, 0.995),
            ncols=2, borderaxespad=0.2, handlelength=1.6, columnspacing=0.8, handletextpad=0.4,
        )  # fmt: skip


def one_of_each(connections: tuple[AtlasConnection, ...]) -> list[AtlasConnection]:
    """Return one connection of each colour, of the positive sense: the others are its images."""
    look, kept = colours(connections), {}
    for c in connections:
        if c.sense > 0:
            kept.setdefault(look[c.name], c)
    return list(kept.values())


def draw_row(
    figure: Figure,
    cell: SubplotSpec,
    atlas: Atlas,
    kind: AtlasKind,
    shown: Sequence[AtlasConnection],
    *,
    numbers: dict[str, str],
    marked: tuple[AtlasConnection, ...] | None = None,
    flat: bool = False,
    share: float = 1.65,
) -> list[Axes]:
    """Draw a kind's cuts left and the flights of `shown` right, each under its number; return the flights' axes.

    numbers: by connection's name. marked: on the cuts, all connections if not given. flat: flights one below the other.
    share: width of the flights over that of the cuts.
    """
    left, right = cell.subgridspec(1, 2, wspace=0.1, width_ratios=[1, share])
    draw_cuts(figure.add_subplot(left), atlas, kind, shown=marked, numbers=numbers)
    count = max(len(shown), 1)
    flights = right.subgridspec(*((count, 1) if flat else (1, count)), wspace=0.27, hspace=0.75)
    look = colours(connections_of(atlas, kind) if marked is None else marked)
    drawn = []
    for k, c in enumerate(shown):
        axes = figure.add_subplot(flights[k, 0] if flat else flights[0, k])
        draw_flight(axes, atlas, c, look[c.name], labelled=k == 0 or flat)
        turns = ", ".join(f"{turn:+d}" if turn else "0" for turn in c.winding)
        title = f"{numbers[c.name]}  {c.transversality_angle:.1f}°, winding [{turns}]"
        axes.set_title(title, fontsize=9 if count < 5 else 7.5, loc="left", color=look[c.name])
        drawn.append(axes)
    return drawn


def draw_flight(axes: Axes, atlas: Atlas, connection: AtlasConnection, colour: str, *, labelled: bool = True) -> None:
    """Draw a flight in the plane of the first two coordinates, from its source's named place, with both orbits."""
    n = len(atlas.periods) // 2
    lift = atlas.turn_lengths
    turns = np.concatenate([np.asarray(connection.winding, dtype=float), np.zeros(n)])
    for saddle, offset in ((connection.source, 0 * turns), (connection.target, turns)):
        orbit = next(o for o in atlas.orbits if o.saddle == saddle)
        closed = np.vstack([orbit.samples, orbit.samples[:1]]) + offset * lift
        axes.plot(closed[:, 0], closed[:, 1], color=style.saddle_colour(saddle), linewidth=3.5, alpha=0.45, zorder=1)
        centre = next(p.state for p in atlas.points if p.name == saddle) + offset * lift
        axes.plot(centre[0], centre[1], "+", color=style.INK, markersize=7, zorder=1)
    axes.plot(connection.states[:, 0], connection.states[:, 1], color=colour, linewidth=1.3, zorder=3)
    axes.plot(*connection.state[:2], "o", color=colour, markeredgecolor="white", markersize=6, zorder=4)
    quiet(axes)
    if np.isfinite(atlas.periods).any():
        angle_axis(axes, "x", step=1.0)
        angle_axis(axes, "y", step=1.0)
        axes.set_xlabel("θ₁", fontsize=9, labelpad=1)
        if labelled:
            axes.set_ylabel("θ₂", fontsize=9, labelpad=1)
    # Turns of the inner arm alone are wide and flat: their panels shrink to them.
    flat = connection.source == connection.target and not connection.winding[-1]
    axes.set_aspect("equal", adjustable="box" if flat else "datalim", anchor="W")


def draw_angles(axes: Axes, atlas: Atlas, connection: AtlasConnection) -> None:
    """Draw both angles against the time from the section."""
    for arm in range(len(atlas.periods) // 2):
        axes.plot(connection.times, connection.states[:, arm], color=style.arm_colour(arm), linewidth=1.3)
    for time in (-connection.time_out, connection.time_in):
        if np.isfinite(time):
            axes.axvline(time, color=style.REFERENCE, linewidth=0.9, linestyle=(0, (2, 2)))
    quiet(axes)
    axes.margins(x=0)
    angle_axis(axes, "y", step=1.0)


FLIGHT = style.INK


def draw_space(
    axes: Axes,
    atlas: Atlas,
    *,
    hit_of: Callable[[AtlasCut], int | None],
    only: str | None = None,
    one_colour: str | None = None,
    flights: tuple[AtlasConnection, ...] = (),
) -> None:
    """Draw the tubes of cuts for which `hit_of` gives a hit (of one saddle), all orbits, and flights, in 3-D axes.

    Flights leave their source's named place; where they end whole turns away, the orbit that they join is drawn there.
    """
    rate = len(atlas.periods) // 2
    for cut in atlas.cuts:
        if hit_of(cut) is None or (only is not None and cut.saddle != only):
            continue
        for tube in tubes_of_cut(atlas, cut):
            for states in tube.strands:
                axes.plot(*states[:, [0, 1, rate]].T, color=tube.colour, linewidth=0.5, alpha=0.8)
            for states in tube.ends:
                axes.plot(*states[:, [0, 1, rate]].T, color=style.CUT, linewidth=1.6)
    for orbit in atlas.orbits:
        closed = np.vstack([orbit.samples, orbit.samples[:1]])
        colour = one_colour or style.saddle_colour(orbit.saddle)
        axes.plot(*closed[:, [0, 1, rate]].T, color=colour, linewidth=2.5, zorder=10)
    for c in flights:
        axes.plot(*c.states[:, [0, 1, rate]].T, color=FLIGHT, linewidth=0.9, alpha=0.9, zorder=8)
    samples = {orbit.saddle: orbit.samples for orbit in atlas.orbits if orbit.family == 0}
    for saddle, winding in sorted({(c.target, c.winding) for c in flights if any(c.winding)}):
        copy = samples[saddle] + np.r_[np.asarray(winding, float), np.zeros(rate)] * atlas.turn_lengths
        colour = one_colour or style.saddle_colour(saddle)
        axes.plot(*np.vstack([copy, copy[:1]])[:, [0, 1, rate]].T, color=colour, linewidth=1.6, alpha=0.6, zorder=9)
    angular = bool(np.isfinite(atlas.periods).any())
    for which, label in (("x", "θ₁ (rad)" if angular else "x"), ("y", "θ₂ (rad)" if angular else "y")):
        getattr(axes, f"set_{which}label")(label, fontsize=9)
        if angular:
            angle_axis(axes, which, step=0.25 if which == "x" and only else 1.0)
    axes.set_zlabel("ω₁ (rad/s)" if angular else "x rate", fontsize=9)  # type: ignore[attr-defined]
    axes.view_init(elev=22, azim=-122)  # type: ignore[attr-defined]
    axes.tick_params(labelsize=8, colors=style.CART)


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
