"""Comparison of a recording with a model's prediction and with an estimator.

Three predictions are compared with the measured angles. One covers whole segments from the best-fitting initial state.
The others predict one sample and `ahead` samples from the estimate. If the cart moved, its motion is the input. The
encoders' zeros are subtracted from the angles if the model has them. Predictions are given as the encoders would show
them. In the log, the prediction is the reference.

The initial state of each stretch is fitted by multiple shooting, like those of an identification but with fixed ratios
and least squares.

The estimator receives only angles, as means of a few samples, corrected for the motion between them. If model and noise
are correct, its NIS has a chi-square distribution with one degree of freedom per angle:

    z = mean θ - ½ mean(τ²) θ̈(x̂),      R = R_encoder / M        (samples at times τ about their middle, over M ms)

A single sample of a real encoder is not Gaussian. It is constant when the arm turns back, and jumps by whole counts.
The 95 % band of single-sample NIS therefore contains only four fifths of the values. Means of ten samples are nearly
Gaussian. The model gives the correction for a curved motion.

Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, sections 5.4.2, 10.3.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.estimator_settings import EstimatorSettings, NisMeans, chi_square_band, nis_means
from dpcontrol.control.interface import SampledModel
from dpcontrol.dynamics.chain import ArmChainParameters, Level, base_ratios, equations_of
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.checked import checked
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.foundation.settings import Setting, Settings, suggest
from dpcontrol.foundation.shown import Brief
from dpcontrol.identification.fit import Swing, Swings, fit_starts
from dpcontrol.identification.windows import FitSettings
from dpcontrol.loop.bench import SensorSettings
from dpcontrol.loop.controllers import ESTIMATORS, make_estimator
from dpcontrol.loop.result import inside_95
from dpcontrol.recordings.recording import (
    REPLAYED,
    SUMMARY,
    CartMotion,
    Recording,
    cart_motion,
    described,
    write_samples,
)


@dataclass(frozen=True, eq=False)
class FittedPath(Brief):
    """Motion of a model that is nearest to a stretch of measured angles.

    Attributes:
        states: states (K, 2n) of the arms.
        residual: root mean square residual (n,) of each angle, rad.
        converged: True if the model follows the stretch.
        status: result in words.
    """

    states: Array
    residual: Array
    converged: bool
    status: str

    @property
    def rms(self) -> float:
        """Root mean square residual over all angles, rad."""
        return float(np.sqrt(np.mean(np.square(self.residual))))


_SHORT, _WHOLE = 0.5, 1e6
"""Windows of the fits of a start, s: short ones bridge chaos, and a single one suits a wrong model."""
_FOLLOWS = 0.5
"""Largest residual of a model that follows the angles, rad rms."""


def fitted_path(model: Swings, swing: Swing, ratios: Array) -> FittedPath:
    """Return the best-fitting motion for a stretch of angles, by which the model is judged.

    If the model cannot follow the stretch, for example because it is too long, the status reports it. The path is then
    the best one found.

    Args:
        model: integrator of the arms.
        swing: the stretch; missing angles are NaN.
        ratios: parameter ratios (m,) of the model.
    """
    n = model.arms.count
    fit_of = partial(fit_starts, model, [swing], parameters=ratios, zeros=np.zeros((1, n)))
    fit = fit_of(settings=FitSettings(window=_SHORT))
    if not fit.converged:
        fit = fit_of(settings=FitSettings(window=_WHOLE), near=fit.starts[:1])
    start, period = fit.starts[:1], np.array([swing.period])
    (path,), _ = model.flown(
        start,
        ratios,
        period=period,
        samples=len(swing.angles),
        accelerations=swing.accelerations,
        velocities=swing.velocities,
    )
    finite = np.isfinite(swing.angles)
    errors = np.where(finite, path[:, :n] - swing.angles, 0.0)
    residual = np.sqrt(np.sum(errors**2, axis=0) / np.maximum(np.sum(finite, axis=0), 1))
    follows = fit.converged and bool(finite.any() and residual.max() < _FOLLOWS)
    complaint = (
        "no initial state was found from which the model follows the angles; shorten the span, or identify the model"
    )
    status = "the initial state was fitted" if follows else complaint if finite.any() else "it contains no reading"
    return FittedPath(path, residual, follows, status)


_INDEPENDENT = 1e-3
"""Interval between samples with independent rounding, s; a swinging arm passes several counts in it."""


@dataclass(frozen=True, eq=False)
class RecordedEstimate(Brief):
    """An estimator's result for each sample of a recording.

    Attributes:
        states: estimated states (K, 2n) of the arms.
        sigmas: standard deviations (K, 2n) of these states.
        nis: NIS (K,), NaN except at the end of a mean.
    """

    states: Array
    sigmas: Array
    nis: Array


def estimate_recording(
    recording: Recording,
    arms: ArmChainParameters,
    filters: EstimatorSettings,
    carts: Sequence[CartMotion],
    *,
    counts: int,
    mean_over: float,
    progress: Progress = no_progress,
) -> RecordedEstimate:
    """Run an estimator over each segment of a recording, restarting in each, as a check of model and noise.

    A measurement is the mean of M samples, called `mean_of`, at times τ about their middle, `times`, and is corrected
    for the motion, see the head of this module. Its noise is that of a sample over the number of samples with
    independent rounding. The estimator steps from middle to middle under the mean acceleration of the cart between
    both. The equations of arms and cart need a cart position, which has no effect and is 0.

    Args:
        recording: angles in segments.
        arms: the model.
        filters: kind and process noise of the estimator.
        carts: cart motion of each segment. Empty if clamped.
        counts: encoder counts per turn.
        mean_over: duration of each mean, s. Samples within a millisecond share their rounding and count as one.
        progress: receiver of progress reports.

    Raises:
        InputError: a segment is shorter than a mean.
        GoalMissed: the estimator's covariance broke down.
    """
    n, total = recording.arms, len(recording.time)
    mean_of = max(1, round(mean_over / recording.dt))
    equations = equations_of(arms, Level.CART)
    model, rate = SampledModel(equations, arms.base(), period=mean_of * recording.dt), equations.function()
    noise = SensorSettings(counts=counts).covariance(n)
    noise[:n, :n] /= max(1.0, mean_of * min(1.0, recording.dt / _INDEPENDENT))
    estimator = make_estimator(filters, model, noise=noise)

    def rate_of(state: Array, drive: Array) -> Array:
        """Return the derivative (2n,) of the arms' state (2n,); `drive` is the cart's velocity and acceleration."""
        full = np.concatenate([state, [0.0, drive[0]]])
        return np.asarray(rate(full, drive[1], arms.base())).ravel()[: 2 * n]

    # The cart's measurement adds nothing about the arms, since its motion is an input.
    present = np.array([True] * n + [False])
    times: Array = np.asarray((np.arange(mean_of) - (mean_of - 1) / 2) * recording.dt, dtype=np.float64)
    result = RecordedEstimate(np.zeros((total, 2 * n)), np.zeros((total, 2 * n)), np.full(total, np.nan))
    for index, (first, end) in enumerate(recording.segments):
        zeros = np.zeros(end - first)
        cart = carts[index] if carts else CartMotion(zeros, zeros, zeros, commanded=False)
        means, drives, between_means, start = _means_of(recording, first, end, cart, mean_of)
        (guess,) = Swing(recording.angles[first:end], recording.dt).guess([0])
        first_state = _nearby(guess, rate_of(guess, drives[0])[n:], -times[:1])[0]
        estimate = estimator.first(np.concatenate([first_state, start]))
        rows = slice(first, first)
        try:
            for k in range(len(means)):
                rows = slice(first + k * mean_of, first + (k + 1) * mean_of)
                mean_acceleration = float(between_means[k - 1]) if k else 0.0
                expected = estimate.state if not k else estimator.ahead(estimate, [mean_acceleration])
                curvature = rate_of(np.asarray(expected[: 2 * n]), drives[k])[n:] * np.mean(times**2) / 2
                # A mean with missing samples has another centre in time, so it is skipped.
                has_reading = bool(np.isfinite(means[k]).all())
                measured = np.concatenate([means[k] - curvature if has_reading else np.zeros(n), [0.0]])
                if k:
                    estimate = estimator.step(estimate, mean_acceleration, measured, present & has_reading)
                    result.nis[rows.stop - 1] = estimate.nis if has_reading else np.nan
                else:
                    estimate = estimator.update(estimate, measured, present & has_reading)
                state = np.asarray(estimate.state[: 2 * n])
                # Too few samples for another mean belong to the last one.
                samples = slice(rows.start, rows.stop if k < len(means) - 1 else end)
                times_from_middle = times[0] + recording.dt * np.arange(samples.stop - samples.start)
                result.states[samples] = _nearby(state, rate_of(state, drives[k])[n:], times_from_middle)
                result.sigmas[samples] = estimate.sigmas[: 2 * n]
                if not k % 256:
                    progress("running the estimator", rows.stop / total)
        except ArithmeticError as error:
            raise GoalMissed(f"the estimator broke down at {recording.time[rows.start]:.6g} s: {error}") from error
    return result


def _means_of(
    recording: Recording, first: int, end: int, cart: CartMotion, mean_of: int
) -> tuple[Array, Array, Array, Array]:
    """Return means of `mean_of` samples of a segment, and the cart's motion at their middles, for the estimator.

    The segment has the samples `first` to `end` (not included) of the recording.

    Raises:
        InputError: the segment is shorter than a mean.

    Returns:
        Four arrays for B means. The first has the angles (B, n), rad. The second has the cart's velocity, m/s, and its
        mean acceleration, m/s² (B, 2). The third has its mean acceleration between neighbouring middles (B - 1,), m/s².
        The last has its position, m, and velocity, m/s, at the first middle (2,).
    """
    blocks = (end - first) // mean_of
    if not blocks:
        raise InputError(f"{recording.source}: a segment of {end - first} samples is shorter than a mean of {mean_of}")
    whole_means = recording.angles[first : first + blocks * mean_of]
    means: Array = np.asarray(np.mean(whole_means.reshape(blocks, mean_of, recording.arms), axis=1), dtype=float)
    at_middle = np.arange(blocks) * mean_of + mean_of // 2
    mean_accelerations = cart.acceleration[: blocks * mean_of].reshape(blocks, mean_of).mean(axis=1)
    start = np.array([cart.position[at_middle[0]], cart.velocity[at_middle[0]]])
    drives = np.column_stack([cart.velocity[at_middle], mean_accelerations])
    return means, drives, _between_means(cart.acceleration, mean_of, blocks), start


def _nearby(state: Array, acceleration: Array, times: Array) -> Array:
    """Return the states (M, 2n) at `times` (M,), s from the time of `state` (2n,), at a constant `acceleration` (n,).

    It gives the states at all samples of a mean from the state at its middle. `state` has n angles, rad, then their
    rates, rad/s; the acceleration is in rad/s². The times are a few ms.
    """
    n = len(acceleration)
    angles = state[:n] + np.outer(times, state[n:]) + np.outer(times**2 / 2, acceleration)
    return np.column_stack([angles, state[n:] + np.outer(times, acceleration)])


def _between_means(acceleration: Array, mean_of: int, blocks: int) -> Array:
    """Return the mean accelerations (B - 1,), m/s², between the middles of successive means of `mean_of` samples.

    `acceleration` (K,), m/s², is the cart's at each sample, held until the next. `blocks` is the number B of means.
    """
    # Velocity gained since the first sample, in units of m/s² times samples.
    velocity_gain = np.concatenate([[0.0], np.cumsum(acceleration)])
    # A middle between two samples is half a sample later.
    middles = mean_of * np.arange(blocks) + (mean_of - 1) / 2
    return np.diff(np.interp(middles, np.arange(len(velocity_gain)), velocity_gain)) / mean_of


_SETTLED = 0.1
"""Initial time of a segment that is excluded from statistics while the estimator finds the rates, s."""
_STARTS = 2000
"""Approximate number of predictions in the error of predictions some samples ahead."""
_MEAN_OVER, _SPAN = (0.015, 0.0), (5.0, 0.5)
"""Default duration of a mean with the cart clamped and moving, s."""
_FLOOR = 0.015
"""Process noise of the rates, rad/s/√s, in addition to the share of the accelerations and tuned with it."""
_CART_FLOOR = 1e-5
"""Process noise of a cart with known motion, m/s/√s; a larger value would affect the arms."""


@dataclass(frozen=True)
class ReplaySettings(Settings, table="replay"):
    """Encoders, means and spans of the comparison with a model.

    None selects 15 ms and 5 s with the cart clamped. With a moving cart it selects single samples, since commands
    change within a mean, and half a second, since errors near a saddle grow fiftyfold in that time.
    """

    counts: Annotated[int, Setting(least=1)] = 40_000
    """Encoder counts per turn, which set the noise."""
    mean_over: Annotated[float | None, Setting(least=0, most=0.02, unit="s")] = None
    """Duration of each mean for the estimator, s."""
    ahead: Annotated[int, Setting(least=1, most=100_000, unit="samples")] = 100
    """Samples of the longer prediction."""
    span: Annotated[float | None, Setting(least=0.05, most=1000, unit="s")] = None
    """Longest stretch that is predicted in one piece, s."""


@dataclass(frozen=True, eq=False)
class Replay(Brief, Documented):
    """A recording of K samples and the model's predictions for it, by which users judge a model.

    Attributes:
        recording: replayed recording.
    """

    KEYS: ClassVar[str] = (
        "log model estimator segments=stretch_errors nis_inside_95 nis_below_95 rates_rms cart status nis_means "
        "rms_ahead=ahead"
    )

    recording: Recording
    predicted: Array
    """States (K, 2n) of the arms, angles as the encoders would show them."""
    estimated: Array
    """Estimated states (K, 2n)."""
    sigmas: Array
    """Standard deviations (K, 2n) of the estimate."""
    nis: Array
    """NIS (K,), NaN except at the end of a mean."""
    carts: tuple[CartMotion, ...]
    """Cart motion of each segment. Empty if clamped."""
    stretches: tuple[tuple[int, int, int], ...]
    """Rows (segment, first, end) of each predicted stretch."""
    fits: tuple[FittedPath, ...]
    """Fit of each stretch."""
    ahead: dict[int, Array]
    """Rms errors {samples: (n,)} of predictions from the estimate, rad."""
    rates_rms: Array | None
    """Rms difference (n,) between estimated and recorded rates, rad/s, or None."""
    nis_inside_95: float
    """Share of the settled NIS in its two-sided 95 % band."""
    nis_below_95: float
    """Share below the 95 % quantile."""
    nis_means: NisMeans | None = None
    """Mean of the NIS, None if there is none."""
    model: str = ""
    """Name of the model."""
    estimator: str = ""
    """Kind of the estimator."""
    log: Path | None = None
    """Log that was written, or None."""

    @checked
    def summary(self, model: str) -> str:
        """Return a sentence on the model's prediction errors and the estimator's consistency.

        Args:
            model: name of the model.
        """
        rms = sorted(1e3 * fit.rms for fit in self.fits)
        seconds = max(end - first for _, first, end in self.stretches) * self.recording.dt
        total = len(self.nis) * self.recording.dt
        means = "" if self.nis_means is None else f", {self.nis_means.sentence}"
        return (
            f"{total:.4g} s predicted by {model}, {seconds:.3g} s from each fitted start: {np.median(rms):.3g} mrad "
            f"median rms, {rms[-1]:.3g} at worst; NIS {self.nis_inside_95:.1%} in its band{means}"
        )

    @property
    def cart(self) -> str:
        """The source of the cart's acceleration, or "" if the cart was clamped."""
        if not self.carts:
            return ""
        commanded = sum(cart.commanded for cart in self.carts)
        if not commanded:
            return "its recorded position"
        return f"the command in {commanded} of {len(self.carts)} segments, else its recorded position"

    @property
    def status(self) -> str:
        """A sentence on the stretches that the model could follow."""
        lost_stretches = [stretch for stretch, fit in zip(self.stretches, self.fits, strict=True) if not fit.converged]
        if not lost_stretches:
            return f"predicted {len(self.fits)} stretches"
        start = self.recording.time[lost_stretches[0][1]]
        reason = next(fit.status for fit in self.fits if not fit.converged)
        return f"{len(lost_stretches)} of {len(self.fits)} stretches, the first at {start:.4g} s: {reason}"

    @property
    def converged(self) -> bool:
        """True if the model could follow all stretches."""
        return all(fit.converged for fit in self.fits)

    @property
    def stretch_errors(self) -> list[dict[str, Any]]:
        """Prediction error of each stretch: rms in rad, of each angle and of all."""
        rows: list[dict[str, Any]] = []
        for (index, first, _), fit in zip(self.stretches, self.fits, strict=True):
            of_angles = {f"rms_angle_{i + 1}": float(value) for i, value in enumerate(fit.residual)}
            start = float(self.recording.time[first])
            rows.append({"index": index, "start": start, **of_angles, "rms": fit.rms, "converged": fit.converged})
        return rows


