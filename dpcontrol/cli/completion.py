"""Shell completion of values.

The values are names of models, itineraries and pages, laws, estimators, faults, saddles and figures.

Click itself completes verbs, options and choices, and the shell completes files. Names that need a heavy import are
read on demand.
"""

import importlib
import tomllib
from collections.abc import Callable, Iterable
from contextlib import suppress
from itertools import product
from typing import Any

import click
from click.shell_completion import CompletionItem

from dpcontrol.foundation.errors import InputError

Values = Callable[[click.Context], Iterable[str]]
Completer = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def completing(values: Values, *, files: bool = False) -> Completer:
    """Return a completer from values.

    Args:
        values: function of the context that returns the values.
        files: True if the shell offers files when no value matches.
    """

    def complete(context: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        found = [CompletionItem(value) for value in values(context) if value.startswith(incomplete)]
        return found or ([CompletionItem(incomplete, type="file")] if files else [])

    return complete


def _found(module: str, name: str, *given: str) -> Values:
    """Return the values of an object or a function.

    An object of a module lists them, or its function returns them for `given`.
    """

    def values(_: click.Context) -> Any:
        there = getattr(importlib.import_module(f"dpcontrol.{module}"), name)
        return there(*given) if callable(there) else there

    return values


def _saddles(context: click.Context) -> list[str]:
    """Return the equilibria of the model on the command line.

    Without a model, they are those of two arms.
    """
    from dpcontrol.foundation.shipped import find

    arms = 2
    # For an unfinished line, click keeps the arguments separately.
    name = context.params.get("model") or next(iter(context.args), "lab")
    with suppress(InputError, OSError, ValueError, LookupError, TypeError):
        model = tomllib.loads(find("models", str(name)).read_text(encoding="utf-8"))
        if model.get("system") == "three-body":
            return ["L1", "L2", "L3"]
        arms = len(model["arms"]["mass"])
    return ["-".join(names) for names in product(("down", "up"), repeat=arms)]


COMPLETERS: dict[tuple[str, str], Completer] = {
    **{
        ("", name): completing(_found("foundation.shipped", "known", "models"), files=True)
        for name in ("model", "plant", "simulated")
    },
    ("", "itinerary"): completing(_found("foundation.shipped", "known", "itineraries"), files=True),
    ("", "mapping"): completing(_found("foundation.shipped", "mappings"), files=True),
    ("", "topic"): completing(_found("foundation.guide", "topics")),
    ("", "fault"): completing(_found("rig.bench", "FAULTS")),
    ("", "controller"): completing(_found("loop.controllers", "CONTROLLERS")),
    ("", "estimator"): completing(_found("loop.controllers", "ESTIMATORS")),
    ("", "on_fall"): completing(_found("loop.result", "ON_FALL")),
    ("", "over"): completing(_found("plans.overrides", "settings_to_vary")),
    ("figures", "names"): completing(_found("cli.charts", "FIGURES")),
    ("bench", "names"): completing(_found("cli.charts", "ALL_CHARTS")),
    ("replay", "estimator"): completing(lambda _: ("ekf", "ukf")),
    ("orbit", "saddle"): completing(_saddles),
    ("walk", "through"): completing(_saddles),
    ("import", "repair"): completing(_found("recordings.checks", "REPAIRS")),
    **{
        (verb, name): completing(_saddles)
        for verb in ("connect", "bifurcations", "walk")
        for name in ("source", "target")
    },
}
"""Completers of parameters, by verb ("" for any) and by the name of the parameter."""
