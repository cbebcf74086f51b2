"""The extended Kalman filter as machine code, for one run or many.

The filter's step is one function, with its inputs and outputs in arrays (M,) or (M, S). `CompiledEkf` calls it for one
run. The step computes state and extras, covariance, innovation and NIS:

    predict:  z⁻ = F(z, u),  P⁻ = A P Aᵀ + Q(z)         update:  y = wrap(m - H z⁻),  S = W (H P⁻ Hᵀ + R) W + I - W,
    K = P⁻ Hᵀ W S⁻¹,  z = z⁻ + K y,  P = (I - K H) P⁻ (I - K H)ᵀ + K R Kᵀ,  NIS = yᵀ S⁻¹ y

Here z is the augmented state and m holds the measured angles and cart position. W is diagonal, with 1 for each
measured position and 0 otherwise, which excludes missing positions exactly. Joseph's form keeps P positive where P⁻
exceeds R by more than the floating-point resolution. P is stored as its lower triangle, row by row, so it stays
symmetric.

Q covers parameter errors, whose effect is proportional to the acceleration: small for an arm at rest. If the filter
estimates the parameters, this factor follows from their variance and vanishes as they converge.
Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, sections 5.2.6, 10.3.
"""

from abc import abstractmethod
from collections import namedtuple
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import inf, isfinite
from typing import Any, Generic, TypeVar

import casadi as ca
import numpy as np

from dpcontrol.control.estimator_settings import (
    Augment,
    FilterSettings,
    extra_names,
)
from dpcontrol.control.interface import Estimate, Estimator, Present, SampledModel
from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.arrays import Array

Parts = TypeVar("Parts")


class Layout(Generic[Parts]):
    """Contiguous parts of a vector, which a named tuple of their lengths declares.

    A part that a vector lacks has length 0.
    """

    def __init__(self, lengths: Any) -> None:
        """Set the ranges of the parts from their lengths.

        Args:
            lengths: named tuple of the lengths, in the order of the vector.
        """
        ends = np.cumsum(lengths).tolist()
        self.size: int = ends[-1]
        self.slices: Any = lengths._make(slice(end - n, end) for n, end in zip(lengths, ends, strict=True))
        """Range of each part."""
        self.names = [name for name, length in lengths._asdict().items() if length]
        """Names of the parts that the vector has."""

    def of(self, vector: Any) -> Parts:
        """Return the parts of a vector by name, which share its memory.

        Args:
            vector: expression (size,), or numbers (size,) or (size, runs).
        """
        return self.slices._make(vector[where] for where in self.slices)

    def of_rows(self, rows: Array) -> Parts:
        """Return the parts of vectors (K, size, …), which share their memory."""
        return self.slices._make(rows[:, where] for where in self.slices)

    def symbols(self, name: str) -> tuple[ca.SX, Parts]:
        """Return a vector of symbols, an input of a casadi function, and its parts by name.

        Args:
            name: name of the vector.
        """
        vector = ca.SX.sym(name, self.size)
        return vector, self.of(vector)

    def joined(self, parts: Parts) -> ca.SX:
        """Return the vector of these parts, an output of a casadi function.

        Args:
            parts: all parts, (length,).
        """
        return ca.densify(ca.vertcat(*(getattr(parts, name) for name in self.names)))

    def filled(self, runs: int | None = None, **parts: Array | float) -> Array:
        """Return the vector of numbers with these parts, and zeros for the others.

        Args:
            runs: number of runs; None for one.
            **parts: values by name, numbers, (length,) or (length, runs).

        Returns:
            Vector (size,), or (size, runs).
        """
        vector = np.zeros(self.size if runs is None else (self.size, runs))
        for name, value in parts.items():
            numbers = np.asarray(value, dtype=float)
            vector[getattr(self.slices, name)] = numbers[:, None] if runs is not None and numbers.ndim == 1 else numbers
        return vector


def packed(matrix: Array) -> Array:
    """Return the lower triangle of a symmetric matrix, row by row, as memories and logs store a covariance.

    Args:
        matrix: matrix (…, n, n).

    Returns:
        Entries (…, n(n+1)/2).
    """
    rows, columns = np.tril_indices(matrix.shape[-1])
    return matrix[..., rows, columns]


