"""Identification of base-parameter ratios, friction laws and encoder zeros from recordings.

Long segments are cut into equal ones, and every third is held out. The candidates combine viscous friction with Coulomb
friction, air drag, both or neither, and free or fixed encoder zeros. Each is fitted to the remaining segments. It then
predicts the held-out ones over their whole length, from a fitted start. The choice is the candidate with the fewest
unknowns whose mean squared error is within one standard error of the least.

The covariance shows the accuracy of the numbers and which of them cannot be distinguished.

Source: Hastie, Tibshirani, Friedman, The elements of statistical learning (2009), section 7.10.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

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
from dpcontrol.foundation.document import Documented, picked
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.settings import Setting, Settings
from dpcontrol.foundation.shown import Brief, Shown
from dpcontrol.identification.fit import Swing, SwingFit, Swings, filled, fit_starts, fit_swings
from dpcontrol.identification.windows import FitSettings
from dpcontrol.recordings.recording import Recording, cart_motion

LONGEST, LONGEST_DRIVEN = 4.0, 1.0
"""Length of pieces with the cart clamped and moving, s.

Near a saddle, errors grow e⁸-fold in a second. Over four seconds, rounding hides the effect of the start.
"""
_STILL = 1e-3
"""Range of an angle below which an arm counts as at rest, rad."""


@dataclass(frozen=True)
class Segment:
    """A piece of a recording in an identification.

    Attributes:
        index: running index.
        log: name of the recording.
        start: time of its first sample, s.
        seconds: length, s.
        used: True if the laws were fitted to it, False if it was held out.
        rms: root mean square residual, rad.
    """

    index: int
    log: str
    start: float
    seconds: float
    used: bool
    rms: float


_FEWEST = 10
"""Minimum samples of a piece for a fit."""


def cut_into_swings(
    recordings: Sequence[Recording], arms: int, longest: float | None
) -> tuple[list[Swing], list[Segment]]:
    """Return the recordings' segments as swings for the fit, and their descriptions; long ones are cut equally.

    The swings of a recording form a group, since they share the zeros of its encoders. In the descriptions, `used` is
    still True and `rms` NaN for all segments, until they are fitted.

    Args:
        recordings: the recordings.
        arms: number of arms of the model.
        longest: longest duration of a piece, s; None for `LONGEST` with the cart clamped, else `LONGEST_DRIVEN`.

    Raises:
        InputError: a recording has another number of arms, a piece has too few samples, or no recording moves.
    """
    swings: list[Swing] = []
    segments: list[Segment] = []
    for group, recording in enumerate(recordings):
        if recording.arms != arms:
            raise InputError(
                f"{recording.name} has {recording.arms} arms, the model has {arms}; use a model with the same number"
            )
        for part in recording.split():
            cart = cart_motion(part)
            longest_piece = longest or (LONGEST if cart is None else LONGEST_DRIVEN)
            pieces = max(int(np.ceil((len(part.time) - 1) * part.dt / longest_piece)), 1)
            if len(part.time) < _FEWEST * pieces:
                raise InputError(
                    f"{recording.name} has {len(part.time)} samples in a segment, one every {part.dt:g} s, fitted "
                    f"in pieces of {longest_piece:g} s; a piece needs {_FEWEST}: record faster, or omit the segment"
                )
            edges = np.linspace(0, len(part.time), pieces + 1).round().astype(int)
            for first, end in pairwise(edges):
                # Turns counted before a segment are irrelevant.
                angles = part.angles[first:end] - 2 * np.pi * np.rint(filled(part.angles[first:end])[0] / (2 * np.pi))
                cart_drive = () if cart is None else (cart.acceleration[first:end], cart.velocity[first:end])
                swings.append(Swing(angles, part.dt, group, *cart_drive))
                seconds = float((end - first - 1) * part.dt)
                segments.append(Segment(len(segments), recording.name, float(part.time[first]), seconds, True, np.nan))
    if max(float(np.ptp(filled(s.angles), axis=0).max()) for s in swings) < _STILL:
        raise InputError(
            f"no angle moves by more than {_STILL:g} rad: there is nothing to identify; record free swings"
        )
    return swings, segments


ALIKE = 0.95
"""Correlation beyond which two numbers are indistinguishable."""


def covariance_at_bounds(fit: SwingFit, bound: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return covariance (f, f) and standard errors (f,) of the unknowns, some of which the fit left at a bound.

    Unknowns at a bound, `bound` (f,), count as fixed for the others and have no variance in the covariance. Their own
    standard errors are those of a fit without any bound.

    Args:
        fit: fit of the chosen candidate.
        bound: True for unknowns (f,) at a bound.
    """
    covariance = np.zeros((len(bound), len(bound)))
    covariance[np.ix_(~bound, ~bound)] = fit.covariance(~bound)
    return covariance, np.sqrt(np.diag(np.where(bound, fit.covariance(), covariance)))


