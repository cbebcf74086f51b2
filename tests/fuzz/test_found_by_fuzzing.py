"""What the fuzz tests found, each as the call that showed it."""

from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol

from dpcontrol.logs import LogWriter

REST = 'model = "lab"\nstart = "hold"\nhold = "down-down"\nseconds = 0.5\n[controller]\nkind = "lqr"\n'


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("rest.toml").write_text(REST)


def test_a_mismatch_of_minus_zero_is_none() -> None:
    assert dpcontrol("run", "rest.toml", "--mismatch=-0").code == 0


def test_a_seed_of_four_hundred_digits_is_refused() -> None:
    ended = dpcontrol("run", "rest.toml", f"--seed={400 * '9'}")
    assert ended.code == 2
    assert "seed" in ended.message
    assert "too many digits" in ended.message


def test_a_nul_character_in_an_argument_is_refused() -> None:
    ended = dpcontrol("plan", "rest.toml", "--out", "a\0b.npz")
    assert ended.code == 2
    assert "NUL" in ended.message


def test_a_name_with_a_line_break_does_not_break_the_sentence() -> None:
    ended = dpcontrol("info", "a\nb.mcap")
    assert ended.code == 2
    assert r"a\nb.mcap" in ended.message
    assert len(ended.stderr.splitlines()) == 1


@pytest.mark.parametrize("verb", ["replay", "identify"])
def test_samples_that_are_not_as_far_apart_as_the_log_says_are_refused(verb: str) -> None:
    """Their stretches were once cut into as many pieces as there would be in years."""
    _recorded(Path("slow.mcap"), period=1e-3, stamps=1e5)
    ended = dpcontrol(verb, "slow.mcap", "--out", "out.toml" if verb == "identify" else "out.mcap")
    assert ended.code == 2
    assert "apart" in ended.message


def test_a_recording_too_slow_for_swings_is_not_identified() -> None:
    _recorded(Path("slow.mcap"), period=100.0, stamps=100.0)
    ended = dpcontrol("identify", "slow.mcap", "--out", "out.toml")
    assert ended.code == 2
    assert "record faster" in ended.message


def _recorded(path: Path, *, period: float, stamps: float) -> None:
    """Write a log of 40 samples `stamps` s apart, of which it says that they are `period` s apart."""
    with LogWriter(path, arm_lengths=(0.17, 0.23), rate_hz=1 / period, has_cart=False) as log:
        log.ticks(stamps * np.arange(40), measured=np.sin(np.arange(80.0)).reshape(40, 2))
