"""A solver's motion as polynomials on a mesh, and its quality.

An interval of length h from t_i has its states at t_i + h σ_k and its input at t_i + h τ_k, with the method's support
σ and points τ. Both polynomials are evaluated in barycentric form (Berrut & Trefethen, SIAM Review 46 (2004), eq. 4.2).

Error between nodes: a propagator at machine precision restarts at each interval's start under the interval's input
polynomial. The error is the largest scaled difference from the state's polynomial on a dense grid. Limits: the extrema
of the polynomials of cart position, velocity and acceleration follow from the roots of their derivatives. A solution
far from its guess is another motion.

Source: Betts, Practical Methods for Optimal Control Using Nonlinear Programming, 3rd ed., sections 4.5 and 4.7.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.shown import Brief
from dpcontrol.references.method import Method, differentiation_matrix, interpolation_matrix
from dpcontrol.references.problem import LIMIT_UNITS, Limits, ReferenceProblem, state_scale

if TYPE_CHECKING:
    from dpcontrol.dynamics.propagator import PolynomialInputPropagator


@dataclass(frozen=True, eq=False)
class Trajectory(Brief):
    """States and inputs at the points of a collocation mesh.

    Attributes:
        method: collocation method.
        mesh: ends of the intervals (N+1,), s.
        states: states at the method's support (N, K+1, nx).
        inputs: inputs at its points (N, K, nu).
    """

    method: Method
    mesh: Array
    states: Array
    inputs: Array

    @property
    def duration(self) -> float:
        """Duration in s."""
        return float(self.mesh[-1] - self.mesh[0])

    @property
    def effort(self) -> float:
        """Effort ∫u² of the first input by the method's quadrature, in m²/s³ for an acceleration."""
        return float((self.inputs[..., 0] ** 2 @ self.method.weights) @ np.diff(self.mesh))

    @property
    def input_times(self) -> Array:
        """Times (N, K) of `inputs`, s."""
        return times_on(self.mesh, self.method.points)

    def _evaluate(self, times: ArrayLike, places: Array, values: Array) -> Array:
        """Return the values (…, nx) of the intervals' polynomials at times (…), s, the nearest end's outside.

        Args:
            times: times (…), s.
            places: places (P,) of the given values in an interval, 0 to 1.
            values: values (N, P, nx) at these places of each interval.
        """
        clipped_times = np.clip(np.asarray(times, dtype=float), self.mesh[0], self.mesh[-1])
        flat_times = clipped_times.ravel()
        index = np.clip(np.searchsorted(self.mesh, flat_times, side="right") - 1, 0, len(self.mesh) - 2)
        tau = (flat_times - self.mesh[index]) / (self.mesh[index + 1] - self.mesh[index])
        rows = interpolation_matrix(places, tau)
        return np.einsum("mk,mkn->mn", rows, values[index]).reshape(*clipped_times.shape, values.shape[-1])

    def state(self, times: ArrayLike) -> Array:
        """Return states (…, nx) at given times.

        Times outside count as the nearest end.

        Args:
            times: times (…), s.
        """
        return self._evaluate(times, self.method.support, self.states)

    def input(self, times: ArrayLike) -> Array:
        """Return inputs (…, nu) at given times.

        Times outside count as the nearest end.

        Args:
            times: times (…), s.
        """
        return self._evaluate(times, self.method.points, self.inputs)


def even_mesh(duration: float, interval: float) -> Array:
    """Return the mesh (N+1,) of equal intervals, s, that are at most as long as given.

    Args:
        duration: length of the mesh, s.
        interval: longest interval, s.
    """
    return np.linspace(0.0, duration, int(np.ceil(duration / interval)) + 1)


def times_on(mesh: Array, places: Array) -> Array:
    """Return the times (N, K) of the same places in each interval of a mesh, s.

    Args:
        mesh: ends of the intervals (N+1,), s.
        places: places (K,) from 0 to 1.
    """
    return mesh[:-1, None] + np.diff(mesh)[:, None] * places


@dataclass(frozen=True)
class Solved:
    """The solver's last iterate with its outcome.

    Attributes:
        trajectory: motion of the last iterate.
        violation: largest violation of a constraint, scaled.
        cost: value of the cost.
        iterations: number of iterations.
        seconds: time of the solution, s.
        succeeded: True if it is a finite solution.
        outcome: the solver's own answer in words.
    """

    trajectory: Trajectory
    violation: float
    cost: float
    iterations: int
    seconds: float
    succeeded: bool
    outcome: str


