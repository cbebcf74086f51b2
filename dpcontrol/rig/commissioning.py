"""Commissioning: checks and measurements on a rig before its first run.

`dpcontrol.rig.motions` moves the cart by at most 10 mm, and `dpcontrol.rig.fits` measures drive, swing and encoders.
The findings here compare the measurements with [run] and the model. Each has a cause and its figures, from which
`dpcontrol.words.findings` makes a sentence and a remedy.

The readings cannot judge the encoder of a joint that friction holds, so its findings are unsure. An accelerated cart
leaves hanging arms behind, which relates the arms' signs to the cart's. Readings cannot distinguish a rig from its
mirror image: either the cart and its drive are reversed, or all encoders. In this case, both are reported.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import compress
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import FindingCause as Cause
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import Setting
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.result import Rig
from dpcontrol.references.problem import Limits
from dpcontrol.rig.client import Deadlines
from dpcontrol.rig.fits import (
    FACTOR,
    LEAST_SWING,
    STUCK,
    CommissioningSwing,
    DriveFit,
    Form,
    Wiring,
    fit_drive,
    fit_play,
    fit_swing,
    modes,
    read_wiring,
    rounding,
)
from dpcontrol.rig.motions import (
    OFTEN_LATE,
    REACH,
    SIDES,
    CommissioningSettings,
    Halted,
    Notify,
    RigSession,
    chirp_of,
    perform,
)
from dpcontrol.words.findings import told

_LONGEST_PERIOD = 0.05
"""s."""
_SWITCHES = Setting(least=2 * REACH, most=100, unit="m")
_GAIN = 0.05
"""Largest error of the drive's gain."""
_LEFT_OVER = 0.3
"""Maximum unexplained fraction of a motion, rms."""
_LIKELY = np.array([1.0, 2.0, 4.0, 0.5, 0.25, math.degrees(1)])
"""Likely wrong factors of an encoder."""
_ZERO, _FAR = 0.003, 0.5
"""Largest zero that needs no change, and largest that can be adjusted, rad."""
_SAME = 0.02
"""Largest relative difference of counts that are the same."""
_LEAST_PLAY = 0.001
"""Play below which there is no finding, rad; friction can look like play."""
_FRICTION = 5e-4
"""Least observable friction relative to gravity's torque."""
_DETUNING, _FASTER, _LEAST_DAMPING = 0.05, 5.0, 0.01
"""Relative tolerance of frequencies, and the multiple of the model's damping that is reported."""


class Grade(StrEnum):
    """Grade of a finding, by which commissioning passes or fails."""

    OK = "ok"
    WRONG = "wrong"
    UNSURE = "unsure"


_GRADES = {
    Cause.RIGHT: Grade.OK,
    Cause.DOUBTFUL: Grade.UNSURE,
    Cause.UNKNOWN: Grade.UNSURE,
    Cause.HIDDEN: Grade.UNSURE,
}


@dataclass(frozen=True)
class Finding:
    """Finding of one step of the commissioning.

    Attributes:
        step: name of the step, such as "drive" or "encoders".
        cause: what was found.
        figures: numbers by name, from which the sentence is made.
        changes: measured values for keys of [run].
    """

    step: str
    cause: Cause
    figures: Mapping[str, Any] = field(default_factory=dict)
    changes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def verdict(self) -> Grade:
        """The grade: whether the step requires a change before a run."""
        return _GRADES.get(self.cause, Grade.WRONG)

    @property
    def sentence(self) -> str:
        """The finding in words."""
        return told(self.step, self.cause, self.figures, self.changes)[0]

    @property
    def remedy(self) -> str:
        """What to do, or ""."""
        return told(self.step, self.cause, self.figures, self.changes)[1]


