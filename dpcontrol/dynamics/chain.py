"""A planar chain of n arms on a cart.

This module has its parameters, one Lagrangian, its levels, identifiable ratios and drawn arms.

    L = ½ Σ M_ij cos(θ_i-θ_j) ω_i ω_j + Σ S_i cos θ_i ω_i ẋ + ½ ẋ² + Σ G_i cos θ_i
    D = Σ ½ k_i ρ_i² + c_i √(ρ_i² + w²) + ⅓ b_i (v_i² + (λ_i w)²)^{3/2},      ρ_i = ω_i - ω_{i-1}

    M_ii = J_i + m_i a_i² + (m_{i+1} + … + m_n) l_i²
    M_ij = (m_j a_j + (m_{j+1} + … + m_n) l_j) l_i        for j > i
    S_i  = m_i a_i + (m_{i+1} + … + m_n) l_i,             G_i = g S_i

Masses, centres, lengths and inertias only enter through the base parameters M, G, S. This form has a third of the
instructions of the form from positions. If the cart's acceleration is the input, the cart's inertia is irrelevant, and
½ ẋ² replaces it.

A joint has viscous friction k and optional Coulomb friction c. Each arm has optional drag b v² in air at rest. Here v_i
is the speed of the arm's centre of oscillation, which is λ_i = M_ii/S_i from its joint. On a free swing, drag at this
true speed explains the data, but a torque b ρ|ρ| in the joint does not. The smoothing rate w keeps both laws analytic,
as Taylor's method and collocation require. Unlike tanh(ρ/w) through log cosh, √ cannot overflow.

If the cart is clamped or driven in acceleration, the equations are invariant under a common factor of masses, inertias
and friction. With known g, swings therefore identify the ratios over C = M_12 (M_11 of a single arm)

    M_ii/C, G_i/C,  l_2 … l_{n-1} (three arms and more),  viscous_i/C, coulomb_i/C, quadratic_i/C

since M_ij = l_i G_j/g for i < j and l_1 = g C/G_2. Many arms have the same ratios. `nearest_arms` selects those whose
masses, centres, lengths and inertias differ least from given ones, in the sum of squared logarithms. Arms drawn from a
covariance Σ of the ratios r have r + s Σ^½ z, with z standard normal and a factor s on the standard errors.

Bounds of possible arms: consider an arm of mass m and length l, with its centre a from the joint, between joint and
end. Its inertia about the centre is at most m a (l - a), with all mass at both ends. It is zero only for a point mass,
which belongs at a rod's end. The arm swings only if friction is small compared with gravity. Let I be its inertia about
the joint and G the largest torque of its weight and of the arms that it carries. With viscous friction above 2 √(G I)
it creeps down without a swing. Coulomb friction above G holds it anywhere. Drag b λ v², λ = I/S, above G brakes it
before the speed of a fall, v² = 4 g λ.

Sources: Armstrong-Hélouvry, Dupont, Canudas de Wit, A survey of models ... of machines with friction (1994), section 2.
Batchelor, An introduction to fluid dynamics (1967), section 5.11, for the drag. Gautier, Khalil, Direct calculation of
minimum set of inertial parameters of serial robots (1990). Hastie, Tibshirani, Friedman, The elements of statistical
learning (2009), section 8.2 (parametric bootstrap).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from fractions import Fraction
from functools import cache, reduce
from itertools import product
from typing import Annotated, Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.equations import Energy, Equations, mechanics, state_equations
from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System, described_system
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.settings import Setting, Settings, check_choice, leaves_of
from dpcontrol.foundation.shown import Brief
from dpcontrol.foundation.units import OTHER_UNITS

MOST_ARMS = 8
"""Largest number of arms; `model` shows 256 equilibria of eight."""
LARGEST = 1e6
"""Largest mass, length, inertia or friction in SI units; products of larger ones overflow."""
_HEAVIEST_ARM = 20.0
"""Largest usual mass, kg."""
_INERTIAL = {"mass": "m", "centre_of_mass": "a", "length": "l", "inertia": "J"}
_FRICTION = {"viscous": "k", "coulomb": "c", "quadratic": "b"}
"""The fields of numbers for each arm, with their short names."""


_PLANNED_SMOOTHING = 0.05
"""rad/s."""


class Friction(StrEnum):
    """Laws of friction in addition to the viscous one.

    They are in the order of their coefficients.
    """

    COULOMB = "coulomb"
    QUADRATIC = "quadratic"


@dataclass(frozen=True)
class ArmChainParameters(Settings):
    """Physical parameters of n arms, inner arm first, in SI units.

    Attributes:
        mass: masses (n,), kg.
        centre_of_mass: distances from the upper joints (n,), m.
        length: lengths (n,), m, the last for pictures only.
        inertia: moments of inertia about the centres of mass (n,), kg m².
        gravity: m/s².
        viscous: friction in each joint, by the relative rate (n,), N m s/rad.
        coulomb: dry friction in each joint (n,), N m; empty to leave it out of the equations.
        quadratic: drag on each arm over the squared speed of its centre of oscillation (n,), N s²/m², or empty.
        smoothing: rate below which these two fade, rad/s.
    """

    mass: Annotated[
        tuple[float, ...], Setting(above=0, most=LARGEST, unit="kg", usual=(5e-4, _HEAVIEST_ARM), help="Masses.")
    ]
    centre_of_mass: Annotated[
        tuple[float, ...],
        Setting(
            above=0,
            most=LARGEST,
            unit="m",
            usual=(1e-4, 4.0),
            help="Distances of the centres of mass from the upper joints.",
        ),
    ]
    length: Annotated[
        tuple[float, ...],
        Setting(above=0, most=LARGEST, unit="m", usual=(5e-3, 4.0), help="Lengths from joint to joint."),
    ]
    # A large inertia is judged by mass and length.
    inertia: Annotated[
        tuple[float, ...],
        Setting(
            least=0, most=1e9, unit="kg m²", usual=(1e-9, np.inf), help="Moments of inertia about the centres of mass."
        ),
    ]
    gravity: Annotated[
        float,
        Setting(
            above=0, most=LARGEST, unit="m/s²", key="acceleration", usual=(1.0, 30.0), help="Acceleration of gravity."
        ),
    ]
    viscous: Annotated[tuple[float, ...], Setting(least=0, most=LARGEST, unit="N m s/rad", help="Viscous friction.")]
    coulomb: Annotated[tuple[float, ...], Setting(least=0, most=LARGEST, unit="N m", help="Dry friction.")] = ()
    quadratic: Annotated[
        tuple[float, ...],
        Setting(least=0, most=LARGEST, unit="N s²/m²", help="Drag of the air at the centres of oscillation."),
    ] = ()
    smoothing: Annotated[
        float,
        Setting(
            above=0, most=LARGEST, unit="rad/s", usual=(1e-4, 20.0), help="Rate below which dry friction is smoothed."
        ),
    ] = 0.05

    def _check_together(self) -> None:
        """Raise an InputError unless there are 1 to `MOST_ARMS` arms and each field has one value for each arm."""
        if not self.mass:
            raise InputError("mass = []: a chain has at least one arm", key="mass")
        if self.count > MOST_ARMS:
            raise InputError(
                f"mass has {self.count} values: a chain has at most {MOST_ARMS} arms (each doubles its equilibria)",
                key="mass",
            )
        for name in ("centre_of_mass", "length", "inertia", "viscous", *self.friction):
            if len(values := getattr(self, name)) != self.count:
                sentence = f"{name} has {len(values)} values but mass has {self.count}; give one for each arm"
                raise InputError(sentence, key=name)

    @property
    def count(self) -> int:
        """Number of arms."""
        return len(self.mass)

    @property
    def friction(self) -> tuple[Friction, ...]:
        """Laws of friction in addition to the viscous one; they select the equations."""
        return tuple(law for law in Friction if getattr(self, law))

    def named(self) -> dict[str, tuple[float, str]]:
        """Return {name: (value, unit)} with the usual short names, for tables and for options that name a parameter.

        The names are m1, a1, l1, J1, g, k1 …
        """
        units = {name: leaf.bounds.unit.replace("²", "^2") for name, leaf in leaves_of(type(self)).items()}
        letters = {**_INERTIAL, "gravity": "g", **_FRICTION, **({"smoothing": "w"} if self.friction else {})}
        named_values: dict[str, tuple[float, str]] = {}
        for field, letter in letters.items():
            value = getattr(self, field)
            numbered = enumerate(value, start=1) if isinstance(value, tuple) else [("", value)]
            named_values |= {f"{letter}{number}": (entry, units[field]) for number, entry in numbered}
        return named_values

    def with_value(self, name: str, value: float) -> "ArmChainParameters":
        """Return the same arms with another value of one parameter, for searches over a range of it.

        Args:
            name: name of the parameter, as in `named`.
            value: its value, SI.

        Raises:
            InputError: an unknown name, or a value out of range.
        """
        check_choice("parameter", self.named(), name)
        letters = {**_INERTIAL, "gravity": "g", **_FRICTION, "smoothing": "w"}
        # A name is the letter of a field, followed by the number of an arm: "m1".
        field = next(field for field, letter in letters.items() if letter == name[0])
        if field in ("gravity", "smoothing"):
            return replace(self, **{field: value})
        values = list(getattr(self, field))
        values[int(name[1:]) - 1] = value
        return replace(self, **{field: tuple(values)})

    def base(self) -> Array:
        """Return the base parameters (n(n+1)/2 + 3n + …,), the parameters of the equations of motion.

        M row by row for j >= i, then G, S, friction.

        The friction is viscous (n,), then coulomb (n,) and quadratic (n,) if these arms have them, then their smoothing
        rate.
        """
        return self._base(lambda name: np.atleast_1d(getattr(self, name)))

    def decimal_base(self, decimals: Mapping[str, Sequence[Fraction]] | None = None) -> tuple[Fraction, ...]:
        """Return the base parameters without rounding, for searches in 113 bits and for proofs.

        Args:
            decimals: exact values of the fields (default: the shortest decimals that read as their doubles).
        """
        texts = decimals or {}

        def numbers(name: str) -> NDArray[Any]:
            """Return the field's exact values as an array of fractions."""
            shortest = [Fraction(repr(float(v))) for v in np.atleast_1d(getattr(self, name))]
            return np.array(texts.get(name, shortest), dtype=object)

        return tuple(Fraction(value) for value in self._base(numbers))

    def _base(self, numbers: Callable[[str], NDArray[Any]]) -> Any:
        """Return the base parameters M, G, S and friction in the arithmetic of the fields' `numbers`.

        `numbers` returns the values (n,) of a field by its name, as doubles or as fractions. The formulas of M, G and S
        are at the head of this module.
        """
        # Masses, centres, distances to the next joint (the lengths) and inertias.
        m, centre, joint, j = map(numbers, _INERTIAL)
        laws = [*self.friction, *(["smoothing"] if self.friction else [])]
        friction = np.concatenate([numbers(name) for name in ("viscous", *laws)])
        n = self.count
        # Mass of the arms that each arm carries.
        carried_mass = np.array([m[i + 1 :].sum() for i in range(n)])
        coupling = m * centre + carried_mass * joint
        inertia = [
            j[i] + m[i] * centre[i] ** 2 + carried_mass[i] * joint[i] ** 2 if i == k else coupling[k] * joint[i]
            for i in range(n)
            for k in range(i, n)
        ]
        return np.concatenate([inertia, numbers("gravity") * coupling, coupling, friction])

    @property
    def coulomb_acceleration(self) -> float:
        """Largest deceleration of the joints' rates by dry friction, rad/s², with the arms in line.

        It is the largest eigenvalue of M⁻¹ Rᵀ c R, R the map from the arms' rates to the joints' rates. Divided by the
        smoothing rate, it is the fastest decay, 1/s, of rates below the smoothing, which a sampled model must resolve.
        """
        if not self.coulomb:
            return 0.0
        relative = np.eye(self.count) - np.eye(self.count, k=-1)
        eigenvalues = np.linalg.eigvals(
            np.linalg.solve(self.mass_in_line, relative.T @ np.diag(self.coulomb) @ relative)
        )
        return float(eigenvalues.real.max())

    @property
    def mass_in_line(self) -> Array:
        """Mass matrix (n, n) with the arms in line, kg m², by the arms' rates."""
        n = self.count
        mass = np.zeros((n, n))
        mass[np.triu_indices(n)] = self.base()[: n * (n + 1) // 2]
        return mass + np.triu(mass, 1).T

    @property
    def torques(self) -> Array:
        """Gravity's largest torque (n,) on each arm and those that it carries, N m: the base parameters G."""
        n = self.count
        return self.base()[n * (n + 1) // 2 :][:n]

    @property
    def natural_time(self) -> float:
        """Period of the slowest swing of the hanging arms, s, a unit of time for arms of any size."""
        return float(2 * np.pi * np.sqrt(np.linalg.eigvals(self.mass_in_line / self.torques[:, None]).real.max()))

    def with_tip(self, mass: float) -> "ArmChainParameters":
        """Return the same arms with a small weight at the end of the outermost one, which can make feedback easier.

        Args:
            mass: mass of the weight, kg.
        """
        arm_mass, centre, end, inertia = self.mass[-1], self.centre_of_mass[-1], self.length[-1], self.inertia[-1]
        middle = (arm_mass * centre + mass * end) / (arm_mass + mass)
        inertia += arm_mass * (middle - centre) ** 2 + mass * (end - middle) ** 2
        changes = {"mass": arm_mass + mass, "centre_of_mass": middle, "inertia": inertia}
        return replace(self, **{name: (*getattr(self, name)[:-1], value) for name, value in changes.items()})

    def need(self, angles: Array) -> float | None:
        """Return the gain of the feedback that holds arms at an equilibrium, m/s² per rad; None if it is stable.

        The gentlest linear-quadratic feedback of an unstable mode v with growth s, v'Mv = 1, mirrors s to -s. Its gain
        per radian of the arm that moves most is 2 s² / (|v·b| max|v|), b the arms' coupling to the cart's acceleration.
        The largest of all modes is returned.

        Args:
            angles: angles (n,) of the equilibrium, rad.
        """
        from scipy.linalg import eigh

        # At an equilibrium, each arm hangs (sign 1) or stands (-1). A mode grows as exp(s t), with the square of s as
        # its eigenvalue.
        signs = np.cos(angles)
        weights = signs * self.torques
        growth_squares, modes = eigh(-np.diag(weights), self.mass_in_line * np.outer(signs, signs))
        coupled = np.abs(weights / self.gravity @ modes) * np.abs(modes).max(axis=0)
        unstable = growth_squares > 0
        with np.errstate(divide="ignore"):
            return float((2 * growth_squares[unstable] / coupled[unstable]).max()) if unstable.any() else None

    def scaled(self, length: float, time: float) -> "ArmChainParameters":
        """Return arms of another size whose motions are these arms' motions at another pace, with the same masses.

        Args:
            length: factor on lengths.
            time: factor on times.
        """
        # Energies and torques scale as length²/time², rates as 1/time.
        factors = {
            "centre_of_mass": length,
            "length": length,
            "inertia": length**2,
            "viscous": length**2 / time,
            "coulomb": (length / time) ** 2,
            "quadratic": 1 / length,
        }
        values = {name: tuple(by * value for value in getattr(self, name)) for name, by in factors.items()}
        return replace(self, gravity=self.gravity * length / time**2, smoothing=self.smoothing / time, **values)

    def frictionless(self) -> "ArmChainParameters":
        """Return the same arms without friction, as for growth rates that friction must not hide."""
        return replace(self, viscous=(0.0,) * self.count, coulomb=(), quadratic=())

    def viscous_only(self) -> "ArmChainParameters":
        """Return the same arms with viscous friction only, whose base parameters have the fewest entries."""
        return replace(self, coulomb=(), quadratic=())

    def planned(self) -> "ArmChainParameters":
        """Return the arms for planning, with dry friction smooth enough for collocation.

        An arm that reverses at 50 rad/s² takes 2 ms for 0.1 rad/s. With less smoothing the error between nodes stays
        above the tolerance until intervals are a tenth of a millisecond long.
        """
        return replace(self, smoothing=max(self.smoothing, _PLANNED_SMOOTHING))

    def with_friction(self, factor: float) -> "ArmChainParameters":
        """Return the same arms with scaled friction, for a plant that differs from its model.

        Args:
            factor: factor on every coefficient of friction.
        """
        return replace(self, **{name: tuple(factor * v for v in getattr(self, name)) for name in _FRICTION})

    def mismatched(self, fraction: float, random: np.random.Generator) -> "ArmChainParameters":
        """Return arms with random errors relative to these.

        These arms are a possible plant for this model. Each mass, centre, length and inertia is multiplied by an
        independent uniform 1 ± fraction; each friction coefficient by 1 ± 5 fraction, but never below zero.

        Args:
            fraction: largest relative error of inertial parameters.
            random: generator, which is advanced.
        """

        def vary(values: tuple[float, ...], by: float) -> tuple[float, ...]:
            """Return the values times independent uniform factors from 1 - by to 1 + by, none below zero."""
            factors = np.maximum(1 + random.uniform(-by, by, len(values)), 0.0)
            return tuple(float(v) for v in np.asarray(values) * factors)

        fraction += 0.0  # Minus zero would give an empty range.
        # Other friction than viscous is drawn last, so that a seed gives the same arms with and without it.
        spread = dict.fromkeys(_INERTIAL, fraction) | dict.fromkeys(_FRICTION, 5 * fraction)
        return replace(self, **{name: vary(getattr(self, name), by) for name, by in spread.items()})


class Level(StrEnum):
    """Modelled part of the bench.

    Each level contains the one above it in this list.
    """

    CONSERVATIVE = "conservative"
    DISSIPATIVE = "dissipative"
    CART = "cart"


@dataclass(frozen=True)
class ChainEnergies(Brief):
    """The chain's energies as functions, with the cart last.

    The functions are of (position (n+1,), velocity (n+1,), parameters).

    Attributes:
        lagrangian: kinetic minus potential energy, J.
        dissipation: dissipation function, W.
        parameters: symbols of the base parameters in the functions.
        coupling: their part S (n,).
    """

    lagrangian: Energy
    dissipation: Energy
    parameters: ca.SX
    coupling: ca.SX


@cache
def chain_energies(count: int, *, friction: tuple[Friction, ...] = ()) -> ChainEnergies:
    """Return Lagrangian and dissipation of arms on a free cart, of which equations of all levels are derived.

    The cart has 1 kg.

    Args:
        count: number n of arms.
        friction: laws in addition to the viscous one.
    """
    n = count
    inertias = ca.SX.sym("M", n * (n + 1) // 2)
    weights = ca.SX.sym("G", n)
    couplings = ca.SX.sym("S", n)
    viscous = ca.SX.sym("k", n)
    laws = {law: ca.SX.sym(law.value, n) for law in Friction if law in friction}
    smoothing = ca.SX.sym("w", 1 if laws else 0)
    parameters = ca.vertcat(inertias, weights, couplings, viscous, *laws.values(), smoothing)
    index = {(i, j): c for c, (i, j) in enumerate((i, j) for i in range(n) for j in range(i, n))}

    def lagrangian(q: ca.SX, v: ca.SX, _: ca.SX) -> ca.SX:
        """Return L of the module's head at positions q and velocities v (n+1,), the cart last."""
        kinetic = v[n] ** 2 / 2
        for i in range(n):
            kinetic += inertias[index[i, i]] * v[i] ** 2 / 2 + couplings[i] * ca.cos(q[i]) * v[i] * v[n]
            for j in range(i + 1, n):
                kinetic += inertias[index[i, j]] * ca.cos(q[i] - q[j]) * v[i] * v[j]
        return kinetic + sum(weights[i] * ca.cos(q[i]) for i in range(n))

    def dissipation(q: ca.SX, v: ca.SX, _: ca.SX) -> ca.SX:
        """Return the dissipation function D of the module's head at positions q and velocities v (n+1,)."""
        relative = [v[i] - v[i - 1] if i else v[0] for i in range(n)]
        total = sum((viscous[i] * relative[i] ** 2 / 2 for i in range(n)), ca.SX(0))
        if Friction.COULOMB in laws:
            total += sum(laws[Friction.COULOMB][i] * ca.sqrt(relative[i] ** 2 + smoothing**2) for i in range(n))
        if Friction.QUADRATIC in laws:
            for i in range(n):
                # M_ji = S_i l_j for the arms within, so this is the velocity of the point at λ_i = M_ii / S_i.
                along = [inertias[index[j, i]] / couplings[i] * v[j] for j in range(i + 1)]
                across = sum((along[j] * ca.cos(q[j]) for j in range(i + 1)), v[n])
                up = sum((along[j] * ca.sin(q[j]) for j in range(i + 1)), ca.SX(0))
                faded = smoothing * inertias[index[i, i]] / couplings[i]
                total += laws[Friction.QUADRATIC][i] * ca.sqrt(across**2 + up**2 + faded**2) ** 3 / 3
        return total

    return ChainEnergies(lagrangian, dissipation, parameters, couplings)


@cache
def arm_chain_equations(count: int, level: Level, *, friction: tuple[Friction, ...] = ()) -> Equations:
    """Return the equations of arms at a level.

    The base parameters are symbols. The state has angles, rates and, at level cart, cart position and velocity. The
    input is the cart's acceleration.

    Args:
        count: number n of arms.
        level: modelled part of the bench.
        friction: laws in addition to the viscous one, see `ArmChainParameters.friction`; others are left out of the
            equations.
    """
    chain = chain_energies(count, friction=friction)
    conservative = level is Level.CONSERVATIVE
    dissipation: Energy = (lambda *_: ca.SX(0)) if conservative else chain.dissipation
    parts = mechanics(chain.lagrangian, dissipation, free=count, prescribed=1, parameters=chain.parameters)
    equations = state_equations(parts, with_cart=level is Level.CART)
    if Friction.COULOMB not in friction:
        return equations
    # Linearised equations get a wider smoothing, such that no joint's viscous damping c/w exceeds `MOST_DAMPING`.
    # The coefficients c follow M, G, S and the viscous ones; the smoothing rate is the last parameter.
    p, first = equations.parameters, count * (count + 1) // 2 + 3 * count
    widths = [p[first + i] / (MOST_DAMPING * scale) for i, scale in enumerate(damping_scales(p, count))]
    return replace(equations, linear_parameters=ca.vertcat(p[:-1], reduce(ca.fmax, widths, p[-1])))


MOST_DAMPING = 0.2
"""Largest viscous damping that replaces dry friction in linearised equations, over √(G M) of each joint.

Coulomb friction c acts on a rate of amplitude A as viscous friction 4 c/(π A). Its slope at zero, c over the
smoothing, corresponds to amplitudes below those of feedback. At twice this limit Up-Up is no longer controllable.
"""


def damping_scales(base: Any, count: int) -> list[Any]:
    """Return √(G_i M_ii) of each joint, N m s/rad, a natural unit for its damping: with twice it, the arm creeps.

    Args:
        base: base parameters, numbers or symbols.
        count: number of arms.
    """
    # G follows M, whose rows have M_ij for j >= i; `at` is the place of M_ii.
    first = count * (count + 1) // 2
    return [(base[first + i] * base[int(at)]) ** 0.5 for i, at in enumerate(np.cumsum([0, *range(count, 1, -1)]))]


def equations_of(arms: ArmChainParameters, level: Level) -> Equations:
    """Return the equations at a level for `arms.base()`.

    The equations have the friction laws of these arms.

    Args:
        arms: parameters of the arms.
        level: see `arm_chain_equations`.
    """
    return arm_chain_equations(arms.count, level, friction=arms.friction)


def pendulum_system(name: str, parameters: ArmChainParameters) -> System:
    """Return the frictionless pendulum on a fixed pivot as a system, for the search of orbits, tubes and connections.

    Saddles are named by the arms' directions, inner arm first. For two arms the sections are those of the paper. The
    turning arm passes straight down: "outer-down", θ₂ = 2πk, about Down-Up and "inner-down", θ₁ = 2πk, about Up-Down.
    Between different saddles both arms align: "aligned", θ₁ - θ₂ = 2πk.

    Args:
        name: name of the system.
        parameters: parameters of the arms; friction is ignored.
    """
    n = parameters.count
    base = parameters.viscous_only().base()
    weights = base[n * (n + 1) // 2 : n * (n + 1) // 2 + n]
    sections: dict[str, Section] = {}
    between: dict[tuple[str, str], str] = {}
    if n == 2:
        # By name: title, the section's normal, the coordinate of an arm that moves along it, and the direction along
        # it.
        rows = {
            "outer-down": ("θ₂ = 2πk", (0.0, 1.0), (1.0, 0.0), (1.0, 0.0)),
            "inner-down": ("θ₁ = 2πk", (1.0, 0.0), (0.0, 1.0), (0.0, 1.0)),
            "aligned": ("θ₁ = θ₂ + 2πk", (1.0, -1.0), (1.0, 0.0), (1.0, 1.0)),
        }
        for key, (title, normal, measure, along) in rows.items():
            sections[key] = Section(title, (*normal, 0.0, 0.0), (*measure, 0.0, 0.0), along, period=2 * np.pi)
        between = {("down-up", "down-up"): "outer-down", ("up-down", "up-down"): "inner-down"}
        between |= dict.fromkeys([("down-up", "up-down"), ("up-down", "down-up")], "aligned")
    angle_signs, rate_signs = np.ones(n), np.ones(n)
    return described_system(
        name,
        arm_chain_equations(n, Level.CONSERVATIVE),
        base,
        [f"angle_{i + 1}" for i in range(n)],
        {"-".join(words): [np.pi * (w == "up") for w in words] for words in product(("down", "up"), repeat=n)},
        periods=(2 * np.pi,) * n,
        # Time can be reversed with the rates, and also with the angles instead. Orbits start at a positive rate of the
        # inner arm.
        reversers=(
            np.diag(np.concatenate([angle_signs, -rate_signs])),
            np.diag(np.concatenate([-angle_signs, rate_signs])),
        ),
        orientation=np.eye(2 * n)[n],
        scale=(np.pi,) * n + (10.0,) * n,
        energy_scale=float(2 * weights.sum()),
        sections=sections,
        between=between,
        section_scale=1.0,
        si=True,
    )


def unit_name(count: int) -> str:
    """Return the name of the base parameter C that divides the others in `base_ratios`.

    Args:
        count: number of arms.
    """
    return "M12" if count > 1 else "M11"


def ratio_names(arms: ArmChainParameters) -> tuple[str, ...]:
    """Return the names of `base_ratios`, in order, such as M11/M12, G1/M12 and viscous_1/M12.

    Args:
        arms: arms with their laws of friction.
    """
    n, unit = arms.count, unit_name(arms.count)
    inertial = [f"M{i}{i}/{unit}" for i in range(1, n + 1) if n > 1] + [f"G{i}/{unit}" for i in range(1, n + 1)]
    lengths = [f"l{i}" for i in range(2, n)]
    return (*inertial, *lengths, *(f"{law}_{i}/{unit}" for law in ("viscous", *arms.friction) for i in range(1, n + 1)))


def inertial_count(count: int) -> int:
    """Return the number of ratios other than friction, which come first in `base_ratios`.

    The number is 3n-2.

    Args:
        count: number n of arms.
    """
    return 3 * count - 2


def base_ratios(arms: ArmChainParameters) -> Array:
    """Return the identifiable ratios (m,), in SI units, in the order at the head of this module.

    Swings on a clamped or driven cart identify them.

    Args:
        arms: parameters of the arms.
    """
    n, base = arms.count, arms.base()
    # Places of M_ii, as M is stored row by row for j >= i.
    diagonal = np.cumsum([0, *range(n, 1, -1)])
    weights = base[n * (n + 1) // 2 :][:n]
    friction = [value for law in ("viscous", *arms.friction) for value in getattr(arms, law)]
    unit = _unit(base, n)
    inertial = [*(base[diagonal[: n if n > 1 else 0]] / unit), *(weights / unit)]
    return np.array([*inertial, *arms.length[1 : n - 1], *(np.array(friction) / unit)])


def _unit(base: Array, count: int) -> float:
    """Return the base parameter C that divides the others in `base_ratios`, kg m²: M_12, or M_11 of a single arm.

    `base` are the base parameters of `count` arms.
    """
    return float(base[1] if count > 1 else base[0])


def base_from_ratios(ratios: Any, arms: ArmChainParameters) -> list[Any]:
    """Return the base parameters with C = 1 as a list, the inverse of `base_ratios`.

    A fit takes the ratios as unknowns, and these are the parameters of its equations.

    Args:
        ratios: ratios (m,) of `base_ratios`, numbers or symbols.
        arms: chain with the gravity, friction laws and smoothing rate.
    """
    n = arms.count
    values = [ratios[k] for k in range(len(ratio_names(arms)))]
    diagonal, remaining = (values[:n], values[n:]) if n > 1 else ([1.0], values)
    weights, remaining = remaining[:n], remaining[n:]
    coupling = [weight / arms.gravity for weight in weights]
    lengths, friction = remaining[: max(n - 2, 0)], remaining[max(n - 2, 0) :]
    if n > 1:
        # The first length is g C/G_2, and S_2 is G_2/g.
        lengths = [1.0 / coupling[1], *lengths]
    inertia = [diagonal[i] if i == j else coupling[j] * lengths[i] for i in range(n) for j in range(i, n)]
    return [*inertia, *weights, *coupling, *friction, *([arms.smoothing] if arms.friction else [])]


def nearest_arms(ratios: Array, start: ArmChainParameters) -> ArmChainParameters:
    """Return the arms with given ratios whose masses, centres, lengths and inertias differ least from those of `start`.

    The logarithms of the factors on the values of `start` are found by Newton's method, in which each step is the
    shortest one. Negative friction becomes zero. An inertia of zero stays zero, and gravity and the last length are
    unchanged.

    Args:
        ratios: ratios (m,) of `base_ratios`, SI units.
        start: first guess, whose laws of friction are kept.

    Raises:
        GoalMissed: no such arms are near, for example because a ratio is not positive.
    """
    n, count = start.count, inertial_count(start.count)
    targets = np.asarray(ratios, dtype=float)[:count]
    field_sizes = {"mass": n, "centre_of_mass": n, "length": n - 1, "inertia": n}
    start_values = np.concatenate([np.asarray(getattr(start, name))[:size] for name, size in field_sizes.items()])
    free = start_values > 0

    def arms_at(logs: Array) -> ArmChainParameters:
        """Return the arms whose positive values are those of `start` times exp(logs)."""
        values = start_values.copy()
        values[free] *= np.exp(logs)
        parts = dict(zip(field_sizes, np.split(values, np.cumsum(list(field_sizes.values()))[:-1]), strict=True))
        fields = {name: tuple(float(v) for v in part) for name, part in parts.items()}
        return replace(start, **fields | {"length": (*fields["length"], start.length[-1])})

    def log_errors(logs: Array) -> Array:
        """Return the logarithms of the inertial ratios over their targets, zero at the solution.

        `logs` are the unknowns of Newton's method, see `arms_at`.
        """
        return np.log(base_ratios(arms_at(logs))[:count] / targets)

    no_arms_near = GoalMissed(
        f"no arms near the starting model's have the ratios {np.array2string(targets, precision=4)}; start from a "
        f"model nearer to the rig"
    )
    if not np.all(targets > 0) or not np.isfinite(ratios).all():
        raise no_arms_near
    logs, difference, tolerance = np.zeros(int(free.sum())), 1e-6, 1e-13
    for _ in range(100):
        error = log_errors(logs)
        slope: Array = np.array(
            [(log_errors(logs + e) - log_errors(logs - e)) / (2 * difference) for e in difference * np.eye(len(logs))]
        ).T
        # The least-norm solution of the linearised equations.
        next_logs: Array = np.linalg.lstsq(slope, slope @ logs - error, rcond=None)[0].astype(np.float64)
        # A factor of exp(5) is not near.
        if not np.isfinite(next_logs).all() or np.abs(next_logs).max() > 5:
            raise no_arms_near
        change = np.abs(next_logs - logs).max()
        logs = next_logs
        if change < tolerance or (np.abs(error).max() < tolerance and change < 1e-9):
            break
    if np.abs(log_errors(logs)).max() > 1e-10:
        raise no_arms_near
    arms = arms_at(logs)
    friction = np.maximum(np.asarray(ratios)[count:], 0.0).reshape(-1, n) * _unit(arms.base(), n)
    names = ("viscous", *start.friction)
    return replace(arms, **{name: tuple(map(float, row)) for name, row in zip(names, friction, strict=True)})


def with_laws(arms: ArmChainParameters, laws: tuple[Friction, ...]) -> ArmChainParameters:
    """Return the same arms with other laws of friction, as identification tries them.

    Args:
        arms: parameters of the arms.
        laws: laws in addition to the viscous one; coefficients of new ones are zero.
    """
    zero = (0.0,) * arms.count
    return replace(arms, **{law.value: (getattr(arms, law) or zero) if law in laws else () for law in Friction})


_TRIES = 20


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of arms, as an identification leaves it in the model's file.

    Attributes:
        names: names of the f ratios of `base_ratios`.
        covariance: covariance of these ratios, row by row.
    """

    names: tuple[str, ...]
    covariance: tuple[float, ...]

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The covariance of the ratios (f, f)."""
        return np.reshape(self.covariance, (len(self.names), len(self.names)))

    def check(self, arms: ArmChainParameters) -> None:
        """Raise an InputError unless this is a covariance of these arms' ratios.

        Args:
            arms: arms with f ratios.

        Raises:
            InputError: an invalid key, with the allowed values.
        """
        expected = ratio_names(arms)
        if self.names != expected:
            raise InputError(f"names = {list(self.names)}: must be {list(expected)} for these arms")
        if len(self.covariance) != len(expected) ** 2:
            raise InputError(
                f"covariance has {len(self.covariance)} numbers: must have {len(expected) ** 2}, one row for each name"
            )
        scale = np.sqrt(np.maximum(np.diag(self.matrix), 1e-300))
        scaled = self.matrix / np.outer(scale, scale)
        if not np.allclose(scaled, scaled.T, atol=1e-9) or np.linalg.eigvalsh(scaled)[0] < -1e-6:
            raise InputError(
                "covariance is invalid: it must be symmetric, with no variance below zero in any direction"
            )

    def drawn(self, arms: ArmChainParameters, random: np.random.Generator, *, scale: float = 1.0) -> ArmChainParameters:
        """Draw arms from the covariance about given ones, as the plant of a simulated run.

        Negative friction becomes zero. Impossible ratios, such as a negative inertia, are drawn again.

        Args:
            arms: mean of the draws.
            random: generator, which is advanced.
            scale: factor on the standard errors.

        Raises:
            GoalMissed: all draws are impossible, for example because the uncertainty is as large as its value.
        """
        ratios = base_ratios(arms)
        variances, axes = np.linalg.eigh(self.matrix)
        for _ in range(_TRIES):
            deviation = axes @ (np.sqrt(np.maximum(variances, 0.0)) * random.standard_normal(len(variances)))
            try:
                return nearest_arms(ratios + scale * deviation, arms)
            except GoalMissed:
                continue
        raise GoalMissed(
            f"of {_TRIES} draws from the model's uncertainty, its standard errors times {scale:g}, none gives "
            f"possible arms; use a smaller factor"
        )


_BEYOND = 10.0
"""Ratio of centre to length that indicates another unit, such as mm for m."""
_HEAVIEST = 100.0
"""Ratio of inertia to m l² that indicates another unit, such as g cm² for kg m²."""
_STUCK = 1000.0
"""Ratio of friction to the limit of a swing that indicates another unit."""
_HOLLOW = 0.02
"""Share of the largest inertia m a (l - a) that only point masses fall below; shipped models have at least 0.04."""
_AT_THE_END = 0.95
"""Share of the length beyond which a centre indicates a mass at the rod's end."""


def oddities(arms: ArmChainParameters) -> tuple[str, ...]:
    """Return a sentence on each unusual parameter of an arm.

    It begins with the parameter's name.

    Args:
        arms: parameters of the arms.

    Raises:
        InputError: a parameter is beyond the bounds of any bench.
    """
    leaves = leaves_of(ArmChainParameters)
    remarks = list(leaves["gravity"].bounds.oddities("gravity", arms.gravity))
    if arms.friction:
        remarks += leaves["smoothing"].bounds.oddities("smoothing", arms.smoothing)
    for arm in range(arms.count):
        slips = list(_slips(arms, arm))
        body = list(_body(arms, arm))
        # A number in another unit makes the others unusual too.
        remarks += [*(slips or body), *_friction(arms, arm)]
    return tuple(remarks)


_HOLLOWEST = 1e-3
"""Least moment of inertia of a likely unit, over mass times length squared."""
_LIKELY = 0.1
"""Ratio of an arm's inertia to m l²; a uniform rod has 1/12, and an arm with a weight at its end more."""
_HEAVY = 40.0
"""kg/m: a round bar of steel 8 cm thick."""


def _slips(arms: ArmChainParameters, arm: int) -> Iterator[str]:
    """Yield sentences on parameters of an arm, by its index, that seem to be in another unit, such as g for kg.

    A sentence is a warning for the user, and the model is used nevertheless.
    """
    of_arm = f" of arm {arm + 1}"
    leaves = leaves_of(ArmChainParameters)
    for name in _INERTIAL:
        bounds = leaves[name].bounds
        for sentence in bounds.oddities(name, getattr(arms, name)[arm]):
            yield sentence.replace(f" {bounds.unit} is ", f" {bounds.unit}{of_arm} is ", 1)
    mass, length = arms.mass[arm], arms.length[arm]
    if _HEAVY * length < mass <= _HEAVIEST_ARM:
        yield (
            f"mass = {mass:g} kg{of_arm} is much for a length of {length:g} m; is it given in g ({1e-3 * mass:.3g} kg)?"
        )


def _body(arms: ArmChainParameters, arm: int) -> Iterator[str]:
    """Yield sentences on the body of one arm, by its index, that hardly exists.

    Its centre is beyond its end, or its inertia is too large or too small for its mass and length.

    Raises:
        InputError: so far off that only another unit explains it.
    """
    mass, centre, length, inertia = (
        getattr(arms, name)[arm] for name in ("mass", "centre_of_mass", "length", "inertia")
    )
    of_arm = f"of arm {arm + 1}"
    if centre > length * (1 + 1e-9):
        lengths_away = f"{centre / length:.3g} times its length of {length:g} m"
        text = f"centre_of_mass = {centre:g} m {of_arm} is {lengths_away} from its joint"
        if centre > _BEYOND * length:
            raise InputError(f"{text}; give both in metres, the centre from the arm's joint", key="centre_of_mass")
        yield f"{text}, beyond its end; is that intended?"
    farthest = max(centre, length)
    largest_inertia = mass * farthest**2
    if inertia > largest_inertia:
        mean_distance = np.sqrt(inertia / mass)
        text = (
            f"inertia = {inertia:g} kg m² {of_arm} puts its mass of {mass:g} kg {mean_distance:.3g} m from its centre "
            f"in the mean, and the arm is {length:g} m long"
        )
        if inertia > _HEAVIEST * largest_inertia:
            in_other_units = {name: factor * inertia for name, factor in OTHER_UNITS["kg m²"].items()}
            likely = min(
                in_other_units, key=lambda name: abs(np.log(in_other_units[name] / (_LIKELY * largest_inertia)))
            )
            is_likely = _HOLLOWEST < in_other_units[likely] / largest_inertia < 1
            remedy = (
                f"is it given in {likely} ({in_other_units[likely]:.3g} kg m²)?"
                if is_likely
                else "give it in kg m², about the centre of mass"
            )
            raise InputError(f"{text}; {remedy}", key="inertia")
        yield f"{text}; is that intended, about the centre of mass?"
    between_ends = mass * centre * (length - centre)
    if centre < _AT_THE_END * length and inertia < _HOLLOW * between_ends:
        yield (
            f"inertia = {inertia:g} kg m² {of_arm} is that of a point mass {centre:g} m along a weightless rod of "
            f"{length:g} m, but a uniform rod of {mass:g} kg has {mass * length**2 / 12:.3g} kg m², and with this "
            f"centre at most {between_ends:.3g} fits between joint and end; is a point mass intended?"
        )


def _friction(arms: ArmChainParameters, arm: int) -> Iterator[str]:
    """Yield sentences on friction so strong that the arm cannot swing, by the limits at the head of this module.

    `arm` is the index of one arm.

    Raises:
        InputError: so strong that only another unit explains it.
    """
    # I, G and S of this arm, from the base parameters M (row by row for j >= i), G, S and friction.
    count, base = arms.count, arms.base()
    about_joint = base[np.cumsum([0, *range(count, 1, -1)])[arm]]
    weight, coupling = base[count * (count + 1) // 2 :].reshape(-1)[[arm, count + arm]]
    oscillation_length = about_joint / coupling
    torque = f"gravity's torque on it of at most {weight:.3g} N m"
    laws = {
        "viscous": (2 * np.sqrt(weight * about_joint), "N m s/rad", lambda k: (
            f"makes it creep instead of swing: {torque} turns it at {weight / k:.2g} rad/s at the fastest")),
        "coulomb": (weight, "N m", lambda _: f"holds it at any angle, against {torque}"),
        "quadratic": (weight / (4 * arms.gravity * oscillation_length**2), "N s²/m²", lambda b: (
            f"brakes it: {torque} moves it at {np.sqrt(weight / (b * oscillation_length)):.2g} m/s at the fastest")),
    }  # fmt: skip
    for law, (limit, unit, effect) in laws.items():
        values = getattr(arms, law)
        if values and values[arm] > limit:
            value = values[arm]
            text = f"{law} = {value:g} {unit} of arm {arm + 1} {effect(value)}"
            if value > _STUCK * limit:
                raise InputError(f"{text}; no bench has this value: give it in {unit}", key=law)
            yield f"{text}; is that intended?"
