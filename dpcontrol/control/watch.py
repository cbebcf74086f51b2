"""Watch of the sensors and the drive: is a reading constant while its joint or the cart must have moved?

For joint i with a constant reading since tick s:

    max |ref_i(k) - ref_i(s)| ≥ max(0.02 rad, 4 counts)

A count is the smallest observed step. An arm that reverses, or rests, stays within a count, but so does its reference.
An arm off its reference can pause alone. So there is a second condition: the filter must have corrected the model by
0.05 rad and 8 counts since then. Alternatively, the pause must be much longer than that of a reversal. Without these
checks, a filter follows a stuck encoder for a tenth of a second. It follows a stuck scale of the cart without end,
because the cart is unobservable from the arms.

The reading of a working scale can stay constant while the cart moves within a count q. So the hypothesis that the scale
works is tested against the commands. A Kalman filter uses the scale only. Its states are the cart's position p and
velocity v, and the response g and lag τ of the drive to the commanded acceleration a:

    ṗ = v - τ a,    v̇ = g a + noise on the command

Every 15 ms it compares its prediction with the reading. A changed reading corrects all states. A constant reading
allows the prediction to differ by up to q. If it differs by q + e, noise must have moved the cart back. With the
variance s of the prediction, e²/s is evidence against the scale:

    J ← max(0, J + e²/(s λ) - 1/2),    J ← 0 at each step of the reading

A scale is stuck if J ≥ 30 and its reading has been constant for 45 ms. The noise is that of the settings, but at least
0.3 m/s² on each command. λ ≥ 1 grows with surprising steps, as after a blow. q is the resolution of the settings, or
the smallest observed step if that is larger. The filter learns the response and the lag of the drive from the steps,
so working scales of 0.2 mm reach J = 11 at most. A cart that moves by noise alone gives no evidence.

Do the scale's readings follow the commands? See `dpcontrol.control.drive`.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from dpcontrol.control.drive import CartReading, DriveWatch
from dpcontrol.control.ekf import pack, packed, unpack
from dpcontrol.control.tick_parts import BIG, Known, Memory, Numbers, Outcome, all_of, any_of, finite
from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.arrays import Array

SAME = 1e-9
"""Difference of readings below which they are the same count, rad and m."""
_STILL = 0.015
"""Shortest constant reading of a joint, s."""
_TURNING = 4.0
"""Slow reversal, rad/s² and m/s²: it stays within a count q for 2 √(2 q / this), 18 ms with 40,000 counts."""
_CART_STILL = 0.045
"""Shortest constant reading of the cart, s."""
_IDLE_RESPONSE, _IDLE_SIGMAS = 0.5, 3.0
"""Largest response of a drive whose cart has not moved since the start, and standard deviations below it."""
_JOINT_MOVED = 0.02
"""rad."""
_SCALE_CHECK = 0.015
"""Time between comparisons of the scale with its prediction, s."""
_SCALE_STUCK, _SCALE_OFFSET = 30.0, 0.5
"""Evidence that a scale is stuck, and its decrease at each comparison.

The evidence is about twice the logarithm of a likelihood ratio, so noise reaches the bound once in 10⁶ trials.
"""
_COMMAND_NOISE = 0.3
"""Least noise on each command, that of a usual drive, m/s²."""
_SCALE_ERROR = 1e-5
"""Standard deviation of a cart's distance from its drive, m."""
_COARSEST = 0.2, 0.02
"""Largest count of an encoder and of the cart's scale, rad and m. A larger change of a reading is no count."""
_SCALE_UNSEEN = 2e-4
"""Assumed count of the cart's scale before its first step, m."""
_RESPONSE, _RESPONSE_DRIFT = 0.25, 0.02
"""Standard deviation of the response of the drive, relative, and its drift, 1/√s."""
_LAG, _LAG_DRIFT = 0.01, 0.002
"""Standard deviation of the lag of the drive, s, and its drift, s/√s."""
_SURPRISE, _SURPRISE_MEMORY = 0.3, 1.0
"""Share of a step's squared relative error that becomes the factor of the variance, and the time constant of its decay,
s."""
_COUNTS = 4.0
_JOINT_HELD, _COUNTS_HELD = 0.05, 8.0
"""Motion of a joint's model during a constant reading, rad and counts. A joint that reverses while its reference
continues also stops, but so does its model."""
_LONG = 8.0
"""Multiple of the longest pause at a reversal, beyond which no other evidence is needed."""
_DOUBT = 30.0
"""Mean NIS per position of a stuck encoder: at least 50 with the default filter, but about 1 for working sensors.

Model errors raise it as well, so it is never the only evidence. For the cart's scale it is not used: only commands
contradict a stuck scale.
"""
_LIMITED = 0.9
"""Share of the drive's velocity limit from which the limit changes commands."""
_UNSEEN = 0.2
"""Assumed count of a sensor before its first motion, rad."""


