"""Plants drawn from how well a model is known: spread as its covariance says, other draws untouched."""

import numpy as np
import pytest

from dpcontrol.dynamics.chain import Uncertainty, base_ratios, ratio_names
from dpcontrol.loop.bench import (
    BenchDraw,
    BenchSettings,
    DisturbanceSettings,
    DriveSettings,
    SensorSettings,
    Unlike,
    draw_bench,
)
from dpcontrol.plans.model import load_model

LAB = load_model("lab").arms
RATIOS = base_ratios(LAB)
# 0.2 % of each ratio, equal errors of the first two. At ten times that, most drawn ratios belong to no arms.
CORRELATION = np.eye(len(RATIOS))
CORRELATION[0, 1] = CORRELATION[1, 0] = 0.8
SHARE = 2e-3
KNOWN_TO = Uncertainty(ratio_names(LAB), tuple((SHARE**2 * CORRELATION * np.outer(RATIOS, RATIOS)).ravel()))
DRAWS = 200
SPREAD = 0.2  # a standard deviation of 200 draws is itself known to 5 %
NOISY = BenchSettings(
    SensorSettings(noise=1e-4, zero_error=1e-3, missed_counts=2.0, dropout=0.01, jitter=1e-4, rate_noise=0.01),
    DriveSettings(command_noise=0.1),
    DisturbanceSettings(pushes=2, push_impulse=1e-3, knocks=1, knock_velocity=0.1),
)


def _draw(scale: float, seed: int = 3, *, mismatch: float = 0.0) -> BenchDraw:
    unlike = Unlike(mismatch, scale, KNOWN_TO, initial_error=0.02)
    return draw_bench(LAB, NOISY, seed=seed, ticks=200, period=1e-3, unlike=unlike)


@pytest.mark.slow
@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_plants_have_the_covariance_times_the_scale(scale: float) -> None:
    away = np.stack([base_ratios(_draw(scale, seed).plant.arms) / RATIOS - 1 for seed in range(DRAWS)])
    assert away.std(axis=0) == pytest.approx(np.full(len(RATIOS), scale * SHARE), rel=SPREAD)
    alike = np.asarray(np.corrcoef(away[:, :4].T))
    assert alike[0, 1] == pytest.approx(0.8, abs=0.08)
    assert np.abs(alike[0, 2:]).max() < 0.25


def test_only_the_plant_is_drawn_anew_and_a_mismatch_comes_on_top() -> None:
    plain, alone, both, drawn = (_draw(scale, mismatch=m) for scale, m in ((0, 0), (0, 0.05), (1, 0.05), (1, 0)))
    assert plain.plant.arms == LAB != drawn.plant.arms
    for one in (alone, both, drawn):
        assert np.array_equal(one.initial_error, plain.initial_error)
        assert np.array_equal(one.zeros, plain.zeros)
        assert one.streams.keys() == plain.streams.keys()
        assert all(np.array_equal(one.drawn(name), plain.drawn(name)) for name in plain.streams)
        assert [(k, b.knock, *b.impulses) for k, b in one.blows.items()] == [
            (k, b.knock, *b.impulses) for k, b in plain.blows.items()
        ]
    share = np.array(alone.plant.arms.mass) / np.array(LAB.mass)
    assert np.array(both.plant.arms.mass) == pytest.approx(share * np.array(drawn.plant.arms.mass), rel=1e-12)
