"""The feedback that an equilibrium needs."""

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

import dpcontrol as dp


def test_one_upright_arm_needs_twice_gravity_whatever_its_mass_and_length() -> None:
    arms = dp.load_model("single").arms
    assert arms.need(np.array([np.pi])) == pytest.approx(2 * arms.gravity)


@pytest.mark.parametrize(("name", "need"), [("down-up", 37.0), ("up-down", 23.0), ("up-up", 69.0), ("down-down", None)])
def test_needs_of_the_laboratorys_arms_are_the_published_ones(name: str, need: float | None) -> None:
    found = dp.describe("lab").document()["equilibria"][name]["need"]
    assert found == (need and pytest.approx(need, abs=0.5))


def test_the_need_is_the_largest_gain_of_the_gentlest_feedback() -> None:
    arms = dp.load_model("printed").arms
    angles = np.array([0.0, np.pi])
    signs = np.cos(angles)
    mass = np.linalg.inv(arms.mass_in_line * np.outer(signs, signs))
    moments = signs * arms.base()[3:5]
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-mass @ np.diag(moments), np.zeros((2, 2))]])
    b = np.append(np.zeros(2), -mass @ moments / arms.gravity)[:, None]
    gain = (b.T @ solve_continuous_are(a, b, 1e-12 * np.eye(4), np.eye(1))).ravel()
    # In the unstable mode, angles and rates contribute equally.
    growth, modes = np.linalg.eig(a)
    mode = modes[:, np.argmax(growth.real)].real
    assert abs(gain @ mode) / 2 / np.abs(mode[:2]).max() == pytest.approx(arms.need(angles), rel=1e-4)
