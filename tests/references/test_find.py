"""References are found with the accuracy that they report, and failures are reported with their cause."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from quick_rate import quick_rate
from scipy.integrate import solve_ivp
from shadowing_stand_in import LAB, StandIn, orbit_stretch

from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.foundation.causes import ObstacleCause, ReferenceCause
from dpcontrol.references.ending import Obstacle
from dpcontrol.references.find import find_reference, raise_friction, split_mesh
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits, ReferenceProblem, ReferenceSettings, state_scale
from dpcontrol.references.reference import Reference
from dpcontrol.references.trajectory import first_trajectory
from dpcontrol.references.transcription import solve

TOLERANCE = 1e-6  # Required error between nodes, scaled.
LIMIT = 1e-9  # Allowed violation of a limit.
EXACT = 1e-12  # Fixed ends are constants of the program.
EQUATIONS = arm_chain_equations(2, Level.CART)
QUICK = ReferenceSettings(method="radau-7", interval=0.05, iterations=60)


def stretch_problem(limits: Limits | None = None, *, duration: float = 0.7, friction: float = 1.0) -> ReferenceProblem:
    """Return the problem of following a stretch of an orbit with scaled friction of the arms."""
    arms = replace(LAB, viscous=tuple(friction * k for k in LAB.viscous))
    return ReferenceProblem(EQUATIONS, arms.base(), orbit_stretch(duration).guess, duration, limits or Limits())


def test_error_between_nodes_agrees_with_an_independent_integrator(tracked: tuple[StandIn, Reference]) -> None:
    _, reference = tracked
    assert reference.converged, reference.status
    rate = quick_rate(EQUATIONS)
    scale = state_scale(6, reference.limits)
    worst = 0.0
    for i in range(0, len(reference.mesh) - 1, 23):
        start, end = reference.mesh[i], reference.mesh[i + 1]
        places, values = start + (end - start) * reference.method.points, reference.inputs[i, :, 0]
        curve = Polynomial.fit(places, values, len(places) - 1, domain=[start, end])
        times = np.linspace(start, end, 33)

        def slope(t: float, x: np.ndarray, curve: Polynomial = curve) -> np.ndarray:
            return np.array(rate(x, curve(t), LAB.base())).ravel()

        tight = {"t_eval": times, "method": "DOP853", "rtol": 1e-12, "atol": 1e-12}
        flow = solve_ivp(slope, (start, end), reference.states[i, 0], **tight)
        # The last time belongs to the next interval.
        worst = max(worst, float((np.abs(flow.y.T - reference.state(times)) / scale).max()))
    # The two methods use different points between the nodes.
    assert worst <= 1.2 * reference.max_error_between_nodes + 1e-10
    assert max(worst, reference.max_error_between_nodes) <= TOLERANCE


def test_a_reference_starts_and_ends_on_the_orbit_with_the_cart_at_rest(tracked: tuple[StandIn, Reference]) -> None:
    orbit, reference = tracked
    for time in (0.0, orbit.duration):
        assert reference.state(time) == pytest.approx([*orbit.guess(time), 0.0, 0.0], abs=EXACT)
    assert reference.duration == pytest.approx(orbit.duration, abs=EXACT)


def test_reference_stays_near_the_orbit_at_the_effort_of_friction(tracked: tuple[StandIn, Reference]) -> None:
    orbit, reference = tracked
    times = np.linspace(0.0, reference.duration, 5001)
    away = reference.state(times)[:, :2] - orbit.guess(times)[:, :2]
    assert np.abs(away).max() < 0.3  # Friction delays a turn by hundredths of a second at up to 20 rad/s.
    assert 0.03 < reference.rms_cart_acceleration < 0.2  # Of the order of friction, not of gravity.
    last_period = orbit.final
    ending = reference.state(times[times > reference.duration - 0.7])[:, :2]
    nearest = np.abs(last_period[None, :, :2] - ending[:, None]).max(2).min(1)
    assert nearest.max() < 0.05


def test_reported_largest_values_agree_with_a_dense_grid(crossing: tuple[StandIn, Reference]) -> None:
    _, reference = crossing
    times = np.linspace(0.0, reference.duration, 100_001)
    states, inputs = reference.state(times), reference.input(times)
    assert reference.max_cart_position == pytest.approx(np.abs(states[:, 4]).max(), rel=1e-3)
    assert reference.max_cart_velocity == pytest.approx(np.abs(states[:, 5]).max(), rel=1e-3)
    assert reference.max_cart_acceleration == pytest.approx(np.abs(inputs).max(), rel=1e-3)
    assert reference.rms_cart_acceleration == pytest.approx(np.sqrt((inputs**2).mean()), rel=1e-3)


@pytest.mark.parametrize("name", ["position", "velocity", "acceleration"])
def test_an_active_limit_holds_between_the_nodes(name: str) -> None:
    free = find_reference(stretch_problem(), ReferenceSettings())
    bound = 0.85 * getattr(free, f"max_cart_{name}")
    held = find_reference(stretch_problem(replace(Limits(), **{name: bound})), ReferenceSettings())
    assert held.converged, held.status
    times = np.linspace(0.0, held.duration, 200_001)
    states = held.state(times)
    curve = {"position": states[:, 4], "velocity": states[:, 5], "acceleration": held.input(times)[:, 0]}[name]
    assert np.abs(curve).max() <= bound + LIMIT
    assert np.abs(curve).max() > 0.95 * bound


def test_refinement_splits_until_the_tolerance_holds() -> None:
    reference = find_reference(stretch_problem(), ReferenceSettings(interval=0.1, tolerance=1e-8))
    assert reference.converged, reference.status
    assert reference.max_error_between_nodes <= 1e-8
    assert len(reference.mesh) > 8


def test_splitting_keeps_accurate_intervals() -> None:
    mesh = split_mesh(np.array([0.0, 1.0, 2.0, 3.0]), np.array([1e-9, 1e-5, np.inf]), tolerance=1e-6, order=5)
    assert mesh[:2] == pytest.approx([0.0, 1.0])
    assert mesh == pytest.approx([0.0, 1.0, 1.5, 2.0, 2.25, 2.5, 2.75, 3.0])


EQUATIONS = arm_chain_equations(2, Level.CART)


def test_a_converged_solution_with_another_motion_is_refused() -> None:
    orbit = orbit_stretch(0.7)
    turned = np.array([0.0, 0.0, 0.0, 9.0])
    # At both ends it is the orbit; in between, the outer arm has an impossible position.
    guess = lambda t: orbit.guess(t) + np.outer(np.sin(np.pi * np.asarray(t) / 0.7), turned)  # noqa: E731
    problem = replace(stretch_problem(), guess=guess)
    first = first_trajectory(problem, method_named("radau-7"), np.linspace(0.0, 0.7, 15))
    assert solve(problem, first, settings=QUICK, limits=problem.limits).succeeded
    found = find_reference(problem, QUICK)
    assert not found.converged
    assert found.ending.cause is ReferenceCause.OTHER_MOTION


def test_continuation_in_friction_gives_the_solution_of_a_cold_start() -> None:
    problem = stretch_problem(friction=10.0)
    first = first_trajectory(problem, method_named("radau-7"), np.linspace(0.0, 0.7, 15))
    cold = solve(problem, first, settings=QUICK, limits=problem.limits)
    share, raised = raise_friction(problem, first, settings=QUICK, limits=problem.limits)
    assert share == 1.0
    assert raised.cost == pytest.approx(cold.cost, rel=1e-6)
    # The arms' own friction costs far less.
    own = find_reference(stretch_problem(), QUICK)
    assert raised.cost > 10 * own.rms_cart_acceleration**2 * own.duration


@pytest.mark.slow
def test_excessive_friction_is_reported_with_the_share_that_can_be_compensated() -> None:
    found = find_reference(stretch_problem(duration=0.75, friction=60.0), QUICK)
    assert not found.converged
    obstacle = found.ending.obstacle
    assert obstacle.cause is ObstacleCause.FRICTION
    share = obstacle.share
    assert 0.1 < share < 0.9
    assert find_reference(stretch_problem(duration=0.75, friction=0.9 * share * 60.0), QUICK).converged


@pytest.mark.parametrize("without", ["S", "G and S"])
def test_a_cart_without_authority_is_reported(without: str) -> None:
    problem = stretch_problem(duration=0.5)
    parameters = problem.parameters.copy()
    names = [str(symbol) for symbol in EQUATIONS.parameters.elements()]
    for k, name in enumerate(names):
        if name[0] in without:
            parameters[k] = 0.0
    found = find_reference(replace(problem, parameters=parameters), QUICK)
    assert not found.converged
    assert found.ending.obstacle == Obstacle(ObstacleCause.AUTHORITY)


def test_a_limit_that_is_too_tight_is_reported_with_its_time() -> None:
    free = find_reference(stretch_problem(), QUICK)
    found = find_reference(stretch_problem(Limits(position=1e-5)), QUICK)
    assert not found.converged
    (use,) = found.ending.obstacle.uses
    assert abs(free.state(use.time)[4]) == pytest.approx(free.max_cart_position, rel=1e-3)
