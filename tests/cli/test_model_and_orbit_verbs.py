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


def test_tables_for_people_name_every_parameter_equilibrium_and_source() -> None:
    shown = dpcontrol("model", "lab")
    assert shown.code == 0
    for text in (*UNITS, *KINDS, "EstimatedParameters_DoublePendulum.mat"):
        assert text in shown.stdout
    orbit = dpcontrol("orbit", "lab", "--saddle", "down-up", "--energy", "-0.07").stdout
    assert "0.75238002849288" in orbit
    assert "533.89333705  1  1" in orbit
