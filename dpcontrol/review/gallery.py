"""What figures are drawn from, and a figure with its words."""

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure

from dpcontrol.bifurcations.bifurcations import BranchDiagram
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.walks.atlas import Atlas


@dataclass(frozen=True)
class Gallery:
    """What figures are drawn from; each figure asks for what it needs.

    system: of a model by name. atlas: of a model, an energy in J and hits (None: the first that there are).
    branches: of a model, a source and a target, with what to report to: their connections against energy.
    progress: where the figure being drawn reports how far it is.
    """

    system: Callable[[str], System]
    atlas: Callable[[str, float, tuple[int, int] | None], Atlas]
    branches: Callable[[str, str, str, Progress], BranchDiagram]
    progress: Progress = no_progress


@dataclass(frozen=True)
class Page:
    """A figure with its words: what it shows, and what differs from the paper's and why."""

    figure: Figure
    caption: str
    differs: str


IDENTIFIED = "Parameters are the rig's identified ones; those that the paper prints do not reproduce its pictures."
