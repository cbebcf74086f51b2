"""Cuts of two tubes on their section, with the connections where they meet: one panel of several figures."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from dpcontrol.review import style
from dpcontrol.review.panel_frame import angle_axis, quiet, wrapped_runs
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
