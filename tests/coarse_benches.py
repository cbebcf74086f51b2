"""Runs on benches with coarse encoders: completion and delay of detecting stuck scales."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from ending_truth import Flight, flights

from dpcontrol.plans.plan import Plan

BENCH = {
    "mismatch": 0.05,
    "initial_error": 0.05,
    "lag": 0.005,
    "command_noise": 0.3,
    "zero_error": 0.02,
    "travel": 0.8,
    "counts": 40_000,
}
MOVED = 1e-3
"""Distance of the cart from which the delay of detection counts, m."""


def flown(plan: Plan, options: Mapping[str, Any], seeds: Sequence[int]) -> list[Flight]:
    return flights(plan.itinerary.with_run({**BENCH, **options}), plan.reference, seeds)


def completed(plan: Plan, options: Mapping[str, Any], seeds: Sequence[int]) -> tuple[float, list[str]]:
    """Return the share of completed runs, and the reasons of failures."""
    problems = [flight.verdict.problem for flight in flown(plan, options, seeds) if flight.verdict.problem]
    return 1 - len(problems) / len(seeds), problems


def delays_of_stuck_scales(plan: Plan, options: Mapping[str, Any], seeds: Sequence[int]) -> list[float]:
    """Return the delays from the cart's first millimetre to the detection of its stuck scale, s; infinite for none.

    The scale sticks at a random time of each run. An earlier detection has zero delay.
    """
    delays = []
    for seed in seeds:
        at = float(np.random.default_rng(seed).uniform(0, 0.8 * plan.reference.duration))
        (flight,) = flown(plan, {**options, "stuck_at": at, "stuck_sensor": 2}, [seed])
        rate, cart = flight.settings.rate, flight.run.truth[:, -2]
        first = min(math.ceil(at * rate), len(cart) - 1)
        moved = np.flatnonzero(np.abs(cart[first:] - cart[first]) >= MOVED)
        if "scale is stuck" not in flight.run.reason:
            delays.append(math.inf)
        elif not len(moved):
            delays.append(0.0)
        else:
            found = re.search(r"t = ([0-9.]+) s", flight.run.reason)
            assert found
            delays.append(max(float(found[1]) - (first + int(moved[0])) / rate, 0.0))
    return delays
