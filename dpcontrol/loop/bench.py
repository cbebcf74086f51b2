"""What stands between the model and the world: sensors, drive, disturbances; and the plant that they make of the arms.

Relative encoders that count, a cart's scale, and what goes wrong with them; angles count from hanging, q: one count:

    joint_i = θ_i - θ_{i-1} + zero_i + noise,   s_i = q round(joint_i / q) - q missed_i,   θ̂_i = s_1 + … + s_i

The cart's drive; a command given at tick k acts from (k + delay) periods on, for one period:

    demanded = clip(response · command + noise),   |demanded| ≤ a_max,   |demanded - last| ≤ jerk · period
    acting:   |w + u Δt| ≤ v_max,   w = v + lag · a         (w: velocity reference of the drive's loop)

Pushes on the arms and knocks on the cart, which act in no time at a tick, right after its reading; a tilted track:

    push:  M(θ) Δω = impulse          knock:  Δẋ given, arms keep their momenta          tilt:  gravity (g sin, -g cos)

Everything random in a run is drawn from its seed, from one stream of numbers for each use: a change of one setting
leaves all other draws as they were, and a longer run begins like a shorter one. What is drawn for each tick comes in
blocks, so that a night takes no more memory than a minute.

Sources: the rig's data sheets as read for its parameters: 40,000 counts per turn, 1 µm on the cart; commanded in
velocity, 3 m/s, limit switches at both ends; O'Neill's seed sequences as in numpy.random.SeedSequence.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.interface import clip_number
from dpcontrol.dynamics.chain import ArmChainParameters, Uncertainty
from dpcontrol.dynamics.components import Belt, Cable, EncoderPlay, Stiction, SymbolicPlant
from dpcontrol.dynamics.plant import PlantParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import Settings, setting
from dpcontrol.foundation.shown import Brief
from dpcontrol.references.problem import Limits

Clip = Callable[[Any, Any, Any], Any]


_FINEST_ANGLE, _FINEST_CART = 1e-5, 1e-7
"""rad and m: steps that an estimator assumes of sensors that are simulated without rounding or noise."""


AGES = ("unknown", "reported")
"""Whether a bench reports the ages of its readings."""


@dataclass(frozen=True)
class SensorSettings(Settings, table="sensors"):
    """The sensors and their faults; what is random is drawn beforehand, see `dpcontrol.loop.bench`.

    counts: of a relative arm encoder per turn, 0 for no rounding; cart_resolution: of the cart's scale, m, 0 likewise.
    zero_error: rad, uniform ± on the zero of each arm's encoder, so that outer angles carry the sum. noise: standard
    deviation on each relative angle, rad; cart_noise: on the cart, m. missed_counts: per s that each encoder loses
    while its joint moves. dropout: share of ticks at which no sensor is read. stuck_at s: from when the sensor
    `stuck_sensor` (0, 1 … the arms, then the cart) repeats its value, for stuck_for s. jitter s: a reading is up to so
    old, uniform. ages: "reported" if each reading comes with its age, else "unknown". rate_noise rad/s: standard
    deviation of what is added to estimated rates, as where rates are measured. zero_drift rad/h: at which the zero of
    each arm's encoder drifts, either way.
    """

    counts: int = setting(40_000, least=1, zero="no rounding", help="Encoder counts per turn of a joint.")
    cart_resolution: float = setting(
        1e-6, least=1e-12, most=1, zero="no rounding", unit="m", help="Resolution of the cart's scale."
    )
    zero_error: float = setting(0.0, least=0, most=np.pi, unit="rad", help="Largest error of each encoder's zero.")
    noise: float = setting(
        0.0, least=0, most=np.pi, unit="rad", help="Standard deviation of the measured joint angles."
    )
    cart_noise: float = setting(
        0.0, least=0, most=1, unit="m", help="Standard deviation of the measured cart position."
    )
    missed_counts: float = setting(
        0.0, least=0, most=1e6, unit="1/s", help="Rate at which a moving encoder loses counts."
    )
    dropout: float = setting(0.0, least=0, most=1, help="Share of ticks without any reading.")
    stuck_at: float = setting(math.inf, least=0, infinite="never", unit="s", help="Time at which a sensor sticks.")
    stuck_sensor: int = setting(
        0, least=0, help="Sensor that sticks: 0 the inner arm's encoder, then outwards, last the cart's scale."
    )
    stuck_for: float = setting(math.inf, above=0, infinite="for good", unit="s", help="Duration for which it sticks.")
    jitter: float = setting(0.0, least=0, most=1, unit="s", help="Largest age of a reading.")
    ages: str = setting("unknown", choices=AGES, help="Whether the bench reports the ages of its readings.")
    rate_noise: float = setting(
        0.0, least=0, most=1000, unit="rad/s", help="Standard deviation of noise added to the estimated rates."
    )
    zero_drift: float = setting(
        0.0, least=0, most=1000, unit="rad/h", help="Drift of each encoder's zero, in either direction."
    )

    def _check_together(self) -> None:
        """Check that an encoder which loses counts has some."""
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

        cov(angle_i, angle_j) = (min(i, j) + 1)(q²/12 + noise²). Where nothing is rounded nor noisy a filter must still
        doubt a reading a little: as if an encoder counted to `_FINEST_ANGLE`, the scale to `_FINEST_CART`.
        """
        angle, cart = self.steps
        angle = angle or (0.0 if self.noise else _FINEST_ANGLE)
        cart = cart or (0.0 if self.cart_noise else _FINEST_CART)
        index = np.arange(arms)
        out = np.zeros((arms + 1, arms + 1))
        out[:arms, :arms] = (np.minimum.outer(index, index) + 1) * (angle**2 / 12 + self.noise**2)
        out[arms, arms] = cart**2 / 12 + self.cart_noise**2
        return out


