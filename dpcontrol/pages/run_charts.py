"""Charts of a motion over time, as descriptions from which both matplotlib and Rerun draw.

They show the motion, the drive, the errors, a reference's mesh, and the estimated parameters.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dpcontrol.control.estimator_settings import MEANS_OF, mean_band, means_of
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.units import prefixed
from dpcontrol.judge.run_view import ACTUAL, RunView, clean
from dpcontrol.logs import Extras
from dpcontrol.pages import style
from dpcontrol.pages.planes import Range, padded
from dpcontrol.references.reference import Reference


@dataclass(frozen=True, eq=False)
class Line:
    """A curve over time.

    Attributes:
        key: path in a recording, below its chart's.
        name: label in the viewer.
        label: label in a page's legend, or "".
        time: (K,) s.
        values: (K,) in SI units, nan at gaps.
        colour: colour of the line.
        width: in points.
        reach: (K,) half width of a band about the line, or None.
        role: "run", or "reference", broad and pale behind the others, or "detail", shown only in the viewer.
        dashed: True to dash it on a page, over another line.
    """

    key: str
    name: str
    label: str
    time: Array
    values: Array
    colour: str
    width: float = 1.3
    reach: Array | None = None
    role: str = "run"
    dashed: bool = False


@dataclass(frozen=True)
class LevelLine:
    """A constant in a chart.

    Its kind is "limit" of the cart, end of the expected "band", or "named" level.
    """

    key: str
    name: str
    value: float
    colour: str
    kind: str


@dataclass(frozen=True, eq=False)
class Chart:
    """Curves over time that share an axis.

    Attributes:
        key: path in a recording, "" for charts only on pages.
        title: the quantity.
        unit: SI unit. "share" is shown in percent, "" is none.
        lines: curves.
        levels: constants.
        shown: initial range of values, or None for all.
        note: rest of the page's title.
        prefixed: False if the unit gets no SI prefix.
        half_turns: True if a page ticks the axis in multiples of π.
        log: True for a logarithmic axis.
    """

    key: str
    title: str
    unit: str
    lines: tuple[Line, ...]
    levels: tuple[LevelLine, ...] = ()
    shown: Range | None = None
    note: str = ""
    prefixed: bool = True
    half_turns: bool = False
    log: bool = False

    @property
    def range(self) -> Range:
        """Initial range of values."""
        return self.shown or padded(np.concatenate([line.values for line in self.lines]))

    @property
    def named(self) -> str:
        """Title in the viewer."""
        return f"{self.title}{f' ({self.unit})' if self.unit else ''}"

    def scaled(self) -> tuple[float, str]:
        """Return the factor from SI units to the unit of a page, such as mrad, and the title with that unit."""
        sizes = [np.abs(self.shown)] if self.shown else [np.abs(line.values) for line in self.lines]
        finite = [size[np.isfinite(size)] for size in sizes]
        largest = max((float(size.max()) for size in finite if size.size), default=0.0)
        fixed_unit = self.half_turns or self.log or not self.prefixed or not self.unit
        scale, unit = (1.0, self.unit) if fixed_unit else prefixed(largest, self.unit)
        if self.unit == "share":
            scale, unit = 100.0, "%"
        return scale, f"{self.title}{f' ({unit})' if unit else ''}{self.note}"


_DRIVEN = {
    "feedforward": ("plan", style.REFERENCE, 3.0, "reference"),
    "command": ("command", style.COMMAND, 1.0, "detail"),
    "applied": ("applied", style.COMMAND, 1.3, "run"),
    ACTUAL: ("plant", style.PLANT, 1.0, "run"),
}
"""Accelerations in drawing order: name, colour, width, role."""
_NIS_LOST = 10.0
"""Multiple of the expected NIS above which an estimate is lost."""
_EXTRA_CHARTS = (
    ("zero_", "zeros", "Encoder zeros", "rad"),
    ("disturbance_", "disturbances", "Disturbances", "rad/s²"),
    ("drive", "drive", "Drive's error", "m/s²"),
    ("friction_", "friction", "Friction's errors", "share"),
    ("dry_", "dry", "Dry friction not in the model, of gravity", "share"),
    ("", "parameters", "Model's errors", "share"),
)
"""Extras that share a chart: beginning of their names, the chart's key, title and unit."""


