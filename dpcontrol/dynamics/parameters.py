"""Parameters of a planar chain of arms on a cart, physical and base.

The physical parameters (masses, centres, lengths, inertias) enter the equations only through the base
parameters

    M_ii = J_i + m_i a_i² + (m_{i+1} + … + m_n) l_i²
    M_ij = (m_j a_j + (m_{j+1} + … + m_n) l_j) l_i        for j > i
    S_i  = m_i a_i + (m_{i+1} + … + m_n) l_i,             G_i = g S_i

so that T = ½ Σ M_ij cos(θ_i-θ_j) ω_i ω_j and V = -Σ G_i cos θ_i; S_i couples arm i to the cart. This form has a
third of the instructions of the form from positions. The friction coefficients of each joint follow: viscous, then
those of the laws in use beyond it, and their smoothing rate.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError

Array = NDArray[np.float64]

LARGEST = 1e6
"""No mass, length, inertia or friction of a bench is larger in SI units; beyond it products overflow."""


class Friction(StrEnum):
    """The laws of friction besides the viscous one, in the order in which their coefficients stand."""

    COULOMB = "coulomb"
    QUADRATIC = "quadratic"


@dataclass(frozen=True)
class ArmChainParameters:
    """Physical parameters of n arms, inner arm first; SI units.

    mass (n,) kg; centre_of_mass (n,) m from the arm's joint; length (n,) m, the last for pictures only;
    inertia (n,) kg m² about the centre of mass; gravity m/s²; viscous (n,) N m s/rad in each joint, on the
    relative rate. coulomb (n,) N m likewise, and quadratic (n,) N s²/m², the air's drag on each arm over the squared
    speed of its centre of oscillation; empty: not in the equations at all. smoothing rad/s: the rate below which
    those two fade.
    """

    mass: tuple[float, ...]
    centre_of_mass: tuple[float, ...]
    length: tuple[float, ...]
    inertia: tuple[float, ...]
    gravity: float
    viscous: tuple[float, ...]
    coulomb: tuple[float, ...] = ()
    quadratic: tuple[float, ...] = ()
    smoothing: float = 0.05

    def __post_init__(self) -> None:
        """Refuse what is no pendulum.

        Raises:
            InputError: names the parameter, its value and what is allowed.
        """
        count = len(self.mass)
        if count < 1:
            raise InputError("mass = []: a chain has at least one arm")
        columns = {  # name: (values, whether zero is allowed)
            "mass": (self.mass, False),
            "centre_of_mass": (self.centre_of_mass, False),
            "length": (self.length, False),
            "inertia": (self.inertia, True),
            "viscous": (self.viscous, True),
            "acceleration": ((self.gravity,), False),
            "smoothing": ((self.smoothing,), False),
        } | {law.value: (getattr(self, law), True) for law in self.friction}
        for name, (values, zero_allowed) in columns.items():
            if name not in ("acceleration", "smoothing") and len(values) != count:
                raise InputError(f"{name} has {len(values)} values but mass has {count}; give one for each arm")
            for value in values:
                if not np.isfinite(value) or not 0 <= value <= LARGEST or (value == 0 and not zero_allowed):
                    allowed = "zero or positive" if zero_allowed else "positive"
                    raise InputError(f"{name} = {value!r}: must be a finite number, {allowed}, at most {LARGEST:g}")

    @property
    def count(self) -> int:
        """Number of arms."""
        return len(self.mass)

    @property
    def friction(self) -> tuple[Friction, ...]:
        """The friction laws besides the viscous one."""
        return tuple(law for law in Friction if getattr(self, law))

    def named(self) -> dict[str, tuple[float, str]]:
        """Return {name: (value, unit)} with the field's short names: m1, a1, l1, J1, g, k1 …"""
        units = (("m", "mass", "kg"), ("a", "centre_of_mass", "m"), ("l", "length", "m"),
                 ("J", "inertia", "kg m^2"))  # fmt: skip
        out: dict[str, tuple[float, str]] = {}
        for letter, field, unit in units:
            for i, value in enumerate(getattr(self, field)):
                out[f"{letter}{i + 1}"] = (value, unit)
        out["g"] = (self.gravity, "m/s^2")
        for i, value in enumerate(self.viscous):
            out[f"k{i + 1}"] = (value, "N m s/rad")
        for law, letter, unit in ((Friction.COULOMB, "c", "N m"), (Friction.QUADRATIC, "b", "N s^2/m^2")):
            for i, value in enumerate(getattr(self, law)):
                out[f"{letter}{i + 1}"] = (value, unit)
        if self.friction:
            out["w"] = (self.smoothing, "rad/s")
        return out

    def base(self) -> Array:
        """Return the base parameters (n(n+1)/2 + 3n + …,): M row by row for j >= i, then G, S, friction.

        The friction is viscous (n,), then coulomb (n,) and quadratic (n,) where these arms have them, then their
        smoothing rate.
        """
        m, a, joint, j = (np.asarray(v) for v in (self.mass, self.centre_of_mass, self.length, self.inertia))
        return _base(m, a, joint, j, np.asarray(self._dissipative()), self.gravity)

    def _dissipative(self) -> tuple[float, ...]:
        """Return all numbers of friction that the equations take."""
        further = sum((getattr(self, law) for law in self.friction), ())
        return (*self.viscous, *further, *((self.smoothing,) if further else ()))

    def decimal_base(self) -> tuple[Fraction, ...]:
        """Return the base parameters without rounding, the physical ones taken as the decimals a file gives.

        That is the shortest decimal that reads as the same double, which is what was typed up to 15 digits.
        """

        def exact(values: tuple[float, ...]) -> Any:
            return np.array([Fraction(repr(float(v))) for v in values], dtype=object)

        m, a, joint, j = exact(self.mass), exact(self.centre_of_mass), exact(self.length), exact(self.inertia)
        base = _base(m, a, joint, j, exact(self._dissipative()), Fraction(repr(float(self.gravity))))
        return tuple(Fraction(value) for value in base)

    def frictionless(self) -> "ArmChainParameters":
        """Return the same arms without friction."""
        return replace(self, viscous=(0.0,) * self.count, coulomb=(), quadratic=())

    def viscous_only(self) -> "ArmChainParameters":
        """Return the same arms with no law of friction besides the viscous one."""
        return replace(self, coulomb=(), quadratic=())

    def mismatched(self, fraction: float, random: np.random.Generator) -> "ArmChainParameters":
        """Return a chain whose parameters differ from these: what the plant may be when this is the model.

        Each mass, centre, length and inertia is multiplied by an independent uniform 1 ± fraction; each
        friction coefficient by 1 ± 5 fraction, but never below zero.
        """

        def vary(values: tuple[float, ...], by: float) -> tuple[float, ...]:
            factors = np.maximum(1 + random.uniform(-by, by, len(values)), 0.0)
            return tuple(float(v) for v in np.asarray(values) * factors)

        return replace(
            self,
            mass=vary(self.mass, fraction),
            centre_of_mass=vary(self.centre_of_mass, fraction),
            length=vary(self.length, fraction),
            inertia=vary(self.inertia, fraction),
            viscous=vary(self.viscous, 5 * fraction),
            # Drawn last, so that a seed gives the same arms with and without them.
            coulomb=vary(self.coulomb, 5 * fraction),
            quadratic=vary(self.quadratic, 5 * fraction),
        )


def _base(m: Any, a: Any, joint: Any, j: Any, friction: Any, gravity: Any) -> Any:
    """Return the base parameters of the chain, in the arithmetic of its arguments (n,), friction last."""
    n = len(m)
    beyond = np.array([m[i + 1 :].sum() for i in range(n)])
    coupling = m * a + beyond * joint
    inertia = [
        j[i] + m[i] * a[i] ** 2 + beyond[i] * joint[i] ** 2 if i == k else coupling[k] * joint[i]
        for i in range(n)
        for k in range(i, n)
    ]
    return np.concatenate([inertia, gravity * coupling, coupling, friction])
