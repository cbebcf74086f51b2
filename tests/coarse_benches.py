"""Runs on benches with coarse encoders: completion and delay of detecting stuck scales."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from ending_truth import Flight, flights

from dpcontrol.foundation.causes import Cause
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
    problems = [flight.verdict.reason for flight in flown(plan, options, seeds) if not flight.verdict.completed]
    return 1 - len(problems) / len(seeds), problems


class StuckScale(NamedTuple):
    """A scale that stuck in a run.

    delay: time from the cart's first millimetre to the detection, s. Infinite for none, zero for an earlier one.
    moving: time that the cart took for this millimetre, s. Infinite if the run ended before.
    """

    delay: float
    moving: float


def stuck_scales(plan: Plan, options: Mapping[str, Any], seeds: Sequence[int]) -> list[StuckScale]:
    """Return how soon the stuck scale of each run is found; it sticks at a random time."""
    found = []
    for seed in seeds:
        at = float(np.random.default_rng(seed).uniform(0, 0.8 * plan.reference.duration))
        (flight,) = flown(plan, {**options, "stuck_at": at, "stuck_sensor": 2}, [seed])
        rate, cart = flight.settings.rate, flight.run.truth[:, -2]
        first = min(math.ceil(at * rate), len(cart) - 1)
        moved = np.flatnonzero(np.abs(cart[first:] - cart[first]) >= MOVED)
        moving = int(moved[0]) / rate if len(moved) else math.inf
        end = flight.run.end
        named = end.cause == Cause.STUCK and end.figures["sensor"] == 0
        delay = max(end.figures["time"] - first / rate - moving, 0.0) if named else math.inf
        # A scale is never reported before it sticks.
        assert not named or end.figures["time"] >= at, (seed, flight.run.reason)
        found.append(StuckScale(delay, moving))
    return found
