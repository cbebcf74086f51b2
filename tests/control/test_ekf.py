import numpy as np
import pytest
from shadowing_stand_in import LAB

from dpcontrol.control.ekf import Ekf, EkfSettings, encoder_noise, nis_band
from dpcontrol.control.sampled import SampledModel
from dpcontrol.dynamics.arm_chain import Level, arm_chain_equations
from dpcontrol.foundation.errors import InputError

ROUNDING = 1e-9  # Relative, of small matrix products and one inverse.
NOISE = encoder_noise(2, counts=40_000, cart_resolution=1e-6)
STATE = np.array([0.4, 2.8, 6.0, -9.0, 0.1, -0.3])
POSITIONS = np.eye(6)[[0, 1, 4]]


@pytest.fixture(scope="module")
def ekf() -> Ekf:
    model = SampledModel(arm_chain_equations(2, Level.CART), LAB.base(), period=1e-3)
    return Ekf(model, EkfSettings(), noise=NOISE)


def test_summed_relative_encoders_have_correlated_noise() -> None:
    random = np.random.default_rng(1)
    q = 2 * np.pi / 40_000
    rounding = np.cumsum(random.uniform(-q / 2, q / 2, (400_000, 3)), axis=1)
    noise = encoder_noise(3, counts=40_000, cart_resolution=1e-6)
    assert noise[:3, :3] == pytest.approx(np.cov(rounding.T), rel=0.02)
    assert noise[3, 3] == pytest.approx(1e-12 / 12)
    assert not noise[3, :3].any()


def test_prediction_and_update_are_the_textbook_filter(ekf: Ekf) -> None:
    first = ekf.first(STATE)
    before = first.covariance.copy()
    predicted = ekf.predict(first, 2.0)
    following, a = (v.copy() for v in ekf.model.step_with_jacobian(STATE, 2.0))
    settings = ekf.settings
    q = np.zeros((6, 6))
    t = 1e-3
    change = (following - STATE)[2:4]
    density = settings.rate_noise**2 + 2 * settings.correlation_time * (settings.parameter_error * change / t) ** 2
    for p, v, d in ((0, 2, density[0]), (1, 3, density[1]), (4, 5, settings.cart_noise**2)):
        q[p, p], q[p, v], q[v, p], q[v, v] = d * t**3 / 3, d * t**2 / 2, d * t**2 / 2, d * t
    prior = a @ before @ a.T + q
    assert predicted.state == pytest.approx(following, abs=1e-15)
    assert predicted.covariance == pytest.approx(prior, rel=ROUNDING, abs=1e-18)
    measured = POSITIONS @ following + np.array([2e-4, -1e-4, 3e-7])
    updated = ekf.update(predicted, measured)
    s = POSITIONS @ prior @ POSITIONS.T + NOISE
    gain = prior @ POSITIONS.T @ np.linalg.inv(s)
    y = measured - POSITIONS @ following
    assert updated.innovation == pytest.approx(y, abs=1e-15)
    assert updated.state == pytest.approx(following + gain @ y, abs=1e-9)
    assert updated.nis == pytest.approx(y @ np.linalg.solve(s, y), rel=1e-6)
    posterior = np.linalg.inv(np.linalg.inv(prior) + POSITIONS.T @ np.linalg.inv(NOISE) @ POSITIONS)
    assert updated.standard_deviations == pytest.approx(np.sqrt(np.diag(posterior)), rel=1e-5)


def test_nothing_given_is_changed_and_the_same_call_gives_the_same(ekf: Ekf) -> None:
    first = ekf.first(STATE)
    state, covariance = first.state.copy(), first.covariance.copy()
    measured = POSITIONS @ STATE + 1e-4
    kept = measured.copy()
    once = ekf.update(ekf.predict(first, 1.0), measured)
    ekf.update(ekf.predict(ekf.first(STATE * 2), -5.0), measured + 0.1)
    again = ekf.update(ekf.predict(first, 1.0), measured)
    assert (first.state == state).all()
    assert (first.covariance == covariance).all()
    assert (measured == kept).all()
    assert (once.state == again.state).all()
    assert (once.covariance == again.covariance).all()


