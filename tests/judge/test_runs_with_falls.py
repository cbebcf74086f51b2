"""Of a run with falls, the flights count that no later one repeats."""

from types import SimpleNamespace

import numpy as np
import pytest

from dpcontrol.judge.score import counted, flights_of
from dpcontrol.logs import Event, Flight, joined_at, joined_text


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