def unpacked(triangle: Array) -> Array:
    """Return the symmetric matrix of a lower triangle, such as a logged covariance.

    Args:
        triangle: lower triangle (…, n(n+1)/2), row by row.

    Returns:
        Matrix (…, n, n).
    """
    n = int(np.sqrt(2 * triangle.shape[-1]))
    rows, columns = np.tril_indices(n)
    matrix = np.empty((*triangle.shape[:-1], n, n))
    matrix[..., rows, columns] = triangle
    matrix[..., columns, rows] = triangle
    return matrix


def pack(matrix: ca.SX) -> ca.SX:
    """Return the lower triangle of a symmetric expression, row by row, as the tick's memory stores it.

    Args:
        matrix: symmetric matrix (n, n).
    """
    return ca.vertcat(*(matrix[i, j] for i in range(matrix.shape[0]) for j in range(i + 1)))


def unpack(triangle: ca.SX, n: int) -> ca.SX:
    """Return the symmetric matrix of an expression's lower triangle.

    Args:
        triangle: lower triangle (n(n+1)/2,), row by row.
        n: size of the matrix.
    """
    matrix = ca.SX(n, n)
    for i in range(n):
        for j in range(i + 1):
            matrix[i, j] = matrix[j, i] = triangle[i * (i + 1) // 2 + j]
    return matrix


def propagated(jacobian: ca.SX, covariance: ca.SX, noise: ca.SX) -> ca.SX:
    """Return the covariance after a period, A P Aᵀ + Q, as its lower triangle row by row.

    Args:
        jacobian: A (N+E, N+E).
        covariance: P (N+E, N+E).
        noise: Q (N+E, N+E).
    """
    # The upper triangle, transposed: the rows of A below the state's are diagonal, so half of A P can be used directly.
    return pack((jacobian @ covariance @ jacobian.T + noise).T)


def _sparse(matrix: Array) -> ca.SX:
    """Return a constant matrix as an expression without its zeros, so that casadi omits the products with them."""
    return ca.sparsify(ca.SX(ca.DM(matrix)))


def _inverse(matrix: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the inverse of a positive definite matrix (n, n), and the factors L⁻¹ (n, n) and D (n,) of L D Lᵀ.

    The factors whiten the innovation for the NIS. A negative D shows that the matrix is not positive.
    """
    n = matrix.shape[0]
    lower, pivots = ca.SX.eye(n), ca.SX(n, 1)
    for j in range(n):
        pivots[j] = matrix[j, j] - sum((lower[j, k] ** 2 * pivots[k] for k in range(j)), ca.SX(0))
        for i in range(j + 1, n):
            lower[i, j] = (
                matrix[i, j] - sum((lower[i, k] * lower[j, k] * pivots[k] for k in range(j)), ca.SX(0))
            ) / pivots[j]
    lower_inverse = ca.SX.eye(n)
    for i in range(n):
        for j in range(i):
            lower_inverse[i, j] = -sum((lower[i, k] * lower_inverse[k, j] for k in range(j, i)), ca.SX(0))
    return lower_inverse.T @ ca.diag(1 / pivots) @ lower_inverse, lower_inverse, pivots


Timing = namedtuple("Timing", "age variance rates")
"""Age of a reading, s before its tick, variance of the unknown part, s², and the rates (n+1,) of the positions."""
_GREATEST_ERROR = 0.5
"""Largest relative error of a parameter that is believed."""


@dataclass(frozen=True, eq=False)
class FilterEquations:
    """An augmented cart-level model sampled at `period` s.

    Args:
        as_measured: if true, P refers to the angles as measured, encoder zeros included, instead of the true ones. An
            angle and its zero are each uncertain by 0.02 rad but their sum only by a count, which single precision
            then resolves.
    """

    equations: Equations
    period: float
    augment: tuple[Augment, ...]
    as_measured: bool = False

    @property
    def arms(self) -> int:
        """Number of arms."""
        return (self.equations.dimension - 2) // 2

    @cached_property
    def extra_names(self) -> tuple[str, ...]:
        """Names of the extra quantities."""
        return extra_names(self.arms, self.augment)

    @property
    def shares(self) -> list[int]:
        """Return the indices in z of the errors of the inertial parameters, which z holds as logarithms."""
        return [self.equations.dimension + i for i, name in enumerate(self.extra_names) if name[0] in "MS"]

    @cached_property
    def dimension(self) -> int:
        """Length N+E of the augmented state."""
        return self.equations.dimension + len(self.extra_names)

    @cached_property
    def observation(self) -> Array:
        """Return H (n+1, N+E), which maps z to the measured positions, including the errors of the encoders' zeros."""
        n = self.arms
        matrix = np.zeros((n + 1, self.dimension))
        matrix[np.arange(n + 1), [*range(n), 2 * n]] = 1.0
        for i, name in enumerate(self.extra_names):
            if name.startswith("zero_"):
                matrix[int(name.removeprefix("zero_")) - 1, self.equations.dimension + i] = 1.0
        return matrix

    @cached_property
    def carried(self) -> Array:
        """Return T (N+E, N+E): T z has the measured positions, with their zero errors, in place of the true ones.

        P is the covariance of T z. Without `as_measured`, T is the identity.
        """
        transformation = np.eye(self.dimension)
        if self.as_measured:
            transformation[[*range(self.arms), 2 * self.arms]] = self.observation
        return transformation

    @cached_property
    def restored(self) -> Array:
        """Return the inverse of T (`carried`); its entries are 0, 1 and -1.

        T is the identity plus a matrix whose square is zero, since positions depend on zeros and not the reverse.
        """
        return 2 * np.eye(self.dimension) - self.carried

    @cached_property
    def inputs(self) -> dict[str, int]:
        """Lengths of a prediction's inputs: z, command, parameters, `FilterSettings.process`, and `noise_inputs`."""
        parameters = int(self.equations.parameters.shape[0])
        return {
            "z": self.dimension, "command": 1, "parameters": parameters, "process": 11 + 2 * len(self.extra_names),
            "noise_inputs": 3,
        }  # fmt: skip

    def noise_inputs(self, covariance: ca.SX, change: ca.SX | float = 0.0, nis: ca.SX | float = 1.0) -> ca.SX:
        """Return the numbers (3,), other than the state, on which the process noise Q depends, see `predicted`.

        Args:
            covariance: covariance (N+E, N+E), from which the mean variance of the parameters' logarithms follows (0 if
                they are not estimated).
            change: change of acceleration from one period to the next, m/s², default 0 if unknown.
            nis: mean NIS per position, default 1.
        """
        variance = sum((covariance[i, i] for i in self.shares), ca.SX(0)) / max(len(self.shares), 1)
        return ca.vertcat(variance, change, nis)

    def _parameters(self, parameters: ca.SX, extra: dict[str, ca.SX]) -> ca.SX:
        """Return the base parameters (p,) with their estimated errors, with which the equations predict.

        Errors of M and S are logarithms, those of friction relative. "dry" adds Coulomb friction as a share of
        gravity's torque. The order of the parameters is that of `ArmChainParameters.base`.

        extra: estimated extras by name; missing ones count as zero.
        """
        n = self.arms
        factors = ca.SX.ones(parameters.shape[0])
        inertias = [f"M{i + 1}{j + 1}" for i in range(n) for j in range(i, n)]
        for entry, name in enumerate(inertias):
            factors[entry] = ca.exp(extra.get(name, ca.SX(0)))
        first = len(inertias)
        # The smoothing rate is the last one, if there is another law than the viscous one.
        laws = max(1, (parameters.shape[0] - first - 2 * n - 1) // n)
        for i in range(n):
            coupling_error, friction_error = extra.get(f"S{i + 1}", ca.SX(0)), extra.get(f"friction_{i + 1}", 0)
            factors[first + i] = factors[first + n + i] = ca.exp(coupling_error)
            for law in range(laws):
                factors[first + (2 + law) * n + i] += friction_error
        with_errors = parameters * factors
        for i in range(n if Augment.DRY in self.augment else 0):
            with_errors[first + 3 * n + i] += extra[f"dry_{i + 1}"] * parameters[first + i]
        return with_errors

    @cached_property
    def _parameter_function(self) -> ca.Function:
        """Parameters (p,) as a function of the model's (p,) and of a report's extras (E,), for `likely_parameters`.

        A report holds relative errors of M and S, but z their logarithms.
        """
        parameters = ca.SX.sym("parameters", self.inputs["parameters"])
        extra = ca.SX.sym("extra", len(self.extra_names))
        by_name = zip(self.extra_names, ca.vertsplit(extra), strict=True)
        errors = {name: ca.log1p(error) if name[0] in "MS" else error for name, error in by_name}
        return ca.Function("likely_parameters", [parameters, extra], [self._parameters(parameters, errors)])

    def likely_parameters(self, parameters: Array, extra: Array) -> Array:
        """Return the parameters (p,) with the errors that a run has estimated, each at most half of its parameter.

        Args:
            parameters: base parameters (p,).
            extra: extras (E,) of a report, in which errors of inertial parameters are relative.
        """
        bounded = np.clip(np.nan_to_num(extra), -_GREATEST_ERROR, _GREATEST_ERROR)
        return np.array(self._parameter_function(parameters, bounded)).ravel()

    def _braked(self, e: ca.SX, parameters: ca.SX) -> ca.SX:
        """Return the largest accelerations (n,) from dry friction, rad/s², by which its process noise is scaled.

        The friction is modelled or estimated, and each arm moves alone. e (E,): extras of z. parameters (p,): base
        parameters.
        """
        n, with_errors = (
            self.arms,
            self._parameters(parameters, dict(zip(self.extra_names, ca.vertsplit(e), strict=True))),
        )
        # Other equations than those of arms in a chain have no known order of parameters.
        if self.equations.linear_parameters is None:
            return ca.SX(n, 1)
        torques, inertias = with_errors[n * (n + 1) // 2 + 3 * n :], np.cumsum([0, *range(n, 1, -1)]).tolist()
        return ca.vertcat(*(ca.sum1(torques[i : min(i + 2, n)]) / with_errors[inertias[i]] for i in range(n)))

    @cached_property
    def _slopes(self) -> ca.Function:
        """(x, e, command, parameters) -> the state's rate (N,) and its Jacobians by x, by e and by the command.

        x (N,) is the state, e (E,) are the extras. Each stage of the Runge-Kutta step in `predicted` calls it.
        """
        size, n = self.equations.dimension, self.arms
        x, e = ca.SX.sym("x", size), ca.SX.sym("e", len(self.extra_names))
        command, parameters = ca.SX.sym("command"), ca.SX.sym("parameters", self.inputs["parameters"])
        extra = {name: e[i] for i, name in enumerate(self.extra_names)}
        pushed = ca.SX.zeros(size)
        for i in range(n):
            pushed[n + i] = extra.get(f"disturbance_{i + 1}", 0)
        rate = self.equations.function()
        slope = rate(x, command + extra.get("drive", 0), self._parameters(parameters, extra)) + pushed
        inputs = [x, e, command, parameters]
        linear = self.equations.linearised
        jacobians = (linear(slope, by, parameters) if by is x else ca.jacobian(slope, by) for by in (x, e, command))
        return ca.Function("f", inputs, [slope, *jacobians], {"cse": True})

    def predicted(
        self,
        z: ca.SX,
        command: ca.SX,
        parameters: ca.SX,
        process: ca.SX,
        noise_inputs: ca.SX,
        origin: ca.SX | None = None,
    ) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return z after a period, and its Jacobian and the process noise Q (N+E, N+E), both for T z (see `carried`).

        Args:
            z: present z (N+E,).
            command: acceleration of the cart during the period, m/s².
            parameters: base parameters (p,).
            process: noise parameters, see `FilterSettings.process`.
            noise_inputs: inputs of Q, see `noise_inputs`.
            origin: offset (N+E,) subtracted from z; None for zero.
        """
        size, n, step = self.equations.dimension, self.arms, self.period
        extras = len(self.extra_names)
        # State and extras are separate symbols here, for the Jacobians of each stage with respect to both.
        x, e = z[:size], z[size:]
        start = ca.horzcat(ca.SX.eye(size), ca.SX(size, extras))
        # The chain rule through the Runge-Kutta stages needs a third fewer instructions than one differentiation.
        moved, spread = x, start
        total, slopes, pushed = ca.SX.zeros(size), ca.SX(size, size + extras), ca.SX(size, 1)
        for weight, next_length in ((1, step / 2), (2, step / 2), (2, step), (1, None)):
            absolute = moved if origin is None else moved + origin[:size]
            # Stages of the classical Runge-Kutta method, with the Jacobian of each one.
            k, by_x, by_e, by_command = self._slopes(absolute, e, command, parameters)
            pushed += weight / 6 * by_command
            k_slope = by_x @ spread + ca.horzcat(ca.SX(size, size), by_e)
            total, slopes = total + weight * k, slopes + weight * k_slope
            if next_length is not None:
                moved, spread = x + next_length * k, start + next_length * k_slope
        decay = process[11 : 11 + extras]
        following = ca.vertcat(x + step / 6 * total, decay * e)
        jacobian = ca.vertcat(start + step / 6 * slopes, ca.horzcat(ca.SX(extras, size), ca.diag(decay)))
        block = np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]])
        noise, braked = ca.SX(self.dimension, self.dimension), self._braked(e, parameters)
        for i in range(n):
            # The Jacobian omits the squared parameter errors, which P does not cover.
            relative_density = process[1] + process[7] * noise_inputs[0] ** 2
            density = process[0] + relative_density * (following[n + i] - x[n + i]) ** 2 + process[10] * braked[i] ** 2
            noise[i, i], noise[n + i, n + i] = density * block[0, 0], density * block[1, 1]
            noise[i, n + i] = noise[n + i, i] = density * block[0, 1]
        for i in range(extras):
            noise[size + i, size + i] = process[11 + extras + i]
        # Unmodelled motion of the cart moves the arms as well.
        reach = ca.SX(self.dimension, 3)
        for position, rate in [*((i, n + i) for i in range(n)), (2 * n, 2 * n + 1)]:
            reach[position, 0] = reach[rate, 1] = pushed[rate]
        if "drive" in self.extra_names:
            reach[size + self.extra_names.index("drive"), 2] = 1
        pp, pv, vv, pd, vd = (process[k] for k in range(2, 7))
        cart_covariance = ca.vertcat(ca.horzcat(pp, pv, pd), ca.horzcat(pv, vv, vd), ca.horzcat(pd, vd, 0))
        # With unmodelled lag, the drive's error starts at the size of each command step.
        lag_error = process[9] * noise_inputs[1] * ca.DM([step**2 / 2, step, 1])
        # After a blow, or with a wrong model, process noise grows with the unexplained innovations.
        surprise = ca.fmax(1, noise_inputs[2]) ** process[8]
        noise = surprise * (noise + reach @ cart_covariance @ reach.T) + reach @ lag_error @ lag_error.T @ reach.T
        if self.as_measured:
            carried, restored = _sparse(self.carried), _sparse(self.restored)
            jacobian, noise = carried @ jacobian @ restored, carried @ noise @ carried.T
        return following, jacobian, noise

    def updated(
        self, z: ca.SX, covariance: ca.SX, measured: ca.SX, present: ca.SX, noise: ca.SX, timing: Timing | None = None
    ) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
        """Return an estimate after a measurement, by the formulas of the module's text.

        The results are z (N+E,), P (N+E, N+E) of T z, innovation y (n+1,), NIS, and S⁻¹ (y, ω) (n+1, 2) with the rates
        ω. The last one serves the estimate of the readings' age.

        Args:
            z: predicted z (N+E,).
            covariance: its covariance P (N+E, N+E), that of T z.
            measured: positions (n+1,) at the tick, rad and m, extrapolated by the rates of z if `timing` has an age.
            present: 1 for each valid position (n+1,), else 0.
            noise: lower triangle of R, row by row.
            timing: timing of the reading; None for a reading of the tick.
        """
        n, m = self.arms, self.arms + 1
        observation, selection = _sparse(self.observation), ca.diag(present)
        innovation = measured - observation @ z
        # Wrapped: a whole turn in a measured angle makes no difference.
        innovation = (
            ca.vertcat(*(ca.atan2(ca.sin(innovation[i]), ca.cos(innovation[i])) for i in range(n)), innovation[n])
            * present
        )
        noise_matrix = unpack(noise, m)
        if self.as_measured:
            observation = _sparse(self.observation @ self.restored)
        rates = [*range(n, 2 * n), 2 * n + 1]
        moving = (z[rates] if timing is None else timing.rates) * present
        if timing is not None:
            # The rates are uncertain too. With ω ωᵀ alone, an arm or a cart at rest would reveal the age of the reading
            # within a count, and errors of the rates would pass for errors of the model.
            noise_matrix += timing.variance * (moving @ moving.T + covariance[rates, rates])
            observation -= timing.age * _sparse(np.eye(self.dimension)[rates])
        crossed = covariance @ observation.T @ selection
        # Compute 1 - W first: 1 + S - 1 would cancel a cart variance of 1e-13 m².
        inverse, lower_inverse, pivots = _inverse(
            selection @ observation @ crossed + selection @ noise_matrix @ selection + (ca.SX.eye(m) - selection)
        )
        gain = crossed @ inverse
        # (I - K H) P, then Joseph's form without its larger products, which avoids cancellation in the second step.
        half = covariance - gain @ (observation @ covariance)
        updated_covariance = half + (gain @ noise_matrix - half @ observation.T) @ gain.T
        whitened = lower_inverse @ innovation
        correction = gain @ innovation
        z = z + (_sparse(self.restored) @ correction if self.as_measured else correction)
        return (
            z,
            updated_covariance,
            innovation,
            ca.sum1(whitened**2 / pivots),
            inverse @ ca.horzcat(innovation, moving),
        )

    def function(self, *, predicts: bool) -> ca.Function:
        """Return a filter's whole step, or its measurement update alone, as a casadi function.

        Inputs: memory (z, then P packed), command, measured (n+1), present (n+1), noise (R packed), parameters, process
        (`FilterSettings.process`). Outputs: memory, standard deviations (N+E), innovation (n+1), NIS, number of
        positions present, and a number that is finite exactly if the estimate is finite.

        Args:
            predicts: True for a whole step, False for the measurement update only.
        """
        z, command, parameters, process, _ = (ca.SX.sym(name, size) for name, size in self.inputs.items())
        m, size = self.arms + 1, self.dimension
        triangle = ca.SX.sym("P", size * (size + 1) // 2)
        measured, present = ca.SX.sym("measured", m), ca.SX.sym("present", m)
        noise = ca.SX.sym("noise", m * (m + 1) // 2)
        covariance = unpack(triangle, size)
        predicted = z
        if predicts:
            predicted, jacobian, process_noise = self.predicted(
                z, command, parameters, process, self.noise_inputs(covariance)
            )
            # Mirror one triangle so that casadi does not compute the other.
            covariance = unpack(propagated(jacobian, covariance, process_noise), size)
        updated, covariance, innovation, nis, _ = self.updated(predicted, covariance, measured, present, noise)
        sigmas = ca.vertcat(*(ca.sqrt(covariance[i, i]) for i in range(size)))
        # The last output is not finite if any part of the estimate is not, so one comparison detects it.
        sound = ca.sum1(updated) + ca.sum1(sigmas)
        result = ca.vertcat(updated, pack(covariance), sigmas, innovation, nis, ca.sum1(present), sound)
        memory = ca.SX.sym("memory", size + triangle.shape[0])
        result = ca.substitute(ca.densify(result), ca.vertcat(z, triangle), memory)
        inputs = {
            "memory": memory, "command": command, "measured": measured, "present": present, "noise": noise,
            "parameters": parameters, "process": process,
        }  # fmt: skip
        return ca.Function("filter", [*inputs.values()], [ca.cse(result)], [*inputs], ["out"], {"cse": True})

    def prediction(self, *, with_jacobian: bool) -> ca.Function:
        """Return the prediction over a period as a casadi function.

        Its inputs are z, command, parameters, process and noise_inputs.

        Args:
            with_jacobian: True to return the next z, its Jacobian and Q by columns, False for the next z only.
        """
        inputs = {name: ca.SX.sym(name, size) for name, size in self.inputs.items()}
        following, jacobian, process_noise = self.predicted(*inputs.values())
        parts = (
            [following, ca.vec(ca.densify(jacobian)), ca.vec(ca.densify(process_noise))]
            if with_jacobian
            else [following]
        )
        result = ca.densify(ca.vertcat(*parts))
        return ca.Function("prediction", [*inputs.values()], [ca.cse(result)], [*inputs], ["out"], {"cse": True})


RESTART_RATE = 10.0
"""Standard deviation of the rates after a restart, rad/s; typical of laboratory arms."""
RESTART_VELOCITY = 1.0
"""Standard deviation of the cart velocity after a restart, m/s."""


@lru_cache(maxsize=32)
def _compiled(
    equations: Equations, period: float, augments: tuple[Augment, ...]
) -> tuple[FilterEquations, Compiled, Compiled, Compiled]:
    """Return a filter's equations, and its step, measurement update and prediction as machine code.

    Cached, so that all filters of a process with the same equations, period (s) and extras (`augments`) compile once.
    """
    filter_equations = FilterEquations(equations, period, augments)
    step, update = (
        Compiled(filter_equations.function(predicts=True)),
        Compiled(filter_equations.function(predicts=False)),
    )
    return filter_equations, step, update, Compiled(filter_equations.prediction(with_jacobian=False))


_Outputs = namedtuple("_Outputs", "z covariance sigmas innovation nis used sound")
"""Outputs of `FilterEquations.function`.

used: number of positions present. sound: a number that is finite exactly if the estimate is.
"""


class KalmanFilter(Estimator):
    """Base of all filters, which compiles the model's equations.

    The functions `whole` and `correct` are the step and the measurement update alone; `ahead_of` is the prediction.
    `process` (P,) are the parameters of the process noise, see `FilterSettings.process`. All attributes are constant:
    the estimate before a step is an argument.
    """

    def __init__(self, model: SampledModel, settings: FilterSettings, *, noise: Array) -> None:
        """Compile the model's equations.

        Args:
            model: model of arms and drive from tick to tick.
            settings: settings of the filter.
            noise: covariance (n+1, n+1) of the measured positions.
        """
        self.model, self.settings, self.noise = model, settings, noise
        compiled = _compiled(model.equations, model.period, settings.augments)
        self.equations, self.whole, self.correct, self.ahead_of = compiled
        self.process = settings.process(model.arms, model.period)
        self.kind, self.extra_names = settings.kind, self.equations.extra_names

    def first(self, state: Array) -> Estimate:
        """Return the estimate before any measurement, with extras of zero.

        Args:
            state: initial state (N,), to which the settings give the standard deviations.
        """
        z = np.append(state, np.zeros(len(self.extra_names)))
        return self._begun(z, self.settings.first_covariance(self.model.arms))

    def restarted(self, estimate: Estimate, measured: Array) -> Estimate:
        """Return an estimate reset to measured positions, for recovery.

        Finite rates are kept with a large variance; the extras are reset.

        Args:
            estimate: last estimate.
            measured: positions (n+1,), rad and m; those that are not finite are kept as well.
        """
        arms, places = self.model.arms, self.model.position_indices
        state = np.where(np.isfinite(estimate.state), estimate.state, 0.0)
        state[arms : 2 * arms] = np.clip(state[arms : 2 * arms], -3 * RESTART_RATE, 3 * RESTART_RATE)
        state[-1] = np.clip(state[-1], -3 * RESTART_VELOCITY, 3 * RESTART_VELOCITY)
        state[places] = np.where(np.isfinite(measured), measured, state[places])
        covariance, rates = self.settings.first_covariance(arms), [*range(arms, 2 * arms), 2 * arms + 1]
        covariance[rates, rates] = [*[RESTART_RATE**2] * arms, RESTART_VELOCITY**2]
        return self._begun(np.append(state, np.zeros(len(self.extra_names))), covariance)

    @abstractmethod
    def _begun(self, z: Array, covariance: Array) -> Estimate:
        """Return the estimate z (N+E,) with this covariance (N+E, N+E) of its errors."""


class CompiledEkf(KalmanFilter):
    """The extended Kalman filter for one sampled model; an `Estimator`. Not thread-safe.

    Attributes:
        inputs: of `whole` and `correct`, (M,); each call overwrites memory, command and measurement, and missing
            positions also need finite values. `_ahead_inputs` are the inputs of `ahead_of`.
        out: layout of their outputs, of which z and covariance are the memory for the next tick.
    """

    def __init__(self, model: SampledModel, settings: FilterSettings, *, noise: Array) -> None:
        """Compile the filter and fill the inputs that do not change.

        Args:
            model: model of arms and drive from tick to tick.
            settings: settings of the filter.
            noise: covariance (n+1, n+1) of the measured positions.
        """
        super().__init__(model, settings, noise=noise)
        size, m, slices = self.equations.dimension, model.arms + 1, self.whole.slices
        self.out = Layout[_Outputs](_Outputs(size, size * (size + 1) // 2, size, m, 1, 1, 1))
        self.inputs, self._ahead_inputs = np.zeros(self.whole.size_in), np.zeros(self.ahead_of.size_in)
        self.inputs[slices["noise"]] = packed(noise)
        for inputs, places in ((self.inputs, slices), (self._ahead_inputs, self.ahead_of.slices)):
            inputs[places["parameters"]], inputs[places["process"]] = model.parameters, self.process

    def _begun(self, z: Array, covariance: Array) -> Estimate:
        """Return the estimate z (N+E,) with this covariance (N+E, N+E), before a measurement."""
        n, no_innovation = self.model.dimension, np.zeros(self.model.arms + 1)
        memory = np.append(z, packed(covariance))
        return Estimate(z[:n], z[n:], np.sqrt(covariance.diagonal()), no_innovation, float("nan"), 0, memory)

    def update(self, estimate: Estimate, measured: Array, present: Present = None) -> Estimate:
        """Return the estimate after a measurement.

        Args:
            estimate: estimate before it.
            measured: positions (n+1,), rad and m.
            present: flags (n+1,) of the valid positions.

        Raises:
            ArithmeticError: the estimate is no longer finite, or its covariance no longer positive.
        """
        return self._called(self.correct, estimate, measured, present)

    def step(self, estimate: Estimate, command: float, measured: Array, present: Present = None) -> Estimate:
        """Return the estimate a period later, after a prediction and a new measurement.

        Args:
            estimate: estimate one tick earlier.
            command: acceleration of the cart, m/s².
            measured: positions (n+1,), rad and m.
            present: True for each valid position (n+1,), None if all are valid.

        Raises:
            ArithmeticError: see `update`.
        """
        self.inputs[self.whole.slices["command"]] = command
        return self._called(self.whole, estimate, measured, present)

    def _called(self, function: Compiled, estimate: Estimate, measured: Array, present: Present) -> Estimate:
        """Return the estimate after a step or an update, the functions of which have the same inputs.

        measured (n+1,): positions, rad and m. present (n+1,): True for each valid one, None for all.
        """
        inputs, slices = self.inputs, self.whole.slices
        inputs[slices["memory"]] = estimate.memory
        valid = np.ones(len(measured), dtype=bool) if present is None else present
        # Replace NaN before the products: zero times NaN is NaN.
        inputs[slices["measured"]], inputs[slices["present"]] = np.where(valid, measured, 0.0), valid
        outputs = function.machine(inputs, np.empty(function.size_out))
        parts, n = self.out.of(outputs), self.model.dimension
        if not (0 <= (nis := parts.nis.item()) < inf and isfinite(parts.sound.item())):
            raise ArithmeticError(
                "the filter's covariance is no longer positive, or its state no longer finite; begin again from the "
                "measured positions, or assume more noise"
            )
        z, used, memory = parts.z, int(parts.used.item()), outputs[: len(estimate.memory)]
        return Estimate(z[:n], z[n:], parts.sigmas, parts.innovation, nis, used, memory)

    def ahead(self, estimate: Estimate, commands: Sequence[float]) -> Array:
        """Return the state (N,) after all pending commands, one per period.

        The extras act during the prediction. This compensates the delay: a new command is computed for the state at
        which it takes effect.

        Args:
            estimate: present estimate.
            commands: pending commands, oldest first, m/s².
        """
        inputs, n = self._ahead_inputs, self.equations.dimension
        z = estimate.memory[:n]
        for command in commands:
            inputs[:n], inputs[n] = z, command
            z = self.ahead_of.machine(inputs, np.empty(n))
        return z[: self.model.dimension]

    def covariance(self, estimate: Estimate) -> Array:
        """Return the covariance (N+E, N+E) of state and extra.

        Args:
            estimate: estimate of this filter.
        """
        return unpacked(estimate.memory[self.out.slices.covariance])
