"""Figures of tubes and connections: in space, as cuts on a section, and as flights in the plane of the coordinates.

The lab pendulum's tubes, its homoclinic connections of one and more turns and its heteroclinic ones; and the first
connection between L1 and L2 of three bodies, found by the same search.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from dpcontrol.review import style
from dpcontrol.review.figures.page import Gallery, Page
from dpcontrol.review.page import angle_axis, new_figure, quiet, wrapped_runs
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


ENERGY = -0.07
SADDLE = "down-up"


def tubes_page(gallery: Gallery) -> Page:
    """Draw the tubes of Down-Up at -0.07 J up to the section, and their cuts."""
    atlas = gallery.atlas("lab", ENERGY, (1, 1))
    kind = kind_of(atlas, SADDLE, SADDLE)
    assert kind is not None
    figure = new_figure(13.5, 5.8, f"The tubes of the Lyapunov orbit about Down-Up at {ENERGY:g} J, and their cuts")
    space = figure.add_axes((0.06, -0.03, 0.5, 0.98), projection="3d")
    draw_space(space, atlas, hit_of=lambda cut: 1 if cut.section.name == kind.section else None, only=SADDLE,
               one_colour=style.INK)  # fmt: skip
    space.legend(
        handles=[
            Line2D([], [], color=style.UNSTABLE, label="unstable tube, forward branch"),
            Line2D([], [], color=style.PALE_UNSTABLE, label="unstable tube, backward branch"),
            Line2D([], [], color=style.STABLE, label="stable tube, forward branch"),
            Line2D([], [], color=style.PALE_STABLE, label="stable tube, backward branch"),
            Line2D([], [], color=style.INK, linewidth=2.5, label="Lyapunov orbit"),
            Line2D([], [], color=style.CUT, linewidth=2, label="cut on θ₂ = 2πk"),
        ],
        fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(-0.22, 0.97),
    )  # fmt: skip
    axes = figure.add_axes((0.62, 0.1, 0.37, 0.75))
    draw_cuts(axes, atlas, kind)
    return Page(
        figure,
        f"Left: trajectories that leave the Lyapunov orbit about Down-Up at {ENERGY:g} J (red) and that come to it "
        "(green) form tubes; the two shades are the tube's two branches, on which the outer arm turns one way or the "
        "other. They are drawn in the angles and the inner arm's rate as far as the section on which the outer arm "
        "hangs straight down. Right: on that section each tube is a closed curve, q the inner arm's angle, p its "
        f"momentum over p₀. Solid curves are crossed with the outer arm's angle rising, dashed ones with it falling; "
        f"where two of one kind meet lie the {kind.count} homoclinic connections, both senses together.",
        f"The energy is that of the homoclinic connections, {ENERGY:g} J; the paper need not have drawn its tubes at "
        "the same. Both branches of both tubes are drawn, and the section's coordinates are canonical, so that areas "
        "on it are those that the flow keeps. Parameters are the rig's identified ones, which reproduce the paper's "
        "pictures; those it prints do not.",
    )


_MOST = 5


def draw_low(gallery: Gallery) -> Page:
    """Draw Down-Up's homoclinics at -0.07 J."""
    atlas = gallery.atlas("lab", -0.07, (1, 1))
    return _page(
        atlas,
        ["down-up"],
        "Below the energy of Up-Down only the outer arm can turn over.",
        "The search finds its own intersections, without windows set by hand: in each sense two symmetric connections "
        "and a mirror pair, all counted on the torus of angles. Section coordinates are canonical, angles at the "
        "crossings are measured in them.",
    )


def draw_high(gallery: Gallery) -> Page:
    """Draw both saddles' homoclinics at 0.2 J."""
    atlas = gallery.atlas("lab", 0.2, (1, 1))
    return _page(
        atlas,
        ["down-up", "up-down"],
        "At this energy both saddles have orbits: the outer arm turns about Down-Up, the inner arm about Up-Down.",
        "Counts are of first hits on these sections, both senses and mirror images included; cuts that graze the "
        "section are open there, and crossings beyond their ends belong to later hits. A count at a section is not the "
        "number of connections.",
    )