@dataclass(frozen=True)
class Commissioning(Documented):
    """Findings of each step, and measured values for keys of the scene's [run].

    Attributes:
        findings: findings in the order of the steps, each with its figures and a remedy.
        itinerary: name of the itinerary.
        bench: address or name of the rig, "" for the example bench in simulated time.
        written: the itinerary's file with the measured values, if it was written.
        unwritten: why it was not, a sentence.
    """

    KEYS: ClassVar[str] = "right findings:step,cause,verdict,sentence,remedy,figures measured=changes written"

    findings: tuple[Finding, ...]
    itinerary: str = ""
    bench: str = ""
    written: Path | None = None
    unwritten: str = ""

    @property
    def wrong(self) -> tuple[Finding, ...]:
        """Findings that require changes before a run."""
        return tuple(f for f in self.findings if f.verdict is Grade.WRONG)

    @property
    def blocking(self) -> tuple[Finding, ...]:
        """Faults of the rig itself, which invalidate the measurements, so that no value is proposed."""
        # The scene's [run] can fix what differs from it.
        return tuple(f for f in self.wrong if f.cause is not Cause.DIFFERS)

    @property
    def changes(self) -> dict[str, Any]:
        """Measured values by key of [run], none if the rig has a fault."""
        return {} if self.blocking else {key: value for f in self.findings for key, value in f.changes.items()}

    @property
    def missed(self) -> str:
        """The number of findings that must still be fixed, and the first of them, as a sentence, or ""."""
        remaining = self.wrong if self.written is None else self.blocking
        if self.changes and self.unwritten:
            return self.unwritten
        return (
            f"{len(remaining)} of {len(self.findings)} findings must be fixed; first: {remaining[0].sentence}"
            if remaining
            else ""
        )

    @property
    def right(self) -> bool:
        """True if nothing must change before a run."""
        return not self.wrong


def commission(
    rig: Rig,
    arms: ArmChainParameters,
    settings: LoopSettings,
    *,
    limits: Limits,
    zeros: Sequence[float] = (),
    switches: float = 0.0,
    options: CommissioningSettings,
    notify: Notify = lambda text: None,
) -> Commissioning:
    """Check and measure a rig before its first run.

    The arms hang, and the cart is at the centre. The rig is stopped at the end and after any error.

    Args:
        rig: the rig.
        arms: model of the arms.
        settings: present settings of the scene's [run].
        limits: the cart's limits.
        zeros: readings (n,) of hanging arms by the present settings, rad, which are subtracted from all readings.
        switches: distance to creep to either side until a limit switch responds, m; 0 to skip this.
        options: durations, sizes and speeds of the motions.
        notify: receives instructions about the next step.

    Raises:
        InputError: the distance to the switches is impossible, or the rig is too slow to hold its cart.
    """
    if switches and (complaint := _SWITCHES.complaint(switches)):
        raise InputError(f"switches = {switches!r}: {complaint}")
    if rig.period > _LONGEST_PERIOD:
        raise InputError(
            f"the rig ticks at {1 / rig.period:.3g} Hz: to hold the cart within {1e3 * REACH:.0f} mm takes at least "
            f"{1 / _LONGEST_PERIOD:g} Hz; raise its rate"
        )
    session = None
    halt: tuple[Any, ...] = ()
    # Slow computations run before the first tick or after the last, because a rig stops if its loop is silent.
    chirp = chirp_of(arms, rig.period, options)
    try:
        encoders = settings.of_each("encoders", arms.count)
        session = RigSession(rig, arms, limits, zeros or [0.0] * arms.count, encoders)
        perform(session, chirp, switches, options=options, notify=notify)
    except Halted as halted:
        halt = halted.args
    except ArithmeticError as failure:
        halt = Cause.FAULT, {"text": str(failure)}
    finally:
        rig.stop()
    findings = []
    if session and session.rang_to:
        findings = _judged(session, settings, tuple(zeros))
        if not (session.tries or halt) or any(f.verdict is not Grade.OK for f in findings if f.step == "drive"):
            findings.append(Finding("switches", Cause.UNKNOWN, {"asked": bool(switches)}))
        else:
            findings += [_switch(*attempt, limits) for attempt in session.tries]
    if halt:
        findings.append(Finding(session.step if session else "still", *halt))
    return Commissioning((*findings, *([_deadlines(session)] if session else [])))


def _judged(session: RigSession, settings: LoopSettings, zeros: tuple[float, ...]) -> list[Finding]:
    """Return the findings of zeros, drive, wiring, counts, play, friction and model from the recorded motion.

    `zeros` (n,) rad are those of the settings at present. The session has the ticks of the parts of the motion: the
    cart was held from `held_from` on, the chirp lasted from `chirped_from` to `chirped_to`, and the free swing ended at
    `rang_to`.
    """
    arms, period, held_from = session.arms, session.period, session.held_from
    readings = session.filled()[: session.rang_to + 1]
    angles, carts = readings[:, :-1], readings[:, -1]
    drive = fit_drive(carts, session.commands, period, first=session.chirped_from, last=session.chirped_to)
    swing = fit_swing(angles[held_from:], carts[held_from:], period, arms)
    wiring = read_wiring(swing, session.encoders)
    signs = _signs(drive.gain, np.where(wiring.unknown | ~session.encoders, 0.0, wiring.factors))
    return [
        _zeros(swing, wiring, zeros, settings),
        _direction(drive, wiring, signs),
        _lateness(drive, settings, period),
        *_encoders(wiring, swing, signs, drive.gain),
        _counts(session, wiring, drive.gain, settings),
        _play(angles[held_from:], period, wiring, settings),
        _friction(swing, arms, settings),
        _model(swing, wiring, arms),
    ]


