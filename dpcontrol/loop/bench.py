"""Bench between model and world: sensors, drive, disturbances and plant.

Relative encoders that count, a cart's scale, and their faults; angles count from hanging, q is one count:

    joint_i = θ_i - θ_{i-1} + zero_i + noise,   s_i = q round(joint_i / q) - q missed_i,   θ̂_i = s_1 + … + s_i

The cart's drive; a command given at tick k acts from (k + delay) periods on, for one period:

    demanded = clip(response · command + noise),   |demanded| ≤ a_max,   |demanded - last| ≤ jerk · period
    acting:   |w + u Δt| ≤ v_max,   w = v + lag · a         (w: velocity reference of the drive's loop)

Pushes on the arms and knocks on the cart are instantaneous. They act at a tick, right after its reading. The track can
be tilted:

    push:  M(θ) Δω = impulse          knock:  Δẋ given, arms keep their momenta          tilt:  gravity (g sin, -g cos)

All random numbers of a run come from its seed, with a separate stream for each use. So a changed setting leaves all
other draws unchanged, and a longer run begins like a shorter one. Draws for each tick come in blocks, so the memory of
a run does not grow with its duration.

Sources: the data sheets of the rig, with 40,000 counts per turn, 1 µm on the cart, a drive commanded in velocity, 3
m/s, and limit switches at both ends. Seed sequences: O'Neill, as in numpy.random.SeedSequence.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.bench_period import Clip, DriveLimits
from dpcontrol.dynamics.chain import ArmChainParameters, Uncertainty
from dpcontrol.dynamics.components import Belt, Cable, EncoderPlay, Stiction, SymbolicPlant
from dpcontrol.dynamics.plant import PlantParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import Setting, Settings
from dpcontrol.foundation.shown import Brief
from dpcontrol.references.problem import Limits

_FINEST_ANGLE, _FINEST_CART = 1e-5, 1e-7
"""Steps that an estimator assumes for ideal sensors, rad and m."""


AGES = ("unknown", "reported")
"""Whether a bench reports the ages of its readings."""
FAILURES = ("off", "reversed")
"""Faults of a drive: its cart brakes and stands, or it goes the other way."""


@dataclass(frozen=True)
class SensorSettings(Settings, table="sensors"):
    """The sensors and their faults.

    Attributes:
        counts: counts of the relative arm encoders per turn, one number or one for each arm; 0 for no rounding.
        cart_resolution: resolution of the cart's scale, m, 0 for no rounding.
        zero_error: bound of the uniform error of each arm encoder's zero, rad. Outer angles have the sum.
        noise: standard deviation of each relative angle, rad.
        cart_noise: standard deviation of the cart's position, m.
        missed_counts: counts per s that each encoder loses while its joint moves.
        dropout: share of ticks without a reading.
        stuck_at: time from which `stuck_sensor` repeats its value, s. Sensors count from the inner arm to the cart.
        stuck_for: duration of this fault, s.
        jitter: largest age of a reading, uniformly distributed, s.
        ages: "reported" if each reading comes with its age, else "unknown".
        rate_noise: standard deviation of noise on the estimated rates, which simulates measured rates, rad/s.
        zero_drift: drift of each arm encoder's zero, in either direction, rad/h.
    """

    counts: Annotated[
        int | tuple[int, ...],
        Setting(least=1, zero="no rounding", usual=(8.0, 2e7), help="Encoder counts per turn of a joint."),
    ] = 40_000
    cart_resolution: Annotated[
        float,
        Setting(
            least=1e-12,
            most=1,
            zero="no rounding",
            unit="m",
            usual=(1e-9, 5e-3),
            help="Resolution of the cart's scale.",
        ),
    ] = 1e-6
    zero_error: Annotated[
        float, Setting(least=0, most=np.pi, unit="rad", usual=(0.0, 0.6), help="Largest error of each encoder's zero.")
    ] = 0.0
    noise: Annotated[
        float,
        Setting(
            least=0, most=np.pi, unit="rad", usual=(0.0, 0.1), help="Standard deviation of the measured joint angles."
        ),
    ] = 0.0
    cart_noise: Annotated[
        float,
        Setting(least=0, most=1, unit="m", usual=(0.0, 0.02), help="Standard deviation of the measured cart position."),
    ] = 0.0
    missed_counts: Annotated[
        float, Setting(least=0, most=1e6, unit="1/s", help="Rate at which a moving encoder loses counts.")
    ] = 0.0
    dropout: Annotated[float, Setting(least=0, most=1, help="Share of ticks without any reading.")] = 0.0
    stuck_at: Annotated[
        float, Setting(least=0, infinite="never", unit="s", usual=(0.0, 600.0), help="Time at which a sensor sticks.")
    ] = math.inf
    stuck_sensor: Annotated[
        int,
        Setting(least=0, help="Sensor that sticks: 0 the inner arm's encoder, then outwards, last the cart's scale."),
    ] = 0
    stuck_for: Annotated[
        float,
        Setting(
            above=0, infinite="the rest of the run", unit="s", usual=(0.0, 60.0), help="Duration for which it sticks."
        ),
    ] = math.inf
    jitter: Annotated[float, Setting(least=0, most=1, unit="s", usual=(0.0, 0.1), help="Largest age of a reading.")] = (
        0.0
    )
    ages: Annotated[str, Setting(choices=AGES, help="Whether the bench reports the ages of its readings.")] = "unknown"
    rate_noise: Annotated[
        float,
        Setting(
            least=0,
            most=1000,
            unit="rad/s",
            usual=(0.0, 20.0),
            help="Standard deviation of noise added to the estimated rates.",
        ),
    ] = 0.0
    zero_drift: Annotated[
        float,
        Setting(
            least=0,
            most=1000,
            unit="rad/h",
            usual=(0.0, 20.0),
            help="Drift of each encoder's zero, in either direction.",
        ),
    ] = 0.0

    def _check_together(self) -> None:
        """Raise an `InputError` for encoders that lose counts but have none."""
        if self.missed_counts and not np.all(self.counts):
            raise InputError(
                f"sensors: missed_counts = {self.missed_counts!r} with counts = 0: an encoder without counts cannot "
                f"lose any; set counts"
            )

    def steps(self, arms: int) -> tuple[float, ...]:
        """Return the rounding steps of the relative angles, rad; zero for none.

        Args:
            arms: number of arms.
        """
        return tuple(2 * np.pi / counts if counts else 0.0 for counts in self.of_each("counts", arms))

    def covariance(self, arms: int) -> Array:
        """Return the covariance (n+1, n+1) of the measured positions for the filter, rad² and m².

        It is that of rounding, q²/12 for a step q, and of noise. cov(angle_i, angle_j) is the sum of q_k²/12 + noise²
        over k ≤ min(i, j). Ideal sensors get the steps `_FINEST_ANGLE` and `_FINEST_CART`, because a filter needs a
        positive covariance.

        Args:
            arms: number n of arms.
        """
        steps = np.array(self.steps(arms))
        steps[steps == 0] = 0.0 if self.noise else _FINEST_ANGLE
        cart = self.cart_resolution or (0.0 if self.cart_noise else _FINEST_CART)
        index = np.arange(arms)
        covariance = np.zeros((arms + 1, arms + 1))
        covariance[:arms, :arms] = np.cumsum(steps**2 / 12 + self.noise**2)[np.minimum.outer(index, index)]
        covariance[arms, arms] = cart**2 / 12 + self.cart_noise**2
        return covariance


@dataclass(frozen=True)
class DriveSettings(Settings, table="drive"):
    """The drive and its cart.

    Attributes:
        delay: from a reading to the action of its command, in periods, also fractions.
        lag: time constant of the velocity loop, s.
        cart_mass: mass of the cart, kg. The arms do not move a cart of mass 0.
        cart_viscous: viscous friction of the cart, N s/m.
        velocity: bound, m/s, or inf for the itinerary's limit.
        acceleration: bound, m/s², or inf for the itinerary's limit.
        jerk: bound, m/s³.
        command_noise: standard deviation of Gaussian noise, drawn in each period, m/s².
        response: share of a command that the drive gives.
        track: distance of the hard stops from the centre, m, or inf for the itinerary's limit.
        switch_margin: distance of the limit switches from the hard stops, m.
        failed_at: time from which the drive has `failure`, s.
        failure: "off" if the cart brakes to a standstill, "reversed" if it goes the other way.
    """

    delay: Annotated[
        float,
        Setting(
            least=0,
            most=1000,
            unit="periods",
            usual=(0.0, 100.0),
            help="Delay from a reading to its command, also fractions.",
        ),
    ] = 1.0
    lag: Annotated[
        float, Setting(least=0, most=1, unit="s", usual=(0.0, 0.2), help="Time constant of the drive's velocity loop.")
    ] = 0.0
    cart_mass: Annotated[
        float,
        Setting(least=0, most=1e6, unit="kg", usual=(0.02, 200.0), help="Mass of the cart, which the arms then push."),
    ] = 0.0
    cart_viscous: Annotated[
        float, Setting(least=0, most=1e6, unit="N s/m", usual=(0.0, 1e4), help="Viscous friction of the cart.")
    ] = 0.0
    velocity: Annotated[
        float,
        Setting(
            above=0, infinite="no separate limit", unit="m/s", usual=(0.05, 20.0), help="Largest velocity of the drive."
        ),
    ] = math.inf
    acceleration: Annotated[
        float,
        Setting(
            above=0,
            infinite="no separate limit",
            unit="m/s²",
            usual=(0.05, 300.0),
            help="Largest acceleration of the drive.",
        ),
    ] = math.inf
    jerk: Annotated[
        float,
        Setting(
            above=0, infinite="no separate limit", unit="m/s³", usual=(5.0, 1e6), help="Largest jerk of the drive."
        ),
    ] = math.inf
    command_noise: Annotated[
        float,
        Setting(least=0, most=1e6, unit="m/s²", usual=(0.0, 100.0), help="Standard deviation of noise on the command."),
    ] = 0.0
    response: Annotated[
        float, Setting(least=0, most=10, usual=(0.05, 3.0), help="Share of a command that the drive gives.")
    ] = 1.0
    track: Annotated[
        float,
        Setting(
            above=0,
            infinite="no separate limit",
            unit="m",
            usual=(0.02, 5.0),
            help="Distance of the hard stops from the centre.",
        ),
    ] = math.inf
    switch_margin: Annotated[
        float,
        Setting(
            least=0, most=1000, unit="m", usual=(0.0, 0.5), help="Distance of the limit switches from the hard stops."
        ),
    ] = 0.0
    failed_at: Annotated[
        float, Setting(least=0, infinite="never", unit="s", usual=(0.0, 600.0), help="Time at which the drive fails.")
    ] = math.inf
    failure: Annotated[str, Setting(choices=FAILURES, help="Fault of the drive from failed_at on.")] = "off"

    def _check_together(self) -> None:
        """Raise an `InputError` for a failure without a time."""
        if self.failure != "off" and self.failed_at == math.inf:
            raise self.refusal("failure", "needs a time; give failed_at in s, such as failed_at = 0")

    def limits(self, limits: Limits) -> Limits:
        """Return the bounds of the drive and its track, with 0 for no bound on jerk.

        Args:
            limits: bounds of the itinerary, which apply where the drive has none.
        """
        return Limits(
            position=self.track if math.isfinite(self.track) else limits.position,
            velocity=self.velocity if math.isfinite(self.velocity) else limits.velocity,
            acceleration=self.acceleration if math.isfinite(self.acceleration) else limits.acceleration,
            jerk=self.jerk if math.isfinite(self.jerk) else 0.0,
        )

    def within(self, limits: Limits, period: float, *, clip: Clip) -> DriveLimits:
        """Return the drive's bounds on successive demands, which the simulated drive applies in each period.

        Args:
            limits: bounds of the itinerary, which apply where the drive has none.
            period: time between demands, s.
            clip: function that clips one number, or those of several runs.
        """
        bounds = self.limits(limits)
        return DriveLimits(float(bounds.acceleration), float(bounds.velocity), self.jerk * period, self.response, clip)


@dataclass(frozen=True)
class Push(Settings, table="push"):
    """One blow at `time` s, on the nearest tick.

    Attributes:
        arm: arm that is struck, 0 the inner one.
        impulse: angular impulse of a couple on the arm, N m s.
        rate: additional jump of the arm's rate, rad/s.
        knock: jump of the cart's velocity, m/s.
    """

    time: Annotated[float, Setting(least=0, unit="s", usual=(0.0, 600.0), help="Time of the blow.")]
    arm: Annotated[int, Setting(least=0, help="Arm that is struck, 0 the inner one.")] = 0
    impulse: Annotated[
        float, Setting(least=-1000, most=1000, unit="N m s", usual=(0.0, 2.0), help="Angular impulse on the arm.")
    ] = 0.0
    rate: Annotated[
        float, Setting(least=-1000, most=1000, unit="rad/s", usual=(0.0, 100.0), help="Jump of the arm's rate.")
    ] = 0.0
    knock: Annotated[
        float, Setting(least=-1000, most=1000, unit="m/s", usual=(0.0, 5.0), help="Jump of the cart's velocity.")
    ] = 0.0


@dataclass(frozen=True)
class DisturbanceSettings(Settings, table="disturbances"):
    """Seeded and explicit disturbances.

    Attributes:
        pushes: number of blows on random arms at random times, uniform up to ±push_impulse N m s.
        knocks: number of blows on the cart, uniform up to ±knock_velocity m/s.
        knocks_per_minute: rate of further blows on random arms (a Poisson process), uniform up to ±knock_impulse N m s.
        tilt: tilt of the track, rad, positive with the right end down. Angles are measured from the track's normal, so
            hanging arms read `tilt`.
        explicit: further blows.
    """

    pushes: Annotated[int, Setting(least=0, most=10_000, help="Number of random blows on the arms.")] = 0
    push_impulse: Annotated[
        float, Setting(least=0, most=1000, unit="N m s", usual=(0.0, 2.0), help="Largest impulse of these blows.")
    ] = 0.0
    knocks: Annotated[int, Setting(least=0, most=10_000, help="Number of random blows on the cart.")] = 0
    knock_velocity: Annotated[
        float,
        Setting(
            least=0, most=1000, unit="m/s", usual=(0.0, 5.0), help="Largest jump of the cart's velocity by such a blow."
        ),
    ] = 0.0
    knocks_per_minute: Annotated[
        float,
        Setting(
            least=0,
            most=6000,
            unit="1/min",
            usual=(0.0, 600.0),
            help="Rate of further blows on the arms at random times.",
        ),
    ] = 0.0
    knock_impulse: Annotated[
        float,
        Setting(least=0, most=1000, unit="N m s", usual=(0.0, 2.0), help="Largest impulse of these further blows."),
    ] = 0.03
    tilt: Annotated[
        float,
        Setting(
            least=-np.pi / 4,
            most=np.pi / 4,
            unit="rad",
            usual=(0.0, 0.4),
            help="Tilt of the track, positive with the right end down.",
        ),
    ] = 0.0
    explicit: tuple[Push, ...] = ()


@dataclass(frozen=True)
class MechanicsSettings(Settings, table="mechanics"):
    """Unmodelled mechanics of an ordinary rig; see `dpcontrol.dynamics.components`.

    Attributes:
        belt: frequency of the cart on an elastic belt with the motor held, Hz.
        belt_damping: damping ratio of this oscillation.
        belt_scale: place of the cart's scale, "motor" or "cart".
        play: width of the play between joint and encoder, for all arms or each, rad. The initial place is random.
        cable_torque: torque of a cable on the hanging inner arm, N m.
        cable_stiffness: stiffness of the cable against turning, N m/rad.
        stiction: break-away torque of the joints, for all or each, N m.
        kinetic: torque of a sliding joint as a share of that.
        initial_rate: bound of each uniform initial rate, for all or each, rad/s.
        initial_cart: initial position of the cart, m.
        initial_position, initial_velocity: bounds of its uniform random additions: m and m/s.
        known_belt: belt frequency assumed by the loop, by default the true one, 0 to ignore it, Hz.
        known_play: play assumed by the loop, by default the true one, 0 to ignore it, rad.
    """

    belt: Annotated[
        float,
        Setting(
            least=1,
            most=1000,
            zero="a rigid belt",
            unit="Hz",
            usual=(0.5, 1000.0),
            help="Frequency of the cart on an elastic belt with the motor held.",
        ),
    ] = 0.0
    belt_damping: Annotated[float, Setting(least=0, most=1, help="Damping ratio of the cart on its belt.")] = 0.05
    belt_scale: Annotated[str, Setting(choices=("motor", "cart"), help="Place of the cart's scale.")] = "motor"
    play: Annotated[
        float | tuple[float, ...],
        Setting(least=0, most=1, unit="rad", usual=(0.0, 0.5), help="Play between each joint and its encoder."),
    ] = 0.0
    cable_torque: Annotated[
        float,
        Setting(
            least=-1000, most=1000, unit="N m", usual=(0.0, 2.0), help="Torque of a cable on the hanging inner arm."
        ),
    ] = 0.0
    cable_stiffness: Annotated[
        float,
        Setting(least=0, most=1000, unit="N m/rad", usual=(0.0, 5.0), help="Stiffness of the cable against turning."),
    ] = 0.0
    stiction: Annotated[
        float | tuple[float, ...],
        Setting(least=0, most=1000, unit="N m", usual=(0.0, 1.0), help="Break-away torque of the joints at rest."),
    ] = 0.0
    kinetic: Annotated[
        float, Setting(least=0, most=1, help="Torque of a sliding joint as a share of its break-away torque.")
    ] = 0.8
    initial_rate: Annotated[
        float | tuple[float, ...],
        Setting(least=0, most=1000, unit="rad/s", usual=(0.0, 50.0), help="Largest initial rate of each arm."),
    ] = 0.0
    initial_cart: Annotated[
        float, Setting(least=-100, most=100, unit="m", usual=(0.0, 5.0), help="Initial position of the cart.")
    ] = 0.0
    initial_position: Annotated[
        float,
        Setting(least=0, most=100, unit="m", usual=(0.0, 5.0), help="Largest random initial distance of the cart."),
    ] = 0.0
    initial_velocity: Annotated[
        float,
        Setting(least=0, most=100, unit="m/s", usual=(0.0, 10.0), help="Largest random initial speed of the cart."),
    ] = 0.0
    known_belt: Annotated[
        float,
        Setting(
            least=1,
            most=1000,
            zero="none",
            infinite="as belt",
            unit="Hz",
            usual=(0.5, 1000.0),
            help="Belt frequency that the controller assumes.",
        ),
    ] = math.inf
    known_play: Annotated[
        float | tuple[float, ...],
        Setting(
            least=0, most=1, infinite="as play", unit="rad", usual=(0.0, 0.5), help="Play that the estimator assumes."
        ),
    ] = math.inf

    def of_each(self, name: str, arms: int) -> tuple[Any, ...]:
        """Return the values of a setting for each arm; infinite play is the bench's own.

        Args:
            name: `play`, `known_play` or `stiction`.
            arms: number of arms.
        """
        return super().of_each("play" if getattr(self, name) == math.inf else name, arms)

    def components(self, arms: int, offsets: Array) -> tuple[SymbolicPlant, ...]:
        """Return the components of a plant that these settings switch on, such as an elastic belt or play.

        Args:
            arms: number n of arms.
            offsets: encoder positions (n,) in their play, -0.5 to 0.5.
        """
        components: list[SymbolicPlant] = []
        play, stiction = self.of_each("play", arms), self.of_each("stiction", arms)
        if self.belt:
            components.append(Belt(self.belt, self.belt_damping, motor_scale=self.belt_scale == "motor"))
        if any(play):
            components.append(EncoderPlay(play, tuple((offsets * play).tolist())))
        if self.cable_torque or self.cable_stiffness:
            components.append(Cable(self.cable_torque, self.cable_stiffness))
        if any(stiction):
            components.append(Stiction(stiction, tuple(self.kinetic * torque for torque in stiction)))
        return tuple(components)


@dataclass(frozen=True)
class BenchSettings:
    """Sensors, drive, disturbances and mechanics of a bench."""

    sensors: SensorSettings = field(default_factory=SensorSettings)
    drive: DriveSettings = field(default_factory=DriveSettings)
    disturbances: DisturbanceSettings = field(default_factory=DisturbanceSettings)
    mechanics: MechanicsSettings = field(default_factory=MechanicsSettings)

    def plant(self, arms: ArmChainParameters, offsets: Array) -> PlantParameters:
        """Return the parameters of a plant with these arms, on this drive and track.

        Args:
            arms: parameters of the n arms.
            offsets: encoder positions (n,) in their play, -0.5 to 0.5.

        Raises:
            InputError: the drive or the tilt is impossible.
        """
        drive, components = self.drive, self.mechanics.components(arms.count, offsets)
        return PlantParameters(
            arms, lag=drive.lag, cart_mass=drive.cart_mass, cart_viscous=drive.cart_viscous,
            tilt=self.disturbances.tilt, components=components,
        )  # fmt: skip


# The order is that of the seed's streams: append only, because any other change alters the runs of old seeds.
_STREAMS = ("plant", "initial_error", "zero_errors", "command_noise", "ages", "dropped", "missed", "noise",
            "rate_noise", "pushes", "knocks", "model", "zero_drift", "random_blows",
            "initial_rate", "play", "initial_position", "initial_velocity")  # fmt: skip


@dataclass(frozen=True, eq=False)
class Blow:
    """Sum of the blows on one bench at one tick.

    Attributes:
        impulses: angular impulses (n,) on the arms, N m s.
        jumps: jumps (n,) of the arms' rates, rad/s.
        knock: jump of the cart's velocity, m/s.
    """

    impulses: Array
    jumps: Array
    knock: float


_BLOCK = 1 << 14
"""Number of ticks for which random numbers are drawn at once."""


@dataclass(frozen=True, eq=False)
class Stream(Brief):
    """Source of the random numbers of one use, such as noise of the sensors, for each tick of a run.

    `make` turns a generator and a count into an array (count, …), and `seed` is that of the generator. Successive
    blocks hold the numbers of one long draw, so a run of any length gets the same numbers.
    """

    seed: np.random.SeedSequence
    make: Callable[[np.random.Generator, int], NDArray[Any]]
    begin: int = 0
    """Number of ticks whose numbers are skipped at the start."""


class StreamReader:
    """Returns the numbers of a stream tick by tick, `reader[k]`, in order and without end.

    It stores one block.

    Args:
        stream: stream to read.
        rows: conversion of a block (count, …) into a sequence with one entry per tick.
        block: number of ticks drawn at once.
    """

    def __init__(self, stream: Stream, rows: Callable[[NDArray[Any]], Any], *, block: int) -> None:
        """Skip the numbers before the stream's first tick; they must be drawn, to advance the generator.

        `_values` is the stored block, with the ticks from `_first` to `_end` (not included).
        """
        self._random, self._make, self._rows = np.random.default_rng(stream.seed), stream.make, rows
        self._block, self._first, self._end, skipped = block, 0, 0, stream.begin
        self._values: Any = ()
        while skipped:
            self._make(self._random, min(skipped, _BLOCK))
            skipped -= min(skipped, _BLOCK)

    def __getitem__(self, tick: int) -> Any:
        """Return the numbers of a tick, which must belong to the present block or to a later one."""
        while tick >= self._end:
            self._values = self._rows(self._make(self._random, self._block))
            self._first, self._end = self._end, self._end + self._block
        return self._values[tick - self._first]


@dataclass(frozen=True, eq=False)
class BenchDraw(Brief):
    """Random draws of one run for n arms and K ticks.

    Attributes:
        plant: parameters of the arms.
        initial_error: errors (n,) of the initial angles, rad.
        initial_rate: initial rates (n,), rad/s.
        initial_cart: initial position and velocity (2,) of the cart, m and m/s.
        zeros: zero errors (n,) of the encoders, rad.
        drift: drift (n,) of these errors, rad/s.
        blows: blows by tick.
        streams: numbers for each tick by name, also beyond K. A stream that the settings do not use is missing.

            command_noise: noise (K,) on commands, m/s².

            ages: ages (K,) of the readings, s.

            dropped: ticks without reading (K,).

            missed: counts (K, n) lost by moving joints.

            noise: noise (K, n+1) on relative angles, rad, and cart, m.

            rate_noise: noise (K, n) on estimated rates, rad/s.
    """

    seed: int
    ticks: int
    period: float
    plant: PlantParameters
    initial_error: Array
    initial_rate: Array
    initial_cart: Array
    zeros: Array
    drift: Array
    streams: Mapping[str, Stream]
    blows: Mapping[int, Blow]
    random_blows: Callable[[], Iterator[tuple[int, Blow]]]
    """Yields blows at random times with their ticks, in order and without end."""
    own: Any = None
    """A user's plant that replaces these arms (`dpcontrol.loop.own`)."""

    def drawn(self, name: str) -> NDArray[Any]:
        """Return the numbers (K, …) of a stream for all ticks.

        Args:
            name: name of the stream in `streams`.
        """
        stream = self.streams[name]
        return stream.make(np.random.default_rng(stream.seed), stream.begin + self.ticks)[stream.begin :]

    def reader(self, name: str, rows: Callable[[NDArray[Any]], Any] = np.ndarray.tolist) -> StreamReader | None:
        """Return a reader of a stream for a run that is computed tick by tick, or None if the stream is unused.

        Args:
            name: name of the stream in `streams`.
            rows: conversion of a block (count, …) into a sequence of one entry per tick; by default to lists.
        """
        stream = self.streams.get(name)
        return None if stream is None else StreamReader(stream, rows, block=min(max(self.ticks, 1), _BLOCK))

    def endless(self, *, since: int = 0) -> "BenchDraw":
        """Return the draw for a run of any length, which may begin later in this draw.

        A run that recovers from falls has no fixed number of ticks.

        Args:
            since: first tick of the run in this draw, default 0.
        """
        return replace(
            self, ticks=_ENDLESS, zeros=self.zeros + self.drift * since * self.period,
            streams={name: replace(stream, begin=stream.begin + since) for name, stream in self.streams.items()},
            blows={tick - since: blow for tick, blow in self.blows.items() if tick >= since},
            random_blows=lambda: ((tick - since, blow) for tick, blow in self.random_blows() if tick >= since),
        )  # fmt: skip