@dataclass(frozen=True)
class DriveSettings(Settings, table="drive"):
    """The drive and its cart; what is random is drawn beforehand, see `dpcontrol.loop.bench`.

    delay: from reading to acting, in periods, also fractions. lag s: time constant of the velocity loop. cart_mass
    kg (zero: the arms do not move the cart) and cart_viscous N s/m. velocity m/s, acceleration m/s²: what it can do,
    inf: as the scene's limits; jerk m/s³. command_noise m/s²: standard deviation, Gaussian, new each period.
    response: share of a command that the drive gives. track m: hard stops stand at ± this, inf: at the scene's limit
    of position. switch_margin m: so far before them the limit switches are touched.
    """

    delay: float = setting(
        1.0, least=0, most=1000, unit="periods", help="Delay from a reading to its command, also fractions."
    )
    lag: float = setting(0.0, least=0, most=1, unit="s", help="Time constant of the drive's velocity loop.")
    cart_mass: float = setting(0.0, least=0, most=1e6, unit="kg", help="Mass of the cart, which the arms then push.")
    cart_viscous: float = setting(0.0, least=0, most=1e6, unit="N s/m", help="Viscous friction of the cart.")
    velocity: float = setting(
        math.inf, above=0, infinite="none of its own", unit="m/s", help="Largest velocity of the drive."
    )
    acceleration: float = setting(
        math.inf, above=0, infinite="none of its own", unit="m/s²", help="Largest acceleration of the drive."
    )
    jerk: float = setting(math.inf, above=0, infinite="none of its own", unit="m/s³", help="Largest jerk of the drive.")
    command_noise: float = setting(
        0.0, least=0, most=1e6, unit="m/s²", help="Standard deviation of noise on the command."
    )
    response: float = setting(1.0, least=0, most=10, help="Share of a command that the drive gives.")
    track: float = setting(
        math.inf, above=0, infinite="none of its own", unit="m", help="Distance of the hard stops from the centre."
    )
    switch_margin: float = setting(
        0.0, least=0, most=1000, unit="m", help="Distance of the limit switches from the hard stops."
    )

    def limits(self, limits: Limits) -> Limits:
        """Return what the drive can do: its own bounds where it has them, else those of the scene."""
        return Limits(
            position=self.track if math.isfinite(self.track) else limits.position,
            velocity=self.velocity if math.isfinite(self.velocity) else limits.velocity,
            acceleration=self.acceleration if math.isfinite(self.acceleration) else limits.acceleration,
            jerk=self.jerk if math.isfinite(self.jerk) else 0.0,
        )

    def within(self, limits: Limits, period: float, *, clip: Clip = clip_number) -> "DriveLimits":
        """Return what it does with demands, `period` s apart, under the scene's limits; clip: `clip_lanes` for many."""
        own = self.limits(limits)
        step = self.jerk * period if math.isfinite(self.jerk) else math.inf
        return DriveLimits(float(own.acceleration), float(own.velocity), step, self.response, clip)


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

    time: float = setting(least=0, unit="s", help="Time of the blow.")
    arm: int = setting(0, least=0, help="Arm that is struck, 0 the inner one.")
    impulse: float = setting(0.0, least=-1000, most=1000, unit="N m s", help="Angular impulse on the arm.")
    rate: float = setting(0.0, least=-1000, most=1000, unit="rad/s", help="Jump of the arm's rate.")
    knock: float = setting(0.0, least=-1000, most=1000, unit="m/s", help="Jump of the cart's velocity.")


