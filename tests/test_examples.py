"""Every example runs without changes and ends with its picture."""

import runpy
from pathlib import Path

import pytest

import dpcontrol

ELSEWHERE = {"air_drag", "eddy_brake", "integral_action", "mujoco_rig"}
"""Examples that tests of their results run: test_symbolic and test_mjcf."""
EXAMPLES = sorted({file.stem for file in (Path(dpcontrol.__file__).parent / "examples").glob("[a-z]*.py")} - ELSEWHERE)
NEEDS = {
    "gym_env": "gymnasium",
    "environment_scores": "gymnasium",
    "inverted_double_pendulum": "imageio",
    "two_poles": "mujoco",
}
"""Additional packages that examples need."""


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_runs_and_ends_in_its_picture(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if name in NEEDS:
        pytest.importorskip(NEEDS[name], reason=f"{NEEDS[name]} is not installed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    runpy.run_module(f"dpcontrol.examples.{name}", run_name="__main__")
    picture = tmp_path / f"{name.replace('_', '-')}.png"
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size > 10_000
