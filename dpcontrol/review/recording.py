"""A run as a Rerun recording: the log's own messages, series derived from them, and a blueprint that arranges them.

The log alone can be opened in the viewer as well, but then without arrangement. Times are durations from the start.
"""

from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import McapReader

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import whole_file
from dpcontrol.logs import RunLog
from dpcontrol.review import series, style
from dpcontrol.review.blueprint import TIMELINE, WORLD, Arrangement, blueprint, line
from dpcontrol.review.context import ReviewContext

_APPLICATION = "dpcontrol"
_TRACE_RATE = 50.0
_TRACE_SECONDS = 0.4
_TOPICS = ["^/tf$", "^/robot_description$", "^/reference/robot_description$", "^/rosout$"]
"""Taken as they are; the numbers of the other topics go into curves with names and colours."""


def write_recording(log: RunLog, context: ReviewContext, path: Path) -> None:
    """Write the recording of `log`, whose file must still be where it was read from, to `path` (`*.rrd`).

    Raises:
        InputError: the recording cannot be written, or the log has gone.
    """
    if not log.path.is_file():
        raise InputError(f"there is no log {log.path} any more; put it back and try again")
    log, context = series.drawable(log, context)
    with whole_file(Path(path), suffix=".rrd") as temporary:
        recording = rr.RecordingStream(_APPLICATION, send_properties=True)
        view = blueprint(
            Arrangement(
                arm_lengths=context.arm_lengths,
                has_cart=log.has_cart,
                has_truth=log.truth is not None,
                has_energy=context.energy is not None,
                bounds=tuple(_bounds(log, context, arm) for arm in range(len(context.arm_lengths))),
                ranges=_ranges(log, context),
            )
        )
        recording.save(temporary, default_blueprint=view)
        recording.send_recording_name(context.title)
        recording.send_chunks(McapReader(log.path, timeline_type="duration", include_topic_regex=_TOPICS).stream())
        _summary(recording, log, context)
        _motion(recording, log, context)
        _commands(recording, log, context)
        _checks(recording, log, context)
        _states(recording, log, context)
        _phase_planes(recording, log, context)
        _tip(recording, log, context)
        recording.flush()
        recording.disconnect()


def _times(time: NDArray[np.float64]) -> list[rr.TimeColumn]:
    return [rr.TimeColumn(TIMELINE, duration=time)]


def _curve(
    recording: rr.RecordingStream,
    path: str,
    *,
    time: NDArray[np.float64],
    values: NDArray[np.float64],
    look: rr.SeriesLines,
) -> None:
    recording.log(path, look, static=True)
    recording.send_columns(path, indexes=_times(time), columns=rr.Scalars.columns(scalars=values))


def _level(recording: rr.RecordingStream, path: str, log: RunLog, *, value: float, colour: str, name: str) -> None:
    ends = log.time[[0, -1]]
    _curve(recording, path, time=ends, values=np.full(2, value), look=line(colour, name, width=1.0))


def _summary(recording: rr.RecordingStream, log: RunLog, context: ReviewContext) -> None:
    rows = [f"# {context.title}", f"**{context.verdict}**" if context.verdict else "", ""]
    rows += [f"{i + 1}. {name}, crossing planned at {at:.3f} s" for i, (at, name) in enumerate(context.symbols)]
    rows += ["", "| | |", "|---|---|", *(f"| {key} | {value} |" for key, value in log.metadata.items())]
    document = rr.TextDocument("\n".join(rows), media_type="text/markdown")
    recording.log("summary", document, static=True)


def _motion(recording: rr.RecordingStream, log: RunLog, context: ReviewContext) -> None:
    arms = len(context.arm_lengths)
    for arm in range(arms):
        colour = style.arm_colour(arm)
        for kind, offset, what in (("angles", 0, "θ"), ("rates", arms, "ω")):
            at = f"plots/{kind}/arm_{arm + 1}"
            column = offset + arm
            ghost = line(style.REFERENCE, f"{what}{arm + 1} reference", width=3.0)
            _curve(recording, f"{at}/1_reference", time=log.time, values=log.reference[:, column], look=ghost)
            estimate = line(colour if log.truth is None else style.PALE_INK, f"{what}{arm + 1} estimate", width=1.0)
            _curve(recording, f"{at}/2_estimate", time=log.time, values=log.estimate[:, column], look=estimate)
            if log.truth is not None:
                plant = line(colour, f"{what}{arm + 1} plant", width=1.5)
                _curve(recording, f"{at}/3_plant", time=log.time, values=log.truth[:, column], look=plant)


