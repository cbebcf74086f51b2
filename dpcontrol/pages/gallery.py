"""Data sources of the figures, and a figure with its caption."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from matplotlib.figure import Figure

from dpcontrol.bifurcations.bifurcations import BranchDiagram
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.plans.atlas import AtlasSettings, make_atlas, make_branches
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
    branches: Callable[[str, str, str, Progress], BranchDiagram]
    progress: Progress = no_progress


def cached_gallery() -> Gallery:
    """Return the gallery whose data is kept in the cache.

    The data is computed on first use.
    """
    model = cache(load_model)
    return Gallery(
        system=lambda name: model(name).system,
        atlas=lambda name, energy, hits: make_atlas(model(name), energy, settings=AtlasSettings(hits=hits)),
        branches=lambda name, source, target, report: make_branches(model(name), source, target, progress=report),
    )


@dataclass(frozen=True)
class PaperFigure:
    """A figure with its caption and its differences from the paper."""

    figure: Figure
    caption: str
    differs: str


IDENTIFIED = "Parameters are the rig's identified ones; those printed in the paper do not reproduce its pictures."