@dataclass(frozen=True, eq=False)
class SensorWatch:
    """Expressions of the watch for one model.

    Attributes:
        equations: the model's equations.
        arms: number n of arms.
        period: time between ticks, s.
        same: differences of readings of a joint and of the cart that are the same count, rad and m.
        measured: True for each measured position (n+1,).
    """

    equations: Equations
    arms: int
    period: float
    same: tuple[float, float]
    measured: tuple[bool, ...]

    @cached_property
    def joints(self) -> tuple[int, ...]:
        """Joints between two measured arms, by number, and the inner joint if its arm is measured."""
        return tuple(i for i in range(self.arms) if all(self.measured[max(i - 1, 0) : i + 1]))

    @cached_property
    def drive(self) -> DriveWatch:
        """Watch of the drive, by the arms inside the first one that is not measured."""
        return DriveWatch(self.arms, self.period, (*self.measured[: self.arms], False).index(False))

    def _fresh(self, known: Known) -> ca.SX:
        """Return 1 if all positions that have a sensor were read in this tick; the watch ignores other ticks."""
        return all_of(*(known.reading.present[i] for i, measured in enumerate(self.measured) if measured))

    def start(self, velocity: float, rates: Array) -> dict[str, Any]:
        """Return the parts of the memory that are not zero at the start of a run.

        Args:
            velocity: velocity of the cart, m/s.
            rates: rates (n,) of the arms, rad/s.
        """
        sigmas = [_SCALE_ERROR, _COMMAND_NOISE * _SCALE_CHECK, _RESPONSE, _LAG]
        return {
            "last": np.inf,
            "step": np.inf,
            "scale_level": 1.0,
            "scale": np.array([0.0, velocity, 1.0, 0.0]),
            "scale_covariance": packed(np.diag(sigmas) ** 2),
            "drive_watch": self.drive.start(velocity, rates),
        }

    def stuck(self, known: Known, nis: ca.SX, taken: ca.SX | None) -> tuple[ca.SX, Memory]:
        """Return the number of the first stuck sensor, from 1, or 0 without one, and the memory after the reading.

        A joint's sensor is stuck if its reading is constant although the reference moved, and if the filter contradicts
        it. In addition, the filter had to correct the joint's model, or the pause is too long for a reversal.

        Args:
            known: parts of the tick's inputs.
            nis: mean NIS per position.
            taken: changes (2n,) of predicted angles and rates by the filter's update, rad and rad/s; None if another
                estimator replaces the filter.
        """
        n, period, wanted = self.arms, self.period, known.row.wanted
        m, r, c = known.memory, known.reading, known.numbers
        fresh = self._fresh(known)
        after: dict[str, list[ca.SX]] = {
            name: [] for name in ("last", "step", "same", "begin", "away", "pulled", "strained", "held_back")
        }
        stuck_flags: list[ca.SX] = []
        for i in range(n + 1):
            arm = i < n
            if arm and i not in self.joints:
                stuck_flags.append(ca.SX(0))
                for name, values_of in after.items():
                    values_of.append(getattr(m, name)[i])
                continue
            inner = r.measured[i - 1] if arm and i else 0
            value = r.measured[i] - inner
            step = ca.fabs(value - m.last[i])
            same = step < self.same[0 if arm else 1]
            jumped = step > _COARSEST[0 if arm else 1]
            smallest = ca.if_else(ca.logic_or(same, jumped), m.step[i], ca.fmin(m.step[i], step))
            count = ca.if_else(same, m.same[i] + 1, 0)
            # A reading within a count's rounding of the last one does not replace it.
            values = {"last": ca.if_else(same, m.last[i], value), "step": smallest, "same": count}
            if not arm:
                frozen, scale = self._frozen_scale(m, c, value, count, smallest)
                after |= {name: [ca.if_else(fresh, new_value, getattr(m, name))] for name, new_value in scale.items()}
                stuck_flags.append(ca.logic_and(fresh, frozen))
            else:
                expected = wanted[i] - (wanted[i - 1] if i else 0)
                begin = ca.if_else(same, m.begin[i], expected)
                away = ca.if_else(same, ca.fmax(m.away[i], ca.fabs(expected - begin)), 0)
                count_size = ca.if_else(smallest <= BIG, smallest, _UNSEEN / _COUNTS)
                longest = ca.fmax(2 * ca.sqrt(2 * count_size / _TURNING), _STILL) / period
                pulled, strained, held_back = m.pulled[i], m.strained[i], m.held_back[i]
                evidence = count >= _LONG * longest
                if taken is not None:
                    turned, braked = (taken[k] - (taken[k - 1] if i else 0) for k in (i, n + i))
                    counts = ca.logic_and(same, ca.logic_not(m.restart))
                    pulled, strained = (
                        ca.if_else(counts, pulled + braked, 0),
                        ca.if_else(counts, strained + ca.fabs(braked), 0),
                    )
                    held_back = ca.if_else(counts, held_back + pulled * period + turned, 0)
                    # An oscillating filter gives no evidence.
                    steady = ca.fabs(pulled) >= strained / 2
                    large = ca.fabs(held_back) >= ca.fmax(_JOINT_HELD, _COUNTS_HELD * count_size)
                    evidence = any_of(evidence, ca.logic_and(steady, large))
                values |= {"begin": begin, "away": away, "pulled": pulled, "strained": strained, "held_back": held_back}
                moved = [away >= _JOINT_MOVED, away >= _COUNTS * count_size, count >= longest]
                stuck_flags.append(all_of(fresh, *moved, ca.logic_not(nis <= _DOUBT), evidence))
            for name, new_value in values.items():
                after[name].append(ca.if_else(fresh, new_value, getattr(m, name)[i]))
        sensor = ca.SX(0)
        for i in reversed(range(n + 1)):
            sensor = ca.if_else(stuck_flags[i], i + 1, sensor)
        return sensor, m._replace(**{name: ca.vertcat(*values) for name, values in after.items()})

    def _frozen_scale(
        self, m: Memory, c: Numbers, value: ca.SX, count: ca.SX, smallest: ca.SX
    ) -> tuple[ca.SX, dict[str, ca.SX]]:
        """Return 1 if the cart's scale has frozen, and the changed parts of the memory.

        They are the filter of scale and commands in the module's text. It runs beside the tick's filter, which a stuck
        scale misleads.

        `m`, `c`: memory and constants of the tick. `value` m: the reading. `count`: number of equal readings before it.
        `smallest` m: smallest step so far.
        """
        period = self.period
        first = ca.logic_not(finite(m.last[self.arms]))
        waited = ca.if_else(first, 0, m.scale_waited + 1)
        due = waited * period >= _SCALE_CHECK - period / 2
        constant = count >= waited
        count_size = ca.fmax(ca.if_else(smallest <= BIG, smallest, _SCALE_UNSEEN), c.scale)
        rounding = count_size**2 / 12 + _SCALE_ERROR**2
        state, covariance = m.scale[:, :], unpack(m.scale_covariance, m.scale.shape[0])
        state[0] = ca.if_else(first, 0, state[0])
        innovation = value - m.scale_read - state[0]
        excess = ca.fmax(ca.fabs(innovation) - count_size, 0)
        surprise = excess**2 / (covariance[0, 0] + rounding)
        # A constant reading does not move the prediction within a count.
        correction = ca.if_else(constant, ca.if_else(innovation < 0, -excess, excess), innovation)
        noise = rounding + ca.if_else(ca.logic_and(constant, excess <= 0), count_size**2, 0)
        gain = covariance[:, 0] / (covariance[0, 0] + noise)
        corrected = state + gain * correction
        # The position is that since the last comparison.
        corrected[0] -= value - m.scale_read
        level = ca.fmax(m.scale_level * (1 - _SCALE_CHECK / _SURPRISE_MEMORY), _SURPRISE * m.scale_surprise)
        # A step of the reading proves a working scale, so the evidence begins again.
        evidence = ca.if_else(count > 0, m.evidence, 0)
        grown = ca.fmax(evidence + surprise / m.scale_level - _SCALE_OFFSET, 0)
        evidence = ca.if_else(ca.logic_and(due, constant), grown, evidence)
        stepped, restarts = ca.logic_and(due, ca.logic_not(constant)), ca.logic_or(first, due)
        changes = {
            "scale": ca.vertcat(*(ca.if_else(due, corrected[i], state[i]) for i in range(state.shape[0]))),
            "scale_covariance": ca.if_else(due, pack(covariance - gain @ covariance[0, :]), m.scale_covariance),
            "scale_read": ca.if_else(restarts, value, m.scale_read),
            "scale_waited": ca.if_else(due, 0, waited),
            # The reading may stop between two comparisons, so a surprise counts from the next step.
            "scale_level": ca.if_else(stepped, ca.fmax(level, 1), m.scale_level),
            "scale_surprise": ca.if_else(stepped, surprise, m.scale_surprise),
            "evidence": evidence,
        }
        # The filter also explains a constant reading by a drive without response.
        idle = state[2] + _IDLE_SIGMAS * ca.sqrt(covariance[2, 2]) <= _IDLE_RESPONSE
        contradicts = ca.logic_or(evidence >= _SCALE_STUCK, ca.logic_and(idle, ca.logic_not(smallest <= BIG)))
        return ca.logic_and(contradicts, count * period >= _CART_STILL - period / 2), changes

    def unfollowed(self, known: Known, stuck: tuple[ca.SX, Memory]) -> tuple[ca.SX, ca.SX, Memory]:
        """Return the outcome of a drive that the cart does not follow, or 0, and the corrected results of `stuck`.

        The latter are the number of the stuck sensor, or 0, and the memory with that of the drive's watch.

        The cause is a stuck scale, not the drive, if the arms move by the commands.

        Args:
            known: parts of the tick's inputs.
            stuck: results of `stuck`.
        """
        tick_memory, constants, n, (sensor, watch), period = known.memory, known.numbers, self.arms, stuck, self.period
        velocity, step = known.sensed.z[2 * n + 1], watch.step[n]
        velocity = ca.if_else(finite(velocity), velocity, 0)
        moved = [ca.if_else(finite(tick_memory.last[i]), watch.last[i] - tick_memory.last[i], 0) for i in range(n + 1)]
        moved = ca.vertcat(ca.DM(np.tril(np.ones((n, n)))) @ ca.vertcat(*moved[:n]), moved[n])
        count = ca.fmax(ca.if_else(step <= BIG, step, 0), constants.scale)
        # The accelerations of a drive near its greatest velocity are not known.
        limited = ca.fabs(velocity) >= _LIMITED * constants.velocity
        variance = ca.if_else(limited, BIG, constants.noise[-1] + known.sensed.timing * velocity**2)
        visible = self.drive.visible(count, variance, ca.fmax(constants.drive_noise, _COMMAND_NOISE))
        cart = CartReading(self._fresh(known), watch.same[n] > 0, moved, known.reading.age * velocity, visible)
        memory = self.drive.update(tick_memory.drive_watch, cart)
        drive_watch = self.drive.memory.of(memory)
        unfollowed = drive_watch.lasts >= self.drive.longest - period / 2
        # Arms that move by the commands contradict a constant reading of the scale, not the drive.
        constant = watch.same[n] * period >= drive_watch.lasts - period / 2
        scale_stuck = all_of(unfollowed, constant, drive_watch.doubt > 0)
        drive_fails = any_of(
            all_of(unfollowed, ca.logic_not(scale_stuck)), all_of(ca.eq(sensor, n + 1), drive_watch.doubt < 0)
        )
        outcome = ca.if_else(drive_watch.against < 0, int(Outcome.DRIVE_REVERSED), int(Outcome.DRIVE_OFF))
        sensor = ca.if_else(drive_fails, 0, ca.if_else(scale_stuck, n + 1, sensor))
        return ca.if_else(drive_fails, outcome, 0), sensor, watch._replace(drive_watch=memory)

    def expected_cart(self, watch: Memory, c: Numbers, acting: ca.SX) -> Memory:
        """Return the memory with the filter of scale and commands predicted over a period (see `_frozen_scale`).

        Args:
            watch: memory after the reading.
            c: constants of the run.
            acting: acceleration in the period, m/s².
        """
        period, state = self.period, watch.scale
        covariance = unpack(watch.scale_covariance, state.shape[0])
        transition = ca.SX.eye(state.shape[0])
        transition[0, 1:] = ca.horzcat(period, acting * period**2 / 2, -acting * period)
        transition[1, 2] = acting * period
        noise = ca.SX(*transition.shape)
        command_variance = ca.fmax(c.drive_noise, _COMMAND_NOISE) ** 2 * period
        noise[0, 0], noise[1, 1] = command_variance * period**3 / 3, command_variance * period
        noise[0, 1] = noise[1, 0] = command_variance * period**2 / 2
        # Without motion, the knowledge of the drive fades to that of the start.
        for i, (sigma, drift) in enumerate(((_RESPONSE, _RESPONSE_DRIFT), (_LAG, _LAG_DRIFT)), start=2):
            noise[i, i] = ca.if_else(covariance[i, i] < sigma**2, drift**2 * period, 0)
        return watch._replace(
            scale=transition @ state, scale_covariance=pack(transition @ covariance @ transition.T + noise)
        )

    def expected_arms(self, known: Known, watch: ca.SX, acting: ca.SX) -> ca.SX:
        """Return the memory of the drive's watch a period later, from the modelled motion of the arms.

        Estimated parameters and errors of the drive adapt to a stuck scale, so they are not used.

        Args:
            known: parts of the tick's inputs.
            watch: memory of the drive's watch.
            acting: acceleration in the period, m/s².
        """
        n, rate, size = self.arms, self.equations.function(), self.equations.dimension
        state = ca.vertcat(*(ca.if_else(finite(value), value, 0) for value in ca.vertsplit(known.sensed.z[:size])))
        arm_accelerations, without_command = (
            rate(state, acceleration, known.numbers.parameters)[n : 2 * n] for acceleration in (acting, 0)
        )
        return self.drive.predict(watch, acting, arm_accelerations, arm_accelerations - without_command)
