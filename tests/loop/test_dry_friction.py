"""Holding Up-Up against dry friction in the plant, known to the model or not."""

from dataclasses import replace

import numpy as np
import pytest
from shadowing_stand_in import LAB

from dpcontrol.control.interface import sampled_model

ROUGH = replace(LAB, coulomb=(0.002, 0.001), smoothing=0.005)


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
