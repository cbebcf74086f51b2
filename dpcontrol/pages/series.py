"""The story of a run for all renderers: charts over time, strips of the planned and flown itinerary, phase planes.

The viewer's recording (`rerun_recording`) and the drawn page (`page`) show the same story. Values are in SI units;
pages add prefixes.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.estimator_settings import MEANS_OF, mean_band, means_of
from dpcontrol.control.margins import Margins
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.units import prefixed
from dpcontrol.judge.run_view import ACTUAL, RunView, Stay, clean
from dpcontrol.logs import LAP, RESUME, RETURN, START, Mode
from dpcontrol.pages import style

Range = tuple[float, float]

NIS_LOST = 10.0
"""Multiple of the expected NIS above which an estimate is lost."""
_MOST = 20_000
"""Number of points of a run in a phase plane."""
DRIVEN = {
    "feedforward": ("plan", style.REFERENCE, 3.0),
    "command": ("command", style.COMMAND, 1.0),
    "applied": ("applied", style.COMMAND, 1.3),
    ACTUAL: ("plant", style.PLANT, 1.0),
}
"""Accelerations in drawing order: name, colour, width."""


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
        reach: (K,) half width of a band, or None.
        around: True for a band about the line, False about zero.
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
    around: bool = False


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
        cut: (start, end) of each stretch with a limited command, s.
        shown: initial range of values, or None for all.
        bound: limit of the cart that the page's title names, or None.
        used: greatest use of it by a reference, or None for a run.
        note: rest of the page's title.
        hint: rest of the viewer's title, which has no keys.
        prefixed: False if the unit gets no SI prefix.
        half_turns: True if a page ticks the axis in multiples of π.
        log: True for a logarithmic axis.
        legend: True if the viewer shows a legend.
    """

    key: str
    title: str
    unit: str
    lines: tuple[Line, ...]
    levels: tuple[LevelLine, ...] = ()
    cut: tuple[Range, ...] = ()
    shown: Range | None = None
    bound: float | None = None
    used: float | None = None
    note: str = ""
    hint: str = ""
    prefixed: bool = True
    half_turns: bool = False
    log: bool = False
    legend: bool = False

    @property
    def named(self) -> str:
        """Title in the viewer."""
        return f"{self.title}{f' ({self.unit})' if self.unit else ''}{self.hint}"

    def scaled(self) -> tuple[float, str]:
        """Return the factor from SI units to a page's unit, and the page's title."""
        parts = [np.abs(self.shown)] if self.shown else [np.abs(line.values) for line in self.lines]
        finite = [part[np.isfinite(part)] for part in parts]
        largest = max((float(part.max()) for part in finite if part.size), default=0.0)
        plain = self.half_turns or self.log or not self.prefixed or not self.unit
        scale, unit = (1.0, self.unit) if plain else prefixed(largest, self.unit)
        if self.unit == "share":
            scale, unit = 100.0, "%"
        bound = ""
        if self.bound is not None:
            used = "" if self.used is None else f"{scale * self.used:.3g} of "
            bound = f", {used}±{scale * self.bound:.4g}{' used' if used else ''}"
        return 1 / np.pi if self.half_turns else scale, f"{self.title}{f' ({unit})' if unit else ''}{bound}{self.note}"


@dataclass(frozen=True)
class Span:
    """A stretch of a strip, s.

    Its kind is "stay" ("astray" if unplanned), "transfer", "symbol", "motion", "mode" or "ended".
    """

    first: float
    last: float
    text: str
    colour: str
    kind: str


@dataclass(frozen=True)
class Strip:
    """Spans in order of time.

    `key` is the path in a recording, which the viewer sorts alphabetically; `name` is the label on a page, or "".
    """

    key: str
    name: str
    spans: tuple[Span, ...]


@dataclass(frozen=True, eq=False)
class Plane:
    """An arm's phase plane.

    Curves (K, 2) have angles in rad and rates in rad/s, with whole turns counted.

    arm: counted from zero.
    strands: of the tubes, by stability.
    cuts: of the tubes, by stability.
    orbits: closed, with their colours; a single point for an equilibrium.
    run: the stretches between gaps.
    ends: the run's first and last point, (2, 2).
    """

    arm: int
    strands: dict[bool, list[Array]]
    cuts: dict[bool, list[Array]]
    orbits: list[tuple[str, Array]]
    run: list[Array]
    ends: Array


