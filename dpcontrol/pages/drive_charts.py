"""Charts of the drive: the cart's acceleration and velocity, with their limits."""

from typing import Any

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.run_view import ACTUAL, RunView
from dpcontrol.pages import style
from dpcontrol.pages.chart import Chart, LevelLine, Line
from dpcontrol.pages.ranges import padded, spans

DRIVEN = {
    "feedforward": ("plan", style.REFERENCE, 3.0, "reference"),
    "command": ("command", style.COMMAND, 1.0, "detail"),
    "applied": ("applied", style.COMMAND, 1.3, "run"),
    ACTUAL: ("plant", style.PLANT, 1.0, "run"),
}
"""Accelerations in drawing order: name, colour, width, role."""


def use_of(view: RunView, which: int) -> dict[str, Any]:
    """Return a limit of the cart and its use by a reference.

    Both are fields of a chart.

    Args:
        view: run or reference.
        which: 0 for position, 1 for velocity, 2 for acceleration.
    """
    used = None if view.source is None else view.source.uses[which].largest
    return {"bound": None if view.limits is None else view.limits[which], "used": used}


def limit_lines(view: RunView, which: int, *, side: bool = False) -> tuple[LevelLine, ...]:
    """Return one of the cart's limits as levels.

    The levels are named by their side of the track, or as bounds.

    Args:
        view: run or reference.
        which: 0 for position, 1 for velocity, 2 for acceleration.
        side: True for names by side.
    """
    if view.limits is None:
        return ()
    names = (("limit_left", "left limit"), ("limit_right", "right limit"))
    if not side:
        names = (("least", "least allowed"), ("greatest", "greatest allowed"))
    ends = (-view.limits[which], view.limits[which])
    return tuple(LevelLine(*name, end, style.LIMIT, "limit") for name, end in zip(names, ends, strict=True))


def acceleration_chart(view: RunView, control: dict[str, Array]) -> Chart:
    lines = tuple(
        Line(key, name, name, view.time, control[key], colour, width, role=role)
        for key, (name, colour, width, role) in DRIVEN.items()
        if key in control
    )
    return Chart(
        "acceleration",
        "Acceleration",
        "m/s²",
        lines,
        levels=limit_lines(view, 2),
        cut=tuple(spans(view.time, control.get("saturated", np.zeros(0)) > 0)),
        shown=padded(np.concatenate([line.values for line in lines if line.role != "detail"])),
        hint=f": {', '.join(line.name for line in lines)}",
        **use_of(view, 2),
    )


def velocity_chart(view: RunView) -> Chart | None:
    """Draw a reference's cart velocity, which has a limit.

    For a run the position is enough.
    """
    if view.source is None:
        return None
    values = view.state[:, -1]
    line = Line("cart", "cart", "", view.time, values, style.PLANT)
    look = {"levels": limit_lines(view, 1), "shown": padded(values), **use_of(view, 1)}
    return Chart("velocity", "Cart velocity", "m/s", (line,), **look)
