"""Commissioning: checks and measurements on a rig before its first run.

The arms hang and the cart moves by at most 10 mm, so errors in signs, gains or delays are harmless. First, a short
shift to and fro shows the direction of the drive. Then the cart is held in place and follows a chirp. The low
frequencies make the arms swing, and the high ones show the delay of the drive. With commands u_j at ticks j, T apart, a
drive of delay d, lag τ and gain γ moves the cart by

    x(t) = x_0 + v_0 t + γ Σ_j (u_j - u_{j-1}) p(t - j T - d),     p(s) = s²/2 - τ s + τ² (1 - e^{-s/τ})  for s > 0

Both sides are high-pass filtered, which removes the accumulated noise of the command. Then d, τ and γ are fitted to the
cart's readings. Standard errors account for residuals that are correlated over blocks.

Small swings of hanging arms follow the measured position x of the cart, so the drive has no effect. With joint angles φ
and the rate of each joint ρ

    M φ̈ + K φ + k ρ + c sgn ρ = -s ẍ,     readings = zeros + B L φ,     |torque| ≤ c where ρ = 0

The frequencies of M and K, viscous friction k, dry friction c and the first state are fitted with a free matrix B. The
readings cannot judge the encoder of a joint that friction holds, so its findings are unsure. Encoders that are wired,
scaled or summed wrongly give a special B. Let L be the sums of joint angles, D a diagonal of signs and factors, and P
an exchange of encoders. Then B is L D P L⁻¹ (joint encoders, summed, as it should be), D P L⁻¹ (never summed), D P
(absolute encoders) or L D P (absolute angles summed again). The nearest form is reported. An accelerated cart leaves
hanging arms behind, which relates the arms' signs to the cart's.

Readings cannot distinguish a rig from its mirror image: either the cart and its drive are reversed, or all encoders. In
this case, both are reported.

Sources: Ljung, System identification (1999), sections 7.4 (output error) and 14.4 (prefilters). Golub & Pereyra,
Separable nonlinear least squares (2003). Moreau, Numerical aspects of the sweeping process (1999), for dry friction.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import lru_cache, partial
from itertools import permutations
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize, signal

from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import Bounds, Settings, setting
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.protocols import Reading
from dpcontrol.loop.result import Rig
from dpcontrol.references.problem import Limits
from dpcontrol.rig.client import Deadlines

Notify = Callable[[str], None]

REACH = 0.010
"""Maximum distance of the cart from its initial position, except towards the switches, m."""
_LONGEST_PERIOD = 0.05
"""s."""
_SWITCHES = Bounds(least=2 * REACH, most=100, unit="m")


class Grade(StrEnum):
    """Grade of a finding."""

    OK = "ok"
    WRONG = "wrong"
    UNSURE = "unsure"


@dataclass(frozen=True)
class Finding:
    """Finding of one step: sentence, remedy, numbers by name.

    mended: the scene's [run] can fix it.
    """

    step: str
    verdict: Grade
    sentence: str
    remedy: str = ""
    figures: Mapping[str, Any] = field(default_factory=dict)
    mended: bool = False


@dataclass(frozen=True)
class CommissioningSettings(Settings, table="commissioning"):
    """Durations and sizes of the motions that measure a rig."""

    wait: float = setting(60.0, least=0, most=3600, unit="s")
    """Time limit for the arms to hang still, s."""
    still: float = setting(0.05, above=0, most=0.2, unit="rad")
    """Swing that counts as still, rad."""
    look: float = setting(0.3, least=0.1, most=60, unit="s")
    """Observation time before any motion, s."""
    hold: float = setting(1.5, least=0.5, most=60, unit="s")
    """Observation time with the cart held, s."""
    sweep: float = setting(8.0, least=2, most=120, unit="s")
    """Duration of the chirp, s, from half the slowest swing's frequency to `highest` Hz."""
    ring: float = setting(3.0, least=0.5, most=120, unit="s")
    """Observation time of the free swing after it, s."""
    highest: float = setting(40.0, least=2, most=500, unit="Hz")
    amplitude: float = setting(0.004, above=0, most=0.005, unit="m")
    """Largest displacement in the chirp, m."""
    push: float = setting(4.0, above=0, most=10, unit="m/s²")
    """Largest acceleration in the chirp, m/s²."""
    creep: float = setting(0.05, above=0, most=0.1, unit="m/s")
    """Speed towards the limit switches, m/s."""

    @property
    def seconds(self) -> float:
        """Total duration, s.

        It assumes that the arms hang still and the switches are not tried.
        """
        return self.look + self.hold + self.sweep + self.ring + 3.0


@dataclass(frozen=True)
class Commissioning(Documented):
    """Findings of each step, and measured values.

    The values are for keys of the scene's [run].
    """

    KEYS: ClassVar[str] = "right findings:step,verdict,sentence,remedy,figures measured=changes"

    findings: tuple[Finding, ...]
    changes: Mapping[str, float | int | list[float]]

    @property
    def wrong(self) -> tuple[Finding, ...]:
        """Findings that require changes before a run."""
        return tuple(f for f in self.findings if f.verdict is Grade.WRONG)

    @property
    def blocking(self) -> tuple[Finding, ...]:
        """Faults of the rig itself, which invalidate the measurements."""
        return tuple(f for f in self.wrong if not f.mended)

    @property
    def right(self) -> bool:
        """True if nothing must change before a run."""
        return not self.wrong


class _Halted(Exception):
    """Further measurement is not possible; contains the finding with the reason."""

    def __init__(self, finding: Finding) -> None:
        super().__init__(finding.sentence)
        self.finding = finding


_FREQUENCY = 2 * np.pi * 0.6
"""Bandwidth of the loop that holds the cart, rad/s; slow enough for any drive's delay."""
_DAMPING = 0.8
_SLOPE = 0.01
"""Interval over which the cart's velocity is computed from its positions, s."""
_LONGEST_GAP = 0.1
"""Time without a cart reading after which the cart is stopped, s."""
_OFTEN_LATE = 0.01
"""Fraction of ticks."""
_HURRY = "reduce other work on the computers, request priority with --real-time, or run at a lower rate"
_COMPLAINS = "fix what the rig reports and start again"


