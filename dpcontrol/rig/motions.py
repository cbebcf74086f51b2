"""Motions of commissioning, within 10 mm of the cart's initial position except towards the limit switches.

The arms hang, so errors in signs, gains or delays are harmless. First, a short shift to and fro shows the direction of
the drive. Then the cart is held in place and follows a chirp. The low frequencies make the arms swing, and the high
ones show the delay of the drive. A rig that fails, is not read or leaves its range is stopped.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import FindingCause as Cause
from dpcontrol.foundation.parts import Later
from dpcontrol.foundation.settings import Setting, Settings
from dpcontrol.loop.protocols import Reading
from dpcontrol.loop.result import Rig
from dpcontrol.references.problem import Limits
from dpcontrol.rig.fits import fit_swing, modes, read_wiring, response

signal, stats = Later("scipy.signal"), Later("scipy.stats")
Notify = Callable[[str], None]

REACH = 0.010
"""Maximum distance of the cart from its initial position, except towards the switches, m."""
SIDES = {1: "right", -1: "left"}
OFTEN_LATE = 0.01
"""Fraction of ticks that may be late before a finding is wrong."""
SAFE_GAIN = 0.2
"""Error of the gain up to which the switches are tried: with a wrong scale, the cart could reach the hard stop."""
_FREQUENCY = 2 * np.pi * 0.6
"""Bandwidth of the loop that holds the cart, rad/s; slow enough for any drive's delay."""
_DAMPING = 0.8
_SLOPE = 0.01
"""Interval over which the cart's velocity is computed from its positions, s."""
_LONGEST_GAP = 0.1
"""Time without a cart reading after which the cart is stopped, s."""
_OFF_CENTRE = 0.02
"""m."""
_SHIFTS = {0.0005: 0.1, 0.003: 0.7}
"""Shifts of the cart, m; the second follows if the first is not clearly visible.

Each has the maximum fraction of the opposite shift's residual: with a drifting cart, a small shift resembles its
opposite at another time.
"""
_SHIFT_SECONDS, _AFTER_SHIFT = 0.16, 0.1
_SEEN, _CLEARLY_SEEN = 0.0002, 5.0
"""Minimum visible shift, m, and as a multiple of the cart's drift."""
_WATCHED = 1.2
"""Time of hanging still that is observed, s: longer than a period."""
_ACCELERATE, _STOPPING = 0.3, 1.0
"""Accelerations towards the switches, and after a response, m/s²."""


class Halted(Exception):
    """Raised if further measurement is not possible, with a cause and its figures."""


@dataclass(frozen=True)
class CommissioningSettings(Settings, table="commissioning"):
    """Durations and sizes of the motions that measure a rig."""

    wait: Annotated[float, Setting(least=0, most=3600, unit="s")] = 60.0
    """Time limit for the arms to hang still, s."""
    still: Annotated[float, Setting(above=0, most=0.2, unit="rad")] = 0.05
    """Swing that counts as still, rad."""
    look: Annotated[float, Setting(least=0.1, most=60, unit="s")] = 0.3
    """Observation time before any motion, s."""
    hold: Annotated[float, Setting(least=0.5, most=60, unit="s")] = 1.5
    """Observation time with the cart held, s."""
    sweep: Annotated[float, Setting(least=2, most=120, unit="s")] = 8.0
    """Duration of the chirp, s, from half the slowest swing's frequency to `highest` Hz."""
    ring: Annotated[float, Setting(least=0.5, most=120, unit="s")] = 3.0
    """Observation time of the free swing after it, s."""
    highest: Annotated[float, Setting(least=2, most=500, unit="Hz")] = 40.0
    amplitude: Annotated[float, Setting(above=0, most=0.005, unit="m")] = 0.004
    """Largest displacement in the chirp, m."""
    push: Annotated[float, Setting(above=0, most=10, unit="m/s²")] = 4.0
    """Largest acceleration in the chirp, m/s²."""
    creep: Annotated[float, Setting(above=0, most=0.1, unit="m/s")] = 0.05
    """Speed towards the limit switches, m/s."""

    @property
    def seconds(self) -> float:
        """Total duration, s.

        It assumes that the arms hang still and the switches are not tried.
        """
        return self.look + self.hold + self.sweep + self.ring + 3.0


