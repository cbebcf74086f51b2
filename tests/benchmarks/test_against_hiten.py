"""The L1-L2 connection of the three-body problem, end to end, against hiten 0.5.4 side by side.

Each is a fresh process on one core with one thread. Times include import and compilation, with caches of compiled code
that untimed runs fill. hiten gets the two orbits, and dpcontrol computes them. A gap is the largest jump of position
or velocity between the pieces.
"""

import json
import os
import resource
import subprocess
import sys

import pytest

from dpcontrol.bench.design import SLOWER, WIDER
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.plans.model import load_model

ENERGY = -1.5175
KEPT = 0.5  # of the stored ratio of times: other machines and busy ones differ by less
STEP, TURNS = 0.005, 1.0  # of hiten: share of a period between seeds; flight in units of 2π
SAME_ORBIT = 1e-7  # hiten's correction keeps the given state to this in energy and period
PYTHON = os.environ.get("DPCONTROL_HITEN_PYTHON")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS")


def spent(command):
    """Run a command on one core; return processor seconds and its JSON."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, **dict.fromkeys(THREADS, "1")}
    core = str(max(os.sched_getaffinity(0)))
    done = subprocess.run(["taskset", "-c", core, *command], env=environment, capture_output=True, text=True)
    # The connections are complete in the output, although open cuts may hide others, which ends with code 1.
    assert done.returncode in (0, 1), done.stderr
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, json.loads(done.stdout)


@pytest.mark.benchmark
@pytest.mark.skipif(PYTHON is None, reason="set DPCONTROL_HITEN_PYTHON to a Python that has hiten 0.5.4")
def test_a_connection_is_found_faster_than_by_hiten_and_closed_a_million_times_better():
    system = load_model("three-body").system
    orbits = [lyapunov_orbit(system, point, energy=ENERGY) for point in ("L1", "L2")]
    states = [[float(x) for x in orbit.state] for orbit in orbits]
    task = {"mu": float(system.parameters[0]), "orbits": states, "step": STEP, "turns": TURNS}
    script = os.path.join(os.path.dirname(__file__), "hiten_connection.py")
    command = ["connect", "three-body", "--from", "L1", "--to", "L2", "--energy", str(ENERGY), "--hits", "2", "--json"]
    run = [sys.executable, "-c", "from dpcontrol.cli.main import main; main()", *command]
    spent([PYTHON, script, json.dumps(task)])
    # The second use optimises the code that later uses find in the cache.
    spent(run)
    spent(run)
    theirs, found = spent([PYTHON, script, json.dumps(task)])
    ours, answer = spent(run)
    for orbit, given in zip(found["orbits"], orbits, strict=True):
        assert orbit["energy"] == pytest.approx(ENERGY, abs=SAME_ORBIT)
        assert orbit["period"] == pytest.approx(given.period, abs=SAME_ORBIT)
    gap = max(connection["residual"] for connection in answer["connections"])
    assert found["gaps"], "hiten found no connection: take more seeds or a wider pairing radius"
    sys.stdout.write(f"\n{ours:.2f} s, gap {gap:.1e}; hiten {theirs:.2f} s, gap {min(found['gaps']):.1e}\n")
    assert min(found["gaps"]) >= WIDER * gap
    assert theirs / ours >= KEPT * SLOWER