def _first(holds: Mapping[Cause, Any]) -> Cause:
    """Return the first cause whose condition holds, in the order of the mapping."""
    return next(cause for cause, value in holds.items() if value)


def _signs(gain: float, factors: Array) -> list[tuple[str, ...]]:
    """Return the fewest reversals of drive, cart's scale and arms' encoders that explain the signs.

    `gain` is that of the drive, and `factors` (n,) are those of the encoders, 0 if unknown. The swings show signs
    relative to the cart's scale only, so either the negative ones are reversed, or the scale and all others. There are
    two solutions if both need equally many reversals. Each is a tuple of names, such as "drive" or "arm 1".
    """
    measured = {"cart": 1.0, "drive": gain}
    measured |= {f"arm {k + 1}": float(factor) for k, factor in enumerate(factors) if abs(factor) > STUCK}
    explanations = [tuple(name for name, value in measured.items() if value * cart < 0) for cart in (1, -1)]
    return [answer for answer in explanations if len(answer) == min(map(len, explanations))]


def _cart_scale(gain: float, factors: Array) -> bool:
    """True if a wrong factor of the cart's scale alone explains the drive's gain and the factors (n,) of the encoders.

    The arms' swings then look too large or too small by the inverse of the gain.
    """
    return abs(abs(gain) - 1) > _GAIN and bool(np.all(np.abs(np.abs(factors * gain) - 1) < FACTOR / 2))


def _direction(drive: DriveFit, wiring: Wiring, signs: list[tuple[str, ...]]) -> Finding:
    """Judge direction and gain of the drive and of the cart's scale; the first cause that applies is the finding.

    `signs` are the solutions of `_signs`, tuples of the names of reversed parts; with two solutions, a mirror image
    explains the rig as well. `wiring` has the encoders' factors, of which those below `STUCK` show no motion.
    """
    gain, factors = drive.gain, wiring.factors
    cause = _first(
        {
            Cause.UNKNOWN: drive.misfit > _LEFT_OVER,
            Cause.MIRRORED: len(signs) > 1,
            Cause.REVERSED: "drive" in signs[0],
            Cause.CART_REVERSED: "cart" in signs[0],
            Cause.CART_SCALE: np.all(np.abs(factors) > STUCK) and _cart_scale(gain, factors),
            Cause.SCALE: abs(gain - 1) > _GAIN,
            Cause.RIGHT: True,
        }
    )
    figures = {"gain": gain, "gain_error": drive.errors[2], "misfit": drive.misfit, "reversed": signs}
    return Finding("drive", cause, figures)


def _scales(wiring: Wiring, gain: float) -> Array:
    """Return the likely factor (n,) of each encoder, without its sign: 1 without a fault, NaN if it cannot be judged.

    A measured factor is as accurate as the model, so a value near a likely mistake, such as 4 for the decoding of
    quadrature, counts as that mistake. It cannot be judged if friction hides it, or a fault is not significant. The
    factor of an arm without an encoder is 1. `gain` is that of the drive, by which a wrong cart's scale is recognised.
    """
    measured = np.maximum(np.abs(wiring.factors * (gain if _cart_scale(gain, wiring.factors) else 1.0)), STUCK)
    nearest_likely = _LIKELY[np.argmin(np.abs(np.log(_LIKELY / measured[:, None])), axis=1)]
    likely = np.where(np.abs(measured / nearest_likely - 1) <= FACTOR, nearest_likely, measured)
    doubtful = (likely != 1) & (np.abs(measured - 1) < FACTOR + 3 * wiring.errors)
    return np.where(np.isnan(wiring.errors), 1.0, np.where(wiring.unknown | doubtful, np.nan, likely))


