"""Swings cut into shooting windows, flown together, and linearised along each swing.

Linearised, each window's start follows from its swing's first one and from the unknowns (p, z): x_j = N_j (x_0, p, z) +
d_j, with the gaps between windows in d_j. See `dpcontrol.control.swing_fit`.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from dpcontrol.control.swings import Swings

Array = NDArray[np.float64]

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
