"""Shell completion of values.

The values are names of models, itineraries and pages, laws, estimators, faults, saddles, sections and figures.

Click itself completes verbs, options and choices, and the shell completes files. Names that need a heavy import are
read on demand.
"""

import importlib
import warnings
from collections.abc import Callable, Iterable
from contextlib import suppress
from itertools import permutations
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from dpcontrol.foundation.errors import InputError

if TYPE_CHECKING:
    from dpcontrol.dynamics.system import System

Values = Callable[[click.Context, str], Iterable[str]]
"""Function of the context, and of the part of the word before the value."""
Completer = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def completing(values: Values, *, files: bool = False, listed: bool = False) -> Completer:
    """Return a completer from values.

    Args:
        values: function that returns the values.
        files: True if the shell offers files when no value matches.
        listed: True if a value can follow a comma or an equals sign.
    """

    def complete(context: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        before = incomplete[: max(map(incomplete.rfind, ",=")) + 1] if listed else ""
        found: list[CompletionItem] = []
        # Unknown names have no values, and messages would garble the command line.
        with suppress(InputError), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            words = (before + value for value in values(context, before))
            found = [CompletionItem(word) for word in words if word.startswith(incomplete)]
        return found or ([CompletionItem(incomplete, type="file")] if files else [])

    return complete


def _found(module: str, name: str, *given: str) -> Values:
    """Return the values of an object or a function.

    An object of a module lists them, or its function returns them for `given`.
    """

    def values(*_: Any) -> Any:
        there = getattr(importlib.import_module(f"dpcontrol.{module}"), name)
        return there(*given) if callable(there) else there

    return values


def _settings(_: click.Context, given: str) -> Iterable[str]:
    from dpcontrol.plans.overrides import settings_to_vary

    return settings_to_vary(given)


def _system(context: click.Context) -> "System":
    """Return the system of the model on the command line.

    Without a model, it is that of the lab.
    """
    from dpcontrol.plans.model import load_model

    # For an unfinished line, click keeps the arguments separately.
    for name in (context.params.get("model"), *context.args):
        with suppress(InputError):
            return load_model(str(name)).system
    return load_model("lab").system


def _saddles(context: click.Context, _: str) -> Iterable[str]:
    return _system(context).saddles


def _sections(context: click.Context, _: str) -> Iterable[str]:
    return _system(context).named_sections


def _symbols(context: click.Context, _: str) -> Iterable[str]:
    saddles = _system(context).saddles
    return [
        *(f"{saddle} {sense}" for saddle in saddles for sense in "+-"),
        *(f"{source} > {target}" for source, target in permutations(saddles, 2)),
    ]


COMPLETERS: dict[tuple[str, str], Completer] = {
    **{
        ("", name): completing(_found("foundation.shipped", "known", "models"), files=True)
        for name in ("model", "plant", "simulated")
    },
    ("", "itinerary"): completing(_found("foundation.shipped", "known", "itineraries"), files=True),
    ("", "mapping"): completing(_found("foundation.shipped", "mappings"), files=True),
    ("", "topic"): completing(_found("foundation.guide", "topics")),
    ("", "faults"): completing(_found("rig.bench", "FAULTS")),
    ("", "controller"): completing(_found("loop.controllers", "CONTROLLERS")),
    ("", "estimator"): completing(_found("loop.controllers", "ESTIMATORS")),
    ("", "on_fall"): completing(_found("loop.result", "ON_FALL")),
    ("", "over"): completing(_settings, listed=True),
    ("", "rig"): completing(lambda *_: ("udp",), files=True),
    ("", "section"): completing(_sections),
    ("", "saddle"): completing(_saddles),
    ("", "symbols"): completing(_symbols),
    ("figures", "names"): completing(_found("pages.figures", "FIGURES")),
    ("bench", "names"): completing(_found("bench.chart", "NAMES")),
    ("walk", "through"): completing(_saddles),
    ("import", "repairs"): completing(_found("recordings.checks", "REPAIRS"), listed=True),
    **{
        (verb, name): completing(_saddles)
        for verb in ("connect", "bifurcations", "walk", "prove")
        for name in ("source", "target")
    },
}
"""Completers of parameters, by verb ("" for any) and by the name of the parameter."""
