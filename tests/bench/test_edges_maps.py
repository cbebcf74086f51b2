"""Borders by bisection, and complaints about disagreement, unreported failures and missing borders."""

import json
import math

import pytest

from dpcontrol.bench.chart import AGREES, GROUPS, Attempt, Border, EdgeChart, EdgeMap, check_names, find_border, half_of
from dpcontrol.bench.drawing import figure
from dpcontrol.foundation.errors import InputError

BORDER = 0.37


def below(border: float = BORDER, says: str = "too much"):
    return lambda y: Attempt(y < border, says)


def one_map(*borders: Border, **more) -> EdgeMap:
    return EdgeMap("a map", "x", "y", tuple(borders), **more)


@pytest.mark.parametrize(("near", "far"), [(0.01, 5.0), (5.0, 0.01)])
def test_the_border_lies_between_its_sides_whichever_is_larger(near, far):
    works = below() if near < far else (lambda y: Attempt(y > BORDER, "too little"))
    found = find_border(works, x=1.0, line="", near=near, far=far, ratio=1.05)
    assert min(found.near, found.far) <= BORDER <= max(found.near, found.far)
    assert max(found.near / found.far, found.far / found.near) <= 1.05
    assert found.measured == pytest.approx(BORDER, rel=0.05)
    assert found.says


def test_whole_units_are_tried_down_to_neighbours():
    tried = []

    def probe(y):
        tried.append(y)
        return Attempt(y < 0.0405, "late")

    found = find_border(probe, x=1.0, line="", near=0.005, far=0.2, ratio=1.0001, unit=1e-3)
    assert (found.near, found.far) == (pytest.approx(0.040), pytest.approx(0.041))
    assert all(y / 1e-3 == pytest.approx(round(y / 1e-3), abs=1e-9) for y in tried)


def test_a_missing_side_is_none_without_an_invented_number():
    nothing, everything = (
        find_border(below(b), x=1.0, line="", near=0.1, far=1.0, predicted=0.3) for b in (0.0, math.inf)
    )
    assert (nothing.near, nothing.far, nothing.measured) == (None, 0.1, None)
    assert (everything.near, everything.far, everything.measured) == (1.0, None, None)
    assert "no border, predicted at 0.3" in one_map(nothing).complaints()[0]
    assert "no border, predicted at 0.3" in one_map(everything).complaints()[0]


@pytest.mark.parametrize("share", [-AGREES, -0.1, 0.1, AGREES])
def test_a_prediction_is_judged_by_how_far_it_is_from_the_border(share):
    for slack, complains in ((0.8, False), (1.3, True)):
        factor = 1 + abs(share) * slack
        predicted = BORDER * factor if share > 0 else BORDER / factor
        found = find_border(below(), x=1.0, line="l", near=0.01, far=5.0, predicted=predicted, ratio=1.0005)
        assert found.off == pytest.approx(abs(share) * slack, abs=2e-3)
        assert bool(one_map(found).complaints()) == (complains and abs(share) == AGREES)


def test_an_unreported_far_side_is_a_complaint():
    found = find_border(below(says=""), x=1.0, line="l", near=0.01, far=5.0)
    assert "is not reported" in one_map(found).complaints()[0]


def test_half_of_the_answers_decide_and_one_answer_with_a_text_explains_the_rest():
    silent, works, says = Attempt(False), Attempt(True), Attempt(False, "tracking lost")
    assert half_of([works, silent], "runs lost").works
    assert half_of([works, silent, says], "runs lost") == Attempt(False, "2 of 3 runs lost; tracking lost")
    # An unreported failure remains a complaint.
    assert half_of([silent, silent, works], "runs lost") == Attempt(False, "")


def test_a_chart_of_maps_is_json_and_a_picture(tmp_path):
    found = find_border(below(), x=2.0, line="two", near=0.01, far=5.0, predicted=0.4)
    none = find_border(below(0.0), x=3.0, line="three", near=0.1, far=1.0)
    chart = EdgeChart("edges-x", "title", ("1", "2", "3"), "chosen", (one_map(found, none, theory="a rule"),))
    text = json.dumps(chart.document(), allow_nan=False)
    borders = json.loads(text)["maps"][0]["borders"]
    assert borders[0]["measured"] == pytest.approx(BORDER, rel=0.1)
    assert borders[1]["measured"] is None
    figure(chart, chart.parts).savefig(tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 1000
    assert len(chart.parts[0].table().rows) == 2


def test_edges_represent_all_maps_of_failure():
    assert check_names(("edges",)) == GROUPS["edges"]
    assert len(GROUPS["edges"]) > 3
    assert check_names(("edges-moving", "edges"))[0] == "edges-moving"
    with pytest.raises(InputError, match="edges"):
        check_names(("edge",))


def test_a_finding_has_the_range_of_borders():
    never = Border(1.0, "k = 1", None, 4e8, None, "lost", ())
    borders = (
        never,
        *(Border(x, f"k = {x:g}", 1.1 * y, y / 1.1, None, "lost", ()) for x, y in ((2, 1.64e6), (16, 618.0))),
    )
    assert one_map(*borders, far="lost").finding() == "lost at 618 to 1.64e+06"
