"""Ratios, encoder zeros and starts that explain measured swings: multiple shooting with a robust loss.

    min Σ ρ(y_k - θ(t_k; x_j, p) - z),   x_{j+1} = φ(x_j, p) from window to window,   p_i ≥ 0 for friction
    ρ(e) = ½e² for |e| ≤ d, else d(|e| - ½d)        (Huber)

by Gauss-Newton steps on all windows' starts x_j at once: linearised, the later starts follow from each swing's first
one and from (p, z), so that a swing adds a small dense block; the first starts are eliminated from it in turn. With
windows of half a second a poor first guess, or a chaotic swing, does no harm.

Sources: Bock, Kostina, Schlöder, Numerical methods for parameter estimation in nonlinear differential algebraic
equations (2007); Albersmeyer, Diehl, The lifted Newton method (2010); Huber, Robust statistics (1981), section 7.8.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from dpcontrol.control.shooting_windows import Linearised, Swing, Windows, linearised
from dpcontrol.control.swings import Swings
from dpcontrol.foundation.errors import InputError

Array = NDArray[np.float64]

_STILL_ADAPTING = 6
_HALVINGS = 8


@dataclass(frozen=True)
class FitSettings:
    """window s: length of a shooting window. robust: where the loss turns from square to straight, in standard
    deviations of the bulk; 0 for squares alone. bend rad: where it turns, if it is to be held there rather than found.
    least_scale rad: the bulk is taken as no narrower; half a count or so.
    tolerance: share of the loss by which the last step may still lessen it.
    """

    window: float = 0.5
    robust: float = 3.0
    bend: float = 0.0
    least_scale: float = 1e-4
    iterations: int = 40
    tolerance: float = 1e-7

    def __post_init__(self) -> None:
        """Refuse impossible settings.

        Raises:
            InputError: names the setting, its value and what is allowed.
        """
        for name in ("window", "least_scale", "tolerance"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"fit: {name} = {getattr(self, name)!r}: must be positive")
        for name in ("robust", "bend"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise InputError(f"fit: {name} = {getattr(self, name)!r}: must be zero or positive")
        if self.iterations < 1:
            raise InputError(f"fit: iterations = {self.iterations!r}: must be at least 1")


@dataclass(frozen=True, eq=False)
class SwingFit:
    """Ratios (m,) and zeros (groups, n) rad that were found, the starts (S, 2n) of the swings, and what is left.

    residuals: of each swing (K, n), rad, measured less predicted. information: of the free unknowns (see `unknowns`),
    with the starts eliminated; scores: of each swing (K, f), each sample's part of the gradient, starts eliminated.
    unknowns: indices of the free ones among (p, z raveled). bend rad: where the loss turned straight. window_starts
    (W, 2n). converged, status: a sentence; gap: the largest between windows.
    """

    parameters: Array
    zeros: Array
    starts: Array
    residuals: list[Array]
    information: Array
    scores: list[Array]
    unknowns: NDArray[np.intp]
    loss: float
    bend: float
    window_starts: Array
    gap: float
    iterations: int
    converged: bool
    status: str

    @property
    def rms(self) -> Array:
        """Root mean square of each swing's residuals over its angles (S,), rad."""
        return np.array([np.sqrt((r**2).mean()) for r in self.residuals])


def fit_swings(
    model: Swings,
    swings: list[Swing],
    *,
    parameters: Array,
    zeros: Array,
    free: NDArray[np.bool_],
    free_zeros: bool,
    friction_from: int,
    settings: FitSettings,
    near: Array | None = None,
) -> SwingFit:
    """Fit the swings' starts, and those of the parameters (m,) that are `free` (m,), and the zeros if asked.

    parameters and zeros (groups, n) are the first guess, or what is held; near (W, 2n): that of the windows' starts, in
    place of the measured angles. From index `friction_from` on parameters stay at zero or above.

    Raises:
        InputError: a swing is too short.
    """
    if any(len(s.angles) < 8 for s in swings):
        raise InputError("a swing of fewer than 8 samples tells nothing; leave it out")
    cut = Windows(swings, model, settings.window)
    n, m, arms = model.states, model.parameters, model.states // 2
    unknown = np.concatenate([free, np.full(zeros.size, free_zeros)])
    values = np.concatenate([parameters, zeros.ravel()])
    lower = np.where((np.arange(len(values)) >= friction_from) & (np.arange(len(values)) < m), 0.0, -np.inf)
    where = np.flatnonzero(unknown)
    starts = cut.guess() if near is None else near.copy()
    groups = [s.group for s in swings]
    if near is None:
        for windows, group in zip(cut.of_swing, groups, strict=True):
            starts[windows, :arms] -= zeros[group]

    def evaluated(starts: Array, values: Array) -> Linearised:
        states, slopes = cut.flown(starts, values[:m])
        return linearised(cut, starts, states, slopes, values, where, groups)

    now = evaluated(starts, values)
    threshold, converged, iteration, status = np.inf, False, 0, ""
    damping = 0.0
    for iteration in range(1, settings.iterations + 1):
        if iteration <= _STILL_ADAPTING:
            threshold = _threshold(now, settings)
        normal = _normal(now, threshold, n, len(where))
        if not np.isfinite(normal.scaled).all():
            status = "errors grow so much along a swing that its start tells nothing; cut the swings shorter"
            break
        step, firsts = _step(normal, values[where], lower[where], damping)
        better, share = None, 1.0
        new_values, new_starts = values, starts
        for _ in range(_HALVINGS):
            new_values = values.copy()
            new_values[where] += share * step
            new_starts = starts.copy()
            for s, windows in enumerate(cut.of_swing):
                direction = np.concatenate([firsts[s], step])
                for j, w in enumerate(windows):
                    new_starts[w] += share * (now.nodes[s][j] @ direction + now.offsets[s][j])
            trial = evaluated(new_starts, np.maximum(new_values, lower))
            if trial.finite and trial.merit(threshold) < now.merit(threshold) * (1 + 1e-12):
                better = trial
                break
            share /= 2
        if better is None:
            converged = damping == 0.0 and now.gap < 1e-6
            status = "" if converged else "no step lessened the misfit; check units, signs and the starting model"
            break
        gained = 1 - better.merit(threshold) / max(now.merit(threshold), 1e-300)
        now, starts, values = better, new_starts, np.maximum(new_values, lower)
        if share == 1.0 and gained < settings.tolerance and now.gap < 1e-7 and iteration > 2:
            converged = True
            break
    if not converged and not status:
        status = f"still improving after {settings.iterations} steps; allow more, or start from a nearer model"
    normal = _normal(now, threshold, n, len(where))
    return SwingFit(
        parameters=values[:m],
        zeros=values[m:].reshape(zeros.shape),
        starts=np.array([starts[windows[0]] for windows in cut.of_swing]),
        residuals=now.residuals,
        information=normal.reduced,
        scores=[_scores(now, normal, s, threshold) for s in range(len(swings))],
        unknowns=where,
        loss=now.loss(threshold),
        bend=float(threshold),
        window_starts=starts,
        gap=now.gap,
        iterations=iteration,
        converged=converged,
        status=status or f"converged in {iteration} steps",
    )


