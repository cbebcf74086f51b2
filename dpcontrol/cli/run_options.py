"""Options that override a scene's run settings, the same for every verb that runs a loop."""

from collections.abc import Callable
from dataclasses import fields
from typing import Any

from dpcontrol.cli.verbs import option
from dpcontrol.scenes.run_options import RunOptions

KINDS: dict[str, type] = {
    f.name: {"str": str, "int": int, "float": float}[str(f.type).partition(" ")[0]] for f in fields(RunOptions)
}
"""Type of every run setting that can be given on the command line."""


def run_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add `--mismatch`, `--lag` and the like to a verb, by part of the bench; those not given arrive as None."""
    for f in reversed(fields(RunOptions)):
        flag = f"--{f.name.replace('_', '-')}"
        function = option(flag, f.name, type=KINDS[f.name], default=None, **f.metadata)(function)
    return function
