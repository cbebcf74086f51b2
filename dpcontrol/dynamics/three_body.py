"""The planar circular restricted three-body problem in the rotating frame, as a system like the pendulum.

    L = ½(ẋ² + ẏ²) + x ẏ - y ẋ + ½(μ₁ r₁² + μ₂ r₂²) + μ₁/r₁ + μ₂/r₂

with the larger primary (μ₁ = 1 - μ) at x = -μ and the smaller (μ₂ = μ) at x = 1 - μ; units: distance of the primaries,
their total mass, their angular velocity. The kinetic energy has terms linear in velocity and nothing is an angle.

Source: Koon, Lo, Marsden, Ross (2000), section 2; the constant in the potential is that of Kaheman et al. (2023),
appendix A.
"""

from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
from scipy.optimize import root_scalar

from dpcontrol.dynamics.equations import Equations, state_equations
from dpcontrol.dynamics.lagrangian import mechanics
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


@cache
def three_body_equations() -> Equations:
    """Return the equations with state (x, y, ẋ, ẏ) and the parameter μ."""
    mu = ca.SX.sym("mu")

    def lagrangian(q: ca.SX, v: ca.SX, _: ca.SX) -> ca.SX:
        x, y = q[0], q[1]
        first, second = (x + mu) ** 2 + y**2, (x - 1 + mu) ** 2 + y**2
        potential = -((1 - mu) * first + mu * second) / 2 - (1 - mu) / ca.sqrt(first) - mu / ca.sqrt(second)
        return (v[0] ** 2 + v[1] ** 2) / 2 + x * v[1] - y * v[0] - potential

    def no_dissipation(q: ca.SX, v: ca.SX, _: ca.SX) -> ca.SX:
        return ca.SX(0)

    parts = mechanics(lagrangian, no_dissipation, free=2, prescribed=0, parameters=mu)
    return state_equations(parts, with_cart=False)


def _collinear_points(mu: float) -> dict[str, float]:
    """Return x of L1, L2, L3: where the force on the axis vanishes."""

    def force(x: float) -> float:
        a, b = x + mu, x - 1 + mu
        return x - (1 - mu) * a / abs(a) ** 3 - mu * b / abs(b) ** 3

    tiny = 1e-9
    brackets = {"L1": (-mu + tiny, 1 - mu - tiny), "L2": (1 - mu + tiny, 2.5), "L3": (-2.5, -mu - tiny)}
    return {name: float(root_scalar(force, bracket=b, xtol=1e-16).root) for name, b in brackets.items()}


def three_body_system(name: str, parameters: ThreeBodyParameters) -> System:
    """Return the restricted three-body problem as a system with the equilibria L1, L2, L3.

    Homoclinics are cut on y = 0, x < 0; connections between L1 and L2 on x = 1 - μ.
    """
    mu = parameters.mass_ratio
    opposite = Section("y = 0, x < 0", (0, 1, 0, 0), (1, 0, 0, 0), (1, 0), side=(-1, 0, 0, 0))
    between = Section("x = 1 - mu", (1, 0, 0, 0), (0, 1, 0, 0), (0, 1), offset=1 - mu)
    return System(
        name=name,
        equations=three_body_equations(),
        parameters=np.array([mu]),
        equilibria={key: np.array([x, 0.0, 0.0, 0.0]) for key, x in _collinear_points(mu).items()},
        periods=np.full(4, np.inf),
        reversers=(np.diag([1.0, -1.0, -1.0, 1.0]),),
        orientation=np.array([0.0, 0.0, 0.0, 1.0]),
        # Orbits about L1 and L2 are about a tenth of the primaries' distance in size.
        scale=np.full(4, 0.1),
        energy_scale=0.1,
        sections={
            ("L1", "L1"): opposite,
            ("L2", "L2"): opposite,
            ("L1", "L2"): between,
            ("L2", "L1"): between,
        },
        named_sections={"opposite": opposite, "between": between},
        section_scale=0.1,
        # Half a lap of the larger primary takes three; beyond four, passages of the smaller one scatter the tubes.
        flight_periods=4.0,
    )
