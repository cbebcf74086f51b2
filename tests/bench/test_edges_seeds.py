"""Seeds of tubes: both borders from both sides, and what a search says of connections that it misses."""

from functools import cache

import numpy as np
import pytest

from dpcontrol.bench.edges_seeds import LUCK, SADDLE, crossings, found_all, nearest_seeds, scatter, search
from dpcontrol.scenes.model import load_model
from dpcontrol.tubes.intersections import ConnectionSettings
from dpcontrol.tubes.lyapunov import LyapunovOrbit, lyapunov_orbit

DEFAULT = ConnectionSettings().distance
FEW_DRAWS = 0.5  # of a standard deviation from 30 draws, of several crossings


@cache
def orbit() -> LyapunovOrbit:
    return lyapunov_orbit(load_model("lab").system, SADDLE, energy=0.05)


@cache
def states() -> np.ndarray:
    return np.array([c.state for c in search(orbit(), DEFAULT).connections])


@cache
def foretold() -> float:
    return nearest_seeds(orbit())


def test_rounding_in_arrivals_grows_as_the_inverse_of_the_distance():
    def spread(distance: float) -> float:
        return float(np.median([np.sqrt(np.trace(scatter(c))) for c in crossings(orbit(), distance)[0][:3]]))

    assert spread(DEFAULT) / spread(10 * DEFAULT) == pytest.approx(10, rel=FEW_DRAWS)


def test_seeds_nearer_than_foretold_lose_connections_and_the_search_says_so():
    assert found_all(orbit(), states(), (1 + LUCK) * foretold()).works
    lost = found_all(orbit(), states(), foretold() / (1 + LUCK))
    assert not lost.works
    assert lost.says.startswith("at least")
    assert "did not converge" in lost.says


def test_seeds_too_far_lose_connections_and_the_search_says_so():
    assert found_all(orbit(), states(), 0.2).works
    lost = found_all(orbit(), states(), 0.45)
    assert not lost.works
    assert lost.says.startswith("at least")


def test_the_default_is_far_from_both_borders():
    assert 50 * nearest_seeds(orbit()) < DEFAULT
    assert DEFAULT < 0.2 / 100
