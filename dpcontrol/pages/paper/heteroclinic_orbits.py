"""Heteroclinic connections in space, from either saddle to the other."""

from collections.abc import Sequence
from functools import partial

from matplotlib.axes import Axes

from dpcontrol.pages import style
from dpcontrol.pages.atlas_flights import draw_space
from dpcontrol.pages.atlas_parts import connections_of, kind_of, placed
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.layout import MOST_IN_KEY, Page, Panel, key
from dpcontrol.pages.paper.senses import SENSES_ENERGY
from dpcontrol.walks.atlas import Atlas, AtlasConnection


def heteroclinic_orbits_page(gallery: Gallery) -> PaperFigure:
    """Draw heteroclinic connections at 0.2 J in (θ₁, θ₂, ω₁).

    Both Lyapunov orbits are included.
    """
    atlas = gallery.atlas("lab", SENSES_ENERGY, (1, 1))
    page = Page(f"Heteroclinic orbits in (θ₁, θ₂, ω₁) at {SENSES_ENERGY:g} J")
    words, spaces = [], []
    for column, (source, target) in enumerate((("down-up", "up-down"), ("up-down", "down-up"))):
        kind = kind_of(atlas, source, target)
        assert kind is not None
        # One of each pair of reflections is drawn.
        kept = [c for c in connections_of(atlas, kind) if c.sense > 0]
        title = f"{'ab'[column]}  {source} → {target}"
        spaces.append(Panel(partial(_between, atlas=atlas, target=target, kept=kept, title=title), space=True))
        words.append(f"{len(kept)} from {source} to {target}")
    page.row(*spaces, height=5.4)
    return PaperFigure(
        page.figure(),
        f"The heteroclinic connections at {SENSES_ENERGY:g} J whose difference of angles grows on the section θ₁ = θ₂ "
        f"({' and '.join(words)}; each has a reflection). They lead from one Lyapunov orbit to the other "
        "and are labelled with the angle between the tubes. Those of b are those of a, run backward in time.",
        f"The paper draws one direction. {IDENTIFIED}",
    )


def _between(axes: Axes, atlas: Atlas, target: str, kept: Sequence[AtlasConnection], *, title: str) -> None:
    draw_space(axes, atlas, (), saddles=())
    for orbit in atlas.orbits:
        turns = {c.winding for c in kept} if orbit.saddle == target else {(0, 0)}
        for winding in sorted(turns):
            closed = placed(atlas, orbit, winding)[:, :3]
            axes.plot(*closed.T, color=style.saddle_colour(orbit.saddle), linewidth=2.5, zorder=10)
    for k, c in enumerate(kept):
        axes.plot(*c.states[:, :3].T, color=style.SERIES[k % len(style.SERIES)], linewidth=1.2)
    axes.set_title(title, loc="left")
    looks = [(f"{c.transversality_angle:.1f}°", style.SERIES[k]) for k, c in enumerate(kept[:MOST_IN_KEY])]
    key(axes, looks)
