"""Which sensor is stuck: it repeats one reading while the arm must have moved on, or the cart was sent elsewhere.

For joint i, whose reading has been the same since tick s, and the cart, whose has since s':

    max |ref_i(k) - ref_i(s)| ≥ max(0.02 rad, 4 counts),        |Σ w Δt| ≥ max(2 mm, 4 counts)

w: the velocity that the cart was sent to. A count is the smallest step that was seen. An arm that turns back, or is
held at rest, stays within a count as well, but so does its reference. Without this a filter follows a stuck encoder for
a tenth of a second, and a stuck scale of the cart for ever, the cart being unobservable from the arms.
"""

import math
from collections.abc import Sequence

_STILL = 0.015
"""Seconds of one reading of a joint at least."""
_TURNING = 10.0
"""rad/s² and m/s²: what turns back as slowly stays within a count q for 2 √(2 q / this), 11 ms with 40,000 counts."""
_CART_STILL = 0.05
"""Seconds of one reading of the cart: it begins to move only once the first commands have come to act."""
_JOINT_MOVED, _CART_MOVED = 0.02, 2e-3
"""rad and m."""
_COUNTS = 4.0
_DOUBT = 300.0
"""Mean NIS per position: with 256 counts, stuck encoders gave 450 and more when they were found, slow arms up to 270.
The cart's scale is told without it: nothing but its own commands contradicts it."""
_UNSEEN = 0.2
"""rad: taken for a count while a sensor has not moved at all."""
SAME = 1e-9
"""rad and m: readings this near to each other are the same count."""


class StuckWatch:
    """Watches the sensors of one run of `arms` arms, `period` s from tick to tick; reaction s: until a command acts."""

    def __init__(self, arms: int, *, period: float, reaction: float = 0.0) -> None:
        self._arms, self._period = arms, period
        # Bounds, sensor by sensor: ticks, rad or m, mean NIS per position.
        self.still = [_STILL / period] * arms + [(_CART_STILL + reaction) / period]
        self.least = [_JOINT_MOVED] * arms + [_CART_MOVED]
        self.doubt = [_DOUBT] * arms + [0.0]
        self._last = [math.nan] * (arms + 1)
        self._steps = [math.inf] * (arms + 1)
        self._same = [0] * (arms + 1)
        self._begin = [0.0] * (arms + 1)
        self._moved = [0.0] * (arms + 1)
        self._sent = 0.0

    def seen(self, positions: Sequence[float], wanted: Sequence[float], sent: float, nis: float) -> str:
        """Return which sensor is stuck, or "".

        positions (n+1,): absolute angles and the cart's position, all new; wanted: the reference's angles first; sent
        m/s: the velocity that the cart was sent to; nis: its mean of late, for each position.
        """
        n, inner, inner_wanted = self._arms, 0.0, 0.0
        last, same, begin = self._last, self._same, self._begin
        self._sent += sent * self._period
        for i, position in enumerate(positions):
            if i < n:
                due = wanted[i]
                value, should = position - inner, due - inner_wanted
                inner, inner_wanted = position, due
            else:
                value, should = position, self._sent
            step = abs(value - last[i])
            if not step < SAME:
                last[i], begin[i] = value, should
                if same[i]:
                    same[i], self._moved[i] = 0, 0.0
                if step < self._steps[i]:
                    self._steps[i] = step
                continue
            same[i] += 1
            moved = self._moved[i] = max(self._moved[i], abs(should - begin[i]))
            if same[i] >= self.still[i] and moved >= self.least[i] and not nis <= self.doubt[i]:
                told = self.told(i, same=same[i], moved=moved, step=self._steps[i])
                if told:
                    return told
        return ""

    def told(self, i: int, *, same: int, moved: float, step: float) -> str:
        """Return that sensor i is stuck, or "" where it may as well turn back.

        same: ticks with one reading; moved: by how much it should have changed meanwhile; step: the smallest seen.
        """
        count = step if step < math.inf else _UNSEEN / _COUNTS
        turning = 2 * math.sqrt(2 * count / _TURNING) / self._period
        if not (moved >= _COUNTS * count and same >= turning):
            return ""
        name = "the cart's scale" if i == self._arms else f"the encoder of joint {i + 1}"
        return f"{name} is stuck: it has given the same reading for {same * self._period:.3g} s"
