"""An estimator run over a recording's angles: over means of a few samples, corrected for the motion within them.

    z = mean θ - ½ mean(τ²) θ̈(x̂),      R = R_encoder / M        (samples at times τ about their middle, over M ms)

One sample of a real encoder is no Gaussian number: it sticks when the arm turns back and jumps by whole counts, so the
95 % band of a single sample's NIS holds four fifths of them. Means of ten come close to Gaussian, and what a mean
misses of a curved motion is known from the model.

Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, sections 5.4.2, 10.3.
"""

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
from dpcontrol.foundation.files import Progress, no_progress
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
    *,
    counts: int,
    mean_over: float,
    progress: Progress = no_progress,
) -> RecordedEstimate:
    """Run an estimator over each segment of a recording with the cart clamped, beginning anew in each.

    Args:
        recording: angles in segments.
        arms: the model.
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
    still = NumericEquations(equations_of(arms, Level.DISSIPATIVE), arms.base())
    model = SampledModel(equations_of(arms, Level.CART), arms.base(), period=mean_of * recording.dt)
    noise = SensorSettings(counts=counts).covariance(n)
    noise[:n, :n] /= max(1.0, mean_of * min(1.0, recording.dt / _INDEPENDENT))
    estimator = make_estimator(filters, model, noise=noise)
    # The cart is not measured: it stands still in the model as it does on the bench.
    present = np.array([True] * n + [False])
    times: Array = np.asarray((np.arange(mean_of) - (mean_of - 1) / 2) * recording.dt, dtype=np.float64)
    out = RecordedEstimate(np.zeros((total, 2 * n)), np.zeros((total, 2 * n)), np.full(total, np.nan))
    for first, end in recording.segments:
        blocks = (end - first) // mean_of
        if not blocks:
            raise InputError(
                f"{recording.source}: a segment of {end - first} samples is shorter than a mean of {mean_of}"
            )
        used = recording.angles[first : first + blocks * mean_of]
        means: Array = np.asarray(np.mean(used.reshape(blocks, mean_of, n), axis=1), dtype=float)
        guess = first_guess(recording.angles[first:end], recording.dt)
        middle = _nearby(guess, still.rate(guess)[n:], -times[:1])[0]
        estimate = estimator.first(np.concatenate([middle, [0.0, 0.0]]))
        rows = slice(first, first)
        try:
            for k in range(blocks):
                rows = slice(first + k * mean_of, first + (k + 1) * mean_of)
                expected = estimate.state if not k else estimator.ahead(estimate, [0.0])
                bend = still.rate(np.asarray(expected[: 2 * n]))[n:] * np.mean(times**2) / 2
                measured = np.concatenate([means[k] - bend, [0.0]])
                if k:
                    estimate = estimator.step(estimate, 0.0, measured, present)
                    out.nis[rows.stop - 1] = estimate.nis
                else:
                    estimate = estimator.update(estimate, measured, present)
                state = np.asarray(estimate.state[: 2 * n])
                out.states[rows] = _nearby(state, still.rate(state)[n:], times)
                out.sigmas[rows] = estimate.sigmas[: 2 * n]
                if not k % 256:
                    progress("running the estimator", rows.stop / total)
        except ArithmeticError as error:
            raise GoalMissed(f"the estimator broke down at {recording.time[rows.start]:.6g} s: {error}") from error
        _finish(out, still, rows.stop, end, recording.dt)
    return out


def _nearby(state: Array, acceleration: Array, times: Array) -> Array:
    """Return the states (M, 2n) at `times` (M,) s from `state` (2n,), a few ms away."""
    n = len(acceleration)
    angles = state[:n] + np.outer(times, state[n:]) + np.outer(times**2 / 2, acceleration)
    return np.column_stack([angles, state[n:] + np.outer(times, acceleration)])


def _finish(out: RecordedEstimate, still: NumericEquations, begin: int, end: int, period: float) -> None:
    """Carry the last estimate through the samples that are too few for a mean."""
    for row in range(begin, end):
        state = out.states[row - 1]
        halfway = state + period / 2 * still.rate(state)
        out.states[row] = state + period * still.rate(halfway)
        out.sigmas[row] = out.sigmas[row - 1]
