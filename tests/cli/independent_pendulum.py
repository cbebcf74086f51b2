"""The lab pendulum again, by the textbook and scipy: what verbs claim is checked against it."""

from functools import cache
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from reference_values import LYAPUNOV_ORBITS
from scipy.integrate import solve_ivp
from shadowing_stand_in import LAB
from textbook import TwoArms

Array = NDArray[np.float64]

PRINTED = SimpleNamespace(
    mass=(0.0938, 0.1376),
    centre_of_mass=(0.1086, 0.1168),
    length=(0.1727,),
    inertia=(0.0001, 0.0001),
    gravity=9.808,
    viscous=(0.0, 0.0),
)
PARAMETERS = {"lab": LAB, "printed": PRINTED}
"""The rig's identified values, and those of the paper's text, which has no length of the outer arm."""
LETTERS = {"m": "mass", "a": "centre_of_mass", "J": "inertia", "k": "viscous"}

SADDLES = {"down-up": np.array([0.0, np.pi]), "up-down": np.array([np.pi, 0.0])}
SCALE = np.array([np.pi, np.pi, 10.0, 10.0])

_ARMS = TwoArms(LAB)


def flow(state: Array, duration: float, points: int = 2) -> Array:
    """Return states (points, 4) at equal steps from 0 to `duration`, which may be negative."""
    times = np.linspace(0.0, duration, points)
    done = solve_ivp(
        lambda _, x: _ARMS.slope(x), (0.0, duration), state, method="DOP853", t_eval=times, rtol=1e-13, atol=1e-13
    )
    return done.y.T


@cache
def lyapunov_orbit(saddle: str, energy: float) -> Array:
    """Return 100,000 states round the published orbit: neighbours are less than 3e-4 (scaled) apart."""
    state, period, *_ = LYAPUNOV_ORBITS["lab", saddle, energy]
    return flow(np.array(state), period, points=100_000)


def angle_gaps(angles: Array, orbit: Array) -> Array:
    """Return for angles (K, 2), on the orbit's own lift, how far (rad) each is from the orbit, least over phase."""
    sparse = orbit[::50, :2]
    return np.array([np.abs(sparse - a).max(axis=1).min() for a in angles])
