"""The planar circular restricted three-body problem in the rotating frame, as a system like the pendulum.

    L = ½(ẋ² + ẏ²) + x ẏ - y ẋ + ½(μ₁ r₁² + μ₂ r₂²) + μ₁/r₁ + μ₂/r₂

with the larger primary (μ₁ = 1 - μ) at x = -μ and the smaller (μ₂ = μ) at x = 1 - μ; units: distance of the primaries,
their total mass, their angular velocity. The kinetic energy has terms linear in velocity and nothing is an angle.

Source: Koon, Lo, Marsden, Ross (2000), section 2; the constant in the potential is that of Kaheman et al. (2023),
appendix A.
"""

from dataclasses import dataclass

import casadi as ca

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.settings import Settings, setting


@dataclass(frozen=True)
class ThreeBodyParameters(Settings):
    """mass_ratio μ: the smaller primary's share of the total mass, dimensionless."""

    mass_ratio: float = setting(above=0, most=0.5)

    def named(self) -> dict[str, tuple[float, str]]:
        """Return {name: (value, unit)}."""
        return {"mu": (self.mass_ratio, "1")}


def _lagrangian(q: tuple[ca.SX, ...], v: tuple[ca.SX, ...], parameters: dict[str, ca.SX]) -> ca.SX:
    (x, y), (vx, vy), mu = q, v, parameters["mu"]
    first, second = (x + mu) ** 2 + y**2, (x - 1 + mu) ** 2 + y**2
    potential = -((1 - mu) * first + mu * second) / 2 - (1 - mu) / ca.sqrt(first) - mu / ca.sqrt(second)
    return (vx**2 + vy**2) / 2 + x * vy - y * vx - potential


def three_body_system(name: str, parameters: ThreeBodyParameters) -> System:
    """Return the restricted three-body problem as a system with the equilibria L1, L2, L3.

    Homoclinics are cut on y = 0, x < 0; connections between L1 and L2 on x = 1 - μ.
    """
    mu = parameters.mass_ratio
    hill_radius = (mu / 3) ** (1 / 3)
    return System.from_lagrangian(
        name,
        _lagrangian,
        coordinates=("x", "y"),
        parameters={"mu": mu},
        equilibria={"L1": (1 - mu - hill_radius, 0), "L2": (1 - mu + hill_radius, 0), "L3": (-1 - 5 * mu / 12, 0)},
        orientation=(0, 0, 0, 1),
        # Orbits about L1 and L2 are about a tenth of the primaries' distance in size.
        scale=(0.1,) * 4,
        energy_scale=0.1,
        sections={
            "opposite": Section.plane("y = 0, x < 0", (0, 1)).where((-1, 0)),
            "between": Section.plane("x = 1 - mu", (1, 0), offset=1 - mu),
        },
        between={
            ("L1", "L1"): "opposite",
            ("L2", "L2"): "opposite",
            ("L1", "L2"): "between",
            ("L2", "L1"): "between",
        },
        # Half a lap of the larger primary takes three; beyond four, passages of the smaller one scatter the tubes.
        flight_periods=4.0,
    )