@dataclass(frozen=True)
class DisturbanceSettings(Settings, table="disturbances"):
    """Seeded and explicit disturbances.

    pushes: how many blows on arms in a run, at random times on random arms, each of a uniform ± push_impulse N m s;
    knocks: how many on the cart, each a uniform ± knock_velocity m/s. knocks_per_minute: blows on random arms at random
    times (a Poisson process), for as long as the run lasts, each of a uniform ± knock_impulse N m s. tilt rad of the
    track, positive with the right end down; angles are measured from the track's normal, so hanging arms read `tilt`.
    explicit: further blows.
    """

    pushes: int = setting(0, least=0, most=10_000, help="Number of random blows on the arms.")
    push_impulse: float = setting(0.0, least=0, most=1000, unit="N m s", help="Largest impulse of these blows.")
    knocks: int = setting(0, least=0, most=10_000, help="Number of random blows on the cart.")
    knock_velocity: float = setting(
        0.0, least=0, most=1000, unit="m/s", help="Largest jump of the cart's velocity by such a blow."
    )
    knocks_per_minute: float = setting(
        0.0, least=0, most=6000, unit="1/min", help="Rate of further blows on the arms at random times."
    )
    knock_impulse: float = setting(
        0.03, least=0, most=1000, unit="N m s", help="Largest impulse of these further blows."
    )
    tilt: float = setting(
        0.0, least=-np.pi / 4, most=np.pi / 4, unit="rad", help="Tilt of the track, positive with the right end down."
    )
    explicit: tuple[Push, ...] = ()


@dataclass(frozen=True)
class MechanicsSettings(Settings, table="mechanics"):
    """Mechanics of an ordinary rig that no model has; see `dpcontrol.dynamics.components`.

    belt Hz: frequency of the cart on an elastic belt with the motor held. belt_damping: damping ratio of that.
    belt_scale: place of the cart's scale, "motor" or "cart". play rad: width of the play between joint and encoder, for
    all arms or each. The encoder's first place in it is random. cable_torque N m acts on the hanging inner arm,
    cable_stiffness N m/rad against its turning. stiction N m: break-away torque of the joints, for all or each.
    kinetic: torque of a sliding joint as a share of that. initial_rate rad/s: uniform ± on each rate of the first
    state. initial_cart m: first position of the cart.

    known_belt Hz and known_play rad are the loop's values of belt and play, by default the true ones. With 0 the loop
    ignores them.
    """

    belt: float = setting(
        0.0,
        least=1,
        most=1000,
        zero="a rigid belt",
        unit="Hz",
        help="Frequency of the cart on an elastic belt with the motor held.",
    )
    belt_damping: float = setting(0.05, least=0, most=1, help="Damping ratio of the cart on its belt.")
    belt_scale: str = setting("motor", choices=("motor", "cart"), help="Place of the cart's scale.")
    play: float | tuple[float, ...] = setting(
        0.0, least=0, most=1, unit="rad", help="Play between each joint and its encoder."
    )
    cable_torque: float = setting(
        0.0, least=-1000, most=1000, unit="N m", help="Torque of a cable on the hanging inner arm."
    )
    cable_stiffness: float = setting(
        0.0, least=0, most=1000, unit="N m/rad", help="Stiffness of the cable against turning."
    )
    stiction: float | tuple[float, ...] = setting(
        0.0, least=0, most=1000, unit="N m", help="Break-away torque of the joints at rest."
    )
    kinetic: float = setting(
        0.8, least=0, most=1, help="Torque of a sliding joint as a share of its break-away torque."
    )
    initial_rate: float = setting(0.0, least=0, most=1000, unit="rad/s", help="Largest initial rate of each arm.")
    initial_cart: float = setting(0.0, least=-100, most=100, unit="m", help="Initial position of the cart.")
    known_belt: float = setting(
        math.inf,
        least=1,
        most=1000,
        zero="none",
        infinite="as belt",
        unit="Hz",
        help="Belt frequency that the controller assumes.",
    )
    known_play: float | tuple[float, ...] = setting(
        math.inf, least=0, most=1, infinite="as play", unit="rad", help="Play that the estimator assumes."
    )

    def of_each(self, name: str, arms: int) -> tuple[float, ...]:
        """Return the values of `play`, `known_play` or `stiction` for each arm.

        Raises:
            InputError: their number is not that of the arms.
        """
        value = getattr(self, name)
        if value == math.inf:
            return self.of_each("play", arms)
        values = tuple(value) if isinstance(value, tuple | list) else (value,) * arms
        if len(values) != arms:
            raise self.refusal(name, f"must be one number, or {arms}, one for each arm")
        return values

    def components(self, arms: int, offsets: Array) -> tuple[SymbolicPlant, ...]:
        """Return the components of a plant of so many arms; offsets (n,): of encoders in their play, -0.5 to 0.5."""
        found: list[SymbolicPlant] = []
        play, stiction = self.of_each("play", arms), self.of_each("stiction", arms)
        if self.belt:
            found.append(Belt(self.belt, self.belt_damping, motor_scale=self.belt_scale == "motor"))
        if any(play):
            found.append(EncoderPlay(play, tuple((offsets * play).tolist())))
        if self.cable_torque or self.cable_stiffness:
            found.append(Cable(self.cable_torque, self.cable_stiffness))
        if any(stiction):
            found.append(Stiction(stiction, tuple(self.kinetic * torque for torque in stiction)))
        return tuple(found)


