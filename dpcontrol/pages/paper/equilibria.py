"""Equilibria: the landscapes of energy between them, the orbits about the saddles, and the manifolds of Up-Up."""

from collections.abc import Sequence
from functools import partial
from itertools import product

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.progress import Progress
from dpcontrol.orbits.cut import section_points
from dpcontrol.orbits.lyapunov import LyapunovOrbit, equilibria, lyapunov_orbit
from dpcontrol.pages import style
from dpcontrol.pages.figures import IDENTIFIED, PaperFigure, model_named
from dpcontrol.pages.layout import Page, Panel, key
from dpcontrol.pages.panels import angle_axis, name_curves, name_point, quiet_plane

LANDSCAPES = {"three-body": (-1.523, -1.5195, -1.51, -1.5005), "lab": (-0.3, -0.07, 0.2, 0.55)}
"""Energies, one between the heights of adjacent critical points."""
_GRID = 361
_REACHED, _FORBIDDEN = "#dbe9f6", "#8d959e"


def landscape_page(_: Progress) -> PaperFigure:
    """Draw potential energies and Hill's regions at four energies, of three bodies and of the pendulum.

    Hill's region of an energy has the positions whose energy at rest is not larger; a motion of the energy stays in it.
    """
    page = Page("Energy landscapes and Hill's regions: higher energies open more saddles")
    words = []
    for name, energies in LANDSCAPES.items():
        system, angular = model_named(name).system, name == "lab"
        side = np.linspace(-np.pi, np.pi, _GRID) if angular else np.linspace(-1.45, 1.45, _GRID)
        first, second = np.meshgrid(side, side)
        still = np.stack([first, second, 0 * first, 0 * first], axis=-1)
        # At rest, in the rotating frame for three bodies, the energy is the potential.
        with np.errstate(divide="ignore"):
            potential = system.numeric.hamiltonian(still.reshape(-1, 4)).reshape(first.shape)
        points = {n: (p.state[:2], p.energy, p.kind) for n, p in equilibria(system).items()}
        if not angular:
            top = np.array([0.5 - float(system.parameters[0]), np.sqrt(3) / 2])
            height = float(system.numeric.hamiltonian(np.array([*top, 0.0, 0.0])))
            points |= {n: (top * (1, sign), height, "maximum") for n, sign in (("L4", 1), ("L5", -1))}
        field = first, second, potential
        regions = [partial(_hill, system=system, field=field, energy=energy, points=points) for energy in energies]
        page.row(Panel(partial(_landscape, system=system, field=field), 1.35), *regions, height=3.0)
        listed = ", ".join(f"{n} {p[1]:+.4f}{system.unit('J')}" for n, p in points.items())
        words.append(f"{'Pendulum' if angular else 'Three bodies'}: {listed}.")
    page.text(
        "Left: energy at rest. Right: accessible (blue) at an energy, or not (grey). Marks: reached (green), or not."
    )
    return PaperFigure(
        page.figure(),
        "Above the restricted three-body problem in its rotating frame, below the lab pendulum. Left: the energy at "
        "rest, over the plane and over the torus of the two angles (from hanging). Right: Hill's regions, one energy "
        "between adjacent critical points; blue regions are accessible, grey ones are not. Squares: the saddles whose "
        "necks connect regions, L1 and L2, and their counterparts Down-Up and Up-Down. Circle: the stable equilibrium; "
        f"triangles: maxima. Green: reached; red: not. {' '.join(words)}",
        f"Each energy lies between two adjacent equilibria. {IDENTIFIED}",
    )


Points = dict[str, tuple[Array, float, str]]
"""Place (2,), energy and kind of each equilibrium, by name."""
Field = tuple[Array, Array, Array]
"""Both coordinates and the energy at rest, each on the same grid."""


