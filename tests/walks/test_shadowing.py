"""Walks and the orbits that shadow them."""

from dataclasses import replace

import numpy as np
import pytest

from dpcontrol.foundation.causes import ShootingCause, WalkCause
from dpcontrol.shooting.newton import NewtonSettings, solve_shooting
from dpcontrol.tubes.connections import find_connections, orbits_between
from dpcontrol.walks.shadowing import ShadowingSettings, described, first_guess, phase_gap, shadow
from dpcontrol.walks.symbols import choose, parse_symbol, parse_walk

SADDLES = ("down-up", "up-down")
RESIDUAL = 1e-11
SAME_ORBIT = 1e-10  # scaled


@pytest.fixture(scope="module")
def connections(system):
    pairs = [("down-up", "down-up"), ("down-up", "up-down"), ("up-down", "up-down"), ("up-down", "down-up")]
    return {pair: find_connections(*orbits_between(system, *pair, 0.2)).connections for pair in pairs}


@pytest.fixture(scope="module")
def turns(system):
    return find_connections(*orbits_between(system, "down-up", "down-up", -0.07)).connections


def chain(connections, walk):
    return [choose(s, connections[s.source, s.target]) for s in parse_walk(walk, SADDLES)]


ROUND_TRIP = ["down-up +", "down-up > up-down", "up-down -", "up-down > down-up"]


def test_a_turn_is_shadowed_with_its_leads(turns):
    turn = choose(parse_symbol("down-up +", SADDLES), turns)
    orbit = shadow([turn], lead_in=2, lead_out=3)
    assert orbit.converged
    assert orbit.residual < RESIDUAL
    period = turn.source.period
    assert orbit.duration == pytest.approx(turn.time_out + turn.time_in + 5 * period, rel=1e-12)
    ends = orbit.states(np.array([0.0, orbit.duration]))
    assert ends[1, 1] - ends[0, 1] == pytest.approx(2 * np.pi, abs=1.5)


@pytest.mark.slow
def test_a_walk_over_both_saddles_conserves_energy_and_winding(system, connections):
    walked = chain(connections, ROUND_TRIP)
    orbit = shadow(walked, wraps=[2, 3, 2])
    assert orbit.converged
    assert orbit.residual < RESIDUAL
    assert orbit.wraps_realised == (2, 3, 2)
    states = orbit.states(np.linspace(0, orbit.duration, 3000))
    assert np.abs(system.numeric.hamiltonian(states) - 0.2).max() < 1e-12
    # Its final lattice point is the sum of the windings.
    total = np.sum([c.winding for c in walked], axis=0)
    home = np.array([0.0, np.pi]) + 2 * np.pi * total
    last = states[-300:, :2]
    assert np.abs((last.max(0) + last.min(0)) / 2 - home).max() < 0.1


def test_wraps_lengthen_a_stop_by_whole_periods(connections):
    walked = chain(connections, ROUND_TRIP[:2])
    stays = []
    for wraps in (1, 2, 3):
        orbit = shadow(walked, wraps=[wraps])
        assert orbit.wraps_realised == (wraps,)
        stays.append(float(np.diff(orbit.symbol_times)[0]))
    period = walked[0].target.period
    assert np.diff(stays) == pytest.approx([period, period], abs=1e-3)
    expected = walked[0].time_in + walked[1].time_out + (3 + phase_gap(*walked)) * period
    assert stays[2] == pytest.approx(expected, abs=1e-3)


def test_segments_too_long_for_the_multiplier_are_detected(connections):
    """A segment of one period multiplies rounding by λ = 2,000, so the defect exceeds 1e-12."""
    walked = chain(connections, ["down-up +", "down-up -"])
    tight = NewtonSettings(tolerance=1e-12)
    long, short = (shadow(walked, wraps=[6], settings=ShadowingSettings(n, newton=tight)) for n in (1, 8))
    assert short.converged
    assert not long.converged
    assert (long.cause, long.orbit.cause) == (WalkCause.SHOOTING, ShootingCause.ROUNDING)
    assert long.residual > 5 * short.residual


def test_plus_selects_the_most_transversal_symmetric_connection(turns):
    for sense in (1, -1):
        chosen = choose(parse_symbol(f"down-up {'+' if sense > 0 else '-'}", SADDLES), turns)
        rivals = [c for c in turns if c.sense == sense and c.symmetric]
        assert chosen.sense == sense
        assert chosen.transversality_angle == max(c.transversality_angle for c in rivals)


@pytest.mark.parametrize("periodic", [False, True])
def test_a_guess_with_an_error_of_a_thousandth_gives_the_same_orbit(system, connections, periodic):
    """The noise on all nodes is 1e5 times the distance of the ends from their orbits."""
    walked = chain(connections, ROUND_TRIP)
    wraps = [1, 0, 2, 1][: 4 if periodic else 3]
    guess = first_guess(walked, wraps, periodic=periodic)
    found = described(solve_shooting(guess), tuple(walked), wraps)
    generator = np.random.default_rng(5)
    for _ in range(3):
        states = guess.states + generator.uniform(-1e-3, 1e-3, guess.states.shape) * system.scale
        again = described(solve_shooting(replace(guess, states=states)), tuple(walked), wraps)
        assert again.converged, again.status
        assert _apart(system, found, again) < SAME_ORBIT


def _apart(system, first, second):
    """Return the largest scaled distance of two orbits, timed from their first symbol."""
    times = np.linspace(0.0, first.symbol_times[-1] - first.symbol_times[0], 400)
    states = [orbit.states(times + orbit.symbol_times[0]) for orbit in (first, second)]
    return float(np.max(np.abs(states[1] - states[0]) / system.scale))