class _Session:
    """The rig during commissioning; records every tick and limits the cart's travel."""

    def __init__(self, rig: Rig, arms: int, limits: Limits, zeros: Sequence[float]) -> None:
        self.rig, self.arms, self.period = rig, arms, rig.period
        self._zeros = np.array([*(zeros or [0.0] * arms), 0.0])
        self._most = limits.acceleration
        self.positions: list[Array] = []
        self.present: list[bool] = []
        self.commands: list[float] = []
        self.switches: list[int] = []
        self.late = 0
        self.gain = 0.0
        """Cart reading per command, once known; its sign is the drive's direction."""
        self.reach, self.step = REACH, "still"
        self._span = max(1, round(_SLOPE / self.period))
        self._gap = 0
        self.read()
        self.home = self.cart

    @property
    def cart(self) -> float:
        """The cart's last reading, m."""
        return float(self.positions[-1][-1])

    @property
    def tick(self) -> int:
        """Number of the last reading."""
        return len(self.positions) - 1

    def read(self) -> Reading:
        """Read and store the next reading."""
        reading = self.rig.read()
        present = reading.present is None or bool(reading.present.all())
        positions = reading.positions - self._zeros
        if reading.present is not None and self.positions:
            positions = np.where(reading.present, positions, self.positions[-1])
        self.positions.append(positions)
        self.present.append(present)
        self.switches.append(reading.switch)
        self.late += reading.late > 0
        return reading

    def halted(self, sentence: str, remedy: str) -> _Halted:
        """Return the exception that ends the commissioning in the present step."""
        return _Halted(Finding(self.step, Grade.WRONG, sentence, remedy))

    def advance(self, acceleration: float) -> Reading:
        """Send a command, m/s², and return the next reading.

        Raises:
            _Halted: the rig has failed, the cart has left its range, or its position is not read.
        """
        command = min(max(acceleration, -self._most), self._most)
        self.rig.command(command)
        self.commands.append(command)
        reading = self.read()
        self._gap = 0 if self.present[-1] else self._gap + 1
        if self.rig.fault is not None:
            creeping = self.step == "switches"
            remedy = "give --switches less than the distance to the hard stop" if creeping else _COMPLAINS
            raise self.halted(self.rig.fault.text, remedy)
        if self._gap * self.period > _LONGEST_GAP:
            absent = [k for k, there in enumerate([] if reading.present is None else reading.present) if not there]
            if len(absent) > self.arms:
                raise self.halted(
                    f"no reading came for {self._gap * self.period:.2g} s, so the cart was stopped",
                    "check whether the rig sends a reading each period, and whether the network loses packets",
                )
            sensors = [*(f"the encoder of arm {k + 1}" for k in range(self.arms)), "the cart's scale"]
            which = " and ".join(sensors[k] for k in absent)
            raise self.halted(
                f"{which} gave no reading for {self._gap * self.period:.2g} s, so the cart was stopped",
                "check whether it is plugged in, and whether the rig's program reads it",
            )
        away = self.cart - self.home
        if abs(away) > self.reach and self.late > _OFTEN_LATE * self.tick:
            raise self.halted(
                f"the cart left its {1e3 * self.reach:.3g} mm and was stopped, since {self.late} of {self.tick} "
                "commands came at least a period late",
                _HURRY,
            )
        if abs(away) > self.reach:
            raise self.halted(
                f"the cart left its {1e3 * self.reach:.3g} mm (it is at {1e3 * away:+.3g} mm), so it was stopped",
                "check whether the drive follows an acceleration in m/s², holds the cart at zero, and has the cart's "
                "scale in metres",
            )
        return reading

    def follow(self, path: Array, feedforward: Array) -> None:
        """Follow a path with feedforward and slow feedback.

        Positions (K,) are in m from home, feedforward accelerations (K,) in m/s².
        """
        for wanted, slope, ahead in zip(path, np.gradient(path, self.period), feedforward, strict=True):
            self.advance(self.steered(wanted, slope, ahead))

    def steered(self, wanted: float, slope: float, ahead: float) -> float:
        """Return the command for a position and a velocity, m/s².

        The position, m, and the velocity, m/s, are relative to home.
        """
        then = self.positions[max(self.tick - self._span, 0)][-1]
        velocity = (self.cart - float(then)) / (min(self._span, max(self.tick, 1)) * self.period)
        error = self.home + wanted - self.cart
        pull = _FREQUENCY**2 * error + 2 * _DAMPING * _FREQUENCY * (slope - velocity)
        return (ahead + pull) / self.gain

    def hold(self, seconds: float) -> None:
        """Hold the cart at home."""
        still = np.zeros(max(2, round(seconds / self.period)))
        self.follow(still, still)

    def filled(self, first: int = 0) -> Array:
        """Return the readings (K, n+1) of arms and cart from tick `first`, with gaps interpolated linearly."""
        rows, present = np.array(self.positions[first:]), np.array(self.present[first:])
        if not present.all() and present.any():
            ticks = np.arange(len(rows))
            rows = np.stack([np.interp(ticks, ticks[present], v[present]) for v in rows.T], axis=1)
        return rows


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
        zeros: present zeros (n,), rad.
        switches: distance to creep to either side until a limit switch responds, m; 0 to skip this.
        options: settings of the commissioning.
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
    findings: list[Finding] = []
    halts: list[Finding] = []
    changes: dict[str, Any] = {}
    session, motion = None, _Motion()
    # Slow computations run before the first tick or after the last, because a rig stops if its loop is silent.
    chirp = _chirp(arms, rig.period, options)
    try:
        session = _Session(rig, arms.count, limits, zeros)
        _move(session, motion, arms, chirp, switches, limits, options, notify)
    except _Halted as halted:
        halts.append(halted.finding)
    except ArithmeticError as failure:
        halts.append(Finding(session.step if session else "still", Grade.WRONG, str(failure), _COMPLAINS))
    finally:
        rig.stop()
    if session is not None and motion.rang_to:
        findings += _judged(session, motion, arms, settings, tuple(zeros), changes)
        right = all(f.verdict is Grade.OK for f in findings if f.step == "drive")
        findings += motion.switches if right else [_untried("the drive has a fault", "fix the drive first")]
    findings += halts
    if session is not None:
        findings.append(_deadlines(session))
    found = Commissioning(tuple(findings), changes)
    return replace(found, changes={}) if found.blocking else found


@dataclass
class _Motion:
    """Ticks of the parts of the motion, and switch results.

    Parts have a first and a last tick.
    """

    held_from: int = 0
    chirped_from: int = 0
    chirped_to: int = 0
    rang_to: int = 0
    switches: list[Finding] = field(default_factory=list)


def _move(
    session: _Session, motion: _Motion, arms: ArmChainParameters, chirp: tuple[Array, Array], switches: float,
    limits: Limits, options: CommissioningSettings, notify: Notify,
) -> None:  # fmt: skip
    """Perform all motions of the cart."""
    notify(f"the arms should hang with the cart at the centre; it will move by at most {1e3 * REACH:.0f} mm")
    _look(session, options)
    notify("the cart shifts a few millimetres and back: check that it goes to the right first")
    session.step = "drive"
    _shift(session, arms)
    session.step = "still"
    _wait_until_still(session, options, notify)
    notify(f"the cart follows a chirp for {options.sweep:g} s, then stays still for {options.ring:g} s; the arms swing")
    session.step, motion.held_from = "delay", session.tick
    session.hold(options.hold)
    motion.chirped_from = session.tick
    # A small gain may come from a scale that shows too little, and the cart may then move further than measured.
    share = min(abs(session.gain), 1.0)
    session.follow(*(share * part for part in chirp))
    motion.chirped_to = session.tick
    session.hold(options.ring)
    motion.rang_to = session.tick
    session.step = "switches"
    if not switches:
        remedy = "give --switches with the distance in metres that the cart can move"
        motion.switches = [_untried("--switches was not given", remedy)]
    elif abs(session.gain - 1) > _SAFE_GAIN:
        # With a wrong scale, the cart could reach the hard stop.
        motion.switches = [_untried("the drive has a fault", "fix the drive first")]
    else:
        notify(f"the cart creeps to the right, then to the left, by up to {switches:g} m: be ready to cut the power")
        session.reach = switches + REACH
        sides = ((1, "right"), (-1, "left"))
        motion.switches = [_tried_switch(session, side, name, switches, limits, options) for side, name in sides]


_SAFE_GAIN = 0.2


def _untried(why: str, remedy: str) -> Finding:
    return Finding("switches", Grade.UNSURE, f"the limit switches were not tried: {why}", remedy)


def _judged(
    session: _Session, motion: _Motion, arms: ArmChainParameters, settings: LoopSettings, zeros: tuple[float, ...],
    changes: dict[str, Any],
) -> list[Finding]:  # fmt: skip
    """Return the findings of the motion, and add measured values to `changes`."""
    readings, since = session.filled()[: motion.rang_to + 1], motion.held_from
    angles, carts = readings[:, :-1], readings[:, -1]
    drive = fit_drive(carts, session.commands, session.period, first=motion.chirped_from, last=motion.chirped_to)
    swing = fit_swing(angles[since:], carts[since:], session.period, arms)
    wiring = read_wiring(swing)
    signs = _signs(drive.gain, np.where(wiring.unknown, 0.0, wiring.factors))
    return [
        _zeros(session, swing, wiring, zeros, settings, changes),
        _direction(drive, wiring, signs),
        _lateness(drive, settings, session.period, changes),
        *_encoders(wiring, swing, signs, drive.gain),
        _counts(session, wiring, drive.gain, settings, changes),
        _play(angles[since:], session.period, wiring, settings, changes),
        _friction(swing, arms, settings),
        _model(swing, wiring, arms),
    ]


def _look(session: _Session, options: CommissioningSettings) -> None:
    """Take readings before any motion."""
    if abs(session.home) > _OFF_CENTRE:
        raise session.halted(
            f"the cart is at {session.home:+.4g} m by its scale",
            "move it to the centre of its track, and set its scale to zero there, in metres",
        )
    for _ in range(max(4, round(options.look / session.period))):
        session.advance(0.0)
    if session.switches[-1]:
        side = "right" if session.switches[-1] > 0 else "left"
        raise session.halted(
            f"the limit switch at the {side} responds although the cart does not touch it",
            "check whether it is stuck or its contact is inverted (normally closed), and whether the cart is at the "
            "centre",
        )


_OFF_CENTRE = 0.02
"""m."""


_SHIFTS = {0.0005: 0.1, 0.003: 0.7}
"""Shifts of the cart, m; the second follows if the first is not clearly visible.

Each has the maximum fraction of the opposite shift's residual: with a drifting cart, a small shift resembles its
opposite at another time.
"""
_LARGEST_SHIFT = max(_SHIFTS)
_SHIFT_SECONDS, _AFTER_SHIFT = 0.16, 0.1
_SEEN, _CLEARLY_SEEN = 0.0002, 5.0
"""Minimum visible shift, m, and as a multiple of the cart's drift."""


