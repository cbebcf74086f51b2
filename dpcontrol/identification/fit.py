"""Ratios, encoder zeros and starts that explain measured swings: multiple shooting with a robust loss.

    min Σ ρ(y_k - θ(t_k; x_j, p) - z),   x_{j+1} = φ(x_j, p) from window to window,   p_i ≥ 0 for friction
    ρ(e) = ½e² for |e| ≤ d, else d(|e| - ½d)        (Huber)

by Gauss-Newton steps on all windows' starts x_j at once: linearised, the later starts follow from each swing's first
one and from (p, z), x_j = N_j (x_0, p, z) + d_j with the gaps between windows in d_j, so that a swing adds a small
dense block; the first starts are eliminated from it in turn. With
windows of half a second a poor first guess, or a chaotic swing, does no harm.

Swings fly from many starts at once, with their sensitivities to start and parameters:

    x_{k+1} = F(x_k, p; u),    S_{k+1} = ∂F/∂x S_k + [0  ∂F/∂p],    S = [∂x/∂x_0  ∂x/∂p]

F is one classical Runge-Kutta step (order 4), p the ratios of `dpcontrol.dynamics.chain`; the cart is clamped or
follows an acceleration. It is compiled once in a process, for as many swings as the processor's vectors hold.

Sources: Bock, Kostina, Schlöder, Numerical methods for parameter estimation in nonlinear differential algebraic
equations (2007); Albersmeyer, Diehl, The lifted Newton method (2010); Huber, Robust statistics (1981), section 7.8;
Hairer, Nørsett, Wanner, Solving ordinary differential equations I (1993), section I.14.
"""

from dataclasses import dataclass, field, replace
from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from dpcontrol.dynamics.chain import ArmChainParameters, Level, base_from_ratios, equations_of, ratio_names
from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import Settings, setting

Array = NDArray[np.float64]

LONGEST_STEP = 2e-3
"""s. Steps of 1 ms are off by 1e-7 rad at the rig's rates, most of it where Coulomb friction changes sides."""


class Swings:
    """Swings of `arms`: their count, gravity and laws of friction; the parameters' values are given with each call.

    Not to be shared between threads.
    """

    def __init__(self, arms: ArmChainParameters) -> None:
        self.arms = arms
        self.states = 2 * arms.count
        self.parameters = len(ratio_names(arms))

    def flown(
        self,
        starts: Array,
        parameters: Array,
        *,
        period: Array,
        samples: int,
        accelerations: Array | None = None,
        velocities: Array | None = None,
    ) -> tuple[Array, Array]:
        """Return states (W, K, N) and sensitivities (W, K, N, N+m) at `samples` = K times from each start (W, N).

        parameters (m,) ratios; period (W,) s between samples; accelerations (W, K) m/s² of the cart, held from each
        sample to the next, and velocities (W, K) m/s at it, zero if not given.
        """
        w, n, m = len(starts), self.states, self.parameters
        size = n + n * (n + m)
        substeps = int(np.ceil(period.max() / LONGEST_STEP - 1e-9))
        held, out = np.empty((size + m + 3, w)), np.empty((size, w))
        held[:n] = starts.T
        held[n:size] = np.eye(n, n + m).T.reshape(-1, 1)
        held[size : size + m] = parameters[:, None]
        held[size + m] = period / substeps
        held[size + m + 1 :] = 0.0
        every = np.empty((samples, size, w))
        step = _compiled(_nominal(self.arms))
        every[0] = held[:size]
        for k in range(1, samples):
            if accelerations is not None and velocities is not None:
                held[size + m + 1] = accelerations[:, k - 1]
                held[size + m + 2] = velocities[:, k - 1]
            for _ in range(substeps):
                step(held, out)
                held[:size] = out
                if accelerations is not None:
                    held[size + m + 2] += held[size + m] * held[size + m + 1]
            every[k] = out
        states = every[:, :n].transpose(2, 0, 1)
        return states, every[:, n:].reshape(samples, n + m, n, w).transpose(3, 0, 2, 1)


def _nominal(arms: ArmChainParameters) -> ArmChainParameters:
    """Return arms that stand for all of the same count, gravity, laws of friction and smoothing."""
    one = (1.0,) * arms.count
    names = ("mass", "centre_of_mass", "length", "inertia", "viscous", *arms.friction)
    return replace(arms, **dict.fromkeys(names, one))