def _page(atlas: Atlas, saddles: list[str], lead: str, differs: str) -> Page:
    tall = 0.7 + 4.3 * len(saddles)
    figure = new_figure(14, tall, f"Homoclinic connections at {atlas.energy:g} J (first hits)")
    grid = figure.add_gridspec(
        len(saddles), 1, left=0.05, right=0.99, top=1 - 0.95 / tall, bottom=0.5 / tall, hspace=0.32
    )
    words = []
    for row, saddle in enumerate(saddles):
        kind = kind_of(atlas, saddle, saddle)
        assert kind is not None
        connections = atlas.between(saddle, saddle)
        kept = one_of_each(connections)[:_MOST]
        # Where the outer arm turns flights are tall, where the inner one does they are wide.
        flat = not kept[0].winding[1]
        draw_row(figure, grid[row, 0], atlas, kind, kept, numbers=numbered(connections, kept), flat=flat)
        symmetric = sum(c.symmetric for c in connections)
        word = "closed" if kind.complete else "open in places"
        words.append(
            f"{saddle}: {kind.count} connections ({symmetric} symmetric, {kind.count - symmetric} in mirror pairs), "
            f"largest residual {max(c.residual for c in connections):.0e}, cuts {word}"
        )
    return Page(
        figure,
        f"{lead} Left: the cuts of the unstable (red) and stable (green) tube; dots of one colour are one connection "
        "and its mirror images, and carry its number. Right: one flight of each colour, of positive sense, in the "
        "plane of the angles (thick and pale: the orbits it leaves and joins; dot: where it passes the section), with "
        f"the angle at which the cuts meet. {'; '.join(words)}.",
        differs,
    )


def numbered(connections: tuple[AtlasConnection, ...], kept: list[AtlasConnection]) -> dict[str, str]:
    """Return the number of each connection by name: that of the kept one of its colour."""
    look = colours(connections)
    number = {look[c.name]: str(k + 1) for k, c in enumerate(kept)}
    return {c.name: number[look[c.name]] for c in connections if look[c.name] in number and np.isfinite(c.point[1])}


HETEROCLINIC_ENERGY = 0.2
PAIRS = (("down-up", "up-down"), ("up-down", "down-up"))


def heteroclinics_page(gallery: Gallery) -> Page:
    """Draw the connections from Down-Up to Up-Down and back at 0.2 J."""
    atlas = gallery.atlas("lab", HETEROCLINIC_ENERGY, (1, 1))
    figure = new_figure(
        14, 9.2, f"Heteroclinic connections between Down-Up and Up-Down at {HETEROCLINIC_ENERGY:g} J (first hits)"
    )
    grid = figure.add_gridspec(2, 1, left=0.05, right=0.99, top=0.89, bottom=0.06, hspace=0.32)
    counts = []
    for row, (source, target) in enumerate(PAIRS):
        kind = kind_of(atlas, source, target)
        assert kind is not None
        shown = atlas.between(source, target)[:4]
        numbers = {c.name: "abcdefgh"[4 * row + k] for k, c in enumerate(shown)}
        draw_row(figure, grid[row, 0], atlas, kind, shown, numbers=numbers, share=1.75)
        counts.append(f"{kind.count} from {source} to {target}")
    return Page(
        figure,
        "On the section both arms are aligned, θ₁ = θ₂ + 2πk. Left: where the unstable tube (red) of the orbit that is "
        "left meets the stable tube (green) of the orbit that is joined. Right: the flights in the plane of the "
        "angles, from the source's named position; pale teal is the orbit about Down-Up, pale violet that about "
        f"Up-Down. {' and '.join(counts)}; those in one direction are those in the other, run backward in time.",
        'The paper\'s heteroclinics "at H = -0.07" cannot exist, since Up-Down has no orbit below its energy of '
        "0.1754 J. Here both directions are drawn, and each connection with its reflection; the unstable tube's cut is "
        "open where its trajectories graze the section.",
    )


_SHOWN = 3
_WORDS = {2: ("Double", "second", "twice", "two"), 3: ("Triple", "third", "three times", "three")}


def draw_double(gallery: Gallery) -> Page:
    """Draw connections of Down-Up at -0.07 J with winding [0, 2], and how they go."""
    return _draw(gallery, 2)