@dataclass(frozen=True)
class BenchSettings:
    """What stands between the model and the world."""

    sensors: SensorSettings = field(default_factory=SensorSettings)
    drive: DriveSettings = field(default_factory=DriveSettings)
    disturbances: DisturbanceSettings = field(default_factory=DisturbanceSettings)
    mechanics: MechanicsSettings = field(default_factory=MechanicsSettings)

    def plant(self, arms: ArmChainParameters, offsets: Array | None = None) -> PlantParameters:
        """Return these arms on this drive and track; offsets: see `MechanicsSettings.components`, zero by default.

        Raises:
            InputError: the drive or the tilt is impossible.
        """
        drive, offsets = self.drive, np.zeros(arms.count) if offsets is None else offsets
        components = self.mechanics.components(arms.count, offsets)
        return PlantParameters(
            arms, lag=drive.lag, cart_mass=drive.cart_mass, cart_viscous=drive.cart_viscous,
            tilt=self.disturbances.tilt, components=components,
        )  # fmt: skip


# Their order is that of the seed's streams: append only, or old seeds give other runs.
_STREAMS = ("plant", "initial_error", "zero_errors", "command_noise", "ages", "dropped", "missed", "noise",
            "rate_noise", "pushes", "knocks", "model", "zero_drift", "random_blows",
            "initial_rate", "play")  # fmt: skip


@dataclass(frozen=True, eq=False)
class Blow:
    """What strikes at one tick: impulses (n,) N m s, jumps (n,) rad/s, knock m/s."""

    impulses: Array
    jumps: Array
    knock: float


_BLOCK = 1 << 14
"""Ticks drawn at once."""


@dataclass(frozen=True, eq=False)
class Stream(Brief):
    """What is drawn for each tick of a run: `make` turns a generator and a count into as many ticks' (count, …).

    Blocks one after the other hold the numbers of one long draw.
    """

    seed: np.random.SeedSequence
    make: Callable[[np.random.Generator, int], NDArray[Any]]
    begin: int = 0
    """Ticks that were before the first."""

    def first(self, count: int) -> NDArray[Any]:
        """Return the first `count` ticks."""
        return self.make(np.random.default_rng(self.seed), self.begin + count)[self.begin :]

    def reader(self, rows: Callable[[NDArray[Any]], Any], *, ticks: int = _BLOCK) -> "StreamReader":
        """Return a reader from the first tick on; rows: what becomes of a block; ticks: how many, if known."""
        return StreamReader(self, rows, block=min(max(ticks, 1), _BLOCK))


class StreamReader:
    """Gives a stream tick by tick, `reader[k]`, without end, in order; it keeps one block of it."""

    def __init__(self, stream: Stream, rows: Callable[[NDArray[Any]], Any], *, block: int) -> None:
        self._random, self._make, self._rows = np.random.default_rng(stream.seed), stream.make, rows
        self._block, self._first, self._end, left = block, 0, 0, stream.begin
        self._values: Any = ()
        while left:
            self._make(self._random, min(left, _BLOCK))
            left -= min(left, _BLOCK)

    def __getitem__(self, tick: int) -> Any:
        while tick >= self._end:
            self._values = self._rows(self._make(self._random, self._block))
            self._first, self._end = self._end, self._end + self._block
        if tick < self._first:
            raise IndexError(f"tick {tick} of a stream is asked for after tick {self._first}")
        return self._values[tick - self._first]


