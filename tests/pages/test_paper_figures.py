"""The curves of the paper's figures agree with independent numbers."""

import numpy as np
import pytest

from dpcontrol.orbits.cut import section_points, tube_cut
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.pages import gallery
from dpcontrol.pages.paper import up_up, wheels
from dpcontrol.pages.paper.returning import returning_search
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


@pytest.mark.slow
def test_wheels_hold_points_of_both_tubes_and_the_orbits_that_stay(shown):
    """An independent check of staying: three laps of a periodic orbit end where it began."""
    page = wheels.wheels_page(shown, saddle="down-up")
    panels = page.figure.axes
    assert len(panels) == 10  # the start and three returns, forward and backward; two phase planes
    stars = [line.get_data() for line in panels[0].lines if line.get_marker() == "*"]
    assert stars
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
