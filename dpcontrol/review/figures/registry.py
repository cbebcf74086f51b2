"""Figures by name; drawing them to PNG with their captions beside them."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import whole_file, write_whole
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.review.figures.connections import (
    draw_double,
    draw_high,
    draw_low,
    draw_triple,
    heteroclinics_page,
    three_body_page,
    tubes_page,
)
from dpcontrol.review.figures.orbits import branches_page, families_page, graph_page, landscape_page, wheels_page
from dpcontrol.review.figures.page import Gallery, Page

FIGURES: dict[str, Callable[[Gallery], Page]] = {
    "energy-landscape": landscape_page,
    "families": families_page,
    "tubes": tubes_page,
    "homoclinics-low": draw_low,
    "homoclinics-high": draw_high,
    "heteroclinics": heteroclinics_page,
    "branches": branches_page,
    "graph": graph_page,
    "double-homoclinics": draw_double,
    "triple-homoclinics": draw_triple,
    "colour-wheels": wheels_page,
    "three-body": three_body_page,
}
"""In the order of the paper."""
CAPTIONS = "captions.json"


@dataclass(frozen=True)
class Drawn:
    """A figure that was drawn: its file, its words, the seconds it took with all that it was computed from."""

    name: str
    file: Path
    caption: str
    differs: str
    seconds: float


def draw_figures(
    names: Sequence[str], gallery: Gallery, folder: Path, *, progress: Progress = no_progress
) -> tuple[Drawn, ...]:
    """Draw figures (all where `names` is empty) to NAME.png in `folder`, and their words to captions.json there.

    Words of figures drawn there before are kept.

    Raises:
        InputError: an unknown name, or a folder that cannot be written to.
    """
    for name in names:
        if name not in FIGURES:
            raise InputError(f"there is no figure {name!r}; choose from {', '.join(FIGURES)}")
    chosen = list(dict.fromkeys(names)) or list(FIGURES)
    drawn = []
    for k, name in enumerate(chosen):
        progress(name, k / len(chosen))
        began = time.perf_counter()
        part = part_of(progress, k / len(chosen), (k + 1) / len(chosen))
        page = FIGURES[name](replace(gallery, progress=part))
        file = Path(folder) / f"{name}.png"
        with whole_file(file, suffix=".png") as temporary:
            page.figure.savefig(temporary, format="png")
        drawn.append(Drawn(name, file, page.caption, page.differs, time.perf_counter() - began))
    _write_captions(Path(folder) / CAPTIONS, drawn)
    return tuple(drawn)


def _write_captions(file: Path, drawn: Sequence[Drawn]) -> None:
    try:
        known = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        known = {}
    words = known if isinstance(known, dict) else {}
    words |= {d.name: {"file": d.file.name, "caption": d.caption, "differs": d.differs} for d in drawn}
    ordered = {name: words[name] for name in FIGURES if name in words}
    write_whole(file, json.dumps(ordered, indent=1, ensure_ascii=False) + "\n")
