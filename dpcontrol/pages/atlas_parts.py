"""Parts of an atlas to draw.

They are tubes, curves on the section, places and colours of connections.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.pages import style
from dpcontrol.pages.panels import wrapped_runs
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

    Args:
        atlas: atlas with the kind.
        kind: kind of connection.
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

    Args:
        atlas: atlas with the connection.
        connection: connection with a section.
    """
    _, period = section_axes(connection.section, atlas)
    q, p = connection.point
    return np.array([q - (np.rint(q / period) * period if period else 0.0), p])


def tubes_of_cut(atlas: Atlas, cut: AtlasCut) -> list[TubePart]:
    """Return both branches of a saddle's tubes up to a cut.

    The stable tube is found by time reversal.

    Args:
        atlas: atlas with the cut.
        cut: cut of the saddle's tubes.
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


def kind_of(atlas: Atlas, source: str, target: str) -> AtlasKind:
    """Return the last kind searched between two saddles.

    A search ends with the first kind that has connections.

    Args:
        atlas: atlas with the kinds.
        source: saddle that the connections leave.
        target: saddle that they join.
    """
    return [kind for kind in atlas.kinds if (kind.source, kind.target) == (source, target)][-1]


def connections_of(atlas: Atlas, kind: AtlasKind) -> tuple[AtlasConnection, ...]:
    """Return the connections of a kind.

    Args:
        atlas: atlas with the kind.
        kind: kind of connection.
    """
    return tuple(c for c in atlas.between(kind.source, kind.target) if c.hits == kind.hits)


def stable_direction(atlas: Atlas, cut: AtlasCut, direction: int) -> int:
    """Return the sign of a stable tube's crossing of the section.

    It follows from its unstable image's.

    Args:
        atlas: atlas with the cut.
        cut: cut of the saddle's tubes.
        direction: sign of the unstable image's crossing.
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


def placed(atlas: Atlas, orbit: AtlasOrbit, winding: Sequence[int] = ()) -> Array:
    """Return an orbit as a closed curve (M, N), shifted by turns.

    Args:
        atlas: atlas with the orbit.
        orbit: orbit to shift.
        winding: whole turns of each coordinate; none by default.
    """
    turns = np.zeros(len(atlas.periods))
    turns[: len(winding)] = winding
    return np.vstack([orbit.samples, orbit.samples[:1]]) + turns * atlas.turn_lengths
