"""The lab pendulum again, written by hand and integrated by scipy: what verbs claim is checked against it.

    A ω₁' + C cos(θ₁-θ₂) ω₂' + C sin(θ₁-θ₂) ω₂² + G₁ sin θ₁ = 0
    B ω₂' + C cos(θ₁-θ₂) ω₁' - C sin(θ₁-θ₂) ω₁² + G₂ sin θ₂ = 0

A = m₁a₁² + m₂ℓ₁² + J₁, B = m₂a₂² + J₂, C = m₂ℓ₁a₂, G₁ = (m₁a₁ + m₂ℓ₁)g, G₂ = m₂a₂g; any textbook on mechanics.
Angles absolute, from hanging.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray
from reference_values import LYAPUNOV_ORBITS
from scipy.integrate import solve_ivp

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

_P = PARAMETERS["lab"]
_A = _P["m1"] * _P["a1"] ** 2 + _P["m2"] * _P["l1"] ** 2 + _P["J1"]
_B = _P["m2"] * _P["a2"] ** 2 + _P["J2"]
_C = _P["m2"] * _P["l1"] * _P["a2"]
_G1 = (_P["m1"] * _P["a1"] + _P["m2"] * _P["l1"]) * _P["g"]
_G2 = _P["m2"] * _P["a2"] * _P["g"]


def _slope(_: float, x: Array) -> Array:
    angle_1, angle_2, rate_1, rate_2 = x
    cosine, sine = _C * np.cos(angle_1 - angle_2), _C * np.sin(angle_1 - angle_2)
    force_1 = -sine * rate_2**2 - _G1 * np.sin(angle_1)
    force_2 = sine * rate_1**2 - _G2 * np.sin(angle_2)
    determinant = _A * _B - cosine**2
    return np.array(
        [
            rate_1,
            rate_2,
            (_B * force_1 - cosine * force_2) / determinant,
            (_A * force_2 - cosine * force_1) / determinant,
        ]
    )


def flow(state: Array, duration: float, points: int = 2) -> Array:
    """Return states (points, 4) at equal steps from 0 to `duration`, which may be negative."""
    times = np.linspace(0.0, duration, points)
    done = solve_ivp(_slope, (0.0, duration), state, method="DOP853", t_eval=times, rtol=1e-13, atol=1e-13)
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