def _shift(session: _Session, arms: ArmChainParameters) -> None:
    """Find the drive's direction and gain, without feedback, which would require them."""
    quarter = max(1, round(_SHIFT_SECONDS / 4 / session.period))
    pattern = np.repeat([1.0, -1.0, -1.0, 1.0], quarter) / (quarter * session.period) ** 2
    after = max(2, round(_AFTER_SHIFT / session.period))
    before = session.filled()[-(len(pattern) + after) :, -1]
    wander = float(np.std(before - _drift(before)))
    seen = 0.0
    for size, share in _SHIFTS.items():
        if size < _LARGEST_SHIFT and _CLEARLY_SEEN * wander > size / 3:
            continue
        first = session.tick
        for value in (*(pattern * size), *np.zeros(after)):
            session.advance(float(value))
        carts = session.filled(first)[:, -1]
        wanted = _response(np.array([*session.commands[first:], 0.0]), session.period, 0.0)[:, 0]
        # The drive's delay is still unknown, so the best-fitting one is used. The whole shift must be visible.
        delays = range(0, after + 1, max(1, quarter // 8))
        fits = [_slope(wanted[: len(wanted) - k], carts[k:]) for k in delays]
        gain, left = min(fits, key=lambda fit: fit[1])
        opposite = min((other for slope, other in fits if slope * gain <= 0), default=1.0)
        seen = abs(gain) * size
        if seen > _SEEN and abs(gain) * np.std(wanted) > _CLEARLY_SEEN * wander and left < share * opposite:
            session.gain = gain
            return
    _no_shift(session, arms, seen)


def _drift(values: Array) -> Array:
    """Return the linear trend of values (K,)."""
    line = np.vander(np.linspace(-1, 1, len(values)), 2)
    return line @ _solved(line, values)


def _solved(design: Array, values: Array) -> Array:
    """Return the least-squares solution.

    `design` is (K, p), and the values are (K,) or (K, n).
    """
    return np.asarray(np.linalg.lstsq(design, values, rcond=None)[0], dtype=float)


def _slope(wanted: Array, seen: Array) -> tuple[float, float]:
    """Return the slope of `seen` on `wanted` without drifts.

    The unexplained fraction of the variance follows.
    """
    wanted, seen = wanted - _drift(wanted), seen - _drift(seen)
    size = float(wanted @ wanted)
    slope = float(wanted @ seen) / size
    return slope, 1 - slope**2 * size / max(float(seen @ seen), 1e-30)


def _no_shift(session: _Session, arms: ArmChainParameters, seen: float) -> None:
    """Raise the cause of an invisible shift.

    The arms reveal motion of the cart.
    """
    wandered = float(np.ptp(session.filled()[:, -1]))
    if wandered > _SEEN:
        raise session.halted(
            f"the cart wanders by {1e3 * wandered:.2g} mm, in which a commanded shift of {1e3 * _LARGEST_SHIFT:g} mm "
            "and back is not visible",
            "check whether the drive holds the cart where zero is commanded, and follows accelerations in m/s²",
        )
    for _ in range(round(1.0 / session.period)):
        session.advance(0.0)
    commanded = _response(np.array([*session.commands, 0.0]), session.period, 0.0)[:, 0]
    wiring = read_wiring(fit_swing(session.filled()[:, :-1], commanded, session.period, arms))
    if float(np.abs(wiring.factors).max()) > 0.3:
        raise session.halted(
            f"the arms began to swing when the cart was to shift by {1e3 * _LARGEST_SHIFT:g} mm and back, but its "
            "reading did not change: the cart's scale does not count",
            "check whether the cart's scale is plugged in, and its reading is the last position sent, in metres",
        )
    raise session.halted(
        f"the cart does not move: commanded to shift by {1e3 * _LARGEST_SHIFT:g} mm and back, its reading shows "
        f"{1e3 * seen:.2g} mm of it and the arms do not swing",
        "check whether the motor is on, its brake released and the emergency stop pulled out, and commands reach the "
        "drive as accelerations in m/s²",
    )


def _wait_until_still(session: _Session, options: CommissioningSettings, notify: Notify) -> None:
    """Hold the cart until the arms hardly swing."""
    attempts, swing = math.floor(options.wait / _WATCHED) + 1, 0.0
    for attempt in range(attempts):
        if attempt == 1:
            notify(f"the arms swing by ±{swing:.2g} rad: hold them still; waiting for up to {options.wait:g} s")
        first = session.tick
        session.hold(_WATCHED)
        swing = float(np.ptp(session.filled(first)[:, :-1], axis=0).max()) / 2
        if swing <= options.still:
            return
    raise session.halted(
        f"the arms still swing by ±{swing:.2g} rad after {attempts * _WATCHED:.0f} s",
        "hold them until they hang still, let go and start again; if they do hang still, their readings are not in "
        "radians, or are wrapped to one turn",
    )


_WATCHED = 1.2
"""Time of hanging still that is observed, s: longer than a period."""


def _chirp(arms: ArmChainParameters, period: float, options: CommissioningSettings) -> tuple[Array, Array]:
    """Return the positions and accelerations of a logarithmic chirp.

    The positions and accelerations are (K,), in m and in m/s².
    """
    slowest = float(modes(arms).frequencies.min()) / (2 * np.pi)
    low, high = 0.6 * slowest, min(options.highest, 0.1 / period)
    finer = 8
    t = np.arange(round(options.sweep / period) * finer + 1) * period / finer
    growth = math.log(high / low) / options.sweep
    frequency = 2 * np.pi * low * np.exp(growth * t)
    phase = 2 * np.pi * low * np.expm1(growth * t) / growth
    fade = np.clip(np.minimum(t, options.sweep - t) / min(0.5, options.sweep / 8), 0, 1)
    size = np.minimum(options.amplitude, options.push / frequency**2)
    x = size * np.sin(np.pi / 2 * fade) ** 2 * np.sin(phase)
    v = np.gradient(x, t)
    v[[0, -1]] = 0.0
    return x[:-1:finer], np.diff(v[::finer]) / period


class DriveFit(NamedTuple):
    """Fitted drive: delay and lag, s, gain, standard errors.

    misfit: unexplained fraction of the motion.
    """

    delay: float
    lag: float
    gain: float
    errors: tuple[float, float, float]
    misfit: float


def _response(commands: Array, period: float, total: float, square: float = 0.0) -> Array:
    """Return the response of a cart at rest, with slopes (K, 3).

    It responds to commands (K,) m/s², with one row for each tick.

    The columns are the position for unit gain and its derivatives. These are with respect to `total` s, the sum of
    delay and lag, and `square` s², that of the lag. The two are nearly independent even at zero lag, unlike delay and
    lag.
    """
    lag = math.sqrt(square)
    after = np.maximum(np.arange(len(commands)) * period - (total - lag), 0.0)
    ratio = after / lag if lag else np.where(after > 0, np.inf, 0.0)
    fading = np.exp(-ratio)
    rising = lag * (1 - fading)
    position = after**2 / 2 - lag * (after - rising)
    by_square = (1 - fading - np.where(fading > 0, ratio, 0.0) * fading) / 2
    kernels = np.stack([position, rising - after, by_square], axis=1)
    changes = np.diff(commands, prepend=0.0)[:, None]
    return signal.fftconvolve(changes, kernels, axes=0)[: len(commands)]


_HIGH_PASS = 20.0
"""Corner frequency of the filter, Hz. Below it, positions become accelerations, in which command noise is white."""
_MARGIN = 0.5
"""Time before and after the chirp that the fit includes, s."""
_BLOCKS = 24


def fit_drive(carts: Array, commands: Sequence[float], period: float, *, first: int, last: int) -> DriveFit:
    """Fit delay, lag and gain of the drive.

    Args:
        carts: readings (K,), m.
        commands: command after each reading, m/s².
        period: control period, s.
        first: tick at which the chirp begins.
        last: tick at which it ends.
    """
    begin, end = max(first - round(_MARGIN / period), 0), min(last + round(_MARGIN / period), len(carts))
    x, u = carts[begin:end], np.array([*commands, 0.0])[begin:end]
    cutoff = min(_HIGH_PASS, 0.05 / period)
    sections = signal.butter(2, cutoff, "highpass", fs=1 / period, output="sos")
    t = np.linspace(-1, 1, len(x))
    skip = min(round(0.3 / period), len(x) // 8)

    def high(values: Array) -> Array:
        return np.asarray(signal.sosfilt(sections, values, axis=0), dtype=float)[skip:]

    base, _ = np.linalg.qr(high(np.vander(t, 3)))

    def seen(values: Array) -> Array:
        passed = high(values) / size
        return passed - base @ (base.T @ passed)

    # In units of the motion itself, so that tolerances are relative.
    size = 1.0
    size = max(float(np.std(seen(x[:, None]))), 1e-9)
    y = seen(x[:, None])[:, 0]

    def rough(total: float, lag: float) -> tuple[float, float]:
        p = seen(_response(u, period, total, lag**2)[:, :1])[:, 0]
        gain = float(p @ y) / max(float(p @ p), 1e-30)
        return float(np.sum((y - gain * p) ** 2)), gain

    lags = (0.0, 0.004, 0.016)
    grid = [(0.5 * period + d + lag, lag) for d in (0.0, *(0.001 * 2.0**k for k in range(8))) for lag in lags]
    total, lag = min(grid, key=lambda point: rough(*point)[0])
    unit = np.array([1e-3, 1e-6, 1.0])
    low, most = np.array([-period, 0.0, -np.inf]) / unit, np.array([0.8, 0.09, np.inf]) / unit

    def residual(values: Array) -> Array:
        total, square, gain = values * unit
        return gain * seen(_response(u, period, total, square)[:, :1])[:, 0] - y

    def slopes(values: Array) -> Array:
        total, square, gain = values * unit
        parts = seen(_response(u, period, total, square))
        return np.stack([gain * parts[:, 1], gain * parts[:, 2], parts[:, 0]], axis=1) * unit

    def fitted(values: Array, free: list[int]) -> tuple[Array, Array]:
        """Return the best values, with `free` ones fitted, and their standard errors."""

        def whole(some: Array) -> Array:
            out = values.copy()
            out[free] = some
            return out

        scale = 1.0
        # A late command disturbs the cart for a moment; a robust loss reduces its weight.
        for loss in ("linear", "soft_l1"):
            found = optimize.least_squares(
                lambda some: residual(whole(some)), values[free],
                lambda some: slopes(whole(some))[:, free],  # type: ignore[arg-type]
                bounds=(low[free], most[free]), method="dogbox", loss=loss, f_scale=scale, x_scale="jac",
            )  # fmt: skip
            values = whole(found.x)
            left = residual(values)
            scale = max(1.5 * 1.4826 * float(np.median(np.abs(left))), 1e-9)
        errors = np.zeros(len(values))
        errors[free] = _sandwich(slopes(values)[:, free], left, 1 / np.sqrt(1 + (left / scale) ** 2))
        return values, errors

    # Start inside the bounds, because a search would stay on them.
    values, errors = fitted(np.array([total, max(lag, 5e-4) ** 2, rough(total, lag)[1]]) / unit, [0, 1, 2])
    # Error of the square's root, which is non-negative.
    lag_error = math.sqrt(values[1] * unit[1] + errors[1] * unit[1]) - math.sqrt(values[1] * unit[1])
    if values[1] < 3 * errors[1] or values[1] * unit[1] < _NO_LAG**2:
        # The lag is then zero and must not add to the uncertainty of the delay.
        lag_error = math.sqrt((values[1] + errors[1]) * unit[1])
        values[1] = 0.0
        values, errors = fitted(values, [0, 2])
    total, square, gain = (values * unit).tolist()
    lag, total_error = math.sqrt(square), float(errors[0] * unit[0])
    misfit = float(np.sqrt(np.mean(residual(values) ** 2) / max(np.mean(y**2), 1e-24)))
    delay_error = math.hypot(total_error, lag_error) if lag else total_error
    return DriveFit(total - lag, lag, gain, (delay_error, lag_error, float(errors[2])), misfit)


_NO_LAG = 2e-5
"""Lag below which it counts as zero, s."""


def _sandwich(jacobian: NDArray[Any], residual: Array, weights: Array | None = None) -> Array:
    """Return standard errors (p,) for correlated residuals.

    The residuals (K,) are correlated over blocks, and have the weights (K,) of soft_l1.
    """
    weights = np.ones(len(residual)) if weights is None else weights
    blocks = max(_BLOCKS, 3 * jacobian.shape[1])
    edges = np.linspace(0, len(residual), blocks + 1).round().astype(int)[:-1]
    scores = np.add.reduceat(jacobian * (weights * residual)[:, None], edges)
    # The derivative of weight times residual is the cube of the weight.
    inverse = np.linalg.pinv(jacobian.T @ (weights[:, None] ** 3 * jacobian))
    few = blocks / (blocks - jacobian.shape[1])
    return np.sqrt(few) * np.linalg.norm(scores @ inverse, axis=0)


class Modes(NamedTuple):
    """Normal modes of hanging arms.

    Frequencies (n,) rad/s, dampings (n,), shapes W_0 (n, n) by column.

    `vectors` (n, n) are the modes of unit mass, by column.
    """

    frequencies: Array
    dampings: Array
    shapes: Array
    vectors: Array


def modes(arms: ArmChainParameters) -> Modes:
    """Return the normal modes of hanging arms on an accelerated cart.

    Θ = shapes · y.

    Args:
        arms: parameters of the n arms.
    """
    n, base = arms.count, arms.base()
    weights, coupling = base[n * (n + 1) // 2 :][:n], base[n * (n + 1) // 2 + n :][:n]
    joints = np.linalg.inv(_sums(n))
    drag = joints.T @ np.diag(arms.viscous) @ joints
    squares, vectors = linalg.eigh(np.diag(weights), arms.mass_in_line)
    frequencies = np.sqrt(squares)
    dampings = np.diag(vectors.T @ drag @ vectors) / (2 * frequencies)
    return Modes(frequencies, dampings, vectors * (vectors.T @ coupling), vectors)


def _sums(n: int) -> Array:
    """Return the matrix that converts joint angles to absolute angles."""
    return np.tril(np.ones((n, n)))


class CommissioningSwing(NamedTuple):
    """Swing of n arms in K readings, and the motion of the model that is nearest to it.

    Attributes:
        readings: readings (K, n), rad.
        motion: absolute angles (K, n) of the fitted model, rad.
        slopes: derivatives (K n, p) of the readings with respect to the fitted parameters.
        ratios: frequencies (n,) of the modes relative to the model.
        viscous: viscous friction (n,) of the joints, N m s/rad, and its standard errors.
        dry: dry friction (n,) of the joints, N m, and its standard errors.
        zeros: readings (n,) of hanging arms, rad, and their standard errors.
    """

    readings: Array
    motion: Array
    slopes: Array
    ratios: Array
    viscous: tuple[Array, Array]
    dry: tuple[Array, Array]
    zeros: tuple[Array, Array]


_LEAST_SWING = 1e-3
"""Swing of a joint that is necessary to judge its encoder, rad rms."""
_DETUNED = np.linspace(-3, 3, 25)
"""Logarithms of the ratios of frequencies to try, in units of 0.1."""
_DRY = np.array([0.0, 0.2, 0.5, 1.0, 2.0, 5.0, 20.0])
"""Dry friction to try, in percent of gravity's torque on the arms."""
_ROWS = 100.0
"""Sampling rate that is sufficient for slow swings, Hz."""
_SWEEPS = 3
"""Corrections of the dry torques in each step, which begin with those of the last step."""
_STEP = 1e-4
"""Difference of scaled parameters for derivatives."""


def simulated_swings(values: Array, carts: Array, period: float, arms: ArmChainParameters) -> Array:
    """Return the angles (P, K, n) of hanging arms on a moving cart, with viscous and dry friction, rad.

    Rates of joints are found at the middle of each step, at which the dry torque of a joint either holds it or has its
    full size (Moreau's time stepping). All sets of values are simulated together.

    Args:
        values: P rows of 5n values: logarithms of the ratios of frequencies, viscous friction, N m s/rad, dry friction,
            N m, and first angles and rates of the joints.
        carts: positions (K,) of the cart, m.
        period: time between positions, s.
        arms: model of the arms, whose friction is ignored.
    """
    n, model = arms.count, modes(arms)
    sums = _sums(n)
    ratios, viscous, dry, place, speed = (part[:, :, None] for part in np.split(values, 5, axis=1))
    mass = sums.T @ arms.mass_in_line @ sums
    shapes = sums.T @ arms.mass_in_line @ model.vectors
    inverse = np.linalg.inv(mass + period * np.eye(n) * viscous)
    stiffness = shapes @ ((model.frequencies[:, None] * np.exp(ratios)) ** 2 * shapes.T)
    keeps, pulls = inverse @ mass, period * inverse @ stiffness
    jumps = np.diff(carts, prepend=carts[0], n=2) / period
    pushes = jumps[:, None, None] * (np.linalg.inv(sums) @ model.shapes.sum(axis=1))[:, None]
    limit, held, out = period * dry, np.zeros_like(dry), np.empty((len(carts), *place.shape))
    columns, sizes = [inverse[:, :, j : j + 1] for j in range(n)], [inverse[:, j : j + 1, j : j + 1] for j in range(n)]
    out[0] = place
    for k, push in enumerate(pushes, start=1):
        speed = keeps @ (speed - push) - pulls @ place - inverse @ held
        for j in [*range(n)] * _SWEEPS:
            torque = held[:, j : j + 1] + speed[:, j : j + 1] / sizes[j]
            torque = np.maximum(np.minimum(torque, limit[:, j : j + 1]), -limit[:, j : j + 1])
            speed = speed - columns[j] * (torque - held[:, j : j + 1])
            held[:, j : j + 1] = torque
        place = place + period * speed
        out[k] = place
    return (sums @ out)[..., 0].transpose(1, 0, 2)


def _coarse_guess(costs: Callable[[Array], Array], guess: Array, n: int) -> Array:
    """Return the best of coarse grids of friction and frequencies, one parameter after the other, scaled."""
    dry = [[2 * n + k] for k in range(n)]
    # Friction can look like another frequency, so a frequency must improve the fit the more the farther it is away.
    for places in ([*range(2 * n, 3 * n)], *dry, *([k] for k in range(n)), *dry):
        tried, penalty = (_DETUNED, 1 + np.abs(_DETUNED)) if places[0] < n else (_DRY, np.ones(len(_DRY)))
        lanes = np.tile(guess, (len(tried), 1))
        lanes[:, places] = tried[:, None]
        guess = lanes[np.argmin(costs(lanes) * penalty)]
    return guess


def fit_swing(angles: Array, carts: Array, period: float, arms: ArmChainParameters) -> CommissioningSwing:
    """Fit frequencies, friction and first state of the arms to their readings.

    The readings can be any linear combination of the angles.

    Args:
        angles: readings (K, n) of the arms, rad.
        carts: readings (K,) of the cart, m.
        period: time between readings, s.
        arms: model of the arms.
    """
    n, every = arms.count, max(1, round(1 / (_ROWS * period)))
    rows, x, period = angles[::every], carts[::every] - carts[0], period * every
    weight = float(arms.base()[n * (n + 1) // 2 :][:n].max())
    unit = np.repeat([0.1, 1e-3 * weight, 1e-2 * weight, 0.05, 0.3], n)

    def left(values: Array) -> tuple[Array, Array]:
        """Return angles and a constant (P, K, n+1), and the residuals (P, K, n) of their best combinations."""
        motions = simulated_swings(values * unit, x, period, arms)
        designs = np.concatenate([motions, np.ones((len(values), len(rows), 1))], axis=2)
        return designs, np.array([design @ _solved(design, rows) - rows for design in designs])

    start = np.concatenate([np.zeros(n), arms.viscous, np.zeros(3 * n)]) / unit
    # A fit from the model's frequencies and a friction that nearly holds the arms finds what a coarse search misses.
    starts = (
        start + np.repeat([0, 0, 1, 0, 0], n),
        _coarse_guess(lambda lanes: (left(lanes)[1] ** 2).sum(axis=(1, 2)), start, n),
    )

    @lru_cache(maxsize=2)
    def near(values: tuple[float, ...]) -> tuple[Array, Array]:
        return left(values + _STEP * np.eye(5 * n + 1, 5 * n, k=-1))

    def slopes(lanes: Array) -> Array:
        return (lanes[1:] - lanes[0]).reshape(5 * n, -1).T / _STEP

    bounds = np.repeat([[-5.0, 0.0, 0.0, -np.inf, -np.inf], [5.0, np.inf, np.inf, np.inf, np.inf]], n, axis=1)
    fits = [
        optimize.least_squares(
            lambda values: near(tuple(values))[1][0].ravel(), guess,
            lambda values: slopes(near(tuple(values))[1]),  # type: ignore[arg-type]
            bounds=bounds, ftol=1e-4, xtol=1e-4, max_nfev=25,
        )
        for guess in starts
    ]  # fmt: skip
    found = min(fits, key=lambda fit: fit.cost)
    designs, rest = near(tuple(found.x))
    weights = _solved(designs[0], rows)
    turned = slopes(designs @ weights)
    # Each reading has its own combination and zero.
    errors = _sandwich(np.hstack([turned, np.kron(designs[0], np.eye(n))]), rest[0].ravel())
    ratios, viscous, dry, *_ = np.split(found.x * unit, 5)
    own = np.split(errors[: 5 * n] * unit, 5)
    return CommissioningSwing(
        rows, designs[0, :, :n], turned, np.exp(ratios), (viscous, own[1]), (dry, own[2]), (weights[-1], errors[-n:])
    )


class Form(StrEnum):
    """Relation between angles and encoders."""

    SUMMED = "joint encoders, summed"
    RELATIVE = "joint encoders, not summed"
    ABSOLUTE = "absolute encoders"
    TWICE = "absolute encoders, summed"


class Wiring(NamedTuple):
    """Wiring: form, order of the encoders, signs and factors (n,), unexplained fraction of the rms.

    The standard error (n,) of a factor that friction hides is infinite.
    """

    form: Form
    order: tuple[int, ...]
    factors: Array
    misfit: float
    errors: Array

    @property
    def unknown(self) -> NDArray[np.bool_]:
        """Return which factors (n,) are unknown."""
        return 3 * self.errors > _FACTOR * np.maximum(np.abs(self.factors), 1)


_CLEARLY = 0.6
"""A fault is reported if it leaves less than this fraction of the correct wiring's residual."""


def read_wiring(swing: CommissioningSwing) -> Wiring:
    """Return the wiring that fits the readings best.

    Args:
        swing: readings, and the motion of the fitted model.
    """
    n = swing.readings.shape[1]
    sums, rest = _sums(n), swing.readings - swing.readings.mean(axis=0)
    joints, one = np.linalg.inv(sums), np.eye(n)
    forms = {Form.SUMMED: (sums, joints), Form.ABSOLUTE: (one, one), Form.RELATIVE: (one, joints),
             Form.TWICE: (sums, one)}  # fmt: skip
    found: list[tuple[Wiring, Array]] = []
    for order in permutations(range(n)):
        for form, (after, before) in forms.items():
            inner = (swing.motion - swing.motion.mean(axis=0)) @ before[list(order)].T
            columns = (after * inner[:, None]).reshape(-1, n)
            factors = _solved(columns, rest.ravel())
            left = float(np.linalg.norm(rest.ravel() - columns @ factors) / max(np.linalg.norm(rest), 1e-12))
            errors = np.where(inner.std(axis=0) < _LEAST_SWING, np.inf, 0.0)
            found.append((Wiring(form, order, factors, left, errors), columns))
    least = min(wiring.misfit for wiring, _ in found)
    nearest, columns = next(pair for pair in found if _CLEARLY * pair[0].misfit <= least + 1e-3)
    design = np.hstack([columns, swing.slopes, np.kron(np.ones((len(rest), 1)), one)])
    errors = _sandwich(design, rest.ravel() - columns @ nearest.factors)[:n]
    return nearest._replace(errors=np.maximum(errors, nearest.errors))


_STUCK = 0.08
"""Fraction of the swing below which an encoder does not move."""


def _stuck(wiring: Wiring) -> NDArray[np.bool_]:
    """Return which encoders (n,) do not move although their joints do."""
    return (np.abs(wiring.factors) < _STUCK) & ~wiring.unknown


_FACTOR = 0.25
"""Maximum relative difference to the swing of the model, whose parameters are not exact."""
_GAIN = 0.05
_LEFT_OVER = 0.3
"""Maximum unexplained fraction of a motion, rms."""


def _signs(gain: float, factors: Array) -> list[tuple[str, ...]]:
    """Return the fewest reversals of drive, cart's scale and arms' encoders that explain the signs.

    There are two solutions if the rig and its mirror image need equally many.
    """
    seen = {"cart": 1.0, "drive": gain}
    seen |= {f"arm {k + 1}": float(factor) for k, factor in enumerate(factors) if abs(factor) > _STUCK}
    answers = [tuple(name for name, value in seen.items() if value * cart < 0) for cart in (1, -1)]
    return [answer for answer in answers if len(answer) == min(map(len, answers))]


def _cart_scale(gain: float, factors: Array) -> bool:
    """True if the cart's scale alone explains the errors.

    They are the errors of the drive's gain and of all arms' swings.
    """
    return abs(abs(gain) - 1) > _GAIN and bool(np.all(np.abs(np.abs(factors * gain) - 1) < _FACTOR / 2))


def _direction(drive: DriveFit, wiring: Wiring, signs: list[tuple[str, ...]]) -> Finding:
    """Judge direction and gain of the drive and of the cart's scale."""
    gain, factors = drive.gain, wiring.factors
    figures = {"gain": gain, "gain_error": drive.errors[2]}
    wrong = partial(Finding, "drive", Grade.WRONG, figures=figures)
    if drive.misfit > _LEFT_OVER:
        return Finding(
            "drive", Grade.UNSURE,
            f"{100 * drive.misfit:.0f} % of the cart's motion is not explained by its commands and a drive with a "
            "delay and a lag",
            "check whether the drive works within its limits, and whether deadlines were missed", figures,
        )  # fmt: skip
    if len(signs) > 1:
        named = {"drive": "the drive", "cart": "the cart's scale"}
        either, other = (" and ".join(named.get(name, f"the encoder of {name}") for name in one) for one in signs)
        return wrong(
            f"either {either} are reversed, or {other}: the readings are the same",
            "check in which direction the cart goes first: to the right means that its drive is correct",
        )
    if "drive" in signs[0]:
        return wrong(
            "the drive is reversed: a command to the right moves the cart to the left, by its scale and by the arms",
            "reverse the sign of commands in the rig's program, or swap two of the motor's leads; if the cart "
            "went to the right first, reverse the cart's scale and all encoders instead",
        )
    if "cart" in signs[0]:
        return wrong(
            "the cart's scale is reversed: its reading decreases when the arms show that the cart goes to the right",
            "reverse the sign of the cart's reading in the rig's program",
        )
    if np.all(np.abs(factors) > _STUCK) and _cart_scale(gain, factors):
        return wrong(
            f"the cart's scale shows {abs(gain):.3g} times the distance that commands and arms show",
            f"divide the cart's reading by {abs(gain):.3g} in the rig's program; it is in metres",
        )
    if abs(gain - 1) > _GAIN:
        return wrong(
            f"the drive gives {gain:.3g} times the commanded acceleration",
            f"multiply commands by {1 / gain:.3g} in the rig's program, or correct the drive's own scale",
        )
    return Finding(
        "drive", Grade.OK, f"the cart goes in the commanded direction, with {gain:.3f} of the acceleration", "", figures
    )  # fmt: skip


_DEGREES = 180 / math.pi
_LIKELY = np.array([1.0, 2.0, 4.0, 0.5, 0.25, _DEGREES])


def _scales(wiring: Wiring, gain: float) -> Array:
    """Return the likely factor (n,) of each encoder, 1 without a fault, NaN if friction hides it.

    A measured factor is as accurate as the model.
    """
    sizes = np.maximum(np.abs(wiring.factors * (gain if _cart_scale(gain, wiring.factors) else 1.0)), _STUCK)
    nearest = _LIKELY[np.argmin(np.abs(np.log(_LIKELY / sizes[:, None])), axis=1)]
    likely = np.where(np.abs(sizes / nearest - 1) <= _FACTOR, nearest, sizes)
    doubtful = (likely != 1) & (np.abs(sizes - 1) < _FACTOR + 3 * wiring.errors)
    return np.where(wiring.unknown | doubtful, np.nan, likely)


def _lateness(drive: DriveFit, settings: LoopSettings, period: float, changes: dict[str, Any]) -> Finding:
    """Compare delay and lag with those in [run]."""
    delay, lag = max(drive.delay / period, 0.0), drive.lag
    errors = drive.errors[0] / period, drive.errors[1]
    figures = {"delay": delay, "delay_error": errors[0], "lag": lag, "lag_error": errors[1], "misfit": drive.misfit}
    if drive.misfit > _LEFT_OVER:
        return Finding("delay", Grade.UNSURE, "delay and lag cannot be determined from this motion",
                       "fix the finding of the previous step and start again", figures)  # fmt: skip
    said = settings.drive
    sentence = (
        f"the delay is {_with_error(delay, errors[0])} periods, the lag {_with_error(1e3 * lag, 1e3 * errors[1])} ms"
    )
    # One for the simulated bench, one for the controller.
    changes |= {"delay": round(delay, 3), "lag": round(lag, 5), "drive_lag": round(lag, 5)}
    close = abs(delay - said.delay) <= max(0.1, 3 * errors[0])
    if close and abs(lag - said.lag) <= max(5e-4, 3 * errors[1], 0.1 * said.lag):
        return Finding("delay", Grade.OK, f"{sentence}, as in [run]", "", figures)
    return Finding(
        "delay", Grade.WRONG, f"{sentence}, but [run] has {said.delay:g} periods and {1e3 * said.lag:g} ms",
        f"set delay = {changes['delay']:g}, lag and drive_lag = {changes['lag']:g} in [run], as --write does", figures,
        mended=True,
    )  # fmt: skip


def _with_error(value: float, error: float) -> str:
    """Return a number with its standard error.

    The number is rounded to two digits of the error.
    """
    digits = min(max(1 - math.floor(math.log10(max(error, 1e-9))), 0), 4)
    return f"{value:.{digits}f} ± {error:.{digits}f}"


_ZERO, _FAR = 0.003, 0.5
"""Largest zero that needs no change, and largest that can be adjusted, rad."""


def _zeros(
    session: _Session, swing: CommissioningSwing, wiring: "Wiring", zeros: tuple[float, ...], settings: LoopSettings,
    changes: dict[str, Any],
) -> Finding:  # fmt: skip
    """Judge the readings of hanging arms."""
    off, errors = swing.zeros
    sentence = f"hanging still, the arms read {', '.join(map(_with_error, off, errors))} rad"
    figures = {"zeros": off.tolist(), "zero_errors": errors.tolist()}
    if np.any(_stuck(wiring)):
        return Finding("still", Grade.UNSURE, "the arms' zeros cannot be determined while an encoder does not count",
                       "fix the encoder and start again", figures)  # fmt: skip
    if np.abs(off).max() > _FAR:
        return Finding("still", Grade.WRONG, f"{sentence}: angles are measured from hanging, so each must be zero",
                       "set the encoders to zero while the arms hang", figures)  # fmt: skip
    allowed = max(_ZERO, 1.5 * max(settings.sensors.steps(len(off))))
    # An arm that hangs on a joint which friction holds can rest beside its zero.
    known = ~np.logical_or.accumulate(np.isinf(wiring.errors))
    large, wrong = np.abs(off) > allowed, known & (np.abs(off) > np.maximum(allowed, 3 * errors))
    if wrong.any() or zeros:
        before = np.array(zeros or [0.0] * len(off))
        changes["zeros"] = [round(float(v), 5) for v in np.where(known & (wrong | ~large), before + off, before)]
    if not wrong.any():
        hidden = "loosen the joints and start again: friction hides the zeros" if large.any() or not known.all() else ""
        return Finding("still", Grade.UNSURE if hidden else Grade.OK, sentence, hidden, figures)
    tilt = f", or level the track: all arms hang to one side by {off.mean():+.4f} rad"
    return Finding(
        "still", Grade.WRONG, sentence,
        f"set the encoders to zero while the arms hang, or zeros = {changes['zeros']} in [run], as --write does"
        f"{tilt if len(off) > 1 and np.ptp(off) < allowed else ''}",
        figures, mended=True,
    )  # fmt: skip


def _encoders(wiring: Wiring, swing: CommissioningSwing, signs: list[tuple[str, ...]], gain: float) -> list[Finding]:
    """Judge order, form, signs and counts of the encoders.

    One finding for each fault.
    """
    factors, unknown = wiring.factors, wiring.unknown
    figures = {
        "form": wiring.form.value, "order": [k + 1 for k in wiring.order], "factors": factors.tolist(),
        "errors": [None if math.isinf(e) else e for e in wiring.errors.tolist()], "misfit": wiring.misfit,
        "swing": swing.readings.std(axis=0).tolist(),
    }  # fmt: skip
    joint = "joint" if wiring.form in (Form.SUMMED, Form.RELATIVE) else "absolute"
    wrong = partial(Finding, "encoders", Grade.WRONG, figures=figures)
    if max(figures["swing"]) < _LEAST_SWING:
        remedy = "turn each arm by hand: loosen its joint if the reading follows, and check the encoder's plug if not"
        return [wrong("no arm's reading moves: the joints are stuck, or the encoders are not read", remedy)]
    stuck = np.flatnonzero(_stuck(wiring)).tolist()
    decided = not stuck and not unknown.any()
    found = [
        wrong(
            f"the encoder of arm {k + 1} does not move: it shows {abs(factors[k]):.2f} of the expected swing",
            f"check whether the encoder of arm {k + 1} is plugged in, powered and tight on its shaft",
        )
        for k in stuck
    ]
    if decided and wiring.misfit > _LEFT_OVER:
        return [
            Finding(
                "encoders",
                Grade.UNSURE,
                f"no known fault explains the swing of the arms: {100 * wiring.misfit:.0f} % is unexplained",
                "check whether the model is that of these arms (`dpcontrol identify`) and turn each arm by hand: its "
                "own angle should grow counter-clockwise",
                figures,
            )
        ]
    if decided and (moved := [k + 1 for k, place in enumerate(wiring.order) if place != k]):
        found.append(wrong(f"the encoders of arms {' and '.join(map(str, moved))} are swapped",
                           "swap their plugs, or their order in the rig's program"))  # fmt: skip
    if decided and wiring.form is Form.RELATIVE:
        found.append(wrong(
            "the rig sends the angle between each arm and the previous one",
            "send absolute angles: the sum of an arm's joint angle and those of all previous joints"))  # fmt: skip
    if decided and wiring.form is Form.TWICE:
        found.append(wrong("the rig sums angles that are already absolute", "send each encoder's angle as it is"))
    turned = {name for one in signs[:1] for name in one} if len(signs) == 1 else set()
    for k, scale in enumerate(_scales(wiring, gain)):
        if f"arm {k + 1}" in turned:
            found.append(wrong(
                f"the {joint} encoder of arm {k + 1} counts backwards",
                "reverse the sign of that encoder's counts in the rig's program, before angles are summed, or swap its "
                "channels A and B"))  # fmt: skip
        if k not in stuck and not math.isnan(scale) and scale != 1:
            why = "it may send degrees" if scale == _DEGREES else "its channels may count once, twice or four times"
            found.append(wrong(
                f"the encoder of arm {k + 1} shows {abs(factors[k]):.3g} times the swing of the model",
                f"divide its angle by {scale:.3g} in the rig's program, or multiply its counts per turn there: {why}, "
                "and angles are in radians"))  # fmt: skip
    hidden = [f"arm {k + 1}" for k in np.flatnonzero(np.isnan(_scales(wiring, gain)))]
    if hidden:
        found.append(Finding(
            "encoders", Grade.UNSURE, f"friction hides the scale of the encoder of {' and of '.join(hidden)}",
            "loosen the joint and start again, or turn the arm once by hand: its angle should change by 2π", figures,
        ))  # fmt: skip
    if found:
        return found
    shown = ", ".join(f"{factor:.2f}" for factor in factors)
    sentence = f"{joint} encoders in order, each with its sign; they show {shown} of the model's swing"
    return [Finding("encoders", Grade.OK, sentence, "", figures)]


_SAME = 0.02
"""Largest relative difference of counts that are the same."""


def _counts(
    session: _Session, wiring: Wiring, gain: float, settings: LoopSettings, changes: dict[str, Any]
) -> Finding:  # fmt: skip
    """Compare the rounding of joint angles with the encoder counts in [run]."""
    joints = np.diff(np.array(session.positions)[:, :-1], axis=1, prepend=0.0)
    steps = np.array([_rounding(column) for column in joints.T])
    # An angle that is four times too large has steps that are four times too large.
    scales = _scales(wiring, gain)
    seen = [round(2 * np.pi * f / q) if q and f == f else None for f, q in zip(scales, steps, strict=True)]
    said = settings.sensors.of_each("counts", len(seen))
    figures, assumed = {"counts": seen}, " and ".join({f"{n:,}" if n else "no rounding": n for n in said})
    if not any(seen):
        sentence = "the arms' readings show no rounding to counts"
        return Finding("counts", Grade.UNSURE if any(said) else Grade.OK, sentence,
                       f"check that the encoders have {assumed} counts per turn, as in [run]" if any(said) else "",
                       figures)  # fmt: skip
    sentence = f"the encoders show {' and '.join(f'{one:,}' if one else 'unknown' for one in seen)} counts per turn"
    if all(not one or (told and abs(one / told - 1) < _SAME) for one, told in zip(seen, said, strict=True)):
        return Finding("counts", Grade.OK if all(seen) else Grade.UNSURE, f"{sentence}, and [run] has {assumed}",
                       "" if all(seen) else "loosen the joints: friction hides the others", figures)  # fmt: skip
    # An encoder that was not measured keeps its number.
    found = [one or told for one, told in zip(seen, said, strict=True)]
    changes["counts"] = found if len(set(found)) > 1 else found[0]
    return Finding(
        "counts", Grade.WRONG, f"{sentence}, but [run] has {assumed}",
        f"set counts = {changes['counts']} in [run], as --write does", figures, mended=True,
    )  # fmt: skip


_SPAN, _SHORTEST = 0.1, 0.06
"""Time before and after a reversal that shows the play, and its minimum, s."""
_DEGREE = 4
_LIKE = 20
"""Number of consecutive correlated residuals."""


def fit_play(angles: Array, period: float) -> tuple[float, float]:
    """Return the play of an encoder and its standard error, rad.

    The play is that between a joint and its encoder.

    An encoder stops when its joint reverses, and follows again once the joint has crossed the play. Apart from the
    play, the readings on both sides of this gap lie on one smooth curve. Friction bends that curve at the reversal.

    Args:
        angles: angles (K,) of the joint, as its encoder reads them, rad.
        period: time between readings, s.
    """
    noise = float(np.median(np.abs(np.diff(angles)))) / 0.954
    least, mark = max(0.5 * _rounding(angles), 5 * noise, 1e-9), angles[0]
    ticks, sides = [], []
    for k, angle in enumerate(angles.tolist()):
        if abs(angle - mark) > least:
            ticks.append(k)
            sides.append(math.copysign(1.0, angle - mark))
            mark = angle
    turns = np.flatnonzero(np.diff(sides)) + 1
    plays, weights = [], []
    for before, turn, after in zip([0, *turns], turns, [*turns[1:], len(sides)], strict=False):
        first, last, begin, end = ticks[before], ticks[turn - 1], ticks[turn], ticks[after - 1]
        if min(last - first, end - begin) * period < _SHORTEST:
            continue
        span = round(_SPAN / period)
        rows = np.concatenate(
            [np.arange(max(first, last - span), last + 1), np.arange(begin, min(end, begin + span) + 1)]
        )
        place, since = np.linspace(-1, 1, rows[-1] - rows[0] + 1)[rows - rows[0]], (rows - last) * period
        side = np.where(rows <= last, -sides[turn], sides[turn])
        design = np.column_stack([side / -2, np.where(since > 0, since**2, 0.0), np.vander(place, _DEGREE + 1)])
        left = angles[rows] - design @ _solved(design, angles[rows])
        variance = _LIKE * float(left @ left) / len(rows) * np.linalg.pinv(design.T @ design)[0, 0]
        plays.append(_solved(design, angles[rows])[0])
        weights.append(1 / max(variance, 1e-16))
    if len(plays) < _REVERSALS:
        return math.nan, math.nan
    mean = float(np.average(plays, weights=weights))
    scatter = float(np.average((np.array(plays) - mean) ** 2, weights=weights))
    return mean, math.sqrt(scatter / len(plays) + 1 / sum(weights))


_REVERSALS = 4
_LEAST_PLAY = 0.001
"""Play below which there is no finding, rad; friction can look like play."""


def _play(angles: Array, period: float, wiring: Wiring, settings: LoopSettings, changes: dict[str, Any]) -> Finding:
    """Compare the play of the encoders with that in [run]."""
    joints = np.diff(angles, axis=1, prepend=0.0).T
    known = np.array(settings.mechanics.of_each("play", len(joints)))
    found = [fit_play(joint, period) for joint in joints]
    plays, errors = (np.array(values) for values in zip(*found, strict=True))
    figures = {"play": plays.tolist(), "play_errors": errors.tolist()}
    # Play can make joint encoders look like absolute ones.
    right = wiring.form in (Form.SUMMED, Form.ABSOLUTE) and bool(np.all(_scales(wiring, 1.0) == 1))
    if not right or not np.isfinite(plays).all():
        why = "the play of the encoders cannot be determined: the joints do not swing like those of the model"
        return Finding("play", Grade.UNSURE, why, "fix the other findings and start again", figures)
    least = np.array([max(_LEAST_PLAY, _rounding(joint)) for joint in joints])
    shown = " and ".join(_with_error(1e3 * play, 1e3 * error) for play, error in found)
    seen = np.where(plays > np.maximum(least, 3 * errors), np.round(plays, 5), 0.0)
    if np.all(np.abs(plays - known) <= np.maximum(3 * errors, np.maximum(least, 0.2 * known))):
        same = f"have a play of {shown} mrad, as in [run]"
        none = f"show no play beyond {1e3 * least.max():.2g} mrad"
        return Finding("play", Grade.OK, f"the encoders {same if known.any() else none}", "", figures)
    changes["play"] = seen.tolist()
    said = " and ".join(f"{1e3 * play:g}" for play in known)
    return Finding(
        "play", Grade.WRONG, f"the encoders have a play of {shown} mrad, but [run] has {said} mrad",
        f"set play = {changes['play']} in [run], as --write does, or fix the encoders' couplings", figures, mended=True,
    )  # fmt: skip


def _rounding(values: Array) -> float:
    """Return the rounding step of values, or 0 without one."""
    # Sums and differences of multiples have errors in their last digits.
    levels = np.unique(np.round(values, 9))
    gaps = np.diff(levels)
    gaps = gaps[gaps > 5e-9]
    if len(gaps) < 5:
        return 0.0
    step = float(gaps.min())
    whole = np.abs(gaps / step - np.round(gaps / step)) < 0.02 + 2e-9 / step
    if step < 1e-6 or whole.mean() < 0.95:
        return 0.0
    return float(np.ptp(levels)) / round(float(np.ptp(levels)) / step)


_FRICTION = 5e-4
"""Least observable friction relative to gravity's torque."""


def _friction(swing: CommissioningSwing, arms: ArmChainParameters, settings: LoopSettings) -> Finding:
    """Compare the dry friction of the joints with [run] and with the model."""
    (torques, errors), own = swing.dry, settings.mechanics
    said = np.array(own.of_each("stiction", arms.count)) * own.kinetic + (arms.coulomb or 0.0)
    least = np.maximum(_FRICTION * arms.base()[arms.count * (arms.count + 1) // 2 :][: arms.count].max(), 3 * errors)
    figures = {"torques": torques.tolist(), "errors": errors.tolist()}
    shown = " and ".join(_with_error(1e3 * torque, 1e3 * error) for torque, error in zip(torques, errors, strict=True))
    sentence = f"the joints have a dry friction of {shown} mN m"
    if np.all(np.abs(torques - said) < np.maximum(least, 0.5 * said)):
        none = f"the joints show no dry friction beyond {1e3 * least.max():.1g} mN m"
        known = f"{sentence}, as in [run] and the model" if said.any() else none
        return Finding("friction", Grade.OK, known, "", figures)
    breakaway = np.maximum(torques - (arms.coulomb or 0.0), 0) / max(own.kinetic, 0.1)
    values = ", ".join(f"{torque:.2g}" for torque in breakaway)
    remedy = f"set stiction = [{values}] in [run], or identify the model (`dpcontrol identify`)"
    return Finding("friction", Grade.UNSURE, sentence, remedy, figures)


_DETUNING, _FASTER, _LEAST_DAMPING = 0.05, 5.0, 0.01
"""Relative tolerance of frequencies, and the multiple of the model's damping that is reported."""


def _model(swing: CommissioningSwing, wiring: Wiring, arms: ArmChainParameters) -> Finding:
    """Compare the arms' frequencies and viscous dampings with the model's."""
    frequencies = modes(arms).frequencies * swing.ratios / 2 / np.pi
    shares = ", ".join(f"{100 * (r - 1):+.1f} %" for r in swing.ratios)
    sentence = f"the arms swing at {', '.join(f'{f:.3f}' for f in frequencies)} Hz, {shares} off the model's"
    viscous, errors = swing.viscous
    surely = replace(arms, viscous=tuple(np.maximum(viscous - 3 * errors, 0.0).tolist()))
    figures = {"frequencies": frequencies.tolist(), "viscous": viscous.tolist(),
               "viscous_errors": errors.tolist(), "ratios": swing.ratios.tolist()}  # fmt: skip
    faster = modes(surely).dampings / np.maximum(modes(arms).dampings, _LEAST_DAMPING / _FASTER)
    if float(faster.max()) > _FASTER:
        sentence += f", and viscous friction damps their swing at least {faster.max():.0f} times as much"
    elif float(np.abs(swing.ratios - 1).max()) < _DETUNING or np.any(_stuck(wiring) | wiring.unknown):
        return Finding("model", Grade.OK, sentence, "", figures)
    remedy = "identify the model from free swings of this rig (`dpcontrol identify`), or check the joints' bearings"
    return Finding("model", Grade.UNSURE, sentence, remedy, figures)


_ACCELERATE, _STOPPING = 0.3, 1.0
"""Accelerations towards the switches, and after a response, m/s²."""


def _tried_switch(
    session: _Session, side: int, name: str, most: float, limits: Limits, options: CommissioningSettings
) -> Finding:
    """Creep to a side until the switch responds, and return."""
    answer, at = _creep(session, side, most, options.creep)
    _return(session, options)
    figures = {"side": name, "answer": answer, "position": at}
    wrong = partial(Finding, "switches", Grade.WRONG, figures=figures)
    if answer == -side:
        return wrong(
            f"at the {name}, at {at:+.4f} m, the switch of the other side responds",
            "swap the plugs of the limit switches, or their signs in the rig's program: right is +1",
        )
    if not answer:
        return wrong(
            f"no switch responds at the {name} up to {at:+.4f} m",
            "press that switch by hand: if no reading shows it, check its wiring; otherwise give --switches a "
            "longer distance, less than that to the hard stop",
        )
    if abs(at) < limits.position:
        return wrong(
            f"the switch at the {name} responds at {at:+.4f} m, within the ±{limits.position:g} m that [limits] allows",
            f"set position below {abs(at):.3f} in [limits], or move the switch outwards",
        )
    return Finding("switches", Grade.OK, f"the switch at the {name} responds at {at:+.4f} m", "", figures)


def _creep(session: _Session, side: int, most: float, speed: float) -> tuple[int, float]:
    """Move to a side until a switch responds.

    The motion also ends when the distance is covered. Response and position are returned.
    """
    period, wanted, slope = session.period, 0.0, 0.0
    answer, at, braking = 0, 0.0, False
    while True:
        change = max(-_STOPPING, -slope / period) if braking else min(_ACCELERATE, (speed - slope) / period)
        slope += change * period
        wanted += slope * period
        reading = session.advance(session.steered(side * wanted, side * slope, side * change))
        if not braking:
            answer, at = reading.switch, session.cart - session.home
            braking = bool(answer) or abs(at) >= most or wanted > most
        elif slope < 1e-9:
            return answer, at


def _return(session: _Session, options: CommissioningSettings) -> None:
    """Move the cart back to its home smoothly."""
    away = session.cart - session.home
    duration = max(1.875 * abs(away) / (2 * options.creep), 0.5)
    s = np.linspace(0, 1, max(3, round(duration / session.period)))
    path = away * (1 - s**3 * (10 - 15 * s + 6 * s**2))
    session.follow(path, np.gradient(np.gradient(path, session.period), session.period))
    session.hold(0.3)


def _deadlines(session: _Session) -> Finding:
    """Judge the timing of both ends."""
    ticks, lost = len(session.positions), session.present.count(False)
    kept = getattr(session.rig, "deadlines", None)
    figures: dict[str, Any] = {"ticks": ticks, "late": session.late, "lost": lost}
    sentence = f"of {ticks:,} ticks {session.late} began at least a period late, and {lost} had no reading"
    worst = max(session.late, lost)
    if isinstance(kept, Deadlines):
        figures["held"] = kept.held
        sentence += f"; the bench repeated a command {kept.held} times"
        worst = max(worst, kept.held)
    if worst <= 0.001 * ticks:
        return Finding("deadlines", Grade.OK, sentence, "", figures)
    verdict = Grade.UNSURE if worst <= _OFTEN_LATE * ticks else Grade.WRONG
    return Finding("deadlines", verdict, sentence, _HURRY, figures)
