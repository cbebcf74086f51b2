"""A planar chain of n arms on a cart: one Lagrangian, one dissipation function, the levels made from them.

    L = ½ Σ M_ij cos(θ_i-θ_j) ω_i ω_j + Σ S_i cos θ_i ω_i ẋ + ½ ẋ² + Σ G_i cos θ_i,      D = ½ Σ k_i (ω_i-ω_{i-1})²

in the base parameters of `dpcontrol.dynamics.parameters`. The cart's own inertia does not matter where its
acceleration is the input; ½ ẋ² stands in for it.
"""

from enum import StrEnum
from functools import cache

import casadi as ca

from dpcontrol.dynamics.equations import Equations, state_equations
from dpcontrol.dynamics.lagrangian import mechanics


class Level(StrEnum):
    """How much of the bench a scene models; each level contains the one above it in this list."""

    CONSERVATIVE = "conservative"
    DISSIPATIVE = "dissipative"
    CART = "cart"


@cache
def arm_chain_equations(count: int, level: Level) -> Equations:
    """Return the equations of `count` arms at `level`, with the base parameters as symbols.

    State: angles, rates, then (level cart) cart position and velocity; the input is the cart's acceleration.
    """
    n = count
    m = ca.SX.sym("M", n * (n + 1) // 2)
    g = ca.SX.sym("G", n)
    s = ca.SX.sym("S", n)
    k = ca.SX.sym("k", n)
    parameters = ca.vertcat(m, g, s, k)
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
        return sum((k[i] * relative[i] ** 2 / 2 for i in range(n)), ca.SX(0))

    parts = mechanics(lagrangian, dissipation, free=n, prescribed=1, parameters=parameters)
    return state_equations(parts, with_cart=level is Level.CART)
