"""Equations of motion from a Lagrangian and a Rayleigh dissipation function.

    d/dt ∂L/∂v - ∂L/∂q + ∂D/∂v = 0        (Goldstein, Classical Mechanics, 3rd ed., eq. 1.70)

Coordinates are the free ones q (n) followed by prescribed ones, whose accelerations are inputs. The Lagrangian
may contain terms linear in velocity (rotating frames); nothing assumes that coordinates are angles.
"""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True)
class Mechanics:
    """A mechanical system, symbolically; every entry is a casadi SX expression in the first four.

    position (n + m,), velocity (n + m,): free coordinates first, then m prescribed ones; acceleration (m,) of the
    prescribed ones; parameters (p,). free_acceleration (n,) is the law of motion; momentum (n,) and hamiltonian
    belong to the free coordinates alone.
    """

    position: ca.SX
    velocity: ca.SX
    acceleration: ca.SX
    parameters: ca.SX
    free_acceleration: ca.SX
    momentum: ca.SX
    hamiltonian: ca.SX
    mass_matrix: ca.SX


def solve_symmetric(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Solve matrix · x = right by elimination without pivots, unrolled into the graph.

    matrix (n, n) is symmetric and positive definite (a mass matrix), so no pivot vanishes. casadi's own
    symbolic solve uses a QR decomposition with more instructions.
    """
    n = matrix.shape[0]
    a = [[matrix[i, j] for j in range(n)] for i in range(n)]
    b = [right[i] for i in range(n)]
    for k in range(n):
        for i in range(k + 1, n):
            factor = a[k][i] / a[k][k]
            for j in range(i, n):
                a[i][j] = a[i][j] - factor * a[k][j]
            b[i] = b[i] - factor * b[k]
    x: list[ca.SX] = [ca.SX(0)] * n
    for i in reversed(range(n)):
        rest = b[i]
        for j in range(i + 1, n):
            rest = rest - a[i][j] * x[j]
        x[i] = rest / a[i][i]
    return ca.vertcat(*x)


Energy = Callable[[ca.SX, ca.SX, ca.SX], ca.SX]


def mechanics(lagrangian: Energy, dissipation: Energy, *, free: int, prescribed: int, parameters: ca.SX) -> Mechanics:
    """Derive the equations of motion of a system with `free` + `prescribed` coordinates.

    lagrangian and dissipation map (position, velocity, parameters) to a scalar.
    """
    q = ca.SX.sym("q", free + prescribed)
    v = ca.SX.sym("v", free + prescribed)
    u = ca.SX.sym("u", prescribed)
    energy = lagrangian(q, v, parameters)
    all_momenta = ca.gradient(energy, v)
    mass = ca.jacobian(all_momenta, v)[:free, :]
    force = (
        ca.gradient(energy, q)[:free]
        - ca.jtimes(all_momenta, q, v)[:free]
        - ca.gradient(dissipation(q, v, parameters), v)[:free]
    )
    if prescribed:
        force = force - mass[:, free:] @ u
    # The Hamiltonian of the free coordinates, in a frame where the prescribed ones are at rest.
    rest = ca.vertcat(v[:free], ca.SX.zeros(prescribed))
    momentum = ca.substitute(all_momenta[:free], v, rest) if prescribed else all_momenta
    still = ca.substitute(energy, v, rest) if prescribed else energy
    hamiltonian = ca.dot(momentum, v[:free]) - still
    return Mechanics(
        position=q,
        velocity=v,
        acceleration=u,
        parameters=parameters,
        free_acceleration=ca.cse(solve_symmetric(mass[:, :free], force)),
        momentum=momentum,
        hamiltonian=hamiltonian,
        mass_matrix=mass[:, :free],
    )
