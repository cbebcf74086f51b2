"""What a model would have done where a recording says what the bench did, and what an estimator makes of the angles.

Three predictions, each compared with the measured angles: over whole segments from the initial state that fits best;
one sample and `ahead` samples from the estimate. Where the cart moved, its motion is the input. Angles are taken less
the encoders' zeros, where the model gives them, and predictions are given as the encoders would show them; as a log,
the prediction is the reference.

The initial states of all stretches are fitted at once:

    minimise over x_0:  Σ_k |θ(t_k; x_0) - θ_k|²    for each stretch    (Levenberg–Marquardt; ∂θ/∂x_0 by differences)

Every stretch and every perturbed copy of it is one lane of the same compiled step, so fifteen fits cost what one does.

The estimator sees angles alone, as means of a few samples, corrected for the motion within them; its NIS has a
chi-square distribution with as many degrees of freedom as angles if model and noise are as stated:

    z = mean θ - ½ mean(τ²) θ̈(x̂),      R = R_encoder / M        (samples at times τ about their middle, over M ms)

One sample of a real encoder is not Gaussian: it sticks when the arm turns back and jumps by whole counts, so the
95 % band of a single sample's NIS holds four fifths of them. Means of ten come close to Gaussian, and what a mean
misses of a curved motion is known from the model.

Sources: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, sections 5.4.2, 10.3;
Nocedal & Wright, Numerical Optimization (2006), section 10.3.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.estimator_settings import EstimatorSettings, NisMeans, chi_square_band, nis_means
from dpcontrol.control.interface import SampledModel
from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.dynamics.compiled import compiled_step
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.files import picked
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.foundation.settings import Settings, setting, suggest
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

    moving: whether the pivot is on a cart; then `paths` is given its motion. Not to be shared between threads.
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
        held = np.zeros((samples, lanes))
        if cart is not None:
            copies = lanes // len(cart.velocities)
            whole[size + 1] = np.tile(cart.velocities, copies)
            held = np.tile(cart.accelerations, copies)
        out = np.empty((samples, size, lanes))
        out[0] = states
        for k in range(1, samples):
            if self.moving:
                inputs[where["inputs"]] = held[k - 1]
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

    @property
    def rms(self) -> float:
        """Root mean square over all angles, rad."""
        return float(np.sqrt(np.mean(np.square(self.residual))))


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
        # Even the shortest step gains nothing: this is the minimum.
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
    lost = "no initial state was found that the model follows the angles from: shorten the span, or identify the model"
    return FittedPath(path.copy(), residual, converged, "the initial state is fitted" if converged else lost)


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
    carts: Sequence[CartMotion],
    *,
    counts: int,
    mean_over: float,
    progress: Progress = no_progress,
) -> RecordedEstimate:
    """Run an estimator over each segment of a recording, starting afresh in each.

    Args:
        recording: angles in segments.
        arms: the model.
        carts: how the cart moved in each segment, where it did; empty: clamped.
        filters: kind and process noise of the estimator.
        counts: of an encoder per turn.
        mean_over: s of each mean; samples less than a millisecond apart share their rounding and count as one.
        progress: called with how far it is.

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

    def change(state: Array, drive: Array) -> Array:
        """Return how the arms' state (2n,) changes while the cart has a velocity and an acceleration."""
        whole = np.concatenate([state, [0.0, drive[0]]])
        return np.asarray(rate(whole, drive[1], arms.base())).ravel()[: 2 * n]

    # The cart's own measurement says nothing of the arms: its motion is given, and a clamped one stands still.
    present = np.array([True] * n + [False])
    times: Array = np.asarray((np.arange(mean_of) - (mean_of - 1) / 2) * recording.dt, dtype=np.float64)
    out = RecordedEstimate(np.zeros((total, 2 * n)), np.zeros((total, 2 * n)), np.full(total, np.nan))
    for index, (first, end) in enumerate(recording.segments):
        still = np.zeros(end - first)
        cart = carts[index] if carts else CartMotion(still, still, still, commanded=False)
        blocks = (end - first) // mean_of
        if not blocks:
            raise InputError(
                f"{recording.source}: a segment of {end - first} samples is shorter than a mean of {mean_of}"
            )
        used = recording.angles[first : first + blocks * mean_of]
        means: Array = np.asarray(np.mean(used.reshape(blocks, mean_of, n), axis=1), dtype=float)
        at_middle = np.arange(blocks) * mean_of + mean_of // 2
        felt = cart.acceleration[: blocks * mean_of].reshape(blocks, mean_of).mean(axis=1)
        between = _between_means(cart.acceleration, mean_of, blocks)
        drives = np.column_stack([cart.velocity[at_middle], felt])
        guess = first_guess(recording.angles[first:end], recording.dt)
        middle = _nearby(guess, change(guess, drives[0])[n:], -times[:1])[0]
        start = [cart.position[at_middle[0]], cart.velocity[at_middle[0]]]
        estimate = estimator.first(np.concatenate([middle, start]))
        rows = slice(first, first)
        try:
            for k in range(blocks):
                rows = slice(first + k * mean_of, first + (k + 1) * mean_of)
                moved = float(between[k - 1]) if k else 0.0
                expected = estimate.state if not k else estimator.ahead(estimate, [moved])
                bend = change(np.asarray(expected[: 2 * n]), drives[k])[n:] * np.mean(times**2) / 2
                # A mean that lacks a sample is not of this time, and is left out.
                known = bool(np.isfinite(means[k]).all())
                measured = np.concatenate([means[k] - bend if known else np.zeros(n), [0.0]])
                if k:
                    estimate = estimator.step(estimate, moved, measured, present & known)
                    out.nis[rows.stop - 1] = estimate.nis if known else np.nan
                else:
                    estimate = estimator.update(estimate, measured, present & known)
                state = np.asarray(estimate.state[: 2 * n])
                out.states[rows] = _nearby(state, change(state, drives[k])[n:], times)
                out.sigmas[rows] = estimate.sigmas[: 2 * n]
                if not k % 256:
                    progress("running the estimator", rows.stop / total)
        except ArithmeticError as error:
            raise GoalMissed(f"the estimator broke down at {recording.time[rows.start]:.6g} s: {error}") from error
        for row in range(rows.stop, end):
            # Too few for a mean.
            state = out.states[row - 1]
            halfway = state + recording.dt / 2 * change(state, drives[-1])
            out.states[row] = state + recording.dt * change(halfway, drives[-1])
            out.sigmas[row] = out.sigmas[row - 1]
    return out


