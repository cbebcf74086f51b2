"""How long it takes to calm the arms, from two hundred states that falls may leave; arms off by a fifth."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "loop"))
from calmed_runs import LIMITS, calmed

pytestmark = pytest.mark.benchmark

SEEDS, SECONDS = range(70_000, 70_200), 30.0


def test_two_hundred_falls_are_calmed() -> None:
    runs = calmed(list(SEEDS), seconds=SECONDS)
    median, nearly_all = np.quantile(runs.times, [0.5, 0.99])
    sys.stdout.write(
        f"\n{np.isfinite(runs.times).sum()} of {len(runs.times)} at rest, median {median:.2f} s, "
        f"99 % {nearly_all:.2f} s, slowest {runs.times.max():.2f} s, "
        f"cart {runs.farthest.max():.3f} m of {LIMITS.position:g} m\n"
    )
    assert np.isfinite(runs.times).all()
    assert not runs.faults
    assert median <= 12
    assert nearly_all <= 30
