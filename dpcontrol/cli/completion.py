"""Shell completion of values.

The values are names of models, itineraries and pages, laws, estimators, faults, saddles, sections and figures.

Click itself completes verbs, options and choices, and the shell completes files. Names that need a heavy import are
read on demand.
"""

import warnings
from collections.abc import Callable, Iterable
from contextlib import suppress
from itertools import permutations
from typing import Any

import click
from click.shell_completion import CompletionItem

from dpcontrol.foundation import shipped
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.guide import topics
from dpcontrol.foundation.parts import StageModule

Values = Callable[[click.Context, str], Iterable[str]]
"""Function of the context, and of the part of the word before the value."""
Completer = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def completing(values: Values, *, files: bool = False, listed: bool = False) -> Completer:
    """Return click's completer of a parameter, made from its possible values.

    Args:
        values: function that returns the values.
        files: True if the shell offers files when no value matches.
        listed: True if a value can follow a comma or an equals sign.
    """

    def complete(context: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return the words, or click's marker for files, that can complete `incomplete`, as `values` gives them.

        If the parameter is `listed`, the completed entries of the list stay before each value.
        """
        prefix = incomplete[: max(map(incomplete.rfind, ",=")) + 1] if listed else ""
        items: list[CompletionItem] = []
        # Unknown names have no values, and messages would garble the command line.
        with suppress(InputError), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            words = (prefix + value for value in values(context, prefix))
            items = [CompletionItem(word) for word in words if word.startswith(incomplete)]
        return items or ([CompletionItem(incomplete, type="file")] if files else [])

    return complete


def _system(context: click.Context) -> Any:
    """Return the `System` of the model on the command line, whose saddles and sections can complete a word.

    Without a model, it is that of the lab.
    """
    model = StageModule("plans.model")
    # For an unfinished line, click keeps the arguments separately.
    for name in (context.params.get("model"), *context.args):
        with suppress(InputError):
            return model.load_model(str(name)).system
    return model.load_model("lab").system


def _symbols(context: click.Context, _: str) -> Iterable[str]:
    """Return all symbols of walks between the saddles of the system, such as "down-up +" and "down-up > up-down"."""
    saddles = _system(context).saddles
    return [
        *(f"{saddle} {sense}" for saddle in saddles for sense in "+-"),
        *(f"{source} > {target}" for source, target in permutations(saddles, 2)),
    ]


def _named(module: str, name: str) -> Values:
    """Return a function for `completing` that gives the values which a module of the package lists.

    Args:
        module: module below the package, imported when a word is completed.
        name: name of the list in the module.
    """
    return lambda *_: getattr(StageModule(module), name)


def _shipped(kind: str) -> Completer:
    """Return a completer of the names of models or itineraries (`kind`), or of files."""
    return completing(lambda *_: shipped.shipped_names(kind), files=True)


_SADDLES = completing(lambda context, _: _system(context).saddles)
COMPLETERS: dict[tuple[str, str], Completer] = {
    **{("", name): _shipped("models") for name in ("model", "plant", "simulated")},
    ("", "itinerary"): _shipped("itineraries"),
    ("", "mapping"): completing(lambda *_: shipped.mappings(), files=True),
    ("", "topic"): completing(lambda *_: topics()),
    ("", "faults"): completing(_named("rig.bench", "FAULTS")),
    ("", "controller"): completing(_named("loop.controllers", "CONTROLLERS")),
    ("", "estimator"): completing(_named("loop.controllers", "ESTIMATORS")),
    ("", "on_fall"): completing(_named("loop.result", "ON_FALL")),
    ("", "over"): completing(lambda _, given: StageModule("plans.overrides").settings_to_vary(given), listed=True),
    ("", "rig"): completing(lambda *_: ("udp",), files=True),
    ("", "section"): completing(lambda context, _: _system(context).named_sections),
    ("", "saddle"): _SADDLES,
    ("", "symbols"): completing(_symbols),
    ("figures", "names"): completing(_named("pages.figures", "FIGURES")),
    ("bench", "names"): completing(_named("bench.chart", "NAMES")),
    ("walk", "through"): _SADDLES,
    ("import", "repairs"): completing(_named("recordings.checks", "REPAIRS"), listed=True),
    **{
        (verb, name): _SADDLES for verb in ("connect", "bifurcations", "walk", "prove") for name in ("source", "target")
    },
}
"""Completers of parameters, by verb ("" for any) and by the name of the parameter."""
