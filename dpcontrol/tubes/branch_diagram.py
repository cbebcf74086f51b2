"""The diagram of a sweep: where each connection crosses its section at every energy, with the events between.

A document of plain numbers, to be kept and drawn without the sweep it comes from.
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.tubes.bifurcations import BifurcationSearch

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mark:
    """An event in a diagram: energy in J, kind, point (q, p/p₀) on the section, counts below and above."""

    energy: float
    kind: str
    point: tuple[float, float]
    count_below: int
    count_above: int
    at_least: bool


@dataclass(frozen=True)
class BranchDiagram:
    """Connections between two saddles against energy.

    runs: of each connection followed, energies in J and points (q, p/p₀), in order along it; counts: (energy, number
    on the torus, whether the search was complete); scatters_from: J, as in BifurcationSearch.
    """

    source: str
    target: str
    section: str
    runs: tuple[tuple[Array, Array], ...]
    marks: tuple[Mark, ...]
    counts: tuple[tuple[float, int, bool], ...]
    scatters_from: float | None
    unexplained: int

    def document(self) -> dict[str, Any]:
        """Return the diagram as numbers, lists and strings."""
        runs = [{"energies": e.tolist(), "points": p.tolist()} for e, p in self.runs]
        return {**asdict(self), "runs": runs}


def branch_diagram(search: BifurcationSearch) -> BranchDiagram:
    """Return the diagram of a sweep."""
    return BranchDiagram(
        source=search.source,
        target=search.target,
        section=search.section.name,
        runs=tuple((run.energies, run.points) for run in search.runs),
        marks=tuple(
            Mark(e.energy, e.kind, (float(e.point[0]), float(e.point[1])), e.count_below, e.count_above, e.at_least)
            for e in search.events
        ),
        counts=tuple((c.energy, c.count, c.complete) for c in search.counts),
        scatters_from=search.scatters_from,
        unexplained=len(search.unexplained),
    )


def diagram_from(document: dict[str, Any]) -> BranchDiagram:
    """Return the diagram that a document holds.

    Raises:
        KeyError, TypeError, ValueError: the document is of no diagram.
    """
    return BranchDiagram(
        source=str(document["source"]),
        target=str(document["target"]),
        section=str(document["section"]),
        runs=tuple(
            (np.array(r["energies"], dtype=float), np.array(r["points"], dtype=float)) for r in document["runs"]
        ),
        marks=tuple(Mark(**{**m, "point": (float(m["point"][0]), float(m["point"][1]))}) for m in document["marks"]),
        counts=tuple((float(e), int(n), bool(c)) for e, n, c in document["counts"]),
        scatters_from=document["scatters_from"],
        unexplained=int(document["unexplained"]),
    )
