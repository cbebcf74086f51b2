"""NIS and NEES of many simulated runs at once: is the filter consistent with what it assumes?"""

from dataclasses import dataclass

import numpy as np
import pytest
from estimator_runs import MODEL, NOISE, SWING
from numpy.typing import NDArray
from scipy.stats import chi2

from dpcontrol.control.ekf import CompiledEkf, unpacked
from dpcontrol.control.estimator_settings import ADAPTIVE, EkfSettings, chi_square_band, nees, share_inside
from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.loop.bench import SensorSettings

SHARE = 0.02  # About 95 %; the bar for a nominal plant with the noise that is modelled.
Array = NDArray[np.float64]

_SETTLING = 0.2
"""Initial time without evaluation, s, because it depends on the prior."""
_EVERY = 20
"""Ticks between two values of NEES."""


@dataclass(frozen=True, eq=False)
class Consistency:
    """Shares of values within their 95 % bands, and means (freedom: n+1, N+E)."""

    nis_inside_95: float
    nees_inside_95: float
    mean_nis: float
    mean_nees: float


def simulated_consistency(
    ekf: CompiledEkf, ticks: int, *, runs: int, seed: int, steps: Array | None = None, process_noise: bool = True
) -> Consistency:
    """Run `runs` filters over a swing of a moving cart, with truths drawn from what the filter assumes.

    The truth obeys the filter's own equations, its process noise and its prior, so only linearisation, and optional
    rounding to encoder counts, violates the filter's assumptions. A truth without process noise would not do: the
    filter then expects more error than there is, and too many values fall inside.

        z⁺ = F(z, u) + w,  w ~ N(0, Q(z));    m = H z + v,  v ~ N(0, R), or relative angles rounded to counts

    The measurement has the noise that the filter assumes, unless `steps` (n+1,) are given, the encoders' resolutions in
    rad and m: then readings are rounded to them.
    Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, section 5.4.2.
    """
    random, first, commands = np.random.default_rng(seed), np.array(SWING), 0.5 * np.sin(2.5e-3 * np.arange(ticks))
    equations, size, arms = ekf.equations, ekf.equations.dimension, ekf.model.arms
    sigmas = np.sqrt(ekf.settings.first_covariance(arms).diagonal())
    h, root = equations.observation, np.linalg.cholesky(ekf.noise)
    linear = Compiled(equations.prediction(with_jacobian=True))
    start = np.concatenate([first, np.zeros(size - len(first))])[:, None]
    truth = start + sigmas[:, None] * random.standard_normal((size, runs))
    inputs, memory = (np.repeat(a[:, None], runs, axis=1) for a in (ekf.inputs, ekf.first(first).memory))
    inputs[ekf.whole.slices["present"]] = 1.0
    known = np.zeros((linear.size_in, runs))
    known[linear.slices["parameters"]] = ekf.model.parameters[:, None]
    known[linear.slices["process"]] = ekf.process[:, None]
    out, moved = np.empty((ekf.whole.size_out, runs)), np.empty((linear.size_out, runs))
    settled = int(_SETTLING / ekf.model.period)
    relative = np.eye(arms + 1) - np.diag([*([1.0] * (arms - 1)), 0.0], -1)
    sums = np.linalg.inv(relative)
    nis, errors = [], []
    for k, command in enumerate(commands):
        if k:
            known[linear.slices["z"]], known[linear.slices["command"]] = truth, command
            if equations.shares:
                # The noise that covers the squares of the parameters' errors follows from the filter's own variances.
                variances = unpacked(memory[size:].T)[:, equations.shares, equations.shares]
                known[linear.slices["noise_inputs"].start] = variances.mean(axis=1)
            linear(known, moved)
            truth = moved[:size].copy()
            if process_noise:
                q = moved[size + size * size :].T.reshape(runs, size, size)
                truth += np.einsum("sij,js->is", np.linalg.cholesky(q), random.standard_normal((size, runs)))
        positions = h @ truth
        if steps is None:
            positions = positions + root @ random.standard_normal((arms + 1, runs))
        else:
            positions = sums @ (np.rint(relative @ positions / steps[:, None]) * steps[:, None])
        inputs[ekf.whole.slices["memory"]] = memory
        inputs[ekf.whole.slices["command"]] = command
        inputs[ekf.whole.slices["measured"]] = positions
        (ekf.whole if k else ekf.correct)(inputs, out)
        memory = out[: ekf.out.slices.covariance.stop].copy()
        if k >= settled:
            nis.append(out[ekf.out.slices.nis][0].copy())
            if k % _EVERY == 0:
                p = unpacked(memory[size:].T)
                errors.append(nees((truth - memory[:size]).T, p))
    all_nis, all_nees = np.array(nis), np.array(errors)
    inside = share_inside(all_nis, arms + 1), share_inside(all_nees, size)
    return Consistency(*inside, float(all_nis.mean()), float(all_nees.mean()))


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
    found = simulated_consistency(ekf, 1500, runs=60, seed=8)
    assert found.nis_inside_95 == pytest.approx(0.95, abs=SHARE)
    assert found.nees_inside_95 == pytest.approx(0.95, abs=SHARE)
    assert found.mean_nis == pytest.approx(3.0, rel=0.02)
    assert found.mean_nees == pytest.approx(ekf.equations.dimension, rel=0.05)


@pytest.mark.slow
def test_noise_covers_the_squares_of_the_parameters_errors() -> None:
    # Parameters with errors of a seventh, as for arms off by ±20 %: only the linearisation is wrong.
    known, size, means = {**ADAPTIVE, "augment": ("parameters",), "model_error": 0.14, "rate_noise": 2e-4}, 6 + 4, []
    for nonlinearity in (0.0, ADAPTIVE["nonlinearity"]):
        ekf = CompiledEkf(MODEL, EkfSettings(**{**known, "nonlinearity": nonlinearity}), noise=NOISE)
        means.append(simulated_consistency(ekf, 700, runs=24, seed=8, process_noise=False).mean_nees)
    without, covered = means
    assert covered < 1.5 * size < without


def test_rounding_to_counts_keeps_the_mean_and_puts_too_many_inside() -> None:
    # A rounding error is uniform: of the assumed variance, but without the Gaussian's tails.
    counts = 2000
    steps = np.array([2 * np.pi / counts] * 2 + [1e-6])
    noise = SensorSettings(counts=counts).covariance(2)
    ekf = CompiledEkf(MODEL, EkfSettings(augment=()), noise=noise)
    found = simulated_consistency(ekf, 1000, runs=40, seed=2, steps=steps)
    assert found.mean_nis == pytest.approx(3.0, rel=0.03)
    assert found.nis_inside_95 > 0.97
