"""The review of a run with falls shows the times on the itinerary, returning, and starting."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dpcontrol.judge.of_log import run_view
from dpcontrol.judge.score import counted, flights_of
from dpcontrol.logs import Event, Flight, joined_at, joined_text
from dpcontrol.loop.bench import Push
from dpcontrol.pages.strips import strips
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.run import run_plan


@pytest.fixture(scope="module")
def log():
    scene = load_itinerary("outer-turn").with_run({"on_fall": "resume", "lag": 0.005, "travel": 0.8}, seed=3)
    blows = (Push(1.7, 0, 0.02), Push(3.0, 1, 0.02))
    loop = replace(scene.loop, disturbances=replace(scene.loop.disturbances, explicit=blows))
    return run_plan(make_plan(replace(scene, loop=loop))).log


@pytest.mark.slow
def test_a_strip_shows_the_phases_of_a_run(log) -> None:
    view = run_view(log)
    (strip,) = [one for one in strips(view) if one.key == "motion"]
    assert [span.text for span in strip.spans] == ["itinerary", "return", "start", "itinerary"]
    assert strip.spans[0].first == 0.0
    assert strip.spans[-1].last == pytest.approx(log.time[-1])
    assert all(a.last == b.first for a, b in zip(strip.spans[:-1], strip.spans[1:], strict=True))


@pytest.mark.slow
def test_completed_symbols_have_the_times_of_the_run(log) -> None:
    view = run_view(log)
    returned = next(event.time for event in log.events if event.name == "resume" and event.time)
    # The turn failed before it fell, and was done after it had come back.
    assert view.crossings[0] is not None
    assert view.crossings[0] > returned
    assert [stay.saddle for stay in view.done] == ["down-up", "down-up"]
    (planned,) = [at for at, _ in view.plan.symbols]
    assert abs(planned - view.crossings[0]) < 0.2


def test_ticks_that_are_flown_again_do_not_count() -> None:
    flights = [Flight(0, 3000, 0.0), Flight(8000, 9000, 2.0), Flight(12_000, 15_000, 1.5)]
    parts = counted(flights, rate_hz=1000.0)
    times = np.concatenate([times for _, times in parts])
    assert [rows[0] for rows, _ in parts] == [0, 12_000]
    np.testing.assert_allclose(np.diff(times), 1e-3, atol=1e-9)
    assert times[-1] == pytest.approx(4.499)


def test_flights_are_decoded_from_the_log() -> None:
    told = joined_text(2.5, "symbol 2 of 3 ('down-up -'), attempt 4")
    assert joined_at(told) == (2.5, 2, 4)
    assert joined_at(joined_text(0.0, "lap 7")) == (0.0, 0, 0)
    assert joined_at("adaptive, ekf, 4876 ticks at 1000 Hz") is None
    events = [
        Event(0.0, "info", "resume", joined_text(0.0, "symbol 1 of 3 ('x'), attempt 1")),
        Event(3.0, "warn", "return", "tracking lost"),
        Event(9.0, "info", "resume", told),
        Event(10.0, "warn", "catch", joined_text(2.7, "symbol 2 of 3 ('down-up -'), attempt 4; caught, 0.8 s back")),
    ]
    log = SimpleNamespace(events=events, time=np.arange(12_000) / 1000, rate_hz=1000.0)
    assert flights_of(log) == (Flight(0, 3001, 0.0), Flight(9000, 10_000, 2.5), Flight(10_000, 12_000, 2.7))
