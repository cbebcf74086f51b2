"""`dpcontrol connect` against connections refined in extended precision, and against an independent flow."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from command_line import dpcontrol
from independent_pendulum import SADDLES, SCALE, flow, lyapunov_orbit
from reference_values import CONNECTIONS

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
