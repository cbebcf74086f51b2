"""The closed loop as one object: the same runs, tables and margins as by the shortcuts, its controller made once."""

from pathlib import Path

import numpy as np
import pytest

import dpcontrol as dp
import dpcontrol.loop.assembly as assembly
from dpcontrol.logs import compare_messages
from dpcontrol.runs.closed_loop import ClosedLoop


@pytest.fixture(scope="module")
def loop() -> ClosedLoop:
    return dp.closed_loop("outer-turn", mismatch=0.02, lag=0.002)


def test_a_run_of_the_object_has_the_messages_of_the_shortcuts(loop: ClosedLoop, tmp_path: Path) -> None:
    options = {"lag": 0.002}
    loop.run(seed=3, log=tmp_path / "object.mcap")
    dp.run("outer-turn", mismatch=0.02, seed=3, settings=options, log=tmp_path / "shortcut.mcap")
    assert compare_messages(tmp_path / "object.mcap", tmp_path / "shortcut.mcap").difference is None


@pytest.mark.slow
def test_runs_differ_by_their_seed_alone_whatever_was_run_before(loop: ClosedLoop) -> None:
    first, other, again = (loop.run(seed=seed).log for seed in (3, 4, 3))
    assert np.array_equal(first.states["truth"], again.states["truth"])
    assert not np.array_equal(first.states["truth"], other.states["truth"])
    assert first.metadata["seed"] == again.metadata["seed"] == "3"


@pytest.mark.slow
def test_the_controller_is_made_once_for_runs_margins_and_export(monkeypatch: pytest.MonkeyPatch) -> None:
    made, make = [], assembly.make_controller

    def counted(*of, **how):
        made.append(of)
        return make(*of, **how)

    monkeypatch.setattr(assembly, "make_controller", counted)
    loop = dp.closed_loop("outer-turn", settings={"mismatch": 0.02})
    assert loop.run(seed=1).converged
    assert loop.run(seed=2).converged
    assert loop.margins().least().keys() >= {"delay"}
    assert "dpc_controller.h" in loop.export(single=True).files
    assert len(made) == 1


@pytest.mark.slow
def test_a_campaign_of_the_object_counts_as_the_shortcut_does(loop: ClosedLoop) -> None:
    options = {"lag": 0.002}
    own = loop.campaign(runs=4).table.to_pylist()
    assert own == dp.campaign("outer-turn", runs=4, mismatch=0.02, settings=options).table.to_pylist()


def test_an_unknown_setting_is_named_before_anything_is_planned() -> None:
    with pytest.raises(dp.InputError, match=r"mismatches: no run has this setting; did you mean 'mismatch'"):
        dp.closed_loop("outer-turn", mismatches=0.1)
