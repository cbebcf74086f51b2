"""Endings agree with the true states of ten thousand failing runs, and working sensors are not reported as stuck.

`ending_truth` defines the meaning of each class. A bench is an itinerary with troubles, run with many seeds. Every
eighth has a failing sensor and runs one by one; on every other one, many runs complete. Half an hour of one processor.
"""

import sys
from collections import Counter
from functools import cache

import numpy as np
import pytest
from ending_truth import MOVING, class_of, flights, troubled, untrue, untrue_score

from dpcontrol.foundation.causes import Cause
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan

COUNT, SOUND = 10_000, 50_000
"""Failing runs, and runs with working sensors."""
TRUE = 0.99
TOGETHER, FAULTY = 128, 8
SHARES = (0.3, 0.2, 0.16, 0.08, 0.07, 0.05, 0.05, 0.03, 0.02, 0.02, 0.02)
"""Shares of the itineraries of `MOVING`: long ones take more time for the same failures."""
SHORT = 3
"""Number of itineraries of `MOVING` for benches on which most runs complete."""


@cache
def planned(name: str) -> Plan:
    return make_plan(load_itinerary(name))


@pytest.mark.benchmark
def test_ninety_nine_percent_of_ten_thousand_endings_are_true_and_no_working_sensor_is_called_stuck() -> None:
    seen, false, stuck, sound, number = Counter[str](), list[str](), list[str](), 0, 0
    while seen.total() < COUNT or sound < SOUND:
        random, faulty = np.random.default_rng(number), number % 8 == 0
        mild = not number % 2 and not faulty
        plan = planned(str(random.choice(MOVING[:SHORT]) if mild else random.choice(MOVING, p=SHARES)))
        troubles = int(random.integers(0, 2) if mild else random.integers(3, 6))
        law = str(random.choice(["tvlqr", "adaptive"]))
        scene = plan.itinerary.with_run(troubled(random, controller=law, faulty=faulty, troubles=troubles))
        count = FAULTY if faulty else 2 * TOGETHER if mild else TOGETHER
        first = 20_000 + 2 * number * TOGETHER % 30_000
        for flight in flights(scene, plan.reference, range(first, first + count)):
            if not faulty and flight.run.end.cause == Cause.STUCK:
                stuck.append(f"bench {number}, seed {flight.seed}: {flight.run.reason}")
            if not flight.verdict.completed:
                seen[class_of(flight)] += 1
                if fault := untrue(flight) or untrue_score(flight):
                    false.append(f"bench {number}, seed {flight.seed}: {flight.run.reason} -> {fault}")
        sound += 0 if faulty else count
        number += 1
    sys.stdout.write("\n" + "\n".join(false) + f"\n{dict(seen)}, {len(false)} false; {sound} runs whose sensors work\n")
    assert len(false) <= (1 - TRUE) * seen.total()
    assert not stuck
