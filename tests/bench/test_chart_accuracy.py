"""The charts' accuracy, without their times: schemes keep their orders, truths are true.

Run with every change, so that a method that loses digits is noticed.
"""

import importlib
import pkgutil

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dpcontrol.bench
from dpcontrol.bench import design
from dpcontrol.bench.chart import CHARTS, GROUPS, Point
from dpcontrol.bench.measure import Alternative, TimedWork
from dpcontrol.bench.propagation import (
    Stepper,
    buffered_rate,
    candidates,
    classical_step,
    compared,
    symplectic_gauss,
    tick_panels,
    work_of,
)
from dpcontrol.dynamics.compiled import fixed_step
from dpcontrol.dynamics.propagator import ExtendedPropagator
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.progress import no_progress
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.plans.model import load_model
from dpcontrol.references.problem import ReferenceSettings

START = np.array([[0.9, 1.4, 0.5, -1.0]])
SECONDS = 1.0
ORDER_SLACK = 0.35  # the next term of the error's expansion, at these steps
DOP853 = 1e-10  # scipy at a tolerance of 1e-13, over one second
AT_ROUNDING = 1e-12
ALIKE = 1e-12  # flown twice by the same code


@pytest.fixture(scope="module")
def system():
    return load_model("lab").system


@pytest.fixture(scope="module")
def work(system):
    return work_of(system, START, SECONDS)


def test_the_truth_agrees_with_scipy(system, work):
    rate = buffered_rate(system.equations, system.parameters)
    run = solve_ivp(rate, (0.0, SECONDS), START[0], method="DOP853", rtol=1e-13, atol=1e-13)
    assert work.error(run.y[:, -1][None]) < DOP853


def test_the_rate_given_to_scipy_keeps_its_parameters(system):
    rate = buffered_rate(system.equations, system.parameters)
    others = [np.full(len(system.parameters), np.nan) for _ in range(1000)]
    assert rate(0.0, START[0]) == pytest.approx(system.numeric.rate(START[0]), rel=1e-14)
    assert len(others) == 1000


@pytest.mark.parametrize(
    ("function", "order", "step"),
    [
        (classical_step, 4, 2e-3),
        (fixed_step, 8, 2e-2),
        (lambda e: symplectic_gauss(e, 1), 2, 2e-3),
        (lambda e: symplectic_gauss(e, 2), 4, 4e-3),
        (lambda e: symplectic_gauss(e, 3), 6, 8e-3),
    ],
    ids=["rk4", "dop853", "midpoint", "gauss-4", "gauss-6"],
)
def test_a_scheme_has_its_order(system, work, function, order, step):
    scheme = Stepper(function(system.equations), system.parameters)
    coarse, fine = (work.error(scheme.fly(START[0], SECONDS, step=h)[None]) for h in (step, step / 2))
    assert np.log2(coarse / fine) == pytest.approx(order, abs=ORDER_SLACK)


def test_the_midpoint_rule_is_symplectic_and_rk4_is_not(system):
    n, step = 2, 0.02
    mass = system.numeric.mass_matrix

    def canonical_jacobian(function):
        flow = Stepper(function, system.parameters)

        def moved(z):
            rates = np.linalg.solve(mass(np.concatenate([z[:n], np.zeros(n)])), z[n:])
            x = flow.fly(np.concatenate([z[:n], rates]), step, step=step)
            return np.concatenate([x[:n], mass(x) @ x[n:]])

        z = np.concatenate([START[0, :n], mass(START[0]) @ START[0, n:]])
        shift = 1e-5 * np.array([1, 1, 0.01, 0.01])
        columns = [(moved(z + d) - moved(z - d)) / (2 * d[k]) for k, d in enumerate(np.diag(shift))]
        return np.array(columns).T

    form = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])

    def defect(function):
        j = canonical_jacobian(function)
        return np.abs(j.T @ form @ j - form).max()

    midpoint, rk4 = defect(symplectic_gauss(system.equations, 1)), defect(classical_step(system.equations))
    assert midpoint < 1e-7  # of differences
    assert rk4 > 10 * midpoint


