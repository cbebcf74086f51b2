"""What stands between the model and the world: sensors, drive, disturbances; and the plant that they make of the arms.

Relative encoders that count, a cart's scale, and what goes wrong with them; angles count from hanging, q: one count:

    joint_i = θ_i - θ_{i-1} + zero_i + noise,   s_i = q round(joint_i / q) - q missed_i,   θ̂_i = s_1 + … + s_i

The cart's drive; a command given at tick k acts from (k + delay) periods on, for one period:

    demanded = clip(response · command + noise),   |demanded| ≤ a_max,   |demanded - last| ≤ jerk · period
    acting:   |w + u Δt| ≤ v_max,   w = v + lag · a         (w: velocity reference of the drive's loop)

Pushes on the arms and knocks on the cart, which act in no time at a tick, right after its reading; a tilted track:

    push:  M(θ) Δω = impulse          knock:  Δẋ given, arms keep their momenta          tilt:  gravity (g sin, -g cos)

Source: the rig's data sheets as read for its parameters: 40,000 counts per turn, 1 µm on the cart; commanded in
velocity, 3 m/s, limit switches at both ends.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.dynamics.plant import PlantParameters
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import Settings, setting
from dpcontrol.references.problem import Limits

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SensorSettings(Settings, table="sensors"):
    """The sensors and their faults; what is random is drawn beforehand, see `dpcontrol.loop.draw`.

    counts: of a relative arm encoder per turn, 0 for no rounding; cart_resolution: of the cart's scale, m, 0 likewise.
    zero_error: rad, uniform ± on the zero of each arm's encoder, so that outer angles carry the sum. noise: standard
    deviation on each relative angle, rad; cart_noise: on the cart, m. missed_counts: per s that each encoder loses
    while its joint moves. dropout: share of ticks at which no sensor is read. stuck_at s: from when the sensor
    `stuck_sensor` (0, 1 … the arms, then the cart) repeats its value. jitter s: a reading is up to so old, uniform.
    rate_noise rad/s: standard deviation of what is added to estimated rates, as where rates are measured.
    """

    counts: int = setting(40_000, least=1, zero="no rounding")
    cart_resolution: float = setting(1e-6, least=1e-12, most=1, zero="no rounding", unit="m")
    zero_error: float = setting(0.0, least=0, most=np.pi, unit="rad")
    noise: float = setting(0.0, least=0, most=np.pi, unit="rad")
    cart_noise: float = setting(0.0, least=0, most=1, unit="m")
    missed_counts: float = setting(0.0, least=0, most=1e6, unit="1/s")
    dropout: float = setting(0.0, least=0, most=1)
    stuck_at: float = setting(math.inf, least=0, infinite="never", unit="s")
    stuck_sensor: int = setting(0, least=0)
    jitter: float = setting(0.0, least=0, most=1, unit="s")
    rate_noise: float = setting(0.0, least=0, most=1000, unit="rad/s")

    def __post_init__(self) -> None:
        """Check the bounds, and that an encoder which loses counts has some.

        Raises:
            InputError: names the setting, its value and what is allowed.
        """
        super().__post_init__()
        if self.missed_counts and not self.counts:
            raise InputError(
                f"sensors: missed_counts = {self.missed_counts!r} with counts = 0: an encoder that does not count "
                "misses none; give its counts"
            )

    @property
    def steps(self) -> tuple[float, float]:
        """The rounding steps of a relative angle, rad, and of the cart, m; zero for none."""
        return (2 * np.pi / self.counts if self.counts else 0.0), self.cart_resolution

    def covariance(self, arms: int) -> Array:
        """Return the covariance (n+1, n+1) of the measured positions: a count's q²/12 and the noise, summed.

        cov(angle_i, angle_j) = (min(i, j) + 1)(q²/12 + noise²). Zero where nothing is rounded nor noisy.
        """
        angle, cart = self.steps
        index = np.arange(arms)
        out = np.zeros((arms + 1, arms + 1))
        out[:arms, :arms] = (np.minimum.outer(index, index) + 1) * (angle**2 / 12 + self.noise**2)
        out[arms, arms] = cart**2 / 12 + self.cart_noise**2
        return out


class Encoders:
    """Relative encoders of `arms` joints and the cart's scale, during one run: they remember what went wrong.

    zeros (n,) rad: the encoders' zero errors.

    Raises:
        InputError: the sensor that sticks is none of these.
    """

    def __init__(self, arms: int, settings: SensorSettings, *, zeros: Array | None = None) -> None:
        if math.isfinite(settings.stuck_at) and settings.stuck_sensor > arms:
            raise InputError(
                f"sensors: stuck_sensor = {settings.stuck_sensor!r}: must be 0 to {arms}; {arms} is the cart's scale"
            )
        self.settings = settings
        self._arms = arms
        self._angle, self._cart = settings.steps
        self._zeros = [0.0] * arms if zeros is None else np.asarray(zeros, dtype=float).tolist()
        self._missed = [0] * arms
        self._stuck: float | None = None
        self._stuck_at = settings.stuck_at

    def measure(
        self,
        state: Sequence[float],
        time: float = 0.0,
        *,
        missed: NDArray[np.int64] | None = None,
        noise: Array | None = None,
    ) -> Array:
        """Return absolute angles and cart position (n+1,) as the sensors give them for `state` (2n+2,) at `time` s.

        missed (n,): counts that the encoders lose in this tick where their joints move; noise (n+1,): added to the
        relative angles, rad, and to the cart, m. A list of plain floats is the fastest state.
        """
        # A few plain floats take a third of the time of numpy's calls on so short arrays.
        step, arms = self._angle, self._arms
        lost, added = self._missed, None if noise is None else noise.tolist()
        if missed is not None:
            self._miss(state, missed.tolist())
        readings: list[float] = []
        inner = 0.0
        for k, zero in enumerate(self._zeros):
            outer = state[k]
            value = outer - inner + zero
            inner = outer
            if added is not None:
                value += added[k]
            readings.append(step * (round(value / step) - lost[k]) if step else value)
        cart = state[2 * arms] if added is None else state[2 * arms] + added[arms]
        readings.append(self._cart * round(cart / self._cart) if self._cart else cart)
        if time >= self._stuck_at:
            which = self.settings.stuck_sensor
            if self._stuck is None:
                self._stuck = readings[which]
            readings[which] = self._stuck
        for k in range(1, arms):
            readings[k] += readings[k - 1]
        return np.array(readings)

    def _miss(self, state: Sequence[float], missed: Sequence[int]) -> None:
        """Lose counts against the direction in which each joint moves; one at rest loses none."""
        inner = 0.0
        for k, lost in enumerate(missed):
            outer = state[self._arms + k]
            if lost and outer != inner:
                self._missed[k] += lost if outer > inner else -lost
            inner = outer


@dataclass(frozen=True)
class DriveSettings(Settings, table="drive"):
    """The drive and its cart; what is random is drawn beforehand, see `dpcontrol.loop.draw`.

    delay: from reading to acting, in periods, also fractions. lag s: time constant of the velocity loop. cart_mass
    kg (zero: the arms do not move the cart) and cart_viscous N s/m. velocity m/s, acceleration m/s²: what it can do,
    inf: as the scene's limits; jerk m/s³. command_noise m/s²: standard deviation, Gaussian, new each period.
    response: share of a command that the drive gives. track m: hard stops stand at ± this, inf: at the scene's limit
    of position. switch_margin m: so far before them the limit switches are touched.
    """

    delay: float = setting(1.0, least=0, most=1000, unit="periods")
    lag: float = setting(
        0.0,
        least=0,
        most=1,
        unit="s",
    )
    cart_mass: float = setting(0.0, least=0, most=1e6, unit="kg")
    cart_viscous: float = setting(0.0, least=0, most=1e6, unit="N s/m")
    velocity: float = setting(math.inf, above=0, infinite="none of its own", unit="m/s")
    acceleration: float = setting(math.inf, above=0, infinite="none of its own", unit="m/s²")
    jerk: float = setting(math.inf, above=0, infinite="none of its own", unit="m/s³")
    command_noise: float = setting(0.0, least=0, most=1e6, unit="m/s²")
    response: float = setting(1.0, least=0, most=10)
    track: float = setting(math.inf, above=0, infinite="none of its own", unit="m")
    switch_margin: float = setting(0.0, least=0, most=1000, unit="m")

    def limits(self, limits: Limits) -> Limits:
        """Return what the drive can do: its own bounds where it has them, else those of the scene."""
        return Limits(
            position=self.track if math.isfinite(self.track) else limits.position,
            velocity=self.velocity if math.isfinite(self.velocity) else limits.velocity,
            acceleration=self.acceleration if math.isfinite(self.acceleration) else limits.acceleration,
            jerk=self.jerk if math.isfinite(self.jerk) else 0.0,
        )

    def within(self, limits: Limits, period: float, *, clip: "Clip | None" = None) -> "DriveLimits":
        """Return what it does with demands, `period` s apart, under the scene's limits; clip: `clip_lanes` for many."""
        own = self.limits(limits)
        step = self.jerk * period if math.isfinite(self.jerk) else math.inf
        return DriveLimits(float(own.acceleration), float(own.velocity), step, self.response, clip or clip_number)