def motion_charts(view: RunView) -> tuple[Chart, ...]:
    """Return the charts of the motion.

    They show angles, rates, and, if they exist, cart and acceleration.
    """
    n = view.arms
    found = [_angles(view), _rates(view)]
    if view.has_cart:
        lines = _followed(view, "", 2 * n, name="cart", label=view.what, colour=style.PLANT)
        shown = padded(np.concatenate([line.values for line in lines if line.role != "detail"]))
        levels = _limits(view, 0, side=True)
        look = {"levels": levels, "shown": shown, "hint": _grey(view), **_use(view, 0)}
        found.append(Chart("cart", "Cart position", "m", lines, **look))
    if view.control is not None:
        found.append(_acceleration(view, view.control))
    return tuple(found)


def check_charts(view: RunView) -> tuple[Chart, ...]:
    """Return the charts of the run's quality, as far as known.

    They show errors, energy and NIS, or a reference's mesh.
    """
    makers = (_velocity, _tracking_error, _estimation_error, _energy, _nis, _mesh, _node_errors)
    return tuple(chart for make in makers if (chart := make(view)) is not None)


EXTRA_CHARTS = (
    ("zero_", "zeros", "Encoder zeros", "rad"),
    ("disturbance_", "disturbances", "Disturbances", "rad/s²"),
    ("drive", "drive", "Drive's error", "m/s²"),
    ("friction_", "friction", "Friction's errors", "share"),
    ("dry_", "dry", "Dry friction not in the model, of gravity", "share"),
    ("", "parameters", "Model's errors", "share"),
)
"""Extras that share a chart: beginning of their names, the chart's key, title and unit."""