def draw_triple(gallery: Gallery) -> Page:
    """Draw connections of Down-Up at -0.07 J with winding [0, 3], and how they go."""
    return _draw(gallery, 3)


def _draw(gallery: Gallery, turns: int) -> Page:
    # A flight that turns the outer arm twice passes it hanging twice: the unstable tube's second time is the last.
    hits = (turns, 1)
    title, ordinal, times, number = _WORDS[turns]
    atlas = gallery.atlas("lab", ENERGY, hits)
    kind = kind_of(atlas, SADDLE, SADDLE)
    assert kind is not None
    connections = atlas.between(SADDLE, SADDLE)
    repeated = [c for c in connections if tuple(map(abs, c.winding)) == (0, turns) and c.sense > 0]
    # Time reversal moves the section to the other passage, so images of one flight are recognised by its length.
    lengths: dict[float, AtlasConnection] = {}
    for c in sorted(repeated, key=lambda c: (c.time_in + c.time_out, c.name)):
        lengths.setdefault(round(c.time_in + c.time_out, 4), c)
    kept = list(lengths.values())[:_SHOWN] or [c for c in connections if c.sense > 0][:_SHOWN]
    figure = new_figure(14, 8.2, f"{title} homoclinic connections of Down-Up at {ENERGY:g} J (hits {list(hits)})")
    grid = figure.add_gridspec(2, 1, left=0.05, right=0.99, top=0.84, bottom=0.09, hspace=0.3, height_ratios=[1.5, 1])
    names = {c.name: "abc"[k] for k, c in enumerate(kept)}
    draw_row(figure, grid[0, 0], atlas, kind, kept, numbers=names, marked=tuple(kept))
    below = grid[1, 0].subgridspec(1, max(len(kept), 1), wspace=0.15)
    for k, c in enumerate(kept):
        panel = figure.add_subplot(below[0, k])
        draw_angles(panel, atlas, c)
        panel.set_title(f"{names[c.name]}: θ₁ blue, θ₂ orange, against time (s)", fontsize=8.5, loc="left")
    windings = {tuple(int(v) for v in np.abs(c.winding)) for c in connections}
    counts = ", ".join(
        f"{sum(tuple(map(abs, c.winding)) == t for c in connections)} of winding ±{list(t)}" for t in sorted(windings)
    )
    resolved = all(atlas.cut(SADDLE, kind.section, hit).resolved for hit in hits)
    scattered = (
        ""
        if resolved
        else (
            " Trajectories scatter before that crossing and the cut is drawn as far as it could be resolved: more "
            "connections than these exist."
        )
    )
    return Page(
        figure,
        f"Above, left: the cuts of the unstable tube at its {ordinal} crossing of θ₂ = 2πk and of the stable tube at "
        "its first one back, with the connections shown at right: their flights in the plane of the angles, in which "
        f"the outer arm turns {times} before the arms settle about Down-Up again, {number} turns on (dot: the section "
        "at time zero). "
        "Below: both angles against time; dotted lines mark where the flight leaves one orbit and joins the other. "
        f"{'In all' if resolved else 'At least'} {len(connections)} connections were found at these hits: {counts}; "
        "those of smaller winding turn there and back. The cut is in pieces: part of the tube has been torn apart by "
        f"passing near the orbit again.{scattered}",
        "The paper cuts them on θ₂ = 4π and 6π; here the section is that of the single ones, θ₂ = 2πk, at later hits, "
        "so that one section shows how single, double and triple turns follow from each other. On θ₁ = θ₂ `dpcontrol "
        "connect --section aligned` lists them.",
    )


THREE_BODY_ENERGY = -1.5175