Clip = Callable[[Any, Any, Any], Any]


def clip_number(value: float, low: float, high: float) -> float:
    """Return a number within two bounds, quicker than min and max do."""
    return high if value > high else low if value < low else value


def clip_lanes(value: Array, low: Array | float, high: Array | float) -> Array:
    """Return the numbers (S,) of many runs within two bounds."""
    return np.minimum(np.maximum(value, low), high)


@dataclass(frozen=True)
class DriveLimits:
    """What the drive does with a demand within its bounds; demands are plain floats or, by `clip_lanes`, arrays (S,).

    acceleration m/s², velocity m/s, jerk_step m/s² per period (inf for none), response.
    """

    acceleration: float
    velocity: float
    jerk_step: float
    response: float
    clip: Clip

    def demanded(self, command: Any, noise: Any, last: Any) -> Any:
        """Return what becomes of `command` on its way, `last` having been demanded before it."""
        wanted = self.clip(self.response * command + noise, -self.acceleration, self.acceleration)
        return self.clip(wanted, last - self.jerk_step, last + self.jerk_step)

    def acting(self, demanded: Any, velocity: Any, duration: float) -> Any:
        """Return what acts for `duration` s, so that the loop's velocity reference, now `velocity`, stays in bounds.

        One that a knock has thrown out of them comes back as fast as the drive can.
        """
        low, high = (-self.velocity - velocity) / duration, (self.velocity - velocity) / duration
        return self.clip(self.clip(demanded, low, high), -self.acceleration, self.acceleration)

    def braking(self, velocity: Any, duration: float) -> Any:
        """Return the acceleration that brings `velocity` to zero, as fast as the drive can."""
        return self.clip(-velocity / duration, -self.acceleration, self.acceleration)


