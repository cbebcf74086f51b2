"""Times of repeated work: in turns, the first call apart, the clock of this process only."""

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
    assert (found.first, found.seconds, found.result) == (6.0, 1.0, "a")


def test_compared_methods_alternate():
    # The machine becomes slower in the second half.
    machine = Machine(lambda call: 1.0 if call <= 12 else 2.0)
    works = {"a": machine.work("a", 1.0), "b": machine.work("b", 0.8)}
    found = timed_in_turns(works, 11, starts_up=False, clock=machine.clock)
    assert machine.calls == ["a", "b"] * 11
    assert found["b"].seconds / found["a"].seconds == pytest.approx(0.8)
