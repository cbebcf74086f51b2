"""The series of a recording: motion, command, errors with bands, NIS, energy with levels, and the strips of states."""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from dpcontrol.review import series, style
from dpcontrol.review.context import ReviewContext
from dpcontrol.review.motion import ACTUAL, Motion
from dpcontrol.review.recorded import band, curve, level, line, states, stay_changes

Array = NDArray[np.float64]

DRIVEN = {
    ACTUAL: ("plant green", style.ARMS[2]),
    "command": ("command grey", style.REFERENCE),
    "applied": ("applied blue", style.ARMS[0]),
    "feedforward": ("plan orange", style.ARMS[1]),
}
"""Accelerations in the order in which they are drawn: what a title says of them, and their colours."""
_BAND_POINTS = 4000
_EDGE = np.array([-1e-6, 0.0, 1e-6])
"""s: about an end of a band."""
ENDED = "ended"


def record_motion(recording: rr.RecordingStream, home: str, motion: Motion, context: ReviewContext) -> None:
    """Record angles, rates, cart and command, the reference grey behind them."""
    for arm in range(motion.arms):
        for kind, offset, what in (("angles", 0, "θ"), ("rates", motion.arms, "ω")):
            at, name = f"{home}/{kind}/arm_{arm + 1}", f"{what}{arm + 1}"
            _followed(recording, at, motion, offset + arm, colour=style.arm_colour(arm), name=name)
    if motion.has_cart:
        _followed(recording, f"{home}/cart", motion, 2 * motion.arms, colour=style.PALE_INK, name="cart")
        if context.limits:
            for sign, side in ((-1, "left"), (1, "right")):
                value = sign * context.limits[0]
                at = f"{home}/cart/limit_{side}"
                level(recording, at, motion, value=value, colour=style.LIMIT, name=f"{side} limit")
    _command(recording, f"{home}/acceleration", motion, context)


def _followed(recording: rr.RecordingStream, at: str, motion: Motion, column: int, *, colour: str, name: str) -> None:
    """Record one column of reference, estimate and state; an estimate shows where it differs from the plant."""
    if motion.reference is not None:
        look = line(style.REFERENCE, f"{name} {motion.against}", width=3.0)
        curve(recording, f"{at}/1_reference", time=motion.time, values=motion.reference[:, column], look=look)
    if motion.estimate is not None and motion.what != "estimate":
        look = line(style.PALE_INK, f"{name} estimate", width=1.0)
        curve(recording, f"{at}/2_estimate", time=motion.time, values=motion.estimate[:, column], look=look)
    look = line(colour, f"{name} {motion.what}", width=1.5)
    curve(recording, f"{at}/3_{motion.what}", time=motion.time, values=motion.state[:, column], look=look)


def _command(recording: rr.RecordingStream, home: str, motion: Motion, context: ReviewContext) -> None:
    control = motion.control or {}
    for name, (_, colour) in DRIVEN.items():
        if name in control:
            look = line(colour, "plant", width=3.0) if name == ACTUAL else line(colour, name)
            curve(recording, f"{home}/{name}", time=motion.time, values=control[name], look=look)
    if not control:
        return
    if context.limits:
        for sign, name in ((-1, "least"), (1, "greatest")):
            value = sign * context.limits[2]
            at = f"{home}/{name}"
            level(recording, at, motion, value=value, colour=style.LIMIT, name=f"{name} allowed")
    cut = control.get("saturated", np.zeros(0)) > 0
    if cut.any():
        height = float(np.nanmax(np.abs(control["applied"])))
        # The viewer joins what falls into one pixel: a band between few points would be drawn as wedges.
        edges = np.array(series.spans(motion.time, cut))
        time = np.union1d(np.linspace(*motion.time_range, _BAND_POINTS), np.add.outer(edges, _EDGE).ravel())
        inside = np.searchsorted(edges[:, 0], time, side="right") > np.searchsorted(edges[:, 1], time, side="left")
        reach = np.where(inside, height, 0.0)
        name = "cut at a limit"
        band(
            recording, f"{home}/cut", time=time, values=np.zeros(len(time)), reach=reach, colour=style.LIMIT, name=name
        )


def record_checks(
    recording: rr.RecordingStream, home: str, motion: Motion, context: ReviewContext, *, energy: Array | None
) -> None:
    """Record the errors of tracking and estimation, the NIS, and the energy (N,) in J with the saddles' levels."""
    for arm in range(motion.arms):
        colour, name = style.arm_colour(arm), f"arm {arm + 1}"
        if motion.reference is not None:
            away = motion.state[:, arm] - motion.reference[:, arm]
            at = f"{home}/tracking_error/arm_{arm + 1}"
            curve(recording, at, time=motion.time, values=away, look=line(colour, name))
        if motion.error is not None and motion.sigma is not None:
            at = f"{home}/estimation_error/arm_{arm + 1}"
            reach = 2 * motion.sigma[:, arm]
            error = motion.error[:, arm]
            band(recording, at, time=motion.time, values=error, reach=reach, colour=colour, name=name)
    if motion.nis is not None:
        time, means, spread = series.smoothed_nis(motion)
        curve(recording, f"{home}/nis/mean", time=time, values=means, look=line(style.PALE_INK, "mean of 50 updates"))
        for name, value in (("least", max(motion.sensors - spread, 0)), ("greatest", motion.sensors + spread)):
            at = f"{home}/nis/{name}"
            level(recording, at, motion, value=value, colour=style.ARMS[2], name=f"{name} for 95 %")
    if energy is not None:
        look = line(style.PALE_INK, "pendulum")
        curve(recording, f"{home}/energy/pendulum", time=motion.time, values=energy, look=look)
        for name, value in context.saddle_energies.items():
            at = f"{home}/energy/{name.replace('-', '_')}"
            level(recording, at, motion, value=value, colour=style.saddle_colour(name), name=name)


def record_story(recording: rr.RecordingStream, home: str, motion: Motion, context: ReviewContext) -> None:
    """Record strips of states: the itinerary as asked, as done, its symbols, and the controller's modes."""
    begin, end = motion.time_range
    if context.planned:
        changes, colours = stay_changes(context.planned, begin=begin)
        # The last stay lasts to the plan's end, which is the strip's.
        states(recording, f"{home}/1_asked", changes[:-1], colours)
        done, colours = stay_changes(context.done, begin=begin)
        stopped = context.duration is not None and end < context.duration - 2 / motion.rate_hz
        if done and not stopped:
            done = [*done[:-1]] if end - done[-1][0] < 2 / motion.rate_hz else done
        elif done:
            done.append((end, ENDED))
        states(recording, f"{home}/2_done", done, colours)
    if context.symbols:
        names = [f"{i + 1}: {name}" for i, (_, name) in enumerate(context.symbols)]
        moments = [at for at, _ in context.symbols]
        tints = {name: style.RUNS[i % len(style.RUNS)] for i, name in enumerate(names)}
        changes = [(begin, "before the first"), *zip(moments, names, strict=True)]
        states(recording, f"{home}/3_symbol", changes, tints)
    modes = [(start, name) for start, _, name in series.mode_spans(motion)]
    if modes and context.duration is not None and end < context.duration - 2 / motion.rate_hz:
        modes.append((end, ENDED))
    states(recording, f"{home}/4_controller", modes, style.MODES)
