"""Connections in 113-bit arithmetic, compared with independent values, a third precision and propagation."""

from decimal import Decimal
from fractions import Fraction

import heyoka as hy
import numpy as np
import pytest

from dpcontrol.dynamics.compiled import to_heyoka
from dpcontrol.dynamics.propagator import ExtendedPropagator, digits, extended, pi_times
from dpcontrol.foundation.causes import RefinementCause
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.shooting.extended import RefinementSettings, refine
from dpcontrol.tubes.connections import find_connections, orbits_between
from tests.reference_values import CONNECTIONS, LYAPUNOV_ORBITS, on_torus

RESIDUAL = 1e-20  # required; about 1e-31 is achieved
AGREES = 1e-10  # difference from the double state; about 1e-13 is achieved
LAST_BIT = 0.5  # ulp: the reference has doubles, correctly rounded from more digits
MIRROR = 1e-28  # difference of separate solutions for an orbit and its mirror image
FLOW = 1e-31  # 113 bits have 34 digits, for numbers of size 10 over half a second

REFINED = [
    ("down-up", "down-up", -0.07, 0),
    pytest.param(("down-up", "up-down", 0.2, 0), marks=pytest.mark.slow),
    pytest.param(("down-up", "down-up", -0.07, 1), marks=pytest.mark.slow),
    pytest.param(("down-up", "down-up", 0.2, 2), marks=pytest.mark.slow),
    pytest.param(("up-down", "up-down", 0.2, 2), marks=pytest.mark.slow),
]


@pytest.fixture(scope="module")
def found(lab):
    return {key: find_connections(*orbits_between(lab.system, *key)) for key in CONNECTIONS}


def nearest(connections, state):
    return min(connections, key=lambda c: on_torus(c.state, state))


REFINED_ONCE = {}
"""Connections refined with default settings, by name; shared by tests because each takes seconds."""


def in_113_bits(lab, connection, energy, **options):
    exact = {"energy": Decimal(str(energy)), "parameters": lab.parameters.decimal_base()}
    if options:
        return refine(connection.solution, **exact | options)
    key = (connection.name, energy)
    if key not in REFINED_ONCE:
        REFINED_ONCE[key] = refine(connection.solution, **exact)
    return REFINED_ONCE[key]


@pytest.fixture(scope="module", params=REFINED, ids=str)
def refined(request, lab, found):
    key, index = request.param[:3], request.param[3]
    state = CONNECTIONS[key][1][index]
    connection = nearest(found[key].connections, state)
    return state, connection, in_113_bits(lab, connection, key[2])


@pytest.mark.slow
def test_a_refined_connection_equals_the_reference_to_the_last_bit(refined):
    state, connection, found = refined
    expected = np.array(state)
    rest = extended(expected) + pi_times(np.rint((connection.state - expected) / np.pi))
    gap = (found.state - rest).astype(float)
    assert np.all(np.abs(gap) <= LAST_BIT * np.spacing(np.abs(expected)) + 1e-30)


@pytest.mark.slow
def test_the_residual_is_below_double_precision(refined):
    _, _, found = refined
    assert found.converged
    assert found.residual <= RESIDUAL
    assert all(orbit.residual <= RESIDUAL for orbit in found.ends)
    assert found.correction <= AGREES


@pytest.mark.slow
def test_separately_refined_mirror_images_agree(lab, found):
    key = ("down-up", "down-up", -0.07)
    c = nearest(found[key].connections, CONNECTIONS[key][1][1])
    twin = nearest(found[key].connections, c.state * [-1, -1, 1, 1])
    first, second = (in_113_bits(lab, x, key[2]).state for x in (c, twin))
    assert float(np.abs(first[2:] - second[2:]).max()) < MIRROR
    assert float(abs(first[0] + second[0])) < MIRROR


@pytest.mark.slow
def test_refined_orbits_have_the_reference_period_and_energy(lab, found):
    key = ("down-up", "down-up", -0.07)
    refined = in_113_bits(lab, nearest(found[key].connections, CONNECTIONS[key][1][0]), key[2])
    orbit = refined.ends[0]
    expected = LYAPUNOV_ORBITS["lab", "down-up", -0.07]
    assert float(orbit.duration) == pytest.approx(expected[1], rel=2e-16)
    assert orbit.state.astype(float) == pytest.approx(expected[0], rel=2e-16)
    error = orbit.propagator.energy(refined.state) - extended([Fraction(-7, 100)])[0]
    assert abs(float(error)) < 1e-30


def test_flow_agrees_with_two_hundred_bits(lab):
    """The same equations in heyoka's multiprecision reals, a separate arithmetic."""
    equations, parameters = lab.system.equations, lab.parameters.decimal_base()
    propagator = ExtendedPropagator(equations, parameters)
    state = extended([0.4, 2.9, 6.0, -3.0])
    there = propagator.flow(state, extended(0.5)[()])
    names = hy.make_vars("a", "b", "c", "d")
    symbols = [hy.par[i] for i in range(len(parameters))]
    rates = to_heyoka(equations.function(), [names, [], symbols])
    wide = [hy.real(f"{v}", 200) for v in digits(extended([0.4, 2.9, 6.0, -3.0]))]
    system = list(zip(names, rates, strict=True))
    integrator = hy.taylor_adaptive(system, wide, time=hy.real(0, 200), fp_type=hy.real, compact_mode=True, prec=200)
    integrator.pars[:] = [hy.real(v, 200) for v in digits(propagator.parameters)][: len(integrator.pars)]
    integrator.propagate_until(hy.real("0.5", 200))
    for mine, other in zip(there, integrator.state, strict=True):
        assert abs(Decimal(str(mine)) - Decimal(str(other))) < Decimal(FLOW)


def test_decimals_are_not_read_as_binary_numbers():
    third, fifth = extended([Fraction(1, 3), Decimal("0.2")])
    assert digits(np.array([fifth * 5])) == ["1"]
    assert digits(np.array([third]))[0].startswith("0." + "3" * 33)
    assert float(extended(0.2)[()] - fifth) == pytest.approx(0.2 - float(Fraction(0.2)) + 1.1102230246251565e-17)


@pytest.mark.slow
def test_a_refinement_above_its_tolerance_is_reported(lab, found):
    c = found["down-up", "down-up", -0.07].connections[0]
    refined = in_113_bits(lab, c, -0.07, settings=RefinementSettings(tolerance=5e-33))
    assert refined.cause is RefinementCause.STALLED
    with pytest.raises(GoalMissed, match="stops at a residual"):
        in_113_bits(lab, c, -0.07, settings=RefinementSettings(iterations=0))