def motion_charts(view: RunView) -> tuple[Chart, ...]:
    """Return the charts of angles and rates, and, if they exist, of cart and acceleration."""
    n, note = view.arms, ", by differences" if view.differenced else ""
    # An estimate's key takes the room of the longer title.
    title = "Angles" if view.what == "estimate" else "Angles from hanging"
    charts = [
        Chart("angles", title, "rad", _of_arms(view, 0, "θ"), half_turns=True),
        Chart("rates", "Rates", "rad/s", _of_arms(view, n, "ω"), note=note),
    ]
    # The states of n arms have n angles, n rates, and the cart's position and velocity.
    if view.has_cart:
        cart_lines = _followed(view, 2 * n, "", view.what, style.PLANT)
        charts.append(
            Chart("cart", "Cart position", "m", cart_lines, shown=_shown(cart_lines), levels=_limits(view, 0))
        )
    if view.control is not None:
        charts.append(_acceleration(view, view.control))
    return tuple(charts)


def _of_arms(view: RunView, first: int, symbol: str) -> tuple[Line, ...]:
    """Return the lines of a quantity of all arms: of the reference, the estimate and the state.

    Args:
        view: motion to draw.
        first: column of the innermost arm's quantity in the states: 0 for the angles, n for the rates of n arms.
        symbol: symbol of the quantity in labels, such as "θ".
    """
    return tuple(
        line
        for arm in range(view.arms)
        for line in _followed(
            view, first + arm, f"arm_{arm + 1}/", f"{symbol}{style.number(arm)} {view.what}", style.arm_colour(arm)
        )
    )


def _followed(view: RunView, column: int, key: str, label: str, colour: str) -> tuple[Line, ...]:
    """Return the lines of one column of the states: reference, estimate and state, as far as known.

    `view.what` names the drawn states, such as "plant" or "estimate", and `view.against` the reference. The estimate is
    drawn unless it is the state itself. It is then a detail, which only the viewer shows.

    Args:
        view: motion to draw.
        column: column of the states.
        key: beginning of the lines' keys.
        label: label of the state's line.
        colour: colour of the lines.
    """
    time, lines = view.time, []
    if view.reference is not None:
        values, look = view.reference[:, column], {"width": 3.0, "role": "reference"}
        lines.append(Line(f"{key}1_reference", view.against, view.against, time, values, colour, **look))
    if view.estimate is not None and view.what != "estimate":
        values = view.estimate[:, column]
        lines.append(Line(f"{key}2_estimate", "estimate", "", time, values, style.INK, 1.0, role="detail"))
    return (*lines, Line(f"{key}3_{view.what}", label, label, time, view.state[:, column], colour))


def _shown(lines: tuple[Line, ...]) -> tuple[float, float]:
    """Return the initial range of a chart, which holds all its lines except details, with margins."""
    return padded(np.concatenate([line.values for line in lines if line.role != "detail"]))


def _limits(view: RunView, which: int) -> tuple[LevelLine, ...]:
    """Return a limit of the cart as two levels of a chart, none without limits.

    Args:
        view: run or reference.
        which: 0 for position, 1 for velocity, 2 for acceleration.
    """
    if view.limits is None:
        return ()
    return (
        LevelLine("limit_lower", "lower limit", -view.limits[which], style.LIMIT, "limit"),
        LevelLine("limit_upper", "upper limit", view.limits[which], style.LIMIT, "limit"),
    )


def _acceleration(view: RunView, control: dict[str, Array]) -> Chart:
    """Return the chart of the cart's accelerations: plan, command, applied value and the plant's true one, if known.

    Args:
        view: run with the limits.
        control: values (N,) by name, m/s².
    """
    lines = tuple(
        Line(key, name, name, view.time, control[key], colour, width, role=role)
        for key, (name, colour, width, role) in _DRIVEN.items()
        if key in control
    )
    return Chart("acceleration", "Acceleration", "m/s²", lines, shown=_shown(lines), levels=_limits(view, 2))


def check_charts(view: RunView) -> tuple[Chart, ...]:
    """Return the charts of a run's quality, as far as known: errors, energy and NIS, or those of a reference's mesh."""
    of_reference = () if view.source is None else _source_charts(view, view.source)
    charts = (*of_reference[:1], _tracking_error(view), _estimation_error(view), _energy(view), _nis(view))
    return tuple(chart for chart in (*charts, *of_reference[1:]) if chart is not None)