def _commands(recording: rr.RecordingStream, log: RunLog, context: ReviewContext) -> None:
    if log.has_cart:
        state, shown = series.shown_state(log)
        column = 2 * len(context.arm_lengths)
        ghost = line(style.REFERENCE, "reference", width=3.0)
        _curve(recording, "plots/cart/1_reference", time=log.time, values=log.reference[:, column], look=ghost)
        _curve(recording, "plots/cart/2_cart", time=log.time, values=state[:, column], look=line(style.PALE_INK, shown))
        for sign, name in ((-1, "left"), (1, "right")):
            at = sign * context.limits[0]
            _level(recording, f"plots/cart/limit_{name}", log, value=at, colour=style.LIMIT, name=f"{name} limit")
    for name, colour in (("command", style.CART), ("applied", style.ARMS[0]), ("feedforward", style.ARMS[1])):
        at = f"plots/acceleration/{name}"
        _curve(recording, at, time=log.time, values=log.control[name], look=line(colour, name))
    for sign, name in ((-1, "least"), (1, "greatest")):
        at = sign * context.limits[2]
        _level(recording, f"plots/acceleration/{name}", log, value=at, colour=style.LIMIT, name=f"{name} allowed")


def _checks(recording: rr.RecordingStream, log: RunLog, context: ReviewContext) -> None:
    error = series.estimation_error(log)
    if error is not None:
        sigma = series.sigmas(log)
        for arm in range(len(context.arm_lengths)):
            at = f"plots/estimation_error/arm_{arm + 1}"
            look = rr.Measurements.from_fields(
                names=[f"arm {arm + 1}"], colors=[style.rgb(style.arm_colour(arm))], widths=[1.0], units=["rad"]
            )
            recording.log(at, look, static=True)
            # The viewer's band is one standard deviation of what it is given: twice the filter's is asked for.
            columns = rr.Measurements.columns(values=error[:, arm], variances=(2 * sigma[:, arm]) ** 2)
            recording.send_columns(at, indexes=_times(log.time), columns=columns)
    time, means, spread = series.smoothed_nis(log)
    sensors = log.measured.shape[1]
    _curve(recording, "plots/nis/mean", time=time, values=means, look=line(style.PALE_INK, "mean of 50 ticks"))
    for name, value in (("least", max(sensors - spread, 0)), ("greatest", sensors + spread)):
        _level(recording, f"plots/nis/{name}", log, value=value, colour=style.ARMS[2], name=f"{name} for 95 %")
    if context.energy is not None:
        _curve(
            recording,
            "plots/energy/pendulum",
            time=log.time,
            values=context.energy,
            look=line(style.PALE_INK, "pendulum"),
        )
        for name, level in context.saddle_energies.items():
            at = f"plots/energy/{name.replace('-', '_')}"
            _level(recording, at, log, value=level, colour=style.ARMS[3], name=name)


def _states(recording: rr.RecordingStream, log: RunLog, context: ReviewContext) -> None:
    spans = series.mode_spans(log)
    colours = [(*style.rgb(colour), 255) for colour in style.MODES.values()]
    recording.log("states/controller", rr.StateConfiguration(values=list(style.MODES), colors=colours), static=True)
    starts = np.array([start for start, _, _ in spans])
    names = [name for _, _, name in spans]
    columns = rr.StateChange.columns(state=names)
    recording.send_columns("states/controller", indexes=_times(starts), columns=columns)
    if context.symbols:
        changes = [
            (float(log.time[0]), "before the first"),
            *((at, f"{i + 1}: {n}") for i, (at, n) in enumerate(context.symbols)),
        ]
        moments = np.array([at for at, _ in changes])
        columns = rr.StateChange.columns(state=[name for _, name in changes])
        recording.send_columns("states/itinerary", indexes=_times(moments), columns=columns)


