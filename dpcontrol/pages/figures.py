"""The paper's computational figures by name: pages with captions, drawn to files."""

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import ClassVar

from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import write_whole
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.pages.gallery import Gallery, PaperFigure
from dpcontrol.pages.layout import save_figure
from dpcontrol.pages.paper.branches import branches_page
from dpcontrol.pages.paper.connecting import (
    cuts_page,
    graph_page,
    heteroclinics_page,
    repeated_page,
    returning_page,
    senses_page,
    shadowing_page,
    three_body_homoclinics_page,
    three_body_page,
)
from dpcontrol.pages.paper.equilibria import landscape_page, lyapunov_orbits_page, up_up_page

FIGURES: dict[str, Callable[[Gallery], PaperFigure]] = {
    "energy-landscape": landscape_page,
    "three-body-homoclinics": three_body_homoclinics_page,
    "three-body": three_body_page,
    "lyapunov-orbits": lyapunov_orbits_page,
    "tubes-down-up": partial(senses_page, saddle="down-up"),
    "cuts": cuts_page,
    "tubes-up-down": partial(senses_page, saddle="up-down"),
    "heteroclinics": heteroclinics_page,
    "branches": branches_page,
    "graph": graph_page,
    "shadowing": shadowing_page,
    "double-homoclinics": partial(repeated_page, turns=2),
    "triple-homoclinics": partial(repeated_page, turns=3),
    "returning-homoclinics": returning_page,
    "up-up": up_up_page,
}
"""In the order of the paper."""
CAPTIONS = "captions.json"


@dataclass(frozen=True)
class Drawn:
    """A figure on disk: file, caption, and seconds taken including its computations."""

    name: str
    file: Path
    caption: str
    differs: str
    seconds: float


@dataclass(frozen=True)
class DrawnFigures(Documented):
    """Figures on disk, and the file of their captions."""

    KEYS: ClassVar[str] = "figures captions status"

    figures: tuple[Drawn, ...]
    captions: Path

    def __iter__(self) -> Iterator[Drawn]:
        return iter(self.figures)

    @property
    def status(self) -> str:
        """Number of figures."""
        return f"{len(self.figures)} figures drawn"


def draw_figures(
    names: Sequence[str], gallery: Gallery, folder: Path, *, progress: Progress = no_progress
) -> DrawnFigures:
    """Draw figures to NAME.png in a folder.

    Their captions are written to captions.json there.

    Args:
        names: names of the figures; all if empty.
        gallery: data sources.
        folder: folder of the files.
        progress: receiver of progress reports.

    Raises:
        InputError: a name is unknown, or the folder is not writable.
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
        save_figure(page.figure, file)
        drawn.append(Drawn(name, file, page.caption, page.differs, time.perf_counter() - began))
    captions = Path(folder) / CAPTIONS
    words = {d.name: {"file": d.file.name, "caption": d.caption, "differs": d.differs} for d in drawn}
    write_whole(captions, json.dumps(words, indent=1, ensure_ascii=False) + "\n")
    return DrawnFigures(tuple(drawn), captions)
