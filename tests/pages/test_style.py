"""Colours keep apart for people with colour-vision deficiencies."""

from itertools import combinations

import numpy as np
import pytest

from dpcontrol.pages import style

APART = 12.0
"""CIE 1976 distance of two roles: two just noticeable ones are 2.3 apart, and 10 are clear at a glance."""
SERIES_APART = 10.0
"""The same for numbered items, which labels distinguish as well."""
_TO_LMS = np.array([[17.8824, 43.5161, 4.11935], [3.45565, 27.1554, 3.86714], [0.0299566, 0.184309, 1.46709]])
"""Linear RGB to cone responses (Viénot, Brettel and Mollon 1999); the palette was searched with Machado's matrices."""
_LOST = {
    "normal": np.eye(3),
    "protanopia": np.array([[0, 2.02344, -2.52581], [0, 1, 0], [0, 0, 1]]),
    "deuteranopia": np.array([[1, 0, 0], [0.494207, 0, 1.24827], [0, 0, 1]]),
}
"""The missing cone's response from the others'."""
_TRITAN = (
    np.array([[1.01277, 0.13548, -0.14826], [-0.01243, 0.86812, 0.14431], [0.07589, 0.80500, 0.11911]]),
    np.array([[0.93678, 0.18979, -0.12657], [0.06154, 0.81526, 0.12320], [-0.37562, 1.12767, 0.24796]]),
)
_PLANE = np.array([0.03901, -0.02788, -0.01113])
"""Tritanopia in linear RGB, on either side of a plane (Brettel, Viénot and Mollon 1997)."""
VISIONS = (*_LOST, "tritanopia")
_TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def seen(colour: str, vision: str) -> np.ndarray:
    """Return a colour's CIE L*a*b* as a kind of vision sees it."""
    share = np.array(style.rgb(colour)) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    if vision == "tritanopia":
        matrix = _TRITAN[0 if linear @ _PLANE >= 0 else 1]
    else:
        matrix = np.linalg.inv(_TO_LMS) @ _LOST[vision] @ _TO_LMS
    shown = np.clip(matrix @ linear, 0, 1)
    xyz = _TO_XYZ @ shown / (_TO_XYZ @ np.ones(3))
    root = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * root[1] - 16, 500 * (root[0] - root[1]), 200 * (root[1] - root[2])])


@pytest.mark.parametrize("vision", VISIONS)
def test_colours_with_a_meaning_remain_distinct(vision: str) -> None:
    near = {
        (one, other): round(float(np.linalg.norm(seen(a, vision) - seen(b, vision))), 1)
        for (one, a), (other, b) in combinations(style.ROLES.items(), 2)
    }
    assert {pair: distance for pair, distance in near.items() if distance < APART} == {}


@pytest.mark.parametrize("vision", VISIONS)
def test_colours_of_numbered_items_remain_distinct(vision: str) -> None:
    distances = [np.linalg.norm(seen(a, vision) - seen(b, vision)) for a, b in combinations(style.SERIES, 2)]
    assert min(distances) > SERIES_APART