def _lateness(drive: DriveFit, settings: LoopSettings, period: float) -> Finding:
    """Compare the measured delay, in periods, and the lag, s, of the drive with those in [run].

    `period` is the control period, s.
    """
    delay, lag, configured = max(drive.delay / period, 0.0), drive.lag, settings.drive
    errors = drive.errors[0] / period, drive.errors[1]
    agrees = abs(delay - configured.delay) <= max(0.1, 3 * errors[0])
    agrees = agrees and abs(lag - configured.lag) <= max(5e-4, 3 * errors[1], 0.1 * configured.lag)
    cause = _first({Cause.UNKNOWN: drive.misfit > _LEFT_OVER, Cause.RIGHT: agrees, Cause.DIFFERS: True})
    figures = {
        "delay": delay,
        "delay_error": errors[0],
        "lag": lag,
        "lag_error": errors[1],
        "misfit": drive.misfit,
        "said_delay": configured.delay,
        "said_lag": configured.lag,
    }
    # `lag` is the simulated bench's, `drive_lag` the one that the controller assumes.
    changes = {"delay": round(delay, 3), "lag": round(lag, 5), "drive_lag": round(lag, 5)}
    return Finding("delay", cause, figures, {} if cause is Cause.UNKNOWN else changes)


def _zeros(swing: CommissioningSwing, wiring: Wiring, zeros: tuple[float, ...], settings: LoopSettings) -> Finding:
    """Judge the readings (n,) of hanging arms, rad, and propose zeros for [run].

    `zeros` are the present ones, which are already subtracted from the readings. The zero of an arm beyond a joint that
    friction holds is not judged. In the figures, `tilted` is True if all arms read the same angle, as on a tilted
    track. Zeros are proposed if one is wrong, and if the settings have zeros already.
    """
    readings, errors = swing.zeros
    tolerance = max(_ZERO, 1.5 * max(settings.sensors.steps(len(readings))))
    # An arm that hangs on a joint which friction holds can rest beside its zero.
    judged = ~np.logical_or.accumulate(np.isinf(wiring.errors))
    is_large, is_wrong = np.abs(readings) > tolerance, judged & (np.abs(readings) > np.maximum(tolerance, 3 * errors))
    cause = _first(
        {
            Cause.UNKNOWN: wiring.stuck.any(),
            Cause.FAR: np.abs(readings).max() > _FAR,
            Cause.DIFFERS: is_wrong.any(),
            Cause.HIDDEN: is_large.any() or not judged.all(),
            Cause.RIGHT: True,
        }
    )
    encoders = ~np.isnan(wiring.errors)
    shown_readings = readings[encoders]
    tilted = bool(len(shown_readings) > 1 and np.ptp(shown_readings) < tolerance)
    figures = {"zeros": shown_readings.tolist(), "zero_errors": errors[encoders].tolist(), "tilted": tilted}
    present_zeros = np.array(zeros or [0.0] * len(readings))
    values = np.where(judged & (is_wrong | ~is_large), present_zeros + readings, present_zeros)
    writes = cause is Cause.DIFFERS or (zeros and cause in (Cause.HIDDEN, Cause.RIGHT))
    return Finding("still", cause, figures, {"zeros": [round(float(v), 5) for v in values]} if writes else {})


def _encoders(wiring: Wiring, swing: CommissioningSwing, signs: list[tuple[str, ...]], gain: float) -> list[Finding]:
    """Judge order, form, signs and factors of the encoders, with one finding for each fault.

    The form tells how readings follow from angles, for example as sums of joint angles. `signs` are the solutions of
    `_signs`, tuples of names of reversed parts; if there are two, no arm counts as reversed. `gain` is that of the
    drive. If no arm swings, or no wiring explains the readings, that is the only finding.
    """
    order, unknown, scales, arm_count = wiring.order, wiring.unknown, _scales(wiring, gain), len(wiring.order)
    figures = {
        "form": wiring.form.value,
        "order": [k + 1 for k in order],
        "factors": wiring.factors.tolist(),
        "errors": [e if math.isfinite(e) else None for e in wiring.errors.tolist()],
        "misfit": wiring.misfit,
        "swing": swing.readings.std(axis=0).tolist(),
        "kind": "joint" if wiring.form in (Form.SUMMED, Form.RELATIVE) else "absolute",
    }
    # While an encoder stands still or its factor is uncertain, order and form cannot be judged.
    decided = not wiring.stuck.any() and not unknown.any()
    common_faults = {
        Cause.STANDS: max(figures["swing"]) < LEAST_SWING,
        Cause.UNKNOWN: decided and wiring.misfit > _LEFT_OVER,
        Cause.SWAPPED: decided and order != tuple(range(arm_count)),
        Cause.NOT_SUMMED: decided and wiring.form is Form.RELATIVE,
        Cause.SUMMED_TWICE: decided and wiring.form is Form.TWICE,
    }
    findings = [Finding("encoders", cause, figures) for cause, holds in common_faults.items() if holds]
    if common_faults[Cause.STANDS] or common_faults[Cause.UNKNOWN]:
        return findings[:1]
    reversed_names = signs[0] if len(signs) == 1 else ()
    for k, scale in enumerate(scales.tolist()):
        arm_faults = {
            Cause.STUCK: wiring.stuck[k],
            Cause.REVERSED: f"arm {k + 1}" in reversed_names,
            Cause.SCALE: not wiring.stuck[k] and not math.isnan(scale) and scale != 1,
        }
        arm_figures = {**figures, "arm": k + 1, "scale": scale}
        findings += [Finding("encoders", cause, arm_figures) for cause, holds in arm_faults.items() if holds]
    if hidden := [k + 1 for k in np.flatnonzero(np.isnan(scales)).tolist()]:
        findings.append(Finding("encoders", Cause.HIDDEN, {**figures, "hidden": hidden}))
    return findings or [Finding("encoders", Cause.RIGHT, figures)]


