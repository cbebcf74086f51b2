"""Closed walks on random models are proved on the command line within five minutes, or refused with a reason."""

from pathlib import Path

import pytest
from random_walks import MOST_SECONDS, proved, read, summary

pytest.importorskip("flint")


def verdict(seed: int, folder: Path) -> bool:
    """True if a walk is proved; a refusal must have a reason."""
    found = proved(seed, folder / "walks.jsonl")
    assert found["code"] in (0, 1, 2), found
    assert len(found["status"]) > 20, found
    assert "false" not in found["status"]
    assert found["cpu"] < MOST_SECONDS
    return found["code"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [10, 22])
def test_random_walks_are_proved_and_reported(seed: int, tmp_path: Path) -> None:
    """Seed 10 has a rival connection that is nearer than the length of a step."""
    assert verdict(seed, tmp_path)
    (line,) = read(tmp_path / "walks.jsonl")
    assert line["seed"] == seed
    assert "1 of 1 proved" in summary([line])


@pytest.mark.benchmark
def test_three_of_four_random_walks_are_proved(tmp_path: Path) -> None:
    assert sum(verdict(seed, tmp_path) for seed in range(40)) >= 30
