"""`dpcontrol plan`: what it says, how good its references are, and where they go."""

import os
from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol
from reference_values import LYAPUNOV_ORBITS

ERROR_BETWEEN_NODES = 1e-6
VIOLATION = 1e-9
SHADOWING_RESIDUAL = 1e-10
"""Sparse Newton in double precision ends near 1e-13; the bar leaves room for other processors."""
WALKS = {
    # The most transversal symmetric first-hit connection of that sense, by the published angles in (angle, rate),
    # with the same order as the canonical ones. For the crossing, the first of the two published ones.
    "outer-turn": ("down-up", "down-up", [0, 1]),
    "cross": ("down-up", "up-down", [0, 0]),
}
ENERGIES = {"outer-turn": -0.07, "cross": 0.2}


@pytest.mark.parametrize("itinerary", WALKS)
def test_a_reference_solves_the_equations_between_nodes_and_keeps_its_limits(itinerary: str) -> None:
    shown = dpcontrol("plan", itinerary, "--json").document
    reference = shown["reference"]
    assert 0 < reference["max_error_between_nodes"] <= ERROR_BETWEEN_NODES
    assert 0 <= reference["constraint_violation"] <= VIOLATION
    assert 0 < reference["max_cart_position"] <= 0.4 + VIOLATION
    assert 0 < reference["rms_cart_acceleration"] <= reference["max_cart_acceleration"] <= 30 + VIOLATION
    assert reference["intervals"] >= reference["duration"] / 0.05 - 1
    assert reference["iterations"] > 0
    assert reference["solve_seconds"] > 0
    assert reference["status"].startswith("converged")


@pytest.mark.parametrize("itinerary", WALKS)
def test_a_plan_names_its_connections_and_has_the_requested_wobbles(itinerary: str) -> None:
    shown = dpcontrol("plan", itinerary, "--json").document
    source, target, winding = WALKS[itinerary]
    (name,) = shown["walk"]
    assert name.startswith(f"{source}>{target}[{winding[0]},{winding[1]}]h1.1@")
    assert shown["wraps"] == []
    assert 0 <= shown["shadowing"]["residual"] <= SHADOWING_RESIDUAL
    wobbles = sum(2 * LYAPUNOV_ORBITS["lab", saddle, ENERGIES[itinerary]][1] for saddle in (source, target))
    flight = shown["shadowing"]["duration"] - wobbles
    assert 0.5 < flight < 3.0
    assert shown["reference"]["duration"] == pytest.approx(shown["shadowing"]["duration"], rel=1e-9)


def test_a_plan_is_cached_computed_again_on_demand_and_written_as_arrays(tmp_path: Path) -> None:
    made = dpcontrol("plan", "hold-down-down", "--fresh", "--json").document
    assert made["cached"] is False
    assert Path(made["file"]).is_relative_to(os.environ["DPCONTROL_CACHE"])
    found = dpcontrol("plan", "hold-down-down", "--json").document
    assert found["cached"] is True
    for shown in (made, found):
        del shown["cached"], shown["reference"]["solve_seconds"]
    assert found == made
    file = tmp_path / "hold.npz"
    assert dpcontrol("plan", "hold-down-down", "--out", file, "--json").document["file"] == str(file)
    with np.load(file) as arrays:
        assert "states" in arrays.files