@cache
def _compiled(arms: ArmChainParameters) -> Compiled:
    """Return (x, vec S, p, (h, u, v)) -> (x, vec S) one step later; compiling takes longer than most fits."""
    n, m = 2 * arms.count, len(ratio_names(arms))
    rate = equations_of(arms, Level.CART).function()
    x, p, drive = ca.SX.sym("x", n), ca.SX.sym("p", m), ca.SX.sym("drive", 3)
    h, u, velocity = drive[0], drive[1], drive[2]
    base = ca.vertcat(*base_from_ratios(p, arms))

    def slope(state: ca.SX, after: ca.SX) -> ca.SX:
        return rate(ca.vertcat(state, 0, velocity + after * u), u, base)[:n]

    k1 = slope(x, ca.SX(0))
    k2 = slope(x + h / 2 * k1, h / 2)
    k3 = slope(x + h / 2 * k2, h / 2)
    k4 = slope(x + h * k3, h)
    following = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    s = ca.SX.sym("S", n, n + m)
    forward = ca.jacobian(following, x) @ s + ca.horzcat(ca.SX.zeros(n, n), ca.jacobian(following, p))
    out = ca.cse(ca.densify(ca.vertcat(following, ca.vec(forward))))
    return Compiled(ca.Function("swing", [ca.vertcat(x, ca.vec(s)), p, drive], [out]))


_GAP_WEIGHT = 1e3


@dataclass(frozen=True, eq=False)
class Swing:
    """K measured samples of one uninterrupted swing: angles (K, n) rad, absolute from hanging; period s between them.

    group: of swings that share their encoders' zeros. accelerations (K,) m/s² and velocities (K,) m/s of the cart, or
    None where it was clamped.
    """

    angles: Array
    period: float
    group: int = 0
    accelerations: Array | None = None
    velocities: Array | None = None


@dataclass(eq=False)
class Windows:
    """All swings cut into windows, flown together."""

    swings: list[Swing]
    model: Swings
    length: float
    of_swing: list[list[int]] = field(default_factory=list)
    first: list[int] = field(default_factory=list)
    last: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        for swing in self.swings:
            count = len(swing.angles)
            per_window = max(round(self.length / swing.period), 2)
            pieces = max(round((count - 1) / per_window), 1)
            edges = np.linspace(0, count - 1, pieces + 1).round().astype(int)
            self.of_swing.append(list(range(len(self.first), len(self.first) + pieces)))
            self.first += edges[:-1].tolist()
            self.last += edges[1:].tolist()
        self.samples = max(b - a for a, b in zip(self.first, self.last, strict=True)) + 1
        owner = [s for s, windows in enumerate(self.of_swing) for _ in windows]
        self.periods = np.array([self.swings[s].period for s in owner])
        self.drive = None
        if any(s.accelerations is not None for s in self.swings):
            self.drive = np.zeros((2, len(owner), self.samples))
            for w, s in enumerate(owner):
                rows = slice(self.first[w], self.last[w] + 1)
                for row, values in enumerate((self.swings[s].accelerations, self.swings[s].velocities)):
                    if values is not None:
                        self.drive[row, w, : self.last[w] + 1 - self.first[w]] = values[rows]

    def guess(self) -> Array:
        """Return starts (W, 2n) from the measured angles, rates by a local polynomial."""
        # It brings all of scipy.stats, which runs on a model that was identified elsewhere do not need.
        from scipy.signal import savgol_filter

        starts = []
        for swing, windows in zip(self.swings, self.of_swing, strict=True):
            width = min(max(int(0.02 / swing.period) | 1, 5), (len(swing.angles) - 1) | 1)
            rates = np.asarray(savgol_filter(swing.angles, width, 3, deriv=1, delta=swing.period, axis=0), dtype=float)
            starts += [np.concatenate([swing.angles[self.first[w]], rates[self.first[w]]]) for w in windows]
        return np.array(starts)

    def flown(self, starts: Array, parameters: Array) -> tuple[Array, Array]:
        u, v = (None, None) if self.drive is None else self.drive
        return self.model.flown(
            starts, parameters, period=self.periods, samples=self.samples, accelerations=u, velocities=v
        )


@dataclass(eq=False)
class Linearised:
    """Residuals (K, n) of each swing, their slopes (K, n, 2n+f) over its first start and the f unknowns, and how each
    window's start follows from these: nodes (J, 2n, 2n+f) and offsets (J, 2n). gap: the largest between windows.
    """

    residuals: list[Array]
    reduced_residuals: list[Array]
    slopes: list[Array]
    nodes: list[Array]
    offsets: list[Array]
    gaps: float
    gap: float
    finite: bool

    def loss(self, threshold: float) -> float:
        return float(sum(_huber(r, threshold).sum() for r in self.residuals))

    def merit(self, threshold: float) -> float:
        scale = threshold if np.isfinite(threshold) else 1e-3
        return self.loss(threshold) / scale**2 + _GAP_WEIGHT * self.gaps / scale


