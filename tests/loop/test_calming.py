"""Calming: from whatever a fall leaves the arms are brought to hang at rest, the cart inside its track."""

import numpy as np
import pytest
from calmed_runs import LIMITS, calmed

from dpcontrol.control.calming import CalmingSettings, calming_controller
from dpcontrol.loop.loop import sampled_model
from dpcontrol.plans.model import load_model


@pytest.fixture(scope="module")
def runs():
    # As many as fill a processor's vector; the benchmark measures hundreds, of which 99 % take 6 s.
    return calmed(list(range(8)), seconds=8.0)


@pytest.mark.slow
def test_arms_left_by_a_fall_come_to_rest(runs) -> None:
    assert np.isfinite(runs.times).all()


@pytest.mark.slow
def test_the_cart_never_meets_its_stop_while_it_calms(runs) -> None:
    assert not runs.faults
    assert runs.farthest.max() < LIMITS.position


@pytest.mark.slow
def test_arms_that_a_blow_has_made_fast_come_to_rest_too() -> None:
    # 0.03 N m s on the outer arm are some 40 rad/s; the energy law alone would feed five of these.
    runs = calmed(list(range(8)), seconds=8.0, fastest=45.0)
    assert np.isfinite(runs.times).all()
    assert not runs.faults


def test_the_common_energy_of_arms_and_imitated_cart_only_falls() -> None:
    # Its law in plain arithmetic: m v + P changes by spring and damper alone, whatever the arms do.
    model, settings = sampled_model(load_model("lab").arms, 1000.0), CalmingSettings(near=1e-9, fast=100.0, braking=1.0)
    law = calming_controller(model, LIMITS, settings, reaction=0.0, seconds=1.0)
    state, energies, m = np.array([2.0, -1.0, 5.0, -8.0, 0.1, 0.0]), [], 0.2554
    base = model.parameters
    m11, m12, m22, g1, g2, s1, s2 = base[:7]
    session = law.begin()
    for tick in range(1500):
        a, b, p, q, x, v = state
        momentum = s1 * np.cos(a) * p + s2 * np.cos(b) * q
        arms = (m11 * p * p + m22 * q * q) / 2 + m12 * np.cos(a - b) * p * q - g1 * np.cos(a) - g2 * np.cos(b)
        spring = 0.75 * 0.2043 * 5.7106**2
        energies.append(arms + momentum * v + m * v * v / 2 + spring * (x**2 / 2 + x**4 / LIMITS.position**2))
        state = model.step(state, session.command(tick, state, np.empty(0)).feedback)
    # Commands that are held for a period give a little back.
    assert np.diff(energies).max() < 1e-4
    assert energies[-1] < energies[0] - 0.5