def first_trajectory(problem: ReferenceProblem, method: Method, mesh: Array) -> Trajectory:
    """Return the guess as a trajectory on a mesh, with the cart at rest in the middle.

    Args:
        problem: problem with a guess.
        method: collocation method.
        mesh: ends of the intervals (N+1,), s.
    """
    times, input_times = times_on(mesh, method.support), times_on(mesh, method.points)
    states = np.zeros((*times.shape, problem.equations.dimension))
    states[..., : problem.pendulum_dimension] = problem.guess_at(times.ravel()).reshape(*times.shape, -1)
    return Trajectory(method, mesh, states, np.zeros((*input_times.shape, 1)))


DENSE = 21
"""Places per interval at which the error is evaluated: four between adjacent nodes of five points."""
_FAST = 3.0
"""Largest ratio of an arm's largest rate to the scale of rates, above which the scale grows."""
LATENESS = 0.3
_LOOK = 0.005
"""Largest time shift between a reference and its guess, s, and steps of its search."""


def power_coefficients(points: Array, values: Array) -> Array:
    """Return the coefficients (…, K) in powers of τ of the polynomials through given values, lowest power first.

    Args:
        points: distinct points (K,).
        values: values (…, K) at the points.
    """
    powers = points[:, None] ** np.arange(len(points))
    return np.asarray(np.einsum("pk,...k->...p", np.linalg.inv(powers), values), dtype=np.float64)


def error_between_nodes(problem: ReferenceProblem, trajectory: Trajectory) -> Array:
    """Return the largest scaled error in each interval (N,), infinite if the propagation fails.

    Collocation fulfils the equations at its points only, so this error decides which intervals are split.

    Args:
        problem: equations and limits.
        trajectory: motion with N intervals.
    """
    method, propagator = trajectory.method, interval_propagator(problem, trajectory.method)
    scale = state_scale(problem.equations.dimension, problem.limits)
    tau = np.linspace(0.0, 1.0, DENSE)
    lengths = np.diff(trajectory.mesh)
    dense_states = np.einsum("dk,ikn->idn", interpolation_matrix(method.support, tau), trajectory.states)
    coefficients = power_coefficients(method.points, trajectory.inputs[..., 0])
    # In powers of the time from the interval's start instead of its share τ.
    coefficients = coefficients / lengths[:, None] ** np.arange(len(method.points))
    errors = np.full(len(lengths), np.inf)
    for i, length in enumerate(lengths):
        try:
            propagated_states = propagator.sample(dense_states[i, 0], coefficients[i], tau * length)
        except ArithmeticError:
            continue
        errors[i] = np.abs((propagated_states - dense_states[i]) / scale).max()
    return np.where(np.isfinite(errors), errors, np.inf)


def interval_propagator(problem: ReferenceProblem, method: Method) -> "PolynomialInputPropagator":
    """Return the propagator for intervals of a method, compiled when first used and kept with the problem.

    Args:
        problem: equations.
        method: collocation method.
    """
    from dpcontrol.dynamics.propagator import PolynomialInputPropagator

    degree = len(method.points) - 1
    if degree not in problem.propagators:
        problem.propagators[degree] = PolynomialInputPropagator(problem.equations, problem.parameters, degree=degree)
    return problem.propagators[degree]


def largest_on_intervals(points: Array, values: Array, *, above: float) -> float:
    """Return the largest |polynomial| over all intervals 0 ≤ τ ≤ 1, exact where it exceeds `above`.

    Args:
        points: distinct points (K,) in [0, 1].
        values: values (N, K) at the points.
        above: size, in the unit of `values`, from which the extrema are computed.
    """
    tau = np.linspace(0.0, 1.0, DENSE)
    sampled_sizes = np.abs(values @ interpolation_matrix(points, tau).T).max(1)
    largest = float(sampled_sizes.max())
    for i in np.flatnonzero(sampled_sizes > above):
        polynomial = np.polynomial.Polynomial(power_coefficients(points, values[i]))
        roots = polynomial.deriv().roots()
        inside = roots.real[(abs(roots.imag) < 1e-9) & (roots.real > 0) & (roots.real < 1)]
        if inside.size:
            largest = max(largest, float(np.abs(polynomial(inside)).max()))
    return largest