_ENDLESS = 1 << 60
"""Number of ticks that no run reaches."""


@dataclass(frozen=True)
class Unlike:
    """Differences of the plant from the model, which `draw_bench` draws.

    Attributes:
        mismatch: relative errors of its parameters.
        model_uncertainty: factor on the standard errors of the model's `uncertainty`, for additional errors; 0 for
            none.
        uncertainty: standard errors of the model's parameters, None if unknown.
        initial_error: bound of each uniform initial angle error, rad.
        friction: factor on the friction of the drawn plant.
        plant: arms that replace the model's as the centre of the draw.
    """

    mismatch: float = 0.0
    model_uncertainty: float = 0.0
    uncertainty: Uncertainty | None = None
    initial_error: float = 0.0
    friction: float = 1.0
    plant: ArmChainParameters | None = None


_ALIKE = Unlike()


def draw_bench(
    arms: ArmChainParameters,
    settings: BenchSettings,
    *,
    seed: int,
    ticks: int,
    period: float,
    unlike: Unlike = _ALIKE,
) -> BenchDraw:
    """Draw plant, initial errors, sensor errors, noise and blows of one run from its seed.

    Each use of random numbers has its own generator, by the names of `_STREAMS`, which `generator` returns. Numbers for
    each tick become streams of the draw: `stream` stores one unless `wanted`, the size of its noise, is zero, and
    `normal` one of Gaussian numbers with the standard deviations `sigmas`. `within` draws a uniform number between
    ±`most` for each arm, zeros if `most` is zero.

    Args:
        arms: arms of the model, which are the centre of the draw.
        settings: settings of the bench.
        seed: seed of the random numbers.
        ticks: number of ticks.
        period: period, s.
        unlike: differences of the plant from the model.

    Raises:
        InputError: settings that do not fit these arms.
        GoalMissed: no arms near the model's have the drawn ratios.
    """
    n, sensors, drive = arms.count, settings.sensors, settings.drive
    seeds: dict[str, np.random.SeedSequence] = dict(
        zip(_STREAMS, np.random.SeedSequence(seed).spawn(len(_STREAMS)), strict=True)
    )

    def generator(name: str) -> np.random.Generator:
        return np.random.default_rng(seeds[name])

    # Unused values are not drawn: making a generator takes longer than most draws.
    streams: dict[str, Stream] = {}

    def stream(name: str, make: Callable[[np.random.Generator, int], NDArray[Any]], wanted: Any) -> None:
        if wanted:
            streams[name] = Stream(seeds[name], make)

    def normal(name: str, sigmas: Array) -> None:
        stream(name, lambda source, count: source.standard_normal((count, len(sigmas))) * sigmas, sigmas.any())

    def within(name: str, most: float) -> Array:
        return generator(name).uniform(-most, most, n) if most else np.zeros(n)

    loss, noise = sensors.missed_counts * period, drive.command_noise
    stream("command_noise", lambda source, count: source.standard_normal(count) * noise, noise)
    stream("ages", lambda source, count: source.uniform(0.0, sensors.jitter, count), sensors.jitter)
    stream("dropped", lambda source, count: source.uniform(size=count) < sensors.dropout, sensors.dropout)
    # Whole counts with the right mean: the integer part, plus one with the probability of the rest.
    stream("missed", lambda source, count: np.floor(source.uniform(size=(count, n)) + loss).astype(np.int64), loss)
    normal("noise", np.array([*[sensors.noise] * n, sensors.cart_noise]))
    normal("rate_noise", np.full(n, sensors.rate_noise))
    centre = unlike.plant or arms
    if unlike.model_uncertainty and unlike.uncertainty is not None:
        centre = unlike.uncertainty.drawn(arms, generator("model"), scale=unlike.model_uncertainty)
    true_arms = centre.mismatched(unlike.mismatch, generator("plant"))
    if unlike.friction != 1.0:
        true_arms = true_arms.with_friction(unlike.friction)
    return BenchDraw(
        seed=seed, ticks=ticks, period=period,
        plant=settings.plant(true_arms, within("play", 0.5 if settings.mechanics.play else 0.0)),
        initial_error=within("initial_error", unlike.initial_error),
        initial_rate=np.array(settings.mechanics.of_each("initial_rate", n)) * within("initial_rate", 1.0),
        initial_cart=np.array([
            settings.mechanics.initial_cart + within("initial_position", settings.mechanics.initial_position)[0],
            within("initial_velocity", settings.mechanics.initial_velocity)[0],
        ]),
        zeros=within("zero_errors", sensors.zero_error),
        drift=np.copysign(sensors.zero_drift / 3600, within("zero_drift", sensors.zero_drift)),
        streams=streams,
        blows=_blows(settings.disturbances, n, (ticks, period), generator),
        random_blows=lambda: _random_blows(settings.disturbances, n, period, generator("random_blows")),
    )  # fmt: skip


