"""The extended Kalman filter's step as one expression: state and extras, covariance, innovation, NIS.

    predict:  z⁻ = F(z, u),  P⁻ = A P Aᵀ + Q(z)         update:  y = wrap(m - H z⁻),  S = W (H P⁻ Hᵀ + R) W + I - W,
    K = P⁻ Hᵀ W S⁻¹,  z = z⁻ + K y,  P = (I - K H) P⁻ (I - K H)ᵀ + K R Kᵀ,  NIS = yᵀ S⁻¹ y

z: the state and what it is augmented by; m: angles and cart position. W is diagonal: 1 where a position was measured, 0
where not, which leaves it out exactly. Joseph's form keeps P positive where P⁻ exceeds R by more than the arithmetic
resolves. P is carried as its lower triangle, row by row, so it cannot lose its symmetry.

Q stands for wrong parameters, whose effect is a share of the acceleration: an arm at rest has little.
Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, sections 5.2.6, 10.3.
"""

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.estimator_settings import Augment, extra_names
from dpcontrol.dynamics.equations import Equations

Array = NDArray[np.float64]


def packed(matrix: Array) -> Array:
    """Return the lower triangle of `matrix` (…, n, n), row by row, as (…, n(n+1)/2)."""
    rows, columns = np.tril_indices(matrix.shape[-1])
    return matrix[..., rows, columns]


def unpacked(triangle: Array) -> Array:
    """Return the symmetric matrix (…, n, n) of its lower triangle (…, n(n+1)/2)."""
    n = int(np.sqrt(2 * triangle.shape[-1]))
    rows, columns = np.tril_indices(n)
    out = np.empty((*triangle.shape[:-1], n, n))
    out[..., rows, columns] = triangle
    out[..., columns, rows] = triangle
    return out


def _pack(matrix: ca.SX) -> ca.SX:
    return ca.vertcat(*(matrix[i, j] for i in range(matrix.shape[0]) for j in range(i + 1)))


