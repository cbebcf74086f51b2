"""Cuts and connections, compared with independent values, scipy's integration and other sampling."""

import numpy as np
import pytest
from quick_rate import flown_by_scipy

from dpcontrol.foundation.causes import CutCause, OpenEndCause
from dpcontrol.orbits.cut import CutSettings, tube_cut
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.orbits.manifold import OrbitCurve, UnstableManifold, local_manifold
from dpcontrol.plans.model import load_model
from dpcontrol.tubes import intersections
from dpcontrol.tubes.connections import find_connections, orbits_between
from dpcontrol.tubes.intersections import ConnectionSettings, intersect_cuts, near_touches, polyline_crossings
from tests.reference_values import CONNECTIONS, images, on_torus
from tests.uniform_rods import uniform_rods

STATE = 1e-9  # required; about 1e-12 is achieved
RESIDUAL = 1e-11
NEAR_ORBIT = 2e-6  # scaled: closest approach of free propagation in double precision
KEY = ("down-up", "down-up", -0.07)


def search(key, **settings):
    source, target, energy = key
    orbits = orbits_between(load_model("lab").system, source, target, energy)
    return find_connections(*orbits, settings=ConnectionSettings(**settings))


@pytest.fixture(scope="module")
def found():
    return {key: search(key) for key in CONNECTIONS}


@pytest.mark.parametrize("key", CONNECTIONS, ids=str)
def test_all_reference_connections_and_their_images_are_found(found, key):
    connections = found[key].connections
    assert len(connections) == CONNECTIONS[key][0]
    assert max(c.residual for c in connections) <= RESIDUAL
    for image in images(key):
        assert min(on_torus(c.state, image) for c in connections) < STATE


@pytest.mark.parametrize("key", CONNECTIONS, ids=str)
def test_senses_form_pairs_and_symmetric_connections_lie_on_the_symmetry_line(found, key):
    connections = found[key].connections
    assert sum(c.sense for c in connections) == 0
    for c in connections:
        mirror = min(on_torus(c.state, c.state * [-1, -1, 1, 1]), on_torus(c.state, c.state * [1, 1, -1, -1]))
        assert c.symmetric == (key[0] == key[1] and mirror < 1e-8)
        entries = [k for k in c.winding if k]
        if key[0] == key[1]:
            assert c.sense == entries[0]
            assert sorted(map(abs, c.winding)) == [0, 1]
        else:
            assert c.sense == np.sign(c.state[2] - c.state[3])


@pytest.mark.parametrize("key", CONNECTIONS, ids=str)
def test_connections_reach_both_orbits(found, key):
    for c in found[key].connections:
        for orbit, sign in ((c.source, -1), (c.target, 1)):
            times = sign * np.linspace(0, 3.0, 1500)
            _, distances = OrbitCurve(orbit).distances(orbit.system.propagator.sample(c.state, times))
            assert distances.min() < NEAR_ORBIT


@pytest.mark.parametrize("key", CONNECTIONS, ids=str)
def test_flight_times_and_phases_refer_to_the_first_approach(found, key):
    for c in found[key].connections:
        for orbit, seconds, phase, sign in (
            (c.source, c.time_out, c.phase_out, -1),
            (c.target, c.time_in, c.phase_in, 1),
        ):
            curve = OrbitCurve(orbit)
            there = orbit.system.propagator.flow(c.state, sign * seconds)
            assert curve.nearest(there)[1] == pytest.approx(1e-3, rel=1e-4)
            assert abs((curve.nearest(there)[0] - phase + 0.5) % 1 - 0.5) < 1e-4
            before = orbit.system.propagator.sample(c.state, sign * np.linspace(0, 0.98 * seconds, 400))
            assert curve.distances(before)[1].min() > 1e-3


@pytest.mark.slow
def test_transversality_angles_agree_with_finite_differences(found):
    key = KEY
    fine = search(key, cut=CutSettings(chord=0.002))
    for c in found[key].connections:
        if not c.symmetric or c.sense < 0:
            continue
        piece = next(p for p in fine.cuts[0].pieces if p.direction > 0)
        # On the symmetry line q = 0, the stable cut is the reflection of the unstable cut.
        k = np.argmin(np.linalg.norm(piece.states - c.state, axis=1))
        tangent = piece.points[k + 1] - piece.points[k - 1]
        expected = 2 * np.degrees(np.arctan2(abs(tangent[0]), abs(tangent[1])))
        assert c.transversality_angle == pytest.approx(min(expected, 180 - expected), abs=1.0)