def _nearby(state: Array, acceleration: Array, times: Array) -> Array:
    """Return the states (M, 2n) at `times` (M,) s from `state` (2n,), a few ms away."""
    n = len(acceleration)
    angles = state[:n] + np.outer(times, state[n:]) + np.outer(times**2 / 2, acceleration)
    return np.column_stack([angles, state[n:] + np.outer(times, acceleration)])


def _between_means(acceleration: Array, mean_of: int, blocks: int) -> Array:
    """Return the mean accelerations m/s² from the middle of each mean of `mean_of` samples to that of the next."""
    total = np.concatenate([[0.0], np.cumsum(acceleration)])
    # A middle between two samples stands half a sample on.
    middles = mean_of * np.arange(blocks) + (mean_of - 1) / 2
    return np.diff(np.interp(middles, np.arange(len(total)), total)) / mean_of


_SETTLED = 0.1
"""s of a segment in which the estimator may still find the rates: left out of what is said of it."""
_STARTS = 2000
_MEAN_OVER, _SPAN = (0.015, 0.0), (5.0, 0.5)
"""s: with the cart clamped, and where it moved."""
_FLOOR = 0.015
"""rad/s/√s: process noise of the rates besides the share of the accelerations, chosen with it."""
_CART_FLOOR = 1e-5
"""m/s/√s: of a cart that is clamped, or whose own motion is the input; more would move the arms as well."""


