"""Two arms on a cart by the textbook: typed in by hand, to check the package's Lagrangian against.

    A ω₁' + C cos(θ₁-θ₂) ω₂' = -C sin(θ₁-θ₂) ω₂² - S₁ (g sin θ₁ + u cos θ₁) - k₁ ω₁ - k₂ (ω₁ - ω₂)
    B ω₂' + C cos(θ₁-θ₂) ω₁' =  C sin(θ₁-θ₂) ω₁² - S₂ (g sin θ₂ + u cos θ₂) - k₂ (ω₂ - ω₁)

A = m₁a₁² + m₂ℓ₁² + J₁, B = m₂a₂² + J₂, C = m₂ℓ₁a₂, S₁ = m₁a₁ + m₂ℓ₁, S₂ = m₂a₂. Angles are absolute, from hanging.
"""

from typing import Any

import numpy as np


class TwoArms:
    """The constants of two arms, given an object with their masses, centres, lengths and inertias, and gravity."""

    def __init__(self, arms: Any, *, viscous: tuple[float, float] = (0.0, 0.0)) -> None:
        (m1, m2), (a1, a2), (j1, j2), l1 = arms.mass, arms.centre_of_mass, arms.inertia, arms.length[0]
        self.inner, self.outer, self.both = m1 * a1**2 + m2 * l1**2 + j1, m2 * a2**2 + j2, m2 * l1 * a2
        self.moments, self.gravity, self.viscous = (m1 * a1 + m2 * l1, m2 * a2), arms.gravity, viscous

    def slope(self, state: Any, push: Any = 0.0) -> list[Any]:
        """Return the rates of change of angles and rates, numbers or casadi's, under an acceleration of the cart."""
        first, second, rate, other = (state[i] for i in range(4))
        mixed, bent = self.both * np.cos(first - second), self.both * np.sin(first - second)
        (s1, s2), (k1, k2), g = self.moments, self.viscous, self.gravity
        force_1 = -bent * other**2 - s1 * (g * np.sin(first) + push * np.cos(first)) - k1 * rate - k2 * (rate - other)
        force_2 = bent * rate**2 - s2 * (g * np.sin(second) + push * np.cos(second)) - k2 * (other - rate)
        determinant = self.inner * self.outer - mixed**2
        turn_1, turn_2 = self.outer * force_1 - mixed * force_2, self.inner * force_2 - mixed * force_1
        return [rate, other, turn_1 / determinant, turn_2 / determinant]
