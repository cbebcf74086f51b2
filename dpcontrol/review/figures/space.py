"""Tubes, cuts and orbits of an atlas in space: first coordinate, second, first rate."""

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.review import style
from dpcontrol.review.figures.cuts import tubes_of_cut
from dpcontrol.review.panel_frame import angle_axis
from dpcontrol.walks.atlas import Atlas, AtlasConnection, AtlasCut

FLIGHT = style.INK


def draw_space(
    axes: Axes,
    atlas: Atlas,
    *,
    hit_of: Callable[[AtlasCut], int | None],
    only: str | None = None,
    one_colour: str | None = None,
    flights: tuple[AtlasConnection, ...] = (),
) -> None:
    """Draw the tubes of cuts for which `hit_of` gives a hit (of one saddle), all orbits, and flights, in 3-D axes.

    Flights leave their source's named place; where they end whole turns away, the orbit that they join is drawn there.
    """
    rate = len(atlas.periods) // 2
    for cut in atlas.cuts:
        if hit_of(cut) is None or (only is not None and cut.saddle != only):
            continue
        for tube in tubes_of_cut(atlas, cut):
            for states in tube.strands:
                axes.plot(*states[:, [0, 1, rate]].T, color=tube.colour, linewidth=0.5, alpha=0.8)
            for states in tube.ends:
                axes.plot(*states[:, [0, 1, rate]].T, color=style.CUT, linewidth=1.6)
    for orbit in atlas.orbits:
        closed = np.vstack([orbit.samples, orbit.samples[:1]])
        colour = one_colour or style.saddle_colour(orbit.saddle)
        axes.plot(*closed[:, [0, 1, rate]].T, color=colour, linewidth=2.5, zorder=10)
    for c in flights:
        axes.plot(*c.states[:, [0, 1, rate]].T, color=FLIGHT, linewidth=0.9, alpha=0.9, zorder=8)
    samples = {orbit.saddle: orbit.samples for orbit in atlas.orbits if orbit.family == 0}
    for saddle, winding in sorted({(c.target, c.winding) for c in flights if any(c.winding)}):
        copy = samples[saddle] + np.r_[np.asarray(winding, float), np.zeros(rate)] * atlas.turn_lengths
        colour = one_colour or style.saddle_colour(saddle)
        axes.plot(*np.vstack([copy, copy[:1]])[:, [0, 1, rate]].T, color=colour, linewidth=1.6, alpha=0.6, zorder=9)
    angular = bool(np.isfinite(atlas.periods).any())
    for which, label in (("x", "θ₁ (rad)" if angular else "x"), ("y", "θ₂ (rad)" if angular else "y")):
        getattr(axes, f"set_{which}label")(label, fontsize=9)
        if angular:
            angle_axis(axes, which, step=0.25 if which == "x" and only else 1.0)
    axes.set_zlabel("ω₁ (rad/s)" if angular else "x rate", fontsize=9)  # type: ignore[attr-defined]
    axes.view_init(elev=22, azim=-122)  # type: ignore[attr-defined]
    axes.tick_params(labelsize=8, colors=style.CART)
