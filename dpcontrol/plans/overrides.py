"""Settings of a run by path, such as `drive.lag`.

The last part alone is enough if no other path ends in it.

Paths follow the fields of `LoopSettings`, such as `mismatch`, `drive.lag` and `controller.angle`. `controller` and
`estimator` alone are kinds, or a user's objects.
"""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from functools import cache
from itertools import accumulate
from numbers import Integral, Real
from typing import Any, NamedTuple, get_type_hints

from dpcontrol.foundation.arguments import shortened
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import Bounds, bounds_of, help_of, nearest

NAMED = (
    "mismatch", "initial_error", "drive.lag", "drive.delay", "sensors.counts", "travel", "controller", "estimator",
    "rate", "supervisor.on_fall",
)  # fmt: skip
"""Paths that have an option of the command line each; `--set` takes every path."""


class Leaf(NamedTuple):
    """A setting: types of its values, bounds, default and help."""

    hint: Any
    bounds: Bounds
    default: Any
    help: str

    @property
    def sentence(self) -> str:
        """The help, with the unit or the choices."""
        more = f": {', '.join(self.bounds.choices)}" if self.bounds.choices else ""
        unit = f", {self.bounds.unit}" if self.bounds.unit else ""
        return f"{self.help.removesuffix('.')}{more}{unit}."


@cache
def paths() -> Mapping[str, Leaf]:
    """Return every setting of a run by its path."""
    # Imported here because the help of verbs needs no dynamics.
    from dpcontrol.loop.controllers import ADAPTIVE_ESTIMATORS, CONTROLLERS, ESTIMATORS
    from dpcontrol.loop.loop import LoopSettings
    from dpcontrol.loop.result import SupervisorSettings
    from dpcontrol.plans.layout import BENCH, RunTable

    found: dict[str, Leaf] = {"controller": Leaf(str, Bounds(choices=tuple(CONTROLLERS)), "adaptive", "Law.")}
    found["estimator"] = Leaf(str, Bounds(choices=tuple(ESTIMATORS)), "ekf", "Filter.")
    own, table = dict(_leaves("", LoopSettings)), dict(_leaves("", RunTable))
    found |= {"controller.keep" if name == "keep" else name: own[name] for name in own if name not in ("seed", "plant")}
    found["plant"] = table["plant"]
    parts = {**BENCH, "supervisor": SupervisorSettings}
    for part, kind in parts.items():
        found |= dict(_leaves(f"{part}.", kind))
    for part, kinds in (("controller", CONTROLLERS), ("estimator", {**ESTIMATORS, **ADAPTIVE_ESTIMATORS})):
        for kind in kinds.values():
            found = {**dict(_leaves(f"{part}.", kind)), **found}
    return {path: leaf for path, leaf in found.items() if not path.endswith(".kind")}


def _leaves(prefix: str, kind: type) -> Iterator[tuple[str, Leaf]]:
    """Yield the settings of a dataclass by path."""
    hints, helps, bounds = get_type_hints(kind), help_of(kind), bounds_of(kind)
    for one in fields(kind):
        if one.name in bounds and one.name != "blows":
            yield f"{prefix}{one.name}", Leaf(hints[one.name], bounds[one.name], one.default, helps[one.name])


def resolved(name: str) -> str:
    """Return the path of a setting from its name.

    Args:
        name: path of a setting, or its last part.

    Raises:
        InputError: no path or several paths end in it.
    """
    wanted, known = name.strip().replace("-", "_").removeprefix("run."), paths()
    if wanted in known:
        return wanted
    ends = [path for path in known if path.endswith(f".{wanted}")]
    # A key of [run] is written alone in a file too, so it has priority over tables such as [estimator].
    ends = [path for path in ends if not path.startswith(("controller.", "estimator.", "supervisor."))] or ends
    if len(ends) == 1:
        return ends[0]
    if ends:
        raise InputError(f"{name}: several settings have this name; give {' or '.join(ends)}")
    last = {path.rpartition(".")[2]: path for path in known}
    close = nearest(wanted, known) or last.get(nearest(wanted.rpartition(".")[2], last), "")
    near = f"did you mean {close!r}? " if close else ""
    raise InputError(f"{name}: no run has this setting; {near}`dpcontrol guide settings` lists all")


