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
    "CacheContents": "start.cache",
    "CampaignSummary": "logs.campaign",
    "Configuration": "start.configuration",
    "Demonstration": "start.demonstration",
    "Design": "recordings.design",
    "DrawnCharts": "drawings.charts",
    "DrawnFigures": "drawings.figures",
    "Identification": "recordings.identification",
    "ImportedRecording": "recordings.imported",
    "LogSummary": "logs.summary",
    "ModelDescription": "start.description",
    "Night": "logs.night",
    "Page": "start.page",
    "Plan": "references.plan",
    "Planner": "references.planner",
    "Recovery": "logs.recovery",
    "ReferenceFile": "references.reference",
    "Replay": "recordings.replay",
    "Report": "logs.report",
    "Review": "logs.review",
    "Score": "runs.score_lines",
    "Scores": "logs.scores",
    "Unscored": "logs.unscored",
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