def _random_blows(
    settings: DisturbanceSettings, arms: int, period: float, random: np.random.Generator
) -> Iterator[tuple[int, Blow]]:
    """Yield blows on random arms with their ticks, in order and without end; none without such blows.

    Their times are a Poisson process with the rate `knocks_per_minute`, and their impulses on one arm are uniform up to
    `knock_impulse`, both of `settings`. `period` is that of the ticks, s.
    """
    time_s = 0.0
    while settings.knocks_per_minute and settings.knock_impulse:
        time_s += random.exponential(60 / settings.knocks_per_minute)
        impulses = np.zeros(arms)
        impulses[random.integers(arms)] = random.uniform(-settings.knock_impulse, settings.knock_impulse)
        yield int(time_s / period), Blow(impulses, np.zeros(arms), 0.0)


def _blows(
    settings: DisturbanceSettings, arms: int, clock: tuple[int, float], random: Callable[[str], np.random.Generator]
) -> dict[int, Blow]:
    """Return the settings' fixed number of random blows and explicit blows by tick; those of one tick are added.

    Args:
        settings: number and size of the blows.
        arms: number n of arms.
        clock: number of ticks of the run, and its period, s.
        random: generator for each of `_STREAMS`.
    """
    ticks, period = clock
    strokes: list[tuple[int, int, float, float, float]] = []
    for share, arm_share, size_share in (
        random("pushes").uniform(size=(settings.pushes, 3)).tolist() if settings.pushes else ()
    ):
        strokes.append(
            (int(share * ticks), int(arm_share * arms), (2 * size_share - 1) * settings.push_impulse, 0.0, 0.0)
        )
    for share, size_share in random("knocks").uniform(size=(settings.knocks, 2)).tolist() if settings.knocks else ():
        strokes.append((int(share * ticks), 0, 0.0, 0.0, (2 * size_share - 1) * settings.knock_velocity))
    strokes += [
        (round(push.time / period), push.arm, push.impulse, push.rate, push.knock) for push in settings.explicit
    ]
    blows: dict[int, Blow] = {}
    for tick, arm, impulse, rate, knock in strokes:
        blow = blows.get(tick) or Blow(np.zeros(arms), np.zeros(arms), 0.0)
        unit_vector = np.eye(arms)[arm]
        blows[tick] = Blow(blow.impulses + impulse * unit_vector, blow.jumps + rate * unit_vector, blow.knock + knock)
    return blows