@dataclass(frozen=True)
class ReplaySettings(Settings, table="replay"):
    """counts: of an encoder per turn, the stated noise; mean_over s: of each mean that the estimator is given;
    ahead: samples of the longer prediction; span s: the longest stretch that is predicted in one piece, longer segments
    are cut into equal parts.

    None: 15 ms and 5 s with the cart clamped. Where it moved single samples, for a command changes within a mean, and
    half a second, for near a saddle errors grow fiftyfold in that time.
    """

    counts: int = setting(40_000, least=1)
    mean_over: float | None = setting(None, least=0, most=0.02, unit="s")
    ahead: int = setting(100, least=1, most=100_000, unit="samples")
    span: float | None = setting(None, least=0.05, most=1000, unit="s")


@dataclass(frozen=True, eq=False)
class Replay:
    """A recording of K samples beside what a model says of it.

    predicted and estimated (K, 2n): the arms' states, the angles as the encoders would show them; sigmas (K, 2n): the
    estimate's standard deviations; carts: how the cart moved in each segment, empty where it was clamped; nis (K,), nan
    where no mean of samples ends. stretches: (segment, first, end) rows of each predicted stretch, fits one for each.
    ahead: {samples: (n,) rad rms of each angle} from the estimate. rates_rms (n,) rad/s: estimate against the recorded
    rates, or None. nis_inside_95: share of the settled NIS in its two-sided 95 % band; nis_below_95: below its 95 %
    quantile; nis_means: of its means, None where there is none.
    """

    recording: Recording
    predicted: Array
    estimated: Array
    sigmas: Array
    nis: Array
    carts: tuple[CartMotion, ...]
    stretches: tuple[tuple[int, int, int], ...]
    fits: tuple[FittedPath, ...]
    ahead: dict[int, Array]
    rates_rms: Array | None
    nis_inside_95: float
    nis_below_95: float
    nis_means: NisMeans | None = None

    def summary(self, model: str) -> str:
        """Return a sentence: how well this model predicts, and whether the estimator agrees with it."""
        rms = sorted(1e3 * fit.rms for fit in self.fits)
        seconds = max(end - first for _, first, end in self.stretches) * self.recording.dt
        whole = len(self.nis) * self.recording.dt
        means = "" if self.nis_means is None else f", {self.nis_means.sentence}"
        return (
            f"{whole:.4g} s predicted by {model}, {seconds:.3g} s from each fitted start: {np.median(rms):.3g} mrad "
            f"rms in the median, {rms[-1]:.3g} at worst; NIS {self.nis_inside_95:.1%} in its band{means}"
        )

    @property
    def cart(self) -> str:
        """Return what the cart's acceleration was taken from, or "" where it was clamped."""
        if not self.carts:
            return ""
        commanded = sum(cart.commanded for cart in self.carts)
        if not commanded:
            return "its recorded position" + (
                "; the command does not explain it" if self.recording.command is not None else ""
            )
        if commanded == len(self.carts):
            return "the command" + ("" if self.recording.cart is None else ", which explains its position")
        return f"the command in {commanded} of {len(self.carts)} segments, else its recorded position"

    @property
    def status(self) -> str:
        """Return a sentence: how many stretches the model could follow."""
        lost = [stretch for stretch, fit in zip(self.stretches, self.fits, strict=True) if not fit.converged]
        if not lost:
            return f"predicted {len(self.fits)} stretches"
        start = self.recording.time[lost[0][1]]
        reason = next(fit.status for fit in self.fits if not fit.converged)
        return f"{len(lost)} of {len(self.fits)} stretches, the first at {start:.4g} s: {reason}"

    @property
    def stretch_errors(self) -> list[dict[str, Any]]:
        """What the prediction of each stretch is off: rms in rad, of each angle and of all."""
        rows: list[dict[str, Any]] = []
        for (index, first, _), fit in zip(self.stretches, self.fits, strict=True):
            own = {f"rms_angle_{i + 1}": float(value) for i, value in enumerate(fit.residual)}
            start = float(self.recording.time[first])
            rows.append({"index": index, "start": start, **own, "rms": fit.rms, "converged": fit.converged})
        return rows

    def document(self) -> dict[str, Any]:
        """Return what `dpcontrol replay --json` prints, the log's and the model's names apart."""
        return {
            "segments": self.stretch_errors,
            **picked(self, "nis_inside_95", "nis_below_95", "rates_rms", "cart", "status"),
            "nis_means": None if self.nis_means is None else asdict(self.nis_means),
            "rms_ahead": {str(samples): rms for samples, rms in self.ahead.items()},
        }


