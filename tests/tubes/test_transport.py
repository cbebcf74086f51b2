"""Rates of passage through necks, against cuts of tubes and against counted passages."""

import json

import numpy as np
import pytest

import dpcontrol as dp
from dpcontrol.foundation.causes import TransportCause
from dpcontrol.plans.atlas import load_atlas, save_atlas
from tests.independent_passages import TABLE, Arms, count_passages

AREA = 1e-3
"""Relative; the chords of a cut leave out up to 6e-4 of its area."""
VOLUME = 2e-4
"""Relative; the grid's cells leave errors of up to 5e-5."""
REPEATED = 1e-9
"""Relative; a repeated computation may use code with other rounding, which the flow along the tubes amplifies."""
LAB = [("down-up", -0.15), ("down-up", -0.12), ("down-up", -0.07), ("down-up", 0.0)]
LAB += [("up-down", 0.18), ("up-down", 0.2), ("up-down", 0.25)]
SIX = [("down-up", -0.12), ("down-up", -0.07), ("down-up", 0.0), ("down-up", 0.2), ("up-down", 0.23), ("up-down", 0.3)]


def quartic(**options):
    """Two wells of x⁴/4 - x²/2 beside a saddle at zero, with an oscillator across; the energy surface is closed."""

    def hamiltonian(q, p, c):
        (x, y), (px, py) = q, p
        return px**2 / 2 + py**2 / 2 + x**4 / 4 - x**2 / 2 + c["stiffness"] * y**2 / 2 + c["tilt"] * px

    return dp.System.from_hamiltonian(
        "quartic",
        hamiltonian,
        coordinates=("x", "y"),
        equilibria={"middle": (0.0, 0.0)},
        parameters={"stiffness": 2.0, "tilt": options.pop("tilt", 0.0)},
        **options,
    )


def closed_area(states, system, position, momentum):
    """Return the area of a closed cut in a coordinate and its momentum."""
    q, p = states @ position, system.numeric.momentum(states) @ momentum
    return abs(np.sum(q * np.roll(p, -1) - p * np.roll(q, -1))) / 2


@pytest.mark.parametrize(("saddle", "energy"), LAB)
def test_the_area_of_each_cut_of_a_tube_is_the_action_of_its_orbit(saddle: str, energy: float) -> None:
    orbit = dp.orbit("lab", saddle, energy=energy)
    action, free = dp.transport(orbit).action, int(saddle == "up-down")
    for stable in (False, True):
        cut = orbit.manifold(stable=stable).cut()
        areas = {piece.branch: 0.0 for piece in cut.pieces}
        assert len(areas) == 2
        for piece in cut.pieces:
            areas[piece.branch] += closed_area(piece.states, orbit.system, np.eye(4)[free], np.eye(2)[free])
        assert list(areas.values()) == pytest.approx([action, action], rel=AREA)


@pytest.mark.parametrize(("saddle", "energy", "branch"), [("L1", -1.519, -1), ("L1", -1.5195, -1), ("L2", -1.518, 1)])
def test_so_it_is_for_three_bodies_whose_momenta_differ_from_their_rates(saddle, energy, branch) -> None:
    orbit = dp.orbit("three-body", saddle, energy=energy)
    (piece,) = orbit.manifold(branch=branch).cut().pieces
    area = closed_area(piece.states, orbit.system, np.eye(4)[0], np.eye(2)[0])
    assert area == pytest.approx(dp.transport(orbit).action, rel=AREA)


@pytest.mark.parametrize(
    ("saddle", "energy"), [("down-up", -0.17), ("down-up", 0.0), ("down-up", 0.2), ("up-down", 0.2)]
)
def test_volumes_agree_with_a_sum_over_points_of_the_torus(saddle: str, energy: float) -> None:
    arms, sides = Arms(), (np.arange(6000) + 0.5) * 2 * np.pi / 6000
    volume = 0.0
    for angle in sides:
        mixed = arms.both * np.cos(angle - sides)
        allowed = arms.potential(np.stack([np.full_like(sides, angle), sides])) < energy
        volume += 2 * np.pi * np.sqrt(arms.inner * arms.outer - mixed**2)[allowed].sum() * (2 * np.pi / 6000) ** 2
    assert dp.transport(dp.orbit("lab", saddle, energy=energy)).volume == pytest.approx(volume, rel=VOLUME)


def test_both_open_necks_belong_to_one_energy_surface() -> None:
    inner, outer = (dp.transport(dp.orbit("lab", saddle, energy=0.2)) for saddle in ("up-down", "down-up"))
    assert inner.volume == pytest.approx(outer.volume, rel=VOLUME)
    assert inner.mean_time / outer.mean_time == pytest.approx(outer.action / inner.action, rel=VOLUME)