def _drawn(name: str) -> Any:
    """Return a property of a `BenchDraw`: the first of its ticks of a stream, or None."""

    def first(draw: "BenchDraw") -> NDArray[Any] | None:
        stream = draw.streams.get(name)
        return None if stream is None else stream.first(draw.ticks)

    return cached_property(first)


@dataclass(frozen=True, eq=False)
class BenchDraw(Brief):
    """One run's draws for n arms and K ticks.

    plant; initial_error (n,) rad on the angles, initial_rate (n,) rad/s on the rates; zeros (n,) rad of the encoders,
    drift (n,) rad/s of them; blows by their tick. streams: by name what is drawn for each tick, also beyond the K; None
    stands below for none of the kind, which costs nothing. command_noise (K,) m/s²; ages (K,) s of the readings;
    dropped (K,): ticks without reading; missed (K, n): counts lost where the joint moves; noise (K, n+1) on relative
    angles, rad, and cart, m; rate_noise (K, n) rad/s on estimated rates.
    """

    seed: int
    ticks: int
    period: float
    plant: PlantParameters
    initial_error: Array
    initial_rate: Array
    zeros: Array
    drift: Array
    streams: Mapping[str, Stream]
    blows: Mapping[int, Blow]
    random_blows: Callable[[], Iterator[tuple[int, Blow]]]
    """Gives blows at random times with their ticks, in order, without end where there are any."""
    own: Any = None
    """A user's plant in place of these (`dpcontrol.loop.own`)."""

    command_noise = _drawn("command_noise")
    ages = _drawn("ages")
    dropped = _drawn("dropped")
    missed = _drawn("missed")
    noise = _drawn("noise")
    rate_noise = _drawn("rate_noise")

    def reader(self, name: str, rows: Callable[[NDArray[Any]], Any] = np.ndarray.tolist) -> StreamReader | None:
        """Return what gives a stream tick by tick, None where there is none; see `Stream.reader`."""
        stream = self.streams.get(name)
        return None if stream is None else stream.reader(rows, ticks=self.ticks)

    def endless(self, *, since: int = 0) -> "BenchDraw":
        """Return the same for a run of any length, or for the rest of it that begins with tick `since`."""

        def later() -> Iterator[tuple[int, Blow]]:
            return ((tick - since, blow) for tick, blow in self.random_blows() if tick >= since)

        return replace(
            self, ticks=_ENDLESS, zeros=self.zeros + self.drift * since * self.period,
            streams={name: replace(stream, begin=stream.begin + since) for name, stream in self.streams.items()},
            blows={tick - since: blow for tick, blow in self.blows.items() if tick >= since}, random_blows=later,
        )  # fmt: skip


_ENDLESS = 1 << 60


