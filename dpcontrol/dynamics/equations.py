"""Equations of motion from an energy.

The energy is a Lagrangian with a Rayleigh dissipation function, or a Hamiltonian.

    d/dt ∂L/∂v - ∂L/∂q + ∂D/∂v = 0        (Goldstein, Classical Mechanics, 3rd ed., eq. 1.70)

Coordinates are the free ones q (n) followed by prescribed ones, whose accelerations are inputs. The Lagrangian may
contain terms linear in velocity (rotating frames); nothing assumes that coordinates are angles.

In ẋ = f(x, u; p), symbolically and as numpy functions, the state has the free positions, their velocities, and then
position and velocity of the prescribed cart. The free part is the prefix at every level, so a level with its additions
set to zero equals the level below.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.shown import Brief


@dataclass(frozen=True)
class Mechanics(Brief):
    """Equations of motion of a mechanical system, from which the equations of each level are composed.

    All fields are casadi SX expressions.

    Attributes:
        position, velocity: free coordinates, then m prescribed ones (n + m,).
        acceleration: of the prescribed coordinates (m,).
        parameters: (p,).
        free_acceleration: law of motion (n,).
        momentum: of the free coordinates (n,).
        hamiltonian: of the free coordinates.
        mass_matrix: of the free coordinates (n, n).
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
    """Return x (n,) with matrix · x = right by elimination without pivots, such as accelerations from forces.

    The solution is unrolled into the graph. casadi's own symbolic solve uses a QR decomposition with more instructions.

    Args:
        matrix: symmetric and positive definite (n, n), as a mass matrix, so no pivot vanishes. Entries below its
            diagonal are not used.
        right: right-hand side (n,).
    """
    n = matrix.shape[0]
    entries = [[matrix[i, j] for j in range(n)] for i in range(n)]
    right_entries = [right[i] for i in range(n)]
    for k in range(n):
        for i in range(k + 1, n):
            factor = entries[k][i] / entries[k][k]
            for j in range(i, n):
                entries[i][j] = entries[i][j] - factor * entries[k][j]
            right_entries[i] = right_entries[i] - factor * right_entries[k]
    solution: list[ca.SX] = [ca.SX(0)] * n
    for i in reversed(range(n)):
        remainder = right_entries[i]
        for j in range(i + 1, n):
            remainder = remainder - entries[i][j] * solution[j]
        solution[i] = remainder / entries[i][i]
    return ca.vertcat(*solution)


Energy = Callable[[ca.SX, ca.SX, ca.SX], ca.SX]


