"""Times of repeated work: in turns, the first call apart, the clock of this process only."""

import time

import pytest

from dpcontrol.bench.measure import timed_in_turns


def timed(function, rounds, **more):
    return timed_in_turns({None: function}, rounds, **{"least": 1, **more})[None]


class Machine:
    """A clock on which each call takes its own time, times what the machine makes of it at that call."""

    def __init__(self, slowness=lambda call: 1.0):
        self.now, self.calls, self.slowness = 0.0, [], slowness

    def clock(self):
        return self.now

    def yardstick(self):
        return 1e-3 * self.slowness(len(self.calls))

    @property
    def own(self):
        return {"clock": self.clock, "beside": self.yardstick}

    def work(self, name, seconds):
        def call():
            self.calls.append(name)
            self.now += seconds * self.slowness(len(self.calls))
            return name

        return call


def test_start_up_is_separated_from_repeated_time():
    # The first call compiles for 5 s; each takes 1 s, one in between 9 s.
    machine = Machine(lambda call: {1: 6.0, 3: 9.0}.get(call, 1.0))
    found = timed(machine.work("a", 1.0), 5, most=100.0, clock=machine.clock, beside=lambda: 1e-3)
    assert (found.seconds, found.start_up, found.result) == (1.0, 5.0, "a")


def test_slow_work_is_not_repeated_beyond_its_time_limit():
    machine = Machine()
    assert timed(machine.work("a", 3.0), 50, most=5.0, **machine.own).seconds == 3.0
    assert len(machine.calls) == 3


def test_work_shorter_than_the_clocks_grain_is_repeated_within_a_measurement():
    calls = []
    found = timed(lambda: calls.append(1), 3, grain=1e-3)
    assert len(calls) > 300
    assert 0 < found.seconds < 1e-4


def test_the_clock_of_other_programs_does_not_count():
    assert timed(lambda: time.sleep(0.02), 1).seconds < 0.01


def slow_in_the_second_half(call):
    return 1.0 if call <= 12 else 2.0


def test_compared_methods_alternate():
    machine = Machine(slow_in_the_second_half)
    works = {"a": machine.work("a", 1.0), "b": machine.work("b", 0.8)}
    found = timed_in_turns(works, 11, starts_up=False, clock=machine.clock, beside=lambda: 1e-3)
    assert machine.calls == ["a", "b"] * 11
    assert found["b"].seconds / found["a"].seconds == pytest.approx(0.8)


def test_short_work_measured_while_the_machine_is_slow_counts_as_what_it_takes_otherwise():
    machine = Machine(lambda call: 2.0 if call % 7 < 3 else 1.0)
    found = timed(machine.work("a", 0.02), 15, most=100.0, **machine.own)
    assert found.seconds / found.yardstick == pytest.approx(20.0)
    # By the clock alone, it depends on which of the calls were slow.
    raw = Machine(lambda call: 2.0 if call > 2 else 1.0)
    assert timed(raw.work("a", 0.02), 15, most=100.0, clock=raw.clock, beside=lambda: 1e-3).seconds == pytest.approx(
        0.04
    )


def test_long_work_has_the_time_of_the_clock():
    # A yardstick tells only of how quick the machine was at its ends.
    machine = Machine()
    found = timed(machine.work("a", 1.0), 5, most=100.0, clock=machine.clock, beside=iter(range(1, 1000)).__next__)
    assert found.seconds == 1.0


def test_slow_work_leaves_the_turns_early_but_not_before_its_least():
    machine = Machine()
    timed_in_turns(
        {"slow": machine.work("slow", 10.0), "quick": machine.work("quick", 0.5)}, 9, most=3.0, least=3,
        starts_up=False, **machine.own,
    )  # fmt: skip
    assert machine.calls.count("slow") == 3
    assert machine.calls.count("quick") == 6


def test_uninteresting_work_is_called_once():
    machine = Machine()
    found = timed_in_turns(
        {"fails": machine.work("fails", 2.0), "works": machine.work("works", 1.0)}, 4,
        worth=lambda key, result: result == "works", **machine.own,
    )  # fmt: skip
    assert machine.calls.count("fails") == 1
    assert found["fails"].result == "fails"
    assert machine.calls.count("works") == 5


def test_progress_rises_from_first_calls_through_the_rounds():
    machine, told = Machine(), []
    works = {name: machine.work(name, 1.0) for name in "ab"}
    timed_in_turns(works, 3, progress=lambda what, done: told.append((what, done)), **machine.own)
    assert [what for what, _ in told] == [
        "first call 1 of 2",
        "first call 2 of 2",
        *(f"round {k} of 3" for k in (1, 2, 3)),
    ]
    shares = [done for _, done in told]
    assert shares == sorted(shares)
    assert 0 <= shares[0] < shares[-1] < 1
