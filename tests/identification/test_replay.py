"""Replay of a model on a recording, with consistent filters; a moving cart is the model's input."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_recordings import LAB, PERIOD, free_swing, rig_file
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from dpcontrol.dynamics.chain import ArmChainParameters, base_ratios
from dpcontrol.foundation.errors import InputError
from dpcontrol.identification.fit import Swing, Swings
from dpcontrol.identification.identify import cut_into_swings
from dpcontrol.identification.replay import (
    filter_settings,
    fitted_path,
    replay_recording,
    write_replay,
)
from dpcontrol.logs import read_log
from dpcontrol.plans.model import load_model
from dpcontrol.recordings.importing import import_recording
from dpcontrol.recordings.recording import Recording, cart_motion, load_recording

Array = NDArray[np.float64]

COUNT = 2 * np.pi / 40_000  # encoder count, rad
FITTED = 1e-6  # rad: error of a fit to exact angles, due to steps of 1 ms
NEAR_COUNT = 0.8  # counts: rms of two roundings, 0.41, and errors that the fit does not average
SMOOTHED = 2.0  # counts: also the error of a cubic through 20 ms of the position
CART_COUNT = 1e-6  # m
IN_BAND = 0.90  # of the settled samples; the consistent share is 0.95
RATES = 0.15  # rad/s rms: required for the recorded, filtered rates
PUBLISHED = (2.0e-3, 5.5e-3)  # rad rms over whole segments with the published parameters
IDENTIFIED = 1.6e-3  # rad rms over whole segments allowed for the identified model

ARMS = ArmChainParameters(LAB["m"], LAB["a"], (LAB["l"], 0.2286), LAB["J"], LAB["g"], LAB["k"])


def counted(states: Array) -> Array:
    """Return the angles (K, 2) of states as relative encoders read them."""
    relative = np.column_stack([states[:, 0], states[:, 1] - states[:, 0]])
    return np.cumsum(np.rint(relative / COUNT) * COUNT, axis=1)


def recorded() -> Recording:
    """A free swing by scipy, as read by encoders."""
    times, states = free_swing(3000)
    angles, parts = counted(states), tuple((k, k + 1000) for k in (0, 1000, 2000))
    return Recording("swing", "swing.mat", PERIOD, times, angles, states[:, 2:].copy(), parts, (0.17, 0.23))


def errors(recording: Recording, found: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(found[:, :2] - recording.angles))))


def test_the_fitted_initial_state_for_exact_angles_is_exact() -> None:
    _, states = free_swing(2000)
    angles = states[:, :2].copy()
    angles[700:1300] = np.nan
    fit = fitted_path(Swings(ARMS), Swing(angles, PERIOD), base_ratios(ARMS))
    assert fit.converged
    assert np.abs(fit.states[0] - states[0]).max() <= 1e3 * FITTED
    assert np.abs(fit.states[:, :2] - states[:, :2]).max() <= FITTED
    assert fit.residual.max() <= FITTED


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_the_true_model_follows_to_a_count_and_its_filter_is_consistent(kind: str) -> None:
    result = replay_recording(recorded(), ARMS, filter_settings(kind))
    assert all(fit.converged for fit in result.fits)
    assert max(float(np.sqrt(np.mean(fit.residual**2))) for fit in result.fits) <= NEAR_COUNT * COUNT
    assert result.nis_inside_95 >= IN_BAND
    assert result.rates_rms.max() <= RATES / 3
    assert max(result.ahead[1]) <= COUNT
    # After a tenth of a second, errors of rates from means of 15 samples dominate.
    assert max(result.ahead[100]) <= 12 * COUNT


def test_estimated_zeros_are_subtracted_and_restored() -> None:
    exact, zeros = recorded(), (4e-3, -6e-3)
    off = replace(exact, angles=exact.angles + np.array(zeros))
    ignored, told = (replay_recording(off, ARMS, filter_settings("ekf"), zeros=z) for z in ((), zeros))
    without = replay_recording(exact, ARMS, filter_settings("ekf"))
    # Errors of one or two counts also occur without zeros.
    assert np.abs(told.predicted - without.predicted - np.array([*zeros, 0, 0])).max() <= COUNT / 100
    assert np.abs(told.estimated - without.estimated - np.array([*zeros, 0, 0])).max() <= COUNT / 100
    assert told.ahead[100] == pytest.approx(without.ahead[100], rel=1e-3)
    assert np.array_equal(told.recording.angles, off.angles)
    assert np.mean([f.residual for f in ignored.fits]) > 5 * np.mean([f.residual for f in told.fits])
    with pytest.raises(InputError, match="1 zeros for 2 arms"):
        replay_recording(off, ARMS, filter_settings("ekf"), zeros=(1e-3,))


def test_a_wrong_model_shows_in_every_number() -> None:
    recording = recorded()
    wrong = replace(ARMS, inertia=(ARMS.inertia[0], 1.05 * ARMS.inertia[1]))
    right_result = replay_recording(recording, ARMS, filter_settings("ekf"))
    wrong_result = replay_recording(recording, wrong, filter_settings("ekf"))
    assert errors(recording, wrong_result.predicted) >= 10 * errors(recording, right_result.predicted)
    assert max(wrong_result.ahead[100]) >= 3 * max(right_result.ahead[100])
    assert wrong_result.nis_inside_95 <= right_result.nis_inside_95 - 0.1


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_filters_are_consistent_and_estimate_rates_on_the_rigs_recording(kind: str) -> None:
    recording, model = import_recording(rig_file()), load_model("lab-identified")
    result = replay_recording(recording, model.arms, filter_settings(kind), zeros=model.encoder_zeros)
    assert result.nis_inside_95 >= IN_BAND
    assert result.rates_rms.max() <= RATES
    left = [float(np.sqrt(np.mean(fit.residual**2))) for fit in result.fits]
    assert all(fit.converged for fit in result.fits)
    assert max(left) <= IDENTIFIED


@pytest.mark.slow
def test_the_published_parameters_have_the_measured_residuals() -> None:
    result = replay_recording(import_recording(rig_file()), ARMS, filter_settings("ekf"))
    left = [float(np.sqrt(np.mean(fit.residual**2))) for fit in result.fits]
    assert PUBLISHED[0] <= min(left)
    assert max(left) <= PUBLISHED[1]


def _acceleration(times: Array | float) -> Array:
    return np.asarray(2.0 * np.sin(9.0 * np.asarray(times)) + 1.0 * np.cos(4.0 * np.asarray(times)), dtype=np.float64)


def _rate(t: float, x: Array) -> Array:
    """The textbook pendulum on a moving pivot, with an inertial force."""
    (m1, m2), (a1, a2), (j1, j2), (k1, k2) = LAB["m"], LAB["a"], LAB["J"], LAB["k"]
    length, g = LAB["l"], LAB["g"]
    q1, q2, w1, w2, _, v = x
    u = float(_acceleration(t))
    coupling, first, second = m2 * length * a2, m1 * a1 + m2 * length, m2 * a2
    mass = np.array([[m1 * a1**2 + m2 * length**2 + j1, coupling * np.cos(q1 - q2)],
                     [coupling * np.cos(q1 - q2), m2 * a2**2 + j2]])  # fmt: skip
    joint = k2 * (w2 - w1)
    force = np.array([
        -coupling * np.sin(q1 - q2) * w2**2 - first * (g * np.sin(q1) + u * np.cos(q1)) - k1 * w1 + joint,
        coupling * np.sin(q1 - q2) * w1**2 - second * (g * np.sin(q2) + u * np.cos(q2)) - joint,
    ])  # fmt: skip
    return np.concatenate([[w1, w2], np.linalg.solve(mass, force), [v, u]])


@pytest.fixture(scope="module")
def driven() -> tuple[Array, Array]:
    """Times and states (K, 6) of two seconds on a moving cart."""
    times = PERIOD * np.arange(2000)
    start = [-0.6, 0.35, 4.0, -3.0, 0.0, -2.0 / 9.0]
    flown = solve_ivp(_rate, (0, times[-1]), start, t_eval=times, rtol=1e-10, atol=1e-12, method="DOP853")
    return np.asarray(times, dtype=np.float64), np.asarray(flown.y.T, dtype=np.float64)


def on_a_cart(driven: tuple[Array, Array], *, command: Array | None) -> Recording:
    """Its encoder readings, in counts of the arms and micrometres of the cart."""
    times, states = driven
    angles = counted(states)
    cart = np.rint(states[:, 4] / CART_COUNT) * CART_COUNT
    return Recording(
        "driven", "driven.mat", PERIOD, times, angles, states[:, 2:4].copy(), ((0, len(times)),), (0.17, 0.23),
        cart=cart, command=command,
    )  # fmt: skip


def told(times: Array) -> Array:
    """The command, constant at its mean in each period."""
    return _acceleration(times + PERIOD / 2)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_a_command_that_the_cart_follows_is_the_input(driven: tuple[Array, Array], kind: str) -> None:
    result = replay_recording(on_a_cart(driven, command=told(driven[0])), ARMS, filter_settings(kind))
    assert [cart.commanded for cart in result.carts] == [True]
    assert len(result.fits) == 4
    assert all(fit.converged for fit in result.fits)
    assert max(float(np.sqrt(np.mean(fit.residual**2))) for fit in result.fits) <= NEAR_COUNT * COUNT
    assert result.nis_inside_95 >= IN_BAND
    assert max(result.ahead[1]) <= COUNT


@pytest.mark.parametrize("share", [None, 0.5])
def test_without_a_matching_command_the_carts_position_is_the_input(
    driven: tuple[Array, Array], share: float | None
) -> None:
    command = None if share is None else told(driven[0]) / share
    result = replay_recording(on_a_cart(driven, command=command), ARMS, filter_settings("ekf"))
    assert [cart.commanded for cart in result.carts] == [False]
    assert result.cart == "its recorded position"
    assert max(float(np.sqrt(np.mean(fit.residual**2))) for fit in result.fits) <= SMOOTHED * COUNT


def test_a_command_alone_moves_the_cart(driven: tuple[Array, Array]) -> None:
    recording = replace(on_a_cart(driven, command=told(driven[0])), cart=None)
    motion = cart_motion(recording)
    assert motion.commanded
    assert np.abs(np.diff(motion.velocity) - np.diff(driven[1][:, 5])).max() <= 1e-6


def test_an_identification_omits_missing_readings(driven: tuple[Array, Array]) -> None:
    angles = on_a_cart(driven, command=told(driven[0])).angles.copy()
    angles[[0, 700, 701, 1999]] = np.nan
    angles[1200:1210] = np.nan
    recording = replace(on_a_cart(driven, command=told(driven[0])), angles=angles)
    swings, _ = cut_into_swings([recording], 2, 0.5)
    model, ratios = Swings(ARMS), base_ratios(ARMS)
    for fit in (fitted_path(model, swing, ratios) for swing in swings):
        assert fit.converged
        assert fit.residual.max() <= NEAR_COUNT * COUNT


def test_the_log_has_the_carts_predicted_and_estimated_motion(driven: tuple[Array, Array], tmp_path: Path) -> None:
    recording = on_a_cart(driven, command=told(driven[0]))
    result = replay_recording(recording, ARMS, filter_settings("ekf"))
    log = read_log(write_replay(result, tmp_path / "replay.mcap", model="lab", model_text="title"))
    assert log.has_cart
    assert np.array_equal(log.reference[:, :4], result.predicted)
    assert np.array_equal(log.reference[:, 4], recording.cart)
    assert np.array_equal(log.controls["applied"], result.carts[0].acceleration)
    assert "median rms" in log.metadata["summary"]
    again = load_recording(tmp_path / "replay.mcap")
    for one, other in ((again.cart, recording.cart), (again.command, recording.command)):
        assert one is not None
        assert np.array_equal(one, other)