def _unpack(triangle: ca.SX, n: int) -> ca.SX:
    out = ca.SX(n, n)
    for i in range(n):
        for j in range(i + 1):
            out[i, j] = out[j, i] = triangle[i * (i + 1) // 2 + j]
    return out


def _inverse(matrix: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the inverse of a small positive definite matrix, and its factors: L⁻¹ and D of L D Lᵀ."""
    n = matrix.shape[0]
    lower, d = ca.SX.eye(n), ca.SX(n, 1)
    for j in range(n):
        d[j] = matrix[j, j] - sum((lower[j, k] ** 2 * d[k] for k in range(j)), ca.SX(0))
        for i in range(j + 1, n):
            lower[i, j] = (matrix[i, j] - sum((lower[i, k] * lower[j, k] * d[k] for k in range(j)), ca.SX(0))) / d[j]
    back = ca.SX.eye(n)
    for i in range(n):
        for j in range(i):
            back[i, j] = -sum((lower[i, k] * back[k, j] for k in range(j, i)), ca.SX(0))
    return back.T @ ca.diag(1 / d) @ back, back, d


@dataclass(frozen=True, eq=False)
class FilterEquations:
    """A model of the cart level, sampled at `period` s, with what it is augmented by."""

    equations: Equations
    period: float
    augment: tuple[Augment, ...]

    @property
    def arms(self) -> int:
        """Number of arms."""
        return (self.equations.dimension - 2) // 2

    @property
    def extra_names(self) -> tuple[str, ...]:
        """Names of the extra quantities."""
        return extra_names(self.arms, self.augment)

    @property
    def dimension(self) -> int:
        """Length of state and extra together, N+E."""
        return self.equations.dimension + len(self.extra_names)

    @cached_property
    def observation(self) -> Array:
        """Return H (n+1, N+E): the measured positions of state and extra."""
        n = self.arms
        out = np.zeros((n + 1, self.dimension))
        out[np.arange(n + 1), [*range(n), 2 * n]] = 1.0
        for i, name in enumerate(self.extra_names):
            if name.startswith("zero_"):
                out[int(name.removeprefix("zero_")) - 1, self.equations.dimension + i] = 1.0
        return out

    @cached_property
    def _symbols(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        extras = len(self.extra_names)
        return (
            ca.SX.sym("z", self.dimension),
            ca.SX.sym("command"),
            ca.SX.sym("parameters", self.equations.parameters.shape[0]),
            ca.SX.sym("process", 3 + 2 * extras),
        )

    def _parameters(self, parameters: ca.SX, extra: dict[str, ca.SX]) -> ca.SX:
        """Return the parameters with the relative errors that `extra` holds."""
        n = self.arms
        factors = ca.SX.ones(parameters.shape[0])
        inertias = [f"M{i + 1}{j + 1}" for i in range(n) for j in range(i, n)]
        for c, name in enumerate(inertias):
            factors[c] += extra.get(name, 0)
        first = len(inertias)
        laws = (parameters.shape[0] - first - 2 * n) // n
        for i in range(n):
            coupling, friction = extra.get(f"S{i + 1}", 0), extra.get(f"friction_{i + 1}", 0)
            factors[first + i] += coupling
            factors[first + n + i] += coupling
            for law in range(laws):
                factors[first + (2 + law) * n + i] += friction
        return parameters * factors

    @cached_property
    def _prediction(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """The next z, its Jacobian and Q."""
        z, command, parameters, process = self._symbols
        size, n, step = self.equations.dimension, self.arms, self.period
        extras = len(self.extra_names)
        x, e = z[:size], z[size:]
        extra = {name: e[i] for i, name in enumerate(self.extra_names)}
        # The state and the extras stand apart here, for the Jacobians of the stages by both.
        rate = self.equations.function()
        pushed = ca.SX.zeros(size)
        for i in range(n):
            pushed[n + i] = extra.get(f"disturbance_{i + 1}", 0)
        slope = rate(x, command + extra.get("drive", 0), self._parameters(parameters, extra)) + pushed
        inputs = [x, e, command, parameters]
        f = ca.Function("f", inputs, [slope, ca.jacobian(slope, x), ca.jacobian(slope, e)], {"cse": True})
        start = ca.horzcat(ca.SX.eye(size), ca.SX(size, extras))
        # The chain rule through the stages of Runge-Kutta takes two thirds of the instructions of one differentiation.
        moved, spread = x, start
        total, slopes = ca.SX.zeros(size), ca.SX(size, size + extras)
        for weight, further in ((1, step / 2), (2, step / 2), (2, step), (1, None)):
            k, by_x, by_e = f(moved, e, command, parameters)
            k_slope = by_x @ spread + ca.horzcat(ca.SX(size, size), by_e)
            total, slopes = total + weight * k, slopes + weight * k_slope
            if further is not None:
                moved, spread = x + further * k, start + further * k_slope
        decay = process[3 : 3 + extras]
        following = ca.vertcat(x + step / 6 * total, decay * e)
        jacobian = ca.vertcat(start + step / 6 * slopes, ca.horzcat(ca.SX(extras, size), ca.diag(decay)))
        block = np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]])
        noise = ca.SX(self.dimension, self.dimension)
        densities = [process[0] + process[1] * (following[n + i] - x[n + i]) ** 2 for i in range(n)]
        for density, pair in zip(
            [*densities, process[2]], [*((i, n + i) for i in range(n)), (2 * n, 2 * n + 1)], strict=True
        ):
            for a, i in enumerate(pair):
                for b, j in enumerate(pair):
                    noise[i, j] = density * block[a, b]
        for i in range(extras):
            noise[size + i, size + i] = process[3 + extras + i]
        return following, jacobian, noise

    def _updated(
        self, z: ca.SX, covariance: ca.SX, measured: ca.SX, present: ca.SX, noise: ca.SX
    ) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Return z, P, innovation and NIS after a measurement."""
        n, m = self.arms, self.arms + 1
        h, w = ca.sparsify(ca.SX(ca.DM(self.observation))), ca.diag(present)
        y = measured - h @ z
        # Wrapped: a whole turn in a measured angle makes no difference.
        y = ca.vertcat(*(ca.atan2(ca.sin(y[i]), ca.cos(y[i])) for i in range(n)), y[n]) * present
        r = _unpack(noise, m)
        crossed = covariance @ h.T @ w
        # 1 - W first: one plus S minus one would leave nothing of a cart's variance of 1e-13 m².
        inverse, back, d = _inverse(w @ h @ crossed + w @ r @ w + (ca.SX.eye(m) - w))
        gain = crossed @ inverse
        # (I - K H) P; then Joseph's form without its larger products: nothing large is subtracted the second time.
        half = covariance - gain @ (h @ covariance)
        after = half + (gain @ r - half @ h.T) @ gain.T
        white = back @ y
        return z + gain @ y, after, y, ca.sum1(white**2 / d)

    def function(self, *, predicts: bool) -> ca.Function:
        """Return the step as a casadi function; without `predicts` the measurement alone.

        Inputs: memory (z, then P packed), command, measured (n+1), present (n+1), noise (R packed), parameters, process
        (`FilterSettings.process`), coming: the command of the next period. Output: memory, standard deviations (N+E),
        innovation (n+1), z a period later under `coming`, NIS, number present, and a number that is finite if the
        estimate is.
        """
        z, command, parameters, process = self._symbols
        m, size = self.arms + 1, self.dimension
        triangle = ca.SX.sym("P", size * (size + 1) // 2)
        measured, present = ca.SX.sym("measured", m), ca.SX.sym("present", m)
        noise = ca.SX.sym("noise", m * (m + 1) // 2)
        covariance = _unpack(triangle, size)
        before = z
        if predicts:
            before, jacobian, q = self._prediction
            covariance = jacobian @ covariance @ jacobian.T + q
            # Both triangles from one: casadi need not work out the other.
            covariance = _unpack(_pack(covariance), size)
        after, covariance, y, nis = self._updated(before, covariance, measured, present, noise)
        sigmas = ca.vertcat(*(ca.sqrt(covariance[i, i]) for i in range(size)))
        # The last is no number as soon as anything in the estimate is none: one look tells.
        sound = ca.sum1(after) + ca.sum1(sigmas)
        # Within the same call this costs a sixth of a call of its own.
        coming = ca.SX.sym("coming")
        later = self.prediction(with_jacobian=False)(after, coming, parameters, process)
        out = ca.vertcat(after, _pack(covariance), sigmas, y, later, nis, ca.sum1(present), sound)
        inputs = {
            "memory": ca.vertcat(z, triangle),
            "command": command,
            "measured": measured,
            "present": present,
            "noise": noise,
            "parameters": parameters,
            "process": process,
            "coming": coming,
        }
        memory = ca.SX.sym("memory", size + triangle.shape[0])
        out = ca.substitute(ca.densify(out), inputs["memory"], memory)
        inputs["memory"] = memory
        return ca.Function("filter", [*inputs.values()], [ca.cse(out)], [*inputs], ["out"], {"cse": True})

    def prediction(self, *, with_jacobian: bool) -> ca.Function:
        """Return (z, command, parameters, process) -> next z, or next z, its Jacobian and Q, column by column."""
        z, command, parameters, process = self._symbols
        following, jacobian, q = self._prediction
        parts = [following, ca.vec(ca.densify(jacobian)), ca.vec(ca.densify(q))] if with_jacobian else [following]
        inputs = {"z": z, "command": command, "parameters": parameters, "process": process}
        out = ca.densify(ca.vertcat(*parts))
        return ca.Function("prediction", [*inputs.values()], [ca.cse(out)], [*inputs], ["out"], {"cse": True})
