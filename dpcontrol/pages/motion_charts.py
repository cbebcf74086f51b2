"""Charts of the motion: angles, rates, cart and command."""

import numpy as np

from dpcontrol.judge.run_view import RunView
from dpcontrol.pages import style
from dpcontrol.pages.chart import Chart, Line
from dpcontrol.pages.drive_charts import acceleration_chart, limit_lines, use_of
from dpcontrol.pages.ranges import padded


def motion_charts(view: RunView) -> tuple[Chart, ...]:
    """Return the charts of the motion.

    They show angles, rates, and, if they exist, cart and acceleration.
    """
    n = view.arms
    found = [_angles(view), _rates(view)]
    if view.has_cart:
        lines = _followed(view, "", 2 * n, name="cart", label=view.what, colour=style.PLANT)
        shown = padded(np.concatenate([line.values for line in lines if line.role != "detail"]))
        levels = limit_lines(view, 0, side=True)
        look = {"levels": levels, "shown": shown, "hint": _grey(view), **use_of(view, 0)}
        found.append(Chart("cart", "Cart position", "m", lines, **look))
    if view.control is not None:
        found.append(acceleration_chart(view, view.control))
    return tuple(found)


def _grey(view: RunView) -> str:
    return f", {view.against} grey" if view.reference is not None else ""


def _followed(
    view: RunView, key: str, column: int, *, name: str, label: str, colour: str, first: bool = True
) -> tuple[Line, ...]:
    """Return one column of reference, estimate and state.

    The estimate is drawn if it differs from the plant.
    """
    lines = []
    if view.reference is not None:
        lines.append(
            Line(f"{key}1_reference", f"{name} {view.against}", view.against if first else "", view.time,
                 view.reference[:, column], colour, 3.0, role="reference")
        )  # fmt: skip
    if view.estimate is not None and view.what != "estimate":
        values = view.estimate[:, column]
        lines.append(Line(f"{key}2_estimate", f"{name} estimate", "", view.time, values, style.INK, 1.0, role="detail"))
    lines.append(Line(f"{key}3_{view.what}", f"{name} {view.what}", label, view.time, view.state[:, column], colour))
    return tuple(lines)


def _angles(view: RunView) -> Chart:
    lines: list[Line] = []
    for arm in range(view.arms):
        label = f"θ{style.number(arm)} {view.what}"
        look = {"name": f"θ{arm + 1}", "label": label, "colour": style.arm_colour(arm), "first": arm == 0}
        lines += _followed(view, f"arm_{arm + 1}/", arm, **look)
    arms = ": arm 1 blue, arm 2 orange" if view.arms == 2 else ": one colour for each arm"
    # An estimate's key takes the room of the longer title.
    title = "Angles" if view.what == "estimate" else "Angles from hanging"
    return Chart("angles", title, "rad", tuple(lines), half_turns=True, hint=f"{arms}{_grey(view)}")


def _rates(view: RunView) -> Chart:
    lines: list[Line] = []
    for arm in range(view.arms):
        look = {"name": f"ω{arm + 1}", "label": f"ω{style.number(arm)}", "colour": style.arm_colour(arm)}
        lines += _followed(view, f"arm_{arm + 1}/", view.arms + arm, first=False, **look)
    by = ", by differences" if view.differenced else ""
    return Chart("rates", "Rates", "rad/s", tuple(lines), note=by, hint=by)