def test_open_cuts_are_reported_with_their_cause(found):
    search = found["down-up", "down-up", 0.2]
    # Beyond a graze, an earlier crossing counts, so this one is complete.
    assert search.complete
    assert not any(end.hides for _, end in search.open_ends)
    assert {end.branch for _, end in search.open_ends} == {1, -1}
    assert all(end.cause is OpenEndCause.GRAZES for _, end in search.open_ends)
    assert found[KEY].complete


def test_cuts_with_too_little_time_or_too_few_points_are_not_resolved():
    system = load_model("lab").system
    manifold, section = UnstableManifold(lyapunov_orbit(system, "down-up", energy=0.2)), system.sections[KEY[:2]]
    short, coarse = (
        tube_cut(manifold, section, settings=settings)
        for settings in (CutSettings(longest=0.5), CutSettings(most_points=120))
    )
    assert not short.pieces
    assert short.open_ends[0].cause is OpenEndCause.NEVER_ARRIVES
    assert coarse.cause is CutCause.UNRESOLVED


@pytest.mark.slow
@pytest.mark.parametrize("distance", [1e-9, 3e-2])
def test_seeds_too_near_or_too_far_make_a_search_incomplete(distance):
    """Rounding dominates the cuts of near seeds, and the linear approximation fails for distant seeds."""
    expected = CONNECTIONS[KEY]
    result = search(KEY, distance=distance)
    wrong = len(result.connections) != expected[0]
    off = [min(on_torus(c.state, s) for s in map(np.array, expected[1])) for c in result.connections if c.sense > 0]
    if wrong:
        assert not result.complete
    else:
        assert min(off) < STATE


@pytest.mark.parametrize(("gap", "seen"), [(2e-5, True), (0.01, False)])
def test_near_touches_are_those_within_the_curves_sagitta(gap, seen):
    x = np.linspace(-1, 1, 201) + 0.005
    parabola, axis = np.column_stack([x, x**2 + gap]), np.column_stack([x, 0 * x])
    assert not polyline_crossings(parabola, axis)
    touches = near_touches(parabola, axis)
    assert bool(touches) == seen
    assert all(abs(x[int(i)]) < 0.02 for i, _ in touches)


@pytest.mark.slow
def test_closed_cuts_are_refined_until_they_cross_evenly():
    """With λ = 9e4, the cut has folds thinner than its chords. Closed curves cross an even number of times."""
    orbits = orbits_between(load_model("printed").system, "down-up", "up-down", 0.1788112)
    coarse = find_connections(*orbits, settings=ConnectionSettings(finest=1.0))
    assert len(coarse.connections) % 4 != 0
    assert not coarse.complete
    assert not coarse.even
    for distance in (1e-4, 5e-5):
        fine = find_connections(*orbits, settings=ConnectionSettings(distance=distance))
        assert len(fine.connections) == 12
        assert fine.even


@pytest.mark.slow
def test_parallel_cuts_without_intersections_are_not_failures(monkeypatch):
    """Between q = 0.3 and a graze, the cuts are 6e-7 apart, which is below the error of their chords."""
    system = uniform_rods((0.35, 0.1), (0.25, 0.5))
    orbit, settings = lyapunov_orbit(system, "up-down", energy=2.047837), ConnectionSettings()
    manifold, section = local_manifold(orbit, settings.distance), system.sections["up-down", "up-down"]
    cut = tube_cut(manifold, section, settings=settings.cut)
    monkeypatch.setattr(intersections, "_partners", lambda *_: [])
    crossings = intersect_cuts(system, section, (manifold, manifold), (cut, cut), settings)
    assert len(crossings.found) > 20
    assert crossings.failed == 0


@pytest.mark.slow
@pytest.mark.parametrize("key", CONNECTIONS, ids=str)
def test_windings_agree_with_an_independent_integration(found, key):
    system = load_model("lab").system
    for c in found[key].connections:
        after, before = (flown_by_scipy(system, c.state, t) for t in (c.time_in, -c.time_out))
        for state, saddle, turns in ((before, key[0], (0, 0)), (after, key[1], c.winding)):
            home = system.equilibrium(saddle)[:2] + 2 * np.pi * np.asarray(turns)
            # Orbits stay within a turn of their saddle's lattice point.
            assert np.abs(state[:2] - home).max() < np.pi