def filter_settings(name: str, *, model_error: float = 0.003) -> EstimatorSettings:
    """Return the settings of an estimator of recordings, with process noise for a model's error.

    The defaults, including that of `mean_over`, were tuned on two thirds of the rig's recording with its identified
    model. They have the shortest means whose share of NIS in the band is within 0.2 % of the maximum. The share is 90.7
    % there and 90.2 % on the held-out third, for EKF and UKF. Most values above the band occur while the inner joint is
    slow.

    Args:
        name: kind of the estimator.
        model_error: relative error of the model's accelerations.

    Raises:
        InputError: the kind is unknown, or the relative error is negative.
    """
    if name not in ESTIMATORS:
        raise InputError(f"--estimator {name}: unknown estimator; {suggest(name, ESTIMATORS)}")
    # Zeros belong to the model: if estimated here, they would absorb its errors. The cart's motion is an input,
    # unlike in a run's filter, which models the drive.
    return replace(
        ESTIMATORS[name](), parameter_error=model_error, rate_noise=_FLOOR, cart_noise=_CART_FLOOR, augment=()
    )


def replay_recording(
    recording: Recording,
    arms: ArmChainParameters,
    filters: EstimatorSettings,
    settings: ReplaySettings | None = None,
    *,
    zeros: Sequence[float] = (),
    progress: Progress = no_progress,
) -> Replay:
    """Compare a recording with a model's prediction and an estimator.

    The model predicts true angles. The result has angles as the encoders would show them, with the zeros added.
    Statistics exclude the first `_SETTLED` seconds of each segment, unless no samples would be left.

    Args:
        recording: angles in segments.
        arms: the model, with the same number of arms.
        filters: settings of the estimator.
        settings: noise and spans.
        zeros: recorded absolute angles at true zero, rad; all zero if empty.
        progress: receiver of progress reports.

    Raises:
        InputError: the model has another number of arms, the zeros are not one for each arm, the cart moved in only
            some segments, or a segment is shorter than a mean of samples.
        GoalMissed: the estimator's covariance broke down.
    """
    settings = settings or ReplaySettings()
    n = recording.arms
    if arms.count != n:
        raise InputError(f"{recording.source}: the recording has {n} arms and the model {arms.count}; choose another")
    if len(zeros) not in (0, n):
        raise InputError(f"{len(zeros)} zeros for {n} arms; give one for each")
    shown_zeros, shown_recording = np.zeros(2 * n), recording
    shown_zeros[: len(zeros)] = zeros
    recording = replace(recording, angles=recording.angles - shown_zeros[:n])
    carts = _carts(recording)
    model, ratios = Swings(arms), base_ratios(arms)
    stretches = _stretches(recording, _SPAN[bool(carts)] if settings.span is None else settings.span)
    velocity, acceleration = driven(recording, carts)
    progress("fitting initial states", 0.0)
    swings = [Swing(recording.angles[a:b], recording.dt, 0, acceleration[a:b], velocity[a:b]) for _, a, b in stretches]
    fits = [fitted_path(model, swing, ratios) for swing in swings]
    estimated = estimate_recording(
        recording,
        arms,
        filters,
        carts,
        counts=settings.counts,
        mean_over=_MEAN_OVER[bool(carts)] if settings.mean_over is None else settings.mean_over,
        progress=part_of(progress, 0.3, 0.9),
    )
    settled = np.concatenate([np.arange(end - first) * recording.dt >= _SETTLED for first, end in recording.segments])
    if not settled.any():
        settled[:] = True
    nis = estimated.nis[settled & np.isfinite(estimated.nis)]
    progress("predicting", 0.9)
    rates_rms = None
    if recording.rates is not None:
        rates_rms = np.sqrt(np.mean(np.square(estimated.states[settled, n:] - recording.rates[settled]), axis=0))
    return Replay(
        recording=shown_recording,
        predicted=np.concatenate([fit.states for fit in fits]) + shown_zeros,
        estimated=estimated.states + shown_zeros,
        sigmas=estimated.sigmas,
        nis=estimated.nis,
        carts=carts,
        stretches=stretches,
        fits=tuple(fits),
        ahead={
            k: _ahead(model, recording, estimated, settled, k, velocity, acceleration)
            for k in sorted({1, settings.ahead})
        },
        rates_rms=rates_rms,
        nis_inside_95=inside_95(nis, n),
        nis_below_95=float(np.mean(nis <= chi_square_band(n, share=0.9)[1])) if len(nis) else float("nan"),
        nis_means=nis_means(nis, n),
    )


