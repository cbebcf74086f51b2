"""The lab pendulum again, by the textbook and scipy: what verbs claim is checked against it."""

from functools import cache
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from reference_values import LYAPUNOV_ORBITS
from scipy.integrate import solve_ivp
from textbook import TwoArms

Array = NDArray[np.float64]

PARAMETERS = {
    "lab": {
        "m1": 0.0938439747983407,
        "m2": 0.137595970499412,
        "a1": 0.108565214610396,
        "a2": 0.116779018445656,
        "l1": 0.172719203817519,
        "J1": 0.00043752942975691,
        "J2": 0.00126882939257741,
        "g": 9.8085802336215,
        "k1": 0.000237142782693581,
        "k2": 1.00000019330558e-05,
    },
    "printed": {
        "m1": 0.0938,
        "m2": 0.1376,
        "a1": 0.1086,
        "a2": 0.1168,
        "l1": 0.1727,
        "J1": 0.0001,
        "J2": 0.0001,
        "g": 9.808,
        "k1": 0.0,
        "k2": 0.0,
    },
}
"""The rig's identified values, and those of the paper's text."""

SADDLES = {"down-up": np.array([0.0, np.pi]), "up-down": np.array([np.pi, 0.0])}
SCALE = np.array([np.pi, np.pi, 10.0, 10.0])

_LETTERS = {"mass": "m", "centre_of_mass": "a", "inertia": "J"}
_VALUES = PARAMETERS["lab"]
_PAIRS = {name: (_VALUES[f"{letter}1"], _VALUES[f"{letter}2"]) for name, letter in _LETTERS.items()}
_LAB = TwoArms(SimpleNamespace(**_PAIRS, length=(_VALUES["l1"],), gravity=_VALUES["g"]))


def flow(state: Array, duration: float, points: int = 2) -> Array:
    """Return states (points, 4) at equal steps from 0 to `duration`, which may be negative."""
    times = np.linspace(0.0, duration, points)
    done = solve_ivp(
        lambda _, x: _LAB.slope(x), (0.0, duration), state, method="DOP853", t_eval=times, rtol=1e-13, atol=1e-13
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
