"""Do runs complete with dry friction in the plant, whether the model has it or not?

Prints a table: Coulomb torque of the inner joint (the outer joint has half of it), its smoothing, and the completed
runs by itinerary.
"""

import re
import sys
from pathlib import Path

import pytest
from coarse_benches import completed

from dpcontrol.foundation.shipped import find
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan

ITINERARIES = ("turn-from-rest", "up-up", "cross-from-rest")
RUNS = 200
TOLD, UNTOLD = 0.98, 0.95
"""Least share of completed runs if the model has the friction, and if it has none."""
TORQUES, SMOOTHINGS = (5e-4, 1e-3, 2e-3, 5e-3), (0.005, 0.05, 0.5)
"""N m and rad/s."""


def written(folder: Path, torque: float, smoothing: float) -> Path:
    """Write the laboratory's arms with dry friction, and the itineraries for them."""
    folder.mkdir()
    model = find("models", "lab").read_text()
    (folder / "rough.toml").write_text(f"{model}coulomb = [{torque}, {torque / 2}]\nsmoothing = {smoothing}\n")
    for name in ITINERARIES:
        text, count = re.subn('(?m)^model *= *"lab"', 'model = "rough.toml"', find("itineraries", name).read_text())
        assert count == 1
        (folder / f"{name}.toml").write_text(text)
    return folder


def shares(folder: Path, title: str, *, told: bool) -> list[float]:
    """Print a row of the table and return the shares of completed runs, by itinerary."""
    found = []
    for name in ITINERARIES:
        plan = make_plan(load_itinerary(str(folder / f"{name}.toml") if told else name))
        assert any(plan.itinerary.model.arms.coulomb) == told
        share, _ = completed(plan, {} if told else {"plant": str(folder / "rough.toml")}, range(RUNS))
        found.append(share)
    counts = "  ".join(f"{round(share * RUNS):4d} of {RUNS}" for share in found)
    sys.stdout.write(f"{title} {'told  ' if told else 'untold'}  {counts}\n")
    sys.stdout.flush()
    return found


@pytest.mark.benchmark
@pytest.mark.parametrize("torque", TORQUES)
def test_runs_with_dry_friction_complete(torque: float, tmp_path: Path) -> None:
    sys.stdout.write(f"\n{'torque, smoothing':31s}  {'  '.join(ITINERARIES)}\n")
    least: dict[bool, list[float]] = {True: [], False: []}
    for smoothing in SMOOTHINGS:
        folder = written(tmp_path / f"{smoothing}", torque, smoothing)
        title = f"{1e3 * torque:3.1f} mN m {smoothing:5.3f} rad/s"
        for told in (True, False):
            least[told] += shares(folder, title, told=told)
    assert min(least[True]) >= TOLD
    assert torque > 2e-3 or min(least[False]) >= UNTOLD