def _huber(errors: Array, threshold: float) -> Array:
    size = np.abs(errors)
    if not np.isfinite(threshold):
        return size**2 / 2
    return np.where(size <= threshold, size**2 / 2, threshold * (size - threshold / 2))


def linearised(
    cut: Windows,
    starts: Array,
    states: Array,
    slopes: Array,
    values: Array,
    where: NDArray[np.intp],
    groups: list[int],
) -> Linearised:
    """Chain the windows' slopes along each swing."""
    n, m, arms, f = cut.model.states, cut.model.parameters, cut.model.states // 2, len(where)
    zeros = values[m:].reshape(-1, arms)
    in_model = where < m
    out = Linearised([], [], [], [], [], 0.0, 0.0, bool(np.isfinite(states).all() and np.isfinite(slopes).all()))
    for s, windows in enumerate(cut.of_swing):
        swing = cut.swings[s]
        count = len(swing.angles)
        residual, reduced = np.empty((count, arms)), np.empty((count, arms))
        slope = np.zeros((count, arms, n + f))
        node, offset = np.eye(n, n + f), np.zeros(n)
        nodes: list[Array] = []
        offsets: list[Array] = []
        for w in windows:
            nodes.append(node)
            offsets.append(offset)
            rows, k = slice(cut.first[w], cut.last[w] + 1), cut.last[w] - cut.first[w]
            jacobian = slopes[w, : k + 1, :arms]
            residual[rows] = swing.angles[rows] - states[w, : k + 1, :arms] - zeros[groups[s]]
            reduced[rows] = residual[rows] - jacobian[..., :n] @ offset
            slope[rows] = jacobian[..., :n] @ node
            slope[rows, :, n:][..., in_model] += jacobian[..., n + where[in_model]]
            end = slopes[w, k]
            node, offset = end[:, :n] @ node, end[:, :n] @ offset
            node[:, n:][:, in_model] += end[:, n + where[in_model]]
            if w != windows[-1]:
                jump = states[w, k] - starts[w + 1]
                offset = offset + jump
                out.gaps += float(np.abs(jump).sum())
                out.gap = max(out.gap, float(np.abs(jump).max()))
        for column, index in enumerate(where):
            if index >= m and (index - m) // arms == groups[s]:
                slope[:, (index - m) % arms, n + column] = 1.0
        out.residuals.append(residual)
        out.reduced_residuals.append(reduced)
        out.slopes.append(slope)
        out.nodes.append(np.array(nodes))
        out.offsets.append(np.array(offsets))
    return out


_STILL_ADAPTING = 6
_HALVINGS = 8


@dataclass(frozen=True)
class FitSettings(Settings, table="fit"):
    """window s: length of a shooting window. robust: where the loss turns from square to straight, in standard
    deviations of the bulk; 0 for squares alone. bend rad: where it turns, if it is to be held there rather than found.
    least_scale rad: the bulk is taken as no narrower; half a count or so.
    tolerance: share of the loss by which the last step may still lessen it.
    """

    window: float = setting(0.5, above=0, unit="s")
    robust: float = setting(3.0, least=0)
    bend: float = setting(0.0, least=0, unit="rad")
    least_scale: float = setting(1e-4, above=0, unit="rad")
    iterations: int = setting(40, least=1)
    tolerance: float = setting(1e-7, above=0)


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
        raise InputError("a swing of fewer than 8 samples determines nothing; leave it out")
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
    for iteration in range(1, settings.iterations + 1):
        if iteration <= _STILL_ADAPTING:
            threshold = _threshold(now, settings)
        normal = _normal(now, threshold, n, len(where))
        if not np.isfinite(normal.scaled).all():
            status = "errors grow so much along a swing that its start determines nothing; cut the swings shorter"
            break
        step, firsts = _step(normal, values[where], lower[where])
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
            converged = now.gap < 1e-6
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


def _step(normal: _Normal, values: Array, lower: Array) -> tuple[Array, list[Array]]:
    """Return the change of the unknowns (f,), none below its bound, and of each swing's start (2n,)."""
    f = len(values)
    step = np.zeros(f)
    if f:
        scale = normal.scale
        sizes, axes = np.linalg.eigh(normal.scaled)
        kept = sizes > 1e-12 * sizes[-1]
        root = np.sqrt(sizes[kept])[:, None] * axes[:, kept].T
        right = (axes[:, kept].T @ (normal.right * scale)) / np.sqrt(sizes[kept])
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
