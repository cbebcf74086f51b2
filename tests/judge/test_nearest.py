"""First lines of a run's page: its largest values against their limits, and the consistency of its filter."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "pages"))
from synthetic_run import synthetic_run, view_of

from dpcontrol.judge.nearest import limit_uses
from dpcontrol.logs import Mode


@pytest.fixture
def view(tmp_path: Path):
    return view_of(tmp_path / "run.mcap", synthetic_run())


def test_the_largest_share_of_a_limit_comes_first_with_its_time(view):
    state = np.zeros_like(view.state)
    state[10, 4], state[20, 5] = 0.3, 0.5
    still = replace(
        view, state=state, reference=None, limits=(0.4, 3.0, 30.0), control={"applied": np.zeros(len(state))}
    )
    uses = limit_uses(still)
    assert [(use.name, pytest.approx(use.share), use.time) for use in uses[:2]] == [
        ("cart position", 0.75, view.time[10]),
        ("cart velocity", 1 / 6, view.time[20]),
    ]


def test_ticks_after_an_abort_do_not_count(view):
    state, mode = np.zeros_like(view.state), np.full(len(view.time), float(Mode.TRACKING))
    state[10, 4], state[30, 4], mode[20:] = 0.1, 0.39, Mode.ABORTED
    aborted = replace(view, state=state, reference=None, limits=(0.4, 3.0, 30.0), control={"mode": mode})
    assert limit_uses(aborted)[0].largest == pytest.approx(100.0)