class RigSession:
    """The rig during commissioning; records every tick and limits the cart's travel.

    The angle of an arm without an encoder is 0, whatever the rig sends.

    Args:
        rig: the rig.
        arms: model of the n arms.
        limits: the cart's limits, of which the acceleration bounds commands.
        zeros: present readings (n,) of hanging arms, rad.
        encoders: True for each arm (n,) with an encoder.

    Attributes:
        positions: reading (n+1,) of each tick, rad and m.
        present: for each tick, True if all sensors were read.
        commands: command after each reading, m/s².
        switches: state of the limit switches at each tick: -1, 0 or 1.
        late: number of late ticks.
        held_from: tick from which the cart is held for the fit of the swing.
        chirped_from: first tick of the chirp.
        chirped_to: last tick of the chirp.
        rang_to: last tick of the free swing, 0 before.
        home: cart's reading at the start, m.
        reach: largest distance from home that is permitted now, m.
        step: name of the present step, to which a fault belongs.
    """

    def __init__(
        self,
        rig: Rig,
        arms: ArmChainParameters,
        limits: Limits,
        zeros: Sequence[float],
        encoders: Sequence[bool],
    ) -> None:
        self.rig, self.arms, self.period = rig, arms, rig.period
        self.encoders = np.array(encoders)
        self._measured = np.array([*encoders, True])
        self._zeros, self._most = np.array([*zeros, 0.0]), limits.acceleration
        self.positions: list[Array] = []
        self.present: list[bool] = []
        self.commands: list[float] = []
        self.switches: list[int] = []
        self.late = self.held_from = self.chirped_from = self.chirped_to = self.rang_to = 0
        self.tries: list[tuple[int, int, float]] = []
        """Side of each try of a limit switch, its response and the cart's position, m."""
        self.gain = 0.0
        """Cart reading per command, once known; its sign is the drive's direction."""
        self.reach, self.step = REACH, "still"
        # Ticks of the velocity's difference, and ticks since all sensors were read.
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
        """Read and store the next reading, with zeros subtracted, and the last positions in place of missing ones.

        Return it as the rig sent it, except that an arm without an encoder does not count as missing.
        """
        reading = self.rig.read()
        if reading.present is not None:
            reading = reading._replace(present=reading.present | ~self._measured)
        positions = np.where(self._measured, reading.positions - self._zeros, 0.0)
        if reading.present is not None and self.positions:
            positions = np.where(reading.present, positions, self.positions[-1])
        self.positions.append(positions)
        self.present.append(reading.present is None or bool(reading.present.all()))
        self.switches.append(reading.switch)
        self.late += reading.late > 0
        return reading

    def advance(self, acceleration: float) -> Reading:
        """Command an acceleration, m/s², within the cart's limit, and return the next reading.

        Raises:
            Halted: the rig has failed, the cart has left its range, or a sensor is not read.
        """
        command = min(max(acceleration, -self._most), self._most)
        self.rig.command(command)
        self.commands.append(command)
        reading = self.read()
        self._gap = 0 if self.present[-1] else self._gap + 1
        if self.rig.fault is not None:
            raise Halted(Cause.FAULT, {"text": self.rig.fault.text})
        if self._gap * self.period > _LONGEST_GAP and reading.present is not None:
            sensors = [*(f"the encoder of arm {k + 1}" for k in range(self.arms.count)), "the cart's scale"]
            unread = [sensors[k] for k in np.flatnonzero(~reading.present)]
            raise Halted(Cause.UNREAD, {"sensors": unread, "seconds": self._gap * self.period})
        displacement = self.cart - self.home
        if abs(displacement) > self.reach:
            raise Halted(Cause.LEFT, {"reach": self.reach, "away": displacement, "late": self.late, "ticks": self.tick})
        return reading

    def follow(self, path: Array, feedforward: Array) -> None:
        """Move the cart along a path with feedforward and slow feedback.

        Positions (K,) are in m from home, feedforward accelerations (K,) in m/s², one for each tick.
        """
        for position, velocity, acceleration in zip(path, np.gradient(path, self.period), feedforward, strict=True):
            self.advance(self.steered(position, velocity, acceleration))

    def steered(self, wanted: float, slope: float, ahead: float) -> float:
        """Return the command, m/s², that steers the cart along a path.

        At this tick the path has position `wanted`, m from home, velocity `slope`, m/s, and acceleration `ahead`, m/s².
        The cart's velocity is that over the last `_span` ticks. The drive's gain must be known.
        """
        earlier_cart = self.positions[max(self.tick - self._span, 0)][-1]
        velocity = (self.cart - float(earlier_cart)) / (min(self._span, max(self.tick, 1)) * self.period)
        error = self.home + wanted - self.cart
        feedback = _FREQUENCY**2 * error + 2 * _DAMPING * _FREQUENCY * (slope - velocity)
        return (ahead + feedback) / self.gain

    def hold(self, seconds: float) -> None:
        """Hold the cart at home for a number of seconds."""
        self.follow(*np.zeros((2, max(2, round(seconds / self.period)))))

    def filled(self, first: int = 0) -> Array:
        """Return the readings (K, n+1) of arms and cart from tick `first`, with gaps interpolated linearly."""
        readings, present = np.array(self.positions[first:]), np.array(self.present[first:])
        if not present.all() and present.any():
            ticks = np.arange(len(readings))
            readings = np.stack([np.interp(ticks, ticks[present], v[present]) for v in readings.T], axis=1)
        return readings


