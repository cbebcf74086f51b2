"""Where flights stop working: returns from random states on benches that differ from the model.

`pytest -m benchmark tests/benchmarks/test_flights.py -s` prints a row for each target and each bench.
"""

import os
import sys
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from dpcontrol.judge.score import returns
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.result import Ending, Events
from dpcontrol.plans.itinerary import itinerary_from
from dpcontrol.plans.model import load_model
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.run import assembled

pytestmark = pytest.mark.benchmark

STATES = int(os.environ.get("FLIGHT_STATES", "200"))
TARGETS = {
    "up-up": 'hold = "up-up"', "down-up": 'hold = "down-up"', "up-down": 'hold = "up-down"',
    "rest": 'hold = "down-down"', "orbit of Down-Up": 'orbit = "down-up"\nenergy = -0.07',
    "orbit of Up-Down": 'orbit = "up-down"\nenergy = 0.2',
}  # fmt: skip
USUAL = {
    "mismatch": 0.05, "lag": 0.005, "counts": 8192, "noise": 0.0005, "initial_error": np.pi, "initial_rate": 20.0,
    "initial_velocity": 1.5,
}  # fmt: skip
BENCHES: dict[str, dict[str, float]] = {
    "±20 % arms": {"mismatch": 0.2},
    "2 mN m of untold dry friction": {"stiction": 0.002},
    "a belt of 30 Hz": {"belt": 30.0},
    "15 ms of lag": {"lag": 0.015},
    "4,000 counts": {"counts": 4000},
    "a drive of 15 m/s²": {"acceleration": 15.0},
    "blows instead of states": {"initial_error": 0.0, "initial_rate": 0.0, "pushes": 3, "push_impulse": 0.1},
}


@lru_cache(maxsize=2)
def assembly(target: str, track: float, acceleration: float, options: tuple[tuple[str, float], ...]) -> Assembly:
    text = (
        f'title = "any"\nmodel = "lab"\nstart = "anywhere"\nseconds = 6.0\n{TARGETS[target]}\n[limits]\n'
        f"position = {track}\nacceleration = {acceleration}\n"
    )
    chosen = {**USUAL, "initial_position": 0.7 * track, **dict(options)}
    scene = itinerary_from(text, "any", load_model("lab")).with_run({**chosen, "on_fall": "resume"})
    return assembled(make_plan(scene))


def flown(case: tuple[str, float, Mapping[str, float], int]) -> tuple[float, bool]:
    """The longest return in s, infinite if the run is not back to its end, and whether the cart met its end stop."""
    target, track, options, seed = case
    own = {name: value for name, value in options.items() if name != "acceleration"}
    parts, sink = assembly(target, track, options.get("acceleration", 30.0), tuple(own.items())), Events()
    result = parts.under(replace(parts.settings, seed=seed)).simulate(sink=sink)
    returned = returns(sink.kept)
    done = result.ending is Ending.FINISHED and returned
    return (max(returned) if done else np.inf), result.ending is Ending.CART_STOP


def row(target: str, track: float, options: Mapping[str, float]) -> tuple[float, float, float, int]:
    cases = [(target, track, options, seed) for seed in range(5000, 5000 + STATES)]
    with ProcessPoolExecutor(2) as pool:
        times, hits = zip(*pool.map(flown, cases, chunksize=10), strict=True)
    median, most = np.quantile(times, [0.5, 0.99], method="lower")
    return float(np.isfinite(times).mean()), float(median), float(most), sum(hits)


def told(case: str, share: float, median: float, most: float, hits: int) -> None:
    """Print a row of the table."""
    sys.stdout.write(f"{case}: {share:.1%} back, median {median:.2f} s, 99 % within {most:.2f} s, {hits} stops hit\n")


@pytest.mark.parametrize("track", [0.4, 0.8])
@pytest.mark.parametrize("target", TARGETS)
def test_flights_lead_back_from_random_states(target: str, track: float) -> None:
    share, median, most, hits = row(target, track, {})
    told(f"{target}, ±{track} m", share, median, most, hits)
    assert share >= 0.9795
    assert median <= 1.3
    assert most <= 2.5
    assert hits == 0


@pytest.mark.parametrize("bench", BENCHES)
def test_flights_on_other_benches(bench: str) -> None:
    share, median, most, hits = row("up-up", 0.4, BENCHES[bench])
    told(bench, share, median, most, hits)
    assert share >= 0.9
