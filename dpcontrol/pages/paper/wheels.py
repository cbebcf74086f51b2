"""Colour wheels of the points inside a tube's cut.

A grid of points (q, p/p₀) inside the cuts of both the unstable and the stable tube is converted to states on the
section at the tube's energy, and followed to several returns in both directions of time. States inside the unstable
tube have passed the saddle's bottleneck, and those inside the stable tube will pass it. The cut of the stable tube
follows by time reversal, without integration.

To convert a point (q, p/p₀) to a state, θ(q) and the momentum along the section are given. The velocity across it,
v = v₀ + s w, solves the quadratic

    ½ vᵀ M v = H - V(θ)

for the root with the required direction of crossing.

Source: Koon, Lo, Marsden, Ross, Heteroclinic connections between periodic orbits and resonance transitions in
celestial mechanics (2000), section 4; Kaheman et al. (2023), section 3.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure
from matplotlib.path import Path
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System, momentum_scale
from dpcontrol.foundation.arrays import Array, Flags
from dpcontrol.orbits.cut import Cut, section_points, tube_cut
from dpcontrol.orbits.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.orbits.rotating import RotatingOrbit, rotating_orbits
from dpcontrol.orbits.tube import Tube
from dpcontrol.pages import style
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.layout import Draw, Page
from dpcontrol.pages.panels import quiet, quiet_plane

WHEEL_ENERGIES = {"down-up": -0.06985, "up-down": 0.2}
_RETURNS = 3
_ACROSS = {"down-up": 110, "up-down": 200}
"""Points across the cut; the part inside both of Up-Down's tubes is small."""
_LONGEST = 12.0
"""Longest flight to a return, in periods of the orbit."""
_SKIP = 1e-6
"""Propagation time before the search for the next return, s, to exclude the start."""
_TURN = 2 * np.pi


@dataclass(frozen=True)
class Outline:
    """A closed cut in (q, p/p₀).

    Attributes:
        vertices: corners (V, 2) of the polygon.
        branch: branch of the tube, +1 or -1.
        direction: direction of crossing, +1 or -1.
        stable: True for the stable tube.
    """

    vertices: Array
    branch: int
    direction: int
    stable: bool

    @property
    def turns(self) -> float:
        """Whole turns of the polygon's middle from zero."""
        return float(np.rint((self.vertices[:, 0].min() + self.vertices[:, 0].max()) / 2 / _TURN))

    def contains(self, points: Array) -> Flags:
        """Return True (K,) for points (K, 2) inside the polygon, up to whole turns of q."""
        q = points[:, 0] - _TURN * np.rint(points[:, 0] / _TURN)
        lifted = [np.column_stack([q + _TURN * (self.turns + turn), points[:, 1]]) for turn in (-1, 0, 1)]
        return np.any([Path(self.vertices).contains_points(part) for part in lifted], axis=0)


@dataclass(frozen=True)
class Return:
    """Points at one return to the section.

    Attributes:
        start: places (M,) of the points among those of the start.
        states: lifted states (M, N).
        seconds: times (M,) since the start.
    """

    start: NDArray[np.intp]
    states: Array
    seconds: Array


def outlines_of(cut: Cut, manifold: UnstableManifold) -> tuple[Outline, ...]:
    """Return the closed pieces of a cut and its time-reversed image.

    Args:
        cut: cut of the unstable tube.
        manifold: manifold of the tube.
    """
    outlines = []
    for stable in (False, True):
        for piece in cut.pieces:
            placed = Tube(manifold.orbit, stable).placed(piece, cut.section)
            points = placed.points
            # A curve that winds around the torus has no interior.
            if piece.closed and np.linalg.norm(points[0] - points[-1]) <= np.abs(np.diff(points, axis=0)).max() * 4:
                outlines.append(Outline(points, piece.branch, placed.direction, stable))
    return tuple(outlines)


def section_states(
    system: System, section: Section, points: Array, *, energy: float, direction: int
) -> tuple[Array, Flags]:
    """Return states (K, N) on a section, with the given energy and direction of crossing, and which exist.

    Args:
        system: system of two degrees of freedom.
        section: section of the system.
        points: points (K, 2), q and p/p₀.
        energy: energy of the states, J.
        direction: sign of n·ẋ.
    """
    n = system.dimension // 2
    normal, position = np.asarray(section.normal)[:n], np.asarray(section.position)[:n]
    along = np.asarray(section.momentum)
    q = np.linalg.solve(np.array([normal, position]), np.array([np.zeros(len(points)), points[:, 0]])).T.astype(float)
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
    root = np.sqrt(np.maximum(discriminant, 0.0))
    states, exists = np.hstack([q, v0]).astype(float), np.zeros(len(points), dtype=bool)
    for sign in (1, -1):
        velocity = v0 + ((-b + sign * root) / (2 * a))[:, None] * w
        right = (discriminant >= 0) & (np.sign(velocity @ normal) == direction)
        states[right, n:] = velocity[right]
        exists |= right
    return states, exists


