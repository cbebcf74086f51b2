"""Settings of a run by path, such as `drive.lag`.

The last part alone is enough if no other path ends in it.

Paths follow the fields of `LoopSettings`, such as `mismatch`, `drive.lag` and `controller.angle`. `controller` and
`estimator` alone are kinds, or a user's objects.
"""

import shlex
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import accumulate
from typing import Annotated, Any

from dpcontrol.foundation.errors import InputError, Mistakes
from dpcontrol.foundation.settings import Leaf, Setting, leaves_of, nearest

NAMED = {
    "mismatch": "Largest relative error of the plant's parameters.",
    "initial_error": "Largest error of each initial angle, rad.",
    "drive.lag": "Time constant of the drive's velocity loop, s.",
    "drive.delay": "Delay from a reading to its command, also fractions, periods.",
    "sensors.counts": "Encoder counts per turn of a joint.",
    "travel": "Largest distance of the cart from the centre, m.",
    "controller": "Law: tvlqr, adaptive, ogy, ogy-classic, lqr, feedforward.",
    "estimator": "Filter: ekf, ukf.",
    "rate": "Rate of the loop, Hz.",
    "supervisor.on_fall": "Action after a fall: stop, resume, restart.",
}
"""Paths that have an option of the command line each, with its help; `--set` takes every path.

The help is that of the declarations, which import the dynamics and would make `--help` slow.
"""
OBJECTS = ("controller", "estimator", "plant")
"""Settings that may be objects of the user."""
NOT_OF_LOOP = (*OBJECTS, "seconds")
"""Settings that are not fields of a run's settings: objects by their names, and the duration of a stay."""


@cache
def paths() -> Mapping[str, Leaf]:
    """Return every setting of a run by its path, such as "drive.lag", with its type, bounds and default."""
    # Imported here because the help of verbs needs no dynamics.
    from dpcontrol.loop.controllers import CONTROLLERS, ESTIMATORS
    from dpcontrol.loop.result import SupervisorSettings
    from dpcontrol.plans.layout import KEEP, RUN, HoldPart

    law_setting = Setting(choices=tuple(CONTROLLERS), help="Law.")
    filter_setting = Setting(choices=tuple(ESTIMATORS), help="Filter.")
    leaves = {
        "controller": Leaf("controller", Annotated[str, law_setting], "adaptive"),
        "estimator": Leaf("estimator", Annotated[str, filter_setting], "ekf"),
        "controller.keep": KEEP,
        "seconds": leaves_of(HoldPart)["seconds"],
        **dict(RUN.values()),
    }
    tables = [("supervisor", SupervisorSettings), *(("controller", kind) for kind in CONTROLLERS.values())]
    tables += [("estimator", kind) for kind in ESTIMATORS.values()]
    for table, kind in tables:
        leaves = {**{f"{table}.{name}": leaf for name, leaf in leaves_of(kind).items()}, **leaves}
    return leaves


def resolved(name: str) -> str:
    """Return the path of a setting, such as "drive.lag", from a name, such as "lag" or "run.lag".

    Args:
        name: path of a setting, or its last part.

    Raises:
        InputError: no path or several paths end in it.
    """
    key, known_paths = name.strip().replace("-", "_").removeprefix("run."), paths()
    if key in known_paths:
        return key
    matching_paths = [path for path in known_paths if path.endswith(f".{key}")]
    # A key of [run] is written alone in a file too, so it has priority over tables such as [estimator].
    matching_paths = [
        path for path in matching_paths if not path.startswith(("controller.", "estimator.", "supervisor."))
    ] or matching_paths
    if len(matching_paths) == 1:
        return matching_paths[0]
    if matching_paths:
        raise InputError(f"{name}: several settings have this name; give {' or '.join(matching_paths)}")
    names = {path.rpartition(".")[2]: path for path in known_paths} | {path: path for path in known_paths}
    similar = names.get(nearest(key, names) or nearest(key.rpartition(".")[2], names), "")
    suggestion = f"did you mean {similar!r}? " if similar else ""
    raise InputError(f"{name}: no run has this setting; {suggestion}`dpcontrol guide settings` lists all")


def canonical(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings by their full paths, each value checked and of the setting's type.

    None keeps the itinerary's value.

    Args:
        settings: values by name.

    Raises:
        InputError: every unknown or ambiguous name, every setting that is given twice, and every value of another type
            or out of bounds.
    """
    values, mistakes = dict[str, Any](), Mistakes()
    for name, value in settings.items():
        with mistakes:
            path = resolved(name)
            if value is not None and path in values:
                raise InputError(f"{name} = {value!r}: {path} is given twice; give it once")
            if value is not None:
                values[path] = value if path in OBJECTS else paths()[path].read(value, key=name)
    mistakes.report()
    return values


def parsed(name: str, text: str) -> Any:
    """Return the value of a setting from its text on the command line.

    Lists are written as in TOML; brackets and quotes can be left out.

    Args:
        name: path of the setting, or its last part.
        text: text of the value.

    Raises:
        InputError: an unknown setting, or text that is no value of it.
    """
    path, text = resolved(name), text.strip()
    if path in OBJECTS:
        return text
    leaf, value = paths()[path], text
    if "tuple" in str(leaf.hint) and (text[:1] == "[" or "," in text or "tuple[str" in str(leaf.hint)):
        value = [entry.strip(" \"'") for entry in text.removeprefix("[").removesuffix("]").rstrip(", ").split(",")]
    return leaf.read(value, key=name, strict=False)


def values_in(text: str) -> list[str]:
    """Return the texts of several values of one setting, which commas separate except within brackets.

    Args:
        text: values of one setting, such as "0.1,0.2" or "[0.1,0.2],[0.2,0.1]".
    """
    # A comma within brackets has more opening than closing brackets before it.
    depths = accumulate((c == "[") - (c == "]") for c in text)
    return "".join("\n" if c == "," and not depth else c for c, depth in zip(text, depths, strict=True)).split("\n")


def typed(settings: Mapping[str, Any]) -> str:
    """Return settings as the command line takes them, such as `--travel 0.6 --set drive.jerk=100`.

    Args:
        settings: values by name.
    """
    words: list[str] = []
    for name, value in settings.items():
        path, text = resolved(name), ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
        words += [option_of(path), text] if path in NAMED and "," not in text else ["--set", f"{path}={text}"]
    return shlex.join(words)


def option_of(path: str) -> str:
    """Return the option of the command line that sets a path of `NAMED`, such as "--lag".

    Args:
        path: path of a setting.
    """
    return f"--{path.rpartition('.')[2].replace('_', '-')}"


def settings_to_vary(typed: str = "") -> Sequence[str]:
    """Return the texts that a shell offers as completions of `--set` and `--over`.

    Args:
        typed: the setting with the values before the one to complete, such as "controller=lqr,".
    """
    return paths()[resolved(typed.partition("=")[0])].bounds.choices if typed else [f"{path}=" for path in paths()]
