"""The charts' times, held as ratios between points of one run; what became slower is printed.

Each ratio is another method's time over the default's; accuracy is held by tests/bench/test_chart_accuracy.py.
"""

import sys

import pytest

from dpcontrol.bench.run import draw_charts

RATIOS = {
    "propagation": (
        ("trajectory of a tube", "DOP853 of scipy, 1e-12", "Taylor, 8 at once, rounding"),
        ("trajectory of a tube", "CVODES, 1e-12", "Taylor, 8 at once, rounding"),
        ("chaotic swing", "LSODA of scipy, 1e-12", "Taylor, rounding"),
        ("a tick", "DOP853 of scipy, 1e-10", "DOP853 step, compiled, 1 step"),
    ),
    "connections": (("8 connections", "chord, 0.025", "chosen, 1e-4, 100, 0.05, 3e-7"),),
    "transcription": (("one even mesh: error", "radau-7, 50 ms, fatrop", "radau-7, 50 ms"),),
}


@pytest.mark.benchmark
@pytest.mark.parametrize("name", RATIOS)
def test_defaults_stand_where_they_may_and_are_as_much_faster_as_before(name, hold, tmp_path, capsys):
    (drawn,) = draw_charts([name], tmp_path, quick=name != "connections")
    with capsys.disabled():
        sys.stdout.write(f"\n{name}: {drawn.seconds:.0f} s; {'; '.join(drawn.chart.complaints) or 'no complaint'}\n")
    for title, slower, default in RATIOS[name]:
        panel = next(p for p in drawn.chart.document()["panels"] if p["title"].startswith(title))
        seconds = {", ".join(filter(None, (p["method"], p["setting"]))): p["seconds"] for p in panel["points"]}
        ratio = seconds[slower] / seconds[default]
        with capsys.disabled():
            sys.stdout.write(f"  {title}: {slower} takes {ratio:.3g} times as long as {default}\n")
        hold(f"{title}: {slower} over {default}", ratio)
