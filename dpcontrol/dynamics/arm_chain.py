"""A planar chain of n arms on a cart: one Lagrangian, one dissipation function, the levels made from them.

    L = ½ Σ M_ij cos(θ_i-θ_j) ω_i ω_j + Σ S_i cos θ_i ω_i ẋ + ½ ẋ² + Σ G_i cos θ_i
    D = Σ ½ k_i ρ_i² + c_i √(ρ_i² + w²) + ⅓ b_i (v_i² + (λ_i w)²)^{3/2},      ρ_i = ω_i - ω_{i-1}

in the base parameters of `dpcontrol.dynamics.parameters`. The cart's own inertia does not matter where its
acceleration is the input; ½ ẋ² stands in for it. Besides viscous friction k a joint may have Coulomb friction c, and
each arm the air's drag b v², where v_i is the speed of the arm's centre of oscillation, λ_i = M_ii/S_i from its joint,
in air at rest: on a free swing the drag at this true speed explains the data and a torque b ρ|ρ| in the joint does not.
The smoothing rate w keeps both analytic, which Taylor's method and collocation need; unlike tanh(ρ/w) through
log cosh, √ cannot overflow at high rates.

Sources: Armstrong-Hélouvry, Dupont, Canudas de Wit, A survey of models ... of machines with friction (1994), section
2; Batchelor, An introduction to fluid dynamics (1967), section 5.11, for the drag.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import cache

import casadi as ca

from dpcontrol.dynamics.equations import Equations, state_equations
from dpcontrol.dynamics.lagrangian import Energy, mechanics
from dpcontrol.dynamics.parameters import ArmChainParameters, Friction


class Level(StrEnum):
    """How much of the bench a scene models; each level contains the one above it in this list."""

    CONSERVATIVE = "conservative"
    DISSIPATIVE = "dissipative"
    CART = "cart"


@dataclass(frozen=True)
class ChainEnergies:
    """The chain's energies as functions of (position (n+1,), velocity (n+1,), parameters), the cart last.

    parameters: the base parameters' symbols, which the functions hold already; coupling (n,): S among them.
    """

    lagrangian: Energy
    dissipation: Energy
    parameters: ca.SX
    coupling: ca.SX


@cache
def chain_energies(count: int, *, friction: tuple[Friction, ...] = ()) -> ChainEnergies:
    """Return Lagrangian and dissipation function of `count` arms on a cart of mass 1 kg that feels no force."""
    n = count
    m = ca.SX.sym("M", n * (n + 1) // 2)
    g = ca.SX.sym("G", n)
    s = ca.SX.sym("S", n)
    k = ca.SX.sym("k", n)
    laws = {law: ca.SX.sym(law.value, n) for law in Friction if law in friction}
    smoothing = ca.SX.sym("w", 1 if laws else 0)
    parameters = ca.vertcat(m, g, s, k, *laws.values(), smoothing)
    index = {(i, j): c for c, (i, j) in enumerate((i, j) for i in range(n) for j in range(i, n))}

    def lagrangian(q: ca.SX, v: ca.SX, _: ca.SX) -> ca.SX:
        kinetic = v[n] ** 2 / 2
        for i in range(n):
            kinetic += m[index[i, i]] * v[i] ** 2 / 2 + s[i] * ca.cos(q[i]) * v[i] * v[n]
            for j in range(i + 1, n):
                kinetic += m[index[i, j]] * ca.cos(q[i] - q[j]) * v[i] * v[j]
        return kinetic + sum(g[i] * ca.cos(q[i]) for i in range(n))

    def dissipation(q: ca.SX, v: ca.SX, _: ca.SX) -> ca.SX:
        relative = [v[i] - v[i - 1] if i else v[0] for i in range(n)]
        total = sum((k[i] * relative[i] ** 2 / 2 for i in range(n)), ca.SX(0))
        if Friction.COULOMB in laws:
            total += sum(laws[Friction.COULOMB][i] * ca.sqrt(relative[i] ** 2 + smoothing**2) for i in range(n))
        if Friction.QUADRATIC in laws:
            for i in range(n):
                # M_ji = S_i l_j for the arms within, so this is the velocity of the point at λ_i = M_ii / S_i.
                along = [m[index[j, i]] / s[i] * v[j] for j in range(i + 1)]
                across = sum((along[j] * ca.cos(q[j]) for j in range(i + 1)), v[n])
                up = sum((along[j] * ca.sin(q[j]) for j in range(i + 1)), ca.SX(0))
                faded = smoothing * m[index[i, i]] / s[i]
                total += laws[Friction.QUADRATIC][i] * ca.sqrt(across**2 + up**2 + faded**2) ** 3 / 3
        return total

    return ChainEnergies(lagrangian, dissipation, parameters, s)


@cache
def arm_chain_equations(count: int, level: Level, *, friction: tuple[Friction, ...] = ()) -> Equations:
    """Return the equations of `count` arms at `level`, with the base parameters as symbols.

    friction: the laws besides the viscous one, as `ArmChainParameters.friction` gives them; those that are not named
    are not in the equations at all. State: angles, rates, then (level cart) cart position and velocity; the input is
    the cart's acceleration.
    """
    chain = chain_energies(count, friction=friction)
    conservative = level is Level.CONSERVATIVE
    dissipation: Energy = (lambda *_: ca.SX(0)) if conservative else chain.dissipation
    parts = mechanics(chain.lagrangian, dissipation, free=count, prescribed=1, parameters=chain.parameters)
    return state_equations(parts, with_cart=level is Level.CART)


def equations_of(arms: ArmChainParameters, level: Level) -> Equations:
    """Return the equations at `level` that go with `arms.base()`, with the friction laws that these arms have."""
    return arm_chain_equations(arms.count, level, friction=arms.friction)
