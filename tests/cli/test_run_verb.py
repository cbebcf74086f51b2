"""`dpcontrol run` and `dpcontrol score`: completion is decided again here, from the log's true states as the public
ROS 2 decoder reads them.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol
from independent_pendulum import SADDLES, angle_gaps, lyapunov_orbit
from mcap_ros2.reader import read_ros2_messages
from numpy.typing import NDArray
from reference_values import LYAPUNOV_ORBITS

SEEDS = range(20)
MISMATCH = ("--mismatch", "0.02", "--initial-error", "0.02")
NEAR_ORBIT = 0.1  # rad, by the definition of "completed"
LIMITS = {"position": 0.4, "velocity": 3.0, "acceleration": 30.0}
LIMIT_SLACK = 1e-9


@dataclass(frozen=True)
class Journey:
    """The first and the last orbit of an itinerary, and the whole turns between their named places."""

    source: str
    target: str
    turns: tuple[int, int]
    energy: float
    symbol: str


JOURNEYS = {
    "outer-turn": Journey("down-up", "down-up", (0, 1), -0.07, "down-up +"),
    "cross": Journey("down-up", "up-down", (0, 0), 0.2, "down-up > up-down"),
}
OTHERS = pytest.mark.slow, pytest.mark.benchmark
FIRST, SOME = 1, 4
"""Seeds of each itinerary that every test run flies, and that the slow tests do; the others are for benchmarks."""
CASES = [
    pytest.param(name, seed, id=f"{name}-{seed}", marks=[] if seed < FIRST else OTHERS[seed >= SOME])
    for name in JOURNEYS
    for seed in SEEDS
]


def series(log: Path, *topics: str) -> list[tuple[NDArray[np.float64], list]]:
    """Return log times in s and the decoded messages of each topic; the decoder reads the whole log each time."""
    found: dict[str, list] = {topic: [] for topic in topics}
    for message in read_ros2_messages(str(log), topics=list(topics)):
        found[message.channel.topic].append(message)
    return [(np.array([m.log_time_ns * 1e-9 for m in each]), [m.ros_msg for m in each]) for each in found.values()]


@pytest.mark.parametrize(("itinerary", "seed"), CASES)
def test_every_seed_completes_the_itinerary_by_the_true_state(itinerary: str, seed: int, tmp_path: Path) -> None:
    journey, log = JOURNEYS[itinerary], tmp_path / "run.mcap"
    ended = dpcontrol("run", itinerary, "--seed", str(seed), *MISMATCH, "--out", log, "--json")
    shown = ended.document
    assert ended.code == 0
    assert shown["completed"] is True
    assert (shown["log"], shown["seed"]) == (str(log), seed)
    assert shown["symbols_completed"] == shown["symbols_total"] == 1
    assert 0 < shown["rms_tracking_error"] < NEAR_ORBIT
    assert 0.8 < shown["nis_inside_95"] <= 1.0
    assert shown["real_time_factor"] > 0
    assert 0 < shown["thinking"]["median"] <= shown["thinking"]["within_99"]

    (time, truth), (_, control) = series(log, "/truth/joint_states", "/control")
    assert list(truth[0].name) == ["arm_1", "arm_2", "cart"]
    positions = np.array([m.position for m in truth])
    velocities = np.array([m.velocity for m in truth])
    angles = positions[:, :2]
    first, last = (LYAPUNOV_ORBITS["lab", s, journey.energy][1] for s in (journey.source, journey.target))
    assert time[-1] - time[0] > 2 * first + 2 * last
    begin = angles[time < time[0] + 2 * first]
    end = angles[time > time[-1] - last]
    arrival = SADDLES[journey.target] + 2 * np.pi * np.array(journey.turns)
    assert angle_gaps(begin, lyapunov_orbit(journey.source, journey.energy)).max() <= 2 * NEAR_ORBIT
    at_home = end - (arrival - SADDLES[journey.target])
    assert angle_gaps(at_home, lyapunov_orbit(journey.target, journey.energy)).max() <= NEAR_ORBIT

    assert np.abs(positions[:, 2]).max() <= LIMITS["position"] + LIMIT_SLACK
    assert np.abs(velocities[:, 2]).max() <= LIMITS["velocity"] + LIMIT_SLACK
    applied = np.array([m.applied for m in control])
    assert np.abs(applied).max() <= LIMITS["acceleration"] + LIMIT_SLACK
    assert shown["max_cart_position"] == pytest.approx(np.abs(positions[:, 2]).max(), rel=1e-12)
    assert shown["rms_cart_acceleration"] == pytest.approx(np.sqrt(np.mean(applied**2)), rel=1e-9)