def away_from_guess(problem: ReferenceProblem, trajectory: Trajectory) -> tuple[float, float]:
    """Return the largest scaled distance of the pendulum from the guess, and its time, s.

    At each time, the nearest of the guess's states within 0.3 s before and after counts, because friction delays the
    motion. The scale of an arm's rate is at least a third of its largest rate in the guess, because small arms are
    faster.

    Args:
        problem: problem with a guess.
        trajectory: motion of about the same duration.
    """
    nz = problem.pendulum_dimension
    times = np.linspace(0.0, problem.duration, max(2, int(np.ceil(problem.duration / _LOOK)) + 1))
    trajectory_times = trajectory.mesh[0] + times / (problem.duration / trajectory.duration)
    guess = problem.guess_at(times)
    scale = state_scale(problem.equations.dimension, problem.limits)[:nz]
    rates = slice(nz // 2, nz)
    scale[rates] = np.maximum(scale[rates], np.abs(guess[:, rates]).max(0) / _FAST)
    states, guess = trajectory.state(trajectory_times)[:, :nz] / scale, guess / scale
    nearest = np.full(len(times), np.inf)
    most_lag = min(round(LATENESS / _LOOK), len(times) - 1)
    for lag in range(-most_lag, most_lag + 1):
        late_samples = slice(max(0, lag), len(times) + min(0, lag))
        early_samples = slice(max(0, -lag), len(times) + min(0, -lag))
        nearest[late_samples] = np.minimum(
            nearest[late_samples], np.abs(states[late_samples] - guess[early_samples]).max(1)
        )
    farthest = int(nearest.argmax())
    return float(nearest[farthest]), float(trajectory_times[farthest])


def _limited_curves(trajectory: Trajectory) -> dict[str, tuple[Array, Array]]:
    """Return the cart's limited quantities along a motion by name: position, velocity, acceleration and jerk.

    Each is given by places (P,) in an interval and the values (N, P) at them, in SI units.
    """
    inputs, method = trajectory.inputs[..., 0], trajectory.method
    slopes = inputs @ differentiation_matrix(method.points).T / np.diff(trajectory.mesh)[:, None]
    return {
        "position": (method.support, trajectory.states[..., -2]),
        "velocity": (method.support, trajectory.states[..., -1]),
        "acceleration": (method.points, inputs),
        "jerk": (method.points, slopes),
    }


def where_largest(trajectory: Trajectory, name: str) -> float:
    """Return the time at which a limited quantity is largest on the dense grid, s.

    Args:
        trajectory: motion.
        name: name of the quantity.
    """
    points, values = _limited_curves(trajectory)[name]
    tau = np.linspace(0.0, 1.0, DENSE)
    sampled_sizes = np.abs(values @ interpolation_matrix(points, tau).T)
    interval, place = np.unravel_index(int(sampled_sizes.argmax()), sampled_sizes.shape)
    mesh = trajectory.mesh
    return float(mesh[interval] + tau[place] * (mesh[interval + 1] - mesh[interval]))


@dataclass(frozen=True)
class LimitUse:
    """Use of one of the cart's limits: bound and largest size in `unit`, and the time of the latter, s."""

    name: str
    unit: str
    bound: float
    largest: float
    time: float

    @property
    def share(self) -> float:
        """Largest size divided by the bound."""
        return self.largest / self.bound

    @property
    def sentence(self) -> str:
        """Largest size, bound and time in words."""
        return f"{self.largest:.3g} of {self.bound:.4g} {self.unit} at {self.time:.2f} s"


def limit_uses(trajectory: Trajectory, limits: Limits) -> tuple[LimitUse, ...]:
    """Return the use of each of the cart's limits by a motion: bound, largest value and its time.

    Args:
        trajectory: motion.
        limits: limits of the cart.
    """
    largest = largest_values(trajectory, limits)
    return tuple(
        LimitUse(name, LIMIT_UNITS[name], bound, largest[name], where_largest(trajectory, name))
        for name, bound in limits.named().items()
    )


def largest_values(trajectory: Trajectory, limits: Limits) -> dict[str, float]:
    """Return the largest size of each of the cart's limited quantities by name, SI units, between nodes too.

    Args:
        trajectory: motion.
        limits: limits of the cart.
    """
    curves, bounds = _limited_curves(trajectory), limits.named()
    # A curve below nine tenths of its bound on the dense grid does not exceed it in between.
    return {name: largest_on_intervals(*curves[name], above=0.9 * bound) for name, bound in bounds.items()}
