"""The paper's computational figures by name: their data sources, and pages with captions, drawn to files."""

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from matplotlib.figure import Figure

from dpcontrol.bifurcations.bifurcations import BifurcationSearch, SweepSettings, find_bifurcations
from dpcontrol.bifurcations.links import Quantity
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import write_whole
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.pages.layout import save_figure
from dpcontrol.plans.atlas import AtlasSettings, make_atlas
from dpcontrol.plans.model import load_model
from dpcontrol.walks.atlas import Atlas


@dataclass(frozen=True)
class Gallery:
    """Data sources of the figures; each figure uses those it needs.

    Attributes:
        system: returns a model's system by name.
        atlas: returns the atlas of a model, an energy in J and a number of hits; None takes the first available.
        branches: returns connections against energy for a model, a source and a target, with a progress callback.
        progress: progress callback of the current figure.
    """

    system: Callable[[str], System]
    atlas: Callable[[str, float, tuple[int, int] | None], Atlas]
    branches: Callable[[str, str, str, Progress], BifurcationSearch]
    progress: Progress = no_progress


def cached_gallery() -> Gallery:
    """Return the gallery whose data are computed on first use and kept in the cache."""
    model = cache(load_model)
    return Gallery(
        system=lambda name: model(name).system,
        atlas=lambda name, energy, hits: make_atlas(model(name), energy, settings=AtlasSettings(hits=hits)),
        branches=lambda name, source, target, report: find_bifurcations(
            Quantity.of_energy(model(name).system),
            source,
            target,
            values=(LOWEST, HIGHEST if source == target else HIGHEST_BETWEEN),
            settings=SweepSettings(samples=28),
            progress=report,
        ),
    )


LOWEST, HIGHEST, HIGHEST_BETWEEN = -0.49, 0.26, 0.236
"""Energies in J between which connections are drawn: sweeps begin at the later of both saddles. Those between different
saddles end earlier: cuts of the lab pendulum's tubes scatter from about 0.237 J on, where counts are lower bounds."""


@dataclass(frozen=True)
class PaperFigure:
    """A figure with its caption and its differences from the paper."""

    figure: Figure
    caption: str
    differs: str


IDENTIFIED = "Parameters are the rig's identified ones; those printed in the paper do not reproduce its pictures."


def _page(place: str, gallery: Gallery, **how: Any) -> PaperFigure:
    module, _, function = place.partition(":")
    return getattr(import_module(f"dpcontrol.pages.paper.{module}"), function)(gallery, **how)


FIGURES: dict[str, Callable[[Gallery], PaperFigure]] = {
    "energy-landscape": partial(_page, "equilibria:landscape_page"),
    "three-body-homoclinics": partial(_page, "connecting:three_body_homoclinics_page"),
    "three-body": partial(_page, "connecting:three_body_page"),
    "lyapunov-orbits": partial(_page, "equilibria:lyapunov_orbits_page"),
    "tubes-down-up": partial(_page, "connecting:senses_page", saddle="down-up"),
    "cuts": partial(_page, "connecting:cuts_page"),
    "tubes-up-down": partial(_page, "connecting:senses_page", saddle="up-down"),
    "heteroclinics": partial(_page, "connecting:heteroclinics_page"),
    "branches": partial(_page, "branches:branches_page"),
    "graph": partial(_page, "connecting:graph_page"),
    "shadowing": partial(_page, "connecting:shadowing_page"),
    "double-homoclinics": partial(_page, "connecting:repeated_page", turns=2),
    "triple-homoclinics": partial(_page, "connecting:repeated_page", turns=3),
    "returning-homoclinics": partial(_page, "connecting:returning_page"),
    "up-up": partial(_page, "equilibria:up_up_page"),
    "transport": partial(_page, "branches:transport_page"),
}
"""Functions of the gallery, in the order of the paper; their modules are imported on use."""
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
    """Figures on disk, and the file of their captions.

    Attributes:
        figures: figures with file, caption and duration.
        captions: file of the captions.
    """

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
    """Draw figures to NAME.png in a folder, and their captions to captions.json.

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