def _counts(session: RigSession, wiring: Wiring, gain: float, settings: LoopSettings) -> Finding:
    """Compare the counts per turn that follow from the rounding of joint angles with the encoder counts in [run].

    An encoder's count is unknown (None) if its readings show no rounding step or its factor cannot be judged. `gain` is
    that of the drive, by which a wrong cart's scale is recognised.
    """
    joints = np.diff(np.array(session.positions)[:, :-1], axis=1, prepend=0.0)
    steps = np.array([rounding(column) for column in joints.T])
    # An angle that is four times too large has steps that are four times too large.
    scales = _scales(wiring, gain)
    measured = [
        # NaN, a factor that friction hides, differs from itself.
        round(2 * np.pi * scale / step) if step and scale == scale else None
        for scale, step in zip(scales, steps, strict=True)
    ]
    configured = list(settings.sensors.of_each("counts", len(measured)))
    agree = [
        not count or (setting and abs(count / setting - 1) < _SAME)
        for count, setting in zip(measured, configured, strict=True)
    ]
    # An encoder that was not measured keeps its number.
    changed_counts = [count or setting for count, setting in zip(measured, configured, strict=True)]
    measured, configured, agree = (list(compress(column, session.encoders)) for column in (measured, configured, agree))
    cause = _first(
        {
            Cause.UNKNOWN: any(configured) and not any(measured),
            Cause.DIFFERS: not all(agree),
            Cause.HIDDEN: any(measured) and not all(measured),
            Cause.RIGHT: True,
        }
    )
    changes = {"counts": changed_counts if len(set(changed_counts)) > 1 else changed_counts[0]}
    return Finding("counts", cause, {"counts": measured, "said": configured}, changes if cause is Cause.DIFFERS else {})


def _play(angles: Array, period: float, wiring: Wiring, settings: LoopSettings) -> Finding:
    """Compare the play of the encoders, rad, with that in [run], and propose the measured one if it differs.

    `angles` (K, n) are the readings of the arms, rad. `period` is the control period, s. The play is unknown if the
    encoders are not wired rightly, or their joints reverse too rarely.
    """
    encoders = ~np.isnan(wiring.errors)
    joints = np.diff(angles, axis=1, prepend=0.0).T[encoders]
    settings_play = np.array(settings.mechanics.of_each("play", len(encoders)))
    configured = settings_play[encoders]
    plays, errors = (np.array(values) for values in zip(*(fit_play(joint, period) for joint in joints), strict=True))
    # Play can make joint encoders look like absolute ones.
    wiring_is_right = wiring.form in (Form.SUMMED, Form.ABSOLUTE) and bool(np.all(_scales(wiring, 1.0) == 1))
    least_plays = np.array([max(_LEAST_PLAY, rounding(joint)) for joint in joints])
    agree = np.abs(plays - configured) <= np.maximum(3 * errors, np.maximum(least_plays, 0.2 * configured))
    cause = _first(
        {
            Cause.UNKNOWN: not wiring_is_right or not np.isfinite(plays).all(),
            Cause.RIGHT: agree.all(),
            Cause.DIFFERS: True,
        }
    )
    figures = {
        "play": plays.tolist(),
        "play_errors": errors.tolist(),
        "said": configured.tolist(),
        "least": float(least_plays.max()),
    }
    settings_play[encoders] = np.where(plays > np.maximum(least_plays, 3 * errors), np.round(plays, 5), 0.0)
    return Finding("play", cause, figures, {"play": settings_play.tolist()} if cause is Cause.DIFFERS else {})


