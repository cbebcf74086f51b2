"""Hyperbolic periodic orbits as vertices, with their tubes, connections and walks."""

import numpy as np
import pytest

from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.orbits.manifold import OrbitCurve, local_manifold
from dpcontrol.orbits.rotating import rotating_orbits
from dpcontrol.orbits.vertex import rotating_vertex
from dpcontrol.tubes.connections import find_lap_connections, grown_crossing
from dpcontrol.walks.shadowing import shadow
from dpcontrol.walks.walks import as_connection

ENERGY = -0.06985  # J: the outer arm's rotating orbit has λ = -2.74, and Down-Up its Lyapunov orbit
MULTIPLIER = -2.7436245634812297  # computed independently in 113-bit arithmetic
RESIDUAL = 1e-11  # required; about 1e-13 is achieved
MIRRORED = 1e-9  # separate searches of a connection and its mirror image, truncated at (3e-7)² and λ^-14
FLOWN = 1e-9  # propagation over two periods, λ² times 1e-13
SPLINE = 2e-7  # scaled, at the outer arm's lowest position with 21 rad/s; 1e-10 elsewhere
ENERGY_ERROR = 1e-12  # J, between nodes


@pytest.fixture(scope="module")
def rotating(system):
    return rotating_vertex(rotating_orbits(system, 2, ENERGY)[-1])


@pytest.fixture(scope="module")
def section(system):
    return system.named_sections["outer-down"]


@pytest.fixture(scope="module")
def lyapunov(system):
    return lyapunov_orbit(system, "down-up", energy=ENERGY)


@pytest.fixture(scope="module")
def out(rotating, lyapunov, section):
    return find_lap_connections(rotating, lyapunov, section=section, crossing=grown_crossing(rotating, section))


@pytest.fixture(scope="module")
def into(rotating, lyapunov, section):
    return find_lap_connections(lyapunov, rotating, section=section, crossing=grown_crossing(rotating, section))


def test_a_negative_multiplier_gives_a_one_sided_manifold(system, rotating):
    manifold = local_manifold(rotating)
    assert manifold.exponent == pytest.approx(np.log(-MULTIPLIER), abs=1e-12)
    frame = manifold.frame(np.array([0.3, 1.3, 2.3, -0.7]))
    turn = np.array([0.0, 2 * np.pi, 0.0, 0.0])
    assert frame.states - frame.states[0] == pytest.approx(np.outer([0, 1, 2, -1], turn), abs=1e-12)
    assert frame.vectors == pytest.approx(np.outer([1, -1, 1, -1], frame.vectors[0]), abs=1e-12)
    end, matrix = system.propagator.flow_with_stm(frame.states[0], rotating.period)
    assert np.abs(end - frame.states[1]).max() < FLOWN
    assert np.abs(matrix @ frame.vectors[0] - MULTIPLIER * frame.vectors[0]).max() < FLOWN


def test_the_frame_follows_the_flow_and_is_symmetric(system, rotating):
    orbit = rotating
    manifold = local_manifold(orbit)
    phases = np.linspace(-0.6, 1.6, 23)
    frame = manifold.frame(phases)
    for k in range(0, 22, 5):
        step = phases[k + 1] - phases[k]
        end, matrix = system.propagator.flow_with_stm(frame.states[k], step * orbit.period)
        assert np.abs(end - frame.states[k + 1]).max() < FLOWN
        grown = matrix @ frame.vectors[k] * np.exp(-manifold.exponent * step)
        assert np.abs(grown - frame.vectors[k + 1]).max() < FLOWN * np.abs(frame.vectors[k + 1]).max()
    image = (manifold.frame(-phases).states - orbit.rest) @ orbit.mirror.T + orbit.rest
    assert np.abs(image - frame.states).max() < FLOWN
    # Slopes are the derivatives of states and vectors.
    step = 1e-5
    sides = [manifold.frame(phases + s * step) for s in (1, -1)]
    slope = (sides[0].states - sides[1].states) / (2 * step)
    assert np.abs(slope - frame.state_slopes).max() < 1e-5 * np.abs(slope).max()
    slope = (sides[0].vectors - sides[1].vectors) / (2 * step)
    assert np.abs(slope - frame.vector_slopes).max() < 1e-5 * np.abs(slope).max()


def test_the_curve_of_a_rotating_orbit_finds_its_phases(rotating):
    curve = OrbitCurve(rotating)
    phases = np.array([0.0, 0.2, 0.77, 0.999])
    states = local_manifold(rotating).frame(phases + np.array([0, 3, -2, 1])).states
    found, distances = curve.distances(states)
    # Phases zero and one are equal.
    assert np.abs((found - phases + 0.5) % 1.0 - 0.5).max() < 1e-8
    assert distances.max() < SPLINE


