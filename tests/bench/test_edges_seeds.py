"""Seeds of tubes: both borders from both sides, what a search says of what it misses, and the theory of rounding."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dpcontrol.bench.edges_seeds import SADDLE, asked, default_states, found_all, up_and_down
from dpcontrol.bench.seed_rounding import DEFAULT, Chances, Searches, cut_from, meetings, places, rounding
from dpcontrol.orbits.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.scenes.model import load_model
from dpcontrol.tubes.intersections import ConnectionSettings
from dpcontrol.tubes.orbit_curve import local_manifold

FEW_FLIGHTS = 0.4
"""Relative: three deviations of the scatter of 40 flights over that of 40 others."""
SEARCHES = 6


@cache
def orbit() -> LyapunovOrbit:
    return lyapunov_orbit(load_model("lab").system, SADDLE, energy=0.05)


@cache
def states() -> np.ndarray:
    return default_states(orbit())


@cache
def chances() -> Chances:
    return Chances(Searches(orbit()))


@cache
def foretold() -> float:
    return chances().distance()


def test_seeds_of_one_trajectory_have_the_same_place_at_any_distance():
    """What is foretold near the orbit is told of trajectories that were met far from it."""
    settings = ConnectionSettings(distance=DEFAULT / 7)
    nearer = local_manifold(orbit(), settings.distance)
    system, farther = orbit().system, chances().searches
    moved = np.log(7) / farther.manifold.exponent
    for near in meetings(nearer, cut_from(nearer, settings), settings):
        (far,) = (m for m in farther.wanted if system.scaled_distance(m.states[0], near.states[0]) < 1e-6)
        for k, side in enumerate(far.sides):
            (here,), (there,) = places(nearer, near.phases[[k]])[0], places(side.manifold, far.phases[[k]])[0]
            # Phases begin anew where a cut does; seeds leave the manifold by the square of their distance.
            apart = there - here - moved
            assert apart == pytest.approx(np.rint(apart), abs=DEFAULT)


def test_the_scatter_of_arrivals_grows_as_the_inverse_of_the_distance():
    side = chances().searches.wanted[0].sides[0]
    near = replace(side, manifold=local_manifold(orbit(), DEFAULT / 30))
    phases = np.linspace(0.0, 0.5, 8, endpoint=False)
    ratios = [rounding(near, float(phase)) / rounding(side, float(phase)) for phase in phases]
    assert float(np.exp(np.mean(np.log(ratios)))) == pytest.approx(1.0, rel=FEW_FLIGHTS / 2)
    assert ratios == pytest.approx(np.ones(8), rel=2.5 * FEW_FLIGHTS)


def test_meetings_are_found_as_often_as_foretold():
    """Half way down to where none is found, so that chances of one and of nearly none do not make it easy."""
    distance = 0.8 * foretold()
    found = np.array([chances().searches.found(distance, draw, again=False) for draw in range(SEARCHES)])
    chance = chances().each(distance)
    deviation = np.sqrt(SEARCHES * np.sum(chance * (1 - chance)))
    assert deviation > 1.5
    assert abs(found.sum() - SEARCHES * chance.sum()) < 3 * deviation


def test_closed_cuts_that_cross_unevenly_are_searched_again():
    """At -0.07 J cuts are closed: all are found more often than in one search alone."""
    closed = Chances(Searches(lyapunov_orbit(load_model("lab").system, SADDLE, energy=-0.07)))
    even = closed.distance()
    assert np.prod(closed.each(even)) < 0.3
    assert closed.all(even) == pytest.approx(0.5, abs=0.05)
    # Open cuts cannot tell.
    assert chances().all(foretold()) == pytest.approx(float(np.prod(chances().each(foretold()))))


def test_up_and_down_leads_to_where_half_of_the_answers_are_yes():
    rng = np.random.default_rng(1)
    found = []
    for _ in range(200):
        middle, values = up_and_down(lambda y: rng.random() < y**6 / (y**6 + 64.0), start=3.0, draws=20)
        assert len(values) == 20
        assert middle is not None
        found.append(np.log(middle / 2.0))
    assert abs(np.mean(found)) < 0.05
    assert np.std(found) < 0.2


def test_up_and_down_says_that_nothing_failed():
    assert up_and_down(lambda y: True, start=1.0, draws=5)[0] is None


@pytest.mark.parametrize("share", [0.85, 1.1])
def test_whole_searches_find_what_draws_of_them_find(share: float):
    """What draws leave out, multiple shooting, decides nothing."""
    whole = found_all(orbit(), states(), share * foretold())
    assert whole.works == chances().searches.found(share * foretold(), 0).all()


def test_seeds_nearer_than_foretold_lose_connections_and_the_search_says_so():
    assert found_all(orbit(), states(), 2 * foretold()).works
    lost = found_all(orbit(), states(), foretold() / 2)
    assert not lost.works
    assert lost.says.startswith("at least")
    assert "did not converge" in lost.says


def test_at_the_border_both_answers_are_given():
    works, lost = (asked(orbit(), states(), foretold(), wanted=wanted) for wanted in (True, False))
    assert works is not None
    assert lost is not None
    assert lost.says.startswith("at least")


def test_seeds_too_far_lose_connections_and_the_search_says_so():
    assert found_all(orbit(), states(), 0.2).works
    lost = found_all(orbit(), states(), 0.45)
    assert not lost.works
    assert lost.says.startswith("at least")


def test_the_default_is_far_from_both_borders():
    assert 50 * foretold() < DEFAULT
    assert DEFAULT < 0.2 / 100