def _carts(recording: Recording) -> tuple[CartMotion, ...]:
    """Return the cart motion of each segment, which is the input of predictions and estimator.

    The tuple is empty if the cart was clamped in all segments.

    Raises:
        InputError: the cart moved in only some segments.
    """
    carts = [cart_motion(part) for part in recording.split()]
    moving = tuple(cart for cart in carts if cart is not None)
    if moving and len(moving) < len(carts):
        clamped = next(k for k, cart in enumerate(carts) if cart is None)
        raise InputError(
            f"{recording.source}: the cart moves in some segments but not in others, such as segment {clamped}; "
            "import them separately"
        )
    return moving


def driven(recording: Recording, carts: tuple[CartMotion, ...]) -> tuple[Array, Array]:
    """Return the cart's velocity and acceleration (K,) over all segments, zero if the cart was clamped.

    Args:
        recording: the recording.
        carts: motion of the cart in each segment, empty if it was clamped.

    Returns:
        Velocities, m/s, and accelerations, m/s².
    """
    if not carts:
        return np.zeros(len(recording.time)), np.zeros(len(recording.time))
    return np.concatenate([cart.velocity for cart in carts]), np.concatenate([cart.acceleration for cart in carts])


def _stretches(recording: Recording, span: float) -> tuple[tuple[int, int, int], ...]:
    """Return (segment, first, end) of the stretches that are predicted in one piece and together cover all samples.

    A stretch lasts about `span` s at most, and has the samples from `first` to `end`, which is not included.
    """
    stretches = []
    for index, (first, end) in enumerate(recording.segments):
        parts = int(np.ceil((end - first) * recording.dt / span))
        edges = np.linspace(first, end, max(parts, 1) + 1).round().astype(int)
        stretches += [(index, int(start), int(stop)) for start, stop in pairwise(edges)]
    return tuple(stretches)


