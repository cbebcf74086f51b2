"""Shadowing orbits serve as edges of other walks."""

import numpy as np
import pytest

from dpcontrol.orbits.manifold import OrbitCurve
from dpcontrol.tubes.connections import find_connections, orbits_between
from dpcontrol.walks.shadowing import shadow
from dpcontrol.walks.symbols import choose, parse_symbol
from dpcontrol.walks.walks import as_connection

SAME_ORBIT = 1e-10  # rad, rad/s; two solutions with defects of 1e-12 and a condition number of 1e3
SAME_FLIGHT = 1e-8  # s and phase: accuracy of the time at which a slow approach passes 1e-3
SAME_ANGLE = 1e-5  # degrees; tangents of the search have an error of 1e-7
SADDLES = ("down-up", "up-down")


@pytest.fixture(scope="module")
def found(system):
    return find_connections(*orbits_between(system, "down-up", "down-up", -0.07)).connections


@pytest.fixture(scope="module")
def turn(found):
    return choose(parse_symbol("down-up +", SADDLES), found)


@pytest.fixture(scope="module")
def back(found):
    return choose(parse_symbol("down-up -", SADDLES), found)


@pytest.fixture(scope="module")
def other(found, turn):
    return next(c for c in found if c.sense > 0 and c.symmetric and c is not turn)


@pytest.fixture(scope="module")
def composite(turn, back):
    return as_connection(shadow([turn, back], wraps=[1]))


def around(orbit, times):
    """States at times since the first symbol's crossing."""
    return orbit.states(times + orbit.symbol_times[0])


def test_a_walk_of_one_symbol_is_its_connection(found):
    for connection in found[:3]:
        same = as_connection(shadow([connection]))
        assert np.abs(same.state - connection.state).max() < SAME_ORBIT
        for name in ("time_out", "time_in", "phase_out", "phase_in"):
            assert getattr(same, name) == pytest.approx(getattr(connection, name), abs=SAME_FLIGHT)
        for name in ("winding", "sense", "symmetric", "hits"):
            assert getattr(same, name) == getattr(connection, name)
        assert same.transversality_angle == pytest.approx(connection.transversality_angle, abs=SAME_ANGLE)


def test_a_composite_edge_can_be_part_of_longer_walks(turn, back, other, composite):
    plain = shadow([turn, back, other], wraps=[1, 2])
    short = shadow([composite, other], wraps=[2])
    assert short.converged
    assert short.wraps_realised == (2,)
    assert plain.wraps_realised == (1, 2)
    times = np.linspace(-2.0, plain.symbol_times[-1] - plain.symbol_times[0] + 2.0, 300)
    assert np.abs(around(short, times) - around(plain, times)).max() < SAME_ORBIT


def test_closed_walks_can_contain_composite_edges(turn, back, other, composite):
    plain = shadow([turn, back, other], wraps=[1, 2, 1], periodic=True)
    short = shadow([composite, other], wraps=[2, 1], periodic=True)
    assert short.converged
    assert short.wraps_realised == (2, 1)
    assert short.duration == pytest.approx(plain.duration, abs=SAME_ORBIT)
    logs = []
    for orbit in (plain, short):
        assert orbit.estimate is not None
        assert orbit.estimate.multipliers is not None
        logs.append(orbit.estimate.multipliers.log_unstable)
    assert logs[1] == pytest.approx(logs[0], abs=1e-8)


def test_a_composite_edge_leaves_like_its_first_symbol(turn, back, other, composite):
    """Its stable tube is within about λ^-(2 wraps + 2) of the stop's, so it crosses like the first symbol's."""
    for edge, crossings in ((composite, 2), (as_connection(shadow([turn, back, other], wraps=[1, 1])), 3)):
        assert edge.hits == (1, crossings)
        assert np.abs(edge.state - turn.state).max() < 1e-8
        assert np.abs(edge.state - turn.state).max() > 0
        assert edge.time_out == pytest.approx(turn.time_out, abs=SAME_FLIGHT)
        assert edge.transversality_angle == pytest.approx(turn.transversality_angle, abs=1e-4)
        # It arrives like its last symbol, and its end lies on the target's local manifold.
        near = edge.orbit.sample(np.array([edge.time_in]))[0]
        phase, distance = OrbitCurve(edge.target).nearest(near)
        assert distance == pytest.approx(1e-3, rel=1e-6)
        assert phase == pytest.approx(edge.phase_in, abs=1e-9)


def test_a_symmetric_edge_equals_its_mirror_image(turn, back, found):
    """A forward and a backward turn are symmetric; a turn and a neighbour of its mirror image are not."""
    assert as_connection(shadow([turn, back], wraps=[2])).symmetric
    assert as_connection(shadow([turn, turn], wraps=[2])).symmetric
    lopsided = next(c for c in found if not c.symmetric)
    assert not as_connection(shadow([turn, lopsided], wraps=[2])).symmetric
    assert not as_connection(shadow([turn, lopsided, turn], wraps=[2, 2])).symmetric


@pytest.mark.slow
def test_a_heteroclinic_round_trip_gives_a_homoclinic_edge(system):
    pairs = [("down-up", "up-down"), ("up-down", "down-up")]
    there, home = (find_connections(*orbits_between(system, *pair, 0.2)).connections[0] for pair in pairs)
    edge = as_connection(shadow([there, home], wraps=[1]))
    assert (edge.source.saddle, edge.target.saddle) == ("down-up", "down-up")
    assert edge.section is there.section
    assert edge.winding == tuple(a + b for a, b in zip(there.winding, home.winding, strict=True))
    orbit = shadow([edge, there], wraps=[2])
    plain = shadow([there, home, there], wraps=[1, 2])
    assert orbit.converged
    assert orbit.wraps_realised == (2,)
    assert orbit.symbol_times[-1] - orbit.symbol_times[0] == pytest.approx(
        plain.symbol_times[-1] - plain.symbol_times[0], abs=SAME_ORBIT
    )