@dataclass(frozen=True)
class Unlike:
    """How the plant differs from the model.

    mismatch: share by which its parameters differ; model_uncertainty: factor on the standard errors of the model's
    `uncertainty`, by which they differ besides, zero for none. initial_error rad: uniform ± on each angle of the first
    state. friction: factor on that of the plant drawn. plant: arms of its own, about which it is drawn in place of the
    model's.
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
    """Draw a run of `ticks` ticks, `period` s each, of the bench with these arms as the model.

    Raises:
        InputError: settings that do not fit these arms or this period; an uncertainty is asked for and not known.
        GoalMissed: no arms near the model's have the ratios drawn.
    """
    n, sensors, drive, blows = arms.count, settings.sensors, settings.drive, settings.disturbances
    if sensors.jitter > period:
        raise InputError(
            f"sensors: jitter = {sensors.jitter!r}: must be at most a period, {period:g} s; use the drive's delay for "
            "readings that are older"
        )
    children: dict[str, np.random.SeedSequence] = dict(
        zip(_STREAMS, np.random.SeedSequence(seed).spawn(len(_STREAMS)), strict=True)
    )

    def random(name: str) -> np.random.Generator:
        return np.random.default_rng(children[name])

    # What is not asked for is not drawn: making a generator takes longer than most draws.
    streams: dict[str, Stream] = {}

    def stream(name: str, make: Callable[[np.random.Generator, int], NDArray[Any]], wanted: Any) -> None:
        if wanted:
            streams[name] = Stream(children[name], make)

    def normal(name: str, sigmas: Array) -> None:
        stream(name, lambda source, count: source.standard_normal((count, len(sigmas))) * sigmas, sigmas.any())

    def within(name: str, most: float) -> Array:
        return random(name).uniform(-most, most, n) if most else np.zeros(n)

    def shares(name: str, count: int, width: int) -> Array:
        return random(name).uniform(size=(count, width)) if count else np.zeros((0, width))

    lost, noisy = sensors.missed_counts * period, drive.command_noise
    stream("command_noise", lambda source, count: source.standard_normal(count) * noisy, noisy)
    stream("ages", lambda source, count: source.uniform(0.0, sensors.jitter, count), sensors.jitter)
    stream("dropped", lambda source, count: source.uniform(size=count) < sensors.dropout, sensors.dropout)
    # Whole counts of the right mean: the whole part always, one more with the rest's probability.
    stream("missed", lambda source, count: np.floor(source.uniform(size=(count, n)) + lost).astype(np.int64), lost)
    normal("noise", np.array([*[sensors.noise] * n, sensors.cart_noise]))
    normal("rate_noise", np.full(n, sensors.rate_noise))
    if unlike.model_uncertainty and unlike.uncertainty is None:
        raise InputError(
            f"run: model_uncertainty = {unlike.model_uncertainty!r}: the model has no [uncertainty] to draw from; "
            "identify it from recordings, or use a mismatch"
        )
    likely = unlike.plant or arms
    if unlike.model_uncertainty and unlike.uncertainty is not None:
        likely = unlike.uncertainty.drawn(arms, random("model"), scale=unlike.model_uncertainty)
    true_arms = likely.mismatched(unlike.mismatch, random("plant"))
    if unlike.friction != 1.0:
        true_arms = true_arms.with_friction(unlike.friction)
    strokes = shares("pushes", blows.pushes, 3), shares("knocks", blows.knocks, 2)
    return BenchDraw(
        seed=seed, ticks=ticks, period=period,
        plant=settings.plant(true_arms, within("play", 0.5 if settings.mechanics.play else 0.0)),
        initial_error=within("initial_error", unlike.initial_error),
        initial_rate=within("initial_rate", settings.mechanics.initial_rate),
        zeros=within("zero_errors", sensors.zero_error),
        drift=np.copysign(sensors.zero_drift / 3600, within("zero_drift", sensors.zero_drift)),
        streams=streams,
        blows=_blows(settings, n, (ticks, period), *strokes),
        random_blows=lambda: _random_blows(blows, n, period, random("random_blows")),
    )  # fmt: skip


def _random_blows(
    settings: DisturbanceSettings, arms: int, period: float, random: np.random.Generator
) -> Iterator[tuple[int, Blow]]:
    """Yield blows on arms at random times, in order; none where none are asked for."""
    now = 0.0
    while settings.knocks_per_minute and settings.knock_impulse:
        now += random.exponential(60 / settings.knocks_per_minute)
        impulses = np.zeros(arms)
        impulses[random.integers(arms)] = random.uniform(-settings.knock_impulse, settings.knock_impulse)
        yield int(now / period), Blow(impulses, np.zeros(arms), 0.0)


def _blows(
    settings: BenchSettings, arms: int, clock: tuple[int, float], pushes: Array, knocks: Array
) -> dict[int, Blow]:
    """Return blows by tick from draws in [0, 1): pushes (time, arm, size), knocks (time, size)."""
    d, (ticks, period) = settings.disturbances, clock
    strokes: list[tuple[int, int, float, float, float]] = []
    for when, which, size in pushes.tolist():
        strokes.append((int(when * ticks), int(which * arms), (2 * size - 1) * d.push_impulse, 0.0, 0.0))
    strokes += [(int(when * ticks), 0, 0.0, 0.0, (2 * size - 1) * d.knock_velocity) for when, size in knocks.tolist()]
    for push in d.explicit:
        if push.arm >= arms:
            raise InputError(f"push: arm = {push.arm!r}: must be 0 to {arms - 1}")
        strokes.append((round(push.time / period), push.arm, push.impulse, push.rate, push.knock))
    out: dict[int, Blow] = {}
    for tick, arm, impulse, rate, knock in strokes:
        before = out.get(tick) or Blow(np.zeros(arms), np.zeros(arms), 0.0)
        one = np.eye(arms)[arm]
        out[tick] = Blow(before.impulses + impulse * one, before.jumps + rate * one, before.knock + knock)
    return out