@dataclass(frozen=True)
class Push(Settings, table="push"):
    """One blow at `time` s, at the tick next to it: on arm `arm` (0: the inner) and on the cart.

    impulse N m s: of a couple on the arm; rate rad/s: jump of the arm's rate in place of or besides it; knock m/s:
    jump of the cart's velocity.
    """

    time: float = setting(least=0, unit="s")
    arm: int = setting(0, least=0)
    impulse: float = setting(0.0, least=-1000, most=1000, unit="N m s")
    rate: float = setting(0.0, least=-1000, most=1000, unit="rad/s")
    knock: float = setting(0.0, least=-1000, most=1000, unit="m/s")


@dataclass(frozen=True)
class DisturbanceSettings(Settings, table="disturbances"):
    """Seeded and explicit disturbances.

    pushes: how many blows on arms in a run, at random times on random arms, each of a uniform ± push_impulse N m s;
    knocks: how many on the cart, each a uniform ± knock_velocity m/s. tilt rad of the track, positive with the right
    end down; angles are measured from the track's normal, so hanging arms read `tilt`. explicit: further blows.
    """

    pushes: int = setting(0, least=0, most=10_000)
    push_impulse: float = setting(0.0, least=0, most=1000, unit="N m s")
    knocks: int = setting(0, least=0, most=10_000)
    knock_velocity: float = setting(0.0, least=0, most=1000, unit="m/s")
    tilt: float = setting(0.0, least=-np.pi / 4, most=np.pi / 4, unit="rad")
    explicit: tuple[Push, ...] = ()


@dataclass(frozen=True)
class BenchSettings:
    """What stands between the model and the world."""

    sensors: SensorSettings = field(default_factory=SensorSettings)
    drive: DriveSettings = field(default_factory=DriveSettings)
    disturbances: DisturbanceSettings = field(default_factory=DisturbanceSettings)

    def plant(self, arms: ArmChainParameters) -> PlantParameters:
        """Return these arms on this drive and track.

        Raises:
            InputError: the drive or the tilt is impossible.
        """
        drive = self.drive
        return PlantParameters(
            arms, lag=drive.lag, cart_mass=drive.cart_mass, cart_viscous=drive.cart_viscous, tilt=self.disturbances.tilt
        )
