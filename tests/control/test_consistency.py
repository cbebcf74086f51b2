from dataclasses import replace

import numpy as np
import pytest
from estimator_runs import MODEL, NOISE, SWING
from scipy.stats import chi2
from simulated_consistency import simulated_consistency

from dpcontrol.control.ekf import CompiledEkf
from dpcontrol.control.estimator_settings import ADAPTIVE, EkfSettings, chi_square_band, share_inside
from dpcontrol.loop.bench import SensorSettings

SHARE = 0.02  # About 95 %; the bar for a nominal plant with the noise that is modelled.


def test_bands_are_the_published_ones() -> None:
    # Chi-square with 3 degrees of freedom, 2.5 and 97.5 %: Abramowitz & Stegun, table 26.8.
    assert chi_square_band(3) == pytest.approx((0.215795, 9.34840), rel=1e-5)
    for freedom in (1, 2, 8, 150):
        expected = chi2.ppf([0.025, 0.975], freedom)
        assert chi_square_band(freedom) == pytest.approx(tuple(expected), rel=1e-12)


def test_too_small_counts_as_outside_as_well_as_too_large() -> None:
    random = np.random.default_rng(4)
    values = random.chisquare(6, 40_000)
    assert share_inside(values, 6) == pytest.approx(0.95, abs=0.005)
    assert share_inside(values / 20, 6) < 0.2
    assert share_inside(values * 20, 6) < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("augment", [(), ("friction", "parameters")])
def test_nis_and_nees_of_a_nominal_plant_lie_in_their_bands(augment: tuple[str, ...]) -> None:
    ekf = CompiledEkf(MODEL, EkfSettings(augment=augment), noise=NOISE)
    commands = 0.5 * np.sin(2.5e-3 * np.arange(1500))
    found = simulated_consistency(ekf, first=np.array(SWING), commands=commands, runs=60, seed=8)
    assert found.nis_inside_95 == pytest.approx(0.95, abs=SHARE)
    assert found.nees_inside_95 == pytest.approx(0.95, abs=SHARE)
    assert found.mean_nis == pytest.approx(3.0, rel=0.02)
    assert found.mean_nees == pytest.approx(ekf.equations.dimension, rel=0.05)


@pytest.mark.slow
def test_noise_covers_the_squares_of_the_parameters_errors() -> None:
    # Parameters with errors of a seventh, as for arms off by ±20 %: only the linearisation is wrong.
    commands, size = 0.5 * np.sin(2.5e-3 * np.arange(700)), 6 + 4
    found = {}
    for nonlinearity in (0.0, ADAPTIVE["nonlinearity"]):
        settings = replace(
            EkfSettings(**ADAPTIVE),
            augment=("parameters",),
            model_error=0.14,
            nonlinearity=nonlinearity,
            rate_noise=2e-4,
        )
        found[nonlinearity] = simulated_consistency(
            CompiledEkf(MODEL, settings, noise=NOISE), first=np.array(SWING), commands=commands, runs=24, seed=8,
            process_noise=False,
        ).mean_nees  # fmt: skip
    without, covered = found.values()
    assert covered < 1.5 * size < without


def test_rounding_to_counts_keeps_the_mean_and_puts_too_many_inside() -> None:
    # A rounding error is uniform: of the assumed variance, but without the Gaussian's tails.
    counts = 2000
    steps = np.array([2 * np.pi / counts] * 2 + [1e-6])
    noise = SensorSettings(counts=counts).covariance(2)
    ekf = CompiledEkf(MODEL, EkfSettings(augment=()), noise=noise)
    commands = 0.5 * np.sin(2.5e-3 * np.arange(1000))
    found = simulated_consistency(ekf, first=np.array(SWING), commands=commands, runs=40, seed=2, steps=steps)
    assert found.mean_nis == pytest.approx(3.0, rel=0.03)
    assert found.nis_inside_95 > 0.97
