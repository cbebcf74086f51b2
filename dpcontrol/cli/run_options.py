"""Options that override a scene's run settings, the same for every verb that runs a loop."""

from collections.abc import Callable
from dataclasses import fields
from typing import Any, TypeVar

import click

from dpcontrol.scenes.run_options import RunOptions

RUN_OPTIONS: dict[str, tuple[type, str]] = {
    f.name: ({"str": str, "int": int, "float": float}[str(f.type).partition(" ")[0]], f.metadata["help"])
    for f in fields(RunOptions)
}
"""Name, type and help of every run setting that can be given on the command line."""

_F = TypeVar("_F", bound=Callable[..., Any])


def run_options(function: _F) -> _F:
    """Add `--mismatch`, `--lag` and the like to a verb; those not given arrive as None."""
    for name, (kind, text) in reversed(RUN_OPTIONS.items()):
        function = click.option(f"--{name.replace('_', '-')}", name, type=kind, default=None, help=text)(function)
    return function
