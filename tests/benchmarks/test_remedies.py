"""Remedies of failed runs: at least half of the runs get one, and nearly all of them help when they are typed.

Each run has an ordinary rig with one cause of failures; the table is by cause. Two hundred take two hours of one core.
"""

import math
import shlex
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import coarse_benches
import numpy as np
import pytest
from command_line import dpcontrol

from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.overrides import typed
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.runs.campaign import Case, Job
from dpcontrol.runs.preflight import outcomes

HELPED, HELPS = 0.5, 0.95
"""Least share of the failing runs that get a remedy, and of the remedies that complete their run when typed."""
BENCH = {**coarse_benches.BENCH, "mismatch": 0.1}
CAUSES = {
    "mismatch": ("mismatch", 0.2, 0.35),
    "lag": ("lag", 0.01, 0.06),
    "delay": ("delay", 5.0, 40.0),
    "coarse encoders": ("counts", 64, 1000),
    "encoder noise": ("noise", 1e-3, 1e-2),
    "zeros": ("zero_error", 0.05, 0.4),
    "pushes": ("push_impulse", 3e-3, 3e-2),
    "command noise": ("command_noise", 2.0, 30.0),
    "small track": ("travel", 0.03, 0.3),
    "low rate": ("rate", 50.0, 300.0),
    "tilt": ("tilt", 0.01, 0.2),
    "friction": ("friction", 3.0, 30.0),
    "response": ("response", 0.5, 0.85),
    "wrong law": ("controller", 0.0, 0.0),
}
"""The setting behind each cause, and between which values it is drawn, evenly by their logarithm."""
ITINERARIES = ("outer-turn", "turn-from-rest", "cross-from-rest", "up-up", "cross")
RUNS = 200
SEEDS, EACH = 32, 2
"""Runs by which failing seeds are found, and failing runs of each cause in turn."""


def drawn_options(cause: str, random: np.random.Generator) -> dict[str, Any]:
    """Return the options of a rig with one cause of failures."""
    name, low, high = CAUSES[cause]
    if name == "controller":
        return {**BENCH, "controller": str(random.choice(["feedforward", "tvlqr"])), "mismatch": 0.2}
    value = float(f"{math.exp(random.uniform(math.log(low), math.log(high))):.3g}")
    pushes = {"pushes": 2} if cause == "pushes" else {}
    return {**BENCH, name: round(value) if name in ("counts", "delay", "rate") else value, **pushes}


def failing_runs(plans: Sequence[Plan], *, seed: int) -> Iterator[tuple[Plan, str, list[str]]]:
    """Yield an endless sequence of random failing runs, each with its plan, its cause and its options as typed."""
    random = np.random.default_rng(seed)
    while True:
        for cause in CAUSES:
            plan = plans[int(random.integers(len(plans)))]
            options = drawn_options(cause, random)
            scene, first = plan.itinerary.with_run(options), int(random.integers(10**6))
            job = Job(
                scene.name, plan.archive, scene.model.arms, Case("failing", (), scene.loop),
                tuple(range(first, first + SEEDS)), "compiled", replayed=0,
            )  # fmt: skip
            for one in [row.seed for row in outcomes(job, SEEDS) if not row.completed][:EACH]:
                yield plan, cause, [*shlex.split(typed(options)), "--seed", str(one), "--force"]


@pytest.mark.benchmark
def test_printed_remedies_help_when_they_are_typed(tmp_path: Path) -> None:
    plans = [make_plan(load_itinerary(name)) for name in ITINERARIES]
    file, log = tmp_path / "plan.npz", tmp_path / "failing.mcap"
    found: dict[str, list[list[bool]]] = defaultdict(list)
    for plan, cause, options in failing_runs(plans, seed=31):
        file.write_bytes(plan.archive)
        if dpcontrol("run", file, *options, "--out", log).code != 1:
            continue
        asked = dpcontrol("score", log, "--why", "--json", "--yes")
        assert asked.code == 1, asked.stderr
        remedies = asked.document["why"]["saves"]
        again = [("run", file, *options, *shlex.split(one), "--out", tmp_path / "typed.mcap") for one in remedies]
        found[cause].append([dpcontrol(*words).code == 0 for words in again])
        if sum(map(len, found.values())) == RUNS:
            break
    for cause, mine in found.items():
        helps = [done for one in mine for done in one]
        sys.stdout.write(f"{cause:<16} {sum(map(bool, mine))} of {len(mine)} runs; {sum(helps)} of {len(helps)} help\n")
    every = [one for mine in found.values() for one in mine]
    helps = [done for one in every for done in one]
    assert sum(helps) >= HELPS * len(helps)
    assert sum(map(bool, every)) >= HELPED * len(every)
