"""Failures of references, each detected and reported with its cause."""

from dataclasses import replace

import numpy as np
import pytest
from shadowing_stand_in import LAB, orbit_stretch

from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.foundation.causes import ObstacleCause, ReferenceCause
from dpcontrol.references.ending import Obstacle
from dpcontrol.references.find import find_reference, raise_friction
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Guess, Limits, ReferenceProblem, ReferenceSettings
from dpcontrol.references.trajectory import first_trajectory
from dpcontrol.references.transcription import solve

EQUATIONS = arm_chain_equations(2, Level.CART)
QUICK = ReferenceSettings(method="radau-7", interval=0.05, iterations=60)


def problem_of(guess: Guess, duration: float, *, friction: float = 1.0, limits: Limits | None = None):
    arms = replace(LAB, viscous=tuple(friction * k for k in LAB.viscous))
    return ReferenceProblem(EQUATIONS, arms.base(), guess, duration, limits or Limits())


def test_a_converged_solution_with_another_motion_is_refused() -> None:
    orbit = orbit_stretch(0.7)
    turned = np.array([0.0, 0.0, 0.0, 9.0])
    # At both ends it is the orbit; in between, the outer arm has an impossible position.
    guess = lambda t: orbit.guess(t) + np.outer(np.sin(np.pi * np.asarray(t) / 0.7), turned)  # noqa: E731
    problem = problem_of(guess, orbit.duration)
    method = method_named("radau-7")
    first = first_trajectory(problem, method, np.linspace(0.0, orbit.duration, 15))
    assert solve(problem, first, settings=QUICK, limits=problem.limits).succeeded
    found = find_reference(problem, QUICK)
    assert not found.converged
    assert found.ending.cause is ReferenceCause.OTHER_MOTION


def test_continuation_in_friction_gives_the_solution_of_a_cold_start() -> None:
    orbit = orbit_stretch(0.7)
    problem = problem_of(orbit.guess, orbit.duration, friction=10.0)
    method = method_named("radau-7")
    first = first_trajectory(problem, method, np.linspace(0.0, orbit.duration, 15))
    cold = solve(problem, first, settings=QUICK, limits=problem.limits)
    share, raised = raise_friction(problem, first, settings=QUICK, limits=problem.limits)
    assert share == 1.0
    assert raised is not None
    assert raised.cost == pytest.approx(cold.cost, rel=1e-6)
    assert raised.cost > 10 * cost_at_the_arms_own_friction(problem)


def cost_at_the_arms_own_friction(problem: ReferenceProblem) -> float:
    found = find_reference(replace(problem, parameters=LAB.base()), QUICK)
    return found.rms_cart_acceleration**2 * found.duration


@pytest.mark.slow
def test_excessive_friction_is_reported_with_the_share_that_can_be_compensated() -> None:
    orbit = orbit_stretch(0.75)
    found = find_reference(problem_of(orbit.guess, orbit.duration, friction=60.0), QUICK)
    assert not found.converged
    obstacle = found.ending.obstacle
    assert obstacle
    assert obstacle.cause is ObstacleCause.FRICTION
    share = obstacle.share
    assert 0.1 < share < 0.9
    assert find_reference(problem_of(orbit.guess, orbit.duration, friction=0.9 * share * 60.0), QUICK).converged


@pytest.mark.parametrize("without", ["S", "G and S"])
def test_a_cart_without_authority_is_reported(without: str) -> None:
    orbit = orbit_stretch(0.5)
    problem = problem_of(orbit.guess, orbit.duration)
    parameters = problem.parameters.copy()
    names = [str(symbol) for symbol in EQUATIONS.parameters.elements()]
    for k, name in enumerate(names):
        if name[0] in without:
            parameters[k] = 0.0
    found = find_reference(replace(problem, parameters=parameters), QUICK)
    assert not found.converged
    assert found.ending.obstacle == Obstacle(ObstacleCause.AUTHORITY)


def test_a_limit_that_is_too_tight_is_reported_with_its_time() -> None:
    orbit = orbit_stretch(0.7)
    free = find_reference(problem_of(orbit.guess, orbit.duration), QUICK)
    found = find_reference(problem_of(orbit.guess, orbit.duration, limits=Limits(position=1e-5)), QUICK)
    assert not found.converged
    assert found.ending.obstacle is not None
    (use,) = found.ending.obstacle.uses
    assert abs(free.state(use.time)[4]) == pytest.approx(free.max_cart_position, rel=1e-3)
