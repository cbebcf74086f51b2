"""The interior of tubes: which motions pass a saddle, and when.

A grid of points (q, p/p₀) inside the unstable cut is converted to states on the section at the tube's energy and
propagated through several returns. States inside the unstable tube have passed the saddle's bottleneck, and those
inside the stable tube will pass it. At each return, forward and backward, a point is labelled by the cut that contains
it, if any, and by the whole turns since the start. The interior of the stable tube follows by time reversal, without
integration.

Each point keeps its angle about the region's innermost point and a radius, 0 at this point and 1 on the cut. They are
the hue and saturation of a colour wheel.

To convert a point (q, p/p₀) to a state, θ(q) and the momentum along the section are given. The velocity across it,
v = v₀ + s w, solves the quadratic

    ½ vᵀ M v = H - V(θ)

for the root with the required direction of crossing.

Source: Koon, Lo, Marsden, Ross, Heteroclinic connections between periodic orbits and resonance transitions in
celestial mechanics (2000), section 4; Kaheman et al. (2023), section 3.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System, momentum_scale
from dpcontrol.foundation.arrays import Array, Flags
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.shown import Brief
from dpcontrol.orbits.cut import Cut, section_points
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.orbits.tube import Tube
from dpcontrol.tubes.intersections import to_segment

Labels = NDArray[np.int8]


@dataclass(frozen=True)
class Outline(Brief):
    """A closed cut in (q, p/p₀).

    Attributes:
        vertices (V, 2): of the polygon.
        branch: of the tube.
        direction: of crossing, +1 or -1.
    """

    vertices: Array
    branch: int
    direction: int
    stable: bool


def outlines_of(cut: Cut, manifold: UnstableManifold) -> tuple[Outline, ...]:
    """Return the closed pieces of a cut and its time-reversed image.

    Args:
        cut: cut of the unstable tube.
        manifold: manifold of the tube.
    """
    found = []
    for stable in (False, True):
        for piece in cut.pieces:
            if not piece.closed:
                continue
            placed = Tube(manifold.orbit, stable).placed(piece, cut.section)
            points = placed.points
            if np.linalg.norm(points[0] - points[-1]) > np.abs(np.diff(points, axis=0)).max() * 4:
                continue  # a curve that winds around the torus has no interior
            found.append(Outline(points, piece.branch, placed.direction, stable))
    return tuple(found)


def inside(points: Array, vertices: Array) -> Flags:
    """Return True (K,) for points inside a polygon.

    Args:
        points: points (K, 2).
        vertices: corners (V, 2) of the polygon, in order.
    """
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
    """Return the branch of the outline that contains each point, or 0.

    Args:
        system: system of the section.
        section: section of the system.
        outlines: closed cuts of both tubes.
        points: section coordinates (K, 2), q and p/p₀.
        direction: directions (K,) of crossing, +1 or -1.
    """
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
    """Return states (K, N) at points (K, 2), and which exist.

    The states lie on the section n·x = level at (q, p/p₀), with the given energy and direction of crossing.

    Args:
        system: system of two degrees of freedom.
        section: section of the system.
        points: points (K, 2), q and p/p₀.
        energy: energy of the states, J.
        direction: sign of n·ẋ.
        level: value of n·x.
    """
    n = system.dimension // 2
    normal, position = np.asarray(section.normal)[:n], np.asarray(section.position)[:n]
    along = np.asarray(section.momentum)
    q = np.linalg.solve(np.array([normal, position]), np.array([np.full(len(points), level), points[:, 0]])).T
    still = np.hstack([q, np.zeros_like(q)])
    mass = system.numeric.mass_matrix(still)
    momentum = points[:, 1] * momentum_scale(system, section)
    # The base has the given momentum along the section, and the direction does not change it.
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
    """Return the period of the section's coordinate q, or None.

    Args:
        system: system of the section.
        section: section of the system.
    """
    period = float(system.periods[int(np.argmax(np.abs(section.position)))])
    return period if np.isfinite(period) else None


def place_on_section(system: System, section: Section, states: Array) -> tuple[Array, Labels]:
    """Return section coordinates (…, 2) and crossing directions (…).

    The coordinates are (q, p/p₀), with q within half a period.

    Args:
        system: system of the states.
        section: section that the states are on.
        states: states (…, N).
    """
    points = section_points(system, section, states)
    period = position_period(system, section)
    if period is not None:
        points[..., 0] -= np.rint(points[..., 0] / period) * period
    direction = np.sign(system.numeric.rate(states) @ np.asarray(section.normal))
    return points, direction.astype(np.int8)


SKIP = 1e-6
"""Propagation time before the search for the next return, s, to exclude the start."""


_AT_ONCE = 200
"""Points propagated to a return together."""


@dataclass(frozen=True)
class InteriorSettings:
    """Grid and returns of a map of a tube's interior.

    Attributes:
        across: grid points over the width and the height of the cut.
        returns: number of returns in each direction of time.
        longest: flight time to each return, in periods.
    """

    across: int = 60
    returns: int = 3
    longest: float = 12.0


@dataclass(frozen=True)
class Returns(Brief):
    """R returns of K points in one direction of time.

    Entries are valid only if `arrived`. Arrays have shape (K, R) unless stated otherwise.

    Attributes:
        states (K, R, N): lifted.
        points (K, R, 2): (q, p/p₀), q within half a period of zero.
        seconds: since the start, positive.
        winding (K, R, n): whole turns since the start.
        direction: sign of the crossing.

    The arrays `in_unstable` and `in_stable` hold the branch of the cut that contains the point, or 0.
    """

    arrived: Flags
    states: Array
    points: Array
    seconds: Array
    winding: NDArray[np.int64]
    direction: Labels
    in_unstable: Labels
    in_stable: Labels


@dataclass(frozen=True)
class TubeInterior(Brief):
    """A grid of K points inside one tube's cut, with its returns.

    Attributes:
        branch: of the unstable tube.
        points (K, 2): (q, p/p₀).
        states (K, N): at the points.
        angle (K,): hue, rad.
        radius (K,): saturation, 0 to 1.
        outlines: closed cuts of both tubes.
    """

    orbit: LyapunovOrbit
    section: Section
    branch: int
    points: Array
    states: Array
    angle: Array
    radius: Array
    forward: Returns
    backward: Returns
    outlines: tuple[Outline, ...]
    status: str


def tube_interior(
    manifold: UnstableManifold,
    cut: Cut,
    *,
    branch: int = 1,
    settings: InteriorSettings | None = None,
) -> TubeInterior:
    """Propagate a grid inside an unstable cut through several returns.

    Args:
        manifold: manifold of the tube.
        cut: cut of the tube.
        branch: +1 or -1.
        settings: grid and number of returns.

    Raises:
        InputError: the branch is not +1 or -1, its cut is not closed, or the system does not have two degrees of
            freedom.
    """
    settings = settings or InteriorSettings()
    orbit, section = manifold.orbit, cut.section
    system = orbit.system
    if branch not in (1, -1):
        raise InputError(f"branch = {branch}: must be +1 or -1")
    if system.dimension != 4:
        raise InputError(
            f"{system.name} has {system.dimension // 2} degrees of freedom: cuts enclose an area only for two"
        )
    outlines = outlines_of(cut, manifold)
    own = [o for o in outlines if o.branch == branch and not o.stable]
    if not own:
        ends = [end.reason for end in cut.open_ends if end.branch == branch]
        reason = ends[0] if ends else cut.status
        raise InputError(
            f"branch {branch:+d} has no closed cut at crossing {cut.hit} of {section.name}, so no interior: {reason}; "
            "use another section, crossing or energy"
        )
    piece = next(p for p in cut.pieces if p.branch == branch and p.closed)
    level = float(piece.states[0] @ np.asarray(section.normal))
    points = _grid(own[0].vertices, settings.across)
    states, fits = section_states(system, section, points, energy=orbit.energy, direction=own[0].direction, level=level)
    points, states = points[fits], states[fits]
    if not len(points):
        raise InputError(f"the cut of branch {branch:+d} is too thin for {settings.across} points across; use more")
    angle, radius = _wheel(points, own[0].vertices)
    runs = [_carried(orbit, section, states, sign, outlines, settings) for sign in (1, -1)]
    back = [int(np.count_nonzero(run.arrived[:, -1])) for run in runs]
    status = f"{len(points)} points; {back[0]} return {settings.returns} times forward, {back[1]} backward"
    return TubeInterior(orbit, section, branch, points, states, angle, radius, runs[0], runs[1], outlines, status)


def _carried(
    orbit: LyapunovOrbit,
    section: Section,
    states: Array,
    sign: int,
    outlines: tuple[Outline, ...],
    settings: InteriorSettings,
) -> Returns:
    """Propagate every state to its returns in one direction of time."""
    system = orbit.system
    shape = (len(states), settings.returns)
    arrived = np.zeros(shape, dtype=bool)
    flown = np.repeat(states[:, None, :], settings.returns, axis=1)
    seconds = np.zeros(shape)
    longest = settings.longest * orbit.period
    here, elapsed, going = states, np.zeros(len(states)), np.arange(len(states))
    for r in range(settings.returns):
        following = []
        for part in np.array_split(going, max(1, len(going) // _AT_ONCE)):
            started = np.array([system.propagator.flow(here[k], sign * SKIP) for k in part]).reshape(
                -1, system.dimension
            )
            crossings = system.propagator.crossings(started, section, longest=sign * longest)
            for k, crossing in zip(part, crossings, strict=True):
                if crossing is None:
                    continue
                elapsed[k] += SKIP + abs(crossing.time)
                arrived[k, r], flown[k, r], seconds[k, r] = True, crossing.state, elapsed[k]
                following.append(k)
        going = np.array(following, dtype=int)
        here = flown[:, r]
    points, direction = place_on_section(system, section, flown)
    n = system.dimension // 2
    winding = system.nearest_turns(flown - states[:, None, :])[..., :n].astype(np.int64)
    found = [
        labels(
            system,
            section,
            tuple(o for o in outlines if o.stable is stable),
            points.reshape(-1, 2),
            direction.ravel(),
        ).reshape(shape)
        for stable in (False, True)
    ]
    return Returns(
        arrived=arrived,
        states=flown,
        points=np.where(arrived[..., None], points, 0.0),
        seconds=seconds,
        winding=np.where(arrived[..., None], winding, 0),
        direction=np.where(arrived, direction, 0).astype(np.int8),
        in_unstable=np.where(arrived, found[0], 0).astype(np.int8),
        in_stable=np.where(arrived, found[1], 0).astype(np.int8),
    )


def _grid(vertices: Array, across: int) -> Array:
    """Return the points (K, 2) of a regular grid inside a polygon."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    axes = [np.linspace(a, b, across + 2)[1:-1] for a, b in zip(low, high, strict=True)]
    mesh = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    return mesh[inside(mesh, vertices)]


def _wheel(points: Array, vertices: Array) -> tuple[Array, Array]:
    """Return angles (rad) and radii (0 to 1) about the innermost point."""
    span = np.ptp(vertices, axis=0)
    x, edge = points / span, np.vstack([vertices, vertices[:1]]) / span
    depth = np.min([to_segment(x, a, b) for a, b in pairwise(edge)], axis=0)
    centre = x[np.argmax(depth)]
    gap = x - centre
    return np.arctan2(gap[:, 1], gap[:, 0]) % (2 * np.pi), 1 - depth / depth.max()