def extra_charts(view: RunView) -> tuple[Chart, ...]:
    """Return the charts of the estimated parameters, ±2σ.

    The truth is added if it is known.
    """
    extras, found = view.extras, []
    left = {} if extras is None else dict.fromkeys(extras.names)
    for begins, key, title, unit in EXTRA_CHARTS:
        names = [name for name in left if name.startswith(begins)]
        for name in names:
            del left[name]
        if extras is None or not names:
            continue
        lines: list[Line] = []
        truths: list[Line] = []
        reaches: list[Array] = []
        for k, name in enumerate(names):
            column, colour = extras.names.index(name), style.RUNS[k % len(style.RUNS)]
            values, reach = clean(extras.values[:, column]), 2 * clean(extras.sigmas[:, column])
            label = name.replace("_", " ") if len(names) > 1 or name != key else ""
            lines.append(Line(name, f"{name} ±2σ", label, extras.time, values, colour, reach=reach, around=True))
            # The prior at the start is omitted.
            late = slice(len(values) // 4, None)
            reaches += [values, values[late] + reach[late], values[late] - reach[late]]
            if name in view.extra_truth:
                truth = np.broadcast_to(view.extra_truth[name], extras.time.shape)
                label, look = "" if truths else "true", {"width": 1.1, "dashed": True}
                truths.append(Line(f"{name}_truth", f"{name} true", label, extras.time, truth, colour, **look))
                reaches.append(truth)
        every = np.concatenate(reaches)
        known = every[np.isfinite(every)]
        shown = padded(np.quantile(known, [0.01, 0.99])) if known.size else None
        look = {"shown": shown, "note": ", ±2σ", "hint": ", band ±2σ", "legend": True}
        found.append(Chart(key, title, unit, (*lines, *truths), **look))
    return tuple(found)


def margins_chart(margins: Margins) -> Chart:
    """Return the loop's margins of gain, delay and lag.

    They belong to the middle of each window along the reference.
    """
    time, least = margins.times + margins.windows / 2, margins.least()
    figures = {name: 1e3 * value if name in ("delay", "lag") else value for name, (value, _) in least.items()}
    gain, delay, lag = style.SERIES[:3]
    lines = (
        Line(
            "low", "least gain", f"gain {figures['gain_low']:.2g}–{figures['gain_high']:.2g}", time, margins.low, gain
        ),
        Line("high", "greatest gain", "", time, margins.high, gain),
        Line("delay", "delay", f"delay {figures['delay']:.3g}", time, 1e3 * margins.delay, delay),
        Line("lag", "lag", f"lag {figures['lag']:.3g}", time, 1e3 * margins.lag, lag),
    )
    return Chart("", "Margins (×, ms)", "", lines, log=True)


def charts(view: RunView) -> dict[str, Chart]:
    """Return all charts by key."""
    return {chart.key: chart for chart in (*motion_charts(view), *check_charts(view))}


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


def _use(view: RunView, which: int) -> dict[str, Any]:
    """Return one of the cart's limits and its use by a reference, as fields of a chart."""
    used = None if view.summary is None else view.summary.uses[which].largest
    return {"bound": None if view.limits is None else view.limits[which], "used": used}


def _limits(view: RunView, which: int, *, side: bool = False) -> tuple[LevelLine, ...]:
    """Return one of the cart's limits as levels.

    They are named by their side of the track, or as bounds.
    """
    if view.limits is None:
        return ()
    names = (("limit_left", "left limit"), ("limit_right", "right limit"))
    if not side:
        names = (("least", "least allowed"), ("greatest", "greatest allowed"))
    ends = (-view.limits[which], view.limits[which])
    return tuple(LevelLine(*name, end, style.LIMIT, "limit") for name, end in zip(names, ends, strict=True))


def _acceleration(view: RunView, control: dict[str, Array]) -> Chart:
    lines = tuple(
        Line(key, name, name, view.time, control[key], colour, width, role=_role(key))
        for key, (name, colour, width) in DRIVEN.items()
        if key in control
    )
    return Chart(
        "acceleration",
        "Acceleration",
        "m/s²",
        lines,
        levels=_limits(view, 2),
        cut=tuple(spans(view.time, control.get("saturated", np.zeros(0)) > 0)),
        shown=padded(np.concatenate([line.values for line in lines if line.role != "detail"])),
        hint=f": {', '.join(line.name for line in lines)}",
        **_use(view, 2),
    )


def _role(key: str) -> str:
    return {"command": "detail", "feedforward": "reference"}.get(key, "run")


def _velocity(view: RunView) -> Chart | None:
    """Draw a reference's cart velocity, which has a limit; for a run the position is enough."""
    if view.summary is None:
        return None
    values = view.state[:, -1]
    line = Line("cart", "cart", "", view.time, values, style.PLANT)
    look = {"levels": _limits(view, 1), "shown": padded(values), **_use(view, 1)}
    return Chart("velocity", "Cart velocity", "m/s", (line,), **look)


def _arm_lines(view: RunView, values: Array, width: float, reach: Array | None = None) -> tuple[Line, ...]:
    """Return a line for each arm's angle of values (K, …), with its reach."""
    return tuple(
        Line(f"arm_{arm + 1}", f"arm {arm + 1}", f"θ{style.number(arm)}", view.time, values[:, arm],
             style.arm_colour(arm), width, reach=None if reach is None else reach[:, arm])
        for arm in range(view.arms)
    )  # fmt: skip


def _tracking_error(view: RunView) -> Chart | None:
    if view.reference is None:
        return None
    lines = _arm_lines(view, view.state - view.reference, 1.1)
    note = f": {view.what} minus {view.against}"
    return Chart("tracking_error", f"{view.error_name} of the angles", "rad", lines, note=note)


def _estimation_error(view: RunView) -> Chart | None:
    """Draw the estimate's error with ±2σ; for an unknown error ±2σ alone."""
    error, reach = view.error, None if view.sigma is None else 2 * view.sigma
    if error is None and reach is None:
        return None
    known = error is not None
    # The large errors at the start are omitted.
    shown = [np.abs(part[:, : view.arms]) for part in (reach, error) if part is not None]
    finite = [part[np.isfinite(part)] for part in shown]
    most = max((1.6 * float(np.quantile(part, 0.97)) for part in finite if part.size), default=0.0) or 1e-6
    return Chart(
        "estimation_error" if known and reach is not None else "",
        "Estimation error of the angles" if known else "Estimate's ±2σ",
        "rad",
        _arm_lines(view, np.full_like(view.state, np.nan) if error is None else error, 1.0, reach),
        shown=(-most, most),
        note=", lines ±2σ" if known else "; the truth is not known",
        hint=", band ±2σ",
    )


def _energy(view: RunView) -> Chart | None:
    energy = None if view.energy is None else clean(np.asarray(view.energy, dtype=float))
    if energy is None or not np.isfinite(energy).any():
        return None
    levels = tuple(
        LevelLine(name.replace("-", "_"), name, value, style.saddle_colour(name), "named")
        for name, value in view.plan.saddle_energies.items()
    )
    line = Line("pendulum", "pendulum", "", view.time, energy, style.PLANT, 1.1)
    # The extremes are omitted: they result from the initial error.
    low, high = (float(value) for value in np.nanquantile(energy, [0.005, 0.995]))
    known = view.plan.saddle_energies.values()
    low = max((level for level in known if level <= low), default=low)
    high = min((level for level in known if level >= high), default=high)
    shown = padded(np.array([low, high]))
    note = ", dashed: the saddles'" if levels else ""
    look = {"levels": levels, "shown": shown, "note": note, "hint": " and saddles", "legend": True}
    return Chart("energy", "Energy of the pendulum", "J", (line,), prefixed=False, **look)


def _nis(view: RunView) -> Chart | None:
    """Draw means of the NIS over windows, and the 95 % range of a consistent estimator."""
    if view.nis is None:
        return None
    time, means = smoothed_nis(view)
    ends = mean_band(view.sensors)
    levels = [
        LevelLine(name, f"{name} for 95 %", value, style.GOOD, "band")
        for name, value in zip(("least", "greatest"), ends, strict=True)
    ]
    highest = float(np.nanquantile(means, 0.98)) if len(means) else 0.0
    # A lost estimate would compress the rest of the axis.
    lost = highest > NIS_LOST * view.sensors
    band = f"{ends[0]:.1f} to {ends[1]:.1f}"
    return Chart(
        "nis",
        f"NIS, means of {MEANS_OF} updates",
        "",
        (Line("mean", f"mean of {MEANS_OF} updates", "", time, means, style.ESTIMATE, 1.0),),
        levels=tuple(levels),
        shown=(0.0, NIS_LOST * view.sensors if lost else max(1.15 * highest, 1.6 * view.sensors)),
        log=lost,
        note=f"; band for 95 %: {band}",
        hint=f"; 95 % belong in {band}",
    )


def _mesh(view: RunView) -> Chart | None:
    if view.summary is None:
        return None
    lengths = np.diff(view.summary.reference.mesh)
    title = f"Mesh: length of {len(lengths)} intervals of {view.summary.reference.method.name}"
    line = _stairs(view, lengths, style.REFERENCE)
    return Chart("", title, "s", (line,), shown=(0.0, 1.15 * float(lengths.max())))


def _node_errors(view: RunView) -> Chart | None:
    if view.summary is None:
        return None
    title = "Error between nodes, measured again (scaled)"
    if view.summary.errors is None:
        return Chart("", f"{title}: the arms are not known", "", ())
    errors = view.summary.errors
    shown = np.where(np.isfinite(errors), np.maximum(errors, 1e-17), np.nan)
    stored = view.summary.reference.max_error_between_nodes
    known = np.isfinite(stored) and stored > 0
    levels = (LevelLine("", "largest, as stored", stored, style.LIMIT, "named"),) if known else ()
    return Chart("", title, "", (_stairs(view, shown, style.REFERENCE),), levels=levels, log=True)


def _stairs(view: RunView, values: Array, colour: str) -> Line:
    """Return a line of one value for each mesh interval.

    Values are (I,), the mesh of the reference (I + 1,).
    """
    assert view.summary is not None
    return Line("", "", "", np.repeat(view.summary.reference.mesh, 2)[1:-1], np.repeat(values, 2), colour, 1.1)


def strips(view: RunView, *, until: float | None = None) -> tuple[Strip, ...]:
    """Return the strips of itinerary, symbols and modes that exist.

    The itinerary has a planned and a flown strip.

    `until` is the planned end of the run, s; the plan's end by default.
    """
    begin, end = view.time_range
    due = view.plan.duration if until is None else until
    stopped = due is not None and end < due - 2 / view.rate_hz
    ended = (Span(end, due, "ended", style.FAINT, "ended"),) if due is not None and stopped else ()
    found = []
    if view.plan.planned:
        between = [Span(a, b, "change of orbit", style.FAINT, "transfer") for a, b in view.plan.transfers]
        name = "near" if view.what == "walk" else "planned"
        found.append(Strip("asked", name, (*_stays(view.plan.planned), *between)))
        if view.what not in ("reference", "walk"):
            found.append(Strip("done", "done", (*_stays(view.done), *ended)))
    if view.plan.symbols:
        moments = [begin, *(at for at, _ in view.plan.symbols), end]
        names = ["before the first", *(f"{k + 1}: {name}" for k, (_, name) in enumerate(view.plan.symbols))]
        tints = [style.FAINT, *(style.RUNS[k % len(style.RUNS)] for k in range(len(view.plan.symbols)))]
        parts = zip(pairwise(moments), names, tints, strict=True)
        found.append(Strip("symbol", "", tuple(Span(a, b, name, tint, "symbol") for (a, b), name, tint in parts)))
    if motions := tuple(_motions(view)):
        found.append(Strip("motion", "motion", motions))
    modes = tuple(Span(a, b, name, style.MODES.get(name, style.FAINT), "mode") for a, b, name in mode_spans(view))
    if modes:
        found.append(Strip("mode", "controller", (*modes, *ended)))
    return tuple(found)


_MOTIONS = {
    RESUME: ("itinerary", style.MODES["holding"]), LAP: ("itinerary", style.MODES["holding"]),
    RETURN: ("return", style.MODES["saturated"]), START: ("start", style.MODES["pulsing"]),
}  # fmt: skip
"""Activity of a run after an event, and its colour."""


def _motions(view: RunView) -> Iterator[Span]:
    """Yield the periods of a run on its itinerary, returning to rest, and starting again."""
    # The first event of a log describes its controller.
    changes = [event for event in view.events if event.name in _MOTIONS and (event.name, event.time) != (START, 0.0)]
    if not any(event.name == RETURN for event in changes):
        return
    ends = [*(event.time for event in changes[1:]), view.time_range[1]]
    for event, end in zip(changes, ends, strict=True):
        if end > event.time:
            yield Span(event.time, end, *_MOTIONS[event.name], "motion")


def _stays(stays: tuple[Stay, ...]) -> Iterator[Span]:
    for stay in stays:
        colour = style.saddle_colour(stay.saddle) if stay.wanted else style.LIMIT
        yield Span(stay.first, stay.last, stay.text, colour, "stay" if stay.wanted else "astray")


def plane(view: RunView, arm: int) -> Plane:
    """Return an arm's phase plane with the plan's orbits and tubes."""
    columns = [arm, view.arms + arm]
    step = max(1, len(view.time) // _MOST)
    walked = view.state[:, columns]
    edges = [0, *view.breaks.tolist(), len(walked)]
    tubes = {stable: [tube for tube in view.plan.tubes if tube.stable == stable] for stable in (False, True)}
    return Plane(
        arm,
        strands={stable: [s[:, columns] for tube in some for s in tube.strands] for stable, some in tubes.items()},
        cuts={stable: [run for tube in some for run in _known(tube.cut[:, columns])] for stable, some in tubes.items()},
        orbits=[
            (style.saddle_colour(orbit.saddle), np.vstack([orbit.states, orbit.states[:1]])[:, columns])
            for orbit in view.plan.orbits
        ],
        run=[run for a, b in pairwise(edges) for run in _known(walked[a:b][::step])],
        ends=walked[[0, -1]],
    )


def _known(points: Array) -> list[Array]:
    """Return the stretches of points (K, 2) between nan ones."""
    known = np.isfinite(points).all(axis=1)
    edges = np.flatnonzero(np.diff(known.astype(int))) + 1
    return [run for run in np.split(points, edges) if len(run) > 1 and np.isfinite(run).all()]


def arm_points(angles: Array, arm_lengths: Sequence[float]) -> Array:
    """Return pivot, elbows and tip relative to the pivot.

    The x axis points right and y up.

    Args:
        angles: (K, n) absolute, from hanging, counter-clockwise; rad.
        arm_lengths: (n,) in m.

    Returns:
        (K, n+1, 2) in m.
    """
    lengths = np.asarray(arm_lengths)
    steps = np.stack([np.sin(angles), -np.cos(angles)], axis=-1) * lengths[:, None]
    return np.concatenate([np.zeros((len(angles), 1, 2)), np.cumsum(steps, axis=1)], axis=1)


def smoothed_nis(view: RunView) -> tuple[Array, Array]:
    """Return times (K,) and means (K,) of the NIS.

    Means are over stretches of ticks with a measurement.
    """
    nis = np.full(len(view.time), np.nan) if view.nis is None else view.nis
    known = np.isfinite(nis)
    return means_of(view.time[known]), means_of(nis[known])


def gap_times(view: RunView) -> Array:
    """Return the middle of each gap in a view's ticks, s."""
    return (view.time[view.breaks] + view.time[view.breaks - 1]) / 2


def spans(time: Array, flags: NDArray[np.bool_]) -> list[Range]:
    """Return start and end in s of each stretch with true flags.

    The `flags` are (N,). A stretch lasts at least a tick.
    """
    padded_flags = np.concatenate([[False], flags, [False]])
    edges = np.flatnonzero(padded_flags[1:] != padded_flags[:-1])
    return [(float(time[a]), float(time[min(b, len(time) - 1)])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def mode_spans(view: RunView) -> list[tuple[float, float, str]]:
    """Return start, end and name of each stretch of constant mode.

    Times are in s. Other numbers are "unknown mode".
    """
    if view.control is None or "mode" not in view.control:
        return []
    names = {float(mode): mode.name.lower() for mode in Mode}
    modes = np.nan_to_num(view.control["mode"], nan=-1.0)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(modes) != 0) + 1])
    ends = np.concatenate([starts[1:], [len(modes) - 1]])
    return [
        (float(view.time[a]), float(view.time[b]), names.get(float(modes[a]), "unknown mode"))
        for a, b in zip(starts, ends, strict=True)
    ]


def extreme_rows(values: Array, *, bins: int) -> NDArray[np.int64]:
    """Return the rows of the extremes of values (N,) in `bins`.

    The last row is included. Few values are all returned.
    """
    size = len(values) // bins
    if size < 3:
        return np.arange(len(values))
    kept = len(values) // size * size
    block = values[:kept].reshape(-1, size)
    if not np.isfinite(block).all():
        block = np.where(np.isfinite(block), block, 0.0)
    ends = np.sort(np.stack([block.argmin(axis=1), block.argmax(axis=1)], axis=1), axis=1)
    return np.unique(np.concatenate([(ends + size * np.arange(len(block))[:, None]).ravel(), [len(values) - 1]]))


_LABELLED = 5.5
"""Greatest number of labels on a plot of the viewer; with more steps only every tenth is labelled."""
_EDGE = 0.06
"""Share of a plot at its edges that truncates labels."""


def ticked(low: float, high: float) -> Range:
    """Return bounds near these with at least two labels.

    The viewer labels multiples of a power of ten.

    The bound is extended to the nearer next multiple, or to both if they are equally near.
    """
    step = 10.0 ** math.ceil(math.log10(max(high - low, 1e-12) / _LABELLED))
    margin = _EDGE * (high - low)
    first, last = math.ceil((low + margin) / step), math.floor((high - margin) / step)
    if last > first:
        return low, high
    if last < first:
        first, last = last, first
    else:
        down, up = low - (first - 1) * step, (last + 1) * step - high
        first, last = first - (down < 1.01 * up), last + (up < 1.01 * down)
    margin = _EDGE * (max(high, last * step) - min(low, first * step))
    return min(low, first * step - margin), max(high, last * step + margin)


def padded(values: Array) -> Range:
    """Return the range of finite `values`, extended by a tenth."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    margin = 0.1 * (high - low) or 0.1 * abs(high) or 1e-3
    return low - margin, high + margin
