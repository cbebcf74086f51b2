"""Charts: the front, defaults judged, files whole, the verb, times of repeated work, trials of estimators and laws."""

import json
import math
from itertools import pairwise

import numpy as np
import pytest
from command_line import dpcontrol

from dpcontrol.bench import chart as registry, stages
from dpcontrol.bench.chart import ALLOWED, ChartPage, Diagram, Point
from dpcontrol.bench.control import (
    PERIOD,
    derivative_trial,
    differences,
    estimator_trial,
    held,
    noise_of,
    swing,
)
from dpcontrol.bench.drawing import draw_charts, figure
from dpcontrol.bench.measure import timed_in_turns
from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.interface import sampled_model
from dpcontrol.foundation.causes import Cause
from dpcontrol.loop.controllers import make_estimator
from dpcontrol.loop.result import BatchRun, ended
from dpcontrol.plans.model import load_model

READING = ("first", "second", "third")


def panel(*points, **more):
    return Diagram("panel", "time, s", "error", tuple(points), **more)


def points_of(pairs, default=()):
    return [Point("m", str(k), t, e, default=k in default) for k, (t, e) in enumerate(pairs)]


def test_the_front_holds_each_point_that_no_other_beats():
    rng = np.random.default_rng(4)
    # Small whole numbers make ties, which is where a front's definition matters.
    pairs = [(int(t), int(e)) for t, e in rng.integers(1, 12, (60, 2))]
    expected = {
        k for k, (t, e) in enumerate(pairs) if not any(a <= t and b <= e and (a, b) != (t, e) for a, b in pairs)
    }
    front = panel(*points_of(pairs)).front
    assert {int(p.setting) for p in front} == expected
    assert [p.seconds for p in front] == sorted(p.seconds for p in front)


@pytest.mark.parametrize("slower", [ALLOWED * 0.9, ALLOWED * 1.1])
def test_a_default_can_be_at_most_a_fifth_slower_with_a_reason(slower):
    points = points_of([(1.0, 1e-6), (1.0 + slower, 1.1e-6)], default={1})
    unexplained, explained = panel(*points), panel(*points, why="it needs no compiler")
    assert unexplained.off_front(points[1]) == pytest.approx(min(slower, 0.1))
    # Slower is judged by time or by error, whichever is nearer: here the error is within a tenth.
    assert len(unexplained.complaints()) == 1
    assert explained.complaints() == ()
    far = points_of([(1.0, 1e-6), (1.0 + slower, 1e-3)], default={1})
    assert bool(panel(*far, why="a reason").complaints()) == (slower > ALLOWED)


def test_errors_below_the_floor_count_as_equal():
    points = points_of([(1, 3e-16), (2, 1e-16)], default={1})
    assert panel(*points).front == tuple(points)
    assert panel(*points, floor=1e-14).front == (points[0],)
    assert panel(*points, floor=1e-14, why="a reason").complaints() != ()


def test_a_chart_becomes_a_picture_its_data_and_a_complaint_which_is_strictly_a_failure(monkeypatch, tmp_path):
    def chart(quick, progress):
        points = points_of([(1.0, 1e-6), (2.0, 1e-6), (3.0, 0.0)], default={1})
        return ChartPage("tiny", "Tiny", READING, "the slower one", (panel(*points),))

    monkeypatch.setattr(registry, "CHARTS", {"tiny": chart})
    monkeypatch.setattr("dpcontrol.bench.drawing.CHARTS", {"tiny": chart})
    (drawn,) = draw_charts([], tmp_path, quick=True)
    assert drawn.pictures[0].read_bytes().startswith(b"\x89PNG")
    data = json.loads(drawn.data.read_text())["panels"][0]
    assert [p["seconds"] for p in data["points"]] == [1.0, 2.0, 3.0]
    assert data["front"] == ["m, 0", "m, 2"]
    told = dpcontrol("bench", "--json", "--out", str(tmp_path))
    assert told.code == 0
    assert "100% off the front" in told.document["status"]
    failed = dpcontrol("bench", "--strict", "--out", str(tmp_path))
    assert failed.code == 1
    assert "100% off the front" in failed.message


def test_a_stage_is_timed_in_new_programs_with_their_start_and_again_in_one(monkeypatch):
    monkeypatch.setattr(stages, "STAGES", {"sum": ("sum(range(300_000))", "result / 1e12")})
    page = stages.stages_chart(True, lambda *_: None)
    (part,) = page.parts
    assert [p.setting for p in part.points] == ["empty cache", "filled cache", "later results"]
    empty, filled, later = (p.seconds for p in part.points)
    # Python and its imports take a tenth of a second at least, the sum a hundredth.
    assert min(empty, filled) > 2 * later > 0
    assert {p.error for p in part.points} == {sum(range(300_000)) / 1e12}
    assert f"{empty / filled:.2g} times as long" in part.finding()
    assert not page.complaints
    lines = [line for axes in figure(page, page.parts).axes for line in axes.lines if len(line.get_xdata()) == 3]
    assert [sorted(line.get_xdata()) for line in lines] == [sorted([empty, filled, later])]