def _ahead(
    model: Swings,
    recording: Recording,
    estimated: RecordedEstimate,
    settled: NDArray[np.bool_],
    samples: int,
    velocity: Array,
    acceleration: Array,
) -> Array:
    """Return the rms error (n,) of angles predicted `samples` ahead from the estimate, rad.

    A prediction starts from the state of `estimated` at the end of a mean, and must end in the same segment. If there
    is no such start, all errors are NaN. `settled` (K,) is True for samples after the estimator's beginning. `velocity`
    and `acceleration` (K,) are the cart's, m/s and m/s². `model` integrates the arms.
    """
    # True for samples whose segment also has the sample to predict.
    has_target = np.zeros(len(settled), dtype=bool)
    for first, end in recording.segments:
        has_target[first : max(first, end - samples)] = True
    # At the end of a mean, the estimate includes all samples up to it and none after.
    starts = np.flatnonzero(has_target & settled & np.isfinite(estimated.nis))
    starts = starts[:: max(1, len(starts) // _STARTS)]
    if not len(starts):
        return np.full(recording.arms, np.nan)
    states, ratios, period = estimated.states[starts], base_ratios(model.arms), np.full(len(starts), recording.dt)
    for k in range(samples):
        states = model.flown(
            states,
            ratios,
            period=period,
            samples=2,
            accelerations=acceleration[starts + k, None],
            velocities=velocity[starts + k, None],
        )[0][:, 1]
    error = states[:, : recording.arms] - recording.angles[starts + samples]
    return np.sqrt(np.nanmean(np.square(error), axis=0))


def write_replay(result: Replay, path: Path | str, *, model: str, model_text: str, force: bool = False) -> Path:
    """Write a replay as a log: measured angles, the estimate, and the prediction as reference.

    If the cart moved, its motion is the input of both estimate and prediction.

    Args:
        result: the replay.
        path: log to write.
        model: name of the model.
        model_text: text of the model's file.
        force: True to replace any file, default False.

    Returns:
        Path of the log.

    Raises:
        InputError: the file cannot be written.
    """
    recording = result.recording
    estimated, predicted, sigmas = result.estimated, result.predicted, result.sigmas
    velocity, acceleration = driven(recording, result.carts)
    if recording.cart is not None:
        cart_states = np.column_stack([recording.cart, velocity])
        estimated, predicted = np.column_stack([estimated, cart_states]), np.column_stack([predicted, cart_states])
        sigmas = np.column_stack([sigmas, np.zeros_like(cart_states)])
    control = {"nis": result.nis, "applied": acceleration}
    if recording.command is not None:
        control["command"] = recording.command
    # An event for each predicted stretch of samples, from the first one to the end, which is not included.
    pieces = [
        (
            first,
            end,
            "info" if fit.converged else "warn",
            f"segment {index}: predicted to {1e3 * fit.rms:.2f} mrad rms",
        )
        for (index, first, end), fit in zip(result.stretches, result.fits, strict=True)
    ]
    return write_samples(
        recording, path, "replay", pieces,
        metadata=described(recording, kind=REPLAYED) | {"model": model, SUMMARY: result.summary(model)},
        states={"estimate": estimated, "reference": predicted}, control=control, sigmas=sigmas,
        attachments={"model.toml": model_text.encode()}, force=force,
    )  # fmt: skip
