"""Which initial states make a model follow recorded angles best: all stretches at once.

    minimise over x_0:  Σ_k |θ(t_k; x_0) - θ_k|²    for each stretch    (Levenberg–Marquardt; ∂θ/∂x_0 by differences)

Every stretch and every perturbed copy of it is one lane of the same compiled step, so fifteen fits cost what one does.
Source: Nocedal & Wright, Numerical Optimization (2006), section 10.3.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.arm_chain import Level, equations_of
from dpcontrol.dynamics.fixed_step import compiled_step
from dpcontrol.dynamics.parameters import ArmChainParameters
from dpcontrol.foundation.progress import Progress, no_progress

Array = NDArray[np.float64]

_DIFFERENCE = 1e-6
"""rad and rad/s: of the derivatives; errors of 1e-12 · e^(λt) leave six digits after a few Lyapunov times."""
_ITERATIONS = 25
_ENOUGH = 1e-6
"""Relative gain in the sum of squares below which a fit has ended."""
_GUESS_SECONDS = 0.02


@dataclass(frozen=True, eq=False)
class CartDrive:
    """How the carts of C stretches move: velocities (C,) m/s at first, accelerations (K, C) m/s² held between samples.

    The arms do not feel where a cart is.
    """

    velocities: Array
    accelerations: Array


class FreeMotion:
    """Arms on a pivot that rests or is moved, sampled every `period` s, for many motions at once.

    moving: whether the pivot is on a cart; then `paths` is told how it moves. Not to be shared between threads.
    """

    def __init__(self, arms: ArmChainParameters, *, period: float, moving: bool = False) -> None:
        self.arms = arms.count
        self.period = period
        self.moving = moving
        self._step = compiled_step(equations_of(arms, Level.CART if moving else Level.DISSIPATIVE))
        self._base = arms.base()

    def paths(self, states: Array, samples: int, cart: CartDrive | None = None) -> Array:
        """Return the arms' states (samples, N, S) that follow from `states` (N, S), the first included.

        cart: for each lane, or for each of C stretches with S a multiple of C.
        """
        size, lanes = states.shape
        inputs = np.zeros((self._step.size_in, lanes))
        where = self._step.slices
        inputs[where["duration"]] = self.period
        inputs[where["parameters"]] = self._base[:, None]
        whole, following = inputs[where["state"]], np.empty((self._step.size_out, lanes))
        whole[:size] = states
        copies = 1 if cart is None else lanes // len(cart.velocities)
        if cart is not None:
            whole[size + 1] = np.tile(cart.velocities, copies)
        out = np.empty((samples, size, lanes))
        out[0] = states
        for k in range(1, samples):
            if cart is not None:
                inputs[where["inputs"]] = np.tile(cart.accelerations[k - 1], copies)
            self._step(inputs, following)
            whole[:] = following
            out[k] = following[:size]
        return out


def first_guess(angles: Array, period: float) -> Array:
    """Return the state (2n,) at the first of `angles` (K, n): a parabola through the first 20 ms that are known."""
    count = int(np.clip(round(_GUESS_SECONDS / period), 5, len(angles)))
    rows = np.flatnonzero(np.isfinite(angles).all(axis=1))[:count]
    if not len(rows):
        return np.zeros(2 * angles.shape[1])
    curve = np.polynomial.polynomial.polyfit(period * rows, angles[rows], min(2, len(rows) - 1))
    return np.concatenate([curve[0], curve[1] if len(rows) > 1 else np.zeros(angles.shape[1])])


@dataclass(frozen=True, eq=False)
class FittedPath:
    """The motion nearest to a stretch: states (K, 2n); residual (n,) rad rms of each angle; status, a sentence."""

    states: Array
    residual: Array
    converged: bool
    status: str


def fit_initial_states(
    motion: FreeMotion,
    stretches: Sequence[Array],
    carts: Sequence[tuple[Array, Array]] = (),
    *,
    progress: Progress = no_progress,
) -> list[FittedPath]:
    """Return for each stretch of angles (K, n), nan where one is missing, the motion that follows it best.

    carts: of each stretch the velocities (K,) m/s and accelerations (K,) m/s² of its cart, where the pivot is moved.

    A stretch over which the motion cannot be followed, for it is longer than the model predicts, has a status that
    says so; its path is the best that was found.
    """
    n, count = motion.arms, len(stretches)
    size, longest = 2 * n, max(len(angles) for angles in stretches)
    measured = np.zeros((longest, n, count))
    inside = np.zeros((longest, 1, count))
    for s, angles in enumerate(stretches):
        known = np.asarray(np.isfinite(angles).all(axis=1))
        measured[: len(angles), :, s] = np.where(known[:, None], angles, 0.0)
        inside[: len(angles), 0, s] = known
    cart = None
    if carts:
        accelerations = np.zeros((longest, count))
        for s, (_, acceleration) in enumerate(carts):
            accelerations[: len(acceleration), s] = acceleration
        cart = CartDrive(np.array([velocity[0] for velocity, _ in carts]), accelerations)
    states = np.stack([first_guess(angles, motion.period) for angles in stretches], axis=1)
    damping = np.full(count, 1e-6)
    path = motion.paths(states, longest, cart)
    cost = _cost(path, measured, inside)
    ended = np.zeros(count, dtype=bool)
    for iteration in range(_ITERATIONS):
        progress("fitting initial states", iteration / _ITERATIONS)
        lanes = np.repeat(states[:, None, :], size, axis=1) + _DIFFERENCE * np.eye(size)[:, :, None]
        moved = motion.paths(lanes.reshape(size, -1), longest, cart)[:, :n].reshape(longest, n, size, count)
        slopes = (moved - path[:, :n, None, :]) / _DIFFERENCE * inside[:, :, None, :]
        residual = (path[:, :n] - measured) * inside
        normal = np.einsum("kais,kajs->sij", slopes, slopes)
        gradient = np.einsum("kais,kas->si", slopes, residual)
        scale = np.einsum("sii->si", normal)
        finite = np.isfinite(normal).all(axis=(1, 2)) & np.isfinite(gradient).all(axis=1) & (scale > 0).all(axis=1)
        normal[~finite], gradient[~finite], scale[~finite] = np.eye(size), 0.0, 1.0
        damped = normal + damping[:, None, None] * scale[:, :, None] * np.eye(size)
        tried = states - np.linalg.solve(damped, gradient[:, :, None])[:, :, 0].T
        following = motion.paths(tried, longest, cart)
        lower = _cost(following, measured, inside)
        better = lower < cost
        # From an infinite cost any finite one is better, and no end.
        gained = np.where(np.isfinite(cost), cost, np.inf) - np.where(np.isfinite(lower), lower, 0.0)
        ended |= better & (gained <= _ENOUGH * cost) & np.isfinite(cost)
        states = np.where(better, tried, states)
        path = np.where(better, following, path)
        cost = np.where(better, lower, cost)
        damping = np.clip(np.where(better, damping / 10, damping * 10), 1e-12, 1e9)
        # A step that gains nothing however short it is has nothing left to gain.
        ended |= ~better & (damping >= 1e3)
        if ended.all():
            break
    return [_fitted(path[: len(angles), :, s], angles, bool(ended[s])) for s, angles in enumerate(stretches)]


def _cost(path: Array, measured: Array, inside: Array) -> Array:
    n = measured.shape[1]
    total = np.sum(np.square((path[:, :n] - measured) * inside), axis=(0, 1))
    return np.where(np.isfinite(total), total, np.inf)


def _fitted(path: Array, angles: Array, converged: bool) -> FittedPath:
    known = np.isfinite(angles).all(axis=1)
    if not known.any():
        return FittedPath(path.copy(), np.zeros(angles.shape[1]), False, "it holds no reading")
    residual = np.sqrt(np.mean(np.square((path[:, : angles.shape[1]] - angles)[known]), axis=0))
    status = (
        "the initial state is fitted"
        if converged
        else (
            "no initial state was found that the model follows the angles from: shorten the span, or identify the model"
        )
    )
    return FittedPath(path.copy(), residual, converged, status)
