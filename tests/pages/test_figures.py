"""Figures of the paper and recordings of an atlas, written whole; their curves agree with independent numbers."""

import re

import numpy as np
import pytest

from dpcontrol.pages.atlas import connections_of, kind_of, stable_direction, write_atlas_recording
from dpcontrol.pages.paper import equilibria
from dpcontrol.plans.atlas import AtlasSettings, compute_atlas
from dpcontrol.plans.model import load_model
from tests.pages.test_recording import rerun


@pytest.fixture(scope="module")
def low():
    return compute_atlas(load_model("lab"), -0.07, settings=AtlasSettings())


def test_connections_lie_on_cuts_crossed_in_the_same_direction(low):
    kind = kind_of(low, "down-up", "down-up")
    cut = low.cut("down-up", kind.section, 1)
    for c in connections_of(low, kind):
        on = [
            {sign(p) for p in cut.pieces if np.linalg.norm(points(p) - c.point, axis=1).min() < 0.05}
            for points, sign in (
                (lambda p: p.points, lambda p: p.direction),
                (lambda p: p.stable_points, lambda p: stable_direction(low, cut, p.direction)),
            )
        ]
        assert on[0] & on[1]


def test_the_recording_of_an_atlas_is_verified_by_the_viewers_own_tool_and_holds_everything(low, tmp_path):
    write_atlas_recording(low, tmp_path / "a.rrd")
    rerun("rrd", "verify", str(tmp_path / "a.rrd"))
    held = rerun("rrd", "print", str(tmp_path / "a.rrd"))
    for path in ("/space/orbits/down_up", "/space/tubes/down_up/hit_1", "/space/connections/down_up_to_down_up_1_1"):
        assert path in held
    assert len(set(re.findall(r"/space/connections/\w+/\w+", held))) == len(low.connections)


def test_points_of_up_ups_manifold_lie_on_its_energy_and_come_from_it():
    system = load_model("lab").system
    states, top = equilibria.up_up_states(system), system.equilibria["up-up"]
    assert len(states) > 5_000
    # Seeds are off the energy by the square of their distance.
    assert np.abs(system.numeric.hamiltonian(states) - system.numeric.hamiltonian(top)).max() < 1e-9
    for state in states[::600]:
        flown = system.propagator.sample(state, -np.linspace(0.0, 4.0, 4000))
        assert system.scaled_distance(flown, top).min() < 1e-3
    # The manifold is its own image under (θ, ω) -> (-θ, -ω).
    for image in -states[::200]:
        assert system.scaled_distance(states, image).min() < 0.05