def filter_settings(name: str, *, model_error: float = 0.003) -> EstimatorSettings:
    """Return the settings of a kind of estimator whose model's accelerations are right to the share `model_error`.

    The defaults, and that of `mean_over`, were chosen on two thirds of the rig's recording with its identified model:
    of those whose share of the NIS in its band is within 0.2 % of the greatest, the shortest means. The share is 90.7 %
    there and 90.2 % on the third left out, EKF and UKF alike; most of what is above the band is where the inner joint
    is slow.

    Raises:
        InputError: there is no such kind, or the share is negative.
    """
    if name not in ESTIMATORS:
        raise InputError(f"--estimator {name}: there is no such estimator; {suggest(name, ESTIMATORS)}")
    # Zeros belong to the model: estimated here, they would absorb its errors. The cart's motion is given: in a run's
    # filter it is a drive that may do otherwise.
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
    """Predict a recording by a model, its cart clamped or moved as it was recorded, and run an estimator over it.

    Args:
        recording: angles in segments.
        arms: the model, of as many arms.
        filters: the estimator's settings.
        settings: noise and spans.
        zeros: what the recorded absolute angles show where the true ones are zero, rad; all zero if empty.
        progress: called with how far it is.

    Raises:
        InputError: the model has another number of arms, or the cart moved in some of the segments only.
        GoalMissed: the estimator's covariance broke down.
    """
    settings = settings or ReplaySettings()
    n = recording.arms
    if arms.count != n:
        raise InputError(f"{recording.source}: the recording has {n} arms and the model {arms.count}; choose another")
    if len(zeros) not in (0, n):
        raise InputError(f"{len(zeros)} zeros for {n} arms; give one for each")
    shown, shown_recording = np.zeros(2 * n), recording
    shown[: len(zeros)] = zeros
    recording = replace(recording, angles=recording.angles - shown[:n])
    carts = _carts(recording)
    motion = FreeMotion(arms, period=recording.dt, moving=bool(carts))
    stretches = _stretches(recording, _SPAN[bool(carts)] if settings.span is None else settings.span)
    pieces = [recording.angles[first:end] for _, first, end in stretches]
    velocity, acceleration = driven(recording, carts)
    moved = [(velocity[first:end], acceleration[first:end]) for _, first, end in stretches] if carts else []
    fits = fit_initial_states(motion, pieces, moved, progress=part_of(progress, 0.0, 0.5))
    found = estimate_recording(
        recording,
        arms,
        filters,
        carts,
        counts=settings.counts,
        mean_over=_MEAN_OVER[bool(carts)] if settings.mean_over is None else settings.mean_over,
        progress=part_of(progress, 0.5, 0.9),
    )
    settled = np.concatenate([np.arange(end - first) * recording.dt >= _SETTLED for first, end in recording.segments])
    if not settled.any():
        settled[:] = True
    known = found.nis[settled & np.isfinite(found.nis)]
    progress("predicting", 0.9)
    rates_rms = None
    if recording.rates is not None:
        rates_rms = np.sqrt(np.mean(np.square(found.states[settled, n:] - recording.rates[settled]), axis=0))
    return Replay(
        recording=shown_recording,
        predicted=np.concatenate([fit.states for fit in fits]) + shown,
        estimated=found.states + shown,
        sigmas=found.sigmas,
        nis=found.nis,
        carts=carts,
        stretches=stretches,
        fits=tuple(fits),
        ahead={
            k: _ahead(motion, recording, found, settled, k, velocity, acceleration) for k in sorted({1, settings.ahead})
        },
        rates_rms=rates_rms,
        nis_inside_95=inside_95(known, n),
        nis_below_95=float(np.mean(known <= chi_square_band(n, share=0.9)[1])) if len(known) else float("nan"),
        nis_means=nis_means(known, n),
    )