class Machine:
    """A clock on which each call takes its own time, times what the machine makes of it at that call."""

    def __init__(self, slowness=lambda call: 1.0):
        self.now, self.calls, self.slowness = 0.0, [], slowness

    def clock(self):
        return self.now

    def work(self, name, seconds):
        def call():
            self.calls.append(name)
            self.now += seconds * self.slowness(len(self.calls))
            return name

        return call


def test_start_up_is_separated_from_repeated_time():
    # The first call compiles for 5 s; each takes 1 s, one in between 9 s.
    machine = Machine(lambda call: {1: 6.0, 3: 9.0}.get(call, 1.0))
    (found,) = timed_in_turns({"a": machine.work("a", 1.0)}, 5, least=1, most=100.0, clock=machine.clock).values()
    assert (found.first, found.seconds, found.result) == (6.0, 1.0, "a")


def test_compared_methods_alternate():
    # The machine becomes slower in the second half.
    machine = Machine(lambda call: 1.0 if call <= 12 else 2.0)
    works = {"a": machine.work("a", 1.0), "b": machine.work("b", 0.8)}
    found = timed_in_turns(works, 11, starts_up=False, clock=machine.clock)
    assert machine.calls == ["a", "b"] * 11
    assert found["b"].seconds / found["a"].seconds == pytest.approx(0.8)


FIRST_ORDER = 0.03  # Of a sampled low pass against the continuous one, at a hundredth of the sampling rate.
ARMS = load_model("lab").arms


def filtered(positions: np.ndarray, cutoff: float) -> np.ndarray:
    rates, out = np.zeros(1), []
    for last, now in pairwise(positions):
        rates = differences(rates, np.array([last]), np.array([now]), cutoff)
        out.append(rates[0])
    return np.array(out)


def test_smoothed_differences_halve_the_power_of_a_sine_at_the_cutoff():
    cutoff, t = 10.0, np.arange(4000) * PERIOD
    rates = filtered(np.sin(2 * np.pi * cutoff * t), cutoff)[1000:]
    amplitude = 2 * np.pi * cutoff
    assert np.sqrt(2) * rates.std() == pytest.approx(amplitude / np.sqrt(2), rel=FIRST_ORDER)


def ekf_trial(swings, counts):
    estimator = make_estimator(EkfSettings(augment=()), sampled_model(ARMS, 1000.0), noise=noise_of(ARMS, counts))
    return estimator_trial(estimator, swings, counts=counts)


def test_differences_need_fine_counts_and_the_filter_does_not():
    swings = [swing(ARMS, seconds=1.0, seed=0, mismatch=0.02, zero_error=0.0)]
    coarse, fine = (derivative_trial(math.inf, swings, counts=c) for c in (4000, 400_000))
    filters = [ekf_trial(swings, counts) for counts in (4000, 400_000)]
    # Without a low pass a hundred times the step is near a hundred times the noise; half a tick's delay stays.
    assert coarse.error > 10 * fine.error
    assert filters[0].error < 10 * filters[1].error
    assert filters[0].error < coarse.error / 10
    assert coarse.others == {}


def run_of(angles: np.ndarray, cause: Cause = Cause.FINISHED) -> BatchRun:
    states = np.column_stack([angles, np.zeros((len(angles), 4))])
    times = np.arange(len(angles)) * 1e-3
    return BatchRun(ended(cause, {"time": 0.0, "error": 1.0}), times, states, states, np.zeros(len(angles)), 0.95, 0.1)


def test_a_run_is_held_if_its_last_period_is_near_the_orbit_up_to_phase_and_turns():
    phase = np.linspace(0, 2 * np.pi, 1000, endpoint=False)
    orbit = np.column_stack([np.sin(phase), np.pi + 0.3 * np.cos(phase)])
    judge = held(orbit, period=1.0)
    twice = np.vstack([orbit, np.roll(orbit, 300, axis=0)])
    assert judge(run_of(twice))
    for shift, expected in ((4 * np.pi, True), (0.09, True), (0.9, False)):
        assert judge(run_of(twice + np.array([0.0, shift]))) is expected
    assert not judge(run_of(twice, Cause.TRACKING_LOST))
    early_only = np.vstack([orbit + 1.0, orbit])
    assert judge(run_of(early_only))
