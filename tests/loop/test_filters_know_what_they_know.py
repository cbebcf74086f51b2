"""Errors over standard deviations of the default filter in closed loops, by the truth of the plants drawn.

A consistent filter has an rms of 1. The bounds allow for the scatter of a sample of runs and for two remaining errors.
Rounding errors of arms at rest are not white, and at ±20 % squares of the errors exceed the modelled noise.
"""

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from estimator_truth import Beliefs, beliefs

from dpcontrol.loop.assembly import Assembly
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan

PARAMETERS = (0.55, 1.55)
"""Of 64 runs, from 2 s on."""
EARLY = (0.4, 1.75)
"""After half a second, when the prior still counts, which fits ±10 %."""
STATES = (0.55, 1.25)
SLOW = (0.35, 1.8)
"""Of angles: rounding of an arm that hardly moves is no white noise, and a zero is first known by its prior."""
SAME_BENCH = {
    "lag": 0.005,
    "drive_lag": 0.005,
    "command_noise": 0.3,
    "initial_error": 0.05,
    "zero_error": 0.02,
    "counts": 40_000,
    "travel": 0.8,
}
UNTOLD = {name: value for name, value in SAME_BENCH.items() if name != "drive_lag"}


def of_kind(found: Beliefs, *kinds: str) -> np.ndarray:
    return np.sqrt(np.mean(found.over_sigma(found.of(*kinds)) ** 2, axis=1))


@pytest.fixture(scope="module", params=["outer-turn", "turn-from-rest"])
def flown(request: pytest.FixtureRequest):
    plan = make_plan(load_itinerary(request.param))

    def fly(options: Mapping[str, Any], mismatch: float) -> Beliefs:
        loop = plan.itinerary.with_run({**options, "mismatch": mismatch}).loop
        arms = plan.itinerary.model.arms
        law = Assembly(plan.reference, arms, loop).controller
        return beliefs(
            plan.reference, arms, settings=loop, controller=law, seeds=range(64), times=(0.5, 2.0, -(loop.rate**-1))
        )

    return fly


@pytest.mark.slow
def test_parameters_are_as_uncertain_as_they_are_wrong_at_any_mismatch(flown) -> None:
    for mismatch in (0.05, 0.2):
        found = of_kind(flown(UNTOLD, mismatch), "M", "S")
        sys.stdout.write(f"\n±{mismatch:.0%}, untold lag: parameters {found.round(2)}")
        for values, (low, high) in ((found[:1], EARLY), (found[1:], PARAMETERS)):
            assert ((values > low) & (values < high)).all()


@pytest.mark.slow
def test_states_have_the_expected_errors_on_a_bench_that_fits_the_model(flown) -> None:
    found = flown(SAME_BENCH, 0.05)
    for kind in ("angle", "rate", "cart", "velocity"):
        over = of_kind(found, kind)
        sys.stdout.write(f"\n{kind} {over.round(2)}")
        low, high = SLOW if kind == "angle" else STATES
        assert (over > low).all(), kind
        assert (over < high).all(), kind
    assert np.nanmean(found.nis[300:]) == pytest.approx(3.0, rel=0.1)
