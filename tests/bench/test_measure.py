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

    def work(self, name, seconds):
        def call():
            self.calls.append(name)
            self.now += seconds * self.slowness(len(self.calls))
            return name

        return call


def test_start_up_is_separated_from_repeated_time():
    # The first call compiles for 5 s; each takes 1 s, one in between 9 s.
    machine = Machine(lambda call: {1: 6.0, 3: 9.0}.get(call, 1.0))
    found = timed(machine.work("a", 1.0), 5, most=100.0, clock=machine.clock)
    assert (found.seconds, found.start_up, found.result) == (1.0, 5.0, "a")


def test_slow_work_is_not_repeated_beyond_its_time_limit():
    machine = Machine()
    assert timed(machine.work("a", 3.0), 50, most=5.0, clock=machine.clock).seconds == 3.0
    assert len(machine.calls) == 3


def test_work_shorter_than_the_clocks_grain_is_repeated_within_a_measurement():
    calls = []
    found = timed(lambda: calls.append(1), 3)
    assert len(calls) > 300
    assert 0 < found.seconds < 1e-4


def test_the_clock_of_other_programs_does_not_count():
    assert timed(lambda: time.sleep(0.02), 1).seconds < 0.01


def slow_in_the_second_half(call):
    return 1.0 if call <= 12 else 2.0


def test_compared_methods_alternate():
    machine = Machine(slow_in_the_second_half)
    works = {"a": machine.work("a", 1.0), "b": machine.work("b", 0.8)}
    found = timed_in_turns(works, 11, starts_up=False, clock=machine.clock)
    assert machine.calls == ["a", "b"] * 11
    assert found["b"].seconds / found["a"].seconds == pytest.approx(0.8)


def test_slow_work_leaves_the_turns_early_but_not_before_its_least():
    machine = Machine()
    timed_in_turns(
        {"slow": machine.work("slow", 10.0), "quick": machine.work("quick", 0.5)}, 9, most=3.0, least=3,
        starts_up=False, clock=machine.clock,
    )  # fmt: skip
    assert machine.calls.count("slow") == 3
    assert machine.calls.count("quick") == 6


def test_uninteresting_work_is_called_once():
    machine = Machine()
    found = timed_in_turns(
        {"fails": machine.work("fails", 2.0), "works": machine.work("works", 1.0)}, 4,
        worth=lambda key, result: result == "works", clock=machine.clock,
    )  # fmt: skip
    assert machine.calls.count("fails") == 1
    assert found["fails"].result == "fails"
    assert machine.calls.count("works") == 5


def test_progress_rises_from_first_calls_through_the_rounds():
    machine, told = Machine(), []
    works = {name: machine.work(name, 1.0) for name in "ab"}
    timed_in_turns(works, 3, progress=lambda what, done: told.append((what, done)), clock=machine.clock)
    assert [what for what, _ in told] == [
        "first call 1 of 2",
        "first call 2 of 2",
        *(f"round {k} of 3" for k in (1, 2, 3)),
    ]
    shares = [done for _, done in told]
    assert shares == sorted(shares)
    assert 0 <= shares[0] < shares[-1] < 1
