"""Replay of a model on a recording, with consistent filters."""

from dataclasses import replace

import numpy as np
import pytest
from bench_recordings import LAB, PERIOD, free_swing, rig_file
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import ArmChainParameters, base_ratios
from dpcontrol.foundation.errors import InputError
from dpcontrol.identification.fit import Swing, Swings
from dpcontrol.identification.replay import ReplaySettings, filter_settings, fitted_path, replay_recording
from dpcontrol.plans.model import load_model
from dpcontrol.recordings.importing import import_recording
from dpcontrol.recordings.recording import Recording

COUNT = 2 * np.pi / 40_000  # encoder count, rad
FITTED = 1e-6  # rad: error of a fit to exact angles, due to steps of 1 ms
NEAR_COUNT = 0.8  # counts: rms of two roundings, 0.41, and errors that the fit does not average
IN_BAND = 0.90  # of the settled samples; the consistent share is 0.95
RATES = 0.15  # rad/s rms: required for the recorded, filtered rates
PUBLISHED = (2.0e-3, 5.5e-3)  # rad rms over whole segments with the published parameters
IDENTIFIED = 1.6e-3  # rad rms over whole segments allowed for the identified model

ARMS = ArmChainParameters(
    mass=LAB["m"],
    centre_of_mass=LAB["a"],
    length=(LAB["l"], 0.2286),
    inertia=LAB["J"],
    gravity=LAB["g"],
    viscous=LAB["k"],
)


def recorded(segments: int = 3, samples: int = 1000, *, counts: int | None = 40_000) -> Recording:
    """A free swing by scipy, as read by relative encoders; exact without counts."""
    times, states = free_swing(segments * samples)
    angles = states[:, :2].copy()
    if counts:
        step = 2 * np.pi / counts
        relative = np.column_stack([angles[:, 0], angles[:, 1] - angles[:, 0]])
        angles = np.cumsum(np.rint(relative / step) * step, axis=1)
    parts = tuple((k * samples, (k + 1) * samples) for k in range(segments))
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
    assert result.rates_rms is not None
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


def test_coarse_encoders_modelled_as_fine_ones_fail_the_consistency_check() -> None:
    result = replay_recording(recorded(counts=1000), ARMS, filter_settings("ekf"))
    assert result.nis_inside_95 < 0.7
    honest = replay_recording(recorded(counts=1000), ARMS, filter_settings("ekf"), ReplaySettings(counts=1000))
    assert honest.nis_inside_95 >= IN_BAND - 0.05


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_filters_are_consistent_and_estimate_rates_on_the_rigs_recording(kind: str) -> None:
    recording, model = import_recording(rig_file()), load_model("lab-identified")
    result = replay_recording(recording, model.arms, filter_settings(kind), zeros=model.encoder_zeros)
    assert result.nis_inside_95 >= IN_BAND
    assert result.rates_rms is not None
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
