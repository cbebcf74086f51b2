"""Double and triple homoclinics: later hits of the section, with flights on which the outer arm turns so often."""

import numpy as np

from dpcontrol.review.figures.cuts import kind_of
from dpcontrol.review.figures.flights import draw_angles, draw_row
from dpcontrol.review.figures.page import Gallery, Page
from dpcontrol.review.panel_frame import new_figure
from dpcontrol.walks.atlas import AtlasConnection

ENERGY = -0.07
SADDLE = "down-up"
_SHOWN = 3
_WORDS = {2: ("Double", "second", "twice", "two"), 3: ("Triple", "third", "three times", "three")}


def draw_double(gallery: Gallery) -> Page:
    """Draw connections of Down-Up at -0.07 J with winding [0, 2], and how they go."""
    return _draw(gallery, 2)


def draw_triple(gallery: Gallery) -> Page:
    """Draw connections of Down-Up at -0.07 J with winding [0, 3], and how they go."""
    return _draw(gallery, 3)


def _draw(gallery: Gallery, turns: int) -> Page:
    # A flight that turns the outer arm twice passes it hanging twice: the unstable tube's second time is the last.
    hits = (turns, 1)
    title, ordinal, times, number = _WORDS[turns]
    atlas = gallery.atlas("lab", ENERGY, hits)
    kind = kind_of(atlas, SADDLE, SADDLE)
    assert kind is not None
    connections = atlas.between(SADDLE, SADDLE)
    repeated = [c for c in connections if tuple(map(abs, c.winding)) == (0, turns) and c.sense > 0]
    # Time reversal moves the section to the other passage, so images of one flight are told by its length.
    lengths: dict[float, AtlasConnection] = {}
    for c in sorted(repeated, key=lambda c: (c.time_in + c.time_out, c.name)):
        lengths.setdefault(round(c.time_in + c.time_out, 4), c)
    kept = list(lengths.values())[:_SHOWN] or [c for c in connections if c.sense > 0][:_SHOWN]
    figure = new_figure(14, 8.2, f"{title} homoclinic connections of Down-Up at {ENERGY:g} J (hits {list(hits)})")
    grid = figure.add_gridspec(2, 1, left=0.05, right=0.99, top=0.84, bottom=0.09, hspace=0.3, height_ratios=[1.5, 1])
    names = {c.name: "abc"[k] for k, c in enumerate(kept)}
    draw_row(figure, grid[0, 0], atlas, kind, kept, numbers=names, marked=tuple(kept))
    below = grid[1, 0].subgridspec(1, max(len(kept), 1), wspace=0.15)
    for k, c in enumerate(kept):
        panel = figure.add_subplot(below[0, k])
        draw_angles(panel, atlas, c)
        panel.set_title(f"{names[c.name]}: θ₁ blue, θ₂ orange, against time (s)", fontsize=8.5, loc="left")
    windings = {tuple(int(v) for v in np.abs(c.winding)) for c in connections}
    counts = ", ".join(
        f"{sum(tuple(map(abs, c.winding)) == t for c in connections)} of winding ±{list(t)}" for t in sorted(windings)
    )
    resolved = all(atlas.cut(SADDLE, kind.section, hit).resolved for hit in hits)
    scattered = (
        ""
        if resolved
        else (
            " Trajectories scatter before that crossing and the cut is drawn as far as it could be resolved: more "
            "connections than these exist."
        )
    )
    return Page(
        figure,
        f"Above, left: the cuts of the unstable tube at its {ordinal} crossing of θ₂ = 2πk and of the stable tube at "
        "its first one back, with the connections shown at right: their flights in the plane of the angles, in which "
        f"the outer arm turns {times} before the arms settle about Down-Up again, {number} turns on (dot: the section "
        "at time zero). "
        "Below: both angles against time; dotted lines mark where the flight leaves one orbit and joins the other. "
        f"{'In all' if resolved else 'At least'} {len(connections)} connections were found at these hits: {counts}; "
        "those of smaller winding turn there and back. The cut is in pieces: part of the tube has been torn apart by "
        f"passing near the orbit again.{scattered}",
        "The paper cuts them on θ₂ = 4π and 6π; here the section is that of the single ones, θ₂ = 2πk, at later hits, "
        "so that one section shows how single, double and triple turns follow from each other. On θ₁ = θ₂ `dpcontrol "
        "connect --section aligned` lists them.",
    )
