"""Borders by bisection, and complaints about disagreement, unreported failures and missing borders."""

import math

import pytest

from dpcontrol.bench.chart import AGREES, Attempt, Border, EdgeMap, find_border

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
    assert one_map(nothing).complaints()
    assert one_map(everything).complaints()


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