def _carts(recording: Recording) -> tuple[CartMotion, ...]:
    """Return how the cart moved in each segment; empty where it was clamped.

    Raises:
        InputError: it moved in some only.
    """
    found = [cart_motion(part) for part in recording.split()]
    moved = tuple(cart for cart in found if cart is not None)
    if moved and len(moved) < len(found):
        still = next(k for k, cart in enumerate(found) if cart is None)
        raise InputError(
            f"{recording.source}: the cart moves in some segments and stands in others, as in segment {still}; "
            "import them apart"
        )
    return moved


def driven(recording: Recording, carts: tuple[CartMotion, ...]) -> tuple[Array, Array]:
    """Return the cart's velocity and acceleration (K,) over all segments, zero where it was clamped."""
    if not carts:
        return np.zeros(len(recording.time)), np.zeros(len(recording.time))
    return np.concatenate([c.velocity for c in carts]), np.concatenate([c.acceleration for c in carts])


def _stretches(recording: Recording, span: float) -> tuple[tuple[int, int, int], ...]:
    """Return (segment, first, end) of the stretches that are predicted in one piece; together they are all samples."""
    found = []
    for index, (first, end) in enumerate(recording.segments):
        parts = int(np.ceil((end - first) * recording.dt / span))
        edges = np.linspace(first, end, max(parts, 1) + 1).round().astype(int)
        found += [(index, int(a), int(b)) for a, b in pairwise(edges)]
    return tuple(found)


def _ahead(
    motion: FreeMotion,
    recording: Recording,
    found: RecordedEstimate,
    settled: NDArray[np.bool_],
    samples: int,
    velocity: Array,
    acceleration: Array,
) -> Array:
    """Return the rms error (n,) rad of angles predicted `samples` ahead from the estimate; nan where none fits."""
    inside = np.zeros(len(settled), dtype=bool)
    for first, end in recording.segments:
        inside[first : max(first, end - samples)] = True
    # Where a mean ends, the estimate has seen all samples before and none after.
    rows = np.flatnonzero(inside & settled & np.isfinite(found.nis))
    rows = rows[:: max(1, len(rows) // _STARTS)]
    if not len(rows):
        return np.full(recording.arms, np.nan)
    states = np.ascontiguousarray(found.states[rows].T)
    for k in range(samples):
        cart = CartDrive(velocity[rows + k], acceleration[None, rows + k]) if motion.moving else None
        states = motion.paths(states, 2, cart)[1]
    error = states[: recording.arms].T - recording.angles[rows + samples]
    return np.sqrt(np.nanmean(np.square(error), axis=0))


def write_replay(result: Replay, path: Path | str, *, model: str, model_text: str, force: bool = False) -> Path:
    """Write measured angles with the estimate and, as the reference, the prediction; return the log's path.

    Where the cart moved, estimate and prediction hold its motion as the input that it was.

    Raises:
        InputError: the file cannot be written.
    """
    recording = result.recording
    estimated, predicted, sigmas = result.estimated, result.predicted, result.sigmas
    velocity, acceleration = driven(recording, result.carts)
    if recording.cart is not None:
        pivot = np.column_stack([recording.cart, velocity])
        estimated, predicted = np.column_stack([estimated, pivot]), np.column_stack([predicted, pivot])
        sigmas = np.column_stack([sigmas, np.zeros_like(pivot)])
    control = {"nis": result.nis, "applied": acceleration}
    if recording.command is not None:
        control["command"] = recording.command
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
