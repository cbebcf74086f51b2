"""Borders of seed distances from both sides, and statuses of incomplete searches."""

from functools import cache

import numpy as np
import pytest

from dpcontrol.bench.edges import SADDLE, default_states, found_all, near_border
from dpcontrol.orbits.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.plans.model import load_model
from dpcontrol.tubes.intersections import ConnectionSettings


@cache
def orbit() -> LyapunovOrbit:
    return lyapunov_orbit(load_model("lab").system, SADDLE, energy=0.05)


@cache
def states() -> np.ndarray:
    return default_states(orbit())


@pytest.mark.benchmark
def test_seeds_too_near_lose_connections_and_the_search_says_so():
    assert found_all(orbit(), states(), 4e-6).works
    found = near_border(orbit(), states(), draws=3, ratio=2.0)
    assert found.near is not None
    assert found.far is not None
    assert 1e-9 < found.far < found.near < 4e-6
    assert "searches miss connections; at least" in found.says
    # The default is far from both borders.
    assert 50 * found.far < ConnectionSettings().distance < 0.2 / 100


@pytest.mark.slow
def test_seeds_too_far_lose_connections_and_the_search_says_so():
    assert found_all(orbit(), states(), 0.2).works
    lost = found_all(orbit(), states(), 1.2)
    assert not lost.works
    assert lost.says.startswith("at least")
