"""Lost samples: the border by the theory of runs, and in the loop."""

import math

import numpy as np
import pytest

from dpcontrol.bench.edges import arriving, lost_border
from dpcontrol.plans.model import load_model

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
def test_runs_end_at_the_predicted_share_of_lost_samples():
    found = lost_border(LAB.arms, LAB.system.equilibrium("down-up"), rate=60.0, seeds=5)
    assert found.off < APART
