"""Shadowing orbits in 113-bit arithmetic, compared with propagation, other nodes, symmetry and doubles."""

from decimal import Decimal

import numpy as np
import pytest

from dpcontrol.dynamics.propagator import ExtendedPropagator, digits, extended, pi_times
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.orbits.rotating import rotating_orbits
from dpcontrol.orbits.vertex import rotating_vertex
from dpcontrol.shooting.extended import RefinementSettings, refine
from dpcontrol.tubes.connections import find_connections, find_lap_connections, grown_crossing, orbits_between
from dpcontrol.walks.shadowing import ShadowingSettings, shadow
from dpcontrol.walks.symbols import choose, parse_symbol

RESIDUAL = 1e-20  # required; about 2e-32 is achieved
AGREES = 1e-10  # difference from the double nodes; about 3e-14 is achieved
FREE = 1e-8  # over a period with λ = 2e21, 1e-32 grows to 1e-11 and 1e-16 to more than the orbit's size
SAME = 1e-26  # same orbit from other nodes: residuals of 1e-32, condition number of about 1e4
SADDLES = ("down-up", "up-down")


@pytest.fixture(scope="module")
def turns(lab):
    found = find_connections(*orbits_between(lab.system, "down-up", "down-up", -0.07)).connections
    return {sense: choose(parse_symbol(f"down-up {sense}", SADDLES), found) for sense in "+-"}


@pytest.fixture(scope="module")
def dance(turns):
    return shadow([turns["+"], turns["-"]], wraps=[1, 2], periodic=True)


@pytest.fixture(scope="module")
def refined_dance(dance):
    return refine(dance.shot.solution)


@pytest.mark.slow
def test_an_open_walk_of_four_symbols_is_refined(lab, turns):
    walk = [turns[sense] for sense in "+-++"]
    orbit = shadow(walk, wraps=[1, 1, 1])
    refined = refine(orbit.shot.solution, energy=Decimal("-0.07"), parameters=lab.parameters.decimal_base())
    assert refined.converged
    assert refined.residual < RESIDUAL
    assert refined.correction < AGREES
    # The digits equal the arrays, and lie on the section θ₂ = 2π to 30 digits.
    state = refined.states[refined.marked[0]]
    assert refined.digits == digits(state)
    assert all(len(text.lstrip("-").replace(".", "")) >= 30 for text in refined.digits[1:])
    turn = pi_times(2.0 * np.rint(float(state[1]) / (2 * np.pi)))
    assert abs(state[1] - turn) < 1e-30
    # Crossings agree with double precision.
    times = refined.times[refined.marked].astype(float)
    assert times == pytest.approx(orbit.symbol_times - orbit.symbol_times[0], abs=AGREES)
    # Uninterrupted propagation over a symbol and both its stops.
    propagator = ExtendedPropagator(lab.system.equations, lab.parameters.decimal_base())
    flown = propagator.flow(state, refined.times[refined.marked[2]])
    assert np.abs(flown - refined.states[refined.marked[2]]).max() < FREE


@pytest.mark.slow
def test_a_closed_walk_returns_in_one_flight(lab, refined_dance):
    refined = refined_dance
    assert refined.converged
    assert refined.residual < RESIDUAL
    assert refined.correction < AGREES
    propagator = ExtendedPropagator(lab.system.equations, lab.system.parameters)
    state = refined.states[refined.marked[0]]
    back = propagator.flow(state, refined.times[-1] - refined.times[0])
    # One turn forward and one back.
    assert np.abs(back - state).max() < FREE
    assert abs(propagator.energy(state) - extended(-0.07)) < 1e-30


@pytest.mark.slow
def test_different_nodes_give_the_same_digits(turns, refined_dance):
    denser = shadow([turns["+"], turns["-"]], wraps=[1, 2], periodic=True, settings=ShadowingSettings(segments=11))
    other = refine(denser.shot.solution)
    gap = other.states[other.marked[0]] - refined_dance.states[refined_dance.marked[0]]
    assert np.abs(gap).max() < SAME
    assert str(other.duration)[:26] == str(refined_dance.duration)[:26]


@pytest.mark.slow
def test_a_symmetric_orbit_meets_its_symmetry_line(turns):
    refined = refine(shadow([turns["+"]], wraps=[1], periodic=True).shot.solution)
    assert refined.converged
    state = refined.states[refined.marked[0]]
    # The fixed set is (0, 2πk, ω₁, ω₂), although the equations do not require θ₁ = 0.
    assert abs(state[0]) < SAME


@pytest.mark.slow
def test_connections_of_the_rotating_orbit_are_mirror_images(lab):
    """Two separate searches, from and to the rotating orbit with λ = -2.74."""
    vertex = rotating_vertex(rotating_orbits(lab.system, 2, -0.06985)[-1])
    saddle = lyapunov_orbit(lab.system, "down-up", energy=-0.06985)
    section = lab.system.named_sections["outer-down"]
    # Nearer ends take longer. At 1e-10, their energy error of 1e-20 appears in the defects.
    rough = RefinementSettings(amplitude=1e-10, tolerance=1e-20, segments=3)
    states = []
    for pair in ((vertex, saddle), (saddle, vertex)):
        crossing = grown_crossing(vertex, section)
        connection = find_lap_connections(*pair, section=section, crossing=crossing).connections[0]
        refined = refine(shadow([connection], settings=ShadowingSettings(segments=5)).shot.solution, settings=rough)
        assert refined.converged
        assert refined.correction < AGREES
        states.append(refined.states[refined.marked[0]])
    signs = np.array([-1.0, 1.0, 1.0, 1.0])
    gap = (extended(signs) * states[0] - states[1])[[0, 2, 3]]
    # The error of local manifolds is the square of the amplitude, 1e-20, and grows by about λ^0.5.
    assert np.abs(gap).max() < 1e-18
