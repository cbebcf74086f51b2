"""After a push that OGY cannot hold, the supervisor falls back to TVLQR on the nearest orbit, and logs it."""

from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol

from dpcontrol.judge.score import plan_of
from dpcontrol.logs import read_log
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.result import Ending
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan

TRAVEL = 0.4
NEAR_ORBIT = 0.2
"""rad over the last period: the orbit of a plant 2 % off is about 0.1 rad away."""
PUSHED = """
energy = 0.2
walk = ["down-up +"]
lead_in = 6
lead_out = 2
[controller]
keep = "ogy"
[estimator]
augment = []
[supervisor]
lost_tracking = 0.05
hold = "nearest"
[run]
mismatch = 0.02
initial_error = 0.01
counts = 40000
[[run.blows]]
time = 1.5
arm = 0
rate = 3.0
"""


@pytest.mark.slow
def test_the_nearest_orbit_is_held_to_the_end_of_the_run(tmp_path: Path) -> None:
    # The inner arm is struck in the first stay, harder than pulses of bounded size can answer.
    scene = tmp_path / "pushed.toml"
    scene.write_text(PUSHED)
    assert dpcontrol("run", scene, "--out", tmp_path / "pushed.mcap").code == 1
    log = read_log(tmp_path / "pushed.mcap")
    assert log.metadata["ending"] == Ending.FELL_BACK.value
    assert any(event.text.startswith("holds the orbit about down-up") for event in log.events)
    plan = plan_of(log)
    assert log.truth is not None
    assert log.time[-1] >= plan.duration - 1e-3
    assert np.abs(log.truth[:, 4]).max() < TRAVEL
    angles = log.truth[log.time > log.time[-1] - plan.content.orbits[0].period, :2]
    turned = angles - 2 * np.pi * np.rint((angles.mean(0) - [0, np.pi]) / (2 * np.pi))
    gaps = np.abs(turned[:, None] - plan.content.orbits[0].curve[None, :, :2]).max(-1).min(1)
    assert gaps.max() < NEAR_ORBIT


@pytest.mark.parametrize(("name", "own"), [("hold-up-up", "up-up"), ("keep-up-down", "the orbit about up-down")])
def test_the_orbits_and_equilibria_of_a_reference_and_hanging_still_are_candidates(name: str, own: str) -> None:
    itinerary = load_itinerary(name).with_run({"hold": "nearest"})
    reference = make_plan(itinerary).reference
    fallback = Assembly(reference, itinerary.model.arms, itinerary.loop).fallback
    assert fallback is not None
    assert fallback.session(0, reference.state(0.0))[1].startswith(f"holds {own}")
    hanging = np.array([2 * np.pi, 0.02, 0.0, 0.0, 0.1, 0.0])
    assert fallback.session(0, hanging)[1].startswith("holds down-down, 0.0064")
    assert Assembly(reference, itinerary.model.arms, itinerary.with_run({"hold": "none"}).loop).fallback is None