@pytest.mark.parametrize("reversed_roles", [False, True])
def test_a_system_of_ones_own_has_the_action_and_volume_of_its_formulas(reversed_roles: bool) -> None:
    energy, stiffness = 0.1, 2.0
    # The orbit about the saddle is x = 0 with the oscillator across: A = 2π E/ω.
    orbit = dp.orbit(quartic(tilt=0.3 * reversed_roles), "middle", energy=energy - 0.045 * reversed_roles)
    found = dp.transport(orbit)
    assert found.action == pytest.approx(2 * np.pi * energy / np.sqrt(stiffness), rel=1e-9)
    # With a tilt, motions with the rate zero have the momentum -tilt, and E is lower by tilt²/2.
    x = np.linspace(-1.6, 1.6, 400_001)
    height = np.sqrt(np.maximum(2 * (energy + x**2 / 2 - x**4 / 4) / stiffness, 0))
    assert found.volume == pytest.approx(2 * np.pi * 2 * np.trapezoid(height, x), rel=VOLUME)
    assert found.mean_time == pytest.approx(found.volume / found.action / 2)


def test_just_above_a_saddle_a_neck_narrower_than_the_cells_is_open() -> None:
    orbit = dp.orbit(quartic(), "middle", energy=1e-8)
    assert dp.transport(orbit).volume == pytest.approx(8 * np.pi * np.sqrt(2) / 3, rel=VOLUME)


def test_between_the_necks_of_three_bodies_the_volume_is_finite_and_above_both_it_is_not() -> None:
    closed, open_ = (dp.transport(dp.orbit("three-body", "L1", energy=energy)) for energy in (-1.5195, -1.519))
    assert closed.cause is TransportCause.FINITE
    assert open_.cause is TransportCause.UNBOUNDED
    assert (open_.volume, open_.mean_time, open_.converged) == (np.inf, np.inf, False)
    assert open_.document()["mean_time"] is None
    # 2π times the area inside: masses are one. The sum runs over points about the larger body, then the smaller one.
    mu = 9.537e-4
    x, y = np.meshgrid(np.linspace(-1.25, 1.25, 4001), np.linspace(-1.25, 1.25, 4001))
    first, second = np.hypot(x + mu, y), np.hypot(x - 1 + mu, y)
    potential = -((1 - mu) * first**2 + mu * second**2) / 2 - (1 - mu) / first - mu / second
    inside = (potential < -1.5195) & ((first < 0.97) | (second < 0.0687))
    assert closed.volume == pytest.approx(2 * np.pi * inside.sum() * (2.5 / 4000) ** 2, rel=2e-3)


def test_a_kinetic_energy_that_is_no_quadratic_form_is_a_cause() -> None:
    def hamiltonian(q, p, _):
        (x, y), (px, py) = q, p
        return px**2 / 2 + py**2 / 2 + px**4 + py**4 - x**2 / 2 + x**4 / 4 + y**2 / 2

    system = dp.System.from_hamiltonian("stiff", hamiltonian, coordinates=("x", "y"), equilibria={"middle": (0.0, 0.0)})
    found = dp.transport(dp.orbit(system, "middle", energy=0.1))
    assert found.cause is TransportCause.OTHER_KINETIC_ENERGY
    assert np.isnan(found.volume)
    assert found.action > 0


def test_an_open_cut_has_no_share_that_returns() -> None:
    assert dp.transport(dp.orbit("lab", "down-up", energy=0.2)).returns == (None, None)


def test_the_atlas_has_the_rates_of_its_orbits_also_when_it_is_read(tmp_path) -> None:
    atlas = dp.atlas("lab", energy=0.2)
    for saddle, found in zip(("down-up", "up-down"), atlas.transport, strict=True):
        expected = dp.transport(dp.orbit("lab", saddle, energy=0.2))
        assert (found.saddle, found.cause) == (saddle, expected.cause)
        numbers = [np.array([rates.action, rates.volume, *rates.returns], dtype=float) for rates in (found, expected)]
        assert numbers[0] == pytest.approx(numbers[1], rel=REPEATED, nan_ok=True)
    save_atlas(tmp_path / "atlas.npz", atlas)
    assert load_atlas(tmp_path / "atlas.npz").transport == atlas.transport


def test_the_counted_passages_of_the_figure_are_within_three_errors_of_the_rates() -> None:
    rows = json.loads(TABLE.read_text(encoding="utf-8"))
    away = [
        (dp.transport(dp.orbit("lab", row["saddle"], energy=row["energy"])).mean_time - row["mean_time"]) / row["error"]
        for row in rows
    ]
    assert np.abs(away).max() < 3
    assert np.mean(np.square(away)) < 2


@pytest.mark.slow
@pytest.mark.parametrize(("saddle", "energy"), SIX)
def test_mean_times_are_within_two_errors_of_passages_counted_over_the_microcanonical_ensemble(saddle, energy) -> None:
    found = dp.transport(dp.orbit("lab", saddle, energy=energy))
    counted = count_passages(saddle, energy, motions=8000, window=4.0, seed=6)
    assert counted.drift < 3e-4
    assert counted.error < 0.025 * counted.mean_time
    assert found.mean_time == pytest.approx(counted.mean_time, abs=2 * counted.error)
    for share in found.returns:
        assert share is None or share == pytest.approx(counted.again, abs=2 * counted.again_error + 2e-3)