def _scaled(points: NDArray[np.float64]) -> NDArray[np.float64]:
    # The viewer's y points down, and its scales are equal: a rate of 10 rad/s is as long as an angle of 2 rad.
    return np.column_stack([points[:, 0], -0.2 * points[:, 1]])


def _plane(log: RunLog, context: ReviewContext, arm: int) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
    state, _ = series.shown_state(log)
    points = _scaled(state[:, [arm, len(context.arm_lengths) + arm]])
    copies = [
        _scaled(copy) for orbit in context.orbits for copy in series.lattice_copies(orbit, state[:, arm], arm=arm)
    ]
    return points, copies


def _bounds(log: RunLog, context: ReviewContext, arm: int) -> tuple[float, float, float, float]:
    points, copies = _plane(log, context, arm)
    every = np.concatenate([points, *copies])
    every = every[np.isfinite(every).all(axis=1)] if np.isfinite(every).all(axis=1).any() else np.zeros((1, 2))
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.08 * float(max(high - low)) + 1e-3
    low, high = low - margin, high + margin
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def _ranges(log: RunLog, context: ReviewContext) -> dict[str, tuple[float, float]]:
    """Return what to show at first of each plot whose limits, levels or first instants would flatten the rest."""
    state, _ = series.shown_state(log)
    ranges = {"acceleration": series.padded(log.control["applied"])}
    if log.has_cart:
        ranges["cart"] = series.padded(state[:, 2 * len(context.arm_lengths)])
    error = series.estimation_error(log)
    if error is not None:
        arms = len(context.arm_lengths)
        band = 2 * series.sigmas(log)[:, :arms]
        if np.isfinite(band).any():
            most = max(1.6 * float(np.nanquantile(band, 0.97)), 1e-9)
            ranges["estimation_error"] = (-most, most)
    if context.energy is not None:
        ranges["energy"] = series.energy_range(context.energy, context.saddle_energies)
    return ranges


def _phase_planes(recording: rr.RecordingStream, log: RunLog, context: ReviewContext) -> None:
    for arm in range(len(context.arm_lengths)):
        points, copies = _plane(log, context, arm)
        at = f"phase_planes/arm_{arm + 1}"
        if copies:
            orbit = rr.LineStrips2D(copies, colors=[(*style.rgb(style.ARMS[2]), 160)], radii=rr.Radius.ui_points(1.8))
            recording.log(f"{at}/orbits", orbit, static=True)
        step = max(1, len(points) // 20_000)
        path = rr.LineStrips2D(
            [points[::step]], colors=[style.rgb(style.arm_colour(arm))], radii=rr.Radius.ui_points(0.7)
        )
        recording.log(f"{at}/run", path, static=True)
        rows = _trace_rows(log)
        columns = rr.Points2D.columns(positions=points[rows])
        look = rr.Points2D.from_fields(colors=[style.rgb(style.INK)], radii=rr.Radius.ui_points(5))
        recording.log(f"{at}/now", look, static=True)
        recording.send_columns(f"{at}/now", indexes=_times(log.time[rows]), columns=columns)


def _trace_rows(log: RunLog) -> NDArray[np.int64]:
    return np.arange(0, len(log.time), max(1, round(log.rate_hz / _TRACE_RATE)))


def _tip(recording: rr.RecordingStream, log: RunLog, context: ReviewContext) -> None:
    """Trace the tip over the last moments, in the plane in which the outermost arm is drawn."""
    state, _ = series.shown_state(log)
    arms = len(context.arm_lengths)
    rows = _trace_rows(log)
    tips = series.arm_points(state[rows, :arms], context.arm_lengths)[:, -1]
    places = np.column_stack(
        [tips[:, 0] + series.pivot_positions(log, state[rows]), np.full(len(rows), -0.05), tips[:, 1]]
    )
    length = round(_TRACE_SECONDS * _TRACE_RATE)
    strips = [places[max(0, k - length) : k + 1] for k in range(len(rows))]
    colour = style.rgb(style.arm_colour(arms - 1))
    recording.log("tip", rr.LineStrips3D.from_fields(colors=[colour], radii=rr.Radius.ui_points(1.5)), static=True)
    recording.log("tip", rr.CoordinateFrame(WORLD), static=True)
    columns = rr.LineStrips3D.columns(strips=strips)
    recording.send_columns("tip", indexes=_times(log.time[rows]), columns=columns)