def _source_charts(view: RunView, source: Reference) -> tuple[Chart, ...]:
    """Return two charts of a reference: the cart's velocity, which is limited, and the errors between nodes.

    The errors of direct collocation are known for each interval of the mesh, so their line is a staircase.

    Args:
        view: reference as a motion.
        source: reference with its mesh.
    """
    speed = (Line("cart", "cart", "", view.time, view.state[:, -1], style.PLANT),)
    velocity = Chart("velocity", "Cart velocity", "m/s", speed, shown=_shown(speed), levels=_limits(view, 1))
    title = f"Error between nodes of {len(source.mesh) - 1} intervals of {source.method.name} (scaled)"
    if source.errors is None:
        return velocity, Chart("", f"{title}: the arms are not known", "", ())
    # A logarithmic axis cannot show zero.
    errors = np.where(np.isfinite(source.errors), np.maximum(source.errors, 1e-17), np.nan)
    line = Line("", "", "", np.repeat(source.mesh, 2)[1:-1], np.repeat(errors, 2), style.REFERENCE, 1.1)
    stored = source.max_error_between_nodes
    levels = (LevelLine("", "largest, as stored", stored, style.LIMIT, "named"),) if 0 < stored < np.inf else ()
    return velocity, Chart("", title, "", (line,), levels=levels, log=True)


def _arm_lines(view: RunView, values: Array, width: float, reach: Array | None = None) -> tuple[Line, ...]:
    """Return a line for the angle of each arm, which is a column of values.

    Args:
        view: run with the times.
        values: (N, n) or more columns, rad.
        width: width of the lines, points.
        reach: half widths of bands about the lines, of the same shape; None for no bands.
    """
    return tuple(
        Line(
            f"arm_{arm + 1}",
            f"arm {arm + 1}",
            f"θ{style.number(arm)}",
            view.time,
            values[:, arm],
            style.arm_colour(arm),
            width,
            reach=None if reach is None else reach[:, arm],
        )
        for arm in range(view.arms)
    )


def _tracking_error(view: RunView) -> Chart | None:
    """Return the chart of the angles less those of the reference, rad; None without a reference.

    `view.what` names the drawn states, such as "plant", and `view.against` what they are compared with.
    """
    if view.reference is None:
        return None
    return Chart(
        "tracking_error",
        f"{view.error_name} of the angles",
        "rad",
        _arm_lines(view, view.state - view.reference, 1.1),
        note=f": {view.what} minus {view.against}",
    )


def _estimation_error(view: RunView) -> Chart | None:
    """Return the chart of the estimate's error in the angles, rad, in a band of ±2σ.

    If the truth is unknown, the chart shows the band about zero alone; if that is unknown too, there is no chart.
    """
    error, reach = view.error, None if view.sigma is None else 2 * view.sigma
    if error is None and reach is None:
        return None
    # The large errors at the start are omitted.
    sizes = [np.abs(values[:, : view.arms]) for values in (reach, error) if values is not None]
    largest = max(
        (1.6 * float(np.nanquantile(clean(values), 0.97)) for values in sizes if np.isfinite(values).any()), default=0
    )
    return Chart(
        "estimation_error" if error is not None and reach is not None else "",
        "Estimation error of the angles" if error is not None else "Estimate's ±2σ",
        "rad",
        _arm_lines(view, np.zeros_like(view.state) if error is None else error, 1.0, reach),
        shown=(-(largest or 1e-6), largest or 1e-6),
        note=", ±2σ" if error is not None else "; the truth is not known",
    )


def _energy(view: RunView) -> Chart | None:
    """Return the chart of the pendulum's energy, J, with the energies of the plan's saddles; None if it is not known.

    The chart extends to the nearest saddles above and below, so that the energy can be compared with theirs.
    """
    energy = None if view.energy is None else clean(np.asarray(view.energy, dtype=float))
    if energy is None or not np.isfinite(energy).any():
        return None
    saddles = view.plan.saddle_energies
    levels = [LevelLine(n.replace("-", "_"), n, v, style.saddle_colour(n), "named") for n, v in saddles.items()]
    line = Line("pendulum", "pendulum", "", view.time, energy, style.PLANT, 1.1)
    # The extremes are omitted: they result from the initial error.
    low, high = (float(value) for value in np.nanquantile(energy, [0.005, 0.995]))
    low = max((level for level in saddles.values() if level <= low), default=low)
    high = min((level for level in saddles.values() if level >= high), default=high)
    look: dict[str, Any] = {"shown": padded(np.array([low, high])), "note": ", dashed: the saddles'" * bool(levels)}
    return Chart("energy", "Energy of the pendulum", "J", (line,), tuple(levels), prefixed=False, **look)


