"""Closed walks on random models are proved on the command line within five minutes."""

from pathlib import Path

import pytest
from random_walks import MOST_SECONDS, proved, read, summary

pytest.importorskip("flint")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [10])
def test_random_walks_are_proved_and_reported(seed: int, tmp_path: Path) -> None:
    """Seed 10 has a rival connection that is nearer than the length of a step."""
    found = proved(seed, tmp_path / "walks.jsonl")
    assert found["code"] == 0, found
    assert found["cpu"] < MOST_SECONDS
    (line,) = read(tmp_path / "walks.jsonl")
    assert line["seed"] == seed
    assert "1 of 1 proved" in summary([line])
