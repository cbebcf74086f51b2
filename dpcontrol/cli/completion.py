"""Shell completion of values: names of models, itineraries and pages, laws, estimators, faults, saddles, figures.

Click itself completes verbs, options and choices, and leaves files to the shell. Names that need a heavy import are
read when they are asked for.
"""

import tomllib
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from itertools import product

import click
from click.shell_completion import CompletionItem

Values = Callable[[click.Context], Iterable[str]]
Completer = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def completing(values: Values, *, files: bool = False) -> Completer:
    """Return what completes a parameter from values; files: if no value fits, the shell offers files."""

    def complete(context: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        found = [CompletionItem(value) for value in values(context) if value.startswith(incomplete)]
        return found or ([CompletionItem(incomplete, type="file")] if files else [])

    return complete


def _known(kind: str, _: click.Context) -> list[str]:
    from dpcontrol.foundation.shipped import known

    return known(kind)


def _mappings(_: click.Context) -> list[str]:
    from dpcontrol.foundation.shipped import MAPPINGS

    return sorted(file.stem for file in MAPPINGS.glob("*.toml"))


def _topics(_: click.Context) -> list[str]:
    from dpcontrol.cli.start import topics

    return list(topics())


def _faults(_: click.Context) -> list[str]:
    from dpcontrol.rig.bench import FAULTS

    return list(FAULTS)


def _figures(_: click.Context) -> Iterable[str]:
    from dpcontrol.cli.charts import FIGURES

    return FIGURES


def _charts(_: click.Context) -> list[str]:
    from dpcontrol.bench.chart import CHARTS, GROUPS

    return [*CHARTS, *GROUPS]


def _saddles(context: click.Context) -> list[str]:
    """Return the equilibria of the model on the command line, or of two arms."""
    from dpcontrol.foundation.shipped import find

    arms = 2
    # Of an unfinished line click keeps the arguments apart.
    name = context.params.get("model") or next(iter(context.args), "lab")
    with suppress(Exception):
        model = tomllib.loads(find("models", str(name)).read_text(encoding="utf-8"))
        if model.get("system") == "three-body":
            return ["L1", "L2", "L3"]
        arms = len(model["arms"]["mass"])
    return ["-".join(names) for names in product(("down", "up"), repeat=arms)]


def _settings(_: click.Context) -> list[str]:
    from dataclasses import fields

    from dpcontrol.scenes.run_options import RunOptions

    return [f"{one.name}=" for one in fields(RunOptions)]


def choosing(choices: Iterable[str]) -> Completer:
    """Return what completes a parameter from choices that need no import."""
    return completing(lambda _: choices)


COMPLETERS: dict[tuple[str, str], Completer] = {
    **{("", name): completing(partial(_known, "models"), files=True) for name in ("model", "plant", "simulated")},
    ("", "itinerary"): completing(partial(_known, "itineraries"), files=True),
    ("", "mapping"): completing(_mappings, files=True),
    ("", "topic"): completing(_topics),
    ("", "fault"): completing(_faults),
    ("", "over"): completing(_settings),
    ("figures", "names"): completing(_figures),
    ("bench", "names"): completing(_charts),
    ("replay", "estimator"): choosing(("ekf", "ukf")),
    ("orbit", "saddle"): completing(_saddles),
    **{
        (verb, name): completing(_saddles)
        for verb in ("connect", "bifurcations", "walk")
        for name in ("source", "target")
    },
}
"""What completes a parameter, by verb ("" for any) and by the parameter's name."""
