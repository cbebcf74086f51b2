"""Several runs on one clock: aligned at a symbol, said how, drawn and recorded."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_run import synthetic_run, view_of

from dpcontrol.judge.comparison import compare
from dpcontrol.judge.run_view import RunView, Stay

SAME_MOMENT = 0.02
"""s: the synthetic turns pass 2π in their middle, with zero wobble and errors of 0.04 rad at 11 rad/s."""


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> list[RunView]:
    """Two runs whose turns come at 2.5 s and at 1.875 s; the second ends in the wrong place."""
    folder = tmp_path_factory.mktemp("pair")
    found = []
    for name, seconds in (("first", 5.0), ("second", 3.75)):
        view = view_of(folder / f"{name}.mcap", synthetic_run(seconds=seconds))
        planned = (Stay(0.0, seconds / 2, "down-up", "down-up"), Stay(seconds / 2, seconds, "down-up", "down-up"))
        view = replace(
            view,
            crossings=(seconds / 2,),
            plan=replace(view.plan, planned=planned, duration=5.0),
            done=(Stay(0.0, seconds / 2, "down-up", "down-up"), Stay(3.0, 3.5, "up-down", "up-down (−1π)", False)),
        )
        found.append(view)
    return found


def _passes_two_turns(time: np.ndarray, angle: np.ndarray) -> float:
    """Return when an angle first passes 2π upwards."""
    return float(np.interp(2 * np.pi, *(part[np.argsort(angle, kind="stable")] for part in (angle, time))))


def test_runs_cross_the_symbols_section_at_the_same_moment(pair: list[RunView]) -> None:
    comparison = compare(pair)
    moments = [_passes_two_turns(run.view.time, run.view.state[:, 1]) for run in comparison.runs]
    assert moments[0] == pytest.approx(moments[1], abs=SAME_MOMENT)
    assert comparison.moment == 2.5
    assert [run.delay for run in comparison.runs] == [0.0, 0.625]
    assert all(run.view.crossings == (2.5,) for run in comparison.runs)
