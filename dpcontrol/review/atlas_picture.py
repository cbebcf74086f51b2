"""A picture of an atlas: the viewer's where it can draw without a screen, else one drawn by matplotlib."""

from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dpcontrol.foundation.files import whole_file
from dpcontrol.review.figures.cuts import connections_of, draw_cuts
from dpcontrol.review.figures.page import STABLE, UNSTABLE, new_figure, saddle_colour
from dpcontrol.review.figures.space import CUT, FLIGHT, draw_space
from dpcontrol.review.picture import Picture
from dpcontrol.review.viewer import picture_of
from dpcontrol.walks.atlas import Atlas


def write_atlas_picture(atlas: Atlas, path: Path | str) -> Picture:
    """Write a PNG of the atlas: of the Rerun viewer if this machine can render it, else drawn by matplotlib.

    Raises:
        InputError: the file cannot be written.
    """
    from dpcontrol.review.atlas_recording import write_atlas_recording

    path = Path(path)
    reason = picture_of(lambda file: write_atlas_recording(atlas, file), path, moment=0.0)
    if reason is None:
        return Picture(path, "viewer", f"{path} shows the Rerun viewer, rendered without a screen.")
    return write_drawn_atlas(atlas, path, reason=reason)


def write_drawn_atlas(atlas: Atlas, path: Path | str, *, reason: str = "it was asked for") -> Picture:
    """Write a PNG of the atlas drawn by matplotlib, for `reason`.

    Raises:
        InputError: the file cannot be written.
    """
    path = Path(path)
    figure = draw_atlas(atlas)
    with whole_file(path, suffix=".png") as temporary:
        figure.savefig(temporary, format="png")
    return Picture(path, "matplotlib", f"{path} was drawn by matplotlib, not by the Rerun viewer: {reason}.")


def draw_atlas(atlas: Atlas) -> Figure:
    """Return the atlas on one page: tubes, orbits and flights in space, and the cuts of every kind."""
    kinds = [kind for kind in atlas.kinds if connections_of(atlas, kind)]
    title = f"{atlas.title} at {atlas.energy:g} J: {len(atlas.orbits)} orbits, {len(atlas.connections)} connections"
    figure = new_figure(16, 8.6, title)
    wide = 0.42 if kinds else 0.9
    space = figure.add_axes((0.03, 0.0, wide - 0.03, 0.95), projection="3d")
    draw_space(space, atlas, hit_of=lambda cut: cut.hit, flights=atlas.connections)
    looks = ((UNSTABLE, "unstable tubes"), (STABLE, "stable tubes"), (CUT, "cuts"), (FLIGHT, "connections"))
    handles = [Line2D([], [], color=colour, label=label) for colour, label in looks]
    handles += [Line2D([], [], color=saddle_colour(o.saddle), linewidth=2.5, label=f"orbit about {o.name}")
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
