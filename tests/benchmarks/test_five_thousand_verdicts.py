"""Verdicts agree with a second decoder on five thousand runs of random itineraries on random benches.

As a program, this file compares the itineraries of a range of seeds and prints a line for each:

    python tests/benchmarks/test_five_thousand_verdicts.py 0 40
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from generated_itineraries import write_itinerary
from verdict_runs import Comparison, drawn_options, for_plan

from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.judge.decoding import shortfall
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan

pytestmark = pytest.mark.benchmark

RUNS, FIRST = 5000, 0
"""Number of runs, and the first seed of an itinerary."""
SEEDS, BENCHES = 128, 2
KEPT = 2
"""Runs of walks whose stops are kept: they go tick by tick."""


def compare(seed: int, found: Comparison) -> str:
    """Add the runs of an itinerary, and return the status of its plan."""
    random = np.random.default_rng([seed, 5])
    with tempfile.TemporaryDirectory() as folder:
        try:
            plan = make_plan(load_itinerary(str(write_itinerary(Path(folder), seed))))
        except (GoalMissed, InputError) as error:
            return str(error)
        if plan.converged:
            assert shortfall(plan.reference) == ""
            count = KEPT if "program" in plan.reference.notes else SEEDS
            for _ in range(BENCHES):
                found.add(plan, for_plan(drawn_options(random), plan), list(range(count)), random)
        return plan.status


def test_all_verdicts_on_five_thousand_drawn_runs_are_true() -> None:
    found, seed = Comparison(), FIRST
    while found.runs < RUNS:
        compare(seed, found)
        seed += 1
    sys.stdout.write(f"\n{found.runs} runs, {found.completed} completed, {found.wrong} wrong ones made of them\n")
    assert found.wrong > 0
    assert not found.false


if __name__ == "__main__":
    for chosen in range(int(sys.argv[1]), int(sys.argv[2])):
        one = Comparison()
        how = compare(chosen, one)
        sys.stdout.write(f"{chosen}: {one.runs} runs, {one.completed} completed, {one.wrong} wrong; {how}\n")
        sys.stdout.write("".join(f"    false: {text}\n" for text in one.false))
        sys.stdout.flush()