def undetermined_of(
    names: Sequence[str], values: Array, errors: Array, *, covariance: Array, friction: NDArray[np.bool_]
) -> list[str]:
    """Return sentences on undetermined numbers (f,) and indistinguishable pairs, as warnings for the user of a model.

    Args:
        names: names of the identified numbers (f,), ratios and encoder zeros.
        values: their values (f,).
        errors: their standard errors (f,), infinite if undetermined.
        covariance: their covariance (f, f).
        friction: True for coefficients of friction (f,).
    """
    sentences: list[str] = []
    for k, name in enumerate(names):
        if not np.isfinite(errors[k]):
            sentences.append(f"{name}: these swings do not depend on it, or only in combination with another number")
        elif friction[k] and abs(values[k]) < 2 * errors[k]:
            sentences.append(
                f"{name}: {values[k]:.3g} ± {errors[k]:.2g} (standard error) is not distinguishable from zero"
            )
    with np.errstate(invalid="ignore"):
        correlation = correlation_of(covariance)
    for i, j in np.argwhere(np.tril(np.abs(correlation) >= ALIKE, -1)):
        coefficient = correlation[i, j]
        # Ratio of the standard deviations of sum and difference, each number divided by its standard error.
        factor = np.sqrt((1 + abs(coefficient)) / max(1 - abs(coefficient), 1e-12))
        kind = "sum" if coefficient < 0 else "difference"
        sentences.append(
            f"{names[j]} and {names[i]} are not distinguishable (correlation {coefficient:+.3f}): their {kind}, "
            f"each over its standard error, is determined {factor:.0f} times better than the orthogonal combination"
        )
    return sentences


def correlation_of(covariance: Array) -> Array:
    """Return the correlation matrix (f, f), zero for numbers without variance or undetermined.

    Args:
        covariance: covariance (f, f).
    """
    deviations = np.sqrt(np.diag(covariance))
    scale = np.where((deviations > 0) & np.isfinite(deviations), deviations, np.inf)
    return covariance / np.outer(scale, scale)


_ROUNDING = 1e-9
"""Relative tolerance of mean squares: a law with a zero coefficient predicts the same except for rounding."""
LAWS: tuple[tuple[Friction, ...], ...] = (
    (),
    (Friction.COULOMB,),
    (Friction.QUADRATIC,),
    (Friction.COULOMB, Friction.QUADRATIC),
)


@dataclass(frozen=True)
class IdentificationSettings(Settings, table="identify"):
    """Terms to try, and segments to hold out."""

    zeros: Annotated[str, Setting(choices=("free", "none", "chosen"))] = "chosen"
    """"free", "none", or "chosen" by the held-out error."""
    left_out: Annotated[int, Setting(least=2)] = 3
    """One in so many segments is held out."""
    longest: Annotated[float | None, Setting(above=0, unit="s")] = None
    """Maximum segment length, s; None for 4 s, or 1 s if the cart moved, since runs stay near saddles."""
    laws: tuple[tuple[Friction, ...], ...] = LAWS
    """Sets of friction laws to try in addition to the viscous one."""
    fit: FitSettings = field(default_factory=FitSettings)

    def _check_together(self) -> None:
        """Raise an InputError unless there are laws to try."""
        if not self.laws:
            raise self.refusal("laws", "must name at least one set, () for viscous friction alone")


