"""Replays with a moving cart, whose command or recorded motion is the model's input."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_recordings import LAB, PERIOD
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from dpcontrol.dynamics.chain import ArmChainParameters, base_ratios
from dpcontrol.identification.fit import Swings
from dpcontrol.identification.identify import cut_into_swings
from dpcontrol.identification.replay import filter_settings, fitted_path, replay_recording, write_replay
from dpcontrol.logs import read_log
from dpcontrol.recordings.recording import Recording, cart_motion, load_recording

Array = NDArray[np.float64]

COUNT = 2 * np.pi / 40_000  # encoder count, rad
NEAR_COUNT = 0.8  # counts: rms of two roundings, 0.41, and errors that the fit does not average
SMOOTHED = 2.0  # counts: also the error of a cubic through 20 ms of the position
CART_COUNT = 1e-6  # m
IN_BAND = 0.90
ARMS = ArmChainParameters(
    mass=LAB["m"],
    centre_of_mass=LAB["a"],
    length=(LAB["l"], 0.2286),
    inertia=LAB["J"],
    gravity=LAB["g"],
    viscous=LAB["k"],
)


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


def recorded(driven: tuple[Array, Array], *, command: Array | None) -> Recording:
    """Its encoder readings, in counts of the arms and micrometres of the cart."""
    times, states = driven
    relative = np.column_stack([states[:, 0], states[:, 1] - states[:, 0]])
    angles = np.cumsum(np.rint(relative / COUNT) * COUNT, axis=1)
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
    result = replay_recording(recorded(driven, command=told(driven[0])), ARMS, filter_settings(kind))
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
    result = replay_recording(recorded(driven, command=command), ARMS, filter_settings("ekf"))
    assert [cart.commanded for cart in result.carts] == [False]
    assert result.cart == "its recorded position"
    assert max(float(np.sqrt(np.mean(fit.residual**2))) for fit in result.fits) <= SMOOTHED * COUNT


def test_a_command_alone_moves_the_cart(driven: tuple[Array, Array]) -> None:
    recording = replace(recorded(driven, command=told(driven[0])), cart=None)
    motion = cart_motion(recording)
    assert motion is not None
    assert motion.commanded
    assert np.abs(np.diff(motion.velocity) - np.diff(driven[1][:, 5])).max() <= 1e-6


def test_an_identification_omits_missing_readings(driven: tuple[Array, Array]) -> None:
    angles = recorded(driven, command=told(driven[0])).angles.copy()
    angles[[0, 700, 701, 1999]] = np.nan
    angles[1200:1210] = np.nan
    recording = replace(recorded(driven, command=told(driven[0])), angles=angles)
    swings, _ = cut_into_swings([recording], 2, 0.5)
    model, ratios = Swings(ARMS), base_ratios(ARMS)
    for fit in (fitted_path(model, swing, ratios) for swing in swings):
        assert fit.converged
        assert fit.residual.max() <= NEAR_COUNT * COUNT


def test_the_log_has_the_carts_predicted_and_estimated_motion(driven: tuple[Array, Array], tmp_path: Path) -> None:
    recording = recorded(driven, command=told(driven[0]))
    result = replay_recording(recording, ARMS, filter_settings("ekf"))
    log = read_log(write_replay(result, tmp_path / "replay.mcap", model="lab", model_text="title"))
    assert log.has_cart
    assert np.array_equal(log.reference[:, :4], result.predicted)
    assert recording.cart is not None
    assert np.array_equal(log.reference[:, 4], recording.cart)
    assert np.array_equal(log.controls["applied"], result.carts[0].acceleration)
    assert "median rms" in log.metadata["summary"]
    again = load_recording(tmp_path / "replay.mcap")
    for one, other in ((again.cart, recording.cart), (again.command, recording.command)):
        assert one is not None
        assert other is not None
        assert np.array_equal(one, other)
