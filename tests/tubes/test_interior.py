"""The interior of tubes, compared with scipy's integration, transit and time reversal."""

import numpy as np
import pytest
from quick_rate import quick_rate
from scipy.integrate import solve_ivp

from dpcontrol.dynamics.system import momentum_scale
from dpcontrol.foundation.errors import InputError
from dpcontrol.orbits.cut import CutSettings, section_points, tube_cut
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.pages.interior import draw_interior
from dpcontrol.pages.layout import save_figure
from dpcontrol.plans.model import load_model
from dpcontrol.tubes.interior import (
    InteriorSettings,
    inside,
    labels,
    outlines_of,
    section_states,
    tube_interior,
)

ENERGY = 1e-14  # J: states solve the energy equation directly
NEAR_CUT = 0.01  # share of points within the error of the cut's chords
DOP853 = 1e-7  # error of scipy's DOP853 at 1e-12 until the first return

TURNING = {"down-up": 1, "up-down": 0}
"""Index of the angle that turns on passage of each saddle's bottleneck."""


def cut_of(saddle, energy, chord=0.02):
    system = load_model("lab").system
    manifold = UnstableManifold(lyapunov_orbit(system, saddle, energy=energy))
    return manifold, tube_cut(manifold, system.sections[saddle, saddle], settings=CutSettings(chord=chord))


@pytest.fixture(scope="module", params=[("down-up", -0.07), ("up-down", 0.2)], ids=str)
def carried(request):
    manifold, cut = cut_of(*request.param)
    return tube_interior(manifold, cut, settings=InteriorSettings(across=24, returns=2))


def test_a_polygon_contains_the_points_of_its_disc():
    t = np.linspace(0, 2 * np.pi, 2001)[:-1]
    vertices = np.column_stack([np.cos(t), np.sin(t)])
    points = np.random.default_rng(7).uniform(-1.5, 1.5, (4000, 2))
    radius = np.linalg.norm(points, axis=1)
    clear = np.abs(radius - 1) > 1e-5
    assert np.array_equal(inside(points, vertices)[clear], radius[clear] < 1)


def test_states_have_the_tubes_section_energy_and_direction(carried):
    system, section = carried.orbit.system, carried.section
    assert len(carried.points) > 50
    assert np.abs(system.numeric.hamiltonian(carried.states) - carried.orbit.energy).max() < ENERGY
    assert np.abs(np.sin(section.height(carried.states) / 2)).max() < 1e-14
    assert np.abs(section_points(system, section, carried.states) - carried.points).max() < 1e-12
    assert np.all(system.numeric.rate(carried.states) @ np.asarray(section.normal) > 0)


def test_states_inside_the_unstable_tube_have_passed_the_bottleneck(carried):
    turning = TURNING[carried.orbit.saddle]
    assert np.all(carried.backward.arrived[:, 0])
    passed = carried.backward.winding[:, 0, turning] == -1
    assert np.mean(~passed) < NEAR_CUT


def test_states_outside_the_unstable_tube_have_not_passed_the_bottleneck(carried):
    """Points just outside the cut come from the same well, so the turning angle makes no turn."""
    system, section = carried.orbit.system, carried.section
    outline = next(o for o in carried.outlines if o.branch == 1 and not o.stable)
    centre = carried.points[np.argmin(carried.radius)]
    ring = centre + 1.03 * (outline.vertices[::5] - centre)
    ring = ring[~inside(ring, outline.vertices)]
    level = float(np.round(section.height(carried.states[0]) / (2 * np.pi))) * 2 * np.pi
    states, fits = section_states(system, section, ring, energy=carried.orbit.energy, direction=1, level=level)
    turning = TURNING[carried.orbit.saddle]
    for state in states[fits]:
        before = system.propagator.crossing(system.propagator.flow(state, -1e-6), section, longest=-10.0)
        assert before is not None
        assert abs(before.state[turning] - state[turning]) < 1e-9
    assert np.count_nonzero(fits) > 5


def test_states_inside_the_stable_tube_pass_the_bottleneck_next(carried):
    turning = TURNING[carried.orbit.saddle]
    passes = np.abs(carried.forward.winding[:, 0, turning]) == 1
    system, section = carried.orbit.system, carried.section
    own = next(o for o in carried.outlines if o.branch == carried.branch and not o.stable)
    stable = tuple(o for o in carried.outlines if o.stable)
    in_stable = labels(system, section, stable, carried.points, np.full(len(passes), own.direction))
    assert np.mean(passes != (in_stable != 0)) < NEAR_CUT
    assert 0.1 < np.mean(passes) < 0.9


