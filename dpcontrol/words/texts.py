"""Which function turns a result into the lines that a verb prints.

The modules are imported when a result of theirs is printed.
"""

import json
from collections.abc import Iterable
from importlib import import_module
from typing import Any

from dpcontrol.foundation.document import plain
from dpcontrol.words.table import Line

TEXTS = {
    "Atlas": "design.atlas",
    "BifurcationSearch": "design.bifurcations",
    "CacheContents": "start.cache",
    "CertificateCheck": "design.check",
    "ChosenConnection": "design.chosen",
    "Configuration": "start.configuration",
    "ConnectionSearch": "design.connections",
    "Demonstration": "start.demonstration",
    "Edges": "design.graph",
    "LyapunovFamily": "design.family",
    "LyapunovOrbit": "design.orbit",
    "ModelDescription": "start.description",
    "Page": "start.page",
    "Proof": "design.proof",
    "RefinedConnection": "design.refined",
    "RotatingFamilies": "design.rotating_families",
    "RotatingOrbits": "design.rotating_orbits",
    "Score": "runs.score_lines",
    "SolvedWalks": "design.solved",
    "SustainedOrbit": "design.sustained",
    "SymbolChanges": "design.changes",
    "SymmetricSearch": "design.symmetric",
    "WalkList": "design.walks",
}
"""Class of a result -> its function as MODULE.FUNCTION within this package."""


def text_of(result: Any) -> Iterable[Line]:
    """Return the lines of a result: those of its class in `TEXTS`, otherwise its JSON document.

    Args:
        result: result of a public function.
    """
    for kind in type(result).__mro__:
        if kind.__name__ in TEXTS:
            module, _, name = TEXTS[kind.__name__].partition(".")
            return getattr(import_module(f"dpcontrol.words.{module}"), name)(result)
    return [json.dumps(plain(result), indent=1, ensure_ascii=False)]
