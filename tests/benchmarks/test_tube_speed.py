"""A thousand trajectories of a tube to its section: against scipy's DOP853 in time, and extended precision in error.

Both run on one core in turns and are timed by the processor time of this process, so that a busy machine slows
neither ratio. Compilation is left out; it is part of the atlas's own times.
"""

import math
import sys
import time

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dpcontrol.dynamics.propagator import ExtendedPropagator, extended, pi_times
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.plans.model import load_model

ENERGY = 0.2
COUNT = 1000
ROUNDS = 5
EXAMINED = 25  # trajectories flown in extended precision
FASTER = 150


def right_hand_sides(parameters):
    """Return the pendulum's rate written for scipy in three ways; the fastest takes part."""
    m11, m12, m22, g1, g2 = (float(p) for p in parameters[:5])
    mass, weight = np.array([[m11, m12], [m12, m22]]), np.array([g1, g2])

    def scalars(_, x):
        a, b, u, v = x.tolist()
        c, s = m12 * math.cos(a - b), m12 * math.sin(a - b)
        f, g = -s * v * v - g1 * math.sin(a), s * u * u - g2 * math.sin(b)
        d = m11 * m22 - c * c
        return [u, v, (m22 * f - c * g) / d, (m11 * g - c * f) / d]

    def arrays(_, x):
        difference = x[0] - x[1]
        coupled = mass * np.array([[1.0, np.cos(difference)], [np.cos(difference), 1.0]])
        turning = m12 * np.sin(difference) * np.array([-(x[3] ** 2), x[2] ** 2])
        return np.concatenate([x[2:], np.linalg.solve(coupled, turning - weight * np.sin(x[:2]))])

    return {"scalars": scalars, "arrays": arrays}


def by_dop853(rate, seed, longest):
    def height(_, x):
        return math.sin(x[1] / 2)

    height.terminal = True
    found = solve_ivp(rate, (0.0, longest), seed, method="DOP853", rtol=1e-12, atol=1e-12, events=height)
    return found.y_events[0][0]


def exactly(propagator, seed, time_guess):
    """Return the crossing of θ₂ = 2πk in extended precision, by Newton on the time."""
    state = propagator.flow(extended(seed), extended(np.array([time_guess]))[0])
    sheet = pi_times(2 * np.rint(float(state[1]) / (2 * np.pi)))
    for _ in range(5):
        state = propagator.flow(state, -(state[1] - sheet) / state[3])
    assert abs(float(state[1] - sheet)) < 1e-30
    return state


def seconds(function):
    began = time.process_time()
    result = function()
    return time.process_time() - began, result


@pytest.mark.benchmark
def test_tube_trajectories_are_150_times_faster_than_dop853_and_nearer_to_the_truth(one_core, hold, capsys):
    system = load_model("lab").system
    orbit = lyapunov_orbit(system, "down-up", energy=ENERGY)
    section = system.sections["down-up", "down-up"]
    seeds, _ = UnstableManifold(orbit).seeds(np.arange(COUNT) / COUNT, 1)
    longest = system.flight_periods * orbit.period

    candidates = right_hand_sides(system.parameters)
    for rate in candidates.values():
        assert np.allclose(rate(0.0, seeds[0]), system.numeric.rate(seeds[0]), rtol=1e-12, atol=1e-12)
    few = seeds[:: COUNT // 20]
    taken = {
        name: seconds(lambda rate=rate: [by_dop853(rate, seed, longest) for seed in few])[0]
        for name, rate in candidates.items()
    }
    fastest = min(taken, key=taken.__getitem__)

    system.propagator.crossings(seeds[:10], section, longest=longest)
    ours, theirs, crossings, reference = [], 0.0, [], []
    for part in np.array_split(seeds, ROUNDS):
        spent, states = seconds(lambda part=part: [by_dop853(candidates[fastest], seed, longest) for seed in part])
        theirs += spent
        reference += states
        spent, crossings = seconds(lambda: system.propagator.crossings(seeds, section, longest=longest))
        ours.append(spent)
    ratio = theirs / float(np.median(ours))

    truth = ExtendedPropagator(system.equations, system.parameters)
    errors = np.empty((2, EXAMINED))
    for k, which in enumerate(np.linspace(0, COUNT - 1, EXAMINED, dtype=int)):
        exact = exactly(truth, seeds[which], crossings[which].time)
        for row, state in enumerate((crossings[which].state, reference[which])):
            errors[row, k] = float(np.abs(extended(state) - exact).max())

    with capsys.disabled():
        sys.stdout.write(
            f"\n{COUNT} trajectories at {ENERGY} J to {section.name}, core {one_core}, rate written with {fastest}\n"
            f"{'':12s}{'seconds':>10s}{'median error':>14s}{'largest error':>15s}\n"
            f"{'dpcontrol':12s}{np.median(ours):10.4f}{np.median(errors[0]):14.1e}{errors[0].max():15.1e}\n"
            f"{'DOP853':12s}{theirs:10.2f}{np.median(errors[1]):14.1e}{errors[1].max():15.1e}\nratio {ratio:.0f}\n"
        )
    assert (errors[0] < errors[1]).all()
    assert ratio >= FASTER
    hold("tube trajectories: times faster than DOP853", ratio)
