"""Lost samples and stuck encoders: the border by the theory of runs, and both sides of it in the loop."""

import math

import numpy as np
import pytest

from dpcontrol.bench.edges import (
    MOVED,
    STILL,
    arriving,
    earliest_report,
    lost_border,
    stuck_border,
)
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.plans.model import load_model
from dpcontrol.references.sustained import sustained_orbit

APART = 0.25  # the bar
LAB = load_model("lab")


@pytest.mark.parametrize("rate", [50.0, 200.0])
def test_half_of_many_drawn_runs_see_a_gap_at_the_predicted_share(rate):
    missing, seconds = 0.1, 10.0
    p = 1 - arriving(rate, missing=missing, seconds=seconds) / rate
    gap, ticks = math.floor(missing * rate + 1e-9) + 1, round(seconds * rate)
    lost = np.random.default_rng(3).uniform(size=(1000, ticks)) < p
    windows = np.lib.stride_tricks.sliding_window_view(lost, gap, axis=1)
    share = windows.all(axis=2).any(axis=1).mean()
    # 1,000 draws: ±0.03 at two standard deviations; gaps are not quite independent at so few ticks.
    assert share == pytest.approx(0.5, abs=0.08)


@pytest.mark.slow
def test_runs_end_at_the_predicted_share_of_lost_samples_with_a_reason():
    found = lost_border(LAB.arms, LAB.system.equilibrium("down-up"), rate=60.0, seeds=5)
    assert found.off is not None
    assert found.off < APART
    assert "estimate lost" in found.says
    assert "no measurement for" in found.says


@pytest.mark.benchmark
def test_a_stuck_encoder_is_reported_after_what_must_pass_and_not_long_after():
    orbit = sustained_orbit(lyapunov_orbit(LAB.system, "down-up", energy=-0.07), LAB.arms)
    found = stuck_border(LAB.arms, orbit, phase=0.3)
    assert found.near is not None
    assert found.far is not None
    assert "the encoder of joint 2 is stuck" in found.says
    least = earliest_report(orbit, 0.3 * orbit.period, sensor=1)
    assert least >= STILL
    assert least <= found.far < least + 0.1
    # An arm that has moved less than required is not reported.
    assert 100 * 2 * np.pi / 40_000 < MOVED
