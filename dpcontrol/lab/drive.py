"""The cart's drive: how long a command takes, what becomes of it, and where the track ends.

    demanded = clip(response · command + noise),   |demanded| ≤ a_max,   |demanded - last| ≤ jerk · period
    acting:   |w + u Δt| ≤ v_max,   w = v + lag · a         (w: velocity reference of the drive's loop)

A command given at tick k acts from (k + delay) periods on, for one period.

Source: the rig's data sheets as read for its parameters: commanded in velocity, 3 m/s, limit switches at both ends.
"""

import math
from dataclasses import dataclass

from dpcontrol.foundation.errors import InputError
from dpcontrol.references.problem import Limits


@dataclass(frozen=True)
class DriveSettings:
    """The drive and its cart; what is random is drawn beforehand, see `dpcontrol.lab.draw`.

    delay: from reading to acting, in periods, also fractions. lag s: time constant of the velocity loop. cart_mass
    kg (zero: the arms do not move the cart) and cart_viscous N s/m. velocity m/s, acceleration m/s²: what it can do,
    inf: as the scene's limits; jerk m/s³. command_noise m/s²: standard deviation, Gaussian, new each period.
    response: share of a command that the drive gives. track m: hard stops stand at ± this, inf: at the scene's limit
    of position. switch_margin m: so far before them the limit switches are touched.
    """

    delay: float = 1.0
    lag: float = 0.0
    cart_mass: float = 0.0
    cart_viscous: float = 0.0
    velocity: float = math.inf
    acceleration: float = math.inf
    jerk: float = math.inf
    command_noise: float = 0.0
    response: float = 1.0
    track: float = math.inf
    switch_margin: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no drive; lag, mass and friction are checked with the plant's parameters.

        Raises:
            InputError: names the setting, its value and what is allowed.
        """
        bounds = {"delay": (1000.0, " periods"), "command_noise": (1e6, " m/s²"), "response": (10.0, ""),
                  "switch_margin": (1e3, " m")}  # fmt: skip
        for name, (most, unit) in bounds.items():
            value = getattr(self, name)
            if not 0 <= value <= most:
                raise InputError(f"drive: {name} = {value!r}: must be 0 to {most:g}{unit}")
        for name in ("velocity", "acceleration", "jerk", "track"):
            if not getattr(self, name) > 0:
                raise InputError(
                    f"drive: {name} = {getattr(self, name)!r}: must be positive, or inf for none of its own"
                )

    def limits(self, limits: Limits) -> Limits:
        """Return what the drive can do: its own bounds where it has them, else those of the scene."""
        return Limits(
            position=self.track if math.isfinite(self.track) else limits.position,
            velocity=self.velocity if math.isfinite(self.velocity) else limits.velocity,
            acceleration=self.acceleration if math.isfinite(self.acceleration) else limits.acceleration,
            jerk=self.jerk if math.isfinite(self.jerk) else 0.0,
        )

    def within(self, limits: Limits, period: float) -> "DriveLimits":
        """Return what it does with demands, `period` s apart, under the scene's limits."""
        own = self.limits(limits)
        step = self.jerk * period if math.isfinite(self.jerk) else math.inf
        return DriveLimits(float(own.acceleration), float(own.velocity), step, self.response)


@dataclass(frozen=True)
class DriveLimits:
    """What the drive does with a demand within its bounds; all numbers are plain floats.

    acceleration m/s², velocity m/s, jerk_step m/s² per period (inf for none), response.
    """

    acceleration: float
    velocity: float
    jerk_step: float
    response: float

    def demanded(self, command: float, noise: float, last: float) -> float:
        """Return what becomes of `command` on its way, `last` having been demanded before it."""
        wanted = self.response * command + noise
        most = self.acceleration
        wanted = most if wanted > most else -most if wanted < -most else wanted
        low, high = last - self.jerk_step, last + self.jerk_step
        return high if wanted > high else low if wanted < low else wanted

    def acting(self, demanded: float, velocity: float, duration: float) -> float:
        """Return what acts for `duration` s, so that the loop's velocity reference, now `velocity`, stays in bounds.

        One that a knock has thrown out of them comes back as fast as the drive can.
        """
        low, high = (-self.velocity - velocity) / duration, (self.velocity - velocity) / duration
        wanted, most = high if demanded > high else low if demanded < low else demanded, self.acceleration
        return wanted if -most <= wanted <= most else math.copysign(most, wanted)

    def braking(self, velocity: float, duration: float) -> float:
        """Return the acceleration that brings `velocity` to zero, as fast as the drive can."""
        return min(max(-velocity / duration, -self.acceleration), self.acceleration)
