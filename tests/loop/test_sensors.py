"""Sensors and their faults."""

import numpy as np
import pytest

from dpcontrol.loop.bench import SensorSettings
from dpcontrol.loop.simulated import Encoders

COUNT = 2 * np.pi / 40_000
EXACT = 1e-12
UNROUNDED = SensorSettings(counts=0, cart_resolution=0.0)


def test_relative_joints_are_rounded_to_counts_and_then_summed() -> None:
    encoders = Encoders(2, SensorSettings())
    random = np.random.default_rng(5)
    for state in random.uniform(-20, 20, (200, 6)):
        measured = encoders.measure(state)
        joints = np.array([measured[0], measured[1] - measured[0]]) / COUNT
        assert joints == pytest.approx(np.rint(joints), abs=1e-6)
        assert abs(measured[0] - state[0]) <= COUNT / 2 + EXACT
        assert abs((measured[1] - measured[0]) - (state[1] - state[0])) <= COUNT / 2 + EXACT
        assert measured[2] == pytest.approx(state[4], abs=0.5e-6 + EXACT)
    assert encoders.measure(np.zeros(6)) == pytest.approx(np.zeros(3), abs=0)


def test_zero_errors_of_inner_encoders_are_carried_outwards() -> None:
    shifted = Encoders(3, UNROUNDED, zeros=np.array([0.01, -0.02, 0.04]))
    assert shifted.measure(np.zeros(8)) == pytest.approx([0.01, -0.01, 0.03, 0.0], abs=1e-15)


def test_missed_counts_pile_up_against_the_motion_and_a_joint_at_rest_loses_none() -> None:
    encoders = Encoders(2, SensorSettings(missed_counts=1000.0))
    forward = np.array([0.0, 0.0, 1.0, -2.0, 0.0, 0.0])
    for k in range(1, 4):
        inner, outer, _ = encoders.measure(forward, missed=np.array([1, 2]))
        assert inner == pytest.approx(-k * COUNT, abs=EXACT)
        assert outer - inner == pytest.approx(2 * k * COUNT, abs=EXACT)
    still = encoders.measure(np.zeros(6), missed=np.array([5, 5]))
    assert still[0] == pytest.approx(-3 * COUNT, abs=EXACT)
    back = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    assert encoders.measure(back, missed=np.array([3, 0]))[0] == pytest.approx(0.0, abs=EXACT)


def test_noise_has_the_covariance_of_the_settings() -> None:
    settings = SensorSettings(counts=(2000, 500), cart_resolution=1e-3, noise=2e-3, cart_noise=5e-4)
    encoders, random = Encoders(2, settings), np.random.default_rng(1)
    sigmas = np.array([2e-3, 2e-3, 5e-4])
    errors = []
    for _ in range(20_000):
        state = random.uniform(-1, 1, 6)
        errors.append(encoders.measure(state, noise=random.standard_normal(3) * sigmas) - state[[0, 1, 4]])
    expected = settings.covariance(2)
    assert np.cov(np.array(errors).T)[:2, :2] == pytest.approx(expected[:2, :2], rel=0.06)
    assert np.var(np.array(errors)[:, 2]) == pytest.approx(expected[2, 2], rel=0.06)


def test_an_estimator_assumes_a_small_noise_of_ideal_sensors() -> None:
    perfect = SensorSettings(counts=0, cart_resolution=0.0).covariance(2)
    assert np.linalg.eigvalsh(perfect).min() > 0
    assert np.sqrt(np.diag(perfect)).max() < 1e-5
    coarse = SensorSettings(counts=0, noise=1e-3)
    assert coarse.covariance(2)[0, 0] == pytest.approx(1e-6)


def test_a_sensor_that_sticks_for_a_while_comes_back() -> None:
    encoders = Encoders(2, SensorSettings(stuck_at=0.5, stuck_sensor=1, stuck_for=10.0))
    free = Encoders(2, SensorSettings())
    for time, same in ((0.4, True), (0.5, True), (3.0, False), (10.4, False), (10.5, True), (50.0, True)):
        state = np.array([0.3, 0.9 + time / 50, 0.0, 0.0, 0.2, 0.0])
        assert np.array_equal(encoders.measure(state, time), free.measure(state, time)) == same, time


def test_zeros_drift_from_their_initial_values_at_the_requested_rate() -> None:
    state = np.array([0.3, 0.9, 0.0, 0.0, 0.2, 0.0])
    settings = SensorSettings(counts=0, zero_drift=0.01)
    encoders = Encoders(2, settings, zeros=np.array([0.002, 0.0]), drift=np.array([0.01, -0.01]) / 3600)
    assert encoders.measure(state, 0.0)[:2] - state[:2] == pytest.approx([0.002, 0.002], abs=EXACT)
    assert encoders.measure(state, 7200.0)[:2] - state[:2] == pytest.approx([0.022, 0.002], abs=EXACT)
