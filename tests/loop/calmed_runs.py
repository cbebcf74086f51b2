"""Runs that begin as a fall leaves them: arms anywhere and fast, the cart moving, the estimate lost; and are calmed."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.calming import CalmingSettings, calming_controller
from dpcontrol.control.estimator_settings import AdaptiveEkfSettings
from dpcontrol.control.interface import MANY
from dpcontrol.dynamics.compiled import VECTOR
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.bench import DriveSettings, SensorSettings
from dpcontrol.loop.loop import LoopSettings, sampled_model
from dpcontrol.loop.recovery import calming_bounds
from dpcontrol.loop.simulated import BatchBench
from dpcontrol.plans.model import load_model
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import still

Array = NDArray[np.float64]

LIMITS = Limits(position=0.4)
FASTEST = 15.0
"""rad/s: of an arm that a fall leaves."""
ANGLE, RATE = 0.05, 0.1
"""rad and rad/s: what counts as at rest, by the true state."""
CENTRE = 0.02
"""The same for the cart, m and m/s."""


@dataclass(frozen=True)
class Calmed:
    """Of S runs: when each came to rest for good, s (inf: not), the cart's farthest, m, and faults by run."""

    times: Array
    farthest: Array
    faults: dict[int, str]


def fallen_states(seeds: list[int], fastest: float = FASTEST) -> Array:
    """Return states (S, 6) that falls may leave, rates to `fastest` rad/s: the cart can be stopped on its track."""
    out = []
    for seed in seeds:
        random = np.random.default_rng([seed, 19])
        arms = [*random.uniform(-np.pi, np.pi, 2), *random.uniform(-fastest, fastest, 2)]
        while True:
            x, v = random.uniform(-LIMITS.position, LIMITS.position), random.uniform(-LIMITS.velocity, LIMITS.velocity)
            # As the supervisor decides it, which brakes at half of the greatest acceleration.
            if np.sign(v) * (x + 0.002 * v) + v**2 / LIMITS.acceleration < LIMITS.position - 0.002:
                break
        out.append([*arms, x, v])
    return np.array(out)


def calmed(
    seeds: list[int], *, seconds: float, settings: CalmingSettings | None = None, fastest: float = FASTEST, **loop: Any
) -> Calmed:
    """Calm the arms of these seeds' plants from `fallen_states`, the filter beginning with nothing but readings."""
    arms = load_model("lab").arms
    known = {"mismatch": 0.2, **loop}
    run = LoopSettings(
        seed=0, estimator=AdaptiveEkfSettings(), drive=DriveSettings(lag=0.005, command_noise=0.3),
        sensors=SensorSettings(zero_error=0.01), **known,
    )  # fmt: skip
    law = calming_controller(
        sampled_model(arms, run.rate), LIMITS, settings or CalmingSettings(), reaction=0.002, seconds=seconds
    )
    # The bench and the filter compute full vectors of the processor.
    lanes, count = [*seeds, *seeds[-1:] * (-len(seeds) % VECTOR)], len(seeds)
    start = fallen_states(lanes, fastest)
    draws = [run.draw(arms, ticks=law.ticks + 1, seed=seed) for seed in lanes]
    nowhere = still(np.zeros(6), 1.0, method=method_named("radau-7"), limits=LIMITS, interval=1.0)
    ticker = Assembly(nowhere, arms, run, law=law).ticker(runs=len(lanes))
    bench = BatchBench(draws, run.bench, limits=LIMITS, start=start, queued=list(ticker.queued), lanes=MANY)
    ticker.lose()
    # What is known of the cart is not lost with the arms.
    memory = ticker.program.memory
    for part in (memory.z[5:6], memory.velocity, memory.heading):
        part[:] = start[:, 5]
    ticker.program.bound(**calming_bounds(LIMITS))
    rest, farthest = np.full(len(lanes), np.inf), np.zeros(len(lanes))
    with np.errstate(all="ignore"):
        for k in range(law.ticks):
            report = ticker(k, bench.read())
            bench.command(report.command[0])
            truth = bench.truth
            farthest = np.maximum(farthest, np.abs(truth[4]))
            away = np.abs(truth[:2] - 2 * np.pi * np.rint(truth[:2] / (2 * np.pi))).max(0)
            calm = (away <= ANGLE) & (np.abs(truth[2:4]).max(0) <= RATE) & (np.abs(truth[4:]).max(0) <= CENTRE)
            rest = np.where(calm, np.minimum(rest, k / run.rate), np.inf)
    faults = {lane: text for lane, text in bench.faults.items() if lane < count}
    return Calmed(rest[:count], farthest[:count], faults)