def mechanics(lagrangian: Energy, dissipation: Energy, *, free: int, prescribed: int, parameters: ca.SX) -> Mechanics:
    """Derive the equations of motion from energies, by Lagrange's equations with dissipation.

    Args:
        lagrangian: function of (position, velocity, parameters), a scalar.
        dissipation: function of the same arguments, a scalar.
        free: number of coordinates with equations of motion.
        prescribed: number of coordinates with given accelerations, which follow the free ones.
        parameters: symbols of the parameters.
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
        - mass[:, free:] @ u
    )
    # The Hamiltonian of the free coordinates, in the rest frame of the prescribed ones.
    free_velocity = ca.vertcat(v[:free], ca.SX.zeros(prescribed))
    momentum, energy_at_free_velocity = ca.substitute([all_momenta[:free], energy], [v], [free_velocity])
    return Mechanics(
        position=q,
        velocity=v,
        acceleration=u,
        parameters=parameters,
        free_acceleration=ca.cse(solve_symmetric(mass[:, :free], force)),
        momentum=momentum,
        hamiltonian=ca.dot(momentum, v[:free]) - energy_at_free_velocity,
        mass_matrix=mass[:, :free],
    )


@dataclass(frozen=True, eq=False)
class Equations(Brief):
    """One level's first-order equations as casadi SX, from which all numeric and compiled functions are made.

    The linear parameters differ for dry friction, whose slope at a point does not represent motions of finite size.

    Attributes:
        state: symbols (N,).
        inputs: symbols (m,).
        parameters: symbols (p,).
        rate: f (N,).
        hamiltonian: energy of the free coordinates.
        momentum: canonical momenta (n,).
        mass_matrix: matrix of the free coordinates (n, n).
        linear_parameters: expressions of the parameters at which a sampled step is linearised (p,), by default the
            parameters.
    """

    state: ca.SX
    inputs: ca.SX
    parameters: ca.SX
    rate: ca.SX
    hamiltonian: ca.SX
    momentum: ca.SX
    mass_matrix: ca.SX
    linear_parameters: ca.SX | None = None

    @property
    def dimension(self) -> int:
        """Length N of the state."""
        return self.state.shape[0]

    @property
    def input_count(self) -> int:
        """Number of inputs m (0 without a cart)."""
        return self.inputs.shape[0]

    def function(self) -> ca.Function:
        """Return the casadi function (state (N,), inputs (m,), parameters (p,)) -> rate (N,)."""
        return ca.Function("rate", [self.state, self.inputs, self.parameters], [self.rate])

    @cached_property
    def numeric_functions(self) -> dict[str, ca.Function]:
        """Functions of (state, parameters) with zero inputs for `NumericEquations`, by name.

        Matrices are transposed and flattened, since casadi stores columns and numpy rows.
        """
        rate = ca.substitute(self.rate, self.inputs, ca.SX.zeros(self.input_count))
        expressions = {
            "rate": rate,
            "jacobian": ca.vec(ca.jacobian(rate, self.state).T),
            "hamiltonian": self.hamiltonian,
            "gradient": ca.gradient(self.hamiltonian, self.state),
            "momentum": self.momentum,
            "momentum_jacobian": ca.vec(ca.jacobian(self.momentum, self.state).T),
            "mass": ca.vec(self.mass_matrix.T),
        }
        return {
            name: ca.Function(name, [self.state, self.parameters], [ca.densify(value)])
            for name, value in expressions.items()
        }

    def linearised(self, expression: ca.SX, by: ca.SX, parameters: ca.SX) -> ca.SX:
        """Return the Jacobian of an expression at the linear parameters, for the linear models of laws and filters.

        Args:
            expression: expression of symbols.
            by: symbols of the derivative.
            parameters: symbols (p,) in the expression, replaced by `linear_parameters`.
        """
        jacobian = ca.jacobian(expression, by)
        if self.linear_parameters is None:
            return jacobian
        linear = ca.substitute(self.linear_parameters, self.parameters, parameters)
        return ca.substitute(jacobian, parameters, linear)

    def linear(self, parameters: Array) -> Array:
        """Return the values (p,) of the linear parameters, at which a step is linearised.

        Args:
            parameters: values (p,).
        """
        if self.linear_parameters is None:
            return parameters
        function = ca.Function("linear", [self.parameters], [self.linear_parameters])
        return np.array(function(parameters)).ravel()

    def discrete_step(self, step: float) -> ca.Function:
        """Return the sampled step over one control period with its derivatives, as a casadi function.

        It maps (state, inputs, parameters) to (next state, ∂next/∂state, ∂next/∂inputs).

        One classical Runge-Kutta step of order 4 with the inputs held; at 1 ms its error is 2e-8 (scaled), far below an
        encoder count.

        Args:
            step: time, s.
        """
        f = self.function()
        x, u, p = self.state, self.inputs, self.parameters
        following = runge_kutta_4(lambda state, _: f(state, u, p), x, step)
        outputs = [following, self.linearised(following, x, p), self.linearised(following, u, p)]
        return ca.Function("step", [x, u, p], [ca.densify(o) for o in ca.cse(outputs)], {"cse": True})


def runge_kutta_4(slope: Callable[[ca.SX, Any], ca.SX], x: ca.SX, h: Any) -> ca.SX:
    """Return the next state (N,) by the classical Runge-Kutta step of order 4, symbolically.

    Args:
        slope: function of a state and a time after x.
        x: state (N,).
        h: length of the step, in the unit of the time.
    """
    k1 = slope(x, 0)
    k2 = slope(x + h / 2 * k1, h / 2)
    k3 = slope(x + h / 2 * k2, h / 2)
    k4 = slope(x + h * k3, h)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def state_equations(parts: Mechanics, *, with_cart: bool) -> Equations:
    """Write a mechanical system as first-order equations.

    With `with_cart`, the prescribed coordinates and their velocities follow the free ones in the state, and their
    accelerations are the inputs. Otherwise they rest at zero and there is no input.

    Args:
        parts: equations of motion.
        with_cart: include the prescribed coordinates, see above.
    """
    n = parts.free_acceleration.shape[0]
    q, v, u = parts.position, parts.velocity, parts.acceleration
    expressions = [parts.free_acceleration, parts.hamiltonian, parts.momentum, parts.mass_matrix]
    state, inputs, resting = ca.vertcat(q[:n], v[:n]), ca.SX.zeros(0), [q[n:], v[n:], u]
    if with_cart:
        state, inputs, resting = ca.vertcat(state, q[n:], v[n:]), u, []
    acceleration, *energies = ca.substitute(expressions, resting, [ca.SX.zeros(symbol.shape) for symbol in resting])
    rate = ca.vertcat(v[:n], acceleration, *((v[n:], u) if with_cart else ()))
    return Equations(state, inputs, parts.parameters, ca.cse(rate), *energies)


def hamiltonian_equations(energy: Energy, *, count: int, parameters: ca.SX) -> Equations:
    """Return Hamilton's equations of H(q, p, parameters), for systems that users define by H.

    States are (q, p).

    Args:
        energy: function H, a scalar.
        count: number of coordinates.
        parameters: symbols of the parameters.
    """
    q, p = ca.SX.sym("q", count), ca.SX.sym("p", count)
    value = energy(q, p, parameters)
    by_momenta = ca.gradient(value, p)
    rate = ca.cse(ca.vertcat(by_momenta, -ca.gradient(value, q)))
    inverse_mass = ca.jacobian(by_momenta, p)
    mass = ca.horzcat(*(solve_symmetric(inverse_mass, ca.SX.eye(count)[:, k]) for k in range(count)))
    return Equations(ca.vertcat(q, p), ca.SX.zeros(0), parameters, rate, value, p, mass)


_ALIVE: WeakKeyDictionary[Any, tuple[object, ...]] = WeakKeyDictionary()
"""What each call of `bound_call` works on."""


def bound_call(function: ca.Function, inputs: Sequence[Array], outputs: Sequence[Array]) -> Callable[[], None]:
    """Return a call of a function between fixed arrays, without copies.

    The call takes no arguments and returns None: it reads the inputs' arrays and overwrites the outputs'. casadi's
    conversion of arguments takes forty times as long as a small function.

    Args:
        function: function of dense vectors.
        inputs: contiguous arrays of its inputs.
        outputs: contiguous arrays of its outputs.
    """
    buffer, call = cast("Any", function.buffer())
    for k, array in enumerate(inputs):
        buffer.set_arg(k, array.data)
    for k, array in enumerate(outputs):
        buffer.set_res(k, array.data)
    # The buffer holds bare addresses: function and arrays must live as long as the call does.
    _ALIVE[call] = function, buffer, inputs, outputs
    return call


class PointCalls:
    """Calls of a casadi function of dense columns on its interpreter, for one point or many at once.

    Args:
        function: function with one dense output.
    """

    def __init__(self, function: ca.Function) -> None:
        self.function, self.size_out = function, function.numel_out(0)
        # Call, inputs and output by the number of points.
        self._made: dict[int, tuple[Callable[[], None], list[Array], Array]] = {}

    def of(self, count: int) -> tuple[Callable[[], None], list[Array], Array]:
        """Return the call that evaluates `count` points, and the arrays on which it works, made once for each count.

        The arrays (count, size) are those of the inputs and that of the output.
        """
        if count not in self._made:
            function = self.function
            inputs = [np.zeros((count, function.size1_in(i))) for i in range(function.n_in())]
            output = np.zeros((count, self.size_out))
            self._made[count] = bound_call(function.map(count), inputs, [output]), inputs, output
        return self._made[count]


_SIZES = (256, 16, 1)
"""Points of one call. Among many, a point takes a quarter of the time of a call of its own."""


@dataclass(frozen=True)
class NumericEquations(Brief):
    """Equations with numbers for parameters (p,).

    Methods take and return numpy arrays, many states at once. States are (N,) or (K, N), and results have the same
    leading shape. Inputs are zero. Instances cannot be shared between threads because calls reuse memory.
    """

    equations: Equations
    parameters: Array

    @cached_property
    def _functions(self) -> dict[str, PointCalls]:
        """The functions of `Equations.numeric_functions`, by name."""
        return {name: PointCalls(function) for name, function in self.equations.numeric_functions.items()}

    def _call(self, name: str, states: Array, *shape: int) -> Array:
        """Evaluate the named function at states (…, N) and return its outputs with the shape (…, *shape)."""
        x, function = np.asarray(states, dtype=float), self._functions[name]
        rows, done = x.reshape(-1, x.shape[-1]), 0
        results = np.empty((len(rows), function.size_out))
        for size in (size for size in _SIZES if size <= len(rows)):
            call, (state, parameters), output = function.of(size)
            parameters[:] = self.parameters
            while done + size <= len(rows):
                state[:] = rows[done : done + size]
                call()
                results[done : done + size] = output
                done += size
        return results.reshape(*x.shape[:-1], *shape)

    def rate(self, states: Array) -> Array:
        """Return the rates f(x) with the shape of `states`.

        Args:
            states: states (…, N).
        """
        return self._call("rate", states, -1)

    def jacobian(self, states: Array) -> Array:
        """Return the Jacobians ∂f/∂x, (…, N, N), for linear stability and Newton's method.

        Args:
            states: states (…, N).
        """
        return self._call("jacobian", states, -1, self.equations.dimension)

    def hamiltonian(self, states: Array) -> Array:
        """Return the energy H of the free coordinates in J, (…).

        Args:
            states: states (…, N).
        """
        return self._call("hamiltonian", states, 1)[..., 0]

    def gradient(self, states: Array) -> Array:
        """Return the gradients ∂H/∂x of the energy, (…, N).

        Args:
            states: states (…, N).
        """
        return self._call("gradient", states, -1)

    def momentum(self, states: Array) -> Array:
        """Return the canonical momenta of the free coordinates, (…, n).

        Args:
            states: states (…, N).
        """
        return self._call("momentum", states, -1)

    def momentum_jacobian(self, states: Array) -> Array:
        """Return the Jacobians ∂p/∂x of the canonical momenta, (…, n, N).

        Args:
            states: states (…, N).
        """
        return self._call("momentum_jacobian", states, -1, self.equations.dimension)

    def mass_matrix(self, states: Array) -> Array:
        """Return the mass matrix of the free coordinates, (…, n, n).

        Args:
            states: states (…, N).
        """
        return self._call("mass", states, -1, self.equations.mass_matrix.shape[0])
