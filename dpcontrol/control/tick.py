"""The tick: response of the controller to one reading.

It is one function of memory, reading and a row of a table:

    estimate   the extended Kalman filter's update with the measured positions (`dpcontrol.control.ekf`)
    ahead      the state when the command will act, predicted through the pending commands
    law        u = u* + K (x* - x̂) - F w: the row's input, gains, reference state, and gains on the extras w
    judge      continue, restart the filter, abandon the reference, or stop the cart, with the cause
    path       append the command, within the drive's limits, to the pending ones
    predict    the filter's prediction over the coming period, for the next tick

One casadi expression gives the machine code of the loop and the exported C. For a law with internal timing, the
expression is split before and after the law. For another estimator, the second part omits the prediction.

A command acts d periods after its tick, with the delay d. With d = i + f, 0 ≤ f < 1, the mean over the period from tick
k is

    f c_{k-i-1} + (1 - f) c_{k-i}

and the command is computed for the state at tick k + round(d), so timing errors are up to half a period. At 1 kHz this
shifts the motion in time without harm. At 50 Hz it reduces the delay margin. The limits of acceleration and velocity
are those of the drive, and apply before the command enters the prediction.

Checks in each tick:

    consistency   Mean of NIS / degrees of freedom over a fifth of a second, and slips of the estimate by a turn.

    tracking      Mean over about a second of the largest angle's distance from the reference, by the encoders.

    cart          |x| + v²/(2a) + |v| t_d: resting place if it brakes now, after the delay t_d. If the arms are lost by
                  then, they are the cause of the ending.

    sensors       A sensor that sticks, or a drive that the cart does not follow, see `dpcontrol.control.watch`.

Age of the readings: a reading of age τ has positions that lack ω τ, with the rates ω. A reported age is corrected in
the update: y = m - H(z - ω τ). Unknown variations are noise along ω for all positions at once. With the covariance
P_ω of the rates, this noise has the second moment

    R + σ² (ω ωᵀ + P_ω),    σ² by recursive maximum likelihood over half a second, T²/12 at first with the period T

A rig without jitter keeps σ² ≈ 0. The mean age is not estimated. It acts as an additional delay.
"""

import math
from collections import namedtuple
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial, reduce
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING, Any, NamedTuple

import casadi as ca
import numpy as np

from dpcontrol.control.ekf import (
    RESTART_RATE,
    RESTART_VELOCITY,
    FilterEquations,
    Layout,
    Timing,
    pack,
    packed,
    propagated,
    unpack,
)
from dpcontrol.control.estimator_settings import Augment, FilterSettings
from dpcontrol.control.interface import GainSchedule, Mode, Present, SampledModel
from dpcontrol.control.tick_parts import (
    BIG,
    Known,
    Measurement,
    Memory,
    Numbers,
    Outcome,
    Report,
    Row,
    Sensed,
    all_of,
    any_of,
    clipped,
    finite,
    within,
)
from dpcontrol.control.watch import SAME, SensorWatch
from dpcontrol.dynamics.compiled import SINGLE, VECTOR, Compiled
from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.arrays import Array

if TYPE_CHECKING:
    from dpcontrol.control.symbolic import SymbolicLaw


BRAKING = 0.9
"""Share of the largest acceleration for braking, more than the supervisor assumes."""
SETTLING = 0.05
"""Time that the loop continues after the cart is commanded to rest, s, longer than delays and lags."""
TRACKING_MEMORY = 1.0
ESTIMATE_MEMORY = 0.2
"""Time constants of the means, s."""
RESTART_MEMORY = 1.0
"""Time constant of the count of restarts, s: a filter that was consistent for this time can restart again."""
_MOST_AT_ONCE = 16.0
"""Largest contribution of a tick's NIS, relative to the bound of its mean."""
_LAGS = 0.05
"""Time until commands appear in the cart's motion, or have no effect, s."""
LOST_AFTER_FALLBACK = 1.5
"""Distance from which a fallback is lost as well, rad, if the bound of the reference is smaller."""
AT_REST = 1e-12
"""Velocity below that of any cart, m/s."""
TIMING_MEMORY = 0.5
"""Time constant of the estimated age of readings, s."""
_OLDEST = 1.5
"""Periods."""
_LATE, _VERY_LATE, _LATE_MEMORY = 0.5, 0.75, 5.0
"""Bounds in periods, and time constant in readings, of the mean apparent age of innovations.

From the first bound on, the estimated variance of the ages can only fall. Beyond the second, it is 0.
"""
TIMING_PRIOR, TIMING_INFORMATION = 1 / 12, 5 * 12**2
"""Assumed variance of the readings' age, period², and the information in this assumption, period⁻⁴.

The variance is that of ages spread evenly over a period, and the information that of five readings. With that of one,
the variance falls to 0 after five readings of similar age, and a later one passes for an error of the rates.
"""
_MOVES = 3.4
"""Standard deviations of a reading that indicate motion of an encoder with play, 0.98 counts without noise."""
_AT_SIDE, _IN_PLAY = 0.3, 10.0
"""Standard deviations of a joint's place in its play, in units of half the play.

The first is for a joint that moves its encoder and allows for errors of the play. The second is for other joints, whose
readings are constant for some time.
"""
_FASTEST = 1.1
"""Largest velocity of the cart over the drive's limit."""
_SHAPED_DAMPING = 1.0
"""Damping ratio of a belt with shaped commands."""
UNROLLED = 8
"""Periods of prediction in one function; the loop repeats the prediction for further ones."""


class KnownMechanics(NamedTuple):
    """The loop's model of a rig's mechanics.

    play (n,): play of the joints' encoders, rad. belt: belt frequency, Hz, and damping ratio. For an elastic belt, a
    notch filter removes its resonance from the commands. Belt and notch together act as a lag. encoders (n,): True for
    each arm whose angle is measured; empty for all.
    """

    play: tuple[float, ...]
    belt: float
    damping: float
    encoders: tuple[bool, ...] = ()

    @property
    def lag(self) -> float:
        """Lag of belt and notch together at low frequencies, s, which the filter models; 0 for a rigid belt."""
        return 2 * (_SHAPED_DAMPING - self.damping) / (2 * np.pi * self.belt) if self.belt else 0.0

    def notch(self, period: float) -> Array:
        """Return the coefficients b0, b1, b2, a1, a2 of the notch that removes the resonance of the belt from commands.

        They are those of (s² + 2ζωs + ω²)/(s² + 2ζ'ωs + ω²) by the bilinear transform, exact at ω.
        Here, ω and ζ are the belt's frequency and damping ratio, and ζ' is the damping ratio with shaped commands.

        Args:
            period: time between ticks, s.
        """
        k = 1 / np.tan(np.pi * self.belt * period)
        belt, shaped = 2 * self.damping * k, 2 * _SHAPED_DAMPING * k
        leading = k**2 + shaped + 1
        middle = 2 * (1 - k**2) / leading
        return np.array(
            [(k**2 + belt + 1) / leading, middle, (k**2 - belt + 1) / leading, middle, (k**2 - shaped + 1) / leading]
        )


_Acts = namedtuple("_Acts", "ahead drive back coming")
"""State `ahead` (N,) at which the command acts, and the cart's acceleration `drive` then, m/s².

back m/s²: feedback in addition to the row's. coming m/s²: acceleration in the coming period, None if not yet known.
"""
_Law = namedtuple("_Law", "forward feedback finite untrusted by_own own")
"""Feedforward and feedback, m/s².

finite: 1 if both are finite and the estimate is sound. untrusted: number of the last extra beyond its trust, from 1, or
0 (`TickEquations.law`). by_own, own: feedback, m/s², and next memory of a user's law.
"""
_Means = namedtuple("_Means", "nis strain silent distance blind error")
"""Checked means nis, strain, silent and error, see `TickEquations.memory`.

distance: largest distance of an angle from the reference in this tick, rad. blind: 1 while a restarting filter has no
reading yet.
"""
_Verdict = namedtuple("_Verdict", "outcome stopped sensor watch")
"""Outcome of a tick, that which stopped the run or 0, the number of a stuck sensor or 0, and the watch's memory."""
_Path = namedtuple("_Path", "forward feedback wish command acting saturated after")
"""The command of a tick with its parts, m/s², and the memory `after` it.

forward, feedback: parts of the command before limits, whose sum is `wish`. command: sent to the drive. acting: mean
acceleration of the cart in the coming period. saturated: 1 if a limit cut the command.
"""


