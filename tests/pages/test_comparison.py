"""Several runs on one clock: aligned at a symbol, said how, drawn and recorded."""

import numpy as np
import pytest

import dpcontrol as dp
from dpcontrol.judge.comparison import compare
from dpcontrol.judge.of_log import run_view

TICK = 1e-3
"""s."""


def test_runs_cross_the_symbols_section_at_the_same_moment() -> None:
    views = [run_view(dp.run(name, seed=1).log) for name in ("double-turn", "turn-from-rest")]
    comparison = compare(views, symbol=2)
    for run in comparison.runs:
        turns = np.floor(run.view.state[:, 1] / (2 * np.pi))
        passed = run.view.time[1:][np.diff(turns) != 0]
        assert np.abs(passed - comparison.moment).min() <= TICK
        assert run.view.crossings[1] == pytest.approx(comparison.moment)
    assert comparison.runs[0].delay == 0
    assert comparison.runs[1].delay > 0.05
