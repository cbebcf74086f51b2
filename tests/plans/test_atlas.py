"""The atlas: everything of an energy, each thing once, in a file that comes back whole or is refused."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from quick_rate import flown_by_scipy

from dpcontrol.plans.atlas import AtlasSettings, compute_atlas, load_atlas, save_atlas
from dpcontrol.plans.model import load_model
from dpcontrol.tubes.connections import can_be_reversed, find_connections, orbits_between, reversed_search
from dpcontrol.walks.atlas import Atlas

STATE = 1e-9  # the bar for states; what is reached is about 1e-12
FLIGHT = 1e-6  # scipy over at most a second and a half, errors growing e-fold each tenth of one, from rtol 1e-12
REVERSED = 1e-9  # a search and the image of the opposite one are two computations of one thing
APPROACH = 1e-5  # s and phase: the first approach is located on a distance with kinks


@pytest.fixture(scope="module")
def high(lab):
    return compute_atlas(lab, 0.2, settings=AtlasSettings())


@pytest.fixture(scope="module")
def low(lab):
    return compute_atlas(lab, -0.07, settings=AtlasSettings())


def test_below_up_downs_energy_there_are_only_down_ups_homoclinics_with_the_reason(low):
    assert [(k.source, k.target) for k in low.kinds] == [("down-up", "down-up")]
    assert len(low.connections) == 8
    assert low.complete
    assert [saddle for saddle, _ in low.absent] == ["up-down"]
    assert "exist only above its energy of 0.175429746" in low.status


@pytest.mark.slow
def test_flights_pass_the_section_at_time_zero_and_follow_the_equations(lab, high):
    for c in high.connections:
        for seconds in (-0.7 * c.time_out, 0.0, c.time_in):
            k = int(np.searchsorted(c.times, seconds))
            assert np.abs(flown_by_scipy(lab.system, c.state, c.times[k]) - c.states[k]).max() < FLIGHT
        assert c.times[0] < -c.time_out
        assert c.times[-1] > c.time_in


@pytest.mark.slow
def test_strands_of_a_tube_end_on_its_cut(high):
    for cut in high.cuts:
        points = np.concatenate([piece.states for piece in cut.pieces])
        for strand in cut.strands:
            assert abs(np.sin(strand[-1] @ np.asarray(cut.section.normal) / 2)) < STATE
            # Strands are computed again from new seeds, whose rounding the tube magnifies.
            assert min(np.abs(points - strand[-1]).max(axis=1)) < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "pair", "energy", "hits"),
    [
        ("lab", ("down-up", "up-down"), 0.2, (1, 2)),
        ("lab", ("down-up", "down-up"), -0.07, (1, 1)),
        ("three-body", ("L1", "L2"), -1.5175, (2, 2)),
    ],
    ids=lambda value: str(value),
)
def test_a_search_the_other_way_finds_the_images_under_time_reversal(name, pair, energy, hits):
    system = load_model(name).system
    assert can_be_reversed(system, *pair)
    orbits = orbits_between(system, *pair, energy)
    images = reversed_search(find_connections(*orbits, hits=hits)).connections
    direct = find_connections(orbits[1], orbits[0], hits=hits[::-1]).connections
    assert len(direct) == len(images) > 0
    assert [c.name for c in images] == [c.name for c in direct]
    for image, c in zip(images, direct, strict=True):
        assert np.abs(image.state - c.state).max() < REVERSED
        assert (image.winding, image.sense, image.symmetric, image.hits) == (c.winding, c.sense, c.symmetric, c.hits)
        assert image.transversality_angle == pytest.approx(c.transversality_angle, abs=1e-6)
        assert image.time_out == pytest.approx(c.time_out, abs=APPROACH, nan_ok=True)
        assert image.time_in == pytest.approx(c.time_in, abs=APPROACH, nan_ok=True)
        for mine, other in ((image.phase_out, c.phase_out), (image.phase_in, c.phase_in)):
            if np.isfinite(other):
                assert abs((mine - other + 0.5) % 1 - 0.5) < APPROACH
        times = np.linspace(-0.5, 0.5, 11)
        assert np.abs(image.orbit.sample(times) - c.orbit.sample(times)).max() < 10 * REVERSED


@pytest.mark.slow
def test_if_first_hits_are_empty_the_next_are_searched_and_both_reported():
    """L1 → L2 on x = 1 - μ: both tubes pass it once before they can meet."""
    found = compute_atlas(load_model("three-body"), -1.5175, settings=AtlasSettings())
    hits = [(k.hits, k.count) for k in found.kinds if (k.source, k.target) == ("L1", "L2")]
    assert hits[0] == ((1, 1), 0)
    assert hits[1][0] == (2, 2)
    assert hits[1][1] > 0
    assert "L1 → L2 is empty at first hits and has its first connections at [2, 2]" in found.status
    assert not found.complete
    assert all(k.open_ends for k in found.kinds if not k.complete)


def test_a_model_without_sections_has_orbits_of_every_family_and_no_connections():
    found = compute_atlas(load_model("triple"), 0.3, settings=AtlasSettings())
    assert {(o.saddle, o.family) for o in found.orbits} == {
        (s, f) for s in ("down-down-up", "down-up-down", "up-down-down") for f in (0, 1)
    }
    assert not found.connections
    assert "no sections" in found.status


def same(first, second):
    """Compare records field by field, arrays bit for bit."""
    if is_dataclass(first):
        return type(first) is type(second) and all(
            same(getattr(first, f.name), getattr(second, f.name)) for f in fields(first)
        )
    if isinstance(first, np.ndarray):
        return np.array_equal(first, second, equal_nan=True)
    if isinstance(first, tuple):
        return len(first) == len(second) and all(map(same, first, second))
    return first == second or (first != first and second != second)


def test_an_atlas_comes_back_from_its_file_bit_for_bit(low, tmp_path):
    endless = replace(low.connections[0], time_out=float("nan"))
    stored = replace(low, connections=(endless, *low.connections[1:]))
    save_atlas(tmp_path / "a.npz", stored)
    back = load_atlas(tmp_path / "a.npz")
    for field in fields(Atlas):
        assert same(getattr(back, field.name), getattr(stored, field.name)), field.name
