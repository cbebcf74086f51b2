"""The curves of the paper's figures agree with independent numbers."""

import numpy as np
import pytest
from matplotlib.colors import to_hex

from dpcontrol.cli.charts import FIGURES as NAMES
from dpcontrol.orbits.cut import section_points, tube_cut
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.pages import figures, gallery, style
from dpcontrol.pages.paper import up_up, wheels
from dpcontrol.pages.paper.cuts import CUT_ENERGIES, cuts_page
from dpcontrol.pages.paper.heteroclinic_orbits import heteroclinic_orbits_page
from dpcontrol.pages.paper.landscapes import landscape_page
from dpcontrol.pages.paper.lyapunov_orbits import lyapunov_orbits_page
from dpcontrol.pages.paper.returning import returning_search
from dpcontrol.pages.paper.senses import senses_page
from dpcontrol.pages.paper.shadowing import shadowing_page
from dpcontrol.pages.paper.three_body import three_body_homoclinics_page, three_body_page
from dpcontrol.plans.atlas import AtlasSettings, make_atlas
from dpcontrol.plans.model import load_model

ROUNDING = 1e-9


@pytest.fixture(scope="module")
def shown():
    return gallery.Gallery(
        system=lambda name: load_model(name).system,
        atlas=lambda name, energy, hits: make_atlas(load_model(name), energy, settings=AtlasSettings(hits=hits)).atlas,
        branches=lambda *_: pytest.fail("no sweep is needed here"),
    )


def drawn(axes, colour):
    """Return the curves of a colour in a panel, of two or three dimensions."""
    lines = [line for line in axes.lines if to_hex(line.get_color()) == to_hex(colour)]
    return [np.array(line.get_data_3d() if axes.name == "3d" else line.get_data()).T for line in lines]


def dots(axes):
    return sum(line.get_marker() == "o" for line in axes.lines)


def curves(axes):
    """Return all long curves of a flat panel, (K, 2) each, with their line styles."""
    found = [(np.array(line.get_data()).T, line.get_linestyle(), to_hex(line.get_color())) for line in axes.lines]
    return [one for one in found if len(one[0]) > 100]


def test_the_verb_names_the_figures_in_their_order():
    assert list(figures.FIGURES) == list(NAMES)


@pytest.mark.slow
def test_landscapes_mark_every_critical_point_by_whether_it_is_reached(shown):
    page = landscape_page(shown)
    flat = [axes for axes in page.figure.axes if axes.name != "3d"]
    assert len(flat) == 8
    for axes, reached in zip(flat[:4], (0, 1, 2, 3), strict=True):
        marks = [line for line in axes.lines if str(line.get_marker()) in ("s", "o", "^")]
        assert len(marks) == 5  # L1 to L5
        assert sum(line.get_color() != style.LIMIT for line in marks) == reached
    # Of unit distance from both primaries: -(1/2 + 1).
    assert "L4 -1.5000" in page.caption


@pytest.mark.slow
def test_three_bodies_have_flights_from_each_point_to_itself(shown):
    page = three_body_homoclinics_page(shown)
    above, cuts, flights = page.figure.axes[:3]
    assert drawn(above, style.UNSTABLE)
    assert drawn(above, style.STABLE)
    assert dots(cuts) == 4
    found = [one for one in curves(flights) if one[2] in map(to_hex, style.CONNECTIONS)]
    assert sorted(way for _, way, _ in found) == ["-", "-", "--"]
    # Symmetric ones are their own images under y -> -y.
    for curve in (curve for curve, way, _ in found if way == "-"):
        assert curve[:, 1].max() == pytest.approx(-curve[:, 1].min(), abs=1e-3)
    assert "L1 to L1: at -1.5185 at least 4 connections (2 symmetric)" in page.caption


@pytest.mark.slow
def test_three_bodies_have_flights_both_ways_that_are_mirror_images(shown):
    page = three_body_page(shown)
    there, back = (max((c for c, *_ in curves(page.figure.axes[k])), key=len) for k in (2, 5))
    assert there[:, 1].min() == pytest.approx(-back[:, 1].max(), abs=1e-6)


def test_lyapunov_orbits_close_in_both_arms_planes(shown):
    page = lyapunov_orbits_page(shown)
    system = load_model("lab").system
    for row, saddle in enumerate(("down-up", "up-down")):
        for arm in (0, 1):
            axes = page.figure.axes[3 * row + arm]
            orbits = [curve for curve, *_ in curves(axes)]
            assert len(orbits) == 5
            for curve in orbits:
                assert curve[0] == pytest.approx(curve[-1], abs=1e-6)
                assert np.ptp(curve[:, 0]) > 0.01
            middle = np.mean([curve[:, 0].mean() for curve in orbits])
            assert middle == pytest.approx(system.equilibria[saddle][arm], abs=0.02)


@pytest.mark.parametrize(("saddle", "arm", "count"), [("down-up", 1, 7), ("up-down", 0, 4)])
def test_either_sense_has_tubes_that_turn_that_way(saddle, arm, count, shown):
    page = senses_page(shown, saddle=saddle)
    spaces, cuts = ([a for a in page.figure.axes if (a.name == "3d") is space] for space in (True, False))
    start = load_model("lab").system.equilibria[saddle][arm]
    for space, axes, sense in zip(spaces, cuts, (1, -1), strict=True):
        leaving = drawn(space, style.UNSTABLE) + drawn(space, style.PALE_UNSTABLE)
        coming = drawn(space, style.STABLE) + drawn(space, style.PALE_STABLE)
        assert len(leaving) == len(coming) >= 20
        ends = np.array([curve[np.argmax(np.abs(curve[:, arm] - start)), arm] for curve in leaving]) - start
        assert (np.sign(ends) == sense).mean() > 0.9
        assert dots(axes) == count