def test_one_return_earlier_the_unstable_interior_fills_the_stable_one(carried):
    assert np.mean(carried.backward.in_stable[:, 0] != 0) > 1 - NEAR_CUT


def test_returns_agree_with_an_independent_integration(carried):
    system = carried.orbit.system
    f, p, turning = quick_rate(system.equations), system.parameters, TURNING[carried.orbit.saddle]

    def rate(t, x):
        return np.array(f(x, [], p)).ravel()

    for k in range(0, len(carried.points), max(1, len(carried.points) // 6)):
        for run, sign in ((carried.forward, 1), (carried.backward, -1)):
            start, seconds = carried.states[k], run.seconds[k, 0]
            dense = solve_ivp(
                rate, (0, sign * (seconds + 0.05)), start, "DOP853", rtol=1e-12, atol=1e-12, dense_output=True
            ).sol
            assert np.abs(dense(sign * seconds) - run.states[k, 0]).max() < DOP853
            # There is no crossing in between.
            path = np.sin(dense(sign * np.linspace(1e-4, seconds - 1e-4, 4000))[turning] / 2)
            assert np.all(np.sign(path) == np.sign(path[0]))


def test_angle_and_radius_form_a_colour_wheel(carried):
    assert carried.radius.min() == 0
    assert 0.9 < carried.radius.max() <= 1
    assert np.all((carried.angle >= 0) & (carried.angle < 2 * np.pi))
    assert len(np.unique(np.floor(carried.angle / (np.pi / 4)))) == 8


@pytest.mark.parametrize(
    ("saddle", "energy", "state"),
    [
        ("down-up", -0.06985, (0.0, 0.0, -13.01598498635436, 21.243853523780334)),
        ("up-down", 0.2, (0.0, 0.0, 20.70428441172521, -20.03102661145952)),
    ],
    ids=str,
)
def test_the_reference_rotating_orbits_lie_inside_both_tubes(saddle, energy, state):
    manifold, cut = cut_of(saddle, energy)
    system = manifold.orbit.system
    points, outlines = section_points(system, cut.section, np.array([state])), outlines_of(cut, manifold)
    for stable in (False, True):
        own = tuple(o for o in outlines if o.stable is stable)
        assert labels(system, cut.section, own, points, np.array([1]))[0] != 0


@pytest.mark.slow
def test_the_area_of_a_cut_is_the_action_of_its_orbit():
    """By Stokes' theorem, the cut encloses ∮ p dq of its orbit on any section."""
    manifold, cut = cut_of("down-up", -0.07, chord=0.005)
    system, orbit = manifold.orbit.system, manifold.orbit
    outline = next(o for o in outlines_of(cut, manifold) if o.branch == 1 and not o.stable)
    x, y = outline.vertices.T
    area = abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2 * momentum_scale(system, cut.section)
    states = system.propagator.sample(orbit.state, np.linspace(0, orbit.period, 2001)[:-1])
    power = np.sum(system.numeric.momentum(states) * system.numeric.rate(states)[:, :2], axis=1)
    action = np.mean(power) * orbit.period
    assert area == pytest.approx(action, rel=1e-4)


def test_an_open_cut_is_refused_with_the_reason():
    with pytest.raises(InputError, match=r"no closed cut.*grazes"):
        tube_interior(*cut_of("down-up", 0.2))


def test_impossible_branches_are_refused():
    manifold, cut = cut_of("down-up", -0.07, chord=0.2)
    with pytest.raises(InputError, match=r"must be \+1 or -1"):
        tube_interior(manifold, cut, branch=2)


def test_points_that_do_not_return_in_time_are_marked(carried):
    manifold, cut = cut_of(carried.orbit.saddle, carried.orbit.energy, chord=0.2)
    short = tube_interior(manifold, cut, settings=InteriorSettings(across=6, returns=2, longest=0.3))
    assert not short.forward.arrived.all()
    assert np.isfinite(short.forward.states).all()
    missing = ~short.forward.arrived
    assert np.all(short.forward.in_stable[missing] == 0)


@pytest.mark.slow
def test_a_figure_is_drawn(carried, tmp_path):
    save_figure(draw_interior(carried), tmp_path / "unstable.png")
    assert (tmp_path / "unstable.png").stat().st_size > 5_000
