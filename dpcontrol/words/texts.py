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
    "Atlas": "designs.atlas",
    "BifurcationSearch": "designs.bifurcations",
    "CacheContents": "start.cache",
    "Campaign": "runs.campaign_lines",
    "CampaignSummary": "logs.campaign",
    "CertificateCheck": "designs.check",
    "ChosenConnection": "designs.chosen",
    "Commissioning": "runs.commissioning_lines",
    "Configuration": "start.configuration",
    "ConnectionSearch": "designs.connections",
    "ControllerSource": "runs.export_lines",
    "Demonstration": "start.demonstration",
    "Design": "recordings.design",
    "DrawnCharts": "drawings.charts",
    "DrawnFigures": "drawings.figures",
    "Edges": "designs.graph",
    "GuidePage": "start.page",
    "Identification": "recordings.identification",
    "ImportedRecording": "recordings.imported",
    "Learnt": "runs.learnt_lines",
    "LogSummary": "logs.summary",
    "LyapunovFamily": "designs.family",
    "LyapunovOrbit": "designs.orbit",
    "ModelDescription": "start.description",
    "Night": "logs.night",
    "Plan": "references.plan",
    "Planner": "references.planner",
    "Preflight": "runs.preflight_lines",
    "Proof": "designs.proof",
    "Recovery": "logs.recovery",
    "ReferenceFile": "references.reference",
    "RefinedConnection": "designs.refined",
    "Repeat": "runs.repeat_lines",
    "Replay": "recordings.replay",
    "Report": "logs.report",
    "Review": "logs.review",
    "RotatingFamilies": "designs.rotating_families",
    "RotatingOrbits": "designs.rotating_orbits",
    "Run": "runs.run_lines",
    "Score": "runs.score_lines",
    "Scores": "logs.scores",
    "SolvedWalks": "designs.solved",
    "SustainedOrbit": "designs.sustained",
    "SymbolChanges": "designs.changes",
    "SymmetricSearch": "designs.symmetric",
    "Transport": "designs.transport",
    "UdpBench": "runs.bench_lines",
    "Unscored": "logs.unscored",
    "WalkList": "designs.walks",
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
