"""The summary of a long run agrees with a count by hand: times on and off the itinerary, and causes."""

from pathlib import Path

import pytest

from dpcontrol.foundation.causes import Cause
from dpcontrol.judge.night import BETWEEN, BRAKING, FLYING, ITINERARY, Night, followed
from dpcontrol.logs import Event
from dpcontrol.logs.rolling import Digest

Events = list[tuple[float, str, str, Cause]]
FIGURES = dict.fromkeys(
    ("at", "symbol", "symbols", "attempt", "lap", "time", "error", "repeated", "seconds", "stop", "stop_name"), 1
)


def digest(number: int, first: float, events: Events, *, on: bool = True, zero: float = 0.0, **more: float) -> Digest:
    one = Digest(number, first=first, end=first + 600, ticks=600_000, on=on, limit=0.4, cart=0.3, **more)  # type: ignore[arg-type]
    for event in events:
        one.add_event(Event(*event, FIGURES))
    one.extras, one.size = {"zero_1": (zero, 1e-3)}, 1
    one.squares, one.followed, one.memory = 600_000 * 2 * 0.01**2, 600_000, 4e8 + number * 1e6
    return one


def night(folder: Path = Path("turn-0")) -> Night:
    """Two files, one missing, a fourth; two falls before one way back, a sensor that sticks, laps of both kinds."""
    flight = ("info", "flight", Cause.FLOWN)
    first: Events = [
        (0.0, "info", "start", Cause.BEGUN), (0.0, "info", "resume", Cause.JOINED), (50.0, "info", "lap", Cause.JOINED),
        (100.0, "warn", "return", Cause.TRACKING_LOST), (107.0, *flight),
        (108.0, "warn", "flight", Cause.TRACKING_LOST), (116.0, *flight),
        (120.0, "info", "resume", Cause.JOINED),
    ]  # fmt: skip
    second: Events = [
        (700.0, "info", "return", Cause.LAP_DONE), (706.0, *flight),
        (710.0, "info", "lap", Cause.JOINED), (1195.0, "warn", "return", Cause.STUCK),
    ]  # fmt: skip
    third: Events = [
        (1800.0, "info", "start", Cause.BEGUN), (1800.0, "info", "resume", Cause.JOINED),
        (2399.999, "info", "finished", Cause.TIME_OVER),
    ]  # fmt: skip
    digests = (
        digest(1, 0.0, first, on=False), digest(2, 600.0, second, zero=0.001),
        digest(4, 1800.0, third, on=False, zero=0.003, session=2),
    )  # fmt: skip
    return Night(folder, digests, (), *followed(digests))


def test_uptime_is_the_time_between_joining_and_leaving() -> None:
    told = night()
    times = told.document()["seconds"]
    on = 100 + (700 - 120) + (1195 - 710) + 599.999
    assert times == pytest.approx({ITINERARY: on, BRAKING: 15 + 5, FLYING: 5, BETWEEN: 10}, abs=0.01)
    assert told.uptime == pytest.approx(on / 1800, abs=1e-4)
    assert told.known == pytest.approx(1800)


def test_a_flight_that_fails_is_no_second_fall() -> None:
    told = night()
    assert [fall.back for fall in told.falls] == [20.0, None]
    assert told.causes == {"tracking lost": 1, "sensor stuck": 1}
    assert told.falls_per_hour == pytest.approx(4.0)
    assert told.repetitions == 2
    document = told.document()
    assert (document["return_median"], document["return_99"]) == (20.0, 20.0)
    # The fall that the lost file hides the end of.
    assert document["not_back"] == 1
    assert document["sessions"] == 2
    assert document["not_logged"] == [{"first": 1200.0, "end": 1800.0}]


def test_drift_and_tracking_are_those_of_the_files() -> None:
    told = night()
    (drift,) = told.drifts
    assert (drift.first, drift.last) == (0.0, 0.003)
    assert drift.per_hour == pytest.approx(0.006, rel=0.1)
    assert told.tracking == pytest.approx(0.01)
    assert told.cart == 0.3
