"""Readings of unknown age, and readings with their ages: what the loop makes of them."""

from dataclasses import replace

import numpy as np
import pytest
from shadowing_stand_in import LAB

from dpcontrol.control.estimator_settings import ADAPTIVE, EkfSettings
from dpcontrol.control.tracking import AdaptiveSettings
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.bench import DriveSettings, SensorSettings
from dpcontrol.loop.loop import ControlLoop, LoopSettings
from dpcontrol.loop.result import Ending, LoopResult
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.references.reference import Reference

PERIOD = 1e-3
SETTINGS = LoopSettings(
    seed=5, mismatch=0.05, initial_error=0.05, travel=0.8, controller=AdaptiveSettings(),
    estimator=EkfSettings(**ADAPTIVE), drive=DriveSettings(lag=0.005, command_noise=0.3),
)  # fmt: skip
FOUND = 0.35
"""Share by which the found deviation of the ages may miss the true one: arms at rest show none of it."""


def flown(reference: Reference, sensors: SensorSettings) -> tuple[LoopResult, ControlLoop]:
    settings = replace(SETTINGS, sensors=sensors)
    assembly = Assembly(reference, LAB, settings)
    loop, start = assembly.loop(), assembly.controller.first_state
    bench = SimulatedRig(assembly.draw(), settings.bench, limits=assembly.limits, start=start, queued=loop.queued)
    return loop.run(bench), loop


def deviation(loop: ControlLoop) -> float:
    """Return the standard deviation of the readings' age that the loop has found, s."""
    return float(np.sqrt(loop.ticker.program.memory.timing[0, 0]))


def rate_errors(result: LoopResult) -> float:
    truth = result.ticks.truth
    assert truth is not None
    return float(np.sqrt(np.mean((result.ticks.estimates - truth)[500:, 2:4] ** 2)))


@pytest.mark.slow
@pytest.mark.parametrize("jitter", [0.0, 1e-3])
def test_the_spread_of_the_readings_ages_is_found(reference: Reference, jitter: float) -> None:
    result, loop = flown(reference, SensorSettings(jitter=jitter))
    assert result.ending is Ending.FINISHED
    # Uniform ages: their variance is a twelfth of their span squared.
    uniform = jitter / np.sqrt(12)
    assert deviation(loop) == pytest.approx(uniform, rel=FOUND, abs=0.02 * PERIOD)


@pytest.mark.slow
def test_a_reported_age_leaves_the_rates_as_good_as_without_jitter(reference: Reference) -> None:
    jitter = SensorSettings(jitter=PERIOD)
    steady, unknown, known = (
        rate_errors(flown(reference, sensors)[0])
        for sensors in (SensorSettings(), jitter, replace(jitter, ages="reported"))
    )
    assert known < 1.2 * steady
    assert unknown > 1.5 * known
