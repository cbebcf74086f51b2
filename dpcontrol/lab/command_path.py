"""What the loop believes about its own commands: which are on their way, and which one acted.

A command computed at tick k acts from tick k + d to the next, d the delay in periods. With d = i + f, 0 ≤ f < 1, the
mean over the period from tick k is

    f c_{k-i-1} + (1 - f) c_{k-i}

and the command is computed for the state at tick k + round(d): up to half a period of wrong timing is left. At 1 kHz it
moves the motion in time and harms nothing; at 50 Hz it takes part of the margin for delays. The limits of acceleration
and velocity are the drive's own, applied before it is believed.
"""

import math
from collections import deque

from dpcontrol.foundation.errors import InputError
from dpcontrol.references.problem import Limits

AT_REST = 1e-12
"""m/s: slower than any cart."""
LONGEST_DELAY = 1000.0
"""Periods."""


class CommandPath:
    """The commands on their way, for a delay in periods and a loop's period in s.

    Raises:
        InputError: the delay is negative or absurd.
    """

    def __init__(self, limits: Limits, *, delay: float, period: float) -> None:
        if not 0 <= delay <= LONGEST_DELAY:
            raise InputError(f"run: delay = {delay!r}: must be 0 to {LONGEST_DELAY:g} periods")
        self.limits = limits
        self._most, self._fastest = float(limits.acceleration), float(limits.velocity)
        self.period = period
        self.lead = round(delay)
        """By how many ticks a command is computed ahead."""
        whole = math.floor(delay)
        self._share = delay - whole
        # Oldest first; the last is the newest sent. One more than the whole periods, for the blend.
        self._sent: deque[float] = deque([0.0] * (whole + 2), maxlen=whole + 2)
        self.velocity = 0.0
        """The cart's velocity in m/s once all that was sent has acted."""

    def clipped(self, command: float) -> float:
        """Return the command within the limit of acceleration, m/s²."""
        # Here and below in place of min and max, which cost more than the rest.
        most = self._most
        return most if command > most else -most if command < -most else command

    def start(self, commands: list[float], *, velocity: float) -> None:
        """Fill the path with the commands (m/s²) on their way when the run begins, the cart having `velocity` m/s."""
        self.velocity = velocity
        for command in commands:
            self.send(command)

    def braking(self, share: float) -> float:
        """Return the command in m/s² that brakes the cart to rest with a share of the greatest acceleration."""
        most = share * self.limits.acceleration
        return min(max(-self.velocity / self.period, -most), most)

    def send(self, command: float) -> None:
        """Take the command (m/s²) that has just been computed."""
        most, fastest = self._most, self._fastest
        clipped = most if command > most else -most if command < -most else command
        self._sent.append(clipped)
        velocity = self.velocity + clipped * self.period
        if velocity > fastest:
            velocity = fastest
        elif velocity < -fastest:
            velocity = -fastest
        # Braking to rest leaves what rounding leaves.
        self.velocity = velocity if velocity > AT_REST or velocity < -AT_REST else 0.0

    def acted(self, velocity: float) -> float:
        """Return what acted in the period that now ends, m/s², at the cart's believed `velocity` m/s at its start."""
        sent = self._sent
        mean = sent[1] if not self._share else self._share * sent[0] + (1 - self._share) * sent[1]
        fastest, period = self._fastest, self.period
        low, high = (-fastest - velocity) / period, (fastest - velocity) / period
        return high if mean > high else low if mean < low else mean

    def on_their_way(self) -> list[float]:
        """Return what will act in each of the `lead` periods from now on, m/s²."""
        sent = list(self._sent)
        # The next to act is one place newer than what acted last.
        if not self._share:
            return sent[2:]
        coming = []
        for k in range(1, self.lead + 1):
            newer = sent[min(k + 1, len(sent) - 1)]
            coming.append(self._share * sent[k] + (1 - self._share) * newer)
        return coming
