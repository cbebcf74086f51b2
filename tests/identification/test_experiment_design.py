"""Comparison of experiments by information, checked by fits to the same swing."""

from dataclasses import replace

import numpy as np
import pytest

from dpcontrol.dynamics.chain import base_ratios
from dpcontrol.identification.fit import (
    Design,
    DesignSettings,
    FitSettings,
    Swings,
    design_experiments,
    digits,
    fit_swings,
)
from dpcontrol.identification.identify import cut_into_swings
from dpcontrol.plans.model import load_model
from dpcontrol.recordings.recording import simulated_recording

LAB = load_model("lab").arms
QUICK = DesignSettings(seconds=1.5, steps=3, amplitudes=(1.0, 2.0), frequencies=(0.8, 2.0))


@pytest.fixture(scope="module")
def design() -> Design:
    """A small comparison of the lab's pendulum."""
    return design_experiments(LAB, settings=QUICK)


def test_information_agrees_with_a_fit_to_the_same_swing(design: Design) -> None:
    best = next(e for e in design.ranked() if e.kind == "swing")
    recording = simulated_recording(LAB, [np.array(best.angles)], seconds=QUICK.seconds, period=QUICK.period)
    swings, settings = cut_into_swings([recording], 2, 10.0)[0], FitSettings(robust=0.0, window=0.4)
    first = {"parameters": base_ratios(LAB), "zeros": np.zeros((1, 2))}
    fit = fit_swings(Swings(LAB), swings, **first, free=np.ones(6, dtype=bool), free_zeros=True, settings=settings)
    # Zeros are eliminated, slopes are over logarithms, and both angles have the same rounding variance.
    whole, m = fit.information, 6
    reduced = whole[:m, :m] - whole[:m, m:] @ np.linalg.solve(whole[m:, m:], whole[m:, :m])
    sigma = 2 * np.pi / QUICK.counts / np.sqrt(12)
    expected = reduced * np.outer(fit.parameters, fit.parameters) / sigma**2
    # The errors of the fit's ratios are due to rounding, with a few percent for friction.
    assert digits(best.matrix) == pytest.approx(digits(expected), abs=0.05)


def test_higher_swings_and_stronger_drives_give_more_information(design: Design) -> None:
    swings = [e for e in design.experiments if e.kind == "swing" and e.angles[0] == 0.0 and e.angles[1] > 0]
    low, high = (pick(swings, key=lambda e: e.angles[1]) for pick in (min, max))
    assert high.information > low.information
    drives = {(e.amplitude, e.frequency): e.information for e in design.experiments if e.kind == "cart"}
    assert all(drives[2.0, f] > drives[1.0, f] for f in QUICK.frequencies)
    # A pair gives more than either of its experiments.
    first, second = design.best_pair()
    assert digits(first.matrix + second.matrix) > max(first.information, second.information)
    assert all(e.information <= first.information for e in design.ranked())


def test_swings_that_magnify_errors_and_drives_beyond_the_track_are_not_usable(design: Design) -> None:
    assert any(not e.usable and e.amplification > 20 for e in design.experiments)
    short = design_experiments(LAB, settings=replace(QUICK, track=0.02))
    assert not any(e.usable for e in short.experiments if e.kind == "cart" and e.frequency < 1)
