"""Connections of the pendulum's orbits: homoclinic ones of one to three turns, and heteroclinic ones."""

from dpcontrol.pages.atlas_panels import row_of
from dpcontrol.pages.atlas_parts import kind_of
from dpcontrol.pages.gallery import Gallery, PaperFigure
from dpcontrol.pages.layout import Page
from dpcontrol.pages.paper.tubes import ENERGY, SADDLE, SENSES_ENERGY
from dpcontrol.walks.atlas import AtlasConnection

PAIRS = (("down-up", "up-down"), ("up-down", "down-up"))
_MOST, _REPEATED = 5, 3
_TURNS = {2: ("Double", "second", "twice", "two"), 3: ("Triple", "third", "three times", "three")}


def heteroclinics_page(gallery: Gallery) -> PaperFigure:
    """Draw the connections from Down-Up to Up-Down and back at 0.2 J, with their cuts."""
    atlas = gallery.atlas("lab", SENSES_ENERGY, (1, 1))
    page = Page(f"Heteroclinic connections between Down-Up and Up-Down at {SENSES_ENERGY:g} J (first hits)")
    counts = []
    for letters, (source, target) in zip(("abcd", "efgh"), PAIRS, strict=True):
        kind, shown = kind_of(atlas, source, target), atlas.between(source, target)[:4]
        numbers = {c.name: letter for c, letter in zip(shown, letters, strict=False)}
        page.row(*row_of(atlas, kind, shown, numbers=numbers), height=3.7)
        counts.append(f"{kind.count} from {source} to {target}")
    return PaperFigure(
        page.figure(),
        "On the section both arms are aligned, θ₁ = θ₂ + 2πk. Left: the unstable tube "
        "(red) of the source orbit meets the stable tube (green) of the target orbit. Right: the flights "
        "in the plane of the angles, from the source's named position; pale teal is the orbit about Down-Up, pale "
        f"violet that about Up-Down. {' and '.join(counts)}; those in one direction are those in the other, "
        "run backward in time.",
        'The paper\'s heteroclinics "at H = -0.07" cannot exist, since Up-Down has no orbit below its energy of '
        "0.1754 J. Here both directions are drawn, and each connection with its reflection; the unstable tube's cut is "
        "open where its trajectories graze the section.",
    )


def repeated_page(gallery: Gallery, *, turns: int) -> PaperFigure:
    """Draw connections of Down-Up at -0.07 J that turn the outer arm several times.

    Args:
        gallery: data sources.
        turns: number of turns, 2 or 3.
    """
    title, ordinal, times, number = _TURNS[turns]
    # The outer arm passes hanging once per turn: for two turns the unstable tube's second crossing is the last.
    atlas = gallery.atlas("lab", ENERGY, (turns, 1))
    kind, connections = kind_of(atlas, SADDLE, SADDLE), atlas.between(SADDLE, SADDLE)
    repeated = [c for c in connections if tuple(map(abs, c.winding)) == (0, turns) and c.sense > 0]
    # Time reversal maps the section to the other passage, so images of one flight are recognised by its length.
    lengths: dict[float, AtlasConnection] = {}
    for c in sorted(repeated, key=lambda c: (c.time_in + c.time_out, c.name)):
        lengths.setdefault(round(c.time_in + c.time_out, 4), c)
    kept = list(lengths.values())[:_REPEATED] or [c for c in connections if c.sense > 0][:_REPEATED]
    names = {c.name: letter for c, letter in zip(kept, "abc", strict=False)}
    page = Page(f"{title} homoclinic connections of Down-Up at {ENERGY:g} J (hits {[turns, 1]})")
    page.row(*row_of(atlas, kind, kept, numbers=names, marked=tuple(kept)), height=4.4)
    windings = [tuple(abs(int(turn)) for turn in c.winding) for c in connections]
    counts = ", ".join(
        f"{windings.count(w)} {f'of winding ±{list(w)}' if any(w) else 'without winding'}"
        for w in sorted(set(windings))
    )
    resolved = all(atlas.cut(SADDLE, kind.section, hit).resolved for hit in kind.hits)
    torn = " and is drawn as far as it could be resolved: more connections than these exist"
    return PaperFigure(
        page.figure(),
        f"Above, left: the cuts of the unstable tube at its {ordinal} crossing of θ₂ = 2πk and of the stable tube at "
        "its first one back. Right: the connections as flights in the plane of the angles, with the "
        f"outer arm turning {times} before the arms settle about Down-Up again, {number} turns on (dot: the section at "
        f"time zero). {'In all' if resolved else 'At least'} {len(connections)} connections were found at these hits: "
        f"{counts}; those of smaller winding turn there and back. The cut is in pieces, torn apart where the tube "
        f"passes near the orbit again{'' if resolved else torn}.",
        "The paper cuts them on θ₂ = 4π and 6π; here the section is that of the single ones, θ₂ = 2πk, at later hits. "
        "On θ₁ = θ₂ `dpcontrol connect --section aligned` lists them.",
    )