def _threshold(now: Linearised, settings: FitSettings) -> float:
    if settings.bend:
        return settings.bend
    if settings.robust == 0:
        return np.inf
    every = np.abs(np.concatenate([r.ravel() for r in now.residuals]))
    return settings.robust * max(1.4826 * float(np.median(every)), settings.least_scale)


@dataclass(eq=False)
class _Normal:
    """Normal equations with the starts eliminated: reduced (f, f), right (f,); of each swing what gives its start."""

    reduced: Array
    right: Array
    start_matrices: list[Array]
    mixed: list[Array]
    start_rights: list[Array]

    @property
    def scale(self) -> Array:
        """What each unknown (f,) is measured in."""
        return 1 / np.sqrt(np.maximum(np.diag(self.reduced), 1e-300))

    @property
    def scaled(self) -> Array:
        """The reduced matrix (f, f) with ones on its diagonal; not finite where rounding has left nothing of it."""
        with np.errstate(over="ignore", invalid="ignore"):
            vectors = self.reduced * self.scale[:, None] * self.scale
            return (vectors + vectors.T) / 2


def _normal(now: Linearised, threshold: float, n: int, f: int) -> _Normal:
    out = _Normal(np.zeros((f, f)), np.zeros(f), [], [], [])
    for residual, reduced, slopes in zip(now.residuals, now.reduced_residuals, now.slopes, strict=True):
        weights = np.minimum(1.0, threshold / np.maximum(np.abs(residual), 1e-300)).ravel()
        jacobian = slopes.reshape(-1, n + f)
        weighted = jacobian * weights[:, None]
        matrix, right = jacobian.T @ weighted, weighted.T @ reduced.ravel()
        a, b, c = matrix[:n, :n], matrix[:n, n:], matrix[n:, n:]
        solved = np.linalg.lstsq(a, np.column_stack([b, right[:n]]), rcond=1e-14)[0].astype(np.float64)
        out.reduced += c - b.T @ solved[:, :f]
        out.right += right[n:] - b.T @ solved[:, f]
        out.start_matrices.append(a)
        out.mixed.append(solved[:, :f])
        out.start_rights.append(solved[:, f])
    return out


def _step(normal: _Normal, values: Array, lower: Array, damping: float) -> tuple[Array, list[Array]]:
    """Return the change of the unknowns (f,), none below its bound, and of each swing's start (2n,)."""
    f = len(values)
    step = np.zeros(f)
    if f:
        scale = normal.scale
        sizes, axes = np.linalg.eigh(normal.scaled)
        kept = sizes > 1e-12 * sizes[-1]
        root = np.sqrt(sizes[kept])[:, None] * axes[:, kept].T
        right = (axes[:, kept].T @ (normal.right * scale)) / np.sqrt(sizes[kept])
        if damping:
            root, right = np.vstack([root, damping * np.eye(f)]), np.append(right, np.zeros(f))
        bounds = np.minimum((lower - values) / scale, -1e-300)
        step = lsq_linear(root, right, bounds=(bounds, np.full(f, np.inf)), method="bvls").x * scale
        step = np.maximum(values + step, lower) - values
    return step, [r - mixed @ step for r, mixed in zip(normal.start_rights, normal.mixed, strict=True)]


def _scores(now: Linearised, normal: _Normal, s: int, threshold: float) -> Array:
    """Return each sample's part (K, f) of the loss's gradient by the unknowns, the start following them."""
    residual = now.residuals[s]
    n = len(normal.mixed[s])
    along = now.slopes[s][..., n:] - now.slopes[s][..., :n] @ normal.mixed[s]
    pulled = np.clip(residual, -threshold, threshold)
    return np.einsum("kaf,ka->kf", along, pulled)
