"""Charts of `bench` whose work runs once, as their tests need no times."""

import importlib
import pkgutil
import time
from collections.abc import Callable, Mapping
from typing import Any

import pytest

import dpcontrol.bench
from dpcontrol.bench.measure import TimedWork


def time_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let each chart time one call of its work, until the end of the test."""

    def once(functions: Mapping[Any, Callable[[], Any]], *_: Any, **options: Any) -> dict[Any, TimedWork[Any]]:
        found: dict[Any, TimedWork[Any]] = {}
        for key, function in functions.items():
            began = time.perf_counter()
            result = function()
            found[key] = TimedWork(time.perf_counter() - began, result)
            if "worth" in options:
                options["worth"](key, result)
        return found

    for module in pkgutil.iter_modules(dpcontrol.bench.__path__, "dpcontrol.bench."):
        holder = importlib.import_module(module.name)
        if hasattr(holder, "timed_in_turns"):
            monkeypatch.setattr(holder, "timed_in_turns", once)