def _landscape(axes: Axes, system: System, field: Field) -> None:
    """Draw the potential energy over the plane of two coordinates, with a bar of its scale.

    Systems in SI units are pendulums, other ones are three bodies.
    """
    first, second, potential = field
    # The wells of the primaries are bottomless, so the scale is cut below the saddles' energies.
    shown = np.maximum(potential, potential.min() if system.si else -1.62)
    heights = axes.contourf(first, second, shown, levels=30, cmap="viridis")
    axes.figure.colorbar(heights, ax=axes)
    title = "double pendulum: energy at rest (J)" if system.si else "three bodies: energy at rest"
    quiet_plane(axes, system, title=title)
    axes.set_aspect("equal")


def _hill(axes: Axes, system: System, field: Field, energy: float, points: Points) -> None:
    """Draw Hill's region of an energy, where the energy at rest is lower, and mark the equilibria that it reaches.

    Squares are saddles of index 1, the circle is the stable equilibrium, and triangles are the others.
    """
    # At collisions of two bodies the energy has no lower bound.
    potential = np.maximum(field[2], -10.0)
    levels = [potential.min() - 1, energy, potential.max() + 1]
    axes.contourf(*field[:2], potential, levels=levels, colors=[_REACHED, _FORBIDDEN])
    axes.contour(*field[:2], potential, levels=[energy], colors=[style.INK], linewidths=1.0, linestyles="solid")
    for name, (place, height, kind) in points.items():
        mark = "o" if kind == "centre" else ("s" if kind.startswith("index-1") else "^")
        # An angle of half a turn is at both edges.
        edges = [{-np.pi, np.pi} if system.si and q else {q} for q in place]
        look = {"color": style.GOOD if height <= energy else style.LIMIT, "markersize": 6 if system.si else 4.5}
        for x, y in product(*edges):
            axes.plot(x, y, mark, **look)
        if not system.si:
            name_point(axes, name, (float(place[0]), float(place[1])), style.INK)
    quiet_plane(axes, system, title=f"{energy:g}{system.unit('J')}")
    axes.grid(False)
    # Marks on the edge of the plane stay clear of the numbers on the axes.
    reach = 1.12 * field[0].max()
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")


_SIZES = (0.002, 0.02, 0.06, 0.12, 0.2)
"""Energies of the drawn Lyapunov orbits above the saddle, J."""


def lyapunov_orbits_page(_: Progress) -> PaperFigure:
    """Draw Lyapunov orbits of the lab pendulum in the phase plane of either arm, a row for each of two saddles."""
    system = model_named("lab").system
    page = Page("Lyapunov orbits of the lab pendulum, in the phase plane of either arm")
    for saddle in ("down-up", "up-down"):
        birth = float(system.numeric.hamiltonian(system.equilibria[saddle]))
        orbits = [lyapunov_orbit(system, saddle, energy=birth + above) for above in _SIZES]
        page.row(*(partial(_orbits, orbits=orbits, arm=arm) for arm in (0, 1)), height=3.4)
    return PaperFigure(
        page.figure(),
        f"Lyapunov orbits about Down-Up (above) and Up-Down (below), {', '.join(f'{a:g}' for a in _SIZES)} J above "
        "their saddle (cross): left the inner arm's angle and rate, right the outer arm's. The hanging arm swings "
        "widely while the upright one balances.",
        f"The paper gives no energies for its curves, so these are chosen. {IDENTIFIED}",
    )


def _orbits(axes: Axes, orbits: Sequence[LyapunovOrbit], arm: int) -> None:
    """Draw orbits about a saddle in the phase plane of an arm, 0 or 1, whose angle and rate are columns of the states.

    In the plane of arm 0, the inner one, the orbits are labelled with their energies.
    """
    saddle, system = orbits[0].saddle, orbits[0].system
    for orbit, colour in zip(orbits, style.SERIES, strict=False):
        axes.plot(*orbit.sample(400)[:, [arm, 2 + arm]].T, color=colour, linewidth=1.4)
    axes.plot(system.equilibria[saddle][arm], 0, "+", color=style.LIMIT, markersize=9)
    quiet_plane(axes, system, (arm, 2 + arm), "" if arm else f"about {saddle}")
    if arm == 0:
        named = zip(orbits, style.SERIES, strict=False)
        name_curves(axes, [(orbit.energy, f"{orbit.energy:.3g} J", colour) for orbit, colour in named])