def _friction(swing: CommissioningSwing, arms: ArmChainParameters, settings: LoopSettings) -> Finding:
    """Compare the dry friction (n,) of the joints, N m, with the sum of those in [run] and in the model.

    In [run], it is the stiction times the share `kinetic` that a sliding joint keeps. A difference is doubtful, not
    wrong. It counts above `_FRICTION` of gravity's torque, three standard errors, and half of the sum.
    """
    (torques, errors), mechanics, coulomb = swing.dry, settings.mechanics, np.array(arms.coulomb or 0.0)
    configured = np.array(mechanics.of_each("stiction", arms.count)) * mechanics.kinetic + coulomb
    least_torques = np.maximum(
        _FRICTION * arms.base()[arms.count * (arms.count + 1) // 2 :][: arms.count].max(), 3 * errors
    )
    figures = {
        "torques": torques.tolist(),
        "errors": errors.tolist(),
        "least": float(least_torques[np.isfinite(least_torques)].max(initial=0.0)),
        "stiction": (np.maximum(torques - coulomb, 0) / max(mechanics.kinetic, 0.1)).tolist(),
    }
    agrees = np.all(np.abs(torques - configured) < np.maximum(least_torques, 0.5 * configured))
    return Finding("friction", Cause.RIGHT if agrees else Cause.DOUBTFUL, figures)


def _model(swing: CommissioningSwing, wiring: Wiring, arms: ArmChainParameters) -> Finding:
    """Compare the arms' frequencies and viscous dampings with the model's.

    The frequencies' ratios to the model's and the dampings are those that `fit_swing` found. A difference is doubtful,
    not wrong: a frequency that is off by `_DETUNING`, or a damping above `_FASTER` times the model's, less three
    standard errors. Frequencies are not judged while an encoder stands still or its factor is uncertain.
    """
    viscous, errors = swing.viscous
    least_viscous_arms = replace(arms, viscous=tuple(np.maximum(viscous - 3 * errors, 0.0).tolist()))
    damping_ratio = float(
        (modes(least_viscous_arms).dampings / np.maximum(modes(arms).dampings, _LEAST_DAMPING / _FASTER)).max()
    )
    figures = {
        "frequencies": (modes(arms).frequencies * swing.ratios / 2 / np.pi).tolist(),
        "viscous": viscous.tolist(),
        "viscous_errors": errors.tolist(),
        "ratios": swing.ratios.tolist(),
        "damped": damping_ratio,
    }
    is_detuned = float(np.abs(swing.ratios - 1).max()) >= _DETUNING and not np.any(wiring.stuck | wiring.unknown)
    return Finding("model", Cause.DOUBTFUL if damping_ratio > _FASTER or is_detuned else Cause.RIGHT, figures)


def _switch(side: int, answer: int, at: float, limits: Limits) -> Finding:
    """Judge a limit switch by its `answer` (-1, 0 or 1) `at` m from home, when the cart crept to `side` (1 or -1)."""
    cause = _first(
        {
            Cause.OTHER: answer == -side,
            Cause.SILENT: not answer,
            Cause.WITHIN: abs(at) < limits.position,
            Cause.RIGHT: True,
        }
    )
    figures = {"side": SIDES[side], "answer": answer, "position": at, "limit": limits.position}
    return Finding("switches", cause, figures)


def _deadlines(session: RigSession) -> Finding:
    """Judge the timing of both ends by the most frequent of late ticks, lost readings and repeated commands.

    One in a thousand ticks is right, and a fraction of up to `OFTEN_LATE` doubtful.
    """
    ticks, lost = len(session.positions), session.present.count(False)
    # A rig in simulated time has no deadlines.
    deadlines = getattr(session.rig, "deadlines", None)
    repeated = deadlines.held if isinstance(deadlines, Deadlines) else 0
    worst_count = max(session.late, lost, repeated)
    cause = _first(
        {Cause.RIGHT: worst_count <= 0.001 * ticks, Cause.DOUBTFUL: worst_count <= OFTEN_LATE * ticks, Cause.LATE: True}
    )
    return Finding("deadlines", cause, {"ticks": ticks, "late": session.late, "lost": lost, "held": repeated})
