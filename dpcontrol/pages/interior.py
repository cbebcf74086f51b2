"""The inside of a tube's cut, and its returns.

The images of its points are drawn at every return to the section.
"""

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure

from dpcontrol.orbits.cut import section_points
from dpcontrol.orbits.rotating import RotatingOrbit
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, Panel
from dpcontrol.pages.panels import angle_axis, quiet
from dpcontrol.tubes.interior import Outline, Returns, TubeInterior


def draw_interior(interior: TubeInterior, periodic: tuple[RotatingOrbit, ...] = ()) -> Figure:
    """Return a figure of the start and its returns.

    Start and forward returns are above, backward returns below.

    Args:
        interior: points inside the tube, with their returns.
        periodic: orbits to mark at their crossings and to draw at the right in the arms' phase planes.
    """
    returns, orbit = interior.forward.arrived.shape[1], interior.orbit
    both = (interior.forward, interior.backward)
    arrived = np.concatenate([r.points[r.arrived] for r in both] + [o.vertices for o in interior.outlines])
    wide, high = 1.08 * np.abs(arrived).max(axis=0)
    box = min(np.pi, float(wide)), float(high)
    page = Page(
        f"Inside {'both tubes' if periodic else 'the unstable tube'} of {orbit.saddle} at {orbit.energy:g} J "
        f"(branch {interior.branch:+d}), cut on {interior.section.name}"
    )
    page.text(
        "Hue: angle about the innermost point at the start; saturation: closeness to the cut. Pale dots cross the "
        "section against the start's direction. Dark red: cut of the unstable tube. Green: of the stable tube. Pale: "
        "cuts crossed against the start's direction." + (" Star: periodic orbit." if periodic else ""),
        size=style.TEXT,
    )
    for row, (word, run) in enumerate((("forward", interior.forward), ("backward", interior.backward))):
        panels: list[Panel] = [
            Panel(partial(_returns, interior=interior, run=run, k=k, word=word, box=box, periodic=periodic))
            for k in range(returns + 1)
        ]
        if periodic:
            panels.append(Panel(partial(_periodic, arm=row, periodic=periodic)))
        page.row(*panels, height=3.2)
    return page.figure()


def _returns(
    axes: Axes,
    interior: TubeInterior,
    run: Returns,
    k: int,
    *,
    word: str,
    box: tuple[float, float],
    periodic: tuple[RotatingOrbit, ...],
) -> None:
    """Draw the points at the start or at a return.

    The start has k = 0, the k-th return k.
    """
    saturation = 0.12 + 0.88 * np.clip(interior.radius, 0, 1)
    hue = interior.angle / (2 * np.pi)
    colours = hsv_to_rgb(np.column_stack([hue, saturation, np.full(len(hue), 0.93)]))
    direction = next(o.direction for o in interior.outlines if o.branch == interior.branch and not o.stable)
    size = _marker(interior)
    title = _returned(run, k, word) if k else f"start: {len(hue)} points"
    quiet(axes, title, x="q (rad)" if word == "backward" else "", y="" if k else "p / p₀")
    axes.grid(False)
    _outlines(axes, interior.outlines, direction)
    if k == 0:
        q = (interior.points[:, 0] + np.pi) % (2 * np.pi) - np.pi
        axes.scatter(q, interior.points[:, 1], s=size, c=colours, marker="s", linewidths=0)
    for way, opacity in ((-direction, 0.3), (direction, 1.0)) if k else ():
        here = run.arrived[:, k - 1] & (run.direction[:, k - 1] == way)
        points = run.points[here, k - 1]
        axes.scatter(*points.T, s=0.5 * size, c=colours[here], alpha=opacity, linewidths=0)
    for one in periodic:
        q, p = section_points(interior.orbit.system, interior.section, one.state)
        axes.plot((q + np.pi) % (2 * np.pi) - np.pi, p, "*", color=style.INK, markersize=9, mec="white", zorder=6)
    axes.set(xlim=(-box[0], box[0]), ylim=(-box[1], box[1]))


def _marker(interior: TubeInterior) -> float:
    """Return the area of the markers, points².

    Neighbours of the start's grid overlap with this area.
    """
    spans = np.ptp(interior.points, axis=0)
    across = max(len(np.unique(np.round(interior.points[:, k], 9))) for k in (0, 1))
    # A cut spans about half of an axis that is 230 points long either way.
    share = float(np.clip(max(spans / (2 * np.abs(interior.points).max(axis=0))), 0.3, 1.0))
    return float(np.clip((1.05 * 230 * share / across) ** 2, 2.5, 60.0))


def _outlines(axes: Axes, outlines: tuple[Outline, ...], direction: int) -> None:
    for outline in outlines:
        closed = np.vstack([outline.vertices, outline.vertices[:1]])
        turns = np.rint((closed[:, 0].min() + closed[:, 0].max()) / 2 / (2 * np.pi))
        colour = style.STABLE if outline.stable else style.UNSTABLE
        opacity = 1.0 if outline.direction == direction else 0.25
        axes.plot(closed[:, 0] - 2 * np.pi * turns, closed[:, 1], color=colour, lw=1.1, alpha=opacity, zorder=3)


def _returned(run: Returns, k: int, word: str) -> str:
    arrived = run.arrived[:, k - 1]
    count = max(1, int(arrived.sum()))
    stable = np.count_nonzero(run.in_stable[arrived, k - 1]) / count
    unstable = np.count_nonzero(run.in_unstable[arrived, k - 1]) / count
    missing = np.count_nonzero(~arrived)
    text = f"return {k} {word}: {unstable:.0%} in unstable, {stable:.0%} in stable cuts"
    return text + (f", {missing} do not return" if missing else "")


def _periodic(axes: Axes, arm: int, periodic: tuple[RotatingOrbit, ...]) -> None:
    """Draw orbits in the phase plane of an arm."""
    for one in periodic:
        states = one.system.propagator.sample(one.state, np.linspace(0.0, one.period, 400))
        axes.plot(states[:, arm], states[:, 2 + arm], color=style.arm_colour(arm), linewidth=1.5)
    number = style.number(arm)
    title = f"periodic orbit, {periodic[0].period:.3f} s" if len(periodic) == 1 else "periodic orbits"
    quiet(axes, "" if arm else title, x=f"θ{number} (rad)", y=f"ω{number} (rad/s)")
    angle_axis(axes, "x")
