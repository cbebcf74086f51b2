"""Watch of the drive: does the cart follow the commands?

Two observers of a cart at constant velocity, with the double pole e^(-Δt/T), see one the scale and one the commands.
The error of the first is y, that of the second c, or c' for a drive with 20 ms more lag. All are high-pass filtered
positions, so y = c for a perfect drive, and y = g c for one with the response g. A drive that is late by up to 20 ms
gives a y between c and c'. With b = min(|c|, |c'|) where both have the same sign, else 0, the cart does not follow if

    y sign(c) < 0.25 b   and   b ≥ 2 counts + 6 standard deviations + 1 m/s² T²

for 3.5 T in all, which is 28 ms with T = 8 ms, without following in between. A blow on the cart gives the same until
its effect on y has faded, so b - y sign(c) must also be at least 0.6 of its recent maximum. The cart moves against the
commands if Σ (4 y sign(c) + b) b < 0 over this time.

A stuck scale gives the same y, so the arms decide. Two observers of each arm see its encoder less the model's motion,
and the part of this motion that is due to the commands. Their errors are r and s, and r is 0 on a cart that follows,
but -s on one that stands. If Σ (r s + s²/2) < 0, the arms contradict the commands, and the drive is the cause.
"""

from collections import namedtuple
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from dpcontrol.control.ekf import Layout
from dpcontrol.foundation.arrays import Array

_TIME, _PERIODS, _LATER = 0.008, 1.5, 0.02
"""Time constant T of the observers, s and at least periods, and the additional lag of a working drive, s."""
_FOLLOWED, _LASTS = 0.25, 3.5
"""Response below which a cart does not follow, and the duration of this, in T."""
_STAYS, _FADES = 0.6, 3.0
"""Share of its maximum at which an error counts, and the time constant of this maximum, in T.

The error after a blow is t e^(-t/T), which falls to 0.6 of its maximum within 2.4 T, and then faster than the maximum.
"""
_COUNTS, _SIGMAS, _ACCELERATION = 2.0, 6.0, 1.0
"""Motion that must be visible: counts, standard deviations, m/s²."""


_Memory = namedtuple("_Memory", "read due late lagged arms driven peak lasts against doubt")
"""Parts of the watch's memory, see `DriveWatch.memory`."""


CartReading = namedtuple("CartReading", "fresh repeats moved ahead visible")
"""The cart in a tick.

fresh: 1 if it was measured. repeats: 1 if its reading is the last one. moved (n+1,): changes of the readings since the
last ones, rad and m. ahead m: the cart's motion during the reading's age. visible m: see `DriveWatch.visible`.
"""


