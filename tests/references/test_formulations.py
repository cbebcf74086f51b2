"""Programs with jerk limits, free durations, closed orbits or pinned orbits."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from shadowing_stand_in import DOWN_UP_LOW, LAB, orbit_stretch

from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.dynamics.equations import NumericEquations
from dpcontrol.foundation.errors import InputError
from dpcontrol.references.find import find_reference
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import EndConditions, Limits, ReferenceProblem, ReferenceSettings
from dpcontrol.references.reference import Reference
from dpcontrol.references.trajectory import first_trajectory
from dpcontrol.references.transcription import solve

Array = NDArray[np.float64]

LIMIT = 1e-9  # Allowed relative violation of a limit.
EXACT = 1e-9  # Residual of the solver's equations, in units of the state.
SECONDS = 0.5
QUICK = ReferenceSettings(method="radau-7", interval=0.05)


def swing(
    limits: Limits | None = None, ends: EndConditions | None = None, seconds: float = SECONDS
) -> ReferenceProblem:
    equations = arm_chain_equations(2, Level.CART)
    return ReferenceProblem(
        equations, LAB.base(), orbit_stretch(seconds).guess, seconds, limits or Limits(), ends or EndConditions()
    )


def slopes_of(reference: Reference, times: Array) -> Array:
    return np.abs(np.diff(reference.input(times)[:, 0]) / np.diff(times))


def effort(reference: Reference) -> float:
    return reference.rms_cart_acceleration**2 * reference.duration


def test_a_jerk_limit_holds_between_the_nodes_and_makes_the_input_continuous() -> None:
    free = find_reference(swing(Limits(jerk=1e5)), QUICK)
    times = np.linspace(0.0, SECONDS, 200_001)
    bound = 0.8 * slopes_of(free, times).max()
    held = find_reference(swing(Limits(jerk=float(bound))), QUICK)
    assert held.converged, held.status
    # A jump between intervals would appear as a slope far above the bound.
    slopes = slopes_of(held, times)
    assert slopes.max() <= bound * (1 + 1e-6)
    assert slopes.max() > 0.9 * bound
    assert effort(held) >= effort(free) * (1 - 1e-6)


def test_a_free_duration_saves_effort_within_its_limit() -> None:
    fixed = find_reference(swing(), QUICK)
    freed = find_reference(swing(ends=EndConditions(stretch=0.2)), QUICK)
    assert freed.converged, freed.status
    assert abs(freed.duration / SECONDS - 1) <= 0.2 + LIMIT
    assert freed.duration != pytest.approx(SECONDS, rel=1e-4)
    assert effort(freed) < effort(fixed)
    given = orbit_stretch(SECONDS).guess(np.array([0.0, SECONDS]))
    assert freed.state(freed.duration)[:4] == pytest.approx(given[1], abs=EXACT)
    # A fixed duration of the same value gives the same optimum.
    again = replace(
        swing(ends=EndConditions(start=np.array([*given[0], 0, 0]), end=np.array([*given[1], 0, 0]))),
        duration=freed.duration,
        guess=lambda t: orbit_stretch(SECONDS).guess(np.asarray(t) * SECONDS / freed.duration),
    )
    assert effort(find_reference(again, QUICK)) == pytest.approx(effort(freed), rel=1e-3)


def test_a_closed_orbit_has_the_requested_energy() -> None:
    problem = swing(ends=EndConditions(closing=np.zeros(6), energy=-0.07, stretch=0.1), seconds=DOWN_UP_LOW.period)
    found = find_reference(problem, replace(QUICK, pendulum_weight=0.01))
    assert found.converged, found.status
    first, last = found.state(0.0), found.state(found.duration)
    assert last == pytest.approx(first, abs=EXACT)
    energy = NumericEquations(arm_chain_equations(2, Level.CONSERVATIVE), LAB.base()).hamiltonian(first[:4])
    assert float(energy) == pytest.approx(-0.07, abs=EXACT)
    # On a closed orbit, friction dissipates all supplied energy.
    assert found.rms_cart_acceleration > 0.01


@pytest.mark.parametrize(("name", "stretch"), [("radau-5", 0.1), ("lobatto-4", 0.0)])
def test_fatrop_refuses_constraints_that_couple_stages(name: str, stretch: float) -> None:
    with pytest.raises(InputError, match=r'fatrop.*use "ipopt"'):
        find_reference(swing(ends=EndConditions(stretch=stretch)), replace(QUICK, method=name, solver="fatrop"))


@pytest.mark.parametrize("name", ["lobatto-4", "lobatto-5", "hermite-simpson"])
def test_neighbouring_lobatto_intervals_share_their_common_input(name: str) -> None:
    problem, method = swing(), method_named(name)
    assert method.shares_inputs
    first = first_trajectory(problem, method, np.linspace(0.0, SECONDS, 26))
    solved = solve(problem, first, settings=ReferenceSettings(), limits=problem.limits)
    inputs = solved.trajectory.inputs[..., 0]
    assert np.abs(inputs).max() > 0.1
    assert inputs[1:, 0] == pytest.approx(inputs[:-1, -1], abs=EXACT)
