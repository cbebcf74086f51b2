"""After a push that OGY cannot hold, the supervisor falls back to TVLQR on the nearest orbit, and logs it."""

from pathlib import Path

import numpy as np
import pytest
from command_line import Ended, dpcontrol

from dpcontrol.foundation.errors import InputError
from dpcontrol.judge.score import plan_of
from dpcontrol.logs import RunLog, read_log
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.result import Ending, SupervisorSettings
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


def pushed(folder: Path, *options: str) -> tuple[Ended, RunLog]:
    """A run in which the inner arm is struck in the first stay, harder than pulses of bounded size can answer."""
    scene, log = folder / "pushed.toml", folder / "pushed.mcap"
    scene.write_text(PUSHED)
    ended = dpcontrol("run", scene, *options, "--out", log)
    return ended, read_log(log)


@pytest.mark.slow
def test_the_nearest_orbit_is_held_to_the_end_of_the_run(tmp_path: Path) -> None:
    ended, log = pushed(tmp_path)
    assert ended.code == 1
    assert "tracking lost at t = 1." in ended.message
    assert "holds the orbit about down-up at 0.2 J" in ended.message
    assert ended.message.endswith("by tvlqr")
    assert log.metadata["ending"] == Ending.FELL_BACK.value
    told = [(event.level, event.text.split(" at t")[0].split(",")[0]) for event in log.events]
    assert ("warn", "tracking lost") in told
    assert ("warn", "holds the orbit about down-up at 0.2 J") in told
    plan = plan_of(log)
    assert log.truth is not None
    assert log.time[-1] >= plan.duration - 1e-3
    assert np.abs(log.truth[:, 4]).max() < TRAVEL
    angles = log.truth[log.time > log.time[-1] - plan.notes["orbits"][0]["period"], :2]
    turned = angles - 2 * np.pi * np.rint((angles.mean(0) - [0, np.pi]) / (2 * np.pi))
    gaps = np.abs(turned[:, None] - plan.extra["orbit_0"][None, :, :2]).max(-1).min(1)
    assert gaps.max() < NEAR_ORBIT


@pytest.mark.slow
def test_without_it_the_same_push_ends_the_run_with_the_cart_at_rest(tmp_path: Path) -> None:
    ended, log = pushed(tmp_path, "--set", "hold=none")
    assert ended.code == 1
    assert log.metadata["ending"] == Ending.TRACKING_LOST.value
    assert log.time[-1] < 3.0
    assert log.truth is not None
    assert np.abs(log.truth[:, 4]).max() < TRAVEL
    assert abs(log.truth[-1, 5]) < 1e-3


def test_orbits_that_cannot_be_held_are_rejected() -> None:
    with pytest.raises(InputError, match="did you mean 'nearest'"):
        SupervisorSettings(hold="nearst")


@pytest.mark.parametrize(("name", "own"), [("hold-up-up", "up-up"), ("keep-up-down", "the orbit about up-down")])
def test_the_orbits_and_equilibria_of_a_reference_and_hanging_still_are_candidates(name: str, own: str) -> None:
    itinerary = load_itinerary(name).with_run({"hold": "nearest"})
    reference = make_plan(itinerary).reference
    fallback = Assembly(reference, itinerary.model.arms, itinerary.loop).fallback
    assert fallback is not None
    assert fallback.session(0, reference.state(0.0))[1].startswith(f"holds {own}")
    hanging = np.array([2 * np.pi, 0.02, 0.0, 0.0, 0.1, 0.0])
    assert fallback.session(0, hanging)[1] == "holds down-down, 0.0064 (scaled) away, by lqr"
    assert Assembly(reference, itinerary.model.arms, itinerary.with_run({"hold": "none"}).loop).fallback is None
