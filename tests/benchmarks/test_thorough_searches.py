"""Thorough searches against a brute force of twenty thousand points a tube, on uniform rods unlike the lab's arms.

The brute force propagates the seeds of evenly spaced phases to the section. It intersects the chords of neighbours that
arrive near each other with those of the mirrored tube, and solves each intersection by scipy's root finder with
differences. It has no refinement, no partners and no second pass.
"""

import time
from itertools import product

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import approx_fprime, root
from uniform_rods import uniform_rods

from dpcontrol.orbits.cut import section_points
from dpcontrol.orbits.manifold import OrbitCurve, local_manifold
from dpcontrol.tubes.connections import find_connections, orbits_between
from dpcontrol.tubes.intersections import polyline_crossings, search_settings

pytestmark = pytest.mark.benchmark

POINTS = 20_000
NEIGHBOURS = 0.3  # in (q, p/p₀): farther apart they are not of one piece
SOLVED = 1e-6  # of a root, in (q, p/p₀): what differences reach where flights are sensitive
SETTLED = 1e-8  # of a phase: beside a graze two cuts run 6e-7 apart without meeting; the next step there is 4e-6
SAME = 1e-5  # scaled
REFINED = 1e-9  # rad, rad/s
SECONDS = 60.0  # of processor time
NEAR_ORBIT = 2e-3  # scaled: where flights that count as joined at 1e-3 end, integrated independently

UP_DOWN, DOWN_UP = ("up-down", "up-down"), ("down-up", "down-up")
CASES = [
    ((0.2, 0.1), (0.1, 0.5), UP_DOWN, 1.0791, 60),
    ((0.2, 0.1), (0.1, 0.5), DOWN_UP, 1.0791, 22),
    ((0.2, 0.2), (0.1, 0.5), UP_DOWN, 1.0791, 44),
    ((0.2, 0.1), (0.1, 0.1), UP_DOWN, 0.250155, 32),
    ((0.1, 0.1), (0.05, 0.05), UP_DOWN, 0.07848, 0),
    ((0.3, 0.2), (0.5, 0.1), DOWN_UP, 0.0981, 0),
    ((0.2, 0.3), (0.05, 0.5), UP_DOWN, 1.61865, 0),
    ((0.4, 0.4), (0.05, 0.1), ("down-up", "up-down"), 0.45126, 0),
    ((0.2, 0.1), (0.1, 0.2), ("up-down", "down-up"), 0.45126, 0),
]
"""Lengths, masses, saddles, energy in J, and the least number of connections."""


class Tube:
    """One branch of an unstable tube, or of a stable one: the unstable one turned around."""

    def __init__(self, manifold, section, branch, stable):
        self.manifold, self.section, self.branch, self.stable = manifold, section, branch, stable
        self.system = manifold.orbit.system

    def states(self, phases):
        """States (K, 4) of the first crossings from phases (K,), not a number where there is none."""
        seeds, _ = self.manifold.seeds(np.asarray(phases), self.branch)
        longest = self.system.flight_periods * self.manifold.orbit.period
        states, _ = self.system.propagator.crossings(seeds, self.section, longest=longest)
        return states * [1, 1, -1, -1] if self.stable else states

    def points(self, phases):
        return section_points(self.system, self.section, self.states(phases))

    def runs(self):
        """Phases (K,), points (K, 2) and direction of crossing of each stretch of neighbours."""
        phases = np.arange(POINTS + 1) / POINTS
        states = self.states(phases)
        points = section_points(self.system, self.section, states)
        direction = np.sign(self.system.numeric.rate(states) @ np.asarray(self.section.normal))
        near = np.linalg.norm(np.diff(points, axis=0), axis=1) < NEIGHBOURS
        ends = np.flatnonzero(~(near & (direction[1:] == direction[:-1]))) + 1
        for part in np.split(np.arange(len(phases)), ends):
            if len(part) > 1:
                yield phases[part], points[part], direction[part[0]]


def crossings(first, second):
    """Phases (2,) at which chords of two tubes cross, angles modulo a turn."""
    others = list(second.runs())
    for phases, points, way in first.runs():
        for other_phases, other_points, other_way in others:
            if way != other_way:
                continue
            for turns in range(-4, 5):
                for i, j in polyline_crossings(points, other_points + np.array([2 * np.pi * turns, 0.0])):
                    yield np.array([phases[0] + i / POINTS, other_phases[0] + j / POINTS])


def brute_force(system, saddles, energy):
    """States (K, 4) of all connections that chords and a root finder see."""
    section = system.section_between(*saddles)
    manifolds = [local_manifold(orbit, 1e-4) for orbit in orbits_between(system, *saddles, energy)]
    found = []
    for branch, other in product((1, -1), (1, -1)):
        if branch < 0 and all(m.branches_are_mirrored for m in manifolds):
            continue  # images of the others
        first, second = Tube(manifolds[0], section, branch, False), Tube(manifolds[1], section, other, True)

        def gap(phases, first=first, second=second):
            off = first.points(phases[:1])[0] - second.points(phases[1:])[0]
            off[0] -= 2 * np.pi * np.rint(off[0] / (2 * np.pi))
            return np.where(np.isfinite(off), off, 1.0)

        for guess in crossings(first, second):
            solved = root(gap, guess, options={"eps": 1e-12, "xtol": 1e-13})
            if np.abs(gap(solved.x)).max() > SOLVED or np.abs(solved.x - guess).max() > 3 / POINTS:
                continue
            slopes = approx_fprime(solved.x, gap, 1e-9)
            if not np.abs(np.linalg.lstsq(slopes, gap(solved.x))[0]).max() < SETTLED:
                continue
            state = first.states(solved.x[:1])[0]
            images = [state] if branch < 0 or not all(m.branches_are_mirrored for m in manifolds) else [state, -state]
            if not found or min(system.scaled_distance(np.array(found), state)) > SAME:
                found += images
    return np.array(found).reshape(-1, 4)


def distances_after(system, connections, sign):
    """Scaled distances (K,) from their orbits of flights by scipy from the section, all at once."""
    orbit = connections[0].target if sign > 0 else connections[0].source
    seconds = np.array([c.time_in if sign > 0 else c.time_out for c in connections])[:, None]

    def rate(_, states):
        return (sign * seconds * system.numeric.rate(states.reshape(-1, 4))).ravel()

    start = np.array([c.state for c in connections]).ravel()
    flown = solve_ivp(rate, (0.0, 1.0), start, method="DOP853", rtol=3e-14, atol=1e-15)
    return OrbitCurve(orbit).distances(flown.y[:, -1].reshape(-1, 4))[1]


@pytest.mark.parametrize(("lengths", "masses", "saddles", "energy", "least"), CASES, ids=str)
def test_a_thorough_search_finds_what_brute_force_finds(lengths, masses, saddles, energy, least):
    system = uniform_rods(lengths, masses)
    orbits = orbits_between(system, *saddles, energy)
    assert all(orbit.converged for orbit in orbits)
    began = time.process_time()
    search = find_connections(*orbits, settings=search_settings(thorough=True))
    assert time.process_time() - began < SECONDS
    states = np.array([c.state for c in search.connections]).reshape(-1, 4)
    brute = brute_force(system, saddles, energy)
    assert len(states) >= max(least, len(brute))
    for state in brute:
        assert system.scaled_distance(states, state).min() < 100 * SAME, state
    for k, c in enumerate(search.connections):
        assert c.residual < REFINED
        if k:
            assert system.scaled_distance(states[:k], c.state).min() > 1e-7
    for sign in (-1.0, 1.0):
        assert distances_after(system, search.connections, sign).max() < NEAR_ORBIT
