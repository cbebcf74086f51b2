"""Independently computed values for the tests: Taylor integration and Newton refinement in 113-bit arithmetic.

Angles are absolute, in rad from hanging. Rates are in rad/s, and energies in J from the pivot's height. State order:
angle_1, angle_2, rate_1, rate_2.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

SQUARED_EIGENVALUES = {
    ("lab", "down-down"): (-0.4906446053930873, -32.61127464154705, -159.94131657523323),
    ("lab", "down-up"): (-0.1754297468841109, 64.82866040641298, -80.45654759279255),
    ("lab", "up-down"): (0.1754297468841109, 80.45654759279255, -64.82866040641298),
    ("lab", "up-up"): (0.4906446053930873, 159.94131657523323, 32.61127464154705),
    ("printed", "down-down"): (-0.49061459904, -37.765524171277285, -497.1919224730543),
    ("printed", "down-up"): (-0.17535252416, 172.66797387911524, -108.74462208646477),
    ("printed", "up-down"): (0.17535252416, 108.74462208646477, -172.66797387911524),
    ("printed", "up-up"): (0.49061459904, 497.1919224730543, 37.765524171277285),
}
"""(model, equilibrium): energy, two squared eigenvalues."""

LYAPUNOV_ORBITS = {
    ("lab", "down-up", -0.07): (
        (0.0, 3.141592653589793, 7.754101061370101, 4.417698392811411),
        0.7523800284928803,
        533.8933370542445,
        (0.8828595470310378, 3.598213677163711),
    ),
    ("lab", "down-up", 0.2): (
        (0.0, 3.141592653589793, 14.750916765681563, 8.846290550616802),
        0.9445642569260552,
        1997.269909891544,
        (1.794347804766788, 3.784229582305787),
    ),
    ("lab", "up-down", 0.2): (
        (3.141592653589793, 0.0, 1.2873939234889786, 4.869279571953793),
        0.8137911933362946,
        1332.1705147452537,
        (3.285939211489251, 0.6056557979614939),
    ),
    ("printed", "down-up", -0.07): (
        (0.0, 3.141592653589793, 10.161622491806602, 8.54395301892988),
        0.6549969138688305,
        10319.662190224504,
        (0.9940832006639465, 3.9260527000718195),
    ),
}
"""(model, saddle, energy): state, period, unstable multiplier, angles of the brake point."""

CONNECTIONS = {
    ("down-up", "down-up", -0.07): (
        8,
        (
            (0.0, 0.0, -9.909953965975522, 21.689438398540574),
            (0.5088259485635326, 0.0, -12.433165000760168, 16.98617970561923),
            (0.0, 0.0, -15.20304513878392, 19.103321157547335),
        ),
    ),
    ("down-up", "down-up", 0.2): (
        14,
        (
            (0.0, 0.0, 9.593480730760934, 10.123714136067388),
            (0.29724200941724777, 0.0, 8.322207480895957, 11.814800382297237),
            (1.6918424437439843, 0.0, -3.126870515120456, 13.24531056265714),
            (0.0, 0.0, -9.219515805489173, 26.9153355946741),
            (0.0, 0.0, -20.210382519303923, 22.697407131322933),
        ),
    ),
    ("up-down", "up-down", 0.2): (
        8,
        (
            (0.0, 0.0, 20.774084222984765, -18.730368686146466),
            (0.0, 0.0, 20.58015403357726, -21.043495048863686),
            (0.0, 0.4334204683994947, 19.14887920641173, -17.89141223857858),
        ),
    ),
    ("down-up", "up-down", 0.2): (
        4,
        (
            (-0.4155636518095254, -0.4155636518095254, 19.89782414430897, -20.69737296130328),
            (-0.272805226211663, -0.272805226211663, 20.151884102406395, -21.592726095536747),
        ),
    ),
}
"""Number of first-hit connections on the torus by (from, to, energy) of the lab pendulum, and states with sense +1. One
state of each mirror pair is given; the other one has the opposite angle on the section."""


def images(key: tuple[str, str, float]) -> NDArray[np.float64]:
    """Return the states (K, 4) of `CONNECTIONS` and of their mirror images."""
    states = np.array(CONNECTIONS[key][1])
    if key[0] == key[1]:
        states = np.vstack([states, states * [-1, -1, 1, 1]])
    return np.vstack([states, -states])


def on_torus(first: ArrayLike, second: ArrayLike) -> float:
    """Return the largest difference of states, with angles modulo a turn."""
    gap = np.asarray(first) - np.asarray(second)
    return float(max(np.abs(2 * np.sin(gap[:2] / 2)).max(), np.abs(gap[2:]).max()))
