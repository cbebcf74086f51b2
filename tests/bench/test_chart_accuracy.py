"""The charts' accuracy, without their times: schemes keep their orders, truths are true."""

import numpy as np
import pytest
from once import time_once
from scipy.integrate import solve_ivp

from dpcontrol.bench.chart import CHARTS, GROUPS
from dpcontrol.bench.propagation import (
    Stepper,
    candidates,
    classical_step,
    compiled_rate,
    work_of,
)
from dpcontrol.dynamics.compiled import fixed_step
from dpcontrol.foundation.progress import no_progress

START = np.array([[0.9, 1.4, 0.5, -1.0]])
SECONDS = 1.0
ORDER_SLACK = 0.35  # the next term of the error's expansion, at these steps
DOP853 = 1e-10  # scipy at a tolerance of 1e-13, over one second
AT_ROUNDING = 1e-12
IN_THE_GUIDE = "connections"  # which draws it


@pytest.fixture(scope="module")
def work(system):
    return work_of(system, START, SECONDS)


def test_the_truth_agrees_with_scipy(system, work):
    rate = compiled_rate(system.equations, system.parameters)
    run = solve_ivp(rate, (0.0, SECONDS), START[0], method="DOP853", rtol=1e-13, atol=1e-13)
    assert work.error(run.y[:, -1][None]) < DOP853


@pytest.mark.parametrize(
    ("function", "order", "step"),
    [
        (classical_step, 4, 2e-3),
        (fixed_step, 8, 2e-2),
    ],
    ids=["rk4", "dop853"],
)
def test_a_scheme_has_its_order(system, work, function, order, step):
    scheme = Stepper(function(system.equations), system.parameters)
    coarse, fine = (work.error(scheme.fly(START[0], SECONDS, step=h)[None]) for h in (step, step / 2))
    assert np.log2(coarse / fine) == pytest.approx(order, abs=ORDER_SLACK)


def test_a_tighter_tolerance_is_nearer_and_the_default_is_at_rounding(work):
    tried = candidates(work, batches=True, quick=True)
    errors = {(c.method, c.setting): work.error(c.work()) for c in tried if c.method.startswith("Taylor")}
    for method in ("Taylor", "Taylor, 8 at once"):
        found = [errors[method, setting] for setting in ("rounding", "1e-12", "1e-09", "1e-06")]
        assert found == sorted(found)
    defaults = [c for c in tried if c.default]
    assert [(c.method, c.setting) for c in defaults] == [("Taylor, 8 at once", "rounding")]
    assert errors["Taylor, 8 at once", "rounding"] < AT_ROUNDING


@pytest.mark.slow
# The stages have no alternatives: their chart compares a cold start with a warm one.
@pytest.mark.parametrize("name", [n for n in CHARTS if n not in (*GROUPS["edges"], IN_THE_GUIDE, "stages")])
def test_each_quick_chart_has_its_defaults(name, monkeypatch):
    time_once(monkeypatch)
    assert any(panel.defaults for panel in CHARTS[name](True, no_progress).parts)