_SEEDS, _OFF = 6000, 1e-5
_FALL = 60.0
"""Longest duration of a fall, in e-folding times of the slow direction."""


def up_up_states(system: System) -> Array:
    """Return the states (K, N) of the first crossings of θ₂ = 2πk on Up-Up's unstable manifold.

    Trajectories start close to Up-Up in all directions of its unstable plane, which the eigenvectors of the two
    growing directions span. Those that do not cross the section in time are left out.
    """
    top = system.equilibria["up-up"]
    values, vectors = np.linalg.eig(system.numeric.jacobian(top))
    # The two growing directions, the slow one first.
    rising = np.argsort(np.real(values))[-2:]
    plane = np.real(vectors[:, rising]) / np.linalg.norm(np.real(vectors[:, rising]), axis=0)
    # The slow direction grows less until the fast one has left; a logarithmic scale covers all ratios of both.
    ratio = np.logspace(-6, 6, _SEEDS // 4)
    fast, slow = ratio / np.hypot(1, ratio), 1 / np.hypot(1, ratio)
    seeds = np.concatenate([np.column_stack([a * slow, b * fast]) for a in (1, -1) for b in (1, -1)])
    section = system.sections["down-up", "down-up"]
    met, times = system.propagator.crossings(
        top + _OFF * seeds @ plane.T, section, longest=_FALL / float(np.sort(np.real(values))[-2])
    )
    return met[np.isfinite(times)]


def up_up_page(_: Progress) -> PaperFigure:
    """Draw the points where Up-Up's stable and unstable manifolds cross θ₂ = 2πk."""
    system = model_named("lab").system
    states, section = up_up_states(system), system.sections["down-up", "down-up"]
    points = section_points(system, section, states)
    sense = np.sign(system.numeric.rate(states) @ np.asarray(section.normal))
    energy = float(system.numeric.hamiltonian(system.equilibria["up-up"]))
    panels = (partial(_manifolds, points=points, sense=sense, way=way) for way in (1, -1))
    return PaperFigure(
        Page(f"The manifolds of Up-Up at its energy of {energy:.4f} J on the section θ₂ = 2πk")
        .row(*panels, height=5.0)
        .figure(),
        f"Up-Up has two unstable directions, so at its energy of {energy:.4f} J its unstable manifold is a surface "
        f"that starts at a point, and no tube. {len(points):,} trajectories that leave it in all directions of the "
        "unstable plane are drawn as points (red) at their first crossing of the section with the outer arm hanging. "
        "Green: the stable manifold, which is the image under time reversal. At points of both colours a trajectory "
        "falls from Up-Up and climbs back to it.",
        "The paper leaves these manifolds out. Around Up-Up no closed curve of orbits separates the motions, so "
        "there are no cuts to intersect; connections of Up-Up exist, but are not searched or offered as symbols. The "
        "triple pendulum has no such picture either: in its six-dimensional phase space tubes do not meet generically.",
    )


def _manifolds(axes: Axes, points: Array, sense: Array, way: int) -> None:
    """Draw points where both manifolds of Up-Up cross the section in the direction `way`, 1 rising and -1 falling.

    `points` (K, 2) are θ₁, rad, and momentum over its scale p₀ where the unstable manifold crosses, and `sense` (K,)
    are the directions of these crossings.
    """
    q = (points[:, 0] + np.pi) % (2 * np.pi) - np.pi
    # Time reversal changes the sign of momenta and of the crossing.
    for sign, colour in ((1, style.UNSTABLE), (-1, style.STABLE)):
        in_direction = sense * sign == way
        axes.scatter(q[in_direction], sign * points[in_direction, 1], s=2.0, color=colour, linewidths=0)
    axes.set(title=f"θ₂ {'rises' if way > 0 else 'falls'}", xlabel="θ₁ on the section (rad)", ylabel="p / p₀")
    key(axes, [("unstable manifold", style.UNSTABLE), ("stable manifold", style.STABLE)])
    angle_axis(axes, "x")