@dataclass(frozen=True)
class DriveWatch:
    """Equations of the watch.

    Attributes:
        arms: number n of arms.
        period: time between ticks, s.
        seen: number of arms, from the inner one, that are all measured, None for all.
    """

    arms: int
    period: float
    seen: int | None = None

    @cached_property
    def memory(self) -> Layout[_Memory]:
        """Values stored from tick to tick, with the letters of the module's text.

        read, due, late (2): y, c and c', m, and their rates, m/s. lagged: acceleration with more lag, m/s².

        arms, driven (2n): r and s, rad, and their rates, rad/s.

        peak: recent maximum of b - y sign(c), m. lasts: time that the cart has not followed, s. against,
        doubt: sums over this time, m² and rad², negative if the cart moves against the commands, and if the arms
        contradict them.
        """
        arms = 2 * self.arms
        return Layout(_Memory(2, 2, 2, lagged=1, arms=arms, driven=arms, peak=1, lasts=1, against=1, doubt=1))

    @property
    def time(self) -> float:
        """Time constant T of the observers, s."""
        return max(_TIME, _PERIODS * self.period)

    @property
    def longest(self) -> float:
        """Time without following that proves a fault, s."""
        return _LASTS * self.time

    def visible(self, count: ca.SX, variance: ca.SX, noise: ca.SX) -> ca.SX:
        """Return the least motion b, m, that counts as evidence: noise and counts hide smaller ones.

        Args:
            count: size of a count of the scale, m.
            variance: variance of its readings, m².
            noise: standard deviation of the noise on each command, m/s².
        """
        variance = variance + noise**2 * self.period * self.time**3 / 4
        return _COUNTS * count + _SIGMAS * ca.sqrt(variance) + _ACCELERATION * self.time**2

    def start(self, velocity: float, rates: Array) -> Array:
        """Return the watch's memory (size,) at the start of a run.

        Args:
            velocity: velocity of the cart, m/s.
            rates: rates (n,) of the arms, rad/s.
        """
        return self.memory.filled(read=np.array([0.0, -velocity]), arms=np.append(0 * rates, -rates))

    def update(self, memory: ca.SX, cart: CartReading) -> ca.SX:
        """Return the watch's memory after a reading and before the next command.

        It updates the evidence that the cart does not follow (`lasts`, `against`, `doubt`), and corrects the observers.

        Args:
            memory: memory of the watch.
            cart: the cart's reading.
        """
        parts = self.memory.of(memory)._asdict()
        errors = {name: parts[name][: parts[name].shape[0] // 2] for name in _OBSERVERS}
        errors["read"] += cart.moved[self.arms]
        errors["arms"] += cart.moved[: self.arms]
        due, late, read = errors["due"], errors["late"], errors["read"] + cart.ahead
        # b of the module's text: motion that a working drive, even one that is late, must show.
        expected = ca.if_else(due * late > 0, ca.fmin(ca.fabs(due), ca.fabs(late)), 0)
        followed = ca.if_else(due > 0, read, -read)
        shortfall, visible = ca.fmax(expected - followed, 0), expected >= cart.visible
        peak = ca.fmax(shortfall, float(np.exp(-self.period / (_FADES * self.time))) * parts["peak"])
        follows = ca.logic_and(visible, followed >= _FOLLOWED * expected)
        astray = ca.logic_and(ca.logic_and(visible, ca.logic_not(follows)), shortfall >= _STAYS * peak)
        doubt = ca.dot((errors["arms"] + errors["driven"] / 2)[: self.seen], errors["driven"][: self.seen])
        changes = {"peak": peak} | {
            name: ca.if_else(condition, parts[name] + increase, ca.if_else(follows, 0, parts[name]))
            for name, increase, condition in (
                ("lasts", self.period, astray), ("against", (4 * followed + expected) * expected, astray),
                ("doubt", doubt, ca.logic_or(astray, ca.logic_and(cart.repeats, ca.logic_not(visible)))),
            )
        }  # fmt: skip
        decay = float(np.exp(-self.period / self.time))
        for name, error in (errors | {"read": read}).items():
            # The poles of the observers are both e^(-Δt/T).
            rate = parts[name][error.shape[0] :] - (1 - decay) ** 2 / self.period * error
            changes[name] = ca.vertcat(errors[name] - (1 - decay**2) * error, rate)
        # Without a reading, no observer is corrected.
        values = {name: ca.if_else(cart.fresh, value, parts[name]) for name, value in changes.items()}
        return self.memory.joined(_Memory(**parts | values))

    def predict(self, memory: ca.SX, acting: ca.SX, swing: ca.SX, driven: ca.SX) -> ca.SX:
        """Return the watch's memory at the next reading: the observers' errors are predicted over a period.

        Args:
            memory: memory before the command.
            acting: acceleration of the cart that the commands demand until then, m/s².
            swing: modelled accelerations (n,) of the arms until then, rad/s².
            driven: the part (n,) of these that is due to the commands, rad/s².
        """
        parts, period = self.memory.of(memory)._asdict(), self.period
        parts["lagged"] = acting + float(np.exp(-period / _LATER)) * (parts["lagged"] - acting)
        for name, acceleration in zip(_OBSERVERS, (ca.SX(0), acting, parts["lagged"], -swing, driven), strict=True):
            error, rate = ca.vertsplit(parts[name], parts[name].shape[0] // 2)
            parts[name] = ca.vertcat(error + rate * period + acceleration * period**2 / 2, rate + acceleration * period)
        return self.memory.joined(_Memory(**parts))


_OBSERVERS = ("read", "due", "late", "arms", "driven")
"""Parts of the memory that are errors of observers, with their rates."""