def perform(
    session: RigSession, chirp: tuple[Array, Array], switches: float, *, options: CommissioningSettings, notify: Notify
) -> None:
    """Perform all motions of the cart; the session records readings and commands for the fits.

    Args:
        session: the rig during commissioning.
        chirp: positions (K,), m, and accelerations (K,), m/s², of `chirp_of`.
        switches: distance of the search for limit switches, m; 0 for none.
        options: durations and sizes of the motions.
        notify: receives instructions about the next step.

    Raises:
        Halted: further measurement is not possible.
    """
    notify(f"the arms should hang with the cart at the centre; it will move by at most {1e3 * REACH:.0f} mm")
    _look(session, options)
    notify("the cart shifts a few millimetres and back: check that it goes to the right first")
    session.step = "drive"
    _shift(session)
    session.step = "still"
    _wait_until_still(session, options, notify)
    notify(f"the cart follows a chirp for {options.sweep:g} s, then stays still for {options.ring:g} s; the arms swing")
    session.step, session.held_from = "delay", session.tick
    session.hold(options.hold)
    session.chirped_from = session.tick
    # A small gain may come from a scale that shows too little, and the cart may then move further than measured.
    fraction = min(abs(session.gain), 1.0)
    session.follow(*(fraction * part for part in chirp))
    session.chirped_to = session.tick
    session.hold(options.ring)
    session.rang_to = session.tick
    session.step = "switches"
    if switches and abs(session.gain - 1) <= SAFE_GAIN:
        notify(f"the cart creeps to the right, then to the left, by up to {switches:g} m: be ready to cut the power")
        session.reach = switches + REACH
        for side in SIDES:
            session.tries.append((side, *_creep(session, side, switches, options.creep)))
            _return(session, options)


def _look(session: RigSession, options: CommissioningSettings) -> None:
    """Take readings before any motion, and halt if the cart is off the centre or touches a limit switch."""
    if abs(session.home) > _OFF_CENTRE:
        raise Halted(Cause.OFF_CENTRE, {"position": session.home})
    for _ in range(max(4, round(options.look / session.period))):
        session.advance(0.0)
    if session.switches[-1]:
        raise Halted(Cause.TOUCHED, {"side": SIDES[session.switches[-1]]})


