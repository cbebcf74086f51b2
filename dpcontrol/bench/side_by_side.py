"""Times of several short functions in turns, so that a machine that slows down for a while slows all of them."""

import statistics
import time
from collections.abc import Callable, Hashable, Mapping
from typing import TypeVar

from dpcontrol.bench.measure import Timed

Key = TypeVar("Key", bound=Hashable)

_GRAIN = 1e-3
"""s: what one measurement takes at least."""


def timed_in_turns(functions: Mapping[Key, Callable[[], object]], rounds: int = 15) -> dict[Key, Timed[None]]:
    """Return each function's median processor time of a call over the rounds, its first call's extra time apart."""
    clock = time.process_time
    first, calls = {}, {}
    for key, function in functions.items():
        first[key] = _spent(function, 1, clock)
        once = _spent(function, 20, clock)
        calls[key] = max(1, round(_GRAIN / once)) if once > 0 else 1000
    found: dict[Key, list[float]] = {key: [] for key in functions}
    for _ in range(rounds):
        for key, function in functions.items():
            found[key].append(_spent(function, calls[key], clock))
    medians = {key: statistics.median(times) for key, times in found.items()}
    return {key: Timed(seconds, max(first[key] - seconds, 0.0), None) for key, seconds in medians.items()}


def _spent(function: Callable[[], object], calls: int, clock: Callable[[], float]) -> float:
    began = clock()
    for _ in range(calls):
        function()
    return (clock() - began) / calls
