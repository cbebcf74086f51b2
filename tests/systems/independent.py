"""Independent orbits and connections by Dormand-Prince's eighth order, with equations from the literature.

Connections are found by brute force at crossings of two densely sampled curves, and refined by Newton's method
with finite differences, without code of dpcontrol.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.integrate import DOP853, solve_ivp

SEED = 1e-5
"""Distance of seeds from the orbit; the error of the linear manifold is its square."""
PARTED = 0.3
"""Largest distance of neighbouring seeds at arrival."""
NEWTON = 5
KNOTS = 400
ESCAPED = 2.0


@dataclass(frozen=True)
class Problem:
    """Rate and energy of states (N, ...), reverser (N,) of signs, and step (s) at states (N, K)."""

    rate: object
    energy: object
    reverser: tuple
    pace: object

    def jacobian(self, x):
        return np.array([np.imag(self.rate(x + 1e-30j * e)) / 1e-30 for e in np.eye(len(x))]).T

    def flow(self, x, time, *, variations=False):
        n = len(x)

        def both(_, y):
            m = y[n:].reshape(n, n)
            return np.concatenate([self.rate(y[:n]), (self.jacobian(y[:n]) @ m).ravel()])

        start = np.concatenate([x, np.eye(n).ravel()]) if variations else x
        function = both if variations else (lambda _, y: self.rate(y))
        end = solve_ivp(function, (0, time), start, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
        return (end[:n], end[n:].reshape(n, n)) if variations else end

    def step(self, x, h, rate=None):
        """One step of DOP853 of states (N, K) over times (K,)."""
        k = np.empty((DOP853.n_stages, *x.shape), x.dtype)
        for i in range(DOP853.n_stages):
            k[i] = (rate or self.rate)(x + h * np.tensordot(DOP853.A[i, :i], k[:i], 1))
        return x + h * np.tensordot(DOP853.B, k, 1)

    def carried(self, y):
        """The rate of states and tangent vectors, (2N, K)."""
        x, v = np.split(y, 2)
        return np.vstack([self.rate(x), np.imag(self.rate(x + 1e-30j * v)) / 1e-30])


@dataclass(frozen=True)
class Orbit:
    """A Lyapunov orbit from the reverser's fixed set, which it meets again after half its period."""

    problem: Problem
    state: np.ndarray
    period: float

    @cached_property
    def monodromy(self):
        return self.problem.flow(self.state, self.period, variations=True)[1]

    @cached_property
    def multiplier(self):
        return float(np.max(np.linalg.eigvals(self.monodromy).real))

    @cached_property
    def knots(self):
        """Orbit and unstable vector (2N, KNOTS) at equally spaced phases."""
        values, vectors = np.linalg.eig(self.monodromy)
        v = vectors[:, np.argmax(values.real)].real
        out = [np.append(self.state, v * np.sign(v[np.argmax(np.abs(v[: len(v) // 2]))]))]
        for _ in range(KNOTS - 1):
            out.append(self.problem.step(out[-1][:, None], self.period / KNOTS, self.problem.carried)[:, 0])
        return np.array(out).T

    def frame(self, phases):
        """Return orbit and unit unstable vectors (N, K) at phases from 0 to 1."""
        place = phases * KNOTS
        nearest = np.minimum(place.astype(int), KNOTS - 1)
        along = (place - nearest) * self.period / KNOTS
        states, vectors = np.split(self.problem.step(self.knots[:, nearest], along, self.problem.carried), 2)
        return states, vectors / np.linalg.norm(vectors, axis=0)

    def seeds(self, phases, branch):
        """Return seeds (N, K) on the orbit's energy, at any phases from 0 to 1."""
        states, vectors = self.frame(phases)
        seeds, energy = states + branch * SEED * vectors, self.problem.energy(self.state)
        for _ in range(3):
            slope = np.array(
                [np.imag(self.problem.energy(seeds + 1e-30j * e[:, None])) / 1e-30 for e in np.eye(len(seeds))]
            )
            seeds = seeds - (self.problem.energy(seeds) - energy) * slope / np.sum(slope**2, axis=0)
        return seeds


def orbit_near(problem, state, period, energy):
    """Refine an orbit by Newton's method on (initial state in the fixed set, half period)."""
    signs = np.array(problem.reverser)
    free, moved = np.flatnonzero(signs > 0), np.flatnonzero(signs < 0)
    unknowns = np.append(np.asarray(state)[free], period / 2)
    for _ in range(8):
        start = np.zeros(len(signs))
        start[free] = unknowns[:-1]
        end, stm = problem.flow(start, unknowns[-1], variations=True)
        slope = np.array([np.imag(problem.energy(start + 1e-30j * e)) / 1e-30 for e in np.eye(len(signs))])
        matrix = np.vstack([np.column_stack([stm[np.ix_(moved, free)], problem.rate(end)[moved]]), [*slope[free], 0.0]])
        step = np.linalg.solve(matrix, np.append(end[moved], problem.energy(start) - energy))
        unknowns = unknowns - step
        if np.abs(step).max() < 1e-13:
            break
    start = np.zeros(len(signs))
    start[free] = unknowns[:-1]
    return Orbit(problem, start, 2 * float(unknowns[-1]))


@dataclass(frozen=True)
class Cut:
    """The `hit`-th crossing of height(x) = 0 with counts(x) by seeds of one branch, or NaN."""

    orbit: Orbit
    height: object
    counts: object
    hit: int
    branch: int
    longest: float

    def arrive(self, phases):
        """Return the states (N, K) at arrival."""
        problem, x = self.orbit.problem, self.orbit.seeds(phases, self.branch)
        out = np.full_like(x, np.nan)
        seen, time = np.zeros(x.shape[1], int), np.zeros(x.shape[1])
        flying = np.arange(x.shape[1])
        while flying.size:
            h = problem.pace(x[:, flying])
            following = problem.step(x[:, flying], h)
            before, after = self.height(x[:, flying]), self.height(following)
            passed = np.flatnonzero(np.sign(before) * np.sign(after) < 0)
            if passed.size:
                start, part = x[:, flying[passed]], h[passed] * before[passed] / (before[passed] - after[passed])
                for _ in range(8):
                    there = problem.step(start, part)
                    slope = np.array(
                        [np.imag(self.height(there + 1e-30j * e[:, None])) / 1e-30 for e in np.eye(len(x))]
                    )
                    part = part - self.height(there) / np.sum(slope * problem.rate(there), axis=0)
                there = problem.step(start, part)
                counted = self.counts(there)
                seen[flying[passed[counted]]] += 1
                done = passed[counted & (seen[flying[passed]] == self.hit)]
                out[:, flying[done]] = there[:, np.isin(passed, done)]
            x[:, flying] = following
            time[flying] += h
            near = np.abs(x[:2, flying]).max(axis=0) < ESCAPED
            flying = flying[near & (seen[flying] < self.hit) & (time[flying] < self.longest)]
        return out


def crossings(unstable, stable, chart, count):
    """Return the states (K, N) at intersections of two tubes' cuts, with `count` seeds each.

    The argument `stable` is the cut of the target's unstable tube, reversed here. The chart maps (N, K) to (2, K).
    """
    signs = np.array(unstable.orbit.problem.reverser)[:, None]
    phases = np.linspace(0, 1, count + 1)
    first = unstable.arrive(phases)
    second = signs * (first if stable is unstable else stable.arrive(phases))
    a, b = chart(first), chart(second)
    along = np.diff(b)
    guesses = []
    for i in range(count):
        p, r = a[:, i, None], a[:, i + 1] - a[:, i]
        gap, cross = b[:, :-1] - p, r[0] * along[1] - r[1] * along[0]
        with np.errstate(all="ignore"):
            t, u = (gap[0] * along[1] - gap[1] * along[0]) / cross, (gap[0] * r[1] - gap[1] * r[0]) / cross
        # Separated neighbours are not on one curve, and distant states meet only in the chart.
        near = (np.linalg.norm(along, axis=0) < PARTED) & (np.linalg.norm(r) < PARTED)
        near &= np.abs(second[:, :-1] - first[:, i, None]).max(axis=0) < PARTED * (1 + np.abs(first[:, i]).max())
        guesses += [(i + t[j], j + u[j]) for j in np.flatnonzero(near & (t >= 0) & (t < 1) & (u >= 0) & (u < 1))]
    if not guesses:
        return np.empty((0, len(signs)))
    found = []
    for state in _refined(unstable, stable, signs, chart, np.array(guesses).reshape(-1, 2).T / count):
        if not any(np.abs(state - other).max() < 1e-7 for other in found):
            found.append(state)
    return np.array(found).reshape(-1, len(signs))


def _refined(unstable, stable, signs, chart, phases):
    """Return the states (K, N) at which both tubes meet, near given phases (2, K)."""
    tiny = 1e-6
    for _ in range(NEWTON):
        there = []
        for cut, turn, q in zip((unstable, stable), (1, signs), phases, strict=True):
            both = turn * cut.arrive(np.concatenate([q, q + tiny]) % 1.0)
            there.append(np.split(both, 2, axis=1))
        gap = chart(there[0][0]) - chart(there[1][0])
        du, ds = (sign * (chart(moved) - chart(x)) / tiny for sign, (x, moved) in zip((1, -1), there, strict=True))
        size = du[0] * ds[1] - du[1] * ds[0]
        step = np.array([gap[0] * ds[1] - gap[1] * ds[0], du[0] * gap[1] - du[1] * gap[0]]) / size
        phases = phases - step * np.minimum(1.0, 0.01 / np.abs(step).max(axis=0))
    return there[0][0].T[np.abs(there[0][0] - there[1][0]).max(axis=0) < 1e-6]
