"""Closed cuts as outlines of regions of a section: which points lie inside, and the states that points stand for.

A point (q, p/p₀) becomes a state on the section: with θ(q) and the momentum along the section given, the velocity
across it, v = v₀ + s w, solves the energy's quadratic

    ½ vᵀ M v = H - V(θ),      the root with the asked direction of crossing.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System, momentum_scale
from dpcontrol.tubes.cut import Cut, section_points
from dpcontrol.tubes.intersections import TubeSide
from dpcontrol.tubes.manifold import UnstableManifold

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Labels = NDArray[np.int8]


@dataclass(frozen=True)
class Outline:
    """A closed cut in (q, p/p₀): vertices (V, 2); branch of its tube; direction of crossing, +1 or -1."""

    vertices: Array
    branch: int
    direction: int
    stable: bool


def outlines_of(cut: Cut, manifold: UnstableManifold) -> tuple[Outline, ...]:
    """Return the closed pieces of a tube's cut and of the stable tube's, which is the cut turned around in time."""
    system, section = manifold.orbit.system, cut.section
    found = []
    for stable in (False, True):
        for piece in cut.pieces:
            if not piece.closed:
                continue
            states = TubeSide(manifold, section, stable, cut.hit, piece.branch, 0.0).turned(piece.states)
            points = section_points(system, section, states)
            rate = float(system.numeric.rate(states[0]) @ np.asarray(section.normal))
            if np.linalg.norm(points[0] - points[-1]) > np.abs(np.diff(points, axis=0)).max() * 4:
                continue  # winds around the torus: it has no inside
            found.append(Outline(points, piece.branch, int(np.sign(rate)), stable))
    return tuple(found)


def inside(points: Array, vertices: Array) -> Flags:
    """Tell which points (K, 2) lie inside a closed polygon (V, 2), by counting the edges that a ray crosses."""
    result = np.zeros(len(points), dtype=bool)
    x, y = points[:, 0], points[:, 1]
    for (x0, y0), (x1, y1) in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        if y0 == y1:
            continue
        spans = (y0 > y) != (y1 > y)
        result ^= spans & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return result


def labels(
    system: System, section: Section, outlines: tuple[Outline, ...], points: Array, direction: NDArray[Any]
) -> Labels:
    """Return the branch of the outline that each point (K, 2), crossing in `direction` (K,), lies in, or 0."""
    found = np.zeros(len(points), dtype=np.int8)
    period = position_period(system, section)
    for outline in outlines:
        q = points[:, 0]
        if period is not None:
            middle = (outline.vertices[:, 0].min() + outline.vertices[:, 0].max()) / 2
            q = q - np.rint((q - middle) / period) * period
        hit = inside(np.column_stack([q, points[:, 1]]), outline.vertices) & (direction == outline.direction)
        found[hit] = outline.branch
    return found


def section_states(
    system: System, section: Section, points: Array, *, energy: float, direction: int, level: float
) -> tuple[Array, Flags]:
    """Return states (K, N) at (q, p/p₀) (K, 2) on n·x = level with an energy and a direction, and which exist."""
    n = system.dimension // 2
    normal, position = np.asarray(section.normal)[:n], np.asarray(section.position)[:n]
    along = np.asarray(section.momentum)
    q = np.linalg.solve(np.array([normal, position]), np.array([np.full(len(points), level), points[:, 0]])).T
    still = np.hstack([q, np.zeros_like(q)])
    mass = system.numeric.mass_matrix(still)
    momentum = points[:, 1] * momentum_scale(system, section)
    # Any momentum with the given part along the section, and the direction that leaves that part alone.
    base = np.outer(momentum / (along @ along), along) - system.numeric.momentum(still)
    across = np.broadcast_to(np.array([-along[1], along[0]]), base.shape)
    v0, w = (np.linalg.solve(mass, part[..., None])[..., 0] for part in (base, across))
    a = np.einsum("ki,kij,kj->k", w, mass, w) / 2
    b = np.einsum("ki,kij,kj->k", v0, mass, w)
    c = np.einsum("ki,kij,kj->k", v0, mass, v0) / 2 + system.numeric.hamiltonian(still) - energy
    discriminant = b * b - 4 * a * c
    exists = discriminant >= 0
    root = np.sqrt(np.where(exists, discriminant, 0.0))
    chosen: Array = np.asarray(np.hstack([q, v0]), dtype=float)
    fits = np.zeros(len(points), dtype=bool)
    for sign in (1, -1):
        velocity = v0 + ((-b + sign * root) / (2 * a))[:, None] * w
        right = exists & (np.sign(velocity @ normal) == direction)
        chosen[right, n:] = velocity[right]
        fits |= right
    return chosen, fits


def position_period(system: System, section: Section) -> float | None:
    """Return the period of the section's coordinate q, or None on a line."""
    period = float(system.periods[int(np.argmax(np.abs(section.position)))])
    return period if np.isfinite(period) else None


def place_on_section(system: System, section: Section, states: Array) -> tuple[Array, Labels]:
    """Return (q, p/p₀) with q within half a period of zero, and the direction of crossing, of states (…, N)."""
    points = section_points(system, section, states)
    period = position_period(system, section)
    if period is not None:
        points[..., 0] -= np.rint(points[..., 0] / period) * period
    direction = np.sign(system.numeric.rate(states) @ np.asarray(section.normal))
    return points, direction.astype(np.int8)
