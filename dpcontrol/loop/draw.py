"""Everything random in a run, drawn beforehand from its seed: one stream of numbers for each use.

A change of one setting leaves all other draws as they were, and a longer run begins like a shorter one. The same draws
serve the bench tick by tick and many seeds in lockstep.

Source of the streams: O'Neill's seed sequences as in numpy.random.SeedSequence.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.dynamics.plant import PlantParameters
from dpcontrol.dynamics.ratios import Uncertainty
from dpcontrol.foundation.errors import InputError
from dpcontrol.loop.bench import BenchSettings

Array = NDArray[np.float64]

# Their order is that of the seed's streams: append only, or old seeds give other runs.
_STREAMS = ("plant", "initial_error", "zero_errors", "command_noise", "ages", "dropped", "missed", "noise",
            "rate_noise", "pushes", "knocks", "model")  # fmt: skip


@dataclass(frozen=True, eq=False)
class Blow:
    """What strikes at one tick: impulses (n,) N m s, jumps (n,) rad/s, knock m/s."""

    impulses: Array
    jumps: Array
    knock: float


@dataclass(frozen=True, eq=False)
class BenchDraw:
    """One run's draws for n arms and K ticks; None stands for none of the kind, which costs nothing.

    plant; initial_error (n,) rad on the angles; zeros (n,) rad of the encoders; command_noise (K,) m/s²; ages (K,) s of
    the readings; dropped (K,): ticks without reading; missed (K, n): counts lost where the joint moves; noise (K, n+1)
    on relative angles, rad, and cart, m; rate_noise (K, n) rad/s on estimated rates; blows by their tick.
    """

    seed: int
    ticks: int
    period: float
    plant: PlantParameters
    initial_error: Array
    zeros: Array
    command_noise: Array | None
    ages: Array | None
    dropped: NDArray[np.bool_] | None
    missed: NDArray[np.int64] | None
    noise: Array | None
    rate_noise: Array | None
    blows: Mapping[int, Blow]


def draw_bench(
    arms: ArmChainParameters,
    settings: BenchSettings,
    *,
    seed: int,
    ticks: int,
    period: float,
    mismatch: float = 0.0,
    model_uncertainty: float = 0.0,
    uncertainty: Uncertainty | None = None,
    initial_error: float = 0.0,
    plant: ArmChainParameters | None = None,
) -> BenchDraw:
    """Draw a run of `ticks` ticks, `period` s each, of the bench with these arms as the model.

    mismatch: share by which the plant's parameters differ; model_uncertainty: factor on the standard errors of the
    model's `uncertainty`, by which they differ besides, zero for none. initial_error rad: uniform ± on each angle of
    the first state. plant: the arms to simulate in place of drawn ones.

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
    def normal(name: str, sigmas: Array) -> Array | None:
        return random(name).standard_normal((ticks, len(sigmas))) * sigmas if sigmas.any() else None

    def within(name: str, most: float) -> Array:
        return random(name).uniform(-most, most, n) if most else np.zeros(n)

    def shares(name: str, count: int, width: int) -> Array:
        return random(name).uniform(size=(count, width)) if count else np.zeros((0, width))

    command_noise = normal("command_noise", np.array([drive.command_noise]))
    lost = sensors.missed_counts * period
    if model_uncertainty and uncertainty is None:
        raise InputError(
            f"run: model_uncertainty = {model_uncertainty!r}: the model has no [uncertainty] to draw from; identify it "
            "from recordings, or use a mismatch"
        )
    likely = arms
    if model_uncertainty and uncertainty is not None and plant is None:
        likely = uncertainty.drawn(arms, random("model"), scale=model_uncertainty)
    true_arms = plant or likely.mismatched(mismatch, random("plant"))
    return BenchDraw(
        seed=seed,
        ticks=ticks,
        period=period,
        plant=settings.plant(true_arms),
        initial_error=within("initial_error", initial_error),
        zeros=within("zero_errors", sensors.zero_error),
        command_noise=None if command_noise is None else command_noise[:, 0],
        ages=random("ages").uniform(0.0, sensors.jitter, ticks) if sensors.jitter else None,
        dropped=random("dropped").uniform(size=ticks) < sensors.dropout if sensors.dropout else None,
        # Whole counts of the right mean: the whole part always, one more with the rest's probability.
        missed=np.floor(random("missed").uniform(size=(ticks, n)) + lost).astype(np.int64) if lost else None,
        noise=normal("noise", np.array([*[sensors.noise] * n, sensors.cart_noise])),
        rate_noise=normal("rate_noise", np.full(n, sensors.rate_noise)),
        blows=_blows(
            settings, n, (ticks, period), shares("pushes", blows.pushes, 3), shares("knocks", blows.knocks, 2)
        ),
    )  # fmt: skip


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
