"""Of a run with falls, the flights count that no later one repeats."""

from types import SimpleNamespace

import numpy as np
import pytest

from dpcontrol.foundation.causes import Cause
from dpcontrol.foundation.errors import InputError
from dpcontrol.judge.score import counted, stretches_of
from dpcontrol.logs import Event, Stretch


def test_ticks_that_are_flown_again_do_not_count() -> None:
    flights = [Stretch(0, 3000, 0.0), Stretch(8000, 9000, 2.0), Stretch(12_000, 15_000, 1.5)]
    parts = counted(flights, rate_hz=1000.0)
    times = np.concatenate([times for _, times in parts])
    assert [rows[0] for rows, _ in parts] == [0, 12_000]
    np.testing.assert_allclose(np.diff(times), 1e-3, atol=1e-9)
    assert times[-1] == pytest.approx(4.499)


def test_flights_are_decoded_from_the_log() -> None:
    symbol = {"symbol": 2, "symbols": 3, "name": "down-up -", "attempt": 4}
    events = [
        Event(0.0, "info", "resume", Cause.JOINED, {**symbol, "at": 0.0, "symbol": 1}),
        Event(3.0, "warn", "return", Cause.TRACKING_LOST),
        Event(9.0, "info", "resume", Cause.JOINED, {**symbol, "at": 2.5}),
        Event(10.0, "warn", "catch", Cause.JOINED, {**symbol, "at": 2.7, "back": 0.8}),
    ]
    log = SimpleNamespace(events=events, time=np.arange(12_000) / 1000, rate_hz=1000.0)
    assert stretches_of(log) == (Stretch(0, 3001, 0.0), Stretch(9000, 10_000, 2.5), Stretch(10_000, 12_000, 2.7))


def test_a_log_whose_events_have_no_causes_is_refused() -> None:
    told = Event(9.0, "info", "resume", words="on the itinerary from t = 2.5 s of the reference: symbol 2 of 3")
    log = SimpleNamespace(path="old.mcap", events=[told], time=np.arange(12_000) / 1000, rate_hz=1000.0)
    with pytest.raises(InputError, match="run it again"):
        stretches_of(log)
