"""Benchmarks in a small size: the same checks except for time, with little of the work.

The constants of a benchmark set its size and its aims. Here some are replaced, and aims of time become bounds that
every machine meets. Small sizes are slow tests, so a broken benchmark is detected at once.
"""

import importlib
import inspect
import math
from collections.abc import Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest


@dataclass(frozen=True)
class Small:
    """A benchmark's function, its constants in a small size, and arguments in place of its parameters."""

    module: str
    function: str
    constants: Mapping[str, Any] = field(default_factory=dict)
    arguments: Mapping[str, Any] = field(default_factory=dict)


SIZES = [
    Small(
        "test_walk_cost",
        "test_cost_grows_with_the_number_of_symbols_and_no_faster",
        {"LENGTHS": (2, 4), "WALKS": 1, "PER_DOUBLING": math.inf},
    ),
    Small(
        "test_walk_cost",
        "test_all_random_walks_become_the_requested_orbits",
        arguments={"count": 6, "lengths": (1, 4), "periodic": False},
    ),
    Small(
        "test_walk_cost",
        "test_all_random_walks_become_the_requested_orbits",
        arguments={"count": 2, "lengths": (1, 3), "periodic": True},
    ),
    Small(
        "test_tube_speed",
        "test_tube_trajectories_are_150_times_faster_than_dop853_and_nearer_to_the_truth",
        {"COUNT": 40, "ROUNDS": 2, "EXAMINED": 4, "FASTER": 0},
    ),
    Small(
        "test_estimators", "test_time_of_a_tick_by_kind_and_extras", {"EXTRAS": [()], "FASTER": 0.0, "TOGETHER": 0.0}
    ),
    Small("test_killed_runs", "test_killed_runs_lose_no_more_than_twenty_five_milliseconds", {"KILLS": 2}),
    Small("test_logging", "test_fifty_kills_leave_fifty_readable_logs", {"KILLS": 2}),
    Small("test_logging", "test_five_hundred_corruptions_are_detected_or_recovered", {"CORRUPTIONS": 12}),
]


@pytest.mark.slow
@pytest.mark.parametrize("small", SIZES, ids=lambda s: f"{s.module}-{s.function}-{len(s.arguments)}")
def test_a_benchmark_checks_in_a_small_size_all_but_time(
    small: Small, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = importlib.import_module(small.module)
    for name, value in small.constants.items():
        # A constant of another name would leave the whole work to be done.
        monkeypatch.setattr(module, name, value, raising=True)
    with ExitStack() as stack:
        known: dict[str, Any] = {"hold": lambda *_: None, **small.arguments}
        function = getattr(module, small.function)
        values = {name: made(name, module, request, known, stack) for name in inspect.signature(function).parameters}
        function(**values)


def made(name: str, module: Any, request: pytest.FixtureRequest, known: dict[str, Any], stack: ExitStack) -> Any:
    """Return the value of a fixture: of the benchmark's own module, or one that pytest knows here."""
    if name not in known:
        own = getattr(module, name, None)
        if own is None or not hasattr(own, "_get_wrapped_function"):
            known[name] = request.getfixturevalue(name)
        else:
            function = own._get_wrapped_function()
            needed = [made(one, module, request, known, stack) for one in inspect.signature(function).parameters]
            if inspect.isgeneratorfunction(function):
                known[name] = stack.enter_context(contextmanager(function)(*needed))
            else:
                known[name] = function(*needed)
    return known[name]
