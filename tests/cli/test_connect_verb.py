"""`dpcontrol connect` against connections refined in extended precision, and against an independent flow."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import dpcontrol
from independent_pendulum import SADDLES, SCALE, flow, lyapunov_orbit
from numpy.typing import NDArray
from reference_values import CONNECTIONS

STATE_TOLERANCE = 1e-9
RESIDUAL = 1e-11
APPROACH = (0.8e-3, 1.2e-3)
"""Flight times end at a scaled distance of 1e-3; the orbit's samples here are up to 3e-4 apart, and a flight's own
error of 1e-12 has grown by 1e3 at most."""

SEARCHES = list(CONNECTIONS)


@cache
def connections(source: str, target: str, energy: float) -> dict[str, Any]:
    shown = dpcontrol("connect", "lab", "--from", source, "--to", target, "--energy", str(energy), "--json")
    assert shown.code == 0
    return shown.document


def on_the_torus(search: tuple[str, str, float]) -> Iterator[tuple[int, bool, NDArray[np.float64]]]:
    """Yield (sense, symmetric, state) of all connections: the published ones, their mirrors and reflections."""
    source, target, _ = search
    for point in CONNECTIONS[search][1]:
        state = np.array(point)
        symmetric = source == target and not state[:2].any()
        twins = [state]
        if source == target and not symmetric:
            twins.append(state * [-1, -1, 1, 1])
        for twin in twins:
            yield +1, symmetric, twin
            yield -1, symmetric, -twin


def difference(found: list[float], expected: NDArray[np.float64]) -> float:
    gap = np.array(found) - expected
    gap[:2] -= 2 * np.pi * np.rint(gap[:2] / (2 * np.pi))
    return float(np.abs(gap).max())


@pytest.mark.parametrize("search", SEARCHES, ids=str)
def test_every_connection_on_the_torus_is_found_once_and_no_other(search: tuple[str, str, float]) -> None:
    shown = connections(*search)
    found = shown["connections"]
    assert shown["count"] == len(found) == CONNECTIONS[search][0]
    assert len({c["name"] for c in found}) == len(found)
    expected = list(on_the_torus(search))
    assert len(expected) == len(found)
    for sense, symmetric, state in expected:
        near = [c for c in found if c["sense"] == sense and difference(c["state"], state) <= STATE_TOLERANCE]
        assert len(near) == 1, state
        assert near[0]["symmetric"] is symmetric
    for connection in found:
        assert connection["residual"] <= RESIDUAL
        assert connection["hits"] == [1, 1]
        assert 0 < connection["transversality_angle_deg"] <= 90


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


def test_open_cuts_are_reported_with_branch_phases_and_reason() -> None:
    open_cuts = connections("down-up", "down-up", 0.2)["open_cuts"]
    assert len(open_cuts) == 4
    assert {cut["branch"] for cut in open_cuts} == {"unstable +1", "unstable -1", "stable +1", "stable -1"}
    for cut in open_cuts:
        low, high = cut["phase_interval"]
        assert 0 <= low <= high <= 1
        assert "graze" in cut["reason"]
    assert connections("down-up", "down-up", -0.07)["open_cuts"] == []


def test_the_cuts_and_connections_are_drawn_on_request(tmp_path: Path) -> None:
    ends = ("connect", "lab", "--from", "down-up", "--to", "up-down", "--energy", "0.2", "--json")
    shown = dpcontrol(*ends, "--picture", str(tmp_path / "cuts.svg"))
    assert shown.document["picture"] == str(tmp_path / "cuts.svg")
    text = (tmp_path / "cuts.svg").read_text(encoding="utf-8")
    assert "tube from down-up" in text
    assert dpcontrol(*ends, "--picture", str(tmp_path / "cuts.jpg")).code == 2