def test_a_tighter_tolerance_is_nearer_and_the_default_is_at_rounding(work):
    tried = candidates(work, batches=True, quick=True)
    errors = {(c.method, c.setting): work.error(c.work()) for c in tried if c.method.startswith("Taylor")}
    for method in ("Taylor", "Taylor, 8 at once"):
        found = [errors[method, setting] for setting in ("rounding", "1e-12", "1e-09", "1e-06")]
        assert found == sorted(found)
    defaults = [c for c in tried if c.default]
    assert [(c.method, c.setting) for c in defaults] == [("Taylor, 8 at once", "rounding")]
    assert errors["Taylor, 8 at once", "rounding"] < AT_ROUNDING


@pytest.mark.benchmark
def test_errors_are_the_same_when_a_chart_is_drawn_again(work):
    tried = [c for c in candidates(work, batches=False, quick=True) if "scipy" not in c.method]
    first, again = (compared(tried, work, quick=True).points for _ in range(2))
    assert [p.name for p in first] == [p.name for p in again]
    assert [p.error for p in first] == pytest.approx([p.error for p in again], rel=0, abs=ALIKE)
    assert len(first) > 15


def test_a_method_that_cannot_fly_is_listed_with_its_reason(work):
    def fails():
        raise ArithmeticError("the state became infinite")

    def diverges():
        return np.full((1, 4), np.nan)

    tried = [Alternative("a", "1 s", fails), Alternative("b", "2 s", diverges)]
    found = compared(tried, work, quick=True)
    assert found.points == ()
    assert [(m.method, m.reason.split(":")[0]) for m in found.missing] == [
        ("a", "the state became infinite"),
        ("b", "its step is too long"),
    ]


@pytest.mark.benchmark
def test_ticks_of_the_plant_are_at_rounding_and_of_the_model_below_an_encoder_count():
    alone, together = tick_panels(load_model("lab").arms, quick=True)
    plant, model = (next(p for p in alone.defaults if p.method.startswith(m)) for m in ("DOP853", "RK4"))
    (many,) = together.defaults
    assert plant.error < 1e-15
    assert many.error < 1e-14
    assert 1e-15 < model.error < 1 / 40_000


@pytest.mark.benchmark
def test_refined_connections_are_at_rounding_and_two_flights_are_not(system):
    orbit = lyapunov_orbit(system, "down-up", energy=design.ENERGY)
    truths = design.true_states(orbit, count=1)
    # The double search against 113 bits.
    assert design.worst(orbit, [truths[0][0]], truths) < 1e-13
    near, far = (design.worst(orbit, design._two_flights(orbit, d), truths) for d in (3e-4, 1e-2))
    assert 1e-13 < near < 0.1 * far
    assert design.worst(orbit, [], truths) == float("inf")
    assert design.worst(orbit, [np.zeros(4)], truths) == float("inf")


@pytest.mark.benchmark
def test_more_points_on_the_same_intervals_are_nearer_and_cost_the_same():
    problem = design.crossing_problem()
    error = {}
    for name in ("radau-5", "radau-7"):
        solved = design.transcribed(problem, ReferenceSettings(method=name, interval=0.03))
        assert solved.succeeded
        error[name] = float(design.error_between_nodes(problem, solved.trajectory).max())
    assert error["radau-7"] < 0.1 * error["radau-5"]


def test_a_build_without_extended_reals_is_reported(system, monkeypatch):
    def refused(*_):
        raise GoalMissed("no 113-bit reals")

    monkeypatch.setattr(ExtendedPropagator, "flow", refused)
    with pytest.raises(GoalMissed, match="113-bit"):
        work_of(system, START, SECONDS)


def test_points_can_have_zero_error_but_not_an_undefined_one():
    assert Point("a", "", 1.0, 0.0).error == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in CHARTS if name not in GROUPS["edges"]])
def test_each_quick_chart_has_its_defaults(name, monkeypatch):
    def once(functions, *_, worth=lambda key, result: True, **__):
        found = {key: TimedWork(1.0, function()) for key, function in functions.items()}
        for key, timed in found.items():
            worth(key, timed.result)
        return found

    for found in pkgutil.iter_modules(dpcontrol.bench.__path__, "dpcontrol.bench."):
        holder = importlib.import_module(found.name)
        if hasattr(holder, "timed_in_turns"):
            monkeypatch.setattr(holder, "timed_in_turns", once)
    assert any(panel.defaults for panel in CHARTS[name](True, no_progress).parts)