@dataclass(frozen=True, eq=False)
class Candidate(Brief):
    """A choice of friction laws and zeros, with its fit, to be compared by the errors on held-out segments.

    Attributes:
        laws: laws in addition to the viscous one.
        zeros: True if encoder zeros were fitted.
        left_out: rms errors (L,) on each held-out segment, rad.
        fit: fit to the other segments.
        predicted: fit of the held-out segments' starts alone.
    """

    laws: tuple[Friction, ...]
    zeros: bool
    left_out: Array
    fit: SwingFit
    predicted: SwingFit

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms."""
        return ("viscous", *(law.value for law in self.laws), *(("zeros",) if self.zeros else ()))

    @property
    def left_out_rms(self) -> float:
        """Root mean squared error over all held-out segments, rad."""
        return float(np.sqrt((self.left_out**2).mean()))


@dataclass(frozen=True, eq=False)
class Identification(Shown, Documented):
    """Identified arms with errors, encoder zeros and friction laws.

    Attributes:
        candidates: tried friction laws, each with its errors.
        segments: segments of the recordings, used or held out.
        swings: measured swings.
        status: result in words.
    """

    arms: ArmChainParameters
    """Arms nearest to the starting model that have the identified ratios."""
    names: tuple[str, ...]
    """Names (f,) of the ratios, then of free zeros of each recording."""
    values: Array
    """Values (f,), zeros in rad."""
    errors: Array
    """Standard errors (f,)."""
    covariance: Array
    """Covariance (f, f), zero for values at a bound."""
    zeros: Array
    """Shown minus true angles (recordings, n), rad."""
    undetermined: tuple[str, ...]
    """Sentences on undetermined numbers."""
    candidates: tuple[Candidate, ...]
    chosen: int
    """Index of the chosen candidate."""
    started_at: Array
    """Rms error (L,) of the starting model on the held-out segments, rad."""
    segments: tuple[Segment, ...]
    swings: tuple[Swing, ...]
    residuals: tuple[Array, ...]
    """Residuals (K, n) of each segment, rad."""
    status: str
    file: Path | None = None
    """Model file that was written, or None."""

    def __repr__(self) -> str:
        return f"<identified arms: {self.status}>"

    @property
    def friction_terms(self) -> tuple[str, ...]:
        """Chosen friction laws."""
        return tuple(term for term in self.candidates[self.chosen].terms if term != "zeros")

    @property
    def correlation(self) -> Array:
        """Correlation matrix (f, f), zero for numbers at a bound or undetermined."""
        return correlation_of(self.covariance)

    def document(self) -> dict[str, Any]:
        """Return the output of `dpcontrol identify --json`."""
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
            **picked(self, "zeros", "correlation", "status", "file"),
        }


def identify(
    recordings: Sequence[Recording],
    start: ArmChainParameters,
    *,
    settings: IdentificationSettings | None = None,
    progress: Progress = no_progress,
) -> Identification:
    """Identify ratios, friction and encoder zeros of arms from recordings, starting from a model.

    The choice among the candidates, sets of friction laws with or without zeros, is described at the head of this
    module.

    Args:
        recordings: recordings of the same arms.
        start: arms of the starting model.
        settings: settings of the identification.
        progress: receiver of progress reports.

    Raises:
        InputError: the recordings have another number of arms, hardly move, or are too short or too few.
        GoalMissed: no candidate could be fitted.
    """
    settings = settings or IdentificationSettings()
    swings, segments = cut_into_swings(recordings, start.count, settings.longest)
    used = np.array([k % settings.left_out != settings.left_out - 1 for k in range(len(swings))])
    if used.all():
        raise InputError(
            f"{len(swings)} segments: one in {settings.left_out} is held out for the choice of laws; give at "
            f"least {settings.left_out}"
        )
    fitted, left_out = ([swings[k] for k in np.flatnonzero(selection)] for selection in (used, ~used))
    candidates, reasons = _candidates(fitted, left_out, start, settings, progress)
    no_zeros = np.zeros((1 + max(s.group for s in swings), start.count))
    start_rms = fit_starts(
        Swings(start), left_out, parameters=base_ratios(start), zeros=no_zeros, settings=settings.fit
    ).rms
    chosen = choose(candidates)
    best = candidates[chosen]
    arms = with_laws(start, best.laws)
    names, values = ratio_names(arms), best.fit.parameters
    if best.zeros:
        suffixes = [f" {recording.name}" if len(recordings) > 1 else "" for recording in recordings]
        names = (*names, *(f"zero_{i + 1}{name}" for name in suffixes for i in range(start.count)))
        values = np.concatenate([values, best.fit.zeros.ravel()])
    is_friction = np.arange(len(values)) >= inertial_count(arms.count)
    is_friction[len(best.fit.parameters) :] = False
    covariance, errors = covariance_at_bounds(best.fit, is_friction & (values <= 0))
    # The segments' residuals (K, n), rad, in the order of `segments`.
    used_residuals, held_out_residuals = iter(best.fit.residuals), iter(best.predicted.residuals)
    residuals = [next(used_residuals if segment else held_out_residuals) for segment in used]
    progress("done", 1.0)
    failures = f"; {len(reasons)} candidates failed ({reasons[0]})" if reasons else ""
    return Identification(
        arms=nearest_arms(best.fit.parameters, arms),
        names=names,
        values=values,
        errors=errors,
        covariance=covariance,
        zeros=best.fit.zeros,
        undetermined=(
            f"{unit_name(arms.count)} itself: if masses, inertias and friction all grow in proportion, the arms "
            "swing the same; only ratios to it are identifiable",
            *undetermined_of(names, values, errors, covariance=covariance, friction=is_friction),
        ),
        candidates=tuple(candidates),
        chosen=chosen,
        started_at=start_rms,
        segments=tuple(
            replace(segment, used=bool(fitted_to), rms=float(np.sqrt((residual**2).mean())))
            for segment, fitted_to, residual in zip(segments, used, residuals, strict=True)
        ),
        swings=tuple(swings),
        residuals=tuple(residuals),
        status=f"{' + '.join(best.terms)}: {best.fit.status}{failures}",
    )


def _candidates(
    fitted: list[Swing],
    left_out: list[Swing],
    start: ArmChainParameters,
    settings: IdentificationSettings,
    progress: Progress,
) -> tuple[list[Candidate], list[str]]:
    """Return the candidates that converged, and a sentence for each that did not.

    A candidate is a set of friction laws with encoder zeros that are either fitted or fixed at 0. `settings` has the
    sets of laws; its `zeros` decides whether zeros are fitted for all candidates, for none, or both ways for each set.
    `fitted` are the swings to fit, `left_out` those held out, and `start` the arms of the starting model. `progress`
    receives the completed share with "fit" and the candidate's terms before each fit, and with "uncertainty" at the
    end, because the caller then computes the errors.

    Raises:
        GoalMissed: no candidate converged.
    """
    choices = {"free": (True,), "none": (False,), "chosen": (False, True)}[settings.zeros]
    choices_of_terms = [(laws, zeros) for laws in settings.laws for zeros in choices]
    candidates: list[Candidate] = []
    reasons: list[str] = []
    for number, (laws, zeros) in enumerate(choices_of_terms):
        terms = ", ".join(["viscous", *laws, *(["zeros"] if zeros else [])])
        progress(f"fit {terms}", number / (len(choices_of_terms) + 1))
        # With free zeros, the fit starts from the one of the same laws without zeros.
        near = candidates[-1] if candidates and candidates[-1].laws == laws else None
        candidate = _fitted(fitted, left_out, with_laws(start, laws), zeros, settings.fit, near)
        if candidate.fit.converged and candidate.predicted.converged:
            candidates.append(candidate)
        else:
            reasons.append(f"{' + '.join(candidate.terms)}: {candidate.fit.status}")
    if not candidates:
        raise GoalMissed(f"no candidate could be fitted; {reasons[0]}")
    progress("uncertainty", len(choices_of_terms) / (len(choices_of_terms) + 1))
    return candidates, reasons


def choose(candidates: Sequence[Candidate]) -> int:
    """Return the index of the simplest candidate within one standard error of the best.

    The standard error is that of the best candidate's mean over the held-out segments. Among candidates with equally
    many unknowns, the better one is chosen. Differences due to rounding are ignored.

    Args:
        candidates: fitted candidates, of which each has the errors of all held-out segments.
    """
    squares = [c.left_out**2 for c in candidates]
    best = min(squares, key=lambda s: float(s.mean()))
    limit = float(best.mean()) + (float(best.std(ddof=1)) / np.sqrt(len(best)) if len(best) > 1 else 0.0)
    eligible = [k for k, s in enumerate(squares) if s.mean() <= limit * (1 + _ROUNDING)]
    return min(eligible, key=lambda k: (len(candidates[k].fit.unknowns), float(squares[k].mean())))


def _fitted(
    fitted: list[Swing],
    left_out: list[Swing],
    arms: ArmChainParameters,
    zeros: bool,
    settings: FitSettings,
    near: Candidate | None,
) -> Candidate:
    """Fit one candidate, the friction laws of `arms` with or without free zeros, and predict the held-out swings.

    `fitted` are the swings to fit, and `left_out` the held-out ones, for which only the starts are fitted. `near` is a
    fit of the same laws, whose ratios and starts are the first guess, or None for the ratios of `arms`. `zeros` is True
    to fit encoder zeros, and False to fix them at 0. `settings` are the windows, robust loss and convergence.
    """
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
        near=None if near is None else near.fit.starts,
    )
    predicted = fit_starts(model, left_out, parameters=fit.parameters, zeros=fit.zeros, settings=settings)
    return Candidate(arms.friction, zeros, predicted.rms, fit, predicted)
