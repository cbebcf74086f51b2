"""Closed walks on random models are proved on the command line within five minutes, or refused with a reason."""

import resource
from pathlib import Path

import pytest
from command_line import dpcontrol
from random_walks import walk_case, write

pytest.importorskip("flint")

MOST_SECONDS = 300.0
"""Processor time for one walk, as required."""


def verdict(seed: int, folder: Path) -> bool:
    """Return whether a walk is proved; a refusal must have a reason."""
    case = walk_case(seed)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_utime
    ended = dpcontrol("prove", "walk", write(case, folder), *case.arguments, "--yes", "--json")
    spent = resource.getrusage(resource.RUSAGE_SELF).ru_utime - before
    assert ended.code in (0, 1, 2), ended.stderr
    assert ended.message or ended.code == 0
    assert "false" not in ended.message
    assert spent < MOST_SECONDS
    return ended.code == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [10, 23])
def test_random_walks_are_proved(seed: int, tmp_path: Path) -> None:
    """Seed 10 has a rival connection that is nearer than the length of a step."""
    assert verdict(seed, tmp_path)


@pytest.mark.benchmark
def test_three_of_four_random_walks_are_proved(tmp_path: Path) -> None:
    assert sum(verdict(seed, tmp_path) for seed in range(40)) >= 30