def test_a_whole_turn_in_a_measured_angle_makes_no_difference(ekf: Ekf) -> None:
    first = ekf.first(STATE)
    measured = POSITIONS @ STATE + np.array([1e-4, -2e-4, 0.0])
    plain = ekf.update(first, measured)
    for turns in ([1, 0], [0, -1], [-3, 2]):
        wound = ekf.update(first, measured + 2 * np.pi * np.array([*turns, 0]))
        assert wound.state == pytest.approx(plain.state, abs=1e-12)
        assert wound.innovation == pytest.approx(plain.innovation, abs=1e-12)
    # The cart's position is no angle.
    far = ekf.update(first, measured + np.array([0, 0, 10.0]))
    assert far.innovation[2] == pytest.approx(10.0)


@pytest.mark.parametrize("shape", [(2,), (4,), (3, 1), (1, 3), ()])
def test_a_measurement_of_another_shape_is_refused(ekf: Ekf, shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="measurement has shape"):
        ekf.update(ekf.first(STATE), np.zeros(shape))


def test_a_state_or_noise_of_another_shape_is_refused(ekf: Ekf) -> None:
    with pytest.raises(InputError, match="state has shape"):
        ekf.first(STATE[:, None])
    first = ekf.first(STATE)
    from dataclasses import replace

    with pytest.raises(InputError, match="shapes"):
        ekf.predict(replace(first, state=STATE[:, None]), 0.0)
    with pytest.raises(InputError, match="shape"):
        ekf.update(replace(first, covariance=np.ones(6)), np.zeros(3))
    with pytest.raises(InputError, match="measurement noise has shape"):
        Ekf(ekf.model, EkfSettings(), noise=np.eye(2))
    with pytest.raises(InputError, match="positive definite"):
        Ekf(ekf.model, EkfSettings(), noise=np.zeros((3, 3)))
    with pytest.raises(InputError, match="rate_noise"):
        EkfSettings(rate_noise=0.0)


def test_a_covariance_that_is_not_finite_is_an_arithmetic_error(ekf: Ekf) -> None:
    from dataclasses import replace

    lost = replace(ekf.first(STATE), covariance=np.full((6, 6), np.nan))
    with pytest.raises(ArithmeticError, match="no inverse"):
        ekf.update(lost, np.zeros(3))


def test_nis_band_is_the_published_one() -> None:
    # Chi-square with 3 degrees of freedom, 2.5 and 97.5 %: Abramowitz & Stegun, table 26.8.
    assert nis_band(3) == pytest.approx((0.215795, 9.34840), rel=1e-5)


def test_nis_and_nees_are_consistent_when_the_assumptions_hold(ekf: Ekf) -> None:
    random = np.random.default_rng(7)
    model = ekf.model
    root = np.linalg.cholesky(NOISE)
    truth = np.array([0.3, 3.0, 1.0, 2.0, 0.0, 0.0])
    estimate = ekf.first(truth)
    truth = truth + random.standard_normal(6) * estimate.standard_deviations
    nis, nees = [], []
    for k in range(1200):
        # An arm that is wrong by the assumed noise alone: white accelerations of the assumed density.
        change = (model.step(truth, 0.0) - truth)[2:4] / 1e-3
        s = ekf.settings
        density = np.sqrt(s.rate_noise**2 + 2 * s.correlation_time * (s.parameter_error * change) ** 2)
        kick = np.array([*density, s.cart_noise]) * random.standard_normal(3) * np.sqrt(1e-3)
        truth = model.step(truth, 0.0)
        truth[[2, 3, 5]] += kick
        truth[[0, 1, 4]] += kick * 5e-4
        estimate = ekf.update(ekf.predict(estimate, 0.0), POSITIONS @ truth + root @ random.standard_normal(3))
        if k >= 200:
            nis.append(estimate.nis)
            nees.append((truth - estimate.state) @ np.linalg.solve(estimate.covariance, truth - estimate.state))
    # Means of a thousand values with variance 2 x freedom; NEES is correlated over some tens of ticks.
    assert np.mean(nis) == pytest.approx(3.0, abs=4 * np.sqrt(6 / len(nis)))
    assert np.mean(nees) == pytest.approx(6.0, abs=4 * np.sqrt(12 * 30 / len(nees)))