def returns_of(orbit: LyapunovOrbit, section: Section, states: Array, *, sign: int, count: int) -> list[Return]:
    """Return the first returns of states to a section.

    Args:
        orbit: orbit of the system, whose period limits the flights.
        section: section of the system.
        states: states (K, N) on the section.
        sign: +1 forward, -1 backward in time.
        count: number of returns.
    """
    system, returns = orbit.system, []
    start, seconds = np.arange(len(states)), np.zeros(len(states))
    for _ in range(count):
        begun = np.array([system.propagator.flow(state, sign * _SKIP) for state in states]).reshape(states.shape)
        crossings = system.propagator.crossings(begun, section, longest=sign * _LONGEST * orbit.period)
        arrived = np.array([crossing is not None for crossing in crossings], dtype=bool)
        landed = [crossing for crossing in crossings if crossing is not None]
        start, seconds = start[arrived], seconds[arrived] + _SKIP + [abs(crossing.time) for crossing in landed]
        states = np.array([crossing.state for crossing in landed]).reshape(-1, system.dimension)
        returns.append(Return(start, states, seconds))
    return returns


def points_within(outlines: tuple[Outline, ...], across: int) -> Array:
    """Return the points (K, 2) of a regular grid inside an unstable cut and a stable one of the same direction.

    Args:
        outlines: closed cuts of both tubes.
        across: points over the width and the height of the unstable cut of branch +1.
    """
    unstable, stable = _inner(outlines)
    low, high = unstable.vertices.min(axis=0), unstable.vertices.max(axis=0)
    axes = [np.linspace(a, b, across + 2)[1:-1] for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    return grid[unstable.contains(grid) & np.any([outline.contains(grid) for outline in stable], axis=0)]


def _inner(outlines: tuple[Outline, ...]) -> tuple[Outline, list[Outline]]:
    unstable = next(outline for outline in outlines if outline.branch == 1 and not outline.stable)
    return unstable, [o for o in outlines if o.stable and o.direction == unstable.direction]


def kept_inside(orbit: LyapunovOrbit, section: Section, outlines: tuple[Outline, ...]) -> tuple[RotatingOrbit, ...]:
    """Return the symmetric orbits that stay inside both tubes' cuts.

    They turn the arm that hangs at the saddle, and cross the cuts at every lap.

    Args:
        orbit: orbit of the tubes.
        section: section of the cuts.
        outlines: closed cuts of both tubes.
    """
    arm, (unstable, stable) = _turning(orbit), _inner(outlines)
    kept = []
    for candidate in rotating_orbits(orbit.system, arm, orbit.energy, sense=unstable.direction):
        states = candidate.sample(400)
        point = section_points(orbit.system, section, candidate.state)[None]
        # An orbit that turns back crosses more than once.
        onward = np.all(np.diff(states[:, arm - 1]) * unstable.direction > 0)
        if onward and unstable.contains(point)[0] and any(outline.contains(point)[0] for outline in stable):
            kept.append(candidate)
    return tuple(kept)


def _turning(orbit: LyapunovOrbit) -> int:
    return 2 if orbit.saddle == "down-up" else 1


def wheels_page(gallery: Gallery, *, saddle: str) -> PaperFigure:
    """Draw the returns of the inside of a saddle's tubes, three each way, with the periodic orbits inside.

    Args:
        gallery: data sources.
        saddle: "down-up" or "up-down".
    """
    system, energy = gallery.system("lab"), WHEEL_ENERGIES[saddle]
    orbit, section = lyapunov_orbit(system, saddle, energy=energy), system.sections[saddle, saddle]
    manifold = UnstableManifold(orbit)
    outlines = outlines_of(tube_cut(manifold, section), manifold)
    gallery.progress("returns", 0.2)
    direction = _inner(outlines)[0].direction
    points = points_within(outlines, _ACROSS[saddle])
    states, exists = section_states(system, section, points, energy=energy, direction=direction)
    points, states = points[exists], states[exists]
    runs = {sign: returns_of(orbit, section, states, sign=sign, count=_RETURNS) for sign in (1, -1)}
    stays = kept_inside(orbit, section, outlines)
    number, turning = style.number(_turning(orbit) - 1), "outer" if _turning(orbit) == 2 else "inner"
    periods = ", ".join(f"{kept.period:.4f} s ({kept.kind})" for kept in stays)
    marked = (
        f"Stars mark the crossings of the symmetric periodic {'orbit' if len(stays) == 1 else 'orbits'} of period "
        f"{periods}. The {turning} arm turns inside both tubes for ever. Right: the same in the phase "
        "planes of both arms"
        if stays
        else "No symmetric periodic orbit was found inside both tubes"
    )
    return PaperFigure(
        _drawn(orbit, section, outlines, points, runs, stays),
        f"The grid covers the inside of both the unstable and the stable tube of {saddle} at {energy:g} J. It is "
        "coloured like a wheel at the unstable tube's first cut, and followed to each "
        f"return forward (above: θ{number} = 4π, 6π, 8π) and backward (below) in time. Points that land inside a cut "
        f"will pass, or have passed, the saddle's neck again. Of {len(points)} points, {len(runs[1][-1].start)} return "
        f"{_RETURNS} times forward and {len(runs[-1][-1].start)} backward. {marked}.",
        "Coordinates are canonical, so coloured areas keep their size from return to return, and returns are "
        f"drawn in both directions of time. {IDENTIFIED}",
    )


def _colours(points: Array) -> Array:
    """Return colours (K, 3): hue by the angle about the middle, saturation by the distance from it."""
    off = (points - points.mean(axis=0)) / np.ptp(points, axis=0)
    radius = np.linalg.norm(off, axis=1)
    hue = np.arctan2(off[:, 1], off[:, 0]) % _TURN / _TURN
    return hsv_to_rgb(np.column_stack([hue, 0.12 + 0.88 * radius / radius.max(), np.full(len(hue), 0.93)]))


def _drawn(
    orbit: LyapunovOrbit,
    section: Section,
    outlines: tuple[Outline, ...],
    points: Array,
    runs: dict[int, list[Return]],
    stays: tuple[RotatingOrbit, ...],
) -> Figure:
    """Return a figure of the start and its returns: forward above, backward below."""
    system, colours, direction = orbit.system, _colours(points), _inner(outlines)[0].direction
    marks = np.array([section_points(system, section, kept.state) for kept in stays]).reshape(-1, 2)
    panel = partial(_cut, outlines=outlines, marks=marks)
    start = partial(panel, points=points, colours=colours, title=f"start: {len(points)} points")
    page = Page(f"Inside both tubes of {orbit.saddle} at {orbit.energy:g} J (branch +1), cut on {section.name}").text(
        "Hue: angle about the middle at the start; saturation: distance from it. Pale dots cross the section against "
        "the start's direction. Dark red: cut of the unstable tube. Green: of the stable tube. Pale: cuts crossed "
        "against the start's direction." + (" Star: periodic orbit." if stays else ""),
        size=style.TEXT,
    )
    for sign, word in ((1, "forward"), (-1, "backward")):
        row: list[Draw] = [start]
        for k, back in enumerate(runs[sign]):
            landed = section_points(system, section, back.states)
            ways = np.sign(system.numeric.rate(back.states) @ np.asarray(section.normal))
            shades = np.column_stack([colours[back.start], np.where(ways == direction, 1.0, 0.3)])
            title = f"return {k + 1} {word}: {_share_inside(landed, ways, outlines):.0%} in unstable cuts"
            row.append(partial(panel, points=landed, colours=shades, title=title))
        if stays:
            row.append(partial(_phase_plane, arm=0 if sign > 0 else 1, stays=stays))
        page.row(*row, height=3.2)
    figure = page.figure()
    cuts = [axes for axes in figure.axes if axes.get_label() == "cut"]
    wide, high = 1.08 * np.max([np.abs(axes.dataLim.get_points()) for axes in cuts], axis=(0, 1))
    for axes in cuts:
        axes.set(xlim=(-min(np.pi, wide), min(np.pi, wide)), ylim=(-high, high))
    return figure


def _share_inside(points: Array, ways: Array, outlines: tuple[Outline, ...]) -> float:
    """Return the share of points inside an unstable cut that is crossed in their direction."""
    unstable = [outline for outline in outlines if not outline.stable]
    return float(np.any([o.contains(points) & (ways == o.direction) for o in unstable], axis=0).mean())


def _cut(axes: Axes, *, points: Array, colours: Array, outlines: tuple[Outline, ...], marks: Array, title: str) -> None:
    """Draw points (K, 2) on the section in their colours, over the tubes' cuts; stars mark periodic orbits."""
    axes.set_label("cut")
    quiet(axes, title, x="q (rad)", y="p / p₀")
    axes.grid(False)
    for outline in outlines:
        closed = np.vstack([outline.vertices, outline.vertices[:1]]) - (_TURN * outline.turns, 0.0)
        colour = style.STABLE if outline.stable else style.UNSTABLE
        opacity = 1.0 if outline.direction == _inner(outlines)[0].direction else 0.25
        axes.plot(*closed.T, color=colour, lw=1.1, alpha=opacity, zorder=3)
    axes.scatter(*_near_zero(points).T, s=3.0, c=colours, linewidths=0)
    axes.plot(*_near_zero(marks).T, "*", color=style.INK, markersize=9, markeredgecolor="white", zorder=6)


def _near_zero(points: Array) -> Array:
    """Return points (K, 2) with q within half a turn of zero."""
    return points - np.outer(_TURN * np.rint(points[:, 0] / _TURN), [1.0, 0.0])


def _phase_plane(axes: Axes, *, arm: int, stays: tuple[RotatingOrbit, ...]) -> None:
    """Draw orbits in the phase plane of an arm."""
    for kept in stays:
        states = kept.sample(400)
        axes.plot(states[:, arm], states[:, 2 + arm], color=style.arm_colour(arm), linewidth=1.5)
    title = f"periodic orbit, {stays[0].period:.3f} s" if len(stays) == 1 else "periodic orbits"
    quiet_plane(axes, stays[0].system, (arm, 2 + arm), "" if arm else title)
