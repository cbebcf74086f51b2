"""A minute on the UDP bench at 1 kHz, on a computer that grants priority or has a core to spare."""

from pathlib import Path

import pytest
from command_line import dpcontrol

pytestmark = pytest.mark.benchmark

TICKS = 60_000
LONG_WALK = """
title = "A turn, a minute of wobbles about it, and back"
model = "lab"
energy = -0.07
walk = ["down-up +", "down-up -"]
wraps = [74]
"""


def test_a_minute_at_a_kilohertz_completes_and_its_missed_deadlines_are_counted(tmp_path: Path) -> None:
    scene = tmp_path / "minute.toml"
    scene.write_text(LONG_WALK)
    ended = dpcontrol("run", scene, "--rig", "udp", "--real-time", "--out", tmp_path / "minute.mcap", "--json")
    shown = ended.document
    assert ended.code == 0, ended.message
    assert shown["ending"] == "finished"
    assert shown["completed"] is None
    assert shown["symbols_completed"] == 2
    deadlines = shown["deadlines"]
    assert deadlines["ticks"] >= TICKS
    assert 0 <= deadlines["missed"] <= deadlines["ticks"]
    assert deadlines["worst"] >= deadlines["lateness_99"] >= deadlines["lateness_median"] >= 0
