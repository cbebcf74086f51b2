"""Crossings of many trajectories, compared with roots on plain propagation."""

import time

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.plans.model import load_model

TIME = 1e-11  # s: brentq's own tolerance, and rounding grown over two seconds
STATE = 1e-9  # the same rounding times accelerations of a hundred
SOON = 2.0  # s of processor time for 1,000 flights of 2,000 steps, which take 0.2 s
LONGEST = 2.0
LIFTED = Section("angle_2 = 2 pi k", (0, 1, 0, 0), (1, 0, 0, 0), (1, 0), period=2 * np.pi)
RISING = Section("rising", (0, 1, 0, 0), (1, 0, 0, 0), (1, 0), period=2 * np.pi, side=(0, 0, 0, 1))
ALIGNED = Section("angle_1 = angle_2", (1, -1, 0, 0), (1, 0, 0, 0), (1, 1), period=2 * np.pi)
LEVEL = Section("angle_1 = 0.3", (1, 0, 0, 0), (0, 1, 0, 0), (0, 1), offset=0.3)
FASTER = Section("rate_1 = rate_2, above", (0, 0, 1, -1), (1, 0, 0, 0), (1, 0), offset=0.5, side=(1, 0, 0, 0))
SECTIONS = [LIFTED, RISING, ALIGNED, LEVEL, FASTER]


@pytest.fixture(scope="module")
def pendulum():
    return load_model("lab").system.propagator


@pytest.fixture(scope="module")
def states():
    """Eleven states, from almost at rest to several turns, which exceeds the lanes of one batch."""
    spread = np.random.default_rng(3)
    fast = spread.uniform(-1, 1, (8, 4)) * [np.pi, np.pi, 12.0, 12.0]
    slow = spread.uniform(-1, 1, (3, 4)) * [0.05, 0.05, 0.1, 0.1]
    return np.vstack([slow[:1], fast[:5], slow[1:2], fast[5:], slow[2:]])


def by_bracketing(propagator, section, state, longest):
    """Return all valid crossing times, by bracketed roots of the height on a fine grid."""
    grid = np.linspace(0, longest, 3001)[1:]
    flown = propagator.sample(state, grid)
    heights = section.height(flown)
    sheets = np.zeros(len(grid)) if section.period is None else np.floor(heights / section.period)
    signs = np.sign(heights) if section.period is None else sheets
    times = []
    for k in np.flatnonzero(signs[1:] != signs[:-1]):
        level = 0.0 if section.period is None else section.period * max(sheets[k], sheets[k + 1])

        def height(after, start=flown[k], level=level):
            return section.height(propagator.flow(start, after)) - level

        time = grid[k] + brentq(height, 0.0, grid[k + 1] - grid[k], xtol=1e-15)
        if section.admits(propagator.flow(state, time)):
            times.append(time)
    return times


@pytest.mark.parametrize("longest", [LONGEST, -LONGEST], ids=["forward", "backward"])
@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.name)
def test_every_crossing_is_a_bracketed_root_of_the_height(pendulum, states, section, longest):
    expected = [by_bracketing(pendulum, section, state, longest) for state in states]
    counts = [len(times) for times in expected]
    assert max(counts) >= 3
    for hit in range(1, max(counts) + 2):
        ends, met = pendulum.crossings(states, section, longest=longest, hit=hit)
        assert np.isfinite(met).tolist() == [count >= hit for count in counts]
        for end, at, times, state in zip(ends, met, expected, states, strict=True):
            if np.isfinite(at):
                assert at == pytest.approx(times[hit - 1], abs=TIME)
                assert np.abs(end - pendulum.flow(state, times[hit - 1])).max() < STATE