def _shift(session: RigSession) -> None:
    """Find the drive's direction and gain by shifts to and fro, without feedback, which would require them.

    The gain is stored in the session. Shifts of the sizes in `_SHIFTS` are tried in order, until one is clearly visible
    beside the cart's drift and explains the motion clearly better than a shift to the other side.

    Raises:
        Halted: no shift of the cart is visible.
    """
    quarter = max(1, round(_SHIFT_SECONDS / 4 / session.period))
    pattern = np.repeat([1.0, -1.0, -1.0, 1.0], quarter) / (quarter * session.period) ** 2
    settling = max(2, round(_AFTER_SHIFT / session.period))
    drift = float(np.std(signal.detrend(session.filled()[-(len(pattern) + settling) :, -1])))
    visible_shift = 0.0
    for size, most_unexplained in _SHIFTS.items():
        if size < max(_SHIFTS) and _CLEARLY_SEEN * drift > size / 3:
            continue
        first = session.tick
        for command in (*(pattern * size), *np.zeros(settling)):
            session.advance(float(command))
        carts = session.filled(first)[:, -1]
        unit_response = response(np.array([*session.commands[first:], 0.0]), session.period, 0.0)
        # The drive's delay is still unknown, so the best-fitting one is used. The whole shift must be visible.
        delays = range(0, settling + 1, max(1, quarter // 8))
        shifts = ((signal.detrend(unit_response[: len(unit_response) - k]), signal.detrend(carts[k:])) for k in delays)
        fits: list[Any] = [stats.linregress(*shift) for shift in shifts]
        # Slope and unexplained fraction of the variance.
        gain, unexplained = min(((fit.slope, 1 - fit.rvalue**2) for fit in fits), key=lambda fit: fit[1])
        opposite = min((1 - fit.rvalue**2 for fit in fits if fit.slope * gain <= 0), default=1.0)
        visible_shift = abs(gain) * size
        if (
            visible_shift > _SEEN
            and abs(gain) * np.std(unit_response) > _CLEARLY_SEEN * drift
            and unexplained < most_unexplained * opposite
        ):
            session.gain = gain
            return
    _raise_for_no_shift(session, visible_shift)


def _raise_for_no_shift(session: RigSession, seen: float) -> None:
    """Raise the cause why no shift of the cart is visible: it drifts, its scale is dead, or it stands.

    `seen` is the shift of the best fit, m. The arms' swing reveals a motion of the cart that its scale does not show.
    """
    drift = float(np.ptp(session.filled()[:, -1]))
    if drift > _SEEN:
        raise Halted(Cause.WANDERS, {"wander": drift})
    for _ in range(round(1.0 / session.period)):
        session.advance(0.0)
    commanded = response(np.array([*session.commands, 0.0]), session.period, 0.0)
    swing = fit_swing(session.filled()[:, :-1], commanded, session.period, session.arms)
    wiring = read_wiring(swing, session.encoders)
    raise Halted(Cause.DEAD if float(np.abs(wiring.factors).max()) > 0.3 else Cause.STANDS, {"seen": seen})


def _wait_until_still(session: RigSession, options: CommissioningSettings, notify: Notify) -> None:
    """Hold the cart until the arms swing by at most `options.still` rad over `_WATCHED` s.

    If they swing at first, the user is asked to hold them.

    Raises:
        Halted: they still swing after the time limit.
    """
    attempts, swing = math.floor(options.wait / _WATCHED) + 1, 0.0
    for attempt in range(attempts):
        if attempt == 1:
            notify(f"the arms swing by ±{swing:.2g} rad: hold them still; waiting for up to {options.wait:g} s")
        first_tick = session.tick
        session.hold(_WATCHED)
        swing = float(np.ptp(session.filled(first_tick)[:, :-1], axis=0).max()) / 2
        if swing <= options.still:
            return
    raise Halted(Cause.SWINGING, {"swing": swing, "seconds": attempts * _WATCHED})


def chirp_of(arms: ArmChainParameters, period: float, options: CommissioningSettings) -> tuple[Array, Array]:
    """Return the positions (K,) m and accelerations (K,) m/s² of a logarithmic chirp.

    Its low frequencies make the arms swing, and its high ones show the delay of the drive.

    Args:
        arms: parameters of the arms, whose lowest frequency begins the chirp.
        period: control period, s.
        options: duration, largest amplitude and acceleration, and highest frequency of the chirp.
    """
    low = 0.6 * float(modes(arms).frequencies.min()) / (2 * np.pi)
    high, finer = min(options.highest, 0.1 / period), 8
    times = np.arange(round(options.sweep / period) * finer + 1) * period / finer
    frequency = 2 * np.pi * low * (high / low) ** (times / options.sweep)
    fade = np.clip(np.minimum(times, options.sweep - times) / min(0.5, options.sweep / 8), 0, 1)
    amplitudes = np.minimum(options.amplitude, options.push / frequency**2) * np.sin(np.pi / 2 * fade) ** 2
    # Computed on a finer grid than the ticks, for the derivatives of the highest frequency.
    positions = amplitudes * signal.chirp(times, low, options.sweep, high, method="logarithmic", phi=-90)
    velocities = np.gradient(positions, times)
    velocities[[0, -1]] = 0.0
    return positions[:-1:finer], np.diff(velocities[::finer]) / period


def _creep(session: RigSession, side: int, most: float, speed: float) -> tuple[int, float]:
    """Move to a side until a switch responds or the distance is covered, and brake.

    `side` is 1 for right or -1 for left, `most` the distance from home, m, `speed` in m/s. Return the switch's response
    (-1 or 1 for the side of the switch, 0 if none responded) and the cart's position then, m from home.
    """
    period, target, target_speed = session.period, 0.0, 0.0
    answer, position, braking = 0, 0.0, False
    while True:
        change = (
            max(-_STOPPING, -target_speed / period) if braking else min(_ACCELERATE, (speed - target_speed) / period)
        )
        target_speed += change * period
        target += target_speed * period
        reading = session.advance(session.steered(side * target, side * target_speed, side * change))
        if not braking:
            answer, position = reading.switch, session.cart - session.home
            braking = bool(answer) or abs(position) >= most or target > most
        elif target_speed < 1e-9:
            return answer, position


def _return(session: RigSession, options: CommissioningSettings) -> None:
    """Move the cart back to its home smoothly, on a polynomial without jumps of velocity and acceleration."""
    displacement = session.cart - session.home
    duration = max(1.875 * abs(displacement) / (2 * options.creep), 0.5)
    shares = np.linspace(0, 1, max(3, round(duration / session.period)))
    # The polynomial of degree five from 1 to 0, flat at both ends.
    path = displacement * (1 - shares**3 * (10 - 15 * shares + 6 * shares**2))
    session.follow(path, np.gradient(np.gradient(path, session.period), session.period))
    session.hold(0.3)