@dataclass(frozen=True, eq=False)
class TickEquations:
    """The tick of one filter, delay and law.

    In the methods, m, r and c are the memory, the reading and the constants of a tick as expressions, with the names in
    `memory`, `reading` and `numbers`. `known` holds them together with the row of the table, the estimate, and the
    state at which the command acts (`Known`). N is the number of states, n of arms, E of extras. z (N+E,) is the state
    followed by the extras, which are disturbances and errors of parameters that the filter estimates as well.

    Attributes:
        whole, lead: whole periods of the delay, and periods of prediction for the command.
        shares: extras (E,) that are relative errors with limited trust; None for a law without gains on them.
        unrolled: True if the memory includes the pending commands, which the caller stores otherwise.
        lags: True for a drive with a known lag.
        plays: True for encoders with a known play.
        shapes: True for commands shaped for a known belt.
        own: a user's law of expressions.
        same: differences of readings of a joint and of the cart that are the same count, rad and m.
        split: True to store the filter's state as a sum of two numbers. Single precision rounds an angle of several
            turns, and changes of a rate, to more than the filter's error.
        encoders: True for each arm (n,) whose angle is measured; empty for all. The tick ignores other angles.
    """

    filter: FilterEquations
    whole: int
    lead: int
    shares: tuple[bool, ...] | None = None
    unrolled: bool = True
    lags: bool = False
    plays: bool = False
    shapes: bool = False
    own: "SymbolicLaw | None" = None
    same: tuple[float, float] = (SAME, SAME)
    split: bool = False
    encoders: tuple[bool, ...] = ()

    @cached_property
    def measured(self) -> tuple[bool, ...]:
        """True for each measured position (n+1,)."""
        return (*(self.encoders or (True,) * self.filter.arms), True)

    @cached_property
    def watch(self) -> SensorWatch:
        """Watch of sensors and drive."""
        return SensorWatch(self.filter.equations, self.filter.arms, self.filter.period, self.same, self.measured)

    @cached_property
    def memory(self) -> Layout[Memory]:
        """Layout of the values stored from tick to tick, the memory `m`.

            z, covariance: prediction for the coming reading, and the covariance's lower triangle row by row.

            sent: commands, oldest first, m/s². velocity: of the cart after all of them, m/s. drive: with a lag, the
            cart's acceleration at the start of the coming period, m/s².

            error rad, nis: means. silent (n+1,): time since a position was measured, s. restarts: so far. held: 1 after
            the reference was abandoned. moved: time since the clock was moved, s. restart: 1 until a restarting filter
            has a reading.

            stopped: the outcome that ended the run, or 0. still: time since the cart's command became zero, s. acted:
            last acceleration, m/s². cut: 1 if the last command was cut. was_untrusted: 1 once an extra exceeded its
            trust. heading: final velocity of the cart, m/s. turns (n,): whole turns between readings and estimate, rad.

        For each sensor: last reading, smallest step, ticks with this reading. For each joint:

            its expected value at the first of these ticks, and the motion of this value since.

            pulled rad/s, held_back rad: the filter's changes of its rate since, and the motion that they prevented.

            strained rad/s: the sum of their absolute values.

        For the cart:

            scale (4): expected travel since the last comparison, m, velocity, m/s, response and lag, s, of the drive.

            scale_covariance: of these, the lower triangle row by row. scale_read: reading at the last comparison, m.

            drive_watch: see `DriveWatch`.

            scale_waited: readings since. evidence: that the scale is stuck. scale_level, scale_surprise: factor of the
            assumed variance, and the squared relative error at the last changed reading.

        For the readings' age:

            timing: variance, s². timed: information in it, for time in periods.

            lateness: recent mean of the apparent age, periods. strain: mean NIS for constant ages.

        With play, mark (n,) is the angle of each encoder when its joint last moved it, rad. With a belt, shaped (2,) is
        the memory of the notch, m/s². own is the memory of a user's law. If the state is split, its part of z is
        relative to origin (N,), which the owner of the memory can change.
        """
        size, m = self.filter.dimension, self.filter.arms + 1
        return Layout(Memory(
            z=size, covariance=size * (size + 1) // 2, sent=self.unrolled * (self.whole + 2), drive=int(self.lags),
            velocity=1, error=1, nis=1, silent=m, restarts=1, held=1, moved=1, restart=1, stopped=1, still=1, acted=1,
            cut=1, was_untrusted=1, last=m, step=m, same=m, begin=m - 1, away=m - 1, pulled=m - 1, strained=m - 1,
            held_back=m - 1, scale=4, scale_covariance=10, scale_read=1, scale_waited=1, scale_level=1,
            scale_surprise=1, evidence=1, heading=1, drive_watch=self.watch.drive.memory.size, turns=m - 1, timing=1,
            timed=1, lateness=1, strain=1, mark=self.plays * (m - 1), shaped=2 * self.shapes,
            own=0 if self.own is None else len(self.own.first), origin=self.split * self.filter.equations.dimension,
        ))  # fmt: skip

    @cached_property
    def reading(self) -> Layout[Measurement]:
        """Layout of a tick's input from the rig, the reading `r`.

        measured (n+1,): angles, rad, and the cart's position, m. present (n+1,): 1 where measured.

        switch: 1 while a limit switch is touched. age: of the reading at its tick, s, 0 if unknown.

        rate_error (n,): added to the law's rates in simulations of measured rates, rad/s.

        offset (n+1,): measured minus the memory's origin, if the state is split.
        """
        m = self.filter.arms + 1
        return Layout(Measurement(measured=m, present=m, switch=1, age=1, rate_error=m - 1, offset=self.split * m))

    @cached_property
    def row(self) -> Layout[Row]:
        """Layout of a tick's input from the table of the law, the row.

        At the tick at which the command acts:

            feedforward m/s², gains (N,), state (N,). With a lag, the cart's acceleration, m/s², and its gain.

            extra_gains (E,) and pair_gains on products of shares, in the order of `combinations_with_replacement`, if
            any.

            own: 1 for a user's law.

        At this tick: wanted (n,), the reference's angles.
        """
        size = self.filter.equations.dimension
        share_count, lag = sum(self.shares or ()), int(self.lags)
        return Layout(Row(
            feedforward=1, gains=size, state=size, drive=lag, drive_gain=lag, extra_gains=len(self.shares or ()),
            pair_gains=share_count * (share_count + 1) // 2, own=int(self.own is not None), wanted=self.filter.arms,
        ))  # fmt: skip

    @cached_property
    def numbers(self) -> Layout[Numbers]:
        """Layout of a run's constants `c`: bounds that judge the run, and numbers of its model.

        bounds. noise: R packed. parameters, process: see `FilterEquations`. fresh (N+E,): variances after a
        restart.

        lag: of the drive, s. lag_keeps: share of an acceleration that it leaves after a period.

        With play: play (n,), rad, and moves, the change of an encoder's angle that proves motion by its joint, rad.

        With a belt: notch (5,), see `KnownMechanics.notch`.
        """
        inputs, m = self.filter.inputs, self.filter.arms + 1
        return Layout(Numbers(
            *[1] * Numbers._fields.index("noise"), noise=m * (m + 1) // 2, parameters=inputs["parameters"],
            process=inputs["process"], fresh=self.filter.dimension, play=self.plays * (m - 1), moves=int(self.plays),
            notch=5 * self.shapes,
        ))  # fmt: skip

    @cached_property
    def sensed(self) -> Layout[Sensed]:
        """Layout of the estimate, the output of a tick's first part.

        z, covariance, sigmas (N+E,), nis, used positions, turns, and sound: 1 if all is finite and no angle has
        slipped. relative: in a whole tick, z relative to its origin.
        """
        size = self.filter.dimension
        return Layout(Sensed(
            z=size, covariance=size * (size + 1) // 2, sigmas=size, nis=1, used=1, sound=1, turns=self.filter.arms,
            timing=1, timed=1, lateness=1, strain=1, mark=self.plays * self.filter.arms, relative=0,
        ))  # fmt: skip

    @cached_property
    def report(self) -> Layout[Report]:
        """Layout of a tick's output for loop and log.

        state (N,): estimate. sigmas, extra: standard deviations of state and extras, and the extras.

        feedforward, feedback, and their sum wish before limits, m/s². acting: in the coming period, m/s².
        saturated, nis, mode: see `dpcontrol.logs.layout.control_fields`, in its order. command: to the drive, m/s².

        outcome: see `Outcome`. stop: 1 while the cart is being stopped. done: 1 after it has rested long enough.

        newly_cut: 1 at the start of a saturation. untrusted: number of the extra that newly exceeds its trust, from
            1, or 0.
        sensor: number of the stuck one, from 1. repeats: ticks with its reading.

        error rad, mean_nis, silent s: checked means, and the longest time without a position. used: positions.

        ahead (N,): state for which the command was computed. own: output of a user's law, m/s².

        notable: not 0 with an outcome or during a stop. news: not 0 with other events.
        """
        n, size = self.filter.equations.dimension, self.filter.dimension
        return Layout(Report(
            state=n, wish=1, feedforward=1, feedback=1, acting=1, saturated=1, nis=1, mode=1, sigmas=size,
            extra=size - n, command=1,
            outcome=1, stop=1, done=1, newly_cut=1, untrusted=1, sensor=1, repeats=1, error=1, mean_nis=1,
            silent=1, used=1, ahead=n, notable=1, news=1, own=int(self.own is not None),
        ))  # fmt: skip

    # The parts.

    def _restarted(self, m: Memory, r: Measurement, c: Numbers) -> tuple[ca.SX, ca.SX]:
        """Return z (N+E,) and its covariance (N+E, N+E) before the update with this reading.

        They are the stored prediction. In a restart (m.restart = 1), z has the measured positions, the predicted rates
        within three standard deviations of a restart's, and extras of zero. Its variances are then `c.fresh`. If the
        state is split, z is relative to its origin.

        `m`, `r`, `c`: memory, reading and constants of the tick.
        """
        n, size, origin = self.filter.arms, self.filter.dimension, self._origin(m)
        z, triangle, restarts = m.z, m.covariance, m.restart
        positions_read = r.offset if self.split else r.measured
        # A restarting filter uses the positions, keeps finite rates and resets extras.
        position_index = {**{i: i for i in range(n)}, 2 * n: n}
        largest = [np.inf] * n + [3 * RESTART_RATE] * n + [np.inf, 3 * RESTART_VELOCITY]
        fresh_state: list[ca.SX] = []
        for i in range(size):
            if i >= 2 * n + 2:
                fresh_state.append(ca.SX(0))
                continue
            predicted = ca.if_else(finite(z[i]), z[i], 0)
            if i in position_index:
                k = position_index[i]
                fresh_state.append(ca.if_else(r.present[k], positions_read[k], predicted))
            else:
                fresh_state.append(within(predicted + origin[i], ca.SX(largest[i])) - origin[i])
        z = ca.vertcat(*(ca.if_else(restarts, fresh_state[i], z[i]) for i in range(size)))
        entries: list[ca.SX] = []
        transformation = self.filter.carried
        for i in range(size):
            for j in range(i + 1):
                stored = ca.if_else(ca.logic_not(restarts), triangle[len(entries)], 0)
                # Entry (i, j) of T diag(fresh) Tᵀ, since the covariance is that of T z (`FilterEquations.carried`).
                shared = np.flatnonzero(transformation[i] * transformation[j]).tolist()
                fresh = sum((c.fresh[k] for k in shared[1:]), c.fresh[shared[0]]) if shared else None
                entries.append(stored if fresh is None else stored + ca.if_else(restarts, fresh, 0))
        return z, unpack(ca.vertcat(*entries), size)

    def _sense(self, m: Memory, r: Measurement, c: Numbers) -> Sensed:
        """Return the filter's estimate from prediction and reading, with the checks that a sound estimate passes.

        If the update is not finite or an angle has slipped by a turn, `sound` is 0 and z is the prediction.

        `m`, `r`, `c`: memory, reading and constants of the tick.
        """
        n, size = self.filter.arms, self.filter.dimension
        # Values here are relative to the origin, if there is one, except rates.
        origin, positions_read = self._origin(m), r.offset if self.split else r.measured
        z, covariance = self._restarted(m, r, c)
        # NaN must not reach the products: zero times NaN is not zero.
        absolute = z + origin
        moving = ca.vertcat(absolute[n : 2 * n], absolute[2 * n + 1])
        extrapolated = positions_read + r.age * moving
        measured = ca.vertcat(*(ca.if_else(r.present[i], extrapolated[i], 0) for i in range(n + 1)))
        noise, mark = c.noise, m.mark
        if self.plays:
            shift, spread, mark = self._without_play(m, r, c, measured - ca.DM(self.filter.observation) @ z)
            measured, noise = measured + shift, noise + pack(spread)
        updated, covariance, innovation, nis, weighted = self.filter.updated(
            z, covariance, measured, r.present, noise, Timing(r.age, m.timing, moving)
        )
        turns, slipped = self._slipped(m, r, measured - ca.DM(self.filter.observation) @ z, innovation)
        variances = ca.diag(covariance)
        if self.filter.as_measured:
            restored = ca.sparsify(ca.SX(ca.DM(self.filter.restored)))
            variances = ca.diag(restored @ covariance @ restored.T)
        sigmas = ca.vertcat(*(ca.sqrt(variances[i]) for i in range(size)))
        # The last value is not finite if any part of the estimate is not.
        sound = all_of(nis >= 0, nis <= BIG, finite(ca.sum1(updated) + ca.sum1(sigmas)), ca.logic_not(slipped))
        # Readings cannot resolve half a turn per period: such rates have diverged.
        sound = all_of(
            sound, *(ca.fabs(updated[n + i] + origin[n + i]) <= np.pi / self.filter.period for i in range(n))
        )
        # If the update fails, the restart begins with the prediction.
        updated = ca.vertcat(*(ca.if_else(sound, updated[i], z[i]) for i in range(size)))
        used = ca.sum1(r.present)
        aligned, weight = ca.horzsplit(moving.T @ weighted)
        timing, timed, lateness = self._timing(m, aligned, weight, sound)
        # Sherman and Morrison: S without the part due to varying ages.
        strain = nis + m.timing * aligned**2 / (1 - m.timing * weight)
        return Sensed(
            updated + origin,
            pack(covariance),
            sigmas,
            nis,
            used,
            sound,
            turns,
            timing,
            timed,
            lateness,
            strain,
            mark,
            updated,
        )

    def _without_play(self, m: Memory, r: Measurement, c: Numbers, apart: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return corrections (n+1,) from the encoders' angles to the joints', rad; that of the cart is 0.

        Their covariance (n+1, n+1) and the new marks (n,) follow. A joint that moves its encoder is at the side of the
        play to which it turns. Any other joint is at the filter's prediction inside the play, or at the nearest side.
        An angle is the sum of the joints inside it, so corrections of the joints add up along the chain.

        `m`, `r`, `c`: memory, reading and constants of the tick. `apart` (n+1,): readings minus predictions, rad and m.
        """
        n = self.filter.arms
        chain_sums = ca.DM(np.tril(np.ones((n, n))))
        shifts, variances, marks = [], [], []
        for i in range(n):
            angle = r.measured[i] - (r.measured[i - 1] if i else 0)
            change, half, lag_in_play = angle - m.mark[i], c.play[i] / 2, (apart[i - 1] if i else 0) - apart[i]
            both_read = all_of(*(r.present[k] for k in range(max(i - 1, 0), i + 1)))
            marked = finite(m.mark[i])
            moves = all_of(ca.fabs(change) >= c.moves, both_read, marked)
            predicted_place = within(ca.atan2(ca.sin(lag_in_play), ca.cos(lag_in_play)), half)
            shift = ca.if_else(moves, ca.if_else(change > 0, half, -half), predicted_place)
            shifts.append(ca.if_else(both_read, shift, 0))
            variances.append((ca.if_else(moves, _AT_SIDE, _IN_PLAY) * half) ** 2)
            # The first mark is the first reading.
            marks.append(ca.if_else(ca.logic_or(moves, ca.logic_not(marked)), angle, m.mark[i]))
        spread = chain_sums @ ca.diag(ca.vertcat(*variances)) @ chain_sums.T
        return ca.vertcat(chain_sums @ ca.vertcat(*shifts), 0), ca.diagcat(spread, 0), ca.vertcat(*marks)

    def _timing(self, m: Memory, aligned: ca.SX, weight: ca.SX, sound: ca.SX) -> Iterator[ca.SX]:
        """Return the variance of the readings' age, s², the information in it, and the mean apparent age, periods.

        They are the estimates after this reading, stored as `timing`, `timed` and `lateness`. Without a sound estimate,
        they are unchanged.

        `m`: memory of the tick. `aligned`, `weight`: ωᵀS⁻¹y and ωᵀS⁻¹ω, whose ratio is the apparent age of this
        innovation y; ω are the rates and S is the innovation's covariance. Let a and b be the same for time in periods.
        Then the log likelihood has the slope (a² - b) / 2 by the variance, and b² / 2 is the information.

        Source: the score of a Gaussian whose covariance is linear in one parameter.
        """
        period = self.filter.period
        a, b = aligned * period, weight * period**2
        timed = m.timed + min(period / TIMING_MEMORY, 1) * (TIMING_INFORMATION - m.timed) + b * b
        # A reading is never older than a period. A much older appearance is due to a blow, a wrong model or a stuck
        # encoder.
        slope = ca.if_else(ca.fabs(a) <= _OLDEST * b, a * a - b, 0)
        late = m.lateness + (a - b * m.lateness) / (1 + b) / _LATE_MEMORY
        # Ages vary about the filter's. A constant lateness is due to a stuck encoder or a wrong model.
        largest = ca.if_else(ca.fabs(late) <= _VERY_LATE, m.timing, 0)
        largest = ca.if_else(ca.fabs(late) <= _LATE, period**2 / 3, largest)
        variance = clipped(m.timing + period**2 * slope / timed, ca.SX(0), largest)
        estimates = ((variance, m.timing), (timed, m.timed), (within(late, ca.SX(_OLDEST)), m.lateness))
        return (ca.if_else(sound, value, stored) for value, stored in estimates)

    def _slipped(self, m: Memory, r: Measurement, apart: ca.SX, innovation: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the whole turns between readings and predictions (n,), rad, and 1 if one of them is new.

        The filter compares angles modulo a turn. If its rates diverge, its angle can slip by a turn without an
        innovation, but the encoders count turns. A new turn therefore shows a lost estimate.

        `m`, `r`: memory and reading of the tick. `apart` (n+1,): readings minus predictions before angles are wrapped.
        `innovation` (n+1,): the same, wrapped. Both are in rad and m.
        """
        n, restarts = self.filter.arms, m.restart
        apparent_turns = [ca.if_else(r.present[i], apart[i] - innovation[i], m.turns[i]) for i in range(n)]
        turns = [ca.if_else(restarts, 0, turn) for turn in apparent_turns]
        # Jumps of a reading, as of an encoder with one turn, and the first reading are not slips.
        jumped = [
            ca.logic_not(ca.fabs(r.measured[i] - (r.measured[i - 1] if i else 0) - m.last[i]) < np.pi)
            for i in self.watch.joints
        ]
        slipped = [ca.fabs(turns[i] - m.turns[i]) > np.pi for i in range(n)]
        continuous = [ca.logic_not(restarts), *([ca.logic_not(any_of(*jumped))] if jumped else [])]
        return ca.vertcat(*turns), all_of(any_of(*slipped), *continuous)

    def _origin(self, m: Memory) -> ca.SX:
        """Return the origin of z, (N+E,), from the memory `m`; zero unless the state is split."""
        return ca.vertcat(m.origin, ca.SX(self.filter.dimension - m.origin.shape[0], 1))

    def _acting(self, command: ca.SX, velocity: ca.SX, drive: ca.SX, c: Numbers) -> tuple[ca.SX, ca.SX]:
        """Return the cart's mean acceleration in a period and its acceleration at the period's end, m/s².

        The first predicts the state over the period, the second is the lagging drive's acceleration for the next
        period. The drive keeps its velocity reference within its limit. If that already exceeds the limit, the drive
        returns it with at most its largest acceleration, see `DriveLimits.acting`.

        `command` m/s²: acts in the period. `velocity` m/s and `drive` m/s²: velocity and acceleration of the cart at
        its begin. `c`: constants of the run.
        """
        period, fastest = self.filter.period, c.velocity
        velocity_reference = velocity + c.lag * drive if self.lags else velocity
        limited = within(
            clipped(command, (-fastest - velocity_reference) / period, (fastest - velocity_reference) / period),
            c.acceleration,
        )
        if not self.lags:
            return limited, drive
        keeps = c.lag_keeps
        return limited + c.lag / period * (1 - keeps) * (drive - limited), limited + keeps * (drive - limited)

    def law(self, row: Row, ahead: Any, drive: Any, extra: Any, trust: Any) -> tuple[Any, Any]:
        """Return the feedback of a table's row, m/s², from the state and the extras that the filter estimates.

        Args:
            row: one row of the table, by the names of `TickEquations.row`.
            ahead: state (N,) at which the command acts.
            drive: the cart's acceleration then, m/s².
            extra: estimated extras (E,).
            trust: largest error of a share on which the law acts.

        Returns:
            The feedback, and the number of the last extra beyond its trust, from 1, or 0.
        """
        feedback, last_untrusted = 0.0, 0.0
        for i in range(ahead.shape[0]):
            feedback += row.gains[i] * (row.state[i] - ahead[i])
        if self.lags:
            feedback += row.drive_gain * (row.drive - drive)
        trusted_shares: list[Any] = []
        for i, share in enumerate(self.shares or ()):
            value = extra[i]
            if share:
                last_untrusted = ca.if_else(ca.fabs(value) > trust, i + 1, last_untrusted)
                value = within(value, trust)
                trusted_shares.append(value)
            feedback -= row.extra_gains[i] * value
        for k, (first, second) in enumerate(combinations_with_replacement(trusted_shares, 2)):
            feedback -= row.pair_gains[k] * first * second
        return feedback, last_untrusted

    def _by_own(self, m: Memory, row: Row, ahead: ca.SX, parameters: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the feedback of a user's law, m/s², and its next memory; without such a law, 0 and m.own.

        `m`, `row`: memory of the tick and row of the table. `ahead` (N,): state at which the command acts. `parameters`
        (p,): base parameters of the model.
        """
        if self.own is None:
            return ca.SX(0), m.own
        law = self.own.expression(ahead.shape[0], parameters.shape[0])
        result = law(ahead, row.state, row.feedforward, m.own, parameters)
        command, memory = ca.vertsplit(result, [0, 1, result.shape[0]])
        return ca.if_else(row.own, command - row.feedforward, 0), memory

    def _finish(self, known: Known, *, predicts: bool) -> ca.SX:
        """Return the next memory and the report of a tick, joined to one vector, from its reading, row and estimate.

        `predicts`: True to include the filter's prediction for the next tick, False if another estimator replaces the
        filter.
        """
        law = self._by_law(known)
        means = self._means(known, predicts=predicts)
        verdict = self._verdict(known, law, means, predicts=predicts)
        path = self._path(known, law, verdict)
        after = self._memory(known, law, means, verdict, path, predicts=predicts)
        report = self._report(known, law, means, verdict, path)
        return ca.vertcat(self.memory.joined(after), self.report.joined(report))

    def _by_law(self, known: Known) -> _Law:
        """Return feedforward and feedback before limits, m/s², and the memory of a user's law.

        Both are summed from the row's gains, a user's law and `acts.back`; `finite` is 0 if they or the estimate are
        unsound.
        """
        row, constants, size = known.row, known.numbers, self.filter.equations.dimension
        sensed, acts = known.sensed, known.acts
        row_feedback, untrusted = self.law(row, acts.ahead, acts.drive, sensed.z[size:], constants.trust)
        own_feedback, own_memory = self._by_own(known.memory, row, acts.ahead, constants.parameters)
        feedback = acts.back + row_feedback + own_feedback
        sound = ca.logic_and(sensed.sound, finite(row.feedforward + feedback))
        return _Law(row.feedforward, feedback, sound, untrusted, own_feedback, own_memory)

    def _means(self, known: Known, *, predicts: bool) -> _Means:
        """Return the means that `_verdict` compares with bounds: of NIS, of distances from the reference, of silence.

        The NIS of a tick is divided by the number of measured positions, so its mean is about 1 for a right model.
        `predicts`: True if the filter is the compiled one.
        """
        memory, reading, constants, sensed, n, period = (
            *known[:2],
            known.numbers,
            known.sensed,
            self.filter.arms,
            self.filter.period,
        )
        has_reading = ca.logic_and(sensed.used > 0, sensed.sound)
        # A blow ends within a tick, and is not evidence of a lost estimate.
        nis_per_position = ca.fmin(sensed.nis / ca.fmax(sensed.used, 1), _MOST_AT_ONCE * constants.lost_estimate)
        nis = memory.nis + ca.if_else(
            has_reading, (nis_per_position - memory.nis) * min(period / ESTIMATE_MEMORY, 1), 0
        )
        strain_per_position = ca.fmin(sensed.strain / ca.fmax(sensed.used, 1), _MOST_AT_ONCE * constants.lost_estimate)
        strain = memory.strain + ca.if_else(
            has_reading, (strain_per_position - memory.strain) * min(period / ESTIMATE_MEMORY, 1), 0
        )
        silent = ca.if_else(reading.present, 0, (memory.silent + period) * ca.DM(self.measured))
        angles = [sensed.z[i] for i in range(n)]
        if predicts:
            # By the readings, which are right if the estimate is wrong. Another estimator's turns are unknown here.
            angles = [
                ca.if_else(reading.present[i], reading.measured[i] - sensed.turns[i], angles[i]) for i in range(n)
            ]
        distance = reduce(ca.fmax, [ca.fabs(angles[i] - known.row.wanted[i]) for i in range(n)])
        blind = ca.logic_and(memory.restart, ca.logic_not(sensed.used > 0))
        comparable = ca.logic_and(sensed.sound, ca.logic_not(blind))
        error = memory.error + ca.if_else(comparable, (distance - memory.error) * min(period / TRACKING_MEMORY, 1), 0)
        return _Means(nis, strain, silent, distance, blind, error)

    def _verdict(self, known: Known, law: _Law, means: _Means, *, predicts: bool) -> _Verdict:
        """Return the tick's outcome: continue, restart the filter, move the clock, hold, or stop with the cause.

        A stuck sensor and a drive that is not followed are checked here as well, so the watch's memory is part of the
        result. Conditions are written so that NaN stops the run.
        """
        memory, constants, sensed, n = known.memory, known.numbers, known.sensed, self.filter.arms
        sound = all_of(law.finite, means.nis <= constants.lost_estimate, finite(means.distance + ca.sum1(sensed.z[:n])))
        lost = ca.logic_not(sound)
        restarts = ca.logic_and(lost, memory.restarts < constants.restarts - 0.5)
        leaves = self._farthest_reach(known) >= constants.travel
        # A cart that follows fallen arms is not the cause of the ending.
        fallen = ca.logic_and(leaves, means.distance > constants.lost_tracking)
        largest_error = ca.if_else(
            memory.held, ca.fmax(constants.lost_tracking, LOST_AFTER_FALLBACK), constants.lost_tracking
        )
        astray = means.error > largest_error
        holds = all_of(astray, constants.can_hold, ca.logic_not(memory.held))
        moves = all_of(
            constants.resynchronise > 0, means.error > constants.resynchronise, memory.moved > TRACKING_MEMORY
        )
        # Changes of angles and rates by the update, (2n,): a stuck encoder needs steady corrections.
        corrections = (sensed.relative if self.split else sensed.z)[: 2 * n] - memory.z[: 2 * n] if predicts else None
        stuck = self.watch.stuck(known, ca.if_else(restarts, 0, means.strain), corrections)
        drive, sensor, watch = self.watch.unfollowed(known, stuck)
        outcome = ca.SX(int(Outcome.GO_ON))
        # From the weakest: each overrides those before it.
        for condition, code in (
            (known.reading.switch, Outcome.SWITCH),
            (moves, Outcome.RESYNCHRONISE),
            (holds, Outcome.HOLD),
            # Neither a restart nor a hold helps against a stuck sensor.
            (restarts, Outcome.RESTART),
            (sensor, Outcome.STUCK),
            *(
                (ca.logic_and(condition, ca.logic_not(restarts)), code)
                for condition, code in (
                    (ca.logic_and(astray, ca.logic_not(holds)), Outcome.TRACKING_LOST),
                    (leaves, Outcome.CART),
                    (fallen, Outcome.FALLEN),
                    (ca.mmax(means.silent) > constants.missing, Outcome.SILENT),
                    (lost, Outcome.ESTIMATE_LOST),
                )
            ),
        ):
            outcome = ca.if_else(condition, int(code), outcome)
        outcome = ca.if_else(drive > 0, drive, outcome)
        # A run that has been stopped keeps its first cause while the cart brakes.
        outcome = ca.if_else(memory.stopped > 0, int(Outcome.GO_ON), outcome)
        stopped = ca.if_else(outcome >= int(Outcome.ESTIMATE_LOST), outcome, memory.stopped)
        return _Verdict(outcome, stopped, sensor, watch)

    def _farthest_reach(self, known: Known) -> ca.SX:
        """Return the cart's resting place if it brakes now, or its place if it is farther, m from the centre.

        `_verdict` compares it with the half length of the track. It includes the supervisor's margin.
        """
        memory, constants, n = known.memory, known.numbers, self.filter.arms
        position, velocity, sent = known.acts.ahead[2 * n], known.acts.ahead[2 * n + 1], memory.velocity
        # The drive is no faster, whatever the estimate of a cart whose scale has just stuck.
        velocity = ca.fmin(ca.fmax(velocity, -_FASTEST * constants.velocity), _FASTEST * constants.velocity)
        # A return, which has no margin, brings the cart back onto its track.
        farthest = ca.fmax(
            ca.if_else(constants.margin > 0, ca.fabs(position), 0), self._stopping_point(position, velocity, constants)
        )
        # Sent commands without an effect yet, for a lagging drive.
        return ca.fmax(
            farthest, ca.if_else(ca.fabs(sent) > 0, self._stopping_point(position, memory.heading, constants), -BIG)
        )

    def _path(self, known: Known, law: _Law, verdict: _Verdict) -> _Path:
        """Return the command, its parts, the cart's acceleration in the coming period, and the memory after the tick.

        `wish` is the sum of the law's feedforward and feedback. `command` is limited to the drive's acceleration. The
        drive limits the velocity, too, which the memory's velocity and `saturated` take into account. During a stop,
        the command brakes the cart to rest, and the law is ignored. `heading` is the velocity that the cart has once
        all sent commands have acted, corrected by the estimate with the time constant `_LAGS`. A caller that stores the
        pending commands itself gives the acceleration in the coming period, `coming`. Otherwise the memory's queue
        holds them, of which the first acts for `share` of the period and the second for the rest.
        """
        memory, constants, period, n = known.memory, known.numbers, self.filter.period, self.filter.arms
        limit, top_speed, sent, stop = constants.acceleration, constants.velocity, memory.velocity, verdict.stopped > 0
        forward = ca.if_else(ca.logic_or(stop, ca.logic_not(law.finite)), 0, law.forward)
        feedback = ca.if_else(law.finite, law.feedback, 0)
        feedback = ca.if_else(stop, within(-sent / period, BRAKING * limit), feedback)
        wish = forward + feedback
        command = within(wish, limit)
        velocity = within(sent + command * period, top_speed)
        # Braking to rest leaves a rounding error.
        velocity = ca.if_else(ca.fabs(velocity) > AT_REST, velocity, 0)
        still = ca.if_else(all_of(memory.stopped > 0, ca.logic_not(ca.fabs(sent) > 0)), memory.still + period, 0)
        queue, coming = memory.sent, known.acts.coming
        if coming is None:
            queue = ca.vertcat(memory.sent[1:], command)
            coming = constants.share * queue[0] + (1 - constants.share) * queue[1]
        velocity_index = self.filter.equations.dimension - 1
        acting, drive_at_end = self._acting(coming, known.sensed.z[velocity_index], memory.drive, constants)
        saturated = ca.logic_or(ca.fabs(wish) > limit, ca.fabs(velocity) >= top_speed)
        heading, cart_velocity = memory.heading, known.acts.ahead[2 * n + 1]
        heading = within(heading + command * period + (cart_velocity - heading) * min(period / _LAGS, 1), top_speed)
        shaped, notch = self._shaped(known, command)
        after = verdict.watch._replace(
            sent=queue, velocity=velocity, heading=heading, still=still, drive=drive_at_end, shaped=notch
        )
        return _Path(forward, feedback, wish, shaped, acting, saturated, after)

    def _shaped(self, known: Known, command: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the command that is sent to the drive, m/s², and the notch's next memory (2,).

        For an elastic belt, the notch removes the belt's resonance from `command`; otherwise the command is sent
        unchanged.
        """
        if not self.shapes:
            return command, known.memory.shaped
        # Drive, shaping and belt act as a lag, which the filter models.
        (b0, b1, b2, a1, a2), (first, second) = (
            ca.vertsplit(known.numbers.notch),
            ca.vertsplit(known.memory.shaped),
        )
        shaped = within(b0 * command + first, known.numbers.acceleration)
        return shaped, ca.vertcat(b1 * command - a1 * shaped + second, b2 * command - a2 * shaped)

    def _memory(
        self, known: Known, law: _Law, means: _Means, verdict: _Verdict, path: _Path, *, predicts: bool
    ) -> Memory:
        """Return the memory for the next tick: that of the path, with prediction, means, verdict and watches.

        The arguments are the results of `_by_law`, `_means`, `_verdict` and `_path`. `predicts`: see `_predicted`.
        """
        memory, sensed, period = known.memory, known.sensed, self.filter.period
        holds, restarts = ca.eq(verdict.outcome, int(Outcome.HOLD)), ca.eq(verdict.outcome, int(Outcome.RESTART))
        clock_moved = ca.eq(verdict.outcome, int(Outcome.RESYNCHRONISE))
        z, covariance = self._predicted(known, means, path.acting, predicts=predicts)
        return self.watch.expected_cart(path.after, known.numbers, path.acting)._replace(
            z=z, covariance=covariance, turns=sensed.turns, timing=sensed.timing, timed=sensed.timed,
            lateness=sensed.lateness, strain=means.strain, error=ca.if_else(holds, 0, means.error),
            nis=ca.if_else(restarts, 0, means.nis), silent=means.silent,
            restarts=memory.restarts * (1 - min(period / RESTART_MEMORY, 1)) + restarts,
            held=ca.if_else(holds, 1, memory.held), moved=ca.if_else(clock_moved, 0, memory.moved + period),
            restart=ca.logic_or(restarts, means.blind), stopped=verdict.stopped, acted=path.acting,
            cut=path.saturated, was_untrusted=ca.logic_or(memory.was_untrusted, law.untrusted > 0), own=law.own,
            drive_watch=self.watch.expected_arms(known, verdict.watch.drive_watch, path.acting), mark=sensed.mark,
        )  # fmt: skip

    def _predicted(self, known: Known, means: _Means, acting: ca.SX, *, predicts: bool) -> tuple[ca.SX, ca.SX]:
        """Return the filter's prediction z (N+E,) for the next reading, and its covariance packed.

        Without `predicts`, the memory's values are returned unchanged, since another estimator replaces the filter.

        `acting`: mean acceleration of the cart in the coming period, m/s².
        """
        memory, constants, sensed = known.memory, known.numbers, known.sensed
        if not predicts:
            return memory.z, memory.covariance
        start, origin = (sensed.relative, self._origin(memory)) if self.split else (sensed.z, None)
        covariance = unpack(sensed.covariance, self.filter.dimension)
        noise_inputs = self.filter.noise_inputs(covariance, acting - memory.acted, means.nis)
        predicted = self.filter.predicted
        following, jacobian, noise = predicted(
            start, acting, constants.parameters, constants.process, noise_inputs, origin
        )
        return following, propagated(jacobian, covariance, noise)

    def _report(self, known: Known, law: _Law, means: _Means, verdict: _Verdict, path: _Path) -> Report:
        """Return the tick's report for loop and log: estimate, command, mode, outcome and checked means.

        The arguments are the results of `_by_law`, `_means`, `_verdict` and `_path`. Errors of parameters, which z has
        as logarithms, are relative in the report.
        """
        memory, sensed, size, stop = known.memory, known.sensed, self.filter.equations.dimension, verdict.stopped > 0
        newly_cut = ca.logic_and(path.saturated, ca.logic_not(memory.cut))
        newly_untrusted = ca.if_else(memory.was_untrusted, 0, law.untrusted)
        repeats = ca.SX(0)
        for i in range(self.filter.arms + 1):
            repeats = ca.if_else(ca.eq(verdict.sensor, i + 1), verdict.watch.same[i], repeats)
        running_mode = ca.if_else(path.saturated, int(Mode.SATURATED), known.numbers.mode)
        # Reports and logs hold relative errors, the filter logarithms.
        extras, sigmas = sensed.z[:, :], sensed.sigmas[:, :]
        for i in self.filter.shares:
            sigmas[i] *= ca.exp(extras[i])
            extras[i] = ca.exp(extras[i]) - 1
        return Report(
            state=sensed.z[:size], wish=path.wish, feedforward=path.forward, feedback=path.feedback, acting=path.acting,
            saturated=path.saturated, nis=sensed.nis, mode=ca.if_else(stop, int(Mode.ABORTED), running_mode),
            sigmas=sigmas, extra=extras[size:], command=path.command, outcome=verdict.outcome, stop=stop,
            done=path.after.still > SETTLING, newly_cut=newly_cut, untrusted=newly_untrusted, sensor=verdict.sensor,
            repeats=repeats, error=means.error, mean_nis=means.nis, silent=ca.mmax(means.silent), used=sensed.used,
            ahead=known.acts.ahead, notable=verdict.outcome + stop, news=newly_cut + newly_untrusted,
            own=law.by_own + known.row.feedforward,
        )  # fmt: skip

    def _stopping_point(self, position: ca.SX, velocity: ca.SX, c: Numbers) -> ca.SX:
        """Return the cart's resting place if it brakes now, from the centre in its direction of motion, m.

        It is negative on the side of its start, and includes the margin.

        `position` m, `velocity` m/s: of the cart when braking is commanded. `c`: constants of the run, of which c.onset
        passes until braking acts.
        """
        reached = position + velocity * c.onset
        return ca.if_else(velocity < 0, -reached, reached) + velocity * velocity / c.brake + c.margin

    # The functions.

    def function(self) -> ca.Function:
        """Return the whole tick: (reading, row, numbers, memory) -> memory and report."""
        (reading, reading_parts), (row, row_parts), (numbers, constants), (memory, memory_parts) = self._symbols()
        sensed = self._sense(memory_parts, reading_parts, constants)
        z, drive = sensed.z, memory_parts.drive
        for command in pending_commands(memory_parts.sent, constants.share, whole=self.whole, lead=self.lead):
            z, drive = self._moved(z, drive, command, constants)
        result = self._finish(
            Known(
                memory_parts,
                reading_parts,
                row_parts,
                constants,
                sensed,
                _Acts(self._seen(z, reading_parts), drive, ca.SX(0), None),
            ),
            predicts=True,
        )
        return _function("tick", {"reading": reading, "row": row, "numbers": numbers, "memory": memory}, result)

    def sense(self) -> ca.Function:
        """Return the first part of a split tick (see `finish`), the filter's update.

        (memory, reading, numbers) -> the estimate, in the layout `sensed`.
        """
        (reading, reading_parts), _, (numbers, constants), (memory, memory_parts) = self._symbols()
        result = self.sensed.joined(self._sense(memory_parts, reading_parts, constants))
        return _function("sense", {"memory": memory, "reading": reading, "numbers": numbers}, result)

    def moved(self) -> ca.Function:
        """Return one period of the prediction up to the time at which a command acts.

        (z, drive, command, numbers) -> the next z, then the next drive.
        """
        z, drive, command = ca.SX.sym("z", self.filter.dimension), ca.SX.sym("drive"), ca.SX.sym("command")
        numbers, constants = self.numbers.symbols("numbers")
        result = ca.vertcat(*self._moved(z, drive, command, constants))
        return _function("moved", {"z": z, "drive": drive, "command": command, "numbers": numbers}, result)

    def finish(self, *, predicts: bool) -> ca.Function:
        """Return the second part of a split tick, which follows the law.

        (reading, row, numbers, memory, sensed, ahead, drive, back[, coming]) -> memory and report.

        A tick is split if Python code runs in its middle: a law with its own clock, which computes `back` from `ahead`,
        another estimator, which provides `sensed`, or the repeated prediction over a delay too long to unroll.

        reading, row, numbers, memory: inputs of a whole tick; the row holds gains and reference of the tick. sensed:
        output of the first part, the estimate. ahead (N,), drive m/s²: state for which the command is computed, and the
        cart's acceleration then. back m/s²: feedback in addition to the row's. coming m/s²: optional last input, the
        command that acts in the coming period, for a memory without the pending commands (`unrolled` is False).

        Args:
            predicts: True to predict the filter's next state, False to keep the filter's memory, if another estimator
                replaces the filter.
        """
        (reading, reading_parts), (row, row_parts), (numbers, constants), (memory, memory_parts) = self._symbols()
        sensed, sensed_parts = self.sensed.symbols("sensed")
        ahead_state, back = ca.SX.sym("ahead", self.filter.equations.dimension), ca.SX.sym("back")
        drive = ca.SX.sym("drive")
        coming = None if self.unrolled else ca.SX.sym("coming")
        result = self._finish(
            Known(
                memory_parts, reading_parts, row_parts, constants, sensed_parts, _Acts(ahead_state, drive, back, coming)
            ),
            predicts=predicts,
        )
        inputs = {"reading": reading, "row": row, "numbers": numbers, "memory": memory, "sensed": sensed}
        inputs |= {"ahead": ahead_state, "drive": drive, "back": back, **({} if coming is None else {"coming": coming})}
        return _function("finish", inputs, result)

    def _symbols(self) -> list[tuple[ca.SX, Any]]:
        """Return the vectors of reading, row, numbers and memory, the inputs of a tick, each with its parts by name."""
        # The memory is last, so that a row of an array can have it as output of one tick and input of the next.
        layouts = {"reading": self.reading, "row": self.row, "numbers": self.numbers, "memory": self.memory}
        symbols = [layout.symbols(name) for name, layout in layouts.items()]
        reading, parts = symbols[0]
        visible = {name: self._measured_only(getattr(parts, name)) for name in ("measured", "present")}
        return [(reading, parts._replace(**visible)), *symbols[1:]]

    def _measured_only(self, values: ca.SX) -> ca.SX:
        """Return values (n+1,) of the positions, with 0 for the arms without an encoder."""
        return ca.vertcat(*(values[i] if measured else 0 for i, measured in enumerate(self.measured)))

    def _moved(self, z: ca.SX, drive: ca.SX, command: ca.SX, c: Numbers) -> tuple[ca.SX, ca.SX]:
        """Return z (N+E,) and the cart's acceleration, m/s², a period later.

        `command` m/s²: acts in the period. `drive` m/s²: acceleration of the cart at its begin, for a lagging drive.
        `c`: constants of the run.
        """
        acting, following = self._acting(command, z[self.filter.equations.dimension - 1], drive, c)
        # Only z is used, so the inputs of the noise are zero.
        return self.filter.predicted(z, acting, c.parameters, c.process, ca.SX(3, 1))[0], following

    def _seen(self, z: ca.SX, r: Measurement) -> ca.SX:
        """Return the state (N,) that the law receives: z without extras, with the simulated error of measured rates.

        `r`: reading of the tick, which has this error.
        """
        n, size = self.filter.arms, self.filter.equations.dimension
        return ca.vertcat(*(z[i] + (r.rate_error[i - n] if n <= i < 2 * n else 0) for i in range(size)))


def pending_commands(sent: Any, share: Any, *, whole: int, lead: int) -> list[Any]:
    """Return the accelerations in the next periods due to commands that were sent, m/s², to predict the state.

    Args:
        sent: sent commands, oldest first, m/s².
        share: share of a period in which the earlier command acts.
        whole: whole periods of the delay.
        lead: number of the next periods.
    """
    # The next command to act is one place newer than the last.
    return [share * sent[k] + (1 - share) * sent[min(k + 1, whole + 1)] for k in range(1, lead + 1)]


def _function(name: str, inputs: Mapping[str, ca.SX], out: ca.SX) -> ca.Function:
    """Return the function from named inputs to the dense vector `out`, with common subexpressions computed once."""
    return ca.Function(name, [*inputs.values()], [ca.cse(ca.densify(out))], [*inputs], ["out"], {"cse": True})


@lru_cache(maxsize=32)
def _tick_equations(
    equations: Equations, period: float, augments: tuple[Augment, ...], path: tuple[int, int] | None,
    shares: tuple[bool, ...] | None, lags: bool, mechanics: tuple[bool, bool, tuple[bool, ...]],
    own: "SymbolicLaw | None",
) -> tuple[TickEquations, dict[str, Compiled]]:  # fmt: skip
    """Return a tick's equations, and a dictionary of their compiled functions by name, empty at first.

    All runs of a process share both, so each function is compiled once.

    path: whole periods of the delay and periods of prediction, or None for a delay too long to unroll. mechanics: True
    for play, True for a belt, and True for each measured arm. augments: extras of the filter. shares, lags, own: see
    the attributes of `TickEquations`.
    """
    filters = FilterEquations(equations, period, augments, as_measured=True)
    whole, lead = path or (0, 0)
    plays, shapes, encoders = mechanics
    return TickEquations(
        filters, whole, lead, shares, path is not None, lags, plays, shapes, own, encoders=encoders
    ), {}


def whole_periods(delay: float) -> tuple[int, int]:
    """Return a delay's whole periods, and the number of periods over which a tick predicts the state.

    Args:
        delay: delay of a command, in periods.
    """
    return math.floor(delay), round(delay)


class TickProgram:
    """The tick of one law as machine code.

    It belongs to one model, filter, delay and law, and computes `runs` runs in lockstep.

    Arrays have a column for each run and fill whole vectors of the processor, because partial vectors round
    differently. So a single run equals one of many.

    The arrays of inputs and outputs are made once, and each tick overwrites them. `_inputs` has the parts `reading`,
    `row`, `_constants` (by name: `numbers`) and `stored` (by name: `memory`), in this order. The caller writes reading
    and row before a tick. `_out` receives the next memory, `_kept`, which is then copied into `stored`, and the report.
    `_sent` holds the pending commands, oldest first; for delays too long to unroll it is an array of its own. `_made`
    holds the compiled functions by name.
    """

    def __init__(
        self,
        model: SampledModel,
        settings: FilterSettings,
        *,
        noise: Array,
        delay: float,
        bounds: Mapping[str, float],
        law: GainSchedule | None = None,
        runs: int = 1,
        mechanics: KnownMechanics | None = None,
    ) -> None:
        """Prepare the tick; machine code is compiled when it is first used.

        Args:
            model: model of arms and drive from tick to tick.
            settings: settings of the filter.
            noise: covariance (n+1, n+1) of the measured positions.
            delay: delay of a command, in periods.
            bounds: values of `Numbers` that judge the run, by name.
            law: gains by the loop's clock; None for a law with its own clock.
            runs: number of runs in lockstep.
            mechanics: the rig's mechanics, by default without play and belt.
        """
        self._delay = whole, self.lead = whole_periods(delay)
        mechanics = mechanics or KnownMechanics((), 0.0, 0.0)
        unrolls = self.lead <= UNROLLED
        # All delays too long to unroll share their compiled code, so this object stores the pending commands.
        path = self._delay if unrolls else None
        self.equations, self._made = _tick_equations(
            model.equations,
            model.period,
            settings.augments,
            path,
            None if law is None else law.shares,
            model.lag > 0,
            (any(mechanics.play), mechanics.belt > 0, mechanics.encoders),
            None if law is None else law.law,
        )
        self.model, self.settings, self.runs = model, settings, runs
        equations, arms = self.equations, model.arms
        self.period = model.period
        self.lanes = SINGLE if runs == 1 else runs + -runs % VECTOR
        restart_variances = settings.first_covariance(arms).diagonal().copy()
        restart_variances[arms : 2 * arms], restart_variances[2 * arms + 1] = RESTART_RATE**2, RESTART_VELOCITY**2
        constants = {
            **bounds, "share": delay - whole, "lag": model.lag, "lag_keeps": model.lag_keeps,
            "noise": packed(noise),
            "parameters": model.parameters, "process": settings.process(arms, model.period), "fresh": restart_variances,
        }  # fmt: skip
        if equations.plays:
            constants |= {"play": np.array(mechanics.play), "moves": _MOVES * np.sqrt(noise[0, 0])}
        if equations.shapes:
            constants["notch"] = mechanics.notch(model.period)
        sizes = [layout.size for layout in (equations.reading, equations.row, equations.numbers, equations.memory)]
        self._inputs = np.zeros((sum(sizes), self.lanes))
        reading, self.row, self._constants, self.stored = np.split(self._inputs, np.cumsum(sizes)[:-1])
        self._constants[:] = equations.numbers.filled(self.lanes, **constants)
        self.memory, self.reading = equations.memory.of(self.stored), equations.reading.of(reading)
        self.numbers = equations.numbers.of(self._constants)
        self._out = np.empty((equations.memory.size + equations.report.size, self.lanes))
        self._sent: Array = self.memory.sent if unrolls else np.zeros((whole + 2, self.lanes))
        self._kept, report = self._out[: equations.memory.size], self._out[equations.memory.size :]
        self.report = equations.report.of(report)
        """Report of the last tick, parts (length, lanes), overwritten at the next."""
        self.logged = report[: equations.report.slices.extra.stop, 0]
        """Its first parts up to the extras, which a log's row holds, of the first run."""

    def machine(self, name: str) -> Compiled:
        """Return one of the tick's functions as machine code, compiled at its first use in the process.

        Args:
            name: "tick", "sense", "moved", "finish", or "judge" (finish without filter).
        """
        if name not in self._made:
            equations = self.equations
            builders = {
                "tick": equations.function, "sense": equations.sense, "moved": equations.moved,
                "finish": partial(equations.finish, predicts=True), "judge": partial(equations.finish, predicts=False),
            }  # fmt: skip
            self._made[name] = Compiled(builders[name]())
        return self._made[name]

    def _call(self, name: str) -> Any:
        """Return the callable of a function by its name: for one run the faster one, otherwise that for all lanes."""
        return self.machine(name).single if self.runs == 1 else self.machine(name).machine

    def begin(self, first: Array, queued: Array, *, velocity: float) -> None:
        """Fill the memory for the start of a run, as if the pending commands had been sent.

        Args:
            first: first state (N,).
            queued: pending commands (lead, runs), oldest first, m/s².
            velocity: velocity of the cart, m/s.
        """
        limit, top_speed = self.numbers.acceleration[0, 0], self.numbers.velocity[0, 0]
        sent = np.zeros(self._sent.shape)
        speed = np.full(self.lanes, velocity)
        for command in np.clip(self.spread(queued), -limit, limit):
            sent = np.concatenate([sent[1:], command[None]])
            speed = np.clip(speed + command * self.period, -top_speed, top_speed)
        carried, n = self.equations.filter.carried, self.model.arms
        first_values = {
            "z": np.concatenate([first, np.zeros(self.equations.filter.dimension - len(first))]),
            "covariance": packed(carried @ self.settings.first_covariance(self.model.arms) @ carried.T),
            "velocity": speed[None], "heading": speed[None], **self.equations.watch.start(velocity, first[n : 2 * n]),
            # An infinite mark is not finite, so the first reading becomes the mark.
            "timing": TIMING_PRIOR * self.period**2, "timed": TIMING_INFORMATION,
            "moved": np.inf, "mark": np.inf, "drive": sent[1][None],
        }  # fmt: skip
        if self.equations.own is not None:
            first_values["own"] = self.equations.own.first
        self.stored[:] = self.equations.memory.filled(self.lanes, **first_values)
        self._sent[:] = sent

    def spread(self, values: Array) -> Array:
        """Return the runs' values for all lanes, (…, lanes).

        The last run's values fill the rest.

        Args:
            values: values (…, runs) or (…, 1).
        """
        count = values.shape[-1]
        return values if count == self.lanes else np.concatenate(
            [values, np.repeat(values[..., -1:], self.lanes - count, axis=-1)], axis=-1
        )  # fmt: skip

    def take(self, positions: Array, present: Present, switch: Any, rate_error: Array | None, age: Any = None) -> None:
        """Write a reading into the inputs of the next tick.

        Args:
            positions: positions (n+1, 1) or (n+1, lanes), rad and m.
            present: True for each new position (n+1,) or (n+1, lanes), None if all are new.
            switch: limit switch, see `Reading.switch`.
            rate_error: error (n, 1) or (n, lanes) of the rates that the law receives, rad/s; None to keep the last.
            age: age of the reading, s, None if unknown.
        """
        inputs = self.reading
        # A missing position can have any value.
        inputs.measured[:], inputs.switch[:], inputs.age[:] = positions, switch, 0.0 if age is None else age
        inputs.present[:] = 1.0 if present is None else present if present.ndim > 1 else present[:, None]
        if rate_error is not None:
            inputs.rate_error[:] = rate_error

    def tick(self) -> None:
        """Compute a whole tick from the reading and from the gains and the reference in `row`; store its memory."""
        self.whole_tick(self._inputs, self._out)
        self.stored[:] = self._kept

    @cached_property
    def whole_tick(self) -> Any:
        """Machine code of `TickEquations.function`."""
        return self._call("tick")

    def prepare(self, names: Sequence[str]) -> None:
        """Compile these functions now, so that no tick of a run waits for the compiler.

        Args:
            names: names of functions, see `machine`.
        """
        for name in names:
            self._call(name)

    def resume(self, inputs: Array, told: Array, kept: Array) -> None:
        """Continue from the result of a tick that was computed elsewhere, as in a block of many ticks.

        Args:
            inputs: inputs of the tick (…, lanes), in the order of `TickEquations.function`.
            told: its report (…, lanes).
            kept: its memory (…, lanes).
        """
        self._inputs[: -len(kept)] = inputs[: len(self._inputs) - len(kept)]
        self._out[len(kept) :], self.stored[:] = told, kept

    @property
    def constants(self) -> Array:
        """Constants of a run, (size,); see `TickEquations.numbers`."""
        return self._constants[:, 0].copy()

    def bound(self, **bounds: float) -> None:
        """Change some of the constants in `Numbers`, for example at the start of another law.

        Args:
            **bounds: new values by name.
        """
        for name, value in bounds.items():
            getattr(self.numbers, name)[:] = value

    # Split, for laws with internal timing and for delays too long to unroll.

    def sense(self) -> Array:
        """Return the estimate, the first part of a split tick, (size, lanes) in the layout `TickEquations.sensed`.

        The filter's memory is unchanged until `finish`.
        """
        inputs = np.concatenate([self.stored, *self.reading, self._constants])
        return self._call("sense")(inputs, np.empty((self.equations.sensed.size, self.lanes)))

    def pending_commands(self) -> list[Array]:
        """Return the commands (lanes,) of each of the next `lead` periods, m/s²."""
        return pending_commands(self._sent, self.numbers.share[0], whole=self._delay[0], lead=self.lead)

    @property
    def drive(self) -> Array:
        """The carts' accelerations (lanes,) for lagging drives, m/s².

        They are those at the start of the coming period.
        """
        return self.memory.drive[0] if self.equations.lags else np.zeros(self.lanes)

    def look_ahead(self, z: Array) -> tuple[Array, Array]:
        """Return the states (N, lanes) at which commands of this tick act, by prediction over the pending commands.

        The carts' accelerations (lanes,) at that time, m/s², follow (`drive`).

        Args:
            z: estimates (N+E, lanes).
        """
        drive = self.drive
        for command in self.pending_commands():
            z, drive = self.moved(z, drive, command)
        return self.with_rate_error(z[: self.model.dimension]), drive

    def pending_accelerations(self) -> tuple[list[Array], Array]:
        """Return the carts' mean accelerations (lanes,) in each of the next `lead` periods by pending commands, m/s².

        `drive` (lanes,) at the end of these periods follows. An estimator without the compiled filter predicts with
        them.
        """
        means, drive, model = [], self.drive, self.model
        for command in self.pending_commands():
            means.append(command + model.lag / self.period * (1 - model.lag_keeps) * (drive - command))
            drive = command + model.lag_keeps * (drive - command)
        return means, drive

    def with_rate_error(self, states: Array) -> Array:
        """Return states (N, lanes) as the law receives them, with the simulated error of measured rates.

        Args:
            states: states (N, lanes).
        """
        received = states.copy()
        received[self.model.arms : 2 * self.model.arms] += self.reading.rate_error
        return received

    def moved(self, z: Array, drive: Array, command: Array) -> tuple[Array, Array]:
        """Return the estimates and the carts' accelerations a period later, one step of `look_ahead`.

        Args:
            z: states and extras (N+E, lanes).
            drive: accelerations (lanes,) of the carts, m/s².
            command: commands (lanes,) that act in the period, m/s².

        Returns:
            States and extras (N+E, lanes), and accelerations (lanes,) of the carts, m/s².
        """
        inputs = np.concatenate([z, drive[None], command[None], self._constants])
        result = self._call("moved")(inputs, np.empty((len(z) + 1, self.lanes)))
        return result[:-1], result[-1]

    def finish(self, sensed: Array, ahead: Array, drive: Array, back: Array | float, *, predicts: bool = True) -> None:
        """Compute the rest of a split tick after estimate and law, and store its memory.

        The gains and the reference of the tick are those in `row`.

        Args:
            sensed: estimate (size, lanes): output of `sense`, or another estimator's in the same layout.
            ahead: states (N, lanes) for which commands are computed.
            drive: accelerations (lanes,) of the carts then, m/s².
            back: feedback in addition to the row's, a number or (lanes,), m/s².
            predicts: True to predict the filter's next state, default; False if another estimator replaces the filter.
        """
        parts = [self._inputs, sensed, ahead, drive[None], np.broadcast_to(back, (1, self.lanes))]
        if not self.equations.unrolled:
            parts.append(self.pending_commands()[0][None])
        self._call("finish" if predicts else "judge")(np.concatenate(parts), self._out)
        self.stored[:] = self._kept
        if not self.equations.unrolled:
            self._sent[:-1] = self._sent[1:]
            self._sent[-1] = self.report.command
