"""Estimators: time by kind and extras, ticks of ten minutes, consistency.

Times are ratios side by side; the table is for reading.
"""

import sys
import time
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / "control"))
sys.path.append(str(Path(__file__).parents[1]))
from estimator_runs import COUNT, MODEL, NOISE, SWING, estimated, run
from simulated_consistency import simulated_consistency

from dpcontrol.control.ekf import CompiledEkf, EkfProgram
from dpcontrol.control.estimator_settings import EkfSettings, UkfSettings
from dpcontrol.loop.bench import SensorSettings
from dpcontrol.loop.controllers import make_estimator

pytestmark = pytest.mark.benchmark

EXTRAS: list[tuple[str, ...]] = [(), ("zeros",), ("zeros", "disturbance"), ("zeros", "friction", "parameters")]
FASTER = 2.0
"""Times that the compiled filter is quicker than filterpy's unscented one with the same equations."""
TOGETHER = 5.0
"""Times that a tick among 256 runs is quicker than one alone."""
TICKS = 600_000
"""Ten minutes at 1 kHz."""
RUNS = 200
"""Simulated runs for each set of extras; half as many for each resolution."""
COUNTS = (500, 1000, 4000, 10_000, 40_000, 400_000)


def least(function, *, count: int = 400, tries: int = 5) -> float:
    """Return the least mean time in µs of a call."""
    best = np.inf
    for _ in range(tries):
        began = time.perf_counter()
        for _ in range(count):
            function()
        best = min(best, (time.perf_counter() - began) / count)
    return best * 1e6


def test_time_of_a_tick_by_kind_and_extras(one_core, hold):
    flown = run(0.1)
    sys.stdout.write("\nextras                        size  kind          µs     ahead  of 256, each\n")
    for augment in EXTRAS:
        spent = {}
        for settings in (EkfSettings, UkfSettings):
            estimator = make_estimator(settings(augment=augment), MODEL, noise=NOISE)
            last = estimated(estimator, flown)[-1]
            measured = flown.measured(99)
            spent[estimator.kind] = least(lambda e=estimator, x=last, z=measured: e.step(x, 0.1, z))
            ahead = least(lambda e=estimator, x=last: e.ahead(x, [0.1]))
            each = np.nan
            if isinstance(estimator, CompiledEkf):
                program = estimator.program
                inputs, out = program.inputs(NOISE, runs=256), np.empty((program.step.size_out, 256))
                inputs[program.slices["memory"]] = last.memory[:, None]
                inputs[program.slices["measured"]] = measured[:, None]
                each = least(lambda p=program, i=inputs, o=out: p.step(i, o), count=40) / 256
                assert spent[estimator.kind] / each > TOGETHER
            sys.stdout.write(
                f"{'+'.join(augment):28s}  {len(last.sigmas):4d}  {estimator.kind:12s}  {spent[estimator.kind]:5.1f}  "
                f"{ahead:5.1f}  {each:5.2f}\n"
            )
        assert spent["ukf"] / spent["ekf"] > FASTER
        if not augment:
            hold("estimator: compiled over unscented", spent["ukf"] / spent["ekf"])


@pytest.mark.parametrize("start", [(0.0,) * 6, (np.pi, np.pi, 0, 0, 0, 0), SWING])
@pytest.mark.parametrize("augment", [(), ("zeros",)])
def test_ten_minutes_leave_the_covariance_positive(start, augment):
    # An exact motion, almost no noise assumed: the covariance becomes as small as it can.
    ekf = CompiledEkf(MODEL, EkfSettings(augment=augment, rate_noise=1e-4, parameter_error=1e-4), noise=NOISE)
    truth = np.array(start, dtype=float)
    estimate, lowest = ekf.first(truth), 1.0
    for k in range(TICKS):
        truth = MODEL.step(truth, 0.0) if start == SWING else truth
        estimate = ekf.step(estimate, 0.0, truth[[0, 1, 4]])
        if k % 5000 == 0:
            p, s = ekf.covariance(estimate), estimate.sigmas
            lowest = min(lowest, float(np.linalg.eigvalsh(p / np.outer(s, s)).min()))
    sys.stdout.write(f"\nleast eigenvalue of the correlations {lowest:.2e}\n")
    assert lowest > 1e-12


def test_consistency_by_extras_and_by_resolution():
    commands = 0.5 * np.sin(2.5e-3 * np.arange(6000))
    first = np.array(SWING)
    for augment in EXTRAS:
        program = EkfProgram(MODEL, EkfSettings(augment=augment))
        found = simulated_consistency(program, NOISE, first=first, commands=commands, runs=RUNS, seed=1)
        sys.stdout.write(f"\n{'+'.join(augment):28s} NIS {found.nis_inside_95:.4f}  NEES {found.nees_inside_95:.4f}")
        assert 0.93 <= found.nis_inside_95 <= 0.97
        assert 0.93 <= found.nees_inside_95 <= 0.97
    program = EkfProgram(MODEL, EkfSettings(augment=()))
    sys.stdout.write("\ncounts   NIS inside  NEES inside  mean NIS  mean NEES\n")
    for counts in COUNTS:
        share = 40_000 / counts
        steps = np.array([COUNT * share, COUNT * share, 1e-6])
        noise = SensorSettings(counts=counts).covariance(2)
        found = simulated_consistency(
            program, noise, first=first, commands=commands, runs=RUNS // 2, seed=1, steps=steps
        )
        sys.stdout.write(
            f"{counts:7d}  {found.nis_inside_95:10.4f}  {found.nees_inside_95:11.4f}  {found.mean_nis:8.3f}  "
            f"{found.mean_nees:9.3f}\n"
        )
        assert found.mean_nis == pytest.approx(3.0, rel=0.05)