def three_body_page(gallery: Gallery) -> Page:
    """Draw L1's and L2's Lyapunov orbits, their tubes to x = 1 - μ, and the first connection from L1 to L2."""
    atlas, system = gallery.atlas("three-body", THREE_BODY_ENERGY, None), gallery.system("three-body")
    kind = kind_of(atlas, "L1", "L2")
    assert kind is not None
    mu = float(system.parameters[0])
    figure = new_figure(
        14, 5.6, f"Three bodies: orbits about L1 and L2 at energy {THREE_BODY_ENERGY:g}, tubes, first connection"
    )
    plane = figure.add_axes((0.045, 0.1, 0.36, 0.76))
    _forbidden(plane, gallery)
    _tubes(plane, atlas, kind.section, kind.hits[0])
    _bodies(plane, atlas, mu)
    plane.legend(
        handles=[
            Line2D([], [], color=style.UNSTABLE, label="unstable tube of L1"),
            Line2D([], [], color=style.STABLE, label="stable tube of L2"),
        ],
        fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=2, borderaxespad=0.2,
    )  # fmt: skip
    cuts = figure.add_axes((0.46, 0.1, 0.22, 0.76))
    draw_cuts(cuts, atlas, kind, numbers={c.name: "ab"[k] for k, c in enumerate(connections_of(atlas, kind)[:2])},
              legend=False)  # fmt: skip
    cuts.set_title(f"cuts on {kind.section.replace('mu', 'μ')}, hits {list(kind.hits)}", fontsize=10, loc="left")
    flight = figure.add_axes((0.72, 0.1, 0.27, 0.76))
    _forbidden(flight, gallery)
    connections = connections_of(atlas, kind)
    look = colours(connections)
    for c in connections[:1]:
        flight.plot(c.states[:, 0], c.states[:, 1], color=look[c.name], linewidth=1.1, zorder=3)
    _bodies(flight, atlas, mu)
    flight.set_title("a  from L1's orbit to L2's" if connections else "none found", fontsize=10, loc="left")
    return Page(
        figure,
        "The planar circular restricted three-body problem in the rotating frame, mass ratio "
        f"{mu:g}, near the smaller primary (dot). Grey: out of reach at this energy. Left: Lyapunov orbits about L1 "
        f"(teal) and L2 (violet), the unstable tube of L1 and the stable tube of L2 up to their crossing number "
        f"{kind.hits[0]} of the line x = 1 - μ. Middle: the cuts there, with the {kind.count} connections found. "
        "Right: the first of them, whole.",
        f"Both tubes pass the line once before they can meet: hits {list(kind.hits)} are the first at which there are "
        "connections from L1 to L2. The code is that of the pendulum; the energy's constant is that of the paper's "
        "appendix. Cuts are open where trajectories of the tube pass close to the smaller primary and are scattered.",
    )


def _forbidden(axes: Axes, gallery: Gallery) -> None:
    system = gallery.system("three-body")
    x, y = np.meshgrid(np.linspace(0.88, 1.12, 240), np.linspace(-0.12, 0.12, 240))
    # At rest in the rotating frame the energy is the effective potential.
    states = np.stack([x, y, 0 * x, 0 * x], axis=-1).reshape(-1, 4)
    potential = system.numeric.hamiltonian(states).reshape(x.shape)
    axes.contourf(x, y, potential, levels=[THREE_BODY_ENERGY, 1e9], colors=["#c4c9cf"])
    quiet(axes)
    axes.grid(False)
    axes.set_xlim(0.89, 1.11)
    axes.set_ylim(-0.11, 0.11)
    axes.set_aspect("equal")
    axes.set_xlabel("x", fontsize=9)
    axes.set_ylabel("y", fontsize=9, labelpad=1)


def _tubes(axes: Axes, atlas: Atlas, section: str, hit: int) -> None:
    for saddle, colour in (("L1", style.UNSTABLE), ("L2", style.STABLE)):
        cut = atlas.cut(saddle, section, hit)
        for strand in cut.strands:
            states = atlas.turned(strand, saddle) if colour == style.STABLE else strand
            axes.plot(states[:, 0], states[:, 1], color=colour, linewidth=0.45, alpha=0.75)


def _bodies(axes: Axes, atlas: Atlas, mu: float) -> None:
    for orbit in atlas.orbits:
        closed = np.vstack([orbit.samples, orbit.samples[:1]])
        axes.plot(closed[:, 0], closed[:, 1], color=style.saddle_colour(orbit.saddle), linewidth=2.4, zorder=5)
        axes.annotate(orbit.saddle, closed[:, :2].max(axis=0), fontsize=9, color=style.saddle_colour(orbit.saddle))
    axes.plot(1 - mu, 0, "o", color=style.INK, markersize=5, zorder=6)
    axes.axvline(1 - mu, color=style.MARK, linewidth=0.8, linestyle=(0, (2, 2)))
