"""Which arms swung so: base-parameter ratios, friction laws and encoder zeros from recordings.

Long segments are cut into equal ones, and every third is left out. Each candidate (friction viscous; with Coulomb; with
the air's drag; with both; the encoders' zeros free or not) is fitted to the others and predicts those left out from a
fitted start over their whole length. The one of fewest unknowns whose mean squared error is within one standard error
of the least is taken.

How well the numbers are known, and which cannot be distinguished:

    Cov = H⁻¹ (b/(b-f) Σ_blocks g gᵀ) H⁻¹,     H = Σ w J̃ᵀJ̃,   g = Σ_block J̃ᵀ ψ(e)

J̃: slopes of the predicted angles over the unknowns, each swing's start following them; ψ: the residuals as the robust
loss counts them. Neighbouring residuals are alike (rounding of slow motion, what the model leaves out), so they are
summed over blocks several times as long as they stay alike; b blocks, f unknowns. Taking each sample as independent
would give errors too small by that factor's root.

Profiles show the least misfit with one number held off its best value and the others fitted again. Where a profile is
the parabola that the linearised fit promises, the standard error describes the number; where it is flat, or stops at a
bound, the recordings do not determine it.

Sources: Hastie, Tibshirani, Friedman, The elements of statistical learning (2009), section 7.10, for the choice; White,
Maximum likelihood estimation of misspecified models (1982); Cameron, Miller, A practitioner's guide to cluster-robust
inference (2015), section II; Raue et al., Structural and practical identifiability analysis of partially observed
dynamical models (2009).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import (
    ArmChainParameters,
    Friction,
    base_ratios,
    inertial_count,
    nearest_arms,
    ratio_names,
    unit_name,
    with_laws,
)
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.files import picked
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.settings import Settings, setting
from dpcontrol.identification.fit import FitSettings, Swing, SwingFit, Swings, fit_swings
from dpcontrol.recordings.recording import Recording, cart_motion

LONGEST, LONGEST_DRIVEN = 4.0, 1.0
"""s: of pieces, and of those on a moving cart. About a saddle errors grow e⁸-fold in a second; over four seconds
rounding leaves nothing of what a start determines."""
_STILL = 1e-3
_MOST_LOST = 5
"""Readings in a row that may be missing."""
_NEAR = 20


@dataclass(frozen=True)
class Segment:
    """A segment as it was used: running index over all logs, log, first time s, length s, used or left out, rms rad."""

    index: int
    log: str
    start: float
    seconds: float
    used: bool
    rms: float


_FEWEST = 10
"""Samples of a piece that a swing is fitted to."""
_MOST_TURNED = 1e6
"""rad: more is no angle of an arm."""


def cut_into_swings(
    recordings: Sequence[Recording], arms: int, longest: float | None
) -> tuple[list[Swing], list[Segment]]:
    """Return the recordings' segments as swings, long ones cut into equal pieces, and what they are.

    Raises:
        InputError: a recording has another number of arms, hardly moves, or lacks more than a few readings in a row.
    """
    swings: list[Swing] = []
    about: list[Segment] = []
    for group, recording in enumerate(recordings):
        if recording.arms != arms:
            raise InputError(
                f"{recording.name} is of {recording.arms} arms, the model has {arms}; give a model of as many"
            )
        for part in recording.split():
            cart = cart_motion(part)
            most = longest or (LONGEST if cart is None else LONGEST_DRIVEN)
            if part.dt * _FEWEST > most:
                raise InputError(
                    f"{recording.name} has a sample every {part.dt:g} s, and swings are followed for {most:g} s at a "
                    "time: too few to fit; record faster"
                )
            pieces = max(int(np.ceil((len(part.time) - 1) * part.dt / most)), 1)
            edges = np.linspace(0, len(part.time), pieces + 1).round().astype(int)
            filled = _filled(part)
            if (largest := float(np.abs(filled).max(initial=0.0))) > _MOST_TURNED:
                raise InputError(
                    f"{part.name}: an angle of {largest:.3g} rad at {part.time[0]:.6g} s or later is beyond any swing; "
                    "import the recording again with the unit of its angles"
                )
            for a, b in pairwise(edges):
                # Turns counted before a segment say nothing about it.
                angles = filled[a:b] - 2 * np.pi * np.rint(filled[a] / (2 * np.pi))
                driven = () if cart is None else (cart.acceleration[a:b], cart.velocity[a:b])
                swings.append(Swing(angles, part.dt, group, *driven))
                seconds = float((b - a - 1) * part.dt)
                about.append(Segment(len(about), recording.name, float(part.time[a]), seconds, True, np.nan))
    if not swings:
        raise InputError("the recordings hold no segment; import them again")
    if max(float(np.ptp(s.angles, axis=0).max()) for s in swings) < _STILL:
        raise InputError(f"no angle moves by more than {_STILL:g} rad: nothing to identify; record free swings")
    return swings, about


def _filled(part: Recording) -> Array:
    """Return the angles (K, n), single missing ones between their neighbours.

    Raises:
        InputError: too many in a row are missing.
    """
    lost = np.asarray(~np.isfinite(part.angles).all(axis=1))
    if not lost.any():
        return part.angles
    known = np.flatnonzero(~lost)
    gaps = np.diff(known, prepend=-1, append=len(lost)) - 1
    if gaps.max() > _MOST_LOST:
        longest = int(gaps.argmax())
        at = part.time[known[longest - 1] + 1 if longest else 0]
        raise InputError(
            f"{part.name}: {gaps.max()} readings in a row are missing at {at:.6g} s; identify from a recording without"
        )
    angles = np.stack([np.interp(np.arange(len(lost)), known, column) for column in part.angles[known].T], axis=1)
    for rows, near in ((np.arange(known[0]), known[:_NEAR]), (np.arange(known[-1] + 1, len(lost)), known[-_NEAR:])):
        # Beyond the ends a parabola through the nearest: two rounded ones tell no slope.
        curve = np.polynomial.polynomial.polyfit(near - near[0], part.angles[near], min(2, len(near) - 1))
        angles[rows] = np.polynomial.polynomial.polyval(rows - near[0], curve).T
    return angles


_BLOCK_TIMES = 4.0
_LEAST_BLOCK = 10
_BLOCKS_PER_UNKNOWN = 4
_UNSEEN = 1e-10
ALIKE = 0.95
"""Correlation from which two numbers count as indistinguishable."""


def correlation_time(residuals: Sequence[Array]) -> float:
    """Return over how many samples residuals (K, n) stay alike: their integrated autocorrelation time, at least 1.

    Summed until the autocorrelation first falls below 0.05, pooled over swings and angles.
    """
    longest = min(len(r) for r in residuals)
    power = np.zeros(longest)
    for residual in residuals:
        for column in residual.T:
            # Padded to twice the length, the transform does not wrap around.
            spectrum = np.abs(np.fft.rfft(column, 2 * len(column))) ** 2
            power += np.fft.irfft(spectrum)[:longest]
    if power[0] <= 0:
        return 1.0
    shape = power / power[0]
    low = np.flatnonzero(shape < 0.05)
    end = int(low[0]) if len(low) else longest
    return float(max(1.0, 1 + 2 * shape[1:end].sum()))


def covariance_at_bounds(fit: SwingFit, bound: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the covariance (f, f) of the fit's unknowns and their standard errors (f,).

    bound (f,): which lie on a bound. They are taken as held there for the others' sake, and have no variance; their own
    standard errors are those that they would have without it.
    """
    covariance = np.zeros((len(bound), len(bound)))
    covariance[np.ix_(~bound, ~bound)] = _covariance(fit, ~bound)
    free = _covariance(fit, np.ones_like(bound))
    return covariance, np.sqrt(np.where(bound, np.diag(free), np.diag(covariance)))


