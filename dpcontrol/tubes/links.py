"""Connections as points of curves in energy: matching without a section.

A connection leaves the seed circle γ(φ_u) ± δ v(φ_u) of its source's unstable manifold and after a time T arrives on
that of its target's stable manifold, at phase φ_s. With X_u(φ_u, t) the seed flown forward and X_s(φ_s, t) backward,

    F(φ_u, φ_s, T; H) = X_u(φ_u, T/2) - X_s(φ_s, T/2) - whole turns = 0,

four equations of which one (energy) is redundant, for three unknowns at every energy H. No section appears: where the
connection meets one, how often, and whether it grazes it, makes no difference here. The tangent spaces of the two
manifolds are spanned by (∂X_u/∂φ_u, f) and (∂X_s/∂φ_s, f); they coincide, and the connection is tangent, where

    σ = det[∂X_u/∂φ_u, -∂X_s/∂φ_s, f, ∇H] = 0        (columns scaled to length one).

A homoclinic that a reverser R carries to itself has its midpoint on Fix R (2 equations for φ, T). There R splits the
tangent D = ∂X_u/∂φ into D₊ (fixed by R, and across ∇H) and D₋ (turned over, modulo f). σ is a product of a = D₋ and
b = D₊: at a = 0 two symmetric connections meet, at b = 0 the symmetric one sheds a mirror pair.

Source: Champneys & Kuznetsov, Numerical detection and continuation of codimension-two homoclinic bifurcations (1994);
Vanderbauwhede & Fiedler (1992) for the reversible case.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError
from dpcontrol.tubes.lyapunov import LyapunovOrbit, described_orbit, lyapunov_orbit
from dpcontrol.tubes.manifold import UnstableManifold
from dpcontrol.tubes.symmetric_shooting import SymmetricShooting, symmetric_shooting

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Link:
    """A connection from seed to seed: branches (±1, ±1), phases φ_u and φ_s, duration T in s, whole turns (N,)."""

    branches: tuple[int, int]
    phases: tuple[float, float]
    duration: float
    turns: tuple[float, ...]

    @property
    def unknowns(self) -> Array:
        """(φ_u, φ_s, T)."""
        return np.array([*self.phases, self.duration])

    def at(self, unknowns: Array) -> "Link":
        """Return the link moved to unknowns (3,)."""
        return replace(self, phases=(float(unknowns[0]), float(unknowns[1])), duration=float(unknowns[2]))


@dataclass(frozen=True)
class Match:
    """How two tubes meet: gap (N,), scaled; its derivative (N, 3) by (φ_u, φ_s, T); tangency σ; state (N,) midway."""

    gap: Array
    jacobian: Array
    tangency: float
    state: Array


@dataclass(frozen=True)
class MirrorMatch:
    """How a tube meets a fixed set: miss (n,), scaled; derivative (n, 2) by (φ, T); a, b as in the module's text."""

    miss: Array
    jacobian: Array
    fold: float
    shedding: float


def phase_gap(first: float, second: float) -> float:
    """Return the difference of phases between -½ and ½."""
    return (first - second + 0.5) % 1.0 - 0.5


