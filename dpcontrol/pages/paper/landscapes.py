"""Both landscapes of potential energy, with Hill's regions.

The regions are at energies between the critical points.
"""

from functools import partial
from itertools import product

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.orbits.lyapunov import equilibria
from dpcontrol.pages import style
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.layout import Page, Panel
from dpcontrol.pages.panels import name_point, quiet_plane

LANDSCAPES = {"three-body": (-1.523, -1.5195, -1.51, -1.5005), "lab": (-0.3, -0.07, 0.2, 0.55)}
"""Energies, one between the heights of adjacent critical points."""
_GRID = 361
_REACHED, _FORBIDDEN = "#dbe9f6", "#8d959e"


def landscape_page(gallery: Gallery) -> PaperFigure:
    """Draw potential energies and Hill's regions at four energies.

    Both are drawn for three bodies and the pendulum.
    """
    page = Page("Energy landscapes and Hill's regions: higher energies open more saddles")
    words = []
    for name, energies in LANDSCAPES.items():
        system, angular = gallery.system(name), name == "lab"
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
Field = tuple[Array, Array, Array]


def _landscape(axes: Axes, system: System, field: Field) -> None:
    first, second, potential = field
    # The wells of the primaries are bottomless.
    shown = np.maximum(potential, potential.min() if system.si else -1.62)
    heights = axes.contourf(first, second, shown, levels=30, cmap="viridis")
    axes.figure.colorbar(heights, ax=axes)
    title = "double pendulum: energy at rest (J)" if system.si else "three bodies: energy at rest"
    quiet_plane(axes, system, title=title)
    axes.set_aspect("equal")


def _hill(axes: Axes, system: System, field: Field, energy: float, points: Points) -> None:
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
            axes.plot(x, y, mark, clip_on=False, **look)
        if not system.si:
            name_point(axes, name, (float(place[0]), float(place[1])), style.INK)
    quiet_plane(axes, system, title=f"{energy:g}{system.unit('J')}")
    axes.grid(False)
    axes.set_aspect("equal")
