"""One program, solved by rockit too: costs and states agree.

rockit holds its input over an interval, so its optimum comes near this project's as the square of the interval; two of
its meshes tell the rest. DPCONTROL_ROCKIT_PYTHON: another interpreter that has rockit-meco.
"""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from shadowing_stand_in import LAB, orbit_stretch

from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.references.find import find_reference
from dpcontrol.references.problem import Limits, ReferenceProblem, ReferenceSettings, state_scale

pytestmark = pytest.mark.benchmark

PYTHON = os.environ.get("DPCONTROL_ROCKIT_PYTHON", sys.executable if find_spec("rockit") else "")
SCRIPT = Path(__file__).parent / "rockit_swing.py"
SECONDS = 0.5
INTERVALS = (50, 200)
SAME_COST = 1e-3
SAME_STATES = 1e-4


@pytest.mark.skipif(not PYTHON, reason="pip install rockit-meco, or set DPCONTROL_ROCKIT_PYTHON")
def test_rockit_finds_the_same_cost_and_states():
    orbit = orbit_stretch(SECONDS)
    problem = ReferenceProblem(arm_chain_equations(2, Level.CART), LAB.base(), orbit.guess, SECONDS)
    settings = ReferenceSettings(method="radau-7", interval=0.05, tolerance=1e-9, pendulum_weight=0.0)
    ours = find_reference(problem, settings)
    assert ours.converged, ours.status
    start, end = problem.end_states()
    times = np.linspace(0.0, SECONDS, 100_001)
    running = ours.input(times)[:, 0] ** 2 + settings.cart_weight * ours.state(times)[:, 4] ** 2
    cost = float(np.trapezoid(running, times))
    gaps, sparse = [], np.linspace(0.0, SECONDS, 101)
    for intervals in INTERVALS:
        asked = {
            "parameters": LAB.base().tolist(),
            "seconds": SECONDS,
            "cart_weight": settings.cart_weight,
            "intervals": intervals,
            "start": start.tolist(),
            "end": end.tolist(),
            "guess": np.polynomial.polynomial.polyfit(sparse, orbit.guess(sparse), 10).T.tolist(),
        }
        run = subprocess.run([PYTHON, str(SCRIPT)], input=json.dumps(asked), capture_output=True, text=True, check=True)
        theirs = json.loads(run.stdout[run.stdout.index('{"times"') :])
        away = (np.array(theirs["states"]).T - ours.state(theirs["times"])) / state_scale(6, Limits())
        gaps.append((theirs["cost"] / cost - 1, float(np.abs(away).max())))
        sys.stdout.write(
            f"\n{intervals} intervals: rockit's cost {theirs['cost']:.8f}, this one's {cost:.8f} "
            f"({gaps[-1][0]:+.1e}); states within {gaps[-1][1]:.1e}"
        )
    assert abs(gaps[-1][0]) < SAME_COST
    assert gaps[-1][1] < SAME_STATES
    # Finer by four, nearer by nearly sixteen: what is left is the held input's.
    assert gaps[0][0] > 8 * gaps[1][0] > 0
