"""An estimator run over a recording's angles: over means of a few samples, corrected for the motion within them.

    z = mean θ - ½ mean(τ²) θ̈(x̂),      R = R_encoder / M        (samples at times τ about their middle, over M ms)

One sample of a real encoder is no Gaussian number: it sticks when the arm turns back and jumps by whole counts, so the
95 % band of a single sample's NIS holds four fifths of them. Means of ten come close to Gaussian, and what a mean
misses of a curved motion is known from the model.

Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, sections 5.4.2, 10.3.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.estimation import make_estimator
from dpcontrol.control.estimator_settings import EstimatorSettings
from dpcontrol.control.sampled import SampledModel
from dpcontrol.dynamics.arm_chain import Level, equations_of
from dpcontrol.dynamics.equations import NumericEquations
from dpcontrol.dynamics.parameters import ArmChainParameters
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.lab.cart_motion import CartMotion
from dpcontrol.lab.initial_states import first_guess
from dpcontrol.lab.recordings import Recording
from dpcontrol.lab.sensors import SensorSettings

Array = NDArray[np.float64]

_INDEPENDENT = 1e-3
"""s: an arm that swings passes several counts in this time, so that roundings this far apart are independent."""


@dataclass(frozen=True, eq=False)
class RecordedEstimate:
    """States (K, 2n) and their standard deviations, for each sample; nis (K,), nan but where a mean ends."""

    states: Array
    sigmas: Array
    nis: Array


def estimate_recording(
    recording: Recording,
    arms: ArmChainParameters,
    filters: EstimatorSettings,
    carts: Sequence[CartMotion] = (),
    *,
    counts: int,
    mean_over: float,
    progress: Progress = no_progress,
) -> RecordedEstimate:
    """Run an estimator over each segment of a recording, beginning anew in each.

    Args:
        recording: angles in segments.
        arms: the model.
        carts: how the cart moved in each segment, where it did; empty: clamped.
        filters: kind and process noise of the estimator.
        counts: of an encoder per turn.
        mean_over: s of each mean; samples less than a millisecond apart share their rounding and count as one.
        progress: told how far it is.

    Raises:
        InputError: a segment is shorter than a mean.
        GoalMissed: the estimator's covariance broke down.
    """
    n, total = recording.arms, len(recording.time)
    mean_of = max(1, round(mean_over / recording.dt))
    model = SampledModel(equations_of(arms, Level.CART), arms.base(), period=mean_of * recording.dt)
    change = _Change(arms, moving=bool(carts))
    noise = SensorSettings(counts=counts).covariance(n)
    noise[:n, :n] /= max(1.0, mean_of * min(1.0, recording.dt / _INDEPENDENT))
    estimator = make_estimator(filters, model, noise=noise)
    # The cart's own measurement says nothing of the arms: its motion is given, and a clamped one stands still.
    present = np.array([True] * n + [False])
    times: Array = np.asarray((np.arange(mean_of) - (mean_of - 1) / 2) * recording.dt, dtype=np.float64)
    out = RecordedEstimate(np.zeros((total, 2 * n)), np.zeros((total, 2 * n)), np.full(total, np.nan))
    for index, (first, end) in enumerate(recording.segments):
        cart = _Cart(carts[index] if carts else None, mean_of)
        blocks = (end - first) // mean_of
        if not blocks:
            raise InputError(
                f"{recording.source}: a segment of {end - first} samples is shorter than a mean of {mean_of}"
            )
        used = recording.angles[first : first + blocks * mean_of]
        means: Array = np.asarray(np.mean(used.reshape(blocks, mean_of, n), axis=1), dtype=float)
        guess = first_guess(recording.angles[first:end], recording.dt)
        middle = _nearby(guess, change(guess, cart, 0)[n:], -times[:1])[0]
        estimate = estimator.first(np.concatenate([middle, cart.start]))
        rows = slice(first, first)
        try:
            for k in range(blocks):
                rows = slice(first + k * mean_of, first + (k + 1) * mean_of)
                moved = cart.between(k)
                expected = estimate.state if not k else estimator.ahead(estimate, [moved])
                bend = change(np.asarray(expected[: 2 * n]), cart, k)[n:] * np.mean(times**2) / 2
                # A mean that lacks a sample is not of this time, and is left out.
                known = bool(np.isfinite(means[k]).all())
                measured = np.concatenate([means[k] - bend if known else np.zeros(n), [0.0]])
                if k:
                    estimate = estimator.step(estimate, moved, measured, present & known)
                    out.nis[rows.stop - 1] = estimate.nis if known else np.nan
                else:
                    estimate = estimator.update(estimate, measured, present & known)
                state = np.asarray(estimate.state[: 2 * n])
                out.states[rows] = _nearby(state, change(state, cart, k)[n:], times)
                out.sigmas[rows] = estimate.sigmas[: 2 * n]
                if not k % 256:
                    progress("running the estimator", rows.stop / total)
        except ArithmeticError as error:
            raise GoalMissed(f"the estimator broke down at {recording.time[rows.start]:.6g} s: {error}") from error
        for row in range(rows.stop, end):
            # Too few for a mean.
            state = out.states[row - 1]
            halfway = state + recording.dt / 2 * change(state, cart, blocks - 1)
            out.states[row] = state + recording.dt * change(halfway, cart, blocks - 1)
            out.sigmas[row] = out.sigmas[row - 1]
    return out


def _nearby(state: Array, acceleration: Array, times: Array) -> Array:
    """Return the states (M, 2n) at `times` (M,) s from `state` (2n,), a few ms away."""
    n = len(acceleration)
    angles = state[:n] + np.outer(times, state[n:]) + np.outer(times**2 / 2, acceleration)
    return np.column_stack([angles, state[n:] + np.outer(times, acceleration)])


class _Cart:
    """A segment's cart by means of `mean_of` samples: how it moves in each, and from one's middle to the next."""

    def __init__(self, motion: CartMotion | None, mean_of: int) -> None:
        self.start = np.zeros(2)
        self._motion, self._mean_of, self._within, self._between = motion, mean_of, np.zeros(0), np.zeros(0)
        if motion is not None:
            middle = mean_of // 2
            self.start = np.array([motion.position[middle], motion.velocity[middle]])
            blocks = len(motion.acceleration) // mean_of
            self._within = motion.acceleration[: blocks * mean_of].reshape(blocks, mean_of).mean(axis=1)
            total = np.concatenate([[0.0], np.cumsum(motion.acceleration)])
            # A middle between two samples stands half a sample on.
            steps = np.arange(len(total))
            middles = mean_of * np.arange(blocks) + (mean_of - 1) / 2
            self._between = np.diff(np.interp(middles, steps, total)) / mean_of

    def between(self, k: int) -> float:
        """Return the mean acceleration m/s² from the middle of mean k - 1 to that of mean k."""
        return float(self._between[k - 1]) if self._motion is not None and k else 0.0

    def within(self, k: int) -> tuple[float, float]:
        """Return the mean acceleration m/s² in mean k, and the velocity m/s at its middle."""
        if self._motion is None:
            return 0.0, 0.0
        return float(self._within[k]), float(self._motion.velocity[k * self._mean_of + self._mean_of // 2])


class _Change:
    """How the arms' states (2n,) change, in the middle of mean k of a segment."""

    def __init__(self, arms: ArmChainParameters, *, moving: bool) -> None:
        self._size, self._base = 2 * arms.count, arms.base()
        self._still = NumericEquations(equations_of(arms, Level.DISSIPATIVE), self._base)
        self._moved = equations_of(arms, Level.CART).function() if moving else None

    def __call__(self, state: Array, cart: _Cart, k: int) -> Array:
        if self._moved is None:
            return self._still.rate(state)
        acceleration, velocity = cart.within(k)
        whole = np.concatenate([state, [0.0, velocity]])
        return np.asarray(self._moved(whole, acceleration, self._base)).ravel()[: self._size]
