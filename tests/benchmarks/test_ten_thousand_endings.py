"""Does an ending say what was true? Ten thousand failing runs against their true states; and sensors that work.

Each test prints its counts. `COUNT` and `SOUND` may be lowered for a look: the order of the scenes is drawn.
"""

import sys
from collections import Counter
from functools import cache

import numpy as np
import pytest
from ending_truth import MOVING, class_of, flights, troubled, untrue, untrue_score

from dpcontrol.loop.loop import loop_controller, run_batch
from dpcontrol.scenes.itinerary import load_itinerary
from dpcontrol.scenes.plan import Plan, make_plan

pytestmark = pytest.mark.benchmark

COUNT, SOUND = 10_000, 50_000
"""Failing runs, and runs whose sensors work."""
TRUE = 0.99
TOGETHER, FAULTY = 64, 8
"""Runs of a bench in lockstep, and one by one."""
SHARES = (0.2, 0.16, 0.16, 0.14, 0.12, 0.07, 0.05, 0.04, 0.02, 0.02, 0.02)
"""Of the scenes of `MOVING`: the longer ones take more time for the same failures."""
CONTROLLERS = ("tvlqr", "adaptive")
FIRST = 20_000
"""The first seed."""


@cache
def planned(name: str) -> Plan:
    return make_plan(load_itinerary(name))


def test_of_ten_thousand_failing_runs_ninety_nine_in_a_hundred_say_what_was_true() -> None:
    seen, false, shown = Counter[str](), Counter[str](), list[str]()
    for number in range(100_000):
        if seen.total() >= COUNT:
            break
        random = np.random.default_rng(number)
        plan, faulty = planned(str(random.choice(MOVING, p=SHARES))), number % 4 == 0
        options = troubled(random, controller=str(random.choice(CONTROLLERS)), faulty=faulty)
        first = FIRST + number * TOGETHER % 30_000
        count = FAULTY if faulty else TOGETHER
        for flight in flights(plan.itinerary.with_run(options), plan.reference, range(first, first + count)):
            if not flight.verdict.problem:
                continue
            seen[class_of(flight)] += 1
            if fault := untrue(flight) or untrue_score(flight):
                false[class_of(flight)] += 1
                shown.append(f"{number} {flight.scene} {flight.seed} {options.given()}: {flight.run.reason} -> {fault}")
    sys.stdout.write("\n" + "\n".join(shown[:: max(1, len(shown) // 40)]))
    share = 1 - false.total() / seen.total()
    sys.stdout.write(f"\n{seen.total()} failing runs {dict(seen)}; untrue {dict(false)}; true {share:.2%}\n")
    assert share >= TRUE


def test_in_fifty_thousand_runs_without_a_fault_no_sensor_is_called_stuck() -> None:
    runs, stuck = 0, list[str]()
    number = 0
    while runs < SOUND:
        random = np.random.default_rng([number, 1])
        number += 1
        plan = planned(str(random.choice(MOVING[:5], p=(0.35, 0.25, 0.15, 0.15, 0.1))))
        scene = plan.itinerary.with_run(troubled(random, controller=str(random.choice(CONTROLLERS))))
        loop, arms, first = scene.loop, scene.model.arms, FIRST + number * TOGETHER % 30_000
        found = run_batch(
            arms, settings=loop, seeds=range(first, first + TOGETHER),
            controller=loop_controller(plan.reference, arms, loop), limits=loop.limits(plan.reference),
        )  # fmt: skip
        runs += len(found)
        stuck += [f"{number - 1} {scene.name} {loop}: {run.reason}" for run in found if "stuck" in run.reason]
    sys.stdout.write("\n" + "\n".join(stuck) + f"\n{runs} runs whose sensors work, {len(stuck)} called stuck\n")
    assert not stuck
