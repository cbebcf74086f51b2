"""Benchmarks compare side by side, for minutes. `pytest -m benchmark tests/benchmarks` runs them.

Measured ratios are compared with those in ratios.json; DPCONTROL_STORE_RATIOS=1 replaces them.
"""

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

HERE = Path(__file__).parent
STORED = HERE / "ratios.json"
KEPT = 0.5  # of a stored ratio: other machines and busy ones differ by less, a lost vector unit by more


@pytest.fixture
def one_core() -> Iterator[int]:
    """Keep this process, and those it starts, on one core; its number."""
    before = os.sched_getaffinity(0)
    core = max(before)
    os.sched_setaffinity(0, {core})
    yield core
    os.sched_setaffinity(0, before)


@pytest.fixture
def hold() -> Callable[[str, float], None]:
    """Hold a ratio against the stored one of its name, or store it."""

    def check(name: str, ratio: float) -> None:
        stored = json.loads(STORED.read_text()) if STORED.exists() else {}
        if os.environ.get("DPCONTROL_STORE_RATIOS") == "1":
            STORED.write_text(json.dumps({**stored, name: float(f"{ratio:.3g}")}, indent=1, sort_keys=True) + "\n")
        elif name in stored:
            assert ratio >= KEPT * stored[name], f"{name} was {stored[name]}, is {ratio:.3g}"

    return check
