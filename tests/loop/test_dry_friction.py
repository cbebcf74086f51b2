"""Holding Up-Up against dry friction in the plant, known to the model or not."""

from dataclasses import replace

import numpy as np
import pytest
from shadowing_stand_in import LAB

from dpcontrol.control.interface import sampled_model
from dpcontrol.control.lqr import HoldController
from dpcontrol.loop.assembly import Assembly
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan

HELD = 0.1  # rad: as the score allows.
SECONDS = 5.0
ROUGH = replace(LAB, coulomb=(0.002, 0.001), smoothing=0.005)
BENCH = {
    "initial_error": 0.05,
    "lag": 0.005,
    "command_noise": 0.3,
    "zero_error": 0.02,
    "counts": 40_000,
    "travel": 0.8,
    "mismatch": 0.05,
}


@pytest.mark.slow
@pytest.mark.parametrize("told", [True, False])
def test_up_up_is_held_against_dry_friction(told: bool) -> None:
    scene = load_itinerary("hold-up-up").with_run(BENCH)
    reference, settings = make_plan(scene).reference, replace(scene.loop, plant=ROUGH)
    model = ROUGH if told else LAB
    law = Assembly(reference, model, settings).controller
    assert isinstance(law, HoldController)
    law = replace(law, ticks=round(SECONDS * settings.rate))
    runs = Assembly(reference, model, settings, law=law).batch(range(8))
    for run in runs:
        last = np.abs(run.truth[-1000:, :2] - np.pi).max()
        assert len(run.times) > SECONDS * settings.rate
        assert last < HELD


def test_a_sampled_model_is_linearised_at_the_mean_slope_of_dry_friction() -> None:
    at_rest = np.array([[np.pi, np.pi, 0.0, 0.0, 0.0, 0.0]])
    model = sampled_model(ROUGH, 1000.0)
    base = LAB.base()
    width = max(0.002 / np.sqrt(base[3] * base[0]), 0.001 / np.sqrt(base[4] * base[2])) / 0.2
    viscous = replace(LAB, viscous=(LAB.viscous[0] + 0.002 / width, LAB.viscous[1] + 0.001 / width))
    found, expected = (m.linearised(at_rest, np.zeros(1))[0][0] for m in (model, sampled_model(viscous, 1000.0)))
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)
    # The step itself keeps the friction: a slow joint meets nearly all of it.
    slow = at_rest[0] + np.array([0, 0, 0.1, 0.1, 0, 0])
    lost = model.step(slow, 0.0)[2] - sampled_model(LAB, 1000.0).step(slow, 0.0)[2]
    assert lost < -1e-3 * 0.002 / base[0]
