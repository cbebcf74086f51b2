"""The exported library in the simulated bench in place of the loop's tick: 20 seeds of six itineraries, masses and
lengths off by 5 %. In double precision every seed ends the same way; in single one in a hundred may not complete.
"""

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.run import export_plan, run_plan

pytestmark = pytest.mark.benchmark

ITINERARIES = ("outer-turn", "cross", "double-turn", "up-up", "turn-from-rest", "triple-turn")
SEEDS = range(20)
FEWER = 0.01  # Share of completions.


def test_runs_by_the_library_end_as_runs_by_the_loop(tmp_path: Path) -> None:
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")
    completed = {"loop": 0, "double": 0, "single": 0}
    for name in ITINERARIES:
        plan, made = make_plan(load_itinerary(name)), {"loop": None}
        for precision in ("double", "single"):
            folder = tmp_path / name / precision
            export_plan(plan, folder, single=precision == "single")
            subprocess.run(["make", "-s", "libdpc.so"], cwd=folder, check=True)
            made[precision] = folder / "libdpc.so"
        for seed in SEEDS:
            scene = load_itinerary(name).with_run({"mismatch": 0.05}, seed=seed)
            scores = {
                kind: run_plan(replace(plan, itinerary=scene), library=library).score()
                for kind, library in made.items()
            }
            for kind, score in scores.items():
                completed[kind] += bool(score.completed)
            same = [(score.completed, score.symbols_completed) for score in (scores["loop"], scores["double"])]
            assert same[0] == same[1], (name, seed)
    assert completed["single"] >= completed["loop"] - FEWER * len(ITINERARIES) * len(SEEDS), completed
