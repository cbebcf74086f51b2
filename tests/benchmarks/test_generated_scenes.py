"""Generated scenes are planned, flown and completed; `scene_tables.py` does the same for as many as wanted."""

from pathlib import Path

import pytest
from generated_scenes import sampled_scene
from independent_decoder import last_gap, plan_of
from independent_tubes import missing_connections
from scene_tables import scene_row
from scipy.stats import binom

from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.model import load_model
from dpcontrol.plans.plan import make_plan

PLANNED, COMPLETED = 0.8, 0.97
"""Shares of the scenes that are planned, and of their runs that are completed, at least."""
SLOW_SCENES, SLOW_RUNS, RISK = (0, 2, 3), 2, 0.01
"""Scenes of the slow test, which are planned in seconds, and the risk that too few complete by chance."""
ENDS = 0.07
"""rad: how far a reference may be off its last orbit. Runs are allowed 0.1 rad, and track within some 0.02 rad."""


def test_the_files_of_forty_scenes_are_accepted_and_reproducible(tmp_path: Path) -> None:
    for seed in range(40):
        scene = sampled_scene(seed)
        assert scene == sampled_scene(seed)
        assert load_itinerary(str(scene.write(tmp_path))).model.arms.count in (1, 2, 3)


@pytest.mark.slow
def test_three_generated_scenes_are_planned_and_completed(tmp_path: Path) -> None:
    rows = [scene_row(sampled_scene(seed), tmp_path, runs=SLOW_RUNS) for seed in SLOW_SCENES]
    assert not any(row.false_verdicts for row in rows)
    ready = sum(row.outcome == "planned" for row in rows)
    assert ready >= PLANNED * len(rows), f"{ready} of {len(rows)} scenes were planned"
    runs, done = sum(row.runs for row in rows), sum(row.completed for row in rows)
    assert done >= binom.ppf(RISK, runs, COMPLETED), f"{done} of {runs} runs were completed"


@pytest.mark.benchmark
@pytest.mark.parametrize(("energy", "missing"), [(-0.07, []), (-0.165, ["'down-up +' at -0.165 J"])])
def test_the_second_search_finds_the_turns_that_there_are(energy: float, missing: list[str], tmp_path: Path) -> None:
    """At -0.07 J eight connections are known; just above the saddle there are none."""
    (tmp_path / "lab.toml").write_text(load_model("lab").text)
    file = tmp_path / "turn.toml"
    file.write_text(f'model = "lab.toml"\nenergy = {energy}\nwalk = ["down-up +"]\n')
    assert missing_connections(file) == missing


@pytest.mark.benchmark
def test_a_reference_ends_near_the_orbit_that_its_runs_are_judged_by(tmp_path: Path) -> None:
    """With the usual weight it was 0.09 rad off, which left the feedback no room."""
    plan = make_plan(load_itinerary(str(sampled_scene(20).write(tmp_path))))
    assert plan.converged
    read = plan_of(plan.reference, 1000.0, (1.0, 1.0, 1.0))
    assert last_gap(read, read.states) < ENDS
