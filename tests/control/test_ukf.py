"""The unscented filter beside the extended one, and what either estimates besides the state."""

import numpy as np
import pytest
from estimator_runs import MODEL, NOISE, SWING, Run, estimated, run

from dpcontrol.control.ekf import CompiledEkf
from dpcontrol.control.estimator_settings import EkfSettings, UkfSettings
from dpcontrol.control.interface import Estimate, Estimator
from dpcontrol.loop.controllers import ESTIMATORS, make_estimator

ROUNDING = 1e-7  # Of a filter's standard deviations; zeros that are hardly known amplify rounding.
NEAR = 0.2  # Of a standard deviation: what linearisation errs by, at most, in a swing.

KINDS = [EkfSettings, UkfSettings]


def apart(one: Estimate, other: Estimate) -> float:
    """Largest difference of two estimates in standard deviations of the second."""
    away = np.concatenate([one.state - other.state, one.extra - other.extra])
    return float(np.abs(away / other.sigmas).max())


def test_the_unscented_filter_agrees_with_the_extended_one_in_a_swing() -> None:
    flown = run(1.0)
    ukf, ekf = (make_estimator(s(augment=()), MODEL, noise=NOISE) for s in (UkfSettings, EkfSettings))
    for k, (one, other) in enumerate(zip(estimated(ukf, flown), estimated(ekf, flown), strict=True)):
        assert apart(one, other) < NEAR
        if k > 10:
            assert one.sigmas == pytest.approx(other.sigmas, rel=0.02)


@pytest.mark.slow
def test_the_unscented_filter_sees_what_a_jacobian_at_the_mean_does_not() -> None:
    # Standing arms, unsure by half a radian, unseen for 0.2 s: they fall either way, farther than linearly and bounded.
    standing, blind = np.array([np.pi, np.pi, 0, 0, 0, 0]), np.zeros(3, dtype=bool)
    random = np.random.default_rng(2)
    sigmas = []
    for kind in (EkfSettings, UkfSettings):
        estimator = make_estimator(kind(augment=(), first_angle=0.5), MODEL, noise=NOISE)
        estimate = estimator.first(standing)
        if kind is EkfSettings:
            cloud = standing[:, None] + estimate.sigmas[:, None] * random.standard_normal((6, 2000))
        for _ in range(200):
            estimate = estimator.step(estimate, 0.0, np.zeros(3), blind)
        sigmas.append(estimate.sigmas)
    for _ in range(200):
        cloud = np.array([MODEL.step(x, 0.0) for x in cloud.T]).T
    fallen = cloud.std(axis=1)
    errors = [np.abs(s / fallen - 1)[:4].max() for s in sigmas]
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_an_estimator_that_finds_zeros(kind) -> None:
    estimator: Estimator = make_estimator(kind(augment=("zeros",)), MODEL, noise=NOISE)
    assert ESTIMATORS[estimator.kind] is kind
    flown = run(1.0, zeros=(0.03, -0.02))
    last = estimated(estimator, flown)[-1]
    assert last.extra == pytest.approx([0.03, -0.02], abs=2e-3)
    assert np.sqrt(np.diag(estimator.covariance(last))) == pytest.approx(last.sigmas)
    expected = MODEL.step(MODEL.step(last.state, 1.0), 2.0)
    assert estimator.ahead(last, [1.0, 2.0]) == pytest.approx(expected, abs=1e-12)


def test_a_missing_position_is_left_out_by_both_kinds() -> None:
    estimator, expected = (make_estimator(k(augment=()), MODEL, noise=NOISE) for k in KINDS[::-1])
    one, other = estimator.first(np.array(SWING)), expected.first(np.array(SWING))
    measured, present = np.array([0.41, np.nan, 1e-4]), np.array([True, False, True])
    one, other = estimator.update(one, measured, present), expected.update(other, measured, present)
    assert apart(one, other) < ROUNDING
    assert one.used == 2
    assert one.nis == pytest.approx(other.nis, rel=1e-6)
    nothing = estimator.step(one, 0.0, measured, np.zeros(3, dtype=bool))
    assert nothing.used == 0
    assert not nothing.innovation.any()


@pytest.mark.parametrize("kind", KINDS)
def test_turns_restarts_and_mistakes_have_the_same_treatment(kind) -> None:
    estimator = make_estimator(kind(augment=()), MODEL, noise=NOISE)
    first, measured = estimator.first(np.array(SWING)), np.array([0.41, 2.79, 0.0])
    wound = estimator.update(first, measured + 2 * np.pi * np.array([2, -1, 0]))
    assert wound.state == pytest.approx(estimator.update(first, measured).state, abs=1e-11)
    begun = estimator.restarted(first, np.array([1.0, 2.0, 0.1]))
    assert begun.state[[0, 1, 4]] == pytest.approx([1.0, 2.0, 0.1])
    with pytest.raises(ArithmeticError, match="no longer"):
        estimator.step(first, np.nan, measured)


@pytest.mark.slow
def test_unobservable_errors_keep_their_uncertainty_at_rest() -> None:
    hanging = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    still = Run(np.zeros(2000), np.zeros((2000, 6)), np.zeros((2000, 3)))
    ekf = CompiledEkf(MODEL, EkfSettings(augment=("disturbance", "parameters")), noise=NOISE)
    last = estimated(ekf, still, start=hanging)[-1]
    known = dict(zip(ekf.extra_names, last.sigmas[6:], strict=True))
    prior = ekf.settings.model_error
    # Inertia needs accelerations, and an angle's zero within a disturbance is not told from it.
    assert known["M11"] > 0.9 * prior
    assert known["S1"] > 0.9 * prior
    moving = estimated(ekf, run(2))[-1]
    assert dict(zip(ekf.extra_names, moving.sigmas[6:], strict=True))["M11"] < 0.2 * prior


@pytest.mark.slow
def test_a_lumped_disturbance_is_followed() -> None:
    flown = run(3, torque=2.0)
    plain = estimated(CompiledEkf(MODEL, EkfSettings(augment=(), parameter_error=1e-3), noise=NOISE), flown)
    # It is drawn towards zero the more, the sooner it is expected to fade.
    settings = EkfSettings(augment=("disturbance",), disturbance_time=1.0, parameter_error=1e-3)
    ekf = CompiledEkf(MODEL, settings, noise=NOISE)
    told = estimated(ekf, flown)
    mean = np.mean([e.extra for e in told[1000:]], axis=0)
    assert mean == pytest.approx([0.0, 2.0], abs=0.3)
    late = slice(1000, None)
    errors = [np.array([e.state[3] for e in es[late]]) - flown.states[late, 3] for es in (plain, told)]
    assert np.abs(errors[1].mean()) < 0.5 * np.abs(errors[0].mean())
