"""The lines that a verb prints of a result.

The modules are imported when a result of theirs is printed.
"""

import json
from collections.abc import Iterable, Mapping
from importlib import import_module
from typing import Any

from dpcontrol.words.listing import listing
from dpcontrol.words.table import Line

TEXTS = {
    "Commissioning": "runs.commissioning_lines",
    "Demonstration": "start.demonstration",
    "DrawnCharts": "drawings.charts",
    "DrawnFigures": "drawings.figures",
    "GuidePage": "start.page",
    "Repeat": "runs.repeat_lines",
    "Report": "runs.report_lines",
    "Run": "runs.run_lines",
    "Score": "runs.score_lines",
    "Scores": "runs.scores_lines",
    "UdpBench": "runs.bench_lines",
}
"""Class of a result with sentences of its own -> its function as MODULE.FUNCTION within this package."""


def text_of(result: Any) -> Iterable[Line]:
    """Return the lines of a result: those of its class in `TEXTS`, otherwise entries of its JSON document.

    A mapping, such as a schema, is JSON itself.

    Args:
        result: result of a public function.
    """
    for kind in type(result).__mro__:
        if kind.__name__ in TEXTS:
            module, _, name = TEXTS[kind.__name__].partition(".")
            return getattr(import_module(f"dpcontrol.words.{module}"), name)(result)
    return [json.dumps(result, indent=1, ensure_ascii=False)] if isinstance(result, Mapping) else listing(result)
