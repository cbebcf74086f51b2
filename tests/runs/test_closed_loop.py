"""The closed loop as one object: the same runs, tables and margins as by the shortcuts, its controller made once."""

from pathlib import Path

import pytest

import dpcontrol as dp
from dpcontrol.logs import compare_messages
from dpcontrol.runs.closed_loop import ClosedLoop


@pytest.fixture(scope="module")
def loop() -> ClosedLoop:
    return dp.closed_loop("outer-turn", mismatch=0.02, lag=0.002)


@pytest.mark.slow
def test_a_run_of_the_object_has_the_messages_of_the_shortcuts(loop: ClosedLoop, tmp_path: Path) -> None:
    options = {"lag": 0.002}
    loop.run(seed=3, log=tmp_path / "object.mcap")
    dp.run("outer-turn", mismatch=0.02, seed=3, settings=options, log=tmp_path / "shortcut.mcap")
    assert compare_messages(tmp_path / "object.mcap", tmp_path / "shortcut.mcap").difference is None
