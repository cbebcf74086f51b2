"""A motion as values on a mesh, each interval with a collocation method's own places, and what a solver made of it.

An interval of length h from t_i has its states at t_i + h σ_k, its input at t_i + h τ_k; σ and τ: the method's support
and points. Source: Betts, Practical Methods for Optimal Control Using Nonlinear Programming, 3rd ed., section 4.5.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.references.method import Method
from dpcontrol.references.problem import ReferenceProblem

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trajectory:
    """Values on a mesh: mesh (N+1,) s, states (N, K+1, nx) at the method's support, inputs (N, K, nu) at its points."""

    mesh: Array
    states: Array
    inputs: Array

    def node_times(self, method: Method) -> Array:
        """Return the times (N, K+1) of `states`."""
        return self.mesh[:-1, None] + np.diff(self.mesh)[:, None] * method.support

    def input_times(self, method: Method) -> Array:
        """Return the times (N, K) of `inputs`."""
        return self.mesh[:-1, None] + np.diff(self.mesh)[:, None] * method.points


@dataclass(frozen=True)
class Solved:
    """What the solver left: a trajectory, its constraint violation (scaled), and how it ended."""

    trajectory: Trajectory
    violation: float
    cost: float
    iterations: int
    seconds: float
    succeeded: bool
    outcome: str


def first_trajectory(problem: ReferenceProblem, method: Method, mesh: Array) -> Trajectory:
    """Return the guess on the mesh; the cart rests in the middle unless the problem says where it goes."""
    empty = Trajectory(mesh, np.empty(0), np.empty(0))
    times, input_times = empty.node_times(method), empty.input_times(method)
    states = np.zeros((*times.shape, problem.equations.dimension))
    states[..., : problem.pendulum_dimension] = problem.guess_at(times.ravel()).reshape(*times.shape, -1)
    inputs = np.zeros((*input_times.shape, 1))
    if problem.cart_guess is not None:
        states[..., problem.pendulum_dimension :] = problem.cart_guess(times.ravel())[:, :2].reshape(*times.shape, 2)
        inputs[..., 0] = problem.cart_guess(input_times.ravel())[:, 2].reshape(input_times.shape)
    return Trajectory(mesh, states, inputs)