def test_a_trajectory_is_independent_of_the_others(pendulum, states):
    together = pendulum.crossings(states, LIFTED, longest=LONGEST)
    order = np.random.default_rng(5).permutation(len(states))
    shuffled = pendulum.crossings(states[order], LIFTED, longest=LONGEST)
    assert np.isfinite(together[1]).any()
    for ends, of_order in zip(together, shuffled, strict=True):
        assert np.array_equal(ends[order], of_order, equal_nan=True)
    for k in range(len(states)):
        alone = pendulum.crossings(states[k : k + 1], LIFTED, longest=LONGEST)
        for ends, of_one in zip(together, alone, strict=True):
            assert np.array_equal(ends[k : k + 1], of_one, equal_nan=True)


def test_a_nonfinite_state_does_not_arrive_or_affect_others(pendulum, states):
    expected, times = pendulum.crossings(states[1:4], LIFTED, longest=LONGEST)
    spoilt = np.vstack([states[1], [np.nan] * 4, states[2:4], [0, 0, np.inf, 0]])
    found, met = pendulum.crossings(spoilt, LIFTED, longest=LONGEST)
    assert np.isinf(met[[1, 4]]).all()
    assert np.isnan(found[[1, 4]]).all()
    assert np.array_equal(met[[0, 2, 3]], times)
    assert np.array_equal(found[[0, 2, 3]], expected, equal_nan=True)
    assert np.isinf(pendulum.crossings(np.full((2, 4), np.nan), LIFTED, longest=LONGEST)[1]).tolist() == [True, True]
    assert [ends.shape for ends in pendulum.crossings(np.empty((0, 4)), LIFTED, longest=LONGEST)] == [(0, 4), (0,)]


def test_a_collision_ends_one_flight_only():
    """A collision with a mass needs infinitely many steps, but the other trajectory still crosses."""
    system = load_model("three-body").system
    section = Section("x = 2", (1, 0, 0, 0), (0, 1, 0, 0), (0, 1), offset=2.0)
    leaving = np.array([1.5, 0.0, 3.0, 0.0])
    centre = np.array([-9.537e-4, 0.0, 0.0, 0.0])  # on the large mass, with an infinite rate
    found, times = system.propagator.crossings(np.array([centre, leaving]), section, longest=2.0)
    assert np.isfinite(times).tolist() == [False, True]
    assert found[1, 0] == pytest.approx(2.0, abs=1e-14)


def test_flights_to_a_singularity_end_soon():
    """Along a cubic potential, x becomes infinite in a finite time, and steps shrink without end."""

    def hamiltonian(q, p, _):
        (x, y), (p_x, p_y) = q, p
        return (p_x**2 + p_y**2) / 2 + x**2 / 2 - x**3 / 3 + y**2 * (1 + 0.3 * x**2) / 2

    system = System.from_hamiltonian("cubic", hamiltonian, coordinates=("x", "y"), equilibria={"bar": (1, 0)})
    states = np.array([[2.0, 0.1, speed, 0.0] for speed in np.linspace(0.5, 1.0, 1000)])
    section = Section.plane("x = 0", (1, 0))
    system.propagator.crossings(states[:1], section, longest=0.1)
    began = time.process_time()
    assert np.isinf(system.propagator.crossings(states, section, longest=60.0)[1]).all()
    assert time.process_time() - began < SOON


def test_a_distant_limit_loses_no_crossing() -> None:
    def hamiltonian(q, p, _):
        (x, y), (px, py) = q, p
        return (px**2 + py**2) / 2 + 1 / ca.cosh(x) ** 2 + 50 * y**2 * (1 + 0.2 / ca.cosh(x) ** 2) / 2

    system = System.from_hamiltonian("barrier", hamiltonian, coordinates=("x", "y"), equilibria={"top": (0.01, 0.0)})
    away = np.array([[3.0, 0.1, 0.02, 0.0]])
    section = Section.plane("x = 60", (1, 0), offset=60.0)
    near, far = (system.propagator.crossing(away[0], section, longest=longest) for longest in (500.0, 1e6))
    assert near is not None
    assert far is not None
    assert far.time == pytest.approx(near.time, rel=1e-12)
    assert near.time > 400
