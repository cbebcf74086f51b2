"""An atlas on one page.

All orbits and tubes in space are followed by the cuts of each kind of connection.
"""

from __future__ import annotations

from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.foundation.document import counted
from dpcontrol.pages import style
from dpcontrol.pages.atlas_panels import draw_cuts, draw_space
from dpcontrol.pages.atlas_parts import connections_of
from dpcontrol.pages.layout import Page, Panel, Stack
from dpcontrol.walks.atlas import Atlas


def draw_atlas(atlas: Atlas) -> Figure:
    """Return the atlas on one page.

    It shows tubes, orbits and flights in space, and the cuts of every kind.
    """
    kinds = [kind for kind in atlas.kinds if connections_of(atlas, kind)]
    counts = f"{counted(len(atlas.orbits), 'orbit')}, {counted(len(atlas.connections), 'connection')}"
    page = Page(f"{atlas.title} at {atlas.energy:g}{atlas.unit('J')}: {counts}")
    spaces: list[Panel | Stack] = [Panel(partial(_draw_whole, atlas=atlas), space=True)]
    panels = [
        partial(draw_cuts, atlas=atlas, kind=k, title=f"{k.source} → {k.target}: {k.count} at hits {list(k.hits)}")
        for k in kinds
    ]
    if len(panels) > 1:
        spaces.append(Stack(panels[:2]))
        page.row(*spaces, height=6.4)
    else:
        page.row(*spaces, *panels, height=5.2)
    for first in range(2, len(panels), 2):
        page.row(*panels[first : first + 2], height=3.2)
    return page.figure()


def _draw_whole(axes: Axes, atlas: Atlas) -> None:
    draw_space(axes, atlas, atlas.cuts, flights=[(c, style.INK) for c in atlas.connections])
    for k, orbit in enumerate(atlas.orbits):
        look = {"fontsize": style.SMALL, "color": style.saddle_colour(orbit.saddle), "weight": "bold"}
        axes.text2D(0.0, 0.04 * k, f"orbit about {orbit.name}", transform=axes.transAxes, **look)  # type: ignore[attr-defined]
    axes.set_box_aspect(None, zoom=1.1)  # type: ignore[call-arg]
