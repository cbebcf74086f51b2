"""The fit of parameters to windows of measurements, of which identification, replay and commissioning make use.

    min Σ ρ(y - f(x_j, p)),     x_{j+1} = φ(x_j, p) from window to window,     l ≤ p ≤ u
    ρ(e) = ½e² for |e| ≤ d, else d(|e| - ½d)        (Huber)

A stretch of measurements is cut into windows, each of which has a start x_j (multiple shooting). A stretch of a motion
that needs no start is a single window without one. A model returns the residuals and their derivatives.

Gauss-Newton steps update the starts of all windows at once. After linearisation, the later starts follow from the
first start of each stretch and from p: x_j = N_j (x_0, p) + d_j. Here d_j contains the gaps between windows. Each
stretch therefore adds a small dense block, from which its first start is eliminated. The work grows in proportion to
the number of windows. A solver of general least squares, whose work grows with its cube, has no use for this structure.

    Cov = H⁻¹ (b/(b-f) Σ_blocks g gᵀ) H⁻¹,     H = Σ w J̃ᵀJ̃,   g = Σ_block J̃ᵀ ψ(e)

J̃ are the derivatives of the predictions by the f unknowns, with each stretch's start eliminated. ψ are the residuals as
weighted by the robust loss. Neighbouring residuals are correlated, because of rounding in slow motion and effects that
the model omits. They are therefore summed over blocks several times longer than their correlation time, with b blocks.
Treating samples as independent would underestimate errors by the square root of that length.

Sources: Bock, Kostina, Schlöder, Numerical methods for parameter estimation in nonlinear differential algebraic
equations (2007). Albersmeyer, Diehl, The lifted Newton method (2010). Huber, Robust statistics (1981), section 7.8.
White, Maximum likelihood estimation of misspecified models (1982). Cameron, Miller, A practitioner's guide to
cluster-robust inference (2015), section II.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.parts import Later
from dpcontrol.foundation.settings import Setting, Settings
from dpcontrol.foundation.shown import Brief

optimize = Later("scipy.optimize")

_GAP_WEIGHT = 1e3
"""Weight of the gaps between windows in the merit of a step."""
_STILL_ADAPTING = 6
"""Number of steps after which the threshold of the robust loss no longer changes."""
_TRIALS = 16
"""Number of shares of a step that are tried, each half of the one before."""
STEP = 1e-4
"""Difference of scaled parameters for derivatives."""
_BLOCK_TIMES = 4.0
_LEAST_BLOCK = 10
_BLOCKS_PER_UNKNOWN = 4
_UNSEEN = 1e-10
_LOST = 1e-18
"""Share of the greatest information that is due to rounding."""


@dataclass(frozen=True)
class FitSettings(Settings, table="fit"):
    """Windows, robust loss and convergence of the fit."""

    window: Annotated[float, Setting(above=0, unit="s")] = 0.5
    """Length of a shooting window, s."""
    robust: Annotated[float, Setting(least=0)] = 3.0
    """Residual at which the loss becomes linear, in standard deviations of the bulk; 0 for least squares."""
    least_scale: Annotated[float, Setting(above=0, unit="rad")] = 1e-4
    """Minimum standard deviation of the bulk, rad, about half a count."""
    iterations: Annotated[int, Setting(least=1)] = 40
    tolerance: Annotated[float, Setting(above=0)] = 1e-7
    """Relative decrease of the loss below which the fit has converged."""


class LinearisedStretch(NamedTuple):
    """Linearisation of a stretch of K samples of n quantities, as a block of the normal equations.

    Attributes:
        residual: measured minus predicted values (K, n).
        reduced: residual minus the effect of the gaps between windows (K, n).
        slope: derivatives (K, n, s+f) of the prediction by the first start (s,) and the f unknowns.
        nodes: N_j of each window, the derivatives (s, s+f) of its start by the first start and the unknowns.
        offsets: d_j of each window, the part (s,) of its start's change that closes the gaps before it.
    """

    residual: Array
    reduced: Array
    slope: Array
    nodes: list[Array]
    offsets: list[Array]


@dataclass(eq=False)
class Linearised:
    """Residuals of all stretches and their derivatives at one point, for a Gauss-Newton step.

    Attributes:
        stretches: linearisation of each stretch.
        gaps: sum of the gaps between windows beyond rounding.
        gap: the largest of them.
        finite: True if all numbers are finite.
    """

    stretches: list[LinearisedStretch]
    gaps: float = 0.0
    gap: float = 0.0
    finite: bool = True

    @property
    def sizes(self) -> Array:
        """Sizes of all residuals (R,), by which the threshold of the robust loss is set."""
        return np.abs(np.concatenate([stretch.residual.ravel() for stretch in self.stretches]))

    def merit(self, threshold: float) -> float:
        """Return the merit function, robust loss plus gaps, by which a step is accepted.

        Args:
            threshold: size of a residual from which the loss is linear; infinite for least squares.
        """
        # Residuals and gaps are measured by the threshold, so that the weight of the gaps has no unit.
        scale = threshold if np.isfinite(threshold) else 1e-3
        clipped = np.minimum(sizes := self.sizes, threshold)
        return float((clipped * (sizes - clipped / 2)).sum()) / scale**2 + _GAP_WEIGHT * self.gaps / scale


class WindowModel(Protocol):
    """A model that predicts measurements in windows, to be fitted by `fit_windows`.

    Attributes:
        windows: windows of each stretch, by number.
    """

    windows: Sequence[range]

    def linearised(self, starts: Array, values: Array, unknowns: NDArray[np.intp]) -> Linearised:
        """Return residuals of all stretches and their derivatives, for a Gauss-Newton step.

        Args:
            starts: starts (W, s) of the windows.
            values: values (V,) of all parameters.
            unknowns: indices (f,) of the free ones.
        """
        ...


@dataclass(eq=False)
class DifferencedModel:
    """A stretch without a start, whose derivatives are differences, for models that return predictions only.

    Attributes:
        residuals: function of sets of values (P, V) that returns the measured minus the predicted values (P, K, n).
        windows: windows of each stretch, by number, here a single one.
    """

    residuals: Callable[[Array], Array]
    windows: Sequence[range] = (range(1),)

    def linearised(self, starts: Array, values: Array, unknowns: NDArray[np.intp]) -> Linearised:
        """Return residuals and derivatives for a Gauss-Newton step, see `WindowModel`.

        Args:
            starts: not used, since the model has no starts.
            values: values (V,) of all parameters, in units of which a step of 1e-4 gives the derivative.
            unknowns: indices (f,) of the free ones.
        """
        # Residuals are measured minus predicted values, so they decrease where the prediction increases.
        residual, *ahead = self.residuals(np.vstack([values, values + STEP * np.eye(len(values))[unknowns]]))
        slope = np.stack([(residual - stepped) / STEP for stepped in ahead], axis=-1)
        stretch = LinearisedStretch(residual, residual, slope, [np.empty((0, len(unknowns)))], [np.empty(0)])
        return Linearised([stretch], finite=bool(np.isfinite(slope).all()))


@dataclass(frozen=True, eq=False)
class WindowedFit(Brief):
    """Fitted parameters with residuals and information, from which the standard errors follow."""

    values: Array
    """Values (V,) of all parameters."""
    starts: Array
    """Starts (W, s) of the windows."""
    unknowns: NDArray[np.intp]
    """Indices (f,) of the free parameters."""
    residuals: list[Array]
    """Measured minus predicted values (K, n) of each stretch."""
    information: Array
    """Information matrix (f, f) of the free parameters, with the starts eliminated."""
    scores: list[Array]
    """Gradient (K, f) of each sample for each stretch, with the starts eliminated."""
    gap: float
    """Largest gap between windows."""
    iterations: int
    converged: bool
    status: str

    @property
    def rms(self) -> Array:
        """Root mean square residual of each stretch (S,) over its quantities."""
        return np.array([np.sqrt((r**2).mean()) for r in self.residuals])

    def covariance(self, among: NDArray[np.bool_] | None = None) -> Array:
        """Return the covariance (f, f) of the free parameters, infinite where they are undetermined.

        Args:
            among: True for those (f,) that are not fixed at a bound; None for all.
        """
        among = np.ones(len(self.unknowns), dtype=bool) if among is None else among
        return clustered_covariance(
            self.information[np.ix_(among, among)], [score[:, among] for score in self.scores], self.residuals
        )


def clustered_covariance(information: NDArray[Any], scores: Sequence[Array], residuals: Sequence[Array]) -> Array:
    """Return the covariance (f, f) of estimates whose residuals are correlated, infinite where they are undetermined.

    It is Cov at the head of this module, where the information is H and the scores are summed over blocks to g. There
    are f unknowns, and each stretch of measurements has K samples of n quantities.

    Args:
        information: information matrix (f, f) of real numbers.
        scores: gradient (K, f) of each sample's loss by the f unknowns, for each stretch.
        residuals: residuals (K, n) of each stretch, which set the length of the blocks.
    """
    f = len(information)
    block = max(int(_BLOCK_TIMES * correlation_time(residuals)), _LEAST_BLOCK)
    # With more unknowns than blocks, the sum would be singular and some errors zero.
    block = max(min(block, sum(map(len, scores)) // max(_BLOCKS_PER_UNKNOWN * f, 1)), 1)
    counts = [max(round(len(score) / block), 1) for score in scores]
    edges = [
        np.linspace(0, len(score), count + 1).round().astype(int) for score, count in zip(scores, counts, strict=True)
    ]
    blocks = np.concatenate([np.add.reduceat(s, edge[:-1], axis=0) for s, edge in zip(scores, edges, strict=True)])
    score_covariance = blocks.T @ blocks * len(blocks) / max(len(blocks) - f, 1)
    # With a unit diagonal, the eigenvalues do not depend on the units of the unknowns.
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    eigenvalues, axes = np.linalg.eigh(information * np.outer(scale, scale))
    determined = eigenvalues > _UNSEEN * eigenvalues[-1]
    inverse = (axes[:, determined] / eigenvalues[determined]) @ axes[:, determined].T * np.outer(scale, scale)
    covariance = inverse @ score_covariance @ inverse
    # Every unknown that takes part in an undetermined direction is itself undetermined.
    for direction in (axes[:, ~determined] * scale[:, None]).T:
        affected = np.abs(direction) > 1e-6 * np.abs(direction).max()
        covariance[affected, affected] = np.inf
    return (covariance + covariance.T) / 2


def correlation_time(residuals: Sequence[Array]) -> float:
    """Return the integrated autocorrelation time of residuals, in samples, at least 1.

    Sums over blocks several times longer count as independent.

    The sum ends when the autocorrelation, pooled over stretches and quantities, first falls below 0.05.

    Args:
        residuals: residuals (K, n) of each stretch.
    """
    lags = min(map(len, residuals))
    # Zero padding to twice the length prevents wrap-around.
    spectra = [np.abs(np.fft.rfft(residual, 2 * len(residual), axis=0)) ** 2 for residual in residuals]
    autocovariance = np.sum([np.fft.irfft(spectrum, axis=0)[:lags].sum(axis=1) for spectrum in spectra], axis=0)
    if autocovariance[0] <= 0:
        return 1.0
    autocorrelation = np.append(autocovariance / autocovariance[0], 0.0)
    return float(max(1.0, 1 + 2 * autocorrelation[1 : np.argmax(autocorrelation < 0.05)].sum()))


class _Iterate(NamedTuple):
    """Starts (W, s) of the windows and values (V,) of all parameters, with the linearisation at them."""

    starts: Array
    values: Array
    linearised: Linearised


def fit_windows(
    model: WindowModel,
    values: Array,
    unknowns: NDArray[np.intp],
    *,
    bounds: tuple[Array, Array],
    settings: FitSettings,
    starts: Array | None = None,
) -> WindowedFit:
    """Fit the starts of windows and the free parameters by bounded Gauss-Newton steps.

    There are V parameters, f of which are free, and W windows, each of which has a start of s numbers.

    Args:
        model: model of the measurements.
        values: first guess or fixed values (V,) of all parameters.
        unknowns: indices (f,) of the free parameters.
        bounds: least and largest values (V,) of all parameters.
        settings: robust loss and convergence.
        starts: first guess (W, s) of the starts; None for a model without starts.

    Returns:
        The last iterate, also if it did not converge; its status then gives the reason and a remedy.
    """
    starts = np.empty((1, 0)) if starts is None else starts
    iterate = _Iterate(starts, values, model.linearised(starts, values, unknowns))
    threshold, converged, iteration, status = np.inf, False, 0, ""
    for iteration in range(1, settings.iterations + 1):
        if iteration <= _STILL_ADAPTING and settings.robust:
            # The median size of normal residuals times 1.4826 is their standard deviation.
            bulk = 1.4826 * float(np.median(iterate.linearised.sizes))
            threshold = settings.robust * max(bulk, settings.least_scale)
        normal = _normal(iterate.linearised, threshold)
        if not np.isfinite(normal.scaled).all():
            status = "errors grow too much along a swing to determine its start; cut the swings shorter"
            break
        # The share is 1 for a whole step, and less for a shortened one.
        next_iterate, share = _improved(iterate, model, unknowns, bounds, normal, threshold)
        if next_iterate is None:
            # At the minimum no step reduces the misfit either.
            converged = iterate.linearised.gap < 1e-6
            status = "" if converged else "no step reduced the misfit; check units, signs and the starting model"
            break
        decrease = 1 - next_iterate.linearised.merit(threshold) / max(iterate.linearised.merit(threshold), 1e-300)
        iterate = next_iterate
        if share == 1.0 and decrease < settings.tolerance and iterate.linearised.gap < 1e-7 and iteration > 2:
            converged = True
            break
    if not converged and not status:
        status = f"still improving after {settings.iterations} steps; increase the limit, or start from a better model"
    normal, stretches = _normal(iterate.linearised, threshold), iterate.linearised.stretches
    return WindowedFit(
        values=iterate.values,
        starts=iterate.starts,
        unknowns=unknowns,
        residuals=[stretch.residual for stretch in stretches],
        information=normal.reduced,
        scores=[
            np.einsum(
                "kaf,ka->kf",
                stretch.slope[..., len(by_unknowns) :] - stretch.slope[..., : len(by_unknowns)] @ by_unknowns,
                np.clip(stretch.residual, -threshold, threshold),
            )
            for stretch, by_unknowns in zip(stretches, normal.mixed, strict=True)
        ],
        gap=iterate.linearised.gap,
        iterations=iteration,
        converged=converged,
        status=status or f"converged in {iteration} steps",
    )


def _improved(
    now: _Iterate,
    model: WindowModel,
    unknowns: NDArray[np.intp],
    bounds: tuple[Array, Array],
    normal: "_Normal",
    threshold: float,
) -> tuple[_Iterate | None, float]:
    """Return the iterate after the longest step that reduces the misfit, None if no step does, and the step's share.

    The share 1 is tried first, then a half, a quarter and so on, `_TRIALS` in total. `now` is the present iterate, and
    `unknowns` are the indices (f,) of the free parameters. `bounds` are the least and largest values (V,) of all
    parameters. `normal` are the normal equations at `now`. `threshold` is the size of a residual from which the robust
    loss is linear.
    """
    lower, upper = bounds
    share = 1.0
    for _ in range(_TRIALS):
        step, first_changes = _step(normal, now.values[unknowns], lower[unknowns], upper[unknowns], share)
        values, starts = now.values.copy(), now.starts.copy()
        values[unknowns] += step
        for stretch, windows, first_change in zip(now.linearised.stretches, model.windows, first_changes, strict=True):
            direction = np.concatenate([first_change, step])
            for w, node, offset in zip(windows, stretch.nodes, stretch.offsets, strict=True):
                starts[w] += node @ direction + share * offset
        values = np.clip(values, lower, upper)
        trial = model.linearised(starts, values, unknowns)
        # Rounding may raise the misfit of a full step, but must not accept ever shorter ones.
        if trial.finite and trial.merit(threshold) < now.linearised.merit(threshold) * (1 + 1e-12 * (share == 1.0)):
            return _Iterate(starts, values, trial), share
        share /= 2
    return None, share


@dataclass(eq=False)
class _Normal:
    """Normal equations of the f unknowns, from which the stretches' starts are eliminated.

    Attributes:
        reduced: matrix (f, f).
        right: right-hand side (f,).
        mixed: for each stretch, the decrease (s, f) of its start per unknown.
        start_rights: for each stretch, the change (s,) of its start with fixed unknowns.
    """

    reduced: Array
    right: Array
    mixed: list[Array]
    start_rights: list[Array]

    @property
    def scale(self) -> Array:
        """Scale of each unknown (f,), with which the matrix has a unit diagonal."""
        sizes = np.diag(self.reduced)
        # Rounding must not make an unknown look determined if the data do not depend on it.
        return 1 / np.sqrt(np.maximum(sizes, max(_LOST * sizes.max(initial=0.0), 1e-300)))

    @property
    def scaled(self) -> Array:
        """The reduced matrix (f, f) with a unit diagonal, not finite if rounding dominates it."""
        with np.errstate(over="ignore", invalid="ignore"):
            vectors = self.reduced * self.scale[:, None] * self.scale
            return (vectors + vectors.T) / 2


def _normal(now: Linearised, threshold: float) -> _Normal:
    """Return the normal equations of a linearisation, with residuals beyond the threshold weighted down (Huber).

    Each stretch has its own block JᵀWJ, where J are the derivatives of its predictions and W the weights. With the
    parts A of its first start, C of the f unknowns and B between both, the stretch adds C - Bᵀ A⁻¹ B to the matrix
    (f, f). `now` is the linearisation, and residuals larger than `threshold` are weighted down.
    """
    n = len(now.stretches[0].offsets[0])
    f = now.stretches[0].slope.shape[2] - n
    normal = _Normal(np.zeros((f, f)), np.zeros(f), [], [])
    for stretch in now.stretches:
        robust_weights = np.minimum(1.0, threshold / np.maximum(np.abs(stretch.residual), 1e-300)).ravel()
        jacobian = stretch.slope.reshape(-1, n + f)
        weighted = jacobian * robust_weights[:, None]
        matrix, right = jacobian.T @ weighted, weighted.T @ stretch.reduced.ravel()
        of_starts, mixed, of_unknowns = matrix[:n, :n], matrix[:n, n:], matrix[n:, n:]
        solved = np.linalg.lstsq(of_starts, np.column_stack([mixed, right[:n]]), rcond=1e-14)[0].astype(np.float64)
        normal.reduced += of_unknowns - mixed.T @ solved[:, :f]
        normal.right += right[n:] - mixed.T @ solved[:, f]
        normal.mixed.append(solved[:, :f])
        normal.start_rights.append(solved[:, f])
    return normal


def _step(normal: _Normal, values: Array, least: Array, most: Array, share: float) -> tuple[Array, list[Array]]:
    """Return the bounded change of the unknowns (f,), and the change (s,) of each stretch's start.

    `values`, `least` and `most` (f,) are the unknowns and their bounds. `normal` are the normal equations. The share is
    1 for the whole Gauss-Newton step. A smaller share gives the step of Levenberg and Marquardt, which is shortened
    most in the directions that the data determine least.
    """
    f = len(values)
    step = np.zeros(f)
    if f:
        scale = normal.scale
        eigenvalues, axes = np.linalg.eigh(normal.scaled)
        eigenvalues += 1 / share - 1
        resolved = eigenvalues > 1e-12 * eigenvalues[-1]
        eigenvalues, axes = eigenvalues[resolved], axes[:, resolved]
        factor = np.sqrt(eigenvalues)[:, None] * axes.T
        right = (axes.T @ (normal.right * scale)) / np.sqrt(eigenvalues)
        # The solver needs bounds on both sides of zero, but an unknown may be at a bound; the clip below restores it.
        bounds = np.minimum((least - values) / scale, -1e-300), np.maximum((most - values) / scale, 1e-300)
        step = optimize.lsq_linear(factor, right, bounds=bounds, method="bvls").x * scale
        step = np.clip(values + step, least, most) - values
    return step, [share * r - mixed @ step for r, mixed in zip(normal.start_rights, normal.mixed, strict=True)]
