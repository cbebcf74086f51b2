"""The paper's computational figures by name: pages with captions, drawn to files."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from matplotlib.figure import Figure

from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.foundation.settings import check_choice
from dpcontrol.pages.layout import save_figure
from dpcontrol.plans.atlas import AtlasSettings, make_atlas
from dpcontrol.plans.model import Model, load_model
from dpcontrol.walks.atlas import Atlas


@cache
def model_named(name: str) -> Model:
    """Return a shipped model by name, loaded once for all figures of the paper."""
    return load_model(name)


def atlas_at(energy: float, *, model: str = "lab", hits: tuple[int, int] | None = (1, 1)) -> Atlas:
    """Return the atlas of an energy, from the cache if it was computed before, for a figure of the paper.

    Args:
        energy: energy in the model's unit.
        model: name of the model.
        hits: crossings of both tubes; None for the first available.
    """
    return make_atlas(model_named(model), energy, settings=AtlasSettings(hits=hits))


@dataclass(frozen=True)
class PaperFigure:
    """A figure of the paper as drawn here.

    Attributes:
        figure: the page.
        caption: text below it.
        differs: differences from the paper's figure.
    """

    figure: Figure
    caption: str
    differs: str


IDENTIFIED = "Parameters are the rig's identified ones; those printed in the paper do not reproduce its pictures."


def _page(place: str, progress: Progress, **how: Any) -> PaperFigure:
    """Return a figure of the paper from the function that draws it, whose module is imported only now.

    Args:
        place: `module:function` within `dpcontrol.pages.paper`.
        progress: receiver of progress reports.
        **how: further arguments of the function.
    """
    module, _, function = place.partition(":")
    return getattr(import_module(f"dpcontrol.pages.paper.{module}"), function)(progress, **how)


FIGURES: dict[str, Callable[[Progress], PaperFigure]] = {
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
"""Functions that draw the figures, in the order of the paper; their modules are imported on use."""


@dataclass(frozen=True)
class Drawn:
    """A figure on disk: file, caption, and its differences from the paper."""

    name: str
    file: Path
    caption: str
    differs: str


@dataclass(frozen=True)
class DrawnFigures(Documented):
    """Figures on disk with their captions.

    Attributes:
        figures: figures with file and caption.
    """

    KEYS: ClassVar[str] = "figures status"

    figures: tuple[Drawn, ...]

    def __iter__(self) -> Iterator[Drawn]:
        return iter(self.figures)

    @property
    def status(self) -> str:
        """Number of figures."""
        return f"{len(self.figures)} figures drawn"


def draw_figures(names: Sequence[str], folder: Path, *, progress: Progress = no_progress) -> DrawnFigures:
    """Draw figures to NAME.png in a folder.

    Args:
        names: names of the figures; all if empty.
        folder: folder of the files.
        progress: receiver of progress reports.

    Raises:
        InputError: a name is unknown, or the folder is not writable.
    """
    check_choice("figure", FIGURES, *names)
    figure_names = list(dict.fromkeys(names)) or list(FIGURES)
    drawn_figures = []
    for k, name in enumerate(figure_names):
        progress(name, k / len(figure_names))
        page = FIGURES[name](part_of(progress, k / len(figure_names), (k + 1) / len(figure_names)))
        file = Path(folder) / f"{name}.png"
        save_figure(page.figure, file)
        drawn_figures.append(Drawn(name, file, page.caption, page.differs))
    return DrawnFigures(tuple(drawn_figures))