class LinkProblem:
    """Matching between the tubes of two saddles at any energy; orbits are kept by energy.

    distance: of the seeds from their orbits, scaled. Systems of two degrees of freedom only.
    """

    def __init__(self, system: System, source: str, target: str, *, distance: float) -> None:
        if system.dimension != 4:
            raise InputError(
                f"{system.name} has {system.dimension // 2} degrees of freedom: connections are followed in energy "
                "for two, where tubes are surfaces in a three-dimensional energy level"
            )
        self.system, self.source, self.target, self.distance = system, source, target, distance
        self._shooting: dict[str, SymmetricShooting] = {}
        self._manifolds: dict[tuple[str, float], UnstableManifold] = {}
        self._guesses: dict[str, list[tuple[float, Array]]] = {}
        lengths = np.where(np.isfinite(system.periods), system.periods, 0.0)
        self.lengths = lengths

    def _orbit(self, saddle: str, energy: float) -> LyapunovOrbit:
        """Return the orbit at `energy`, by Newton's method from the nearest one that is known."""
        if saddle not in self._shooting:
            self._shooting[saddle], _ = symmetric_shooting(self.system, saddle, 0)
            self._guesses[saddle] = []
        problem, known = self._shooting[saddle], self._guesses[saddle]
        floor = float(self.system.numeric.hamiltonian(problem.centre))
        for near, unknowns in sorted(known, key=lambda g: abs(g[0] - energy))[:1]:
            # Unknowns grow as the root of the height above the saddle, so a guess from far off is no guess.
            if not 0.8 < (energy - floor) / (near - floor) < 1.25:
                continue
            found, residual = problem.at_energy(unknowns, energy, iterations=10, tolerance=1e-13)
            if residual < 1e-12:
                known.append((energy, found))
                return described_orbit(
                    problem, found, saddle=saddle, family=0, energy=energy, newton_residual=residual, converged=True,
                    status=f"converged from the orbit at {near:.9g} J",
                )  # fmt: skip
        orbit = lyapunov_orbit(self.system, saddle, energy=energy)
        if not orbit.converged:
            raise ArithmeticError(f"the Lyapunov orbit about {saddle} at {energy:.9g} J: {orbit.status}")
        c = problem.start.T @ (orbit.state - problem.centre)
        known.append((energy, np.append(c, orbit.period / problem.quarters)))
        return orbit

    def centre(self, saddle: str) -> Array:
        """Return the state (N,) of a saddle."""
        return self.system.equilibrium(saddle)

    def manifold(self, saddle: str, energy: float) -> UnstableManifold:
        """Return the unstable manifold of a saddle's orbit at `energy`, its vector turned as at the first energy.

        Raises:
            ArithmeticError: the orbit did not converge.
            InputError: no orbit exists at that energy.
        """
        if (saddle, energy) not in self._manifolds:
            manifold = UnstableManifold(self._orbit(saddle, energy), self.distance)
            kept = [m for (name, _), m in self._manifolds.items() if name == saddle]
            if kept:
                nearest = min(kept, key=lambda m: abs(m.orbit.energy - energy))
                scale = self.system.scale**2
                if float(np.sum(nearest.vector * manifold.vector / scale)) < 0:
                    # A branch is a side of the orbit; the side may not change its name from energy to energy.
                    manifold.__dict__["vector"] = -manifold.vector
            self._manifolds[saddle, energy] = manifold
        return self._manifolds[saddle, energy]

    def manifolds(self, energy: float) -> tuple[UnstableManifold, UnstableManifold]:
        """Return source's and target's manifolds; one object where they are the same."""
        return self.manifold(self.source, energy), self.manifold(self.target, energy)

    def _flown(self, manifold: UnstableManifold, branch: int, phase: float, seconds: float) -> tuple[Array, Array]:
        """Return the seed's state after `seconds` and its derivative by phase."""
        seeds, slopes = manifold.seeds(np.array([phase]), branch)
        state, stm = self.system.propagator.flow_with_stm(seeds[0], seconds)
        return state, stm @ slopes[0]

    def _turned(self, state: Array, saddle: str) -> Array:
        centre = self.system.equilibrium(saddle)
        return self.system.reversers[0] @ (state - centre) + centre

    def match(self, link: Link, energy: float) -> Match:
        """Fly both tubes to the middle of the connection and compare.

        Raises:
            ArithmeticError: an orbit did not converge or a state became infinite.
        """
        system, scale = self.system, self.system.scale
        first, second = self.manifolds(energy)
        half = link.duration / 2
        xu, du = self._flown(first, link.branches[0], link.phases[0], half)
        back, ds = self._flown(second, link.branches[1], link.phases[1], half)
        xs, ds = self._turned(back, self.target), system.reversers[0] @ ds
        gap = (xu - xs - np.asarray(link.turns) * self.lengths) / scale
        along = (system.numeric.rate(xu) + system.numeric.rate(xs)) / 2
        jacobian = np.column_stack([du, -ds, along]) / scale[:, None]
        columns = np.column_stack([jacobian, system.numeric.gradient(xu) * scale])
        tangency = float(np.linalg.det(columns / np.linalg.norm(columns, axis=0)))
        return Match(gap, jacobian, tangency, xu)

    def mirror(self, link: Link, energy: float, which: int) -> MirrorMatch:
        """Fly the unstable tube to the middle of the connection and compare with the fixed set of reverser `which`."""
        system, scale = self.system, self.system.scale
        manifold = self.manifold(self.source, energy)
        x, slope = self._flown(manifold, link.branches[0], link.phases[0], link.duration / 2)
        reverser = system.reversers[which]
        turned_over = (np.eye(4) - reverser) / 2
        off = turned_over @ (x - manifold.orbit.centre)
        half = np.where(np.isfinite(system.periods), system.periods / 2, 1.0)
        off = off - np.where(np.isfinite(system.periods), np.rint(off / half) * half, 0.0)
        rows = np.linalg.svd(turned_over / scale[:, None])[0][:, :2].T
        miss = rows @ (off / scale)
        rate = turned_over @ system.numeric.rate(x)
        d_minus, f_minus = rows @ (turned_over @ slope / scale), rows @ (rate / scale)
        basis = np.linalg.svd((np.eye(4) + reverser) / 2 / scale[:, None])[0][:, :2].T
        d_plus = basis @ (slope / scale)
        normal = basis @ (system.numeric.gradient(x) * scale)
        fold = float(d_minus[0] * f_minus[1] - d_minus[1] * f_minus[0]) / float(np.linalg.norm(f_minus))
        shedding = float(d_plus[0] * normal[1] - d_plus[1] * normal[0]) / float(np.linalg.norm(normal))
        # Not by (a, b) itself, which all but vanishes where both kinds of event fall together.
        size = float(np.linalg.norm(slope / scale))
        return MirrorMatch(miss, np.column_stack([d_minus, f_minus / 2]), fold / size, shedding / size)

    def symmetry(self, link: Link, within: float = 1e-6) -> int | None:
        """Return which reverser carries the link to itself, None if none does."""
        for which in range(len(self.system.reversers)):
            image = self.mirrored(link, which)
            if image is not None and self.distance_between(link, image) < within:
                return which
        return None

    def mirrored(self, link: Link, which: int) -> Link | None:
        """Return the image of a homoclinic link under a reverser; None between different saddles."""
        if self.source != self.target:
            return None
        if which == 0:
            return replace(link, branches=link.branches[::-1], phases=link.phases[::-1])
        half = next(iter(self._manifolds.values())).half_turn
        assert half is not None
        sign = int(half[1])
        branches = (sign * link.branches[1], sign * link.branches[0])
        return replace(link, branches=branches, phases=(link.phases[1] + 0.5, link.phases[0] + 0.5))

    def distance_between(self, first: Link, second: Link) -> float:
        """Return how far apart two links are in phases and relative duration; infinite on different branches."""
        if first.branches != second.branches:
            return float("inf")
        gaps = [abs(phase_gap(a, b)) for a, b in zip(first.phases, second.phases, strict=True)]
        return max(*gaps, abs(first.duration / second.duration - 1))

    def solved(self, link: Link, energy: float, *, iterations: int = 12) -> tuple[Link, Match]:
        """Solve F = 0 for the link nearest to a guess.

        Raises:
            ArithmeticError: Newton's method left the neighbourhood or did not converge.
        """
        best: tuple[float, Link, Match] | None = None
        guess = link.unknowns
        reach = np.array([0.1, 0.1, 0.2 * link.duration])
        for _ in range(iterations):
            match = self.match(link, energy)
            residual = float(np.abs(match.gap).max())
            if best is None or residual < best[0]:
                best = (residual, link, match)
            elif best[0] < 1e-10:
                break
            step = np.linalg.lstsq(match.jacobian, match.gap, rcond=1e-13)[0]
            # Where multipliers are large, rounding keeps the gap from falling, but moves the solution no more.
            if residual < 1e-8 and np.all(np.abs(step) < 1e-7 * reach):
                return link, match
            shrink = min(1.0, 0.3 / float(np.max(np.abs(step) / reach)) if np.any(step) else 1.0)
            link = link.at(link.unknowns - shrink * step)
            if np.any(np.abs(link.unknowns - guess) > reach) or link.duration <= 0:
                break
        assert best is not None
        if best[0] > 1e-9:
            raise ArithmeticError(f"not matched: gap {best[0]:.1e}")
        return best[1], best[2]
