"""One-step schemes as machine code: what the product's propagators are compared with.

Runge-Kutta of order 4 on (θ, ω), and Gauss collocation with s stages on canonical coordinates (q, p), which is
symplectic; s = 1 is the implicit midpoint rule. The stages' equations are solved by a fixed number of substitutions.

    z⁺ = z + h Σ b_i f(Z_i),   Z_i = z + h Σ_j a_ij f(Z_j),   f = (∂H/∂p, -∂H/∂q)

Source: Hairer, Lubich & Wanner, Geometric Numerical Integration (2006), sections II.1.3 and VIII.6.
"""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.dynamics.equations import Equations
from dpcontrol.references.method import gauss

Array = NDArray[np.float64]

SUBSTITUTIONS = 10


def runge_kutta_4(equations: Equations) -> ca.Function:
    """Return (state, inputs, duration, parameters) -> following: the classical step of order 4, inputs held."""
    f = equations.function()
    x, u, p, h = equations.state, equations.inputs, equations.parameters, ca.SX.sym("h")
    k1 = f(x, u, p)
    k2 = f(x + h / 2 * k1, u, p)
    k3 = f(x + h / 2 * k2, u, p)
    k4 = f(x + h * k3, u, p)
    return _step(equations, h, x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))


def symplectic_gauss(equations: Equations, stages: int) -> ca.Function:
    """Return (state, inputs, duration, parameters) -> following: Gauss collocation in canonical coordinates.

    State is (θ, ω) on both sides; order 2 `stages`. For equations without input.
    """
    n = equations.dimension // 2
    x, p, h = equations.state, equations.parameters, ca.SX.sym("h")
    mass = ca.Function("mass", [x, p], [equations.mass_matrix])
    energy = ca.Function("energy", [x, p], [equations.hamiltonian])
    z = ca.SX.sym("z", 2 * n)
    rates = _solved(mass(ca.vertcat(z[:n], ca.SX.zeros(n)), p), z[n:])
    slope = ca.gradient(energy(ca.vertcat(z[:n], rates), p), z)
    f = ca.Function("canonical", [z, p], [ca.cse(ca.vertcat(slope[n:], -slope[:n]))])
    first = ca.vertcat(x[:n], ca.mtimes(mass(x, p), x[n:]))
    a, b = _gauss_tableau(stages)
    slopes = [f(first, p)] * stages
    for _ in range(SUBSTITUTIONS):
        slopes = [f(first + h * sum(float(a[i, j]) * slopes[j] for j in range(stages)), p) for i in range(stages)]
    last = first + h * sum(float(b[i]) * slopes[i] for i in range(stages))
    back = ca.vertcat(last[:n], _solved(mass(ca.vertcat(last[:n], ca.SX.zeros(n)), p), last[n:]))
    return _step(equations, h, back)


def _step(equations: Equations, h: ca.SX, following: ca.SX) -> ca.Function:
    names = ["state", "inputs", "duration", "parameters"]
    arguments = [equations.state, equations.inputs, h, equations.parameters]
    return ca.Function("scheme", arguments, [ca.cse(ca.densify(following))], names, ["following"])


def _solved(matrix: ca.SX, right: ca.SX) -> ca.SX:
    return ca.solve(matrix, right)


def _gauss_tableau(stages: int) -> tuple[Array, Array]:
    """Return a (s, s) and b (s,) of Gauss collocation, from the method that transcribes references."""
    method = gauss(stages)
    powers = method.points[:, None] ** np.arange(stages)
    integrals = method.points[:, None] ** np.arange(1, stages + 1) / np.arange(1, stages + 1)
    a: Array = np.linalg.solve(powers.T, integrals.T).T.astype(np.float64)
    return a, method.weights


class Stepper:
    """Flies states (N, S) by steps of one length, parameters (p,) and inputs (m,) held; not to be shared."""

    def __init__(self, function: ca.Function, parameters: Array, *, lanes: int = 0) -> None:
        self.step = Compiled(function)
        shape = (lanes,) if lanes else ()
        self._inputs = np.zeros((self.step.size_in, *shape))
        self._parameters = parameters.reshape(-1, *([1] * len(shape)))
        self._out = np.zeros((self.step.size_out, *shape))

    def fly(self, states: Array, duration: float, *, step: float, command: float = 0.0) -> Array:
        """Return the states (N,) or (N, S) after `duration` s in steps of about `step` s."""
        at, slices, into = self._inputs, self.step.slices, self._out
        count = max(1, round(duration / step))
        at[slices["parameters"]] = self._parameters
        at[slices["inputs"]] = command
        at[slices["duration"]] = duration / count
        state = at[slices["state"]]
        state[:] = states
        call = self.step
        for _ in range(count):
            state[:] = call(at, into)
        return state.copy()


def buffered_rate(equations: Equations, parameters: Array) -> Callable[[float, Array], Array]:
    """Return the equations' rate (t, x) -> (N,) for scipy, through casadi's buffers; the result is overwritten."""
    function = ca.Function("rate", [equations.state, equations.parameters], [ca.densify(equations.rate)])
    x, p, out = np.zeros(equations.dimension), np.array(parameters, dtype=float), np.zeros(equations.dimension)
    buffer: Any
    buffer, run = function.buffer()
    buffer.set_arg(0, memoryview(x.data))
    buffer.set_arg(1, memoryview(p.data))
    buffer.set_res(0, memoryview(out.data))
    # The run points into the buffer and the arrays but owns none of them: they must live as long as it does.
    keep = (function, buffer, p)

    def rate(_: float, state: Array, keep: object = keep) -> Array:
        x[:] = state
        run()
        return out.copy()

    return rate
