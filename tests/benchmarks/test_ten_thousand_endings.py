"""Endings agree with the true states of ten thousand failing runs, and working sensors are not reported as stuck.

`ending_truth` defines the meaning of each class. A bench is an itinerary with troubles, run with many seeds. The counts
of a bench stay in the cache until the code or the judge changes. If DPCONTROL_TESTS_CACHE names a permanent folder, an
interrupted benchmark therefore resumes at the same bench. All of it takes about half an hour of one processor. As a
program, this file judges the benches of a range and prints one line for each:

    python tests/benchmarks/test_ten_thousand_endings.py 0 200
"""

import json
import sys
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import ending_truth
import numpy as np
import pytest
from ending_truth import MOVING, class_of, flights, troubled, untrue, untrue_score

from dpcontrol.foundation.cache import cache_root, keep, kept
from dpcontrol.foundation.files import content_hash
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.runs.preflight import RUNNING

pytestmark = pytest.mark.benchmark

COUNT, SOUND = 10_000, 50_000
"""Failing runs, and runs with working sensors."""
TRUE = 0.99
TOGETHER, FAULTY = 128, 8
"""Runs of a bench in lockstep, and one by one. Every eighth bench has a failing sensor and runs one by one."""
SHARES = (0.3, 0.2, 0.16, 0.08, 0.07, 0.05, 0.05, 0.03, 0.02, 0.02, 0.02)
"""Shares of the itineraries of `MOVING`: long ones take more time for the same failures."""
SHORT = 3
"""Number of itineraries of `MOVING` for benches on which most runs complete."""
CONTROLLERS = ("tvlqr", "adaptive")
FIRST = 20_000
"""The first seed."""


@cache
def planned(name: str) -> Plan:
    return make_plan(load_itinerary(name))


@cache
def _key() -> str:
    judge = [Path(file or "").read_text() for file in (__file__, ending_truth.__file__)]
    return content_hash(f"running {RUNNING}", *judge)


def judged(number: int) -> dict[str, Any]:
    """Return the counts of bench `number`, from the cache if possible.

    The keys are `runs`, and `sound` for runs with working sensors. `stuck` counts those of them that were reported as
    stuck. `seen` counts failing runs by class. `false` lists wrong endings and scores with class, place and reason.
    """
    file = cache_root() / "endings" / f"{number}-{TOGETHER}-{FAULTY}-{_key()}.json"
    if (content := kept(file)) is not None:
        return json.loads(content)
    random, faulty = np.random.default_rng(number), number % 8 == 0
    # On every other bench, many runs complete.
    mild = not number % 2 and not faulty
    plan = planned(str(random.choice(MOVING[:SHORT]) if mild else random.choice(MOVING, p=SHARES)))
    troubles = int(random.integers(0, 2) if mild else random.integers(3, 6))
    options = troubled(random, controller=str(random.choice(CONTROLLERS)), faulty=faulty, troubles=troubles)
    count = FAULTY if faulty else 2 * TOGETHER if mild else TOGETHER
    first = FIRST + 2 * number * TOGETHER % 30_000
    seen, false, stuck = Counter[str](), list[tuple[str, str]](), list[str]()
    for flight in flights(plan.itinerary.with_run(options), plan.reference, range(first, first + count)):
        where = f"{number} {flight.scene} {flight.seed} {options}: {flight.run.reason}"
        if not faulty and "stuck" in flight.run.reason:
            stuck.append(where)
        if not flight.verdict.problem:
            continue
        seen[class_of(flight)] += 1
        if fault := untrue(flight) or untrue_score(flight):
            false.append((class_of(flight), f"{where} -> {fault}"))
    out = {"runs": count, "sound": 0 if faulty else count, "stuck": stuck, "seen": seen, "false": false}
    keep(file, json.dumps(out).encode())
    return out


def table(seen: Counter[str], false: Counter[str]) -> str:
    """Return the classes, a line each: how many endings are true of how many."""
    lines = [f"{name:20s} {seen[name] - false[name]:6d} true of {seen[name]:6d}" for name in sorted(seen)]
    return "\n".join(lines)


def test_ninety_nine_percent_of_ten_thousand_endings_are_true() -> None:
    seen, false, shown, number = Counter[str](), Counter[str](), list[str](), 0
    while seen.total() < COUNT:
        found = judged(number)
        number += 1
        seen.update(found["seen"])
        false.update(name for name, _ in found["false"])
        shown += [text for _, text in found["false"]]
    share = 1 - false.total() / seen.total()
    sys.stdout.write("\n" + "\n".join(shown[:: max(1, len(shown) // 40)]))
    sys.stdout.write(f"\n{table(seen, false)}\n{seen.total()} failing runs of {number} benches, true {share:.2%}\n")
    assert share >= TRUE


def test_in_fifty_thousand_runs_without_a_fault_no_sensor_is_called_stuck() -> None:
    runs, number, stuck = 0, 0, list[str]()
    while runs < SOUND:
        found = judged(number)
        number += 1
        runs += found["sound"]
        stuck += found["stuck"]
    sys.stdout.write("\n" + "\n".join(stuck) + f"\n{runs} runs whose sensors work, {len(stuck)} called stuck\n")
    assert not stuck


if __name__ == "__main__":
    for chosen in range(int(sys.argv[1]), int(sys.argv[2])):
        sys.stdout.write(f"{chosen} {json.dumps(judged(chosen))}\n")
        sys.stdout.flush()