@pytest.mark.slow
def test_cuts_at_six_energies_have_the_connections_of_their_searches(shown):
    page = cuts_page(shown)
    system = load_model("lab").system
    assert [dots(axes) for axes in page.figure.axes] == [0, 8, 8, 10, 10, 14]
    for axes, energy in zip(page.figure.axes, CUT_ENERGIES, strict=True):
        assert f"{energy:g} J" in axes.get_title(loc="left")
        # The accessible part of the section bounds the inner arm's angle: V(θ₁, 0) = H.
        widest = max(np.abs(curve[:, 0]).max() for curve in drawn(axes, style.UNSTABLE))
        lowest = float(system.numeric.hamiltonian(np.array([widest, 0.0, 0.0, 0.0])))
        assert lowest <= energy


@pytest.mark.slow
def test_wheels_hold_points_of_both_tubes_and_the_orbits_that_stay(shown):
    """An independent check of staying: three laps of a periodic orbit end where it began."""
    page = wheels.wheels_page(shown, saddle="down-up")
    panels = page.figure.axes
    assert len(panels) == 10  # the start and three returns, forward and backward; two phase planes
    stars = [line.get_data() for line in panels[0].lines if line.get_marker() == "*"]
    assert stars
    assert "return 1 forward: 100%" in " ".join(panels[1].get_title(loc="left").split())
    system = load_model("lab").system
    section = system.sections["down-up", "down-up"]
    orbit = lyapunov_orbit(system, "down-up", energy=wheels.WHEEL_ENERGIES["down-up"])
    manifold = UnstableManifold(orbit)
    outlines = wheels.outlines_of(tube_cut(manifold, section), manifold)
    kept = wheels.kept_inside(orbit, section, outlines)
    assert len(kept) == len(stars)
    for one in kept:
        assert section_points(system, section, one.state)[0] == pytest.approx(0.0, abs=ROUNDING)
        later = system.propagator.flow(one.state, one.period)
        assert later - one.state == pytest.approx([0.0, 2 * np.pi, 0.0, 0.0], abs=1e-7)


def test_heteroclinic_orbits_lead_from_one_orbit_to_the_other(shown):
    page = heteroclinic_orbits_page(shown)
    for space, (source, target) in zip(page.figure.axes, (("down-up", "up-down"), ("up-down", "down-up")), strict=True):
        (leaves,) = drawn(space, style.saddle_colour(source))
        joined = np.vstack(drawn(space, style.saddle_colour(target)))
        flights = [f for colour in style.CONNECTIONS[:2] for f in drawn(space, colour) if len(f) > 100]
        assert len(flights) == 2
        for flight in flights:
            for end, orbit in ((flight[0], leaves), (flight[-1], joined)):
                assert np.abs((orbit - end) / (np.pi, np.pi, 10)).max(axis=1).min() < 0.02


@pytest.mark.slow
def test_an_orbit_is_shadowed_twice_and_for_ever(shown):
    page = shadowing_page(shown)
    below = page.figure.axes[3:]
    turns = []
    for axes in below:
        (outer,) = drawn(axes, style.arm_colour(1))
        turns.append(round((outer[-1, 1] - outer[0, 1]) / (2 * np.pi)))
    assert turns == [1, 2, 1]
    (inner,), (outer,) = (drawn(below[2], style.arm_colour(arm)) for arm in (0, 1))
    assert inner[0, 1] == pytest.approx(inner[-1, 1], abs=1e-6)
    assert outer[-1, 1] - outer[0, 1] == pytest.approx(2 * np.pi, abs=1e-6)


@pytest.mark.slow
def test_returning_orbits_cross_the_aligned_section_twice_in_opposite_ways():
    search = returning_search(load_model("lab").system)
    back = [c for c in search.connections if not any(c.winding)]
    assert len(back) == 8
    for c in back:
        times = np.linspace(-c.time_out, c.time_in, 4000)
        states = c.orbit.sample(times)
        sheet = np.floor((states[:, 0] - states[:, 1]) / (2 * np.pi))
        steps = np.diff(sheet)[np.diff(sheet) != 0]
        assert sorted(steps) == [-1, 1]


def test_points_of_up_ups_manifold_lie_on_its_energy_and_come_from_it():
    system = load_model("lab").system
    states, top = up_up.up_up_states(system), system.equilibria["up-up"]
    assert len(states) > 0.9 * up_up._SEEDS
    # Seeds are off the energy by the square of their distance.
    assert np.abs(system.numeric.hamiltonian(states) - system.numeric.hamiltonian(top)).max() < 1e-9
    for state in states[::600]:
        flown = system.propagator.sample(state, -np.linspace(0.0, 4.0, 4000))
        assert system.scaled_distance(flown, top).min() < 1e-3
    # The manifold is its own image under (θ, ω) -> (-θ, -ω).
    for image in -states[::200]:
        assert system.scaled_distance(states, image).min() < 0.05


@pytest.mark.parametrize("name", ["double-homoclinics", "triple-homoclinics"])
@pytest.mark.slow
def test_repeated_homoclinics_turn_the_outer_arm_so_often(name, shown):
    turns = 2 if name.startswith("double") else 3
    page = figures.FIGURES[name](shown)
    below = [axes for axes in page.figure.axes if "against time" in axes.get_title(loc="left")]
    assert below
    for axes in below:
        (outer,) = drawn(axes, style.arm_colour(1))
        assert round((outer[-1, 1] - outer[0, 1]) / (2 * np.pi)) == turns
