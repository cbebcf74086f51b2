"""The points inside tubes, compared with scipy's integration, transit and time reversal."""

import numpy as np
import pytest
from quick_rate import quick_rate
from scipy.integrate import solve_ivp

from dpcontrol.dynamics.system import momentum_scale
from dpcontrol.orbits.cut import CutSettings, section_points, tube_cut
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.pages.paper.wheels import Outline, outlines_of, points_within, returns_of, section_states
from dpcontrol.plans.model import load_model

ENERGY = 1e-14  # J: states solve the energy equation directly
NEAR_CUT = 0.01  # share of points within the error of the cut's chords
DOP853 = 1e-7  # error of scipy's DOP853 at 1e-12 until the first return
TURNING = {"down-up": 1, "up-down": 0}
"""Index of the angle that turns on passage of each saddle's bottleneck."""


class Inside:
    """Points inside the tubes of a saddle, and their first returns."""

    def __init__(self, saddle: str, energy: float, chord: float = 0.02) -> None:
        self.system = load_model("lab").system
        self.section, self.turning = self.system.sections[saddle, saddle], TURNING[saddle]
        self.orbit = lyapunov_orbit(self.system, saddle, energy=energy)
        manifold = UnstableManifold(self.orbit)
        cut = tube_cut(manifold, self.section, settings=CutSettings(chord=chord))
        self.outlines = outlines_of(cut, manifold)
        self.unstable = next(o for o in self.outlines if o.branch == 1 and not o.stable)

    def states(self, points: np.ndarray) -> np.ndarray:
        energy, direction = self.orbit.energy, self.unstable.direction
        states, exists = section_states(self.system, self.section, points, energy=energy, direction=direction)
        return states[exists]


@pytest.fixture(scope="module", params=[("down-up", -0.07), ("up-down", 0.2)], ids=str)
def tubes(request):
    return Inside(*request.param)


@pytest.fixture(scope="module")
def states(tubes):
    return tubes.states(points_within(tubes.outlines, 24))


def test_an_outline_contains_the_points_of_its_disc_up_to_whole_turns():
    t = np.linspace(0, 2 * np.pi, 2001)[:-1]
    disc = Outline(np.column_stack([np.cos(t) + 2 * np.pi, np.sin(t)]), 1, 1, stable=False)
    points = np.random.default_rng(7).uniform(-1.5, 1.5, (4000, 2))
    radius = np.linalg.norm(points, axis=1)
    clear = np.abs(radius - 1) > 1e-5
    for turns in (-3, 0, 1):
        assert np.array_equal(disc.contains(points + np.array([2 * np.pi * turns, 0.0]))[clear], radius[clear] < 1)


def test_states_have_the_tubes_section_energy_and_direction(tubes, states):
    points = points_within(tubes.outlines, 24)
    assert len(points) == len(states) > 20
    assert np.abs(tubes.system.numeric.hamiltonian(states) - tubes.orbit.energy).max() < ENERGY
    assert np.abs(np.sin(tubes.section.height(states) / 2)).max() < 1e-14
    assert np.abs(section_points(tubes.system, tubes.section, states) - points).max() < 1e-12
    assert np.all(tubes.system.numeric.rate(states) @ np.asarray(tubes.section.normal) > 0)


@pytest.mark.parametrize("sign", [1, -1])
def test_states_inside_both_tubes_pass_the_bottleneck_before_and_after(tubes, states, sign):
    (back,) = returns_of(tubes.orbit, tubes.section, states, sign=sign, count=1)
    assert len(back.start) == len(states)
    turned = (back.states - states[back.start])[:, tubes.turning] / (2 * np.pi)
    assert np.mean(np.abs(np.abs(turned) - 1) > 1e-9) < NEAR_CUT


def test_states_outside_the_unstable_tube_have_not_passed_the_bottleneck(tubes):
    """Points just outside the cut come from the same well, so the turning angle makes no turn."""
    vertices = tubes.unstable.vertices
    ring = vertices.mean(axis=0) + 1.03 * (vertices[::5] - vertices.mean(axis=0))
    states = tubes.states(ring[~tubes.unstable.contains(ring)])
    (back,) = returns_of(tubes.orbit, tubes.section, states, sign=-1, count=1)
    assert len(back.start) == len(states) > 5
    assert np.abs((back.states - states)[:, tubes.turning]).max() < 1e-9


def test_returns_agree_with_an_independent_integration(tubes, states):
    f, p = quick_rate(tubes.system.equations), tubes.system.parameters
    chosen = states[:: max(1, len(states) // 6)]
    for sign in (1, -1):
        (back,) = returns_of(tubes.orbit, tubes.section, chosen, sign=sign, count=1)
        for start, state, seconds in zip(chosen[back.start], back.states, back.seconds, strict=True):
            dense = solve_ivp(
                lambda _, x: np.array(f(x, [], p)).ravel(),
                (0, sign * (seconds + 0.05)), start, "DOP853", rtol=1e-12, atol=1e-12, dense_output=True,
            ).sol  # fmt: skip
            assert np.abs(dense(sign * seconds) - state).max() < DOP853
            # There is no crossing in between.
            path = np.sin(dense(sign * np.linspace(1e-4, seconds - 1e-4, 4000))[tubes.turning] / 2)
            assert np.all(np.sign(path) == np.sign(path[0]))


@pytest.mark.parametrize(
    ("saddle", "energy", "state"),
    [
        ("down-up", -0.06985, (0.0, 0.0, -13.01598498635436, 21.243853523780334)),
        ("up-down", 0.2, (0.0, 0.0, 20.70428441172521, -20.03102661145952)),
    ],
    ids=str,
)
def test_the_reference_rotating_orbits_lie_inside_both_tubes(saddle, energy, state):
    tubes = Inside(saddle, energy)
    point = section_points(tubes.system, tubes.section, np.array([state]))
    for stable in (False, True):
        assert any(o.contains(point)[0] for o in tubes.outlines if o.stable is stable and o.direction == 1)


@pytest.mark.slow
def test_the_area_of_a_cut_is_the_action_of_its_orbit():
    """By Stokes' theorem, the cut encloses ∮ p dq of its orbit on any section."""
    tubes = Inside("down-up", -0.07, chord=0.005)
    x, y = tubes.unstable.vertices.T
    area = abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2 * momentum_scale(tubes.system, tubes.section)
    along = tubes.system.propagator.sample(tubes.orbit.state, np.linspace(0, tubes.orbit.period, 2001)[:-1])
    power = np.sum(tubes.system.numeric.momentum(along) * tubes.system.numeric.rate(along)[:, :2], axis=1)
    assert area == pytest.approx(np.mean(power) * tubes.orbit.period, rel=1e-4)