def _nis(view: RunView) -> Chart | None:
    """Return the chart of the NIS, as means over windows, with the 95 % range of a consistent estimator.

    The NIS is the square of the innovation in units of its expected covariance, for each measurement. Its expected
    value is the number of measured positions, `view.sensors`. If the means exceed it tenfold, the axis is logarithmic.
    The result is None if the run has no NIS.
    """
    if view.nis is None:
        return None
    updated, (low, high) = np.isfinite(view.nis), mean_band(view.sensors)
    means = means_of(view.nis[updated])
    line = Line("mean", f"mean of {MEANS_OF} updates", "", means_of(view.time[updated]), means, style.ESTIMATE, 1.0)
    highest = float(np.nanquantile(means, 0.98)) if len(means) else 0.0
    # A lost estimate would compress the rest of the axis.
    lost = highest > _NIS_LOST * view.sensors
    return Chart(
        "nis",
        f"NIS, means of {MEANS_OF} updates",
        "",
        (line,),
        levels=(
            LevelLine("least", "least for 95 %", low, style.GOOD, "band"),
            LevelLine("greatest", "greatest for 95 %", high, style.GOOD, "band"),
        ),
        shown=(0.0, _NIS_LOST * view.sensors if lost else max(1.15 * highest, 1.6 * view.sensors)),
        log=lost,
        note=f"; band for 95 %: {low:.1f} to {high:.1f}",
    )


def extra_charts(view: RunView) -> tuple[Chart, ...]:
    """Return the charts of the parameters that the filter estimates beside the state, ±2σ, with known true values."""
    if view.extras is None:
        return ()
    names_left, charts = list(view.extras.names), []
    for prefix, *attributes in _EXTRA_CHARTS:
        names = [name for name in names_left if name.startswith(prefix)]
        names_left = [name for name in names_left if name not in names]
        charts += [_extra_chart(view, view.extras, names, *attributes)] if names else []
    return tuple(charts)


def _extra_chart(view: RunView, extras: Extras, names: list[str], key: str, title: str, unit: str) -> Chart:
    """Return the chart of estimated parameters that share a unit, with bands of ±2σ and their true values if known.

    Args:
        view: run with the true values.
        extras: estimates of the parameters over time.
        names: names of the parameters in this chart.
        key: path of the chart in a recording.
        title: title of the chart.
        unit: unit of the parameters.
    """
    lines: list[Line] = []
    shown_values: list[Array] = []
    for k, name in enumerate(names):
        column, colour = extras.names.index(name), style.RUNS[k % len(style.RUNS)]
        values, reach = clean(extras.values[:, column]), 2 * clean(extras.sigmas[:, column])
        label = name.replace("_", " ") if len(names) > 1 or name != key else ""
        lines.append(Line(name, f"{name} ±2σ", label, extras.time, values, colour, reach=reach))
        # The prior at the start is omitted.
        later_part = slice(len(values) // 4, None)
        shown_values += [values, values[later_part] + reach[later_part], values[later_part] - reach[later_part]]
        if name in view.extra_truth:
            truth = np.broadcast_to(view.extra_truth[name], extras.time.shape)
            lines.append(Line(f"{name}_truth", f"{name} true", "", extras.time, truth, colour, 1.1, dashed=True))
            shown_values.append(truth)
    all_values = np.concatenate(shown_values)
    finite = all_values[np.isfinite(all_values)]
    value_range = padded(np.quantile(finite, [0.01, 0.99])) if finite.size else None
    remark = ", dashed: true" if any(line.dashed for line in lines) else ""
    return Chart(key, title, unit, tuple(lines), shown=value_range, note=f", ±2σ{remark}")


def charts(view: RunView) -> dict[str, Chart]:
    """Return the charts of motion and quality of a run by key, so that runs can be compared chart by chart."""
    return {chart.key: chart for chart in (*motion_charts(view), *check_charts(view))}
