"""Symmetric connections of three arms at isolated energies, compared with scipy's DOP853."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dpcontrol as dp
from dpcontrol.foundation.causes import GridCause
from dpcontrol.orbits.manifold import OrbitCurve
from dpcontrol.tubes.connections import Connection
from dpcontrol.tubes.symmetric import SymmetricSettings, find_symmetric_connections

SYSTEM = dp.load_model("triple").system
COARSE = SymmetricSettings(energies=3, phases=120)
SAME = 1e-9


@pytest.fixture(scope="module")
def turn() -> Connection:
    """The connection on which the outermost arm turns once, on the first passage through its lowest position."""
    search = find_symmetric_connections(SYSTEM, "down-down-up", energies=(-1.02, -0.99), settings=COARSE)
    assert len(search.connections) == 1
    assert search.failed == 0
    return search.connections[0]


def _flown(start: np.ndarray, times: np.ndarray) -> np.ndarray:
    options = {"method": "DOP853", "t_eval": times, "rtol": 3e-14, "atol": 1e-15}
    return solve_ivp(lambda _, x: SYSTEM.numeric.rate(x), (times[0], times[-1]), start, **options).y.T


@pytest.mark.slow
def test_the_outermost_arm_turns_once_between_two_visits_of_its_orbit(turn: Connection) -> None:
    assert turn.winding == (0, 0, 1)
    assert turn.symmetric
    assert turn.residual < 1e-12
    assert turn.time_out == pytest.approx(turn.time_in, abs=1e-9)
    assert np.abs(turn.state[:3] - [0.0, 0.0, 2 * np.pi]).max() == 0.0


def test_dop853_reaches_the_next_node_of_each_segment(turn: Connection) -> None:
    orbit = turn.orbit
    for k, state in enumerate(orbit.states[:-1]):
        assert np.abs(_flown(state, orbit.times[k : k + 2])[-1] - orbit.states[k + 1]).max() < SAME
    energies = SYSTEM.numeric.hamiltonian(orbit.states)
    assert np.abs(energies - turn.source.energy).max() < SAME


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_propagation_from_the_middle_reaches_the_orbit_in_both_directions(turn: Connection, sign: float) -> None:
    """Rounding grows as the distance decreases, so the closest approach is 1e-6 for seeds at 3e-7."""
    times = sign * np.linspace(0.0, turn.orbit.times[-1], 400)
    _, distances = OrbitCurve(turn.source).distances(_flown(turn.state, times))
    assert distances[0] > 0.1
    assert distances[-1] < 1e-6


@pytest.mark.slow
def test_a_symmetric_connection_exists_at_one_energy_only(turn: Connection) -> None:
    """At other energies, the tube misses the middle in proportion to the energy difference."""
    searches = [
        find_symmetric_connections(SYSTEM, "down-down-up", energies=energies, settings=COARSE)
        for energies in ((-1.02, turn.source.energy - 1e-4), (turn.source.energy + 1e-4, -0.99))
    ]
    assert [search.connections for search in searches] == [(), ()]


def test_a_search_stops_at_a_second_unstable_direction() -> None:
    search = find_symmetric_connections(SYSTEM, "down-down-up", energies=(-0.85, -0.7), family=1, settings=COARSE)
    assert search.searched[1] < -0.7
    assert search.cause is GridCause.UNSTABLE_DIRECTIONS
    assert search.beyond is not None
    assert search.beyond.unstable_directions == 2
