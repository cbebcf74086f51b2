"""`dpcontrol model` and `dpcontrol orbit` against values computed independently."""

import numpy as np
import pytest
from command_line import dpcontrol
from independent_pendulum import PARAMETERS
from reference_values import LYAPUNOV_ORBITS, SQUARED_EIGENVALUES

EQUILIBRIUM_TOLERANCE = 1e-10
"""Relative; closed formulas, so only rounding of an eigenvalue problem of size four remains."""
PERIOD_TOLERANCE = 1e-10
MULTIPLIER_TOLERANCE = 1e-8
"""Relative; what shooting in double precision leaves, with room to spare."""
STATE_TOLERANCE = 1e-9
UNIT_PAIR_TOLERANCE = 1e-3
"""A double eigenvalue moves by the root of what its matrix is off by (1e-9 here), and by its neighbours' size."""
EFFORT = 0.02
"""Relative; the efforts compared with were given to two or three digits."""
EFFORTS = {("down-up", -0.07): 0.056, ("down-up", 0.2): 0.119, ("up-down", 0.2): 0.0095}
KINDS = {"down-down": "centre", "down-up": "index-1 saddle", "up-down": "index-1 saddle", "up-up": "index-2 saddle"}
UNITS = {
    **dict.fromkeys(("m1", "m2"), "kg"),
    **dict.fromkeys(("a1", "a2", "l1", "l2"), "m"),
    **dict.fromkeys(("J1", "J2"), "kg m^2"),
    "g": "m/s^2",
    **dict.fromkeys(("k1", "k2"), "N m s/rad"),
}


@pytest.mark.parametrize("model", ["lab", "printed"])
def test_parameters_are_the_sources_values_with_si_units(model: str) -> None:
    shown = dpcontrol("model", model, "--json").document["parameters"]
    assert {name: entry["unit"] for name, entry in shown.items()} == UNITS
    for name, value in PARAMETERS[model].items():
        assert shown[name]["value"] == value, name


@pytest.mark.parametrize("model", ["lab", "printed"])
def test_all_four_equilibria_have_the_independent_energies_and_eigenvalues(model: str) -> None:
    shown = dpcontrol("model", model, "--json").document["equilibria"]
    assert {name: entry["kind"] for name, entry in shown.items()} == KINDS
    for name, entry in shown.items():
        energy, *squares = SQUARED_EIGENVALUES[model, name]
        assert entry["energy"] == pytest.approx(energy, rel=EQUILIBRIUM_TOLERANCE)
        expected = [sign * np.sqrt(complex(s)) for s in squares for sign in (1, -1)]
        found = [complex(*pair) for pair in entry["eigenvalues"]]
        assert len(found) == 4
        for value in expected:
            assert min(abs(f - value) for f in found) <= EQUILIBRIUM_TOLERANCE * abs(value), (name, value)
        inner, outer = name.split("-")
        np.testing.assert_array_equal(entry["state"], [np.pi * (inner == "up"), np.pi * (outer == "up"), 0, 0])


@pytest.mark.parametrize(("model", "saddle", "energy"), list(LYAPUNOV_ORBITS))
def test_an_orbit_has_the_independent_state_period_and_multiplier_and_closes(
    model: str, saddle: str, energy: float
) -> None:
    state, period, multiplier, _ = LYAPUNOV_ORBITS[model, saddle, energy]
    shown = dpcontrol("orbit", model, "--saddle", saddle, "--energy", str(energy), "--json").document
    assert shown["energy"] == energy
    assert shown["period"] == pytest.approx(period, rel=PERIOD_TOLERANCE)
    np.testing.assert_allclose(shown["state"], state, rtol=0, atol=STATE_TOLERANCE)
    assert shown["residual"] <= 5e-14 * multiplier * (1 + np.abs(state).max())
    assert "converged" in shown["status"]
    values = sorted((complex(*pair) for pair in shown["floquet_multipliers"]), key=abs)
    assert values[3].real == pytest.approx(multiplier, rel=MULTIPLIER_TOLERANCE)
    assert values[0].real == pytest.approx(1 / multiplier, rel=MULTIPLIER_TOLERANCE)
    for value in (values[1], values[2]):
        assert abs(value - 1) <= UNIT_PAIR_TOLERANCE


@pytest.mark.parametrize(("saddle", "energy"), EFFORTS)
def test_a_sustained_orbit_is_near_its_lyapunov_orbit_at_the_known_effort(saddle: str, energy: float) -> None:
    state, period, multiplier, _ = LYAPUNOV_ORBITS["lab", saddle, energy]
    ended = dpcontrol("orbit", "lab", "--saddle", saddle, "--energy", str(energy), "--sustained", "--json")
    assert ended.code == 0
    shown = ended.document
    assert shown["converged"] is True
    assert shown["u_rms"] == pytest.approx(EFFORTS[saddle, energy], rel=EFFORT)
    assert 0 < shown["error_between_nodes"] <= shown["residual"] <= 1e-9
    assert shown["period"] == pytest.approx(period, rel=1e-3)
    np.testing.assert_allclose(shown["state"][:4], state, rtol=0, atol=0.02)
    assert 0 < max(map(abs, shown["state"][4:])) <= shown["max_cart_position"] < 0.01
    for key, count in (("multipliers", 6), ("section_multipliers", 5)):
        values = [complex(*pair) for pair in shown[key]]
        assert len(values) == count
        assert abs(values[0]) == pytest.approx(multiplier, rel=0.05)
        assert abs(values[-1]) == pytest.approx(1 / multiplier, rel=0.1)
        assert sum(abs(v - 1) < 1e-9 for v in values) == 2
