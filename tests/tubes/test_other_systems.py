"""Searches in systems without angles, with one reverser, with three arms or with massless rods."""

import numpy as np
import pytest

import dpcontrol as dp
from dpcontrol.foundation.causes import BranchCause
from dpcontrol.foundation.errors import InputError
from dpcontrol.orbits.cut import CutSettings, tube_cut
from dpcontrol.orbits.lyapunov import equilibria, lyapunov_orbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.plans.model import load_model
from dpcontrol.tubes.connections import find_connections, orbits_between
from dpcontrol.tubes.intersections import ConnectionSettings

ENERGY = -1.5175
# Independent values in double precision (Taylor integration), with errors of about 1e-11.
THREE_BODY = {
    "L1": (0.9323697524160935, (0.923777498791804, 0, 0, 0.07339510442768143), 2.9706237194261025, 1813.7997792118724),
    "L2": (1.0688263265633298, (1.0559587015976588, 0, 0, 0.07082340230733564), 3.225008242523218, 1488.7507959652266),
}
L1_HOMOCLINICS = (
    (-0.6444742663882221, 0.0, 0.022648446055406737, -0.6977730625042919),
    (-0.6315307633593611, 0.0, 0.0, -0.7311817832150959),
    (-0.6444742663889772, 0.0, -0.022648446055798226, -0.6977730625023669),
    (-0.6566205112696305, 0.0, 0.0, -0.6675897017534871),
)
STATE = 1e-9


@pytest.fixture(scope="module")
def three_body():
    return load_model("three-body").system


@pytest.mark.parametrize("point", THREE_BODY)
def test_collinear_points_and_their_lyapunov_orbits_agree_with_independent_values(three_body, point):
    x, state, period, multiplier = THREE_BODY[point]
    assert three_body.equilibrium(point)[0] == pytest.approx(x, rel=1e-14)
    orbit = lyapunov_orbit(three_body, point, energy=ENERGY)
    assert orbit.converged
    assert np.abs(orbit.state - state).max() < 1e-11
    assert orbit.period == pytest.approx(period, rel=1e-11)
    assert orbit.unstable_multiplier == pytest.approx(multiplier, rel=1e-8)
    assert abs(orbit.floquet_multipliers[0] * orbit.floquet_multipliers[-1] - 1) < 1e-9


def test_l1_homoclinics_on_the_far_side_are_found_among_all(three_body):
    orbit = lyapunov_orbit(three_body, "L1", energy=ENERGY)
    # The time suffices for half an inner lap, but only for few passages of the smaller primary.
    search = find_connections(orbit, orbit, settings=ConnectionSettings(cut=CutSettings(longest=3.6)))
    for state in L1_HOMOCLINICS:
        assert min(np.abs(c.state - state).max() for c in search.connections) < STATE
    assert max(c.residual for c in search.connections) < 1e-11
    # Time reversal (x, -y, -vx, vy) maps the set to itself.
    for c in search.connections:
        mirror = c.state * [1, -1, -1, 1]
        assert min(np.abs(d.state - mirror).max() for d in search.connections) < 1e-8
        assert c.winding == (0, 0)


@pytest.mark.slow
def test_l1_and_l2_are_first_connected_at_the_second_crossing(three_body):
    orbits = orbits_between(three_body, "L1", "L2", ENERGY)
    settings = ConnectionSettings(cut=CutSettings(longest=3.2))
    first = find_connections(*orbits, hits=(1, 1), settings=settings)
    second = find_connections(*orbits, hits=(2, 2), settings=settings)
    assert not first.connections
    assert second.connections
    for c in second.connections:
        assert c.residual < 1e-11
        assert c.hits == (2, 2)
        # Free propagation reaches the neighbourhoods of L2 and, backward, of L1.
        after = three_body.propagator.flow(c.state, c.time_in)
        before = three_body.propagator.flow(c.state, -c.time_out)
        assert after[0] == pytest.approx(THREE_BODY["L2"][0], abs=0.05)
        assert before[0] == pytest.approx(THREE_BODY["L1"][0], abs=0.05)


@pytest.mark.slow
def test_a_chaotically_scattering_branch_is_stopped_and_reported(three_body):
    manifold = UnstableManifold(lyapunov_orbit(three_body, "L1", energy=ENERGY), 1e-4)
    settings = CutSettings(longest=8.0, most_jumps=15)
    cut = tube_cut(manifold, three_body.sections["L1", "L1"], settings=settings)
    assert not cut.resolved
    assert {branch.cause for branch in cut.unresolved} == {BranchCause.SCATTERS}


def test_energy_uses_the_constant_of_the_paper(three_body):
    mu = load_model("three-body").parameters.mass_ratio
    x, y, vx, vy = state = np.array([0.4, 0.3, 0.1, -0.2])
    r1, r2 = np.hypot(x + mu, y), np.hypot(x - 1 + mu, y)
    expected = (vx**2 + vy**2) / 2 - ((1 - mu) * r1**2 + mu * r2**2) / 2 - (1 - mu) / r1 - mu / r2
    assert three_body.numeric.hamiltonian(state) == pytest.approx(expected, rel=1e-14)


def test_the_triple_pendulum_has_two_families_at_each_index_1_saddle():
    system = load_model("triple").system
    points = equilibria(system)
    saddles = [name for name, e in points.items() if e.kind == "index-1 saddle"]
    assert saddles == ["down-down-up", "down-up-down", "up-down-down"]
    for saddle in saddles:
        frequencies = sorted({round(float(v), 6) for v in points[saddle].eigenvalues.imag if v > 1e-6})
        for family, frequency in enumerate(frequencies):
            orbit = lyapunov_orbit(system, saddle, energy=points[saddle].energy + 1e-6, family=family)
            assert orbit.converged
            assert orbit.period == pytest.approx(2 * np.pi / frequency, rel=1e-4)
            assert abs(orbit.floquet_multipliers[0] * orbit.floquet_multipliers[-1] - 1) < 1e-8
    orbit = lyapunov_orbit(system, saddles[0], energy=points[saddles[0]].energy + 0.1)
    with pytest.raises(InputError, match="has no section between"):
        find_connections(orbit, orbit)


def test_the_point_mass_pendulum_is_a_chain_without_inertia():
    model = load_model("point-mass")
    (m1, m2), (l1, l2), g = model.arms.mass, model.arms.length, model.arms.gravity
    points = equilibria(model.system)
    assert points["down-up"].energy == pytest.approx(-(m1 + m2) * g * l1 + m2 * g * l2, rel=1e-13)
    # Linearised about hanging: det(K - s M) = 0 with the textbook matrices.
    mass = np.array([[(m1 + m2) * l1**2, m2 * l1 * l2], [m2 * l1 * l2, m2 * l2**2]])
    stiffness = np.diag([(m1 + m2) * g * l1, m2 * g * l2])
    expected = sorted(np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, stiffness))))
    found = sorted(v for v in points["down-down"].eigenvalues.imag if v > 0)
    assert found == pytest.approx(expected, rel=1e-12)
    orbit = lyapunov_orbit(model.system, "down-up", energy=0.0)
    search = find_connections(orbit, orbit)
    assert search.connections
    assert sum(c.sense for c in search.connections) == 0


@pytest.mark.slow
def test_a_search_whose_flights_nearly_collide_ends_with_a_status() -> None:
    """Derivatives along flights close to the smaller primary exceed double precision."""
    search = dp.connections(dp.orbit("three-body", "L2", energy=-1.515), seconds=30)
    assert len(search.connections) > 0
    assert not search.complete
    assert search.status
