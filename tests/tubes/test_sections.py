"""Connections on other sections and at later hits, such as returning orbits and double turns."""

import numpy as np
import pytest
from quick_rate import flown_by_scipy

from dpcontrol.orbits.cut import CutSettings
from dpcontrol.tubes.connections import find_connections, orbits_between
from dpcontrol.tubes.intersections import ConnectionSettings
from tests.reference_values import on_torus

RESIDUAL = 1e-11
SAME = 1e-7  # two integrations of half a second, and a crossing found by scipy
SHORT = 2.0  # periods; later arrivals scatter


@pytest.fixture(scope="module")
def back(system):
    """Homoclinics of Down-Up at 0.2 J with two crossings of θ₁ = θ₂."""
    orbits = orbits_between(system, "down-up", "down-up", 0.2)
    settings = ConnectionSettings(cut=CutSettings(longest=SHORT))
    return find_connections(*orbits, hits=(1, 2), section=system.named_sections["aligned"], settings=settings)


def crossings_of(system, connection):
    section, found = connection.section, [connection.state]
    for sign, last in ((1, connection.time_in), (-1, connection.time_out)):
        state, left = system.propagator.flow(connection.state, sign * 1e-6), last - 1e-6
        while (crossing := system.propagator.crossing(state, section, longest=sign * left)) is not None:
            found += [crossing.state]
            state, left = system.propagator.flow(crossing.state, sign * 1e-6), left - abs(crossing.time) - 1e-6
    return found


@pytest.mark.slow
def test_returning_homoclinics_cross_the_aligned_section_in_both_directions(system, back):
    # The search is limited to `SHORT`.
    assert any(end.later for _, end in back.open_ends)
    assert len(back.connections) == 16
    assert sum(c.winding == (0, 0) for c in back.connections) == 8
    for c in back.connections:
        assert c.residual <= RESIDUAL
        assert c.winding[0] == 0
        assert c.winding[1] in (0, 2, -2)
        first, second = crossings_of(system, c)
        there, again = first[2] - first[3], second[2] - second[3]
        assert (there * again < 0) == (c.winding == (0, 0)), "what does not come back turns twice"


def test_returning_orbits_are_symmetric_if_a_reverser_exchanges_their_crossings(system, back):
    symmetric = 0
    for c in back.connections:
        first, second = crossings_of(system, c)
        mirrored = min(on_torus(reverser @ first, second) for reverser in system.reversers)
        assert c.symmetric == (mirrored < SAME), c.name
        symmetric += c.symmetric
    assert symmetric == 4


def test_double_turns_agree_with_an_independent_integration(system, back):
    double = [c for c in back.connections if abs(c.winding[1]) == 2]
    assert len(double) == 8
    for c in double:
        after, before = (flown_by_scipy(system, c.state, t) for t in (c.time_in, -c.time_out))
        assert np.abs(before[:2] - [0, np.pi]).max() < np.pi
        assert np.abs(after[:2] - [0, np.pi] - 2 * np.pi * np.array(c.winding)).max() < np.pi


@pytest.mark.slow
def test_the_other_crossing_gives_the_same_orbits(system, back):
    orbits = orbits_between(system, "down-up", "down-up", 0.2)
    settings = ConnectionSettings(cut=CutSettings(longest=SHORT))
    other = find_connections(*orbits, hits=(2, 1), section=system.named_sections["aligned"], settings=settings)
    for c in other.connections:
        assert min(on_torus(crossings_of(system, c)[1], d.state) for d in back.connections) < SAME
