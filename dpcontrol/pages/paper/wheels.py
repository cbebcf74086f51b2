"""Colour wheels of the points inside a tube's cut.

They show the images of each point at every return to the section.
"""

from dataclasses import fields, replace

import numpy as np

from dpcontrol.orbits.cut import section_points, tube_cut
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.orbits.rotating import RotatingOrbit, rotating_orbits
from dpcontrol.pages import style
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.interior import draw_interior
from dpcontrol.tubes.interior import InteriorSettings, Returns, TubeInterior, inside, tube_interior

WHEEL_ENERGIES = {"down-up": -0.06985, "up-down": 0.2}
_RETURNS = 3
_ACROSS = {"down-up": 110, "up-down": 200}
"""Points across the cut; the part inside both of Up-Down's tubes is small."""


def within_both(interior: TubeInterior) -> TubeInterior:
    """Return the points also inside a stable cut, coloured again.

    The cut has the same direction; colours are about the points' middle.
    """
    own = next(o for o in interior.outlines if o.branch == interior.branch and not o.stable)
    stable = [o for o in interior.outlines if o.stable and o.direction == own.direction]
    kept = np.zeros(len(interior.points), dtype=bool)
    for outline in stable:
        for turn in (-1, 0, 1):
            kept |= inside(interior.points + np.array([2 * np.pi * turn, 0.0]), outline.vertices)
    middle = interior.points[kept].mean(axis=0)
    off = (interior.points[kept] - middle) / np.ptp(interior.points[kept], axis=0)
    forward, backward = (
        Returns(**{f.name: getattr(run, f.name)[kept] for f in fields(run)})
        for run in (interior.forward, interior.backward)
    )
    back = [int(np.count_nonzero(run.arrived[:, -1])) for run in (forward, backward)]
    return replace(
        interior,
        points=interior.points[kept],
        states=interior.states[kept],
        angle=np.arctan2(off[:, 1], off[:, 0]) % (2 * np.pi),
        radius=np.linalg.norm(off, axis=1) / np.linalg.norm(off, axis=1).max(),
        forward=forward,
        backward=backward,
        status=f"{int(kept.sum())} points; {back[0]} return {_RETURNS} times forward, {back[1]} backward",
    )


def kept_inside(interior: TubeInterior, arm: int) -> tuple[RotatingOrbit, ...]:
    """Return the symmetric orbits that stay inside both tubes' cuts.

    They turn `arm` and cross the cuts at every lap.

    Args:
        interior: points inside the tube.
        arm: number of the arm, from 1.
    """
    orbit, section = interior.orbit, interior.section
    own = next(o for o in interior.outlines if o.branch == interior.branch and not o.stable)
    stable = [o for o in interior.outlines if o.stable and o.direction == own.direction]
    kept = []
    for one in rotating_orbits(orbit.system, arm, orbit.energy, sense=own.direction):
        states = orbit.system.propagator.sample(one.state, np.linspace(0.0, one.period, 400))
        if np.any(np.diff(states[:, arm - 1]) * own.direction <= 0):
            continue  # it turns back and crosses more than once
        point = section_points(orbit.system, section, one.state)[None]
        # The section's angle is drawn within half a turn of zero, like the outlines.
        lifts = [point + np.array([[2 * np.pi * k, 0.0]]) for k in (-2, -1, 0, 1, 2)]
        if all(any(inside(p, o.vertices)[0] for o in some for p in lifts) for some in ([own], stable)):
            kept.append(one)
    return tuple(kept)


def wheels_page(gallery: Gallery, *, saddle: str) -> PaperFigure:
    """Draw the returns of the inside of a saddle's unstable tube.

    There are three each way. Periodic orbits inside are marked.

    Args:
        gallery: data sources.
        saddle: "down-up" or "up-down".
    """
    system, energy = gallery.system("lab"), WHEEL_ENERGIES[saddle]
    orbit = lyapunov_orbit(system, saddle, energy=energy)
    manifold = UnstableManifold(orbit)
    cut = tube_cut(manifold, system.sections[saddle, saddle])
    gallery.progress("returns", 0.2)
    interior = within_both(
        tube_interior(manifold, cut, settings=InteriorSettings(across=_ACROSS[saddle], returns=_RETURNS))
    )
    arm = 2 if saddle == "down-up" else 1
    stays = kept_inside(interior, arm)
    number, turning = style.number(arm - 1), "outer" if arm == 2 else "inner"
    periods = ", ".join(f"{one.period:.4f} s ({one.kind})" for one in stays)
    found = (
        f"Stars mark the crossings of the symmetric periodic {'orbit' if len(stays) == 1 else 'orbits'} of period "
        f"{periods}. The {turning} arm turns inside both tubes for ever. Right: the same in the phase "
        "planes of both arms"
        if stays
        else "No symmetric periodic orbit was found inside both tubes"
    )
    return PaperFigure(
        draw_interior(interior, stays),
        f"The grid covers the inside of both the unstable and the stable tube of {saddle} at {energy:g} J. It is "
        "coloured like a wheel at the unstable tube's first cut, and followed to each "
        f"return forward (above: θ{number} = 4π, 6π, 8π) and backward (below) in time. Points that land inside a cut "
        "will pass, or have passed, the saddle's neck again. "
        f"{interior.status}. {found}.",
        "Coordinates are canonical, so coloured areas keep their size from return to return, and returns are "
        f"drawn in both directions of time. {IDENTIFIED}",
    )
