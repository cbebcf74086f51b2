"""What a model would have done where a recording says what the bench did, and what an estimator makes of the angles.

Three predictions, each compared with the measured angles: over whole segments from the initial state that fits best;
one sample and `ahead` samples from the estimate. Angles are taken less the encoders' zeros, where the model tells them,
and predictions are given as the encoders would show them. The estimator (`dpcontrol.lab.recorded_estimate`) sees angles
alone; its NIS has a chi-square distribution with as many degrees of freedom as angles if model and noise are as stated.

Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, section 5.4.2.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.consistency import chi_square_band
from dpcontrol.control.estimation import ESTIMATORS
from dpcontrol.control.estimator_settings import EstimatorSettings
from dpcontrol.dynamics.parameters import ArmChainParameters
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import Progress, no_progress, part_of
from dpcontrol.foundation.tables import suggest
from dpcontrol.lab.initial_states import FittedPath, FreeMotion, fit_initial_states
from dpcontrol.lab.recorded_estimate import RecordedEstimate, estimate_recording
from dpcontrol.lab.recordings import REPLAYED, Recording, described
from dpcontrol.logs import LogWriter, Mode, control_fields

Array = NDArray[np.float64]

_SETTLED = 0.1
"""s of a segment in which the estimator may still find the rates: left out of what is said of it."""
_STARTS = 2000


_FLOOR = 0.015
"""rad/s/√s: process noise of the rates besides the share of the accelerations, chosen with it."""


@dataclass(frozen=True)
class ReplaySettings:
    """counts: of an encoder per turn, the stated noise; mean_over s: of each mean that the estimator is given;
    ahead: samples of the longer prediction; span s: the longest stretch that is predicted in one piece, longer segments
    are cut into equal parts.
    """

    counts: int = 40_000
    mean_over: float = 0.015
    ahead: int = 100
    span: float = 5.0

    def __post_init__(self) -> None:
        """Refuse what no replay can do.

        Raises:
            InputError: names the setting, its value and what is allowed.
        """
        if self.counts < 1:
            raise InputError(f"replay: counts = {self.counts}: must be at least 1 for a turn")
        if not 0 <= self.mean_over <= 0.02:
            raise InputError(f"replay: mean_over = {self.mean_over!r}: must be 0, for single samples, to 0.02 s")
        if not 1 <= self.ahead <= 100_000:
            raise InputError(f"replay: ahead = {self.ahead}: must be 1 to 100000 samples")
        if not 0.05 <= self.span <= 1000:
            raise InputError(f"replay: span = {self.span!r}: must be 0.05 to 1000 s")


@dataclass(frozen=True, eq=False)
class Replay:
    """A recording of K samples beside what a model says of it.

    predicted and estimated (K, 2n): states, the angles as the encoders would show them; sigmas (K, 2n): the estimate's
    standard deviations; nis (K,), nan where no mean of samples ends. stretches: (segment, first, end) rows of each
    predicted stretch, fits one for each. ahead: {samples: (n,) rad rms of each angle} from the estimate. rates_rms (n,)
    rad/s: estimate against the recorded rates, or None. nis_inside_95: share of the settled NIS in its two-sided 95 %
    band; nis_below_95: below its 95 % quantile.
    """

    recording: Recording
    predicted: Array
    estimated: Array
    sigmas: Array
    nis: Array
    stretches: tuple[tuple[int, int, int], ...]
    fits: tuple[FittedPath, ...]
    ahead: dict[int, Array]
    rates_rms: Array | None
    nis_inside_95: float
    nis_below_95: float

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
    """Predict a recording with the cart clamped by a model, and run an estimator over it.

    Args:
        recording: angles in segments.
        arms: the model, of as many arms.
        filters: the estimator's settings.
        settings: noise and spans.
        zeros: what the recorded absolute angles show where the true ones are zero, rad; all zero if empty.
        progress: told how far it is.

    Raises:
        InputError: the cart moved, or the model has another number of arms.
        GoalMissed: the estimator's covariance broke down.
    """
    settings = settings or ReplaySettings()
    n = recording.arms
    if recording.cart is not None or recording.command is not None:
        raise InputError(f"{recording.source}: the cart moves in this recording; a replay needs it clamped")
    if arms.count != n:
        raise InputError(f"{recording.source}: the recording has {n} arms and the model {arms.count}; choose another")
    if len(zeros) not in (0, n):
        raise InputError(f"{len(zeros)} zeros for {n} arms; give one for each")
    shown = np.array([*zeros, *[0.0] * (2 * n - len(zeros))])
    shown_recording = recording
    recording = replace(recording, angles=recording.angles - shown[:n])
    motion = FreeMotion(arms, period=recording.dt)
    stretches = _stretches(recording, settings.span)
    pieces = [recording.angles[first:end] for _, first, end in stretches]
    fits = fit_initial_states(motion, pieces, progress=part_of(progress, 0.0, 0.5))
    predicted = np.concatenate([fit.states for fit in fits])
    found = estimate_recording(
        recording,
        arms,
        filters,
        counts=settings.counts,
        mean_over=settings.mean_over,
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
        stretches=stretches,
        fits=tuple(fits),
        ahead={k: _ahead(motion, recording, found, settled, k) for k in sorted({1, settings.ahead})},
        rates_rms=rates_rms,
        nis_inside_95=float(np.mean((told >= low) & (told <= high))) if len(told) else float("nan"),
        nis_below_95=float(np.mean(told <= chi_square_band(n, share=0.9)[1])) if len(told) else float("nan"),
    )


def _stretches(recording: Recording, span: float) -> tuple[tuple[int, int, int], ...]:
    """Return (segment, first, end) of the stretches that are predicted in one piece; together they are all samples."""
    found = []
    for index, (first, end) in enumerate(recording.segments):
        parts = int(np.ceil((end - first) * recording.dt / span))
        edges = np.linspace(first, end, max(parts, 1) + 1).round().astype(int)
        found += [(index, int(a), int(b)) for a, b in pairwise(edges)]
    return tuple(found)


def _ahead(
    motion: FreeMotion, recording: Recording, found: RecordedEstimate, settled: NDArray[np.bool_], samples: int
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
    for _ in range(samples):
        states = motion.paths(states, 2)[1]
    error = states[: recording.arms].T - recording.angles[rows + samples]
    return np.sqrt(np.mean(np.square(error), axis=0))


def write_replay(result: Replay, path: Path | str, *, model: str, model_text: str) -> Path:
    """Write measured angles with the estimate and, as the reference, the prediction; return the log's path.

    Raises:
        InputError: the file cannot be written.
    """
    recording = result.recording
    fields = control_fields(recording.arms, has_cart=False)
    control = np.zeros((len(recording.time), len(fields)))
    control[:, fields.index("mode")] = Mode.IDLE
    control[:, fields.index("nis")] = result.nis
    control[:, fields.index("sigma_1") :] = result.sigmas
    metadata = described(recording, kind=REPLAYED) | {"model": model}
    with LogWriter(
        path,
        arm_lengths=recording.arm_lengths,
        rate_hz=1 / recording.dt,
        has_cart=False,
        metadata=metadata,
        attachments={"model.toml": model_text.encode()},
    ) as log:
        for (index, first, end), fit in zip(result.stretches, result.fits, strict=True):
            text = f"segment {index}: predicted to {1e3 * np.sqrt(np.mean(fit.residual**2)):.2f} mrad rms"
            log.event(float(recording.time[first]), "info" if fit.converged else "warn", "replay", text)
            rows = slice(first, end)
            log.ticks(
                recording.time[rows],
                measured=recording.angles[rows],
                rates=None if recording.rates is None else recording.rates[rows],
                estimate=result.estimated[rows],
                reference=result.predicted[rows],
                control=control[rows],
            )
    return Path(path)
