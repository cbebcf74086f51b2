"""Both families of Lyapunov orbits about the index-1 saddles of three arms, compared with DOP853."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dpcontrol.orbits.lyapunov import equilibria, lyapunov_orbit
from dpcontrol.plans.model import load_model

SYSTEM = load_model("triple").system
SAME = 1e-9
"""Relative error of DOP853 at 3e-14, after one period of an orbit with multiplier 4e4: 2e-10."""
CLOSED = 1e-9


@pytest.mark.parametrize("saddle", SYSTEM.saddles)
@pytest.mark.parametrize("family", [0, 1])
def test_floquet_multipliers_of_three_arms_agree_with_dop853(saddle: str, family: int) -> None:
    """The pair at one is defective, with an error of the square root of rounding."""
    orbit = lyapunov_orbit(SYSTEM, saddle, energy=equilibria(SYSTEM)[saddle].energy + 0.05, family=family)
    assert orbit.converged
    n, numeric = SYSTEM.dimension, SYSTEM.numeric

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([numeric.rate(y[:n]), (numeric.jacobian(y[:n]) @ y[n:].reshape(n, n)).ravel()])

    first = np.concatenate([orbit.state, np.eye(n).ravel()])
    done = solve_ivp(rates, (0.0, orbit.period), first, method="DOP853", rtol=3e-14, atol=1e-15).y[:, -1]
    assert np.abs(done[:n] - orbit.state).max() < CLOSED
    found = np.array(orbit.floquet_multipliers)
    expected = np.linalg.eigvals(done[n:].reshape(n, n))
    unstable, stable = found[np.argmax(np.abs(found))], found[np.argmin(np.abs(found))]
    assert np.abs(expected / unstable - 1).min() < SAME
    assert abs(unstable * stable - 1) < SAME
    # A third degree of freedom adds a pair on the unit circle.
    centre = [m for m in found if abs(m.imag) > 1e-3]
    assert len(centre) == 2
    for multiplier in centre:
        assert np.abs(expected - multiplier).min() < SAME
        assert abs(abs(multiplier) - 1) < SAME
