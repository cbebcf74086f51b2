"""Maps of failure of estimation: how many samples may be lost, and how soon a stuck encoder is reported.

Lost samples: of K ticks each is lost with probability p. A run is ended by a gap of m ticks, longer than the supervisor
allows; gaps of at least m begin K (1 - p) pᵐ times on average, nearly independently: half of the runs see none at

    K (1 - p) pᵐ = ln 2

Stuck encoder: it differs from a still arm only once the reference has moved 0.02 rad from the reading and 15 ms have
passed; the filter's doubt comes on top, so this is a lower bound.

Source: Feller, An Introduction to Probability Theory and Its Applications I, 3rd ed., section XIII.7, for runs.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.edges import Attempt, Border, EdgeChart, EdgeMap, borders, find_border, half_of
from dpcontrol.control.lqr import HoldSettings, hold_controller
from dpcontrol.control.periodic import orbit_controller
from dpcontrol.control.tracking import TvlqrSettings
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.progress import Progress, part_of
from dpcontrol.loop.bench import SensorSettings
from dpcontrol.loop.loop import LoopSettings, run_loop, sampled_model
from dpcontrol.loop.result import Ending
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import still
from dpcontrol.references.sustained import SustainedOrbit, sustained_orbit
from dpcontrol.scenes.model import load_model

Array = NDArray[np.float64]

SADDLE = "down-up"
RATES = (50.0, 100.0, 200.0, 400.0)
QUICK_RATES = (100.0,)
SECONDS = 10.0
SEEDS = 9
PHASES = (0.1, 0.3, 0.5, 0.7, 0.9)
QUICK_PHASES = (0.3,)
BEFORE = 0.5
"""s of the run before a sensor sticks, at least."""
MOVED, STILL = 0.02, 0.015
"""rad and s: what distinguishes a stuck joint from a still one."""


def chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: one rate, one phase, fewer seeds."""
    model = load_model("lab")
    rates, phases, seeds = (QUICK_RATES, QUICK_PHASES, 5) if quick else (RATES, PHASES, SEEDS)
    equilibrium = model.system.equilibrium(SADDLE)
    lost = borders(
        lambda rate: lost_border(model.arms, equilibrium, rate=rate, seeds=seeds), rates, part_of(progress, 0.0, 0.6),
        "lost samples at {:g} Hz",
    )  # fmt: skip
    orbit = sustained_orbit(lyapunov_orbit(model.system, SADDLE, energy=-0.07), model.arms)
    stuck = borders(
        lambda phase: stuck_border(model.arms, orbit, phase=phase), phases, part_of(progress, 0.6, 1.0),
        "stuck at phase {:g}",
    )  # fmt: skip
    return EdgeChart(
        name="edges-estimation",
        title="Where estimates end: samples lost, an encoder stuck",
        maps=(
            EdgeMap("Lost samples", "rate of the loop, Hz", "samples that arrive, per s", lost, far="lost",
                    theory="a gap of 0.1 s is as likely as not in 10 s"),
            EdgeMap("A stuck encoder of the outer arm, on the orbit about Down-Up", "phase at which it sticks",
                    "seconds until it is reported", stuck, far="reported", near="goes on", log_x=False),
        ),
        reading=(
            "Left: the filter flies through gaps on its model; the supervisor ends the run after 0.1 s without any.",
            "Right: a stuck encoder is recognised by what the arm should have done meanwhile.",
            "Circles come to the end, crosses end with the sentence in the data; diamonds are predicted.",
        ),
        chosen="0.1 s without a sample: an error at Down-Up grows 2.2-fold in it, far within authority.",
    )  # fmt: skip


def arriving(rate: float, *, missing: float, seconds: float) -> float:
    """Return the samples per s that must arrive for half of the runs to see no gap longer than `missing` s."""
    ticks, gap = seconds * rate, math.floor(missing * rate + 1e-9) + 1
    # Gaps become more with p up to p = m / (m + 1); the border lies below.
    low, high = 1e-6, gap / (gap + 1)
    for _ in range(100):
        p = (low + high) / 2
        low, high = (low, p) if ticks * (1 - p) * p**gap > math.log(2) else (p, high)
    return (1 - low) * rate


def lost_border(arms: ArmChainParameters, equilibrium: Array, *, rate: float, seeds: int = SEEDS) -> Border:
    """Return how many samples per s must arrive for half of the runs to hold the equilibrium for ten seconds."""
    settings = LoopSettings(seed=0, rate=rate, controller=HoldSettings(), initial_error=0.01)
    controller = hold_controller(equilibrium, sampled_model(arms, rate), HoldSettings(), seconds=SECONDS)
    reference = still(controller.state, SECONDS, method=method_named("radau-7"), limits=Limits(), interval=1.0)

    def probe(kept: float) -> Attempt:
        one = replace(settings, sensors=SensorSettings(dropout=1 - kept / rate))
        runs = [
            run_loop(reference, arms, settings=replace(one, seed=seed), controller=controller) for seed in range(seeds)
        ]
        return half_of([Attempt(run.ending is Ending.FINISHED, run.reason) for run in runs], "runs lost")

    predicted = arriving(rate, missing=settings.supervisor.missing, seconds=SECONDS)
    return find_border(
        probe, x=rate, line=f"{rate:g} Hz", near=min(1.6 * predicted, rate), far=predicted / 1.8, predicted=predicted,
        ratio=1.12,
    )  # fmt: skip


def earliest_report(orbit: SustainedOrbit, since: float, *, sensor: int) -> float:
    """Return the seconds after which a reading that sticks at `since` s on the clock differs from a still arm's."""
    after = np.arange(0.0, orbit.period, 1e-3)
    angles = orbit.state(since + after)
    joint = angles[:, sensor] - (angles[:, sensor - 1] if sensor else 0.0)
    return max(float(after[int(np.argmax(np.abs(joint - joint[0]) >= MOVED))]), STILL)


def stuck_border(arms: ArmChainParameters, orbit: SustainedOrbit, *, phase: float, sensor: int = 1) -> Border:
    """Return the seconds for which a run that holds an orbit goes on after its encoder has stuck."""
    model = sampled_model(arms, 1000.0)
    wholes = math.ceil(BEFORE / orbit.period)
    at = round((wholes + phase) * orbit.period, 3)
    settings = LoopSettings(seed=0, sensors=SensorSettings(stuck_at=at, stuck_sensor=sensor))

    def probe(after: float) -> Attempt:
        controller = orbit_controller(orbit, model, TvlqrSettings(), seconds=at + after)
        run = run_loop(orbit.reference, arms, settings=settings, controller=controller)
        return Attempt(run.ending is Ending.FINISHED, "" if run.ending is Ending.FINISHED else run.reason)

    least = earliest_report(orbit, at % orbit.period, sensor=sensor)
    return find_border(probe, x=phase, line=f"{phase:g}", near=least / 2, far=8 * least, ratio=1.1, unit=1e-3)
