"""Homoclinic connections of two and three turns."""

from functools import partial

import numpy as np

from dpcontrol.pages.atlas_flights import draw_angles, row_of
from dpcontrol.pages.atlas_parts import kind_of
from dpcontrol.pages.gallery import Gallery, PaperFigure
from dpcontrol.pages.layout import Page
from dpcontrol.pages.paper.tubes import ENERGY, SADDLE
from dpcontrol.walks.atlas import AtlasConnection

_SHOWN = 3
_TURNS = {2: ("Double", "second", "twice", "two"), 3: ("Triple", "third", "three times", "three")}


def draw_repeated(gallery: Gallery, *, turns: int) -> PaperFigure:
    """Draw connections of Down-Up that turn the outer arm several times.

    The energy is -0.07 J. Their angles are drawn over time.

    Args:
        gallery: data sources.
        turns: number of turns, 2 or 3.
    """
    # The outer arm passes hanging once per turn: for two turns the unstable tube's second crossing is the last.
    hits = (turns, 1)
    title, ordinal, times, number = _TURNS[turns]
    atlas = gallery.atlas("lab", ENERGY, hits)
    kind = kind_of(atlas, SADDLE, SADDLE)
    assert kind is not None
    connections = atlas.between(SADDLE, SADDLE)
    repeated = [c for c in connections if tuple(map(abs, c.winding)) == (0, turns) and c.sense > 0]
    # Time reversal maps the section to the other passage, so images of one flight are recognised by its length.
    lengths: dict[float, AtlasConnection] = {}
    for c in sorted(repeated, key=lambda c: (c.time_in + c.time_out, c.name)):
        lengths.setdefault(round(c.time_in + c.time_out, 4), c)
    kept = list(lengths.values())[:_SHOWN] or [c for c in connections if c.sense > 0][:_SHOWN]
    page = Page(f"{title} homoclinic connections of Down-Up at {ENERGY:g} J (hits {list(hits)})")
    names = {c.name: "abc"[k] for k, c in enumerate(kept)}
    page.row(*row_of(atlas, kind, kept, numbers=names, marked=tuple(kept)), height=4.4)
    angles = "{}: θ₁ blue, θ₂ orange, against time (s)"
    panels = [partial(draw_angles, atlas=atlas, connection=c, title=angles.format(names[c.name])) for c in kept]
    page.row(*panels, height=2.6)
    windings = {tuple(int(v) for v in np.abs(c.winding)) for c in connections}
    counts = ", ".join(
        f"{sum(tuple(map(abs, c.winding)) == t for c in connections)} "
        + (f"of winding ±{list(t)}" if any(t) else "without winding")
        for t in sorted(windings)
    )
    resolved = all(atlas.cut(SADDLE, kind.section, hit).resolved for hit in hits)
    torn = " and is drawn as far as it could be resolved: more connections than these exist"
    return PaperFigure(
        page.figure(),
        f"Above, left: the cuts of the unstable tube at its {ordinal} crossing of θ₂ = 2πk and of the stable tube at "
        "its first one back. Right: the connections as flights in the plane of the angles, with the "
        f"outer arm turning {times} before the arms settle about Down-Up again, {number} turns on (dot: the section at "
        "time zero). Below: both angles against time; dotted lines mark where the flight leaves one orbit and joins "
        f"the other. {'In all' if resolved else 'At least'} {len(connections)} connections were found at these hits: "
        f"{counts}; those of smaller winding turn there and back. The cut is in pieces, torn apart where the tube "
        f"passes near the orbit again{'' if resolved else torn}.",
        "The paper cuts them on θ₂ = 4π and 6π; here the section is that of the single ones, θ₂ = 2πk, at later hits. "
        "On θ₁ = θ₂ `dpcontrol connect --section aligned` lists them.",
    )
