"""An atlas on one page, drawn by matplotlib: tubes, orbits and connections in space, and the cuts of every kind."""

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dpcontrol.review import style
from dpcontrol.review.figures.cuts import connections_of, draw_cuts
from dpcontrol.review.figures.space import FLIGHT, draw_space
from dpcontrol.review.panel_frame import new_figure
from dpcontrol.walks.atlas import Atlas


def draw_atlas(atlas: Atlas) -> Figure:
    """Return the atlas on one page: tubes, orbits and flights in space, and the cuts of every kind."""
    kinds = [kind for kind in atlas.kinds if connections_of(atlas, kind)]
    title = f"{atlas.title} at {atlas.energy:g} J: {len(atlas.orbits)} orbits, {len(atlas.connections)} connections"
    figure = new_figure(16, 8.6, title)
    wide = 0.42 if kinds else 0.9
    space = figure.add_axes((0.03, 0.0, wide - 0.03, 0.95), projection="3d")
    draw_space(space, atlas, hit_of=lambda cut: cut.hit, flights=atlas.connections)
    looks = (
        (style.UNSTABLE, "unstable tubes"),
        (style.STABLE, "stable tubes"),
        (style.CUT, "cuts"),
        (FLIGHT, "connections"),
    )
    handles = [Line2D([], [], color=colour, label=label) for colour, label in looks]
    handles += [Line2D([], [], color=style.saddle_colour(o.saddle), linewidth=2.5, label=f"orbit about {o.name}")
                for o in atlas.orbits]  # fmt: skip
    figure.legend(handles=handles, loc="lower left", fontsize=8.5, frameon=False, ncols=3)
    columns = 1 if len(kinds) < 2 else 2
    rows = (len(kinds) + columns - 1) // columns
    for k, kind in enumerate(kinds):
        row, column = divmod(k, columns)
        tall, broad = 0.9 / rows, (0.99 - wide) / columns
        axes = figure.add_axes(
            (wide + 0.045 + column * broad, 0.94 - (row + 1) * tall + 0.065, broad - 0.05, tall - 0.15)
        )
        draw_cuts(axes, atlas, kind)
        axes.set_title(f"{kind.source} → {kind.target}: {kind.count} at hits {list(kind.hits)}", loc="left",
                       fontsize=10, pad=27)  # fmt: skip
    return figure