def canonical(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings by their paths, each value of the setting's type.

    None keeps the itinerary's value.

    Args:
        settings: values by name.

    Raises:
        InputError: an unknown or ambiguous name, a setting that is given twice, or a value of another type.
    """
    found: dict[str, Any] = {}
    for name, value in settings.items():
        path = resolved(name)
        if value is None:
            continue
        if path in found:
            raise InputError(f"{name} = {value!r}: {path} is given twice; give it once")
        found[path] = _of_type(name, value, paths()[path].hint) if path not in OBJECTS else value
    return found


OBJECTS = ("controller", "estimator", "plant")
"""Settings that may be objects of the user."""


def _of_type(name: str, value: Any, hint: Any) -> Any:
    """Return a value as a type takes it.

    Raises:
        InputError: it is of another type.
    """
    whole = "int" in str(hint)
    if isinstance(value, list | tuple) and "tuple" in str(hint):
        return tuple(_of_type(name, one, int) for one in value) if whole else tuple(value)
    if isinstance(value, Real) and not isinstance(value, bool):
        number: Any = value
        with suppress(OverflowError):
            if whole and (isinstance(value, Integral) or float(number).is_integer()):
                return int(number)
            if not whole and "float" in str(hint) and hint != tuple[float, ...]:
                return float(number)
    if hint is str and isinstance(value, str):
        return value
    raise InputError(f"{name} = {shortened(value)}: must be {_kind(hint)}")


def _kind(hint: Any) -> str:
    if hint is str:
        return "text"
    if "tuple" in str(hint):
        kind = "whole number" if "int" in str(hint) else "number"
        return "a list of texts" if "str" in str(hint) else f"a {kind} or a list of {kind}s"
    return "a whole number" if hint is int else "a number"


def parsed(name: str, text: str) -> Any:
    """Return the value of a setting from its command-line text.

    Args:
        name: path of the setting, or its last part.
        text: text of the value.

    Raises:
        InputError: an unknown setting, or text that is no value of it.
    """
    hint, text = paths()[resolved(name)].hint, text.strip()
    try:
        number = int if "int" in str(hint) else float
        if "tuple" in str(hint) and (text.startswith("[") or "," in text or "str" in str(hint)):
            inner = text[1:-1] if text[:1] + text[-1:] == "[]" else text
            parts = [part.strip() for part in inner.split(",")]
            # The last value of a list may be followed by a comma, as in TOML.
            parts = parts if parts[-1] else parts[:-1]
            if not all(parts):
                raise ValueError(text)
            return tuple(parts if "str" in str(hint) else map(number, parts))
        return text if hint is str else number(text)
    except ValueError:
        raise InputError(f"{name} = {shortened(text)}: must be {_kind(hint)}") from None


def values_in(text: str) -> list[str]:
    """Return the texts between commas, except those within brackets.

    Args:
        text: values of one setting, such as "0.1,0.2" or "[0.1,0.2],[0.2,0.1]".
    """
    # A comma within brackets has more opening than closing brackets before it.
    depths = accumulate((c == "[") - (c == "]") for c in text)
    return "".join("\n" if c == "," and not depth else c for c, depth in zip(text, depths, strict=True)).split("\n")


def typed(settings: Mapping[str, Any]) -> str:
    """Return settings as the command line takes them.

    An example is `--travel 0.6 --set drive.jerk=100`.

    Args:
        settings: values by name.
    """
    words: list[str] = []
    for name, value in settings.items():
        path, text = resolved(name), ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
        words += [option_of(path), text] if path in NAMED and "," not in text else ["--set", f"{path}={text}"]
    return shlex.join(words)


def option_of(path: str) -> str:
    """Return the option of a path in `NAMED`.

    Args:
        path: path of a setting.
    """
    return f"--{path.rpartition('.')[2].replace('_', '-')}"


def settings_to_vary(given: str = "") -> Sequence[str]:
    """Return the completions of `--set` and `--over`.

    Args:
        given: the setting with the values before the one to complete, such as "controller=lqr,".
    """
    return paths()[resolved(given.partition("=")[0])].bounds.choices if given else [f"{path}=" for path in paths()]
