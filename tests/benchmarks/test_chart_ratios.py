"""The charts, held against drawings that were stored: fronts and defaults, accuracy too; what was lost is printed.

Times are in units of a yardstick, work of scipy done in turns with what is measured, so that the drawings may be of
another machine. DPCONTROL_STORE_RATIOS=1 replaces what is stored.
"""

import json
import os
import sys
from pathlib import Path

import pytest

from dpcontrol.bench.chart import CHARTS, GROUPS
from dpcontrol.bench.run import changes, draw_charts, earlier_panels, losses

STORED = Path(__file__).parent / "charts"
KEPT = ("title", "x_label", "y_label", "floor", "judged", "timed")
OF_A_POINT = ("method", "setting", "seconds", "error", "default", "outside", "stored", "yardstick")


@pytest.mark.benchmark
@pytest.mark.parametrize("name", [name for name in CHARTS if name not in GROUPS["edges"]])
def test_defaults_are_on_their_fronts_and_as_fast_and_accurate_as_before(name, tmp_path, capsys):
    (drawn,) = draw_charts([name], tmp_path, quick=True)
    if os.environ.get("DPCONTROL_STORE_RATIOS") == "1":
        STORED.mkdir(exist_ok=True)
        (STORED / f"{name}.json").write_text(shortened(json.loads(drawn.data.read_text())))
    before = earlier_panels(STORED, name)
    lost = losses(before, drawn.chart.parts)
    moved = changes(before, drawn.chart.parts)
    with capsys.disabled():
        sys.stdout.write(f"\n{name}: {'; '.join((*complaints(drawn.chart), *lost, *moved)) or 'nothing was lost'}\n")
    assert not lost
    assert not complaints(drawn.chart)


def complaints(chart):
    """Return sentences about defaults that are off their fronts of time and accuracy."""
    return chart.complaints


def shortened(document):
    """Return the data of a drawing that a comparison needs, a line for each point."""
    panels = [
        {key: panel[key] for key in KEPT} | {"points": [{key: p[key] for key in OF_A_POINT} for p in panel["points"]]}
        for panel in document["panels"]
    ]
    head = {key: document[key] for key in ("name", "commit", "quick")}
    text = json.dumps({**head, "panels": panels}, ensure_ascii=False)
    return text.replace('{"method"', '\n  {"method"').replace('{"title"', '\n {"title"') + "\n"
