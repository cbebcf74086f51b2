"""Trials of the charts of estimation and control, with reported failures."""

import math
from itertools import pairwise

import numpy as np
import pytest

from dpcontrol.bench.control import (
    PERIOD,
    derivative_trial,
    differences,
    estimator_trial,
    held,
    noise_of,
    swing,
)
from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.interface import sampled_model
from dpcontrol.foundation.causes import Cause
from dpcontrol.loop.controllers import make_estimator
from dpcontrol.loop.result import BatchRun, ended
from dpcontrol.plans.model import load_model

FIRST_ORDER = 0.03  # Of a sampled low pass against the continuous one, at a hundredth of the sampling rate.
WELL_BELOW = 0.2  # Of a share that should be 0.95: a filter that believes far too much.
ARMS = load_model("lab").arms


def filtered(positions: np.ndarray, cutoff: float) -> np.ndarray:
    rates, out = np.zeros(1), []
    for last, now in pairwise(positions):
        rates = differences(rates, np.array([last]), np.array([now]), cutoff)
        out.append(rates[0])
    return np.array(out)


def test_smoothed_differences_halve_the_power_of_a_sine_at_the_cutoff():
    cutoff, t = 10.0, np.arange(4000) * PERIOD
    rates = filtered(np.sin(2 * np.pi * cutoff * t), cutoff)[1000:]
    amplitude = 2 * np.pi * cutoff
    assert np.sqrt(2) * rates.std() == pytest.approx(amplitude / np.sqrt(2), rel=FIRST_ORDER)


def ekf_trial(swings, counts, augment=()):
    estimator = make_estimator(EkfSettings(augment=augment), sampled_model(ARMS, 1000.0), noise=noise_of(ARMS, counts))
    return estimator_trial(estimator, swings, counts=counts)


def test_differences_need_fine_counts_and_the_filter_does_not():
    swings = [swing(ARMS, seconds=1.0, seed=0, mismatch=0.02, zero_error=0.0)]
    coarse, fine = (derivative_trial(math.inf, swings, counts=c) for c in (4000, 400_000))
    filters = [ekf_trial(swings, counts) for counts in (4000, 400_000)]
    # Without a low pass a hundred times the step is near a hundred times the noise; half a tick's delay stays.
    assert coarse.error > 10 * fine.error
    assert filters[0].error < 10 * filters[1].error
    assert filters[0].error < coarse.error / 10
    assert coarse.others == {}


def test_wrong_zeros_are_shown_by_nees_and_mended_by_estimating_them():
    right = [swing(ARMS, seconds=1.5, seed=1, mismatch=0.0, zero_error=0.0)]
    wrong = [swing(ARMS, seconds=1.5, seed=1, mismatch=0.0, zero_error=0.02)]
    assert ekf_trial(right, 40_000).others["nees_inside_95"] > 0.5
    blind, told = ekf_trial(wrong, 40_000), ekf_trial(wrong, 40_000, ("zeros",))
    assert blind.others["nees_inside_95"] < WELL_BELOW
    assert told.others["nees_inside_95"] > 0.5
    assert told.error < blind.error / 2


def run_of(angles: np.ndarray, cause: Cause = Cause.FINISHED) -> BatchRun:
    states = np.column_stack([angles, np.zeros((len(angles), 4))])
    times = np.arange(len(angles)) * 1e-3
    return BatchRun(ended(cause, {"time": 0.0, "error": 1.0}), times, states, states, np.zeros(len(angles)), 0.95, 0.1)


def test_a_run_is_held_if_its_last_period_is_near_the_orbit_up_to_phase_and_turns():
    phase = np.linspace(0, 2 * np.pi, 1000, endpoint=False)
    orbit = np.column_stack([np.sin(phase), np.pi + 0.3 * np.cos(phase)])
    judge = held(orbit, period=1.0)
    twice = np.vstack([orbit, np.roll(orbit, 300, axis=0)])
    assert judge(run_of(twice))
    for shift, expected in ((4 * np.pi, True), (0.09, True), (0.9, False)):
        assert judge(run_of(twice + np.array([0.0, shift]))) is expected
    assert not judge(run_of(twice, Cause.TRACKING_LOST))
    early_only = np.vstack([orbit + 1.0, orbit])
    assert judge(run_of(early_only))