@pytest.mark.slow
def test_connections_leave_the_rotating_orbit_and_join_it(system, rotating, lyapunov, out, into):
    for search in (out, into):
        assert search.connections
        for c in search.connections:
            assert c.residual < RESIDUAL
            assert np.abs(system.numeric.hamiltonian(c.orbit.states) - ENERGY).max() < ENERGY_ERROR
            ends = c.orbit.sample(c.orbit.times[[0, -1]])
            for orbit, state in zip((c.source, c.target), ends, strict=True):
                assert OrbitCurve(orbit).nearest(state)[1] < 1e-6
            start = c.orbit.start.orbit_phase - c.orbit.times[0] / c.source.period
            end = c.orbit.end.orbit_phase - c.orbit.times[-1] / c.target.period
            assert 0 <= (start if c.source is rotating else end) < 1
    assert (out.connections[0].source, out.connections[0].target) == (rotating, lyapunov)
    assert out.connections[0].name.startswith("outer-rotating>down-up[0,")


def test_the_symmetry_maps_one_search_to_the_other(system, out, into):
    """The map (θ, ω)(t) to (-θ, ω)(-t) preserves the rotating orbit and Down-Up. The searches are independent."""
    assert len(out.connections) == len(into.connections)
    for c in out.connections:
        image = system.reversers[-1] @ c.state
        other = min(into.connections, key=lambda o: float(system.scaled_distance(o.state, image)))
        assert system.scaled_distance(other.state, image) < MIRRORED
        assert other.time_in == pytest.approx(c.time_out, abs=1e-7)
        assert other.time_out == pytest.approx(c.time_in, abs=1e-7)
        assert other.hits == c.hits[::-1]
        assert other.transversality_angle == pytest.approx(c.transversality_angle, abs=1e-4)


def test_wraps_at_the_rotating_orbit_are_turns(system, rotating, into, out):
    join, leave = into.connections[0], out.connections[0]
    turned, stays = [], []
    for wraps in range(4):
        orbit = shadow([join, leave], wraps=[wraps])
        assert orbit.converged
        assert orbit.wraps_realised == (wraps,)
        assert orbit.residual < RESIDUAL
        states = orbit.states(np.linspace(0.0, orbit.duration, 1500))
        assert np.abs(system.numeric.hamiltonian(states) - ENERGY).max() < ENERGY_ERROR
        # Samples lie on one trajectory without jumps of a turn.
        assert np.abs(np.diff(states[:, 1])).max() < 1.0
        home = (states[:40, 1].mean(), states[-40:, 1].mean())
        turned.append(round((home[1] - home[0]) / (2 * np.pi)))
        assert turned[-1] == orbit.offsets[-1][1]
        stays.append(float(np.diff(orbit.symbol_times)[0]))
    assert np.diff(turned).tolist() == [1, 1, 1]
    assert turned[0] > 5
    assert np.diff(stays)[1:] == pytest.approx([rotating.period] * 2, abs=1e-3)


def test_each_turn_flips_the_sign_of_a_periodic_dance(into, out):
    """With λ < 0 at the stop, each additional turn exchanges the sides of the orbit's tube."""
    signs = []
    for wraps in (1, 2, 3):
        orbit = shadow([into.connections[0], out.connections[0]], wraps=[wraps, 1], periodic=True)
        assert orbit.converged
        assert orbit.residual < RESIDUAL
        assert orbit.estimate is not None
        assert orbit.estimate.multipliers is not None
        assert abs(orbit.estimate.multipliers.reciprocity) < 1e-8
        signs.append(orbit.estimate.multipliers.sign)
    assert signs[0] == -signs[1] == signs[2]


@pytest.mark.slow
def test_a_walk_can_start_and_end_at_the_rotating_orbit(rotating, into, out):
    orbit = shadow([out.connections[0], into.connections[0]], wraps=[2])
    assert orbit.converged
    assert orbit.wraps_realised == (2,)
    curve = OrbitCurve(rotating)
    for state in orbit.orbit.states[[0, -1]]:
        assert curve.nearest(state)[1] < 1e-7
    # Laps before the departure do not count for an edge, as for its symbols.
    edge = as_connection(orbit)
    inside = edge.orbit.sample(np.arange(-edge.time_out, edge.time_in, 1e-3))[:, 1] / (2 * np.pi)
    assert sum(edge.hits) - 1 == np.count_nonzero(np.diff(np.floor(inside)))
    assert edge.symmetric
    longer = shadow([into.connections[0], edge, out.connections[0]], wraps=[1, 2])
    plain = shadow([into.connections[0], out.connections[0]] * 2, wraps=[1, 2, 2])
    assert longer.wraps_realised == (1, 2)
    times = np.linspace(-1.0, plain.symbol_times[-1] - plain.symbol_times[0] + 1.0, 200)
    apart = longer.states(times + longer.symbol_times[0]) - plain.states(times + plain.symbol_times[0])
    assert np.abs(apart).max() < FLOWN
