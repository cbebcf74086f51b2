"""The L1-L2 connection of the three-body problem, end to end, against hiten 0.5.4 side by side.

Each is a fresh process on one core with one thread; times include import and compilation. hiten is given the two
orbits; dpcontrol finds them as well. A gap is the largest jump of position or velocity where the pieces meet.
"""

import json
import os
import resource
import subprocess
import sys

import pytest

from dpcontrol.scenes.model import load_model
from dpcontrol.tubes.lyapunov import lyapunov_orbit

ENERGY = -1.5175
FASTER, CLOSER = 60, 1e6
STEP, TURNS = 0.005, 1.0  # of hiten: share of a period between seeds; flight in units of 2π
SAME_ORBIT = 1e-7  # hiten's correction keeps the given state to this in energy and period
PYTHON = os.environ.get("DPCONTROL_HITEN_PYTHON")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS")


def spent(command):
    """Run a command; return its processor seconds, those of its children with them, and its JSON output."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        command, env={**os.environ, **dict.fromkeys(THREADS, "1")}, capture_output=True, text=True, check=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, json.loads(done.stdout)


@pytest.mark.benchmark
@pytest.mark.skipif(PYTHON is None, reason="set DPCONTROL_HITEN_PYTHON to a Python that has hiten 0.5.4")
def test_a_connection_is_found_60_times_faster_than_by_hiten_and_closed_a_million_times_better(one_core, hold, capsys):
    system = load_model("three-body").system
    orbits = [lyapunov_orbit(system, point, energy=ENERGY) for point in ("L1", "L2")]
    task = {
        "mu": float(system.parameters[0]),
        "orbits": [[float(x) for x in orbit.state] for orbit in orbits],
        "step": STEP,
        "turns": TURNS,
    }
    script = os.path.join(os.path.dirname(__file__), "hiten_connection.py")
    theirs, found = spent([PYTHON, script, json.dumps(task)])
    command = ["connect", "three-body", "--from", "L1", "--to", "L2", "--energy", str(ENERGY), "--hits", "2", "--json"]
    ours, answer = spent([sys.executable, "-c", "from dpcontrol.cli.main import main; main()", *command])

    for orbit, given in zip(found["orbits"], orbits, strict=True):
        assert orbit["energy"] == pytest.approx(ENERGY, abs=SAME_ORBIT)
        assert orbit["period"] == pytest.approx(given.period, abs=SAME_ORBIT)
    gap = max(connection["residual"] for connection in answer["connections"])
    assert found["gaps"], "hiten found no connection: take more seeds or a wider pairing radius"
    with capsys.disabled():
        sys.stdout.write(
            f"\nL1 to L2 at {ENERGY}, core {one_core}\n{'':12s}{'seconds':>10s}{'found':>8s}{'gap':>12s}\n"
            f"{'dpcontrol':12s}{ours:10.2f}{len(answer['connections']):8d}{gap:12.1e}\n"
            f"{'hiten':12s}{theirs:10.2f}{len(found['gaps']):8d}{min(found['gaps']):12.1e}\nratio {theirs / ours:.0f}\n"
        )
    assert min(found["gaps"]) >= CLOSER * gap
    assert theirs / ours >= FASTER
    hold("connection from L1 to L2: times faster than hiten", theirs / ours)
