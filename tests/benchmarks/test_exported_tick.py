"""Time of a tick of the exported C on one core of this computer, clock included; --junitxml stores the figures.

Only the median is asserted, with room for a busy computer, because the time of the operating system is not a property
of the code.
"""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.run import export_plan

pytestmark = pytest.mark.benchmark

MEDIANS = {"tvlqr": 2000.0, "adaptive": 4000.0}  # ns, on a quiet core.
BUSY = 2.0


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("single", [False, True], ids=["double", "single"])
@pytest.mark.parametrize("law", [*MEDIANS])
def test_a_tick_takes_microseconds(
    law: str, single: bool, compiler: str, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    scene = load_itinerary("outer-turn").with_run({"controller": law})
    folder = tmp_path / "controller"
    export_plan(make_plan(scene), folder, single=single)
    rows = np.genfromtxt(folder / "readings.csv", delimiter=",", skip_header=1)
    np.insert(rows, 3, 0.0, axis=1).astype("<f8").tofile(folder / "readings.bin")
    source = Path(__file__).with_name("tick_timing.c")
    command = [compiler, "-std=c99", "-O2", "-ffp-contract=off", "-I.", "-o", "timing", source, "dpc_controller.c",
               "dpc_tables.c", "-lm"]  # fmt: skip
    subprocess.run(command, cwd=folder, check=True)
    done = subprocess.run(["./timing", "readings.bin"], cwd=folder, capture_output=True, text=True, check=True)
    median, rare, worst, _ = map(float, done.stdout.split())
    for name, nanoseconds in (("median", median), ("of_a_thousand", rare), ("worst", worst)):
        record_property(f"{name}_ns", nanoseconds)
    assert median <= BUSY * MEDIANS[law]
