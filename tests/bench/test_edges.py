"""Maps of limits: borders lie where runs fail, and predictions are judged by them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from command_line import dpcontrol

from dpcontrol.bench import energies
from dpcontrol.bench.chart import AGREES, Attempt, Border, EdgeMap, find_border
from dpcontrol.bench.edges import (
    WEAK,
    arriving,
    lost_border,
    moving,
)
from dpcontrol.plans.model import load_model

BORDER = 0.37


def below(border: float = BORDER):
    return lambda y: Attempt(y < border, "too much")


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


RATE = 50.0
BESIDE = 0.05  # rad: what encoders and the held input leave; in the longest delay the arms turn through a radian


def test_commands_on_their_way_at_the_start_belong_to_where_the_motion_leads():
    """However late commands act, a motion that begins on its reference stays there."""
    assert replace(moving(RATE), near=BESIDE).run(acceleration=WEAK, error=0.0, delay=0.2).works


APART = 0.25  # the bar
LAB = load_model("lab")


@pytest.mark.parametrize("rate", [50.0, 200.0])
def test_half_of_many_drawn_runs_see_a_gap_at_the_predicted_share(rate):
    missing, seconds = 0.1, 10.0
    p = 1 - arriving(rate, missing=missing, seconds=seconds) / rate
    gap, ticks = math.floor(missing * rate + 1e-9) + 1, round(seconds * rate)
    lost = np.random.default_rng(3).uniform(size=(1000, ticks)) < p
    windows = np.lib.stride_tricks.sliding_window_view(lost, gap, axis=1)
    share = windows.all(axis=2).any(axis=1).mean()
    # 1,000 draws: ±0.03 at two standard deviations; gaps are not quite independent at so few ticks.
    assert share == pytest.approx(0.5, abs=0.08)


@pytest.mark.slow
def test_runs_end_at_the_predicted_share_of_lost_samples():
    found = lost_border(LAB.arms, LAB.system.equilibrium("down-up"), rate=60.0, seeds=5)
    assert found.off < APART


@pytest.mark.slow
def test_energies_of_an_itinerary_are_compared_in_closed_loop(tmp_path, monkeypatch) -> None:
    """Slow: plans and flies an itinerary at two energies."""
    monkeypatch.setattr(energies, "ENERGIES", (0.65, 1.0))
    monkeypatch.setattr(energies, "RUNS", 4)
    picture = tmp_path / "energies.png"
    ended = dpcontrol("plan", "outer-turn", "--explore-energy", str(picture), "--json")
    assert ended.code == 0, ended.stderr
    found = ended.document["energies"]
    assert "choice" in found["chosen"]
    assert picture.read_bytes().startswith(b"\x89PNG")
    loops = [p for p in found["panels"][0]["points"] if p["method"] == "loop"]
    assert len(loops) == 2
    assert all(p["error"] > p["others"]["reference"] for p in loops)
