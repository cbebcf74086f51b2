"""Verbs of models, orbits, connections and plans against values computed independently."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from command_line import dpcontrol
from independent_pendulum import LETTERS, PARAMETERS, SADDLES, SCALE, flow, lyapunov_orbit
from reference_values import CONNECTIONS, LYAPUNOV_ORBITS

EFFORT = 0.02
"""Relative; the efforts compared with were given to two or three digits."""
EFFORTS = {("down-up", -0.07): 0.056, ("down-up", 0.2): 0.119, ("up-down", 0.2): 0.0095}
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
    arms = PARAMETERS[model]
    pairs = {f"{letter}{i + 1}": getattr(arms, name)[i] for letter, name in LETTERS.items() for i in range(2)}
    for name, value in (pairs | {"l1": arms.length[0], "g": arms.gravity}).items():
        assert shown[name]["value"] == value, name


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


APPROACH = (0.8e-3, 1.2e-3)
"""Flight times end at a scaled distance of 1e-3; the orbit's samples here are up to 3e-4 apart, and a flight's own
error of 1e-12 has grown by 1e3 at most."""

SEARCHES = list(CONNECTIONS)


@cache
def connections(source: str, target: str, energy: float) -> dict[str, Any]:
    shown = dpcontrol("connect", "lab", "--from", source, "--to", target, "--energy", str(energy), "--json")
    assert shown.code == 0
    return shown.document


@pytest.mark.slow
@pytest.mark.parametrize("search", SEARCHES, ids=str)
def test_a_connection_flies_between_its_orbits_in_its_times_with_its_winding(search: tuple[str, str, float]) -> None:
    source, target, energy = search
    for connection in connections(*search)["connections"]:
        lifts = []
        for saddle, duration in ((source, -connection["time_out"]), (target, connection["time_in"])):
            end = flow(np.array(connection["state"]), duration)[-1]
            turns = np.rint((end[:2] - SADDLES[saddle]) / (2 * np.pi))
            orbit = lyapunov_orbit(saddle, energy)
            at_home = end - np.r_[2 * np.pi * turns, 0, 0]
            distance = np.abs((orbit - at_home) / SCALE).max(axis=1).min()
            assert APPROACH[0] <= distance <= APPROACH[1], connection["name"]
            lifts.append(turns)
        np.testing.assert_array_equal(lifts[1] - lifts[0], connection["winding"])
