"""A planar chain of n arms on a cart: one Lagrangian, one dissipation function, the levels made from them.

    L = ½ Σ M_ij cos(θ_i-θ_j) ω_i ω_j + Σ S_i cos θ_i ω_i ẋ + ½ ẋ² + Σ G_i cos θ_i
    D = Σ ½ k_i ρ_i² + c_i r_i + ⅓ b_i r_i³,      ρ_i = ω_i - ω_{i-1},   r_i = √(ρ_i² + w²)

in the base parameters of `dpcontrol.dynamics.parameters`. The cart's own inertia does not matter where its
acceleration is the input; ½ ẋ² stands in for it. Besides viscous friction k a joint may have Coulomb friction, whose
torque c ρ/r is c beyond a few w, and quadratic drag b ρ r. The smoothing rate w keeps both analytic, which Taylor's
method and collocation need; unlike tanh(ρ/w) through log cosh, √ cannot overflow at high rates.

Source: Armstrong-Hélouvry, Dupont, Canudas de Wit, A survey of models ... of machines with friction (1994), section 2.
"""

from enum import StrEnum
from functools import cache

import casadi as ca

from dpcontrol.dynamics.equations import Equations, state_equations
from dpcontrol.dynamics.lagrangian import mechanics
from dpcontrol.dynamics.parameters import ArmChainParameters, Friction


class Level(StrEnum):
    """How much of the bench a scene models; each level contains the one above it in this list."""

    CONSERVATIVE = "conservative"
    DISSIPATIVE = "dissipative"
    CART = "cart"


@cache
def arm_chain_equations(count: int, level: Level, *, friction: tuple[Friction, ...] = ()) -> Equations:
    """Return the equations of `count` arms at `level`, with the base parameters as symbols.

    friction: the laws besides the viscous one, as `ArmChainParameters.friction` gives them; those that are not named
    are not in the equations at all. State: angles, rates, then (level cart) cart position and velocity; the input is
    the cart's acceleration.
    """
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
        if level is Level.CONSERVATIVE:
            return ca.SX(0)
        relative = [v[i] - v[i - 1] if i else v[0] for i in range(n)]
        total = sum((k[i] * relative[i] ** 2 / 2 for i in range(n)), ca.SX(0))
        for law, coefficient in laws.items():
            for i in range(n):
                smooth = ca.sqrt(relative[i] ** 2 + smoothing**2)
                total += coefficient[i] * (smooth if law is Friction.COULOMB else smooth**3 / 3)
        return total

    parts = mechanics(lagrangian, dissipation, free=n, prescribed=1, parameters=parameters)
    return state_equations(parts, with_cart=level is Level.CART)


def equations_of(arms: ArmChainParameters, level: Level) -> Equations:
    """Return the equations at `level` that go with `arms.base()`, with the friction laws that these arms have."""
    return arm_chain_equations(arms.count, level, friction=arms.friction)
