"""Connections against energy, kept by content: a sweep takes ten seconds or more, its diagram tens of kilobytes."""

import json
from dataclasses import asdict

from dpcontrol.bifurcations.bifurcations import BranchDiagram, branch_diagram, diagram_from, find_bifurcations
from dpcontrol.bifurcations.sweep import SweepSettings
from dpcontrol.foundation.cache import cache_folder, code_hash
from dpcontrol.foundation.files import content_hash, write_whole
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.scenes.model import Model

FORMAT = 1
LOWEST, HIGHEST, HIGHEST_BETWEEN = -0.49, 0.26, 0.236
"""Energies in J between which connections are drawn: sweeps begin at the later of both saddles. Those between different
saddles end earlier: cuts of the lab pendulum's tubes scatter from about 0.237 J on, where counts are lower bounds."""


def make_branches(
    model: Model,
    source: str,
    target: str,
    *,
    energies: tuple[float, float] | None = None,
    samples: int = 28,
    progress: Progress = no_progress,
) -> BranchDiagram:
    """Return the diagram of the first-hit connections between two saddles, from the cache where it is kept.

    Raises:
        InputError: saddles or energies between which nothing can be swept.
    """
    settings = SweepSettings(energies=samples)
    energies = energies or (LOWEST, HIGHEST if source == target else HIGHEST_BETWEEN)
    content = {
        "format": FORMAT,
        "code": code_hash(__name__),
        "parameters": model.system.parameters.tolist(),
        "system": type(model.parameters).__name__,
        "saddles": [source, target],
        "energies": energies,
        "settings": asdict(settings),
    }
    key = content_hash(json.dumps(content, sort_keys=True))
    file = cache_folder("branches") / f"{model.name}-{source}-{target}-{key}.json"
    try:
        return diagram_from(json.loads(file.read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError):
        # Never made, or damaged.
        pass
    found = find_bifurcations(model.system, source, target, energies=energies, settings=settings, progress=progress)
    diagram = branch_diagram(found)
    write_whole(file, json.dumps(diagram.document()) + "\n")
    return diagram
