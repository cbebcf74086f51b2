"""Decoding of proved closed walks: section crossings, turns and wraps.

Between the middles of its two stops, each symbol has as many section crossings as its connection, which are
hits_u + hits_s - 1. Heights above the section are enclosed during every step. If a height may vanish, the speed across
the section must have a definite sign, and the sheets before and after determine the number of crossings. In the middle
of each stop, every angle is within half a turn of the walk's lifted saddle, which proves the winding of each symbol. At
the marked crossing, the orbit is nearer to its connection than to any other one of the same kind.
"""

from collections.abc import Sequence
from functools import reduce
from itertools import accumulate, groupby, pairwise
from typing import Any

import numpy as np

from dpcontrol.dynamics.propagator import Section
from dpcontrol.proofs.balls import NotClosed, ball, flint
from dpcontrol.proofs.charts import ChartSegment, Surface, Vector, dot
from dpcontrol.tubes.connections import Connection
from dpcontrol.walks.shadowing import ShadowingOrbit, phase_gap


def crossings(surface: Surface, section: Section, spans: Sequence[Vector]) -> int:
    """Return the number of valid section crossings of enclosed steps.

    Raises:
        NotClosed: the enclosures are too wide to count.
    """
    normal = [ball(v) for v in section.normal]
    length = section.period and (2 * flint.arb.pi() if section.period == 2 * np.pi else ball(section.period))

    def sheet(box: Vector) -> int | None:
        height = dot(normal, box) - ball(section.offset)
        if length is None:
            return int(bool(height > 0)) if not height.contains(0) else None
        floor = (height / length).floor()
        return int(floor.unique_fmpz()) if floor.unique_fmpz() is not None else None

    def admitted(box: Vector) -> bool | None:
        if section.side is None:
            return True
        beyond = dot([ball(v) for v in section.side], box) - ball(section.middle)
        reach = ball(section.reach or 0.0)
        beyond = beyond if section.reach is None else abs(beyond)
        return True if beyond > reach else False if beyond <= reach else None

    count, before = 0, None
    for clean, group in groupby(zip(map(sheet, spans), spans, strict=True), key=lambda one: one[0] is not None):
        run = list(group)
        if clean:
            sheets = [one[0] for one in run]
            if any(a != b for a, b in pairwise(sheets)):
                raise NotClosed("a step's enclosure jumps over a section")
            if before is not None:
                count += _passed(surface, normal, before, run[0][0], admitted)
            before = (run[0][0], [])
        elif before is None:
            raise NotClosed(f"the trajectory begins on the section {section.name}")
        else:
            before = (before[0], [box for _, box in run])
    if before is not None and before[1]:
        raise NotClosed(f"the trajectory ends on the section {section.name}")
    return count


def _passed(surface: Surface, normal: Vector, before: Any, after: Any, admitted: Any) -> int:
    """Return the number of valid crossings in boxes between two sheets."""
    sheet, boxes = before
    inside = [admitted(box) for box in boxes]
    if boxes and not any(one is not False for one in inside):
        return 0
    speeds = [dot(normal, surface.field.rate(box)[0]) for box in boxes]
    signed = all(v > 0 for v in speeds) or all(v < 0 for v in speeds)
    if not signed or not all(inside):
        raise NotClosed("the enclosures do not determine the number of section crossings")
    return abs(after - sheet)


def decoded(
    surface: Surface, walk: ShadowingOrbit, segments: Sequence[ChartSegment], rivals: Sequence[Connection]
) -> list[dict[str, Any]]:
    """Return the decoded symbols of a closed walk from enclosed segments.

    Raises:
        NotClosed: the enclosures do not prove that the orbit follows its symbols.
    """
    count, lasts, nodes = len(walk.connections), walk.shot.guess.joints, sorted(walk.shot.guess.markers)
    total = sum((one.time for one in segments), flint.arb(0))
    starts = [flint.arb(0), *accumulate(one.time for one in segments)]
    stays = [
        (starts[nodes[(k + 1) % count]] - starts[nodes[k]]) + (total if k + 1 == count else 0) for k in range(count)
    ]
    out = []
    for k, connection in enumerate(walk.connections):
        where = f"symbol {k + 1} of {count}"
        first = lasts[k - 1] + 1 if k else 0
        spans = [box for one in segments[first : lasts[k] + 1] for _, _, box in one.spans]
        try:
            times = crossings(surface, connection.section, spans)
        except NotClosed as error:
            raise NotClosed(f"{where}: {error}") from error
        if times != sum(connection.hits) - 1:
            raise NotClosed(f"{where}: its section is crossed {times} times instead of {sum(connection.hits) - 1}")
        _check_turns(surface, walk, k, segments[lasts[k]].spans, where)
        _check_nearest(walk, k, segments[nodes[k]].spans[0][2], rivals, where)
        after = walk.connections[(k + 1) % count]
        spare = (stays[k] - ball(connection.time_in) - ball(after.time_out)) / ball(connection.target.period)
        wraps = (spare - ball(phase_gap(connection, after)) + flint.arb(1) / 2).floor().unique_fmpz()
        if wraps is None or int(wraps) != walk.wraps[k]:
            raise NotClosed(f"{where}: the enclosure of its stop's duration does not determine {walk.wraps[k]} wraps")
        found = {"symbol": connection.name, "section": connection.section.name, "crossings": times}
        out.append({**found, "wraps": int(wraps)})
    return out


def _check_turns(surface: Surface, walk: ShadowingOrbit, k: int, spans: Sequence[Any], where: str) -> None:
    """Check the whole turns at the stop after symbol k."""
    connection = walk.connections[k]
    lift = surface.lift([int(v) for v in walk.offsets[k + 1]])
    box = spans[len(spans) // 2][2]
    for value, centre, turn, turning in zip(box, connection.target.centre, lift, surface.turns, strict=True):
        if turning and not abs(value - ball(float(centre)) - turn) < flint.arb.pi():
            raise NotClosed(f"{where}: the whole turns up to the next stop differ from those of the walk")


def _check_nearest(walk: ShadowingOrbit, k: int, box: Vector, rivals: Sequence[Connection], where: str) -> None:
    """Check that symbol k's connection is the nearest on its section."""
    own, system = walk.connections[k], walk.shot.guess.system
    state = [x - ball(float(t)) for x, t in zip(box, walk.offsets[k] * system.turn_lengths, strict=True)]

    def apart(other: Connection) -> Any:
        parts = zip(state, other.state, system.scale, strict=True)
        return reduce(lambda a, b: a.max(b), (abs(x - ball(float(c))) / ball(float(s)) for x, c, s in parts))

    kind = (own.source.saddle, own.target.saddle, own.winding, own.section)
    for other in rivals:
        same = (other.source.saddle, other.target.saddle, other.winding, other.section) == kind
        if same and other.name != own.name and not apart(own) < apart(other):
            raise NotClosed(f"{where}: the orbit is not nearer to {own.name} than to {other.name}")
