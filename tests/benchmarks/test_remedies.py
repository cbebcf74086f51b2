"""Remedies of failed runs: at least half of the runs get one, and nearly all of them help when they are typed.

Prints a table by cause. Two hundred runs take some two hours of one core.
"""

import sys
from collections import defaultdict
from itertools import islice
from pathlib import Path

import pytest
from failing_runs import CAUSES, Typed, failing_runs, typed_remedies

from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan

HELPED, HELPS = 0.5, 0.95
"""Least share of the failing runs that get a remedy, and of the remedies that complete their run when typed."""


@pytest.mark.parametrize(
    ("itineraries", "runs"),
    [
        pytest.param(("outer-turn",), 5, marks=pytest.mark.slow),
        pytest.param(
            ("outer-turn", "turn-from-rest", "cross-from-rest", "up-up", "cross"), 200, marks=pytest.mark.benchmark
        ),
    ],
)
def test_printed_remedies_help_when_they_are_typed(itineraries: tuple[str, ...], runs: int, tmp_path: Path) -> None:
    plans = [make_plan(load_itinerary(name)) for name in itineraries]
    files = {}
    for plan in plans:
        files[plan.itinerary.name] = tmp_path / f"{plan.itinerary.name}.npz"
        files[plan.itinerary.name].write_bytes(plan.archive)
    tried = (typed_remedies(run, files[run.itinerary], tmp_path) for run in failing_runs(plans, seed=31))
    found = []
    for one in islice((one for one in tried if one is not None), runs):
        found.append(one)
        sys.stdout.write(f"{len(found):3d} {one.run.itinerary} {one.run.cause}: {one.helps or one.sentence}\n")
        sys.stdout.flush()
    by_cause: dict[str, list[Typed]] = defaultdict(list)
    for one in found:
        by_cause[one.run.cause].append(one)
    for cause in CAUSES:
        mine = by_cause[cause]
        helps = [done for one in mine for done in one.helps.values()]
        runs_helped = sum(bool(one.helps) for one in mine)
        sys.stdout.write(f"{cause:<16} {runs_helped} of {len(mine)} runs; {sum(helps)} of {len(helps)} remedies\n")
    remedies = [done for one in found for done in one.helps.values()]
    assert sum(remedies) >= HELPS * len(remedies)
    assert sum(bool(one.helps) for one in found) >= HELPED * len(found)
    assert all(one.sentence.startswith("none of") for one in found if not one.helps)
