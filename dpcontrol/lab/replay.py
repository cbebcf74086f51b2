"""What a model would have done where a recording says what the bench did, and what an estimator makes of the angles.

Three predictions, each compared with the measured angles: over whole segments from the initial state that fits best;
one sample and `ahead` samples from the estimate. Where the cart moved, its motion is the input
(`dpcontrol.lab.cart_motion`). Angles are taken less the encoders' zeros, where the model tells them, and predictions
are given as the encoders would show them. The estimator (`dpcontrol.lab.recorded_estimate`) sees angles
alone; its NIS has a chi-square distribution with as many degrees of freedom as angles if model and noise are as stated.

Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, section 5.4.2.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.consistency import chi_square_band
from dpcontrol.control.estimation import ESTIMATORS
from dpcontrol.control.estimator_settings import EstimatorSettings
from dpcontrol.dynamics.parameters import ArmChainParameters
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.foundation.tables import suggest
from dpcontrol.lab.cart_motion import CartMotion, cart_motion
from dpcontrol.lab.initial_states import CartDrive, FittedPath, FreeMotion, fit_initial_states
from dpcontrol.lab.recorded_estimate import RecordedEstimate, estimate_recording
from dpcontrol.lab.recordings import Recording

Array = NDArray[np.float64]

_SETTLED = 0.1
"""s of a segment in which the estimator may still find the rates: left out of what is said of it."""
_STARTS = 2000
_MEAN_OVER, _SPAN = (0.015, 0.0), (5.0, 0.5)
"""s: with the cart clamped, and where it moved."""
_FLOOR = 0.015
"""rad/s/√s: process noise of the rates besides the share of the accelerations, chosen with it."""


@dataclass(frozen=True)
class ReplaySettings:
    """counts: of an encoder per turn, the stated noise; mean_over s: of each mean that the estimator is given;
    ahead: samples of the longer prediction; span s: the longest stretch that is predicted in one piece, longer segments
    are cut into equal parts.

    None: 15 ms and 5 s with the cart clamped. Where it moved single samples, for a command changes within a mean, and
    half a second, for near a saddle errors grow fiftyfold in that time.
    """

    counts: int = 40_000
    mean_over: float | None = None
    ahead: int = 100
    span: float | None = None

    def __post_init__(self) -> None:
        """Refuse what no replay can do.

        Raises:
            InputError: names the setting, its value and what is allowed.
        """
        if self.counts < 1:
            raise InputError(f"replay: counts = {self.counts}: must be at least 1 for a turn")
        if self.mean_over is not None and not 0 <= self.mean_over <= 0.02:
            raise InputError(f"replay: mean_over = {self.mean_over!r}: must be 0, for single samples, to 0.02 s")
        if not 1 <= self.ahead <= 100_000:
            raise InputError(f"replay: ahead = {self.ahead}: must be 1 to 100000 samples")
        if self.span is not None and not 0.05 <= self.span <= 1000:
            raise InputError(f"replay: span = {self.span!r}: must be 0.05 to 1000 s")


@dataclass(frozen=True, eq=False)
class Replay:
    """A recording of K samples beside what a model says of it.

    predicted and estimated (K, 2n): the arms' states, the angles as the encoders would show them; sigmas (K, 2n): the
    estimate's standard deviations; carts: how the cart moved in each segment, empty where it was clamped; nis (K,), nan
    where no mean of samples ends. stretches: (segment, first, end) rows of each predicted stretch, fits one for each.
    ahead: {samples: (n,) rad rms of each angle} from the estimate. rates_rms (n,) rad/s: estimate against the recorded
    rates, or None. nis_inside_95: share of the settled NIS in its two-sided 95 % band; nis_below_95: below its 95 %
    quantile.
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

    def summary(self, model: str) -> str:
        """Return a sentence: how well this model predicts, and whether the estimator agrees with it."""
        rms = sorted(1e3 * float(np.sqrt(np.mean(np.square(fit.residual)))) for fit in self.fits)
        seconds = max(end - first for _, first, end in self.stretches) * self.recording.dt
        whole = len(self.nis) * self.recording.dt
        return (
            f"{whole:.4g} s predicted by {model}, {seconds:.3g} s from each fitted start: {np.median(rms):.3g} mrad "
            f"rms in the median, {rms[-1]:.3g} at worst; NIS {self.nis_inside_95:.1%} in its band"
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
    # Zeros are the model's to tell: estimated besides, they would take up what it misses.
    return replace(ESTIMATORS[name](), parameter_error=model_error, rate_noise=_FLOOR, augment=())


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
        progress: told how far it is.

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
    shown = np.array([*zeros, *[0.0] * (2 * n - len(zeros))])
    shown_recording = recording
    recording = replace(recording, angles=recording.angles - shown[:n])
    carts = _carts(recording)
    motion = FreeMotion(arms, period=recording.dt, moving=bool(carts))
    stretches = _stretches(recording, _SPAN[bool(carts)] if settings.span is None else settings.span)
    pieces = [recording.angles[first:end] for _, first, end in stretches]
    velocity, acceleration = driven(recording, carts)
    moved = [(velocity[first:end], acceleration[first:end]) for _, first, end in stretches] if carts else []
    fits = fit_initial_states(motion, pieces, moved, progress=part_of(progress, 0.0, 0.5))
    predicted = np.concatenate([fit.states for fit in fits])
    found = estimate_recording(
        recording,
        arms,
        filters,
        carts,
        counts=settings.counts,
        mean_over=_MEAN_OVER[bool(carts)] if settings.mean_over is None else settings.mean_over,
        progress=part_of(progress, 0.5, 0.9),
    )
    estimated, nis = found.states, found.nis
    settled = np.concatenate([np.arange(end - first) * recording.dt >= _SETTLED for first, end in recording.segments])
    if not settled.any():
        settled[:] = True
    told = nis[settled & np.isfinite(nis)]
    low, high = chi_square_band(n)
    progress("predicting", 0.9)
    rates_rms = None
    if recording.rates is not None:
        rates_rms = np.sqrt(np.mean(np.square(estimated[settled, n:] - recording.rates[settled]), axis=0))
    return Replay(
        recording=shown_recording,
        predicted=predicted + shown,
        estimated=estimated + shown,
        sigmas=found.sigmas,
        nis=nis,
        carts=carts,
        stretches=stretches,
        fits=tuple(fits),
        ahead={
            k: _ahead(motion, recording, found, settled, k, velocity, acceleration) for k in sorted({1, settings.ahead})
        },
        rates_rms=rates_rms,
        nis_inside_95=float(np.mean((told >= low) & (told <= high))) if len(told) else float("nan"),
        nis_below_95=float(np.mean(told <= chi_square_band(n, share=0.9)[1])) if len(told) else float("nan"),
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