def _covariance(fit: SwingFit, among: NDArray[np.bool_]) -> Array:
    """Return the covariance of the unknowns that are `among`, the others held; what the data do not see: infinite."""
    information, f = fit.information[np.ix_(among, among)], int(among.sum())
    lengths = [len(s) for s in fit.scores]
    block = max(int(_BLOCK_TIMES * correlation_time(fit.residuals)), _LEAST_BLOCK)
    # More unknowns than blocks would make the sum singular, and every error zero somewhere.
    block = max(min(block, sum(lengths) // max(_BLOCKS_PER_UNKNOWN * f, 1)), 1)
    sums: list[Array] = []
    for score in fit.scores:
        edges = np.linspace(0, len(score), max(round(len(score) / block), 1) + 1).round().astype(int)[:-1]
        sums.append(np.add.reduceat(score[:, among], edges, axis=0))
    blocks = np.concatenate(sums)
    middle = blocks.T @ blocks * len(blocks) / max(len(blocks) - f, 1)
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    sizes, axes = np.linalg.eigh(information * np.outer(scale, scale))
    seen = sizes > _UNSEEN * sizes[-1]
    inverse = (axes[:, seen] / sizes[seen]) @ axes[:, seen].T * np.outer(scale, scale)
    covariance = inverse @ middle @ inverse
    unseen = axes[:, ~seen] * scale[:, None]
    for direction in unseen.T:
        touched = np.abs(direction) > 1e-6 * np.abs(direction).max()
        covariance[touched, touched] = np.inf
    return (covariance + covariance.T) / 2


def undetermined_of(
    names: Sequence[str], values: Array, errors: Array, *, covariance: Array, friction: NDArray[np.bool_]
) -> list[str]:
    """Return sentences on numbers (f,) that the data leave open, and on pairs that they cannot distinguish.

    friction (f,): which are coefficients of friction.
    """
    sentences: list[str] = []
    for k, name in enumerate(names):
        if not np.isfinite(errors[k]):
            sentences.append(f"{name}: these swings do not depend on it, or only together with another")
        elif friction[k] and abs(values[k]) < 2 * errors[k]:
            sentences.append(f"{name}: {values[k]:.3g} ± {errors[k]:.2g} (standard error) may as well be zero")
    with np.errstate(invalid="ignore"):
        correlation = correlation_of(covariance)
    for i, j in np.argwhere(np.tril(np.abs(correlation) >= ALIKE, -1)):
        alike = correlation[i, j]
        factor = np.sqrt((1 + abs(alike)) / max(1 - abs(alike), 1e-12))
        kind = "sum" if alike < 0 else "difference"
        sentences.append(
            f"{names[j]} and {names[i]} apart (correlation {alike:+.3f}): their {kind}, each over its standard "
            f"error, is known {factor:.0f} times better than what is across it"
        )
    return sentences


def correlation_of(covariance: Array) -> Array:
    """Return the correlation matrix (f, f), zero for what has no variance or is not determined."""
    deviations = np.sqrt(np.diag(covariance))
    scale = np.where((deviations > 0) & np.isfinite(deviations), deviations, np.inf)
    return covariance / np.outer(scale, scale)


_ROUNDING = 1e-9
"""Relative, of mean squares: a law whose coefficient came out as zero predicts the same but for rounding."""
LAWS: tuple[tuple[Friction, ...], ...] = (
    (),
    (Friction.COULOMB,),
    (Friction.QUADRATIC,),
    (Friction.COULOMB, Friction.QUADRATIC),
)


@dataclass(frozen=True)
class IdentificationSettings(Settings, table="identify"):
    """zeros: "free", "none", or "chosen" by the error on what was left out. left_out: one segment of so many, the last
    of each. longest s: a longer segment is cut into equal ones; None: 4 s, but 1 s where the cart moved, as in runs,
    which stay near saddles. laws: the sets of laws besides the viscous one to try.
    """

    zeros: str = setting("chosen", choices=("free", "none", "chosen"))
    left_out: int = setting(3, least=2)
    longest: float | None = setting(None, above=0, unit="s")
    laws: tuple[tuple[Friction, ...], ...] = LAWS
    fit: FitSettings = field(default_factory=FitSettings)

    def _check_together(self) -> None:
        """Check that there are laws to try."""
        if not self.laws:
            raise self.refusal("laws", "must name at least one set, () for viscous friction alone")


@dataclass(frozen=True, eq=False)
class Candidate:
    """A set of terms: fitted, and its rms (L,) in rad on each segment left out."""

    laws: tuple[Friction, ...]
    zeros: bool
    left_out: Array
    fit: SwingFit
    predicted: SwingFit

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of its terms."""
        return ("viscous", *(law.value for law in self.laws), *(("zeros",) if self.zeros else ()))

    @property
    def left_out_rms(self) -> float:
        """Root of the mean squared error over all segments left out, rad."""
        return float(np.sqrt((self.left_out**2).mean()))


@dataclass(frozen=True, eq=False)
class Identification:
    """What was identified.

    arms: the nearest to the starting model's with the identified ratios. names, values, errors (f,): of the ratios,
    then of the encoders' zeros where free (rad, each recording's own); covariance (f, f), none where a value lies on
    its bound. zeros (recordings, n) rad: shown less true. undetermined: sentences. candidates, chosen: index of one.
    started_at: rms (L,) rad of the starting model on the segments left out. swings, residuals (K, n) rad: of each
    segment.
    """

    arms: ArmChainParameters
    names: tuple[str, ...]
    values: Array
    errors: Array
    covariance: Array
    zeros: Array
    undetermined: tuple[str, ...]
    candidates: tuple[Candidate, ...]
    chosen: int
    started_at: Array
    segments: tuple[Segment, ...]
    swings: tuple[Swing, ...]
    residuals: tuple[Array, ...]
    status: str

    def __repr__(self) -> str:
        return f"<identified arms: {self.status}>"

    @property
    def friction_terms(self) -> tuple[str, ...]:
        """Laws of friction that were chosen."""
        return tuple(term for term in self.candidates[self.chosen].terms if term != "zeros")

    @property
    def correlation(self) -> Array:
        """Correlation matrix (f, f), zero for what lies on a bound or is not determined."""
        return correlation_of(self.covariance)

    def document(self) -> dict[str, Any]:
        """Return what `dpcontrol identify --json` prints, the file's name apart."""
        segment = ("index", "used", "rms", "log", "start", "seconds")
        return {
            "parameters": {
                name: {"value": float(value), "standard_error": float(error)}
                for name, value, error in zip(self.names, self.values, self.errors, strict=True)
            },
            "undetermined": list(self.undetermined),
            "friction_terms": list(self.friction_terms),
            "candidates": [
                {
                    "terms": list(c.terms),
                    "left_out_rms": c.left_out_rms,
                    "left_out_median": float(np.median(c.left_out)),
                    "left_out_worst": float(c.left_out.max()),
                    "chosen": k == self.chosen,
                }
                for k, c in enumerate(self.candidates)
            ],
            "segments": [picked(s, *segment) for s in self.segments],
            "starting_model_left_out_rms": float(np.sqrt((self.started_at**2).mean())),
            **picked(self, "zeros", "correlation", "status"),
        }


def identify(
    recordings: Sequence[Recording],
    start: ArmChainParameters,
    *,
    settings: IdentificationSettings | None = None,
    progress: Progress = no_progress,
) -> Identification:
    """Identify arms from recordings, starting from those of a model.

    Raises:
        InputError: the recordings are of another pendulum, too short or too few.
        GoalMissed: no candidate could be fitted; the sentence says why.
    """
    settings = settings or IdentificationSettings()
    swings, about = cut_into_swings(recordings, start.count, settings.longest)
    used = np.array([k % settings.left_out != settings.left_out - 1 for k in range(len(swings))])
    if used.all():
        raise InputError(
            f"{len(swings)} segments: one in {settings.left_out} is left out to choose the laws by; give at "
            f"least {settings.left_out}"
        )
    fitted, left_out = ([swings[k] for k in np.flatnonzero(which)] for which in (used, ~used))
    choices = {"free": (True,), "none": (False,), "chosen": (False, True)}[settings.zeros]
    ways = [(laws, zeros) for laws in settings.laws for zeros in choices]
    candidates: list[Candidate] = []
    reasons: list[str] = []
    for number, (laws, zeros) in enumerate(ways):
        doing = ", ".join(["viscous", *laws, *(["zeros"] if zeros else [])])
        progress(f"fit {doing}", number / (len(ways) + 1))
        near = candidates[-1] if candidates and candidates[-1].laws == laws else None
        candidate = _fitted(fitted, left_out, with_laws(start, laws), zeros, settings.fit, near)
        if candidate.fit.converged and candidate.predicted.converged:
            candidates.append(candidate)
        else:
            reasons.append(f"{' + '.join(candidate.terms)}: {candidate.fit.status}")
    if not candidates:
        raise GoalMissed(f"no candidate could be fitted; {reasons[0]}")
    progress("uncertainty", len(ways) / (len(ways) + 1))
    nothing = np.zeros((1 + max(s.group for s in swings), start.count))
    before = _predicted(Swings(start), left_out, base_ratios(start), nothing, settings.fit).rms
    chosen = choose(candidates)
    best = candidates[chosen]
    arms = with_laws(start, best.laws)
    names, values = ratio_names(arms), best.fit.parameters
    if best.zeros:
        of = [f" {recording.name}" if len(recordings) > 1 else "" for recording in recordings]
        names = (*names, *(f"zero_{i + 1}{name}" for name in of for i in range(start.count)))
        values = np.concatenate([values, best.fit.zeros.ravel()])
    rubbing = np.arange(len(values)) >= inertial_count(arms.count)
    rubbing[len(best.fit.parameters) :] = False
    bound = rubbing & (values <= 0)
    covariance, errors = covariance_at_bounds(best.fit, bound)
    of_used, of_left = iter(best.fit.residuals), iter(best.predicted.residuals)
    residuals = [next(of_used if one else of_left) for one in used]
    progress("done", 1.0)
    failed = f"; {len(reasons)} candidates failed ({reasons[0]})" if reasons else ""
    return Identification(
        arms=nearest_arms(best.fit.parameters, arms),
        names=names,
        values=values,
        errors=errors,
        covariance=covariance,
        zeros=best.fit.zeros,
        undetermined=(
            f"{unit_name(arms.count)} itself: masses, inertias and friction may all grow in proportion and the arms "
            "swing the same; only ratios to it are known",
            *undetermined_of(names, values, errors, covariance=covariance, friction=rubbing),
        ),
        candidates=tuple(candidates),
        chosen=chosen,
        started_at=before,
        segments=tuple(
            replace(one, used=bool(fitted_to), rms=float(np.sqrt((residual**2).mean())))
            for one, fitted_to, residual in zip(about, used, residuals, strict=True)
        ),
        swings=tuple(swings),
        residuals=tuple(residuals),
        status=f"{' + '.join(best.terms)}: {best.fit.status}{failed}",
    )


def choose(candidates: Sequence[Candidate]) -> int:
    """Return the index of the one with fewest unknowns whose mean squared error is within one standard error of best.

    The standard error is that of the best one's mean over the segments left out. Of equally many unknowns the better.
    What differs by rounding alone is as good.
    """
    squares = [c.left_out**2 for c in candidates]
    best = min(squares, key=lambda s: float(s.mean()))
    most = float(best.mean()) + (float(best.std(ddof=1)) / np.sqrt(len(best)) if len(best) > 1 else 0.0)
    within = [k for k, s in enumerate(squares) if s.mean() <= most * (1 + _ROUNDING)]
    return min(within, key=lambda k: (len(candidates[k].fit.unknowns), float(squares[k].mean())))


def _fitted(
    fitted: list[Swing],
    left_out: list[Swing],
    arms: ArmChainParameters,
    zeros: bool,
    settings: FitSettings,
    near: Candidate | None,
) -> Candidate:
    model = Swings(arms)
    groups = 1 + max(s.group for s in (*fitted, *left_out))
    fit = fit_swings(
        model,
        fitted,
        parameters=base_ratios(arms) if near is None else near.fit.parameters,
        zeros=np.zeros((groups, arms.count)),
        free=np.ones(model.parameters, dtype=bool),
        free_zeros=zeros,
        settings=settings,
        near=None if near is None else near.fit.window_starts,
    )
    predicted = _predicted(model, left_out, fit.parameters, fit.zeros, settings)
    return Candidate(arms.friction, zeros, predicted.rms, fit, predicted)


def _predicted(model: Swings, swings: list[Swing], parameters: Array, zeros: Array, settings: FitSettings) -> SwingFit:
    """Return the swings' starts fitted by least squares with ratios (m,) and zeros (groups, n) held."""
    return fit_swings(
        model,
        swings,
        parameters=parameters,
        zeros=zeros,
        free=np.zeros(model.parameters, dtype=bool),
        free_zeros=False,
        settings=replace(settings, robust=0.0),
    )


_AT = (-3.0, -1.5, 1.5, 3.0)


@dataclass(frozen=True, eq=False)
class LossProfile:
    """Of one unknown: values (K,), the share (K,) by which the loss rises, and what the linearised fit promises."""

    name: str
    best: float
    error: float
    values: Array
    rises: Array
    promised: Array


def profiles(found: Identification, *, progress: Progress = no_progress) -> tuple[LossProfile, ...]:
    """Return the profile of each unknown within three standard errors, by fitting the others again."""
    fit = found.candidates[found.chosen].fit
    settings = FitSettings(bend=fit.bend, tolerance=1e-5)
    model = Swings(found.arms)
    m, swings = model.parameters, [s for s, about in zip(found.swings, found.segments, strict=True) if about.used]
    every = np.concatenate([fit.parameters, fit.zeros.ravel()])
    inside = np.diag(found.covariance) > 0
    information = np.where(np.outer(inside, inside), fit.information, 0.0)
    information[~inside, ~inside] = np.diag(fit.information)[~inside]
    # What lies on a bound has the standard error, and the curve, that it would have without it.
    curvature = np.where(
        inside,
        1 / np.diag(np.linalg.pinv(information, hermitian=True)),
        1 / np.maximum(np.diag(np.linalg.pinv(fit.information, hermitian=True)), 1e-300),
    )
    out: list[LossProfile] = []
    for k, (name, index) in enumerate(zip(found.names, fit.unknowns, strict=True)):
        progress("profiles", k / len(found.names))
        best, error = float(every[index]), float(found.errors[k])
        values = best + error * np.array(_AT)
        values = np.unique(np.maximum(values, 0.0) if inertial_count(found.arms.count) <= index < m else values)
        values = values[np.abs(values - best) > 1e-3 * error] if np.isfinite(error) else values[:0]
        rises = []
        for value in values:
            held = every.copy()
            held[index] = value
            free = np.ones(m, dtype=bool)
            if index < m:
                free[index] = False
            again = fit_swings(
                model,
                swings,
                parameters=held[:m],
                zeros=held[m:].reshape(fit.zeros.shape),
                free=free,
                # A zero is held together with the others of its kind: they hardly mix.
                free_zeros=len(fit.unknowns) > m and index < m,
                settings=settings,
                near=fit.window_starts,
            )
            rises.append(again.loss / fit.loss - 1)
        promised = curvature[k] * (values - best) ** 2 / 2 / fit.loss
        out.append(LossProfile(name, best, error, values, np.array(rises), promised))
    progress("profiles", 1.0)
    return tuple(out)
