"""The guide's page on settings, from their declarations: `python tests/settings_page.py` writes it."""

from collections.abc import Mapping
from dataclasses import MISSING
from pathlib import Path
from typing import Any

from dpcontrol.foundation.settings import Leaf, leaves_of
from dpcontrol.loop.bench import Push
from dpcontrol.loop.controllers import CONTROLLERS, ESTIMATORS, KEEPERS
from dpcontrol.loop.result import SupervisorSettings
from dpcontrol.plans.layout import BENCH, KEEP, RUN, ZEROS, Header, HoldPart, OrbitPart, WalkPart
from dpcontrol.references.problem import Limits, ReferenceSettings

PAGE = Path(__file__).parents[1] / "dpcontrol" / "guide" / "settings.md"
INTRODUCTION = """\
# Settings

All settings of itineraries and runs, with their defaults and allowed values. This page is generated from the program.

The headings name the tables of an itinerary's file, and *key* is the key in that table. On the command line,
`--set PATH=VALUE` overrides a setting of a run, and `campaign --over PATH=V1,V2` varies it. In Python,
`settings={"drive.lag": 0.005}` does the same. *Path* is given where it differs from the key. Its last part is enough if
it is unique or a key of `[run]`: `--set jerk=100`. Ten settings have options: `--mismatch`, `--initial-error`, `--lag`,
`--delay`, `--counts`, `--travel`, `--controller`, `--estimator`, `--rate` and `--on-fall`. Lists are written as in a
file: `--set 'augment=["zeros", "drive"]'`. `--set seconds=90` changes the duration of an itinerary that is one stay.

`dpcontrol schema itinerary` and `dpcontrol schema model` print the JSON Schema of files. Save it, and name it in the
first line of a file, such as `#:schema itinerary.schema.json`. Editors with a TOML language server, such as Taplo, then
complete and check the keys.
"""


def settings_page() -> str:
    """Return the guide's page on settings."""
    alone = {leaf.name: leaf for path, leaf in RUN.values() if "." not in path} | {"zeros": ZEROS}
    tables: list[tuple[str, str, Mapping[str, Mapping[str, Leaf]]]] = [
        *(
            (title, "", {"": leaves_of(kind)})
            for title, kind in {
                "Top level": Header,
                "A walk": WalkPart,
                "A hold": HoldPart,
                "An orbit": OrbitPart,
                "[limits]": Limits,
                "[reference]": ReferenceSettings,
            }.items()
        ),
        ("[run]: the run", "", {"": alone}),
        *((f"[run]: {name}", f"{name}.", {"": leaves_of(kind)}) for name, kind in BENCH.items()),
        ("[[run.blows]]", "", {"": leaves_of(Push)}),
        ("[controller]", "controller.", {kind: leaves_of(law) for kind, law in CONTROLLERS.items()}),
        ("[estimator]", "estimator.", {kind: leaves_of(filters) for kind, filters in ESTIMATORS.items()}),
        ("[supervisor]", "supervisor.", {"": leaves_of(SupervisorSettings)}),
    ]
    return INTRODUCTION + "".join(f"\n## {title}\n\n{_table(prefix, kinds)}" for title, prefix, kinds in tables)


def _table(prefix: str, kinds: Mapping[str, Mapping[str, Leaf]]) -> str:
    """Return a table in Markdown.

    With several kinds, each has its own default.
    """
    rows: dict[str, list[str]] = {}
    for kind, leaves in kinds.items():
        for key, leaf in leaves.items():
            path = [f"`{prefix}{key}`"] if prefix else []
            row = rows.setdefault(key, [f"`{key}`", *path, "", _allowed(leaf), leaf.bounds.help])
            row[-3] += f"{', ' if row[-3] else ''}{_shown(leaf.default)}{f' ({kind})' if kind else ''}"
    if prefix == "controller.":
        rows["kind"] = ["`kind`", "`controller`", "adaptive", ", ".join(CONTROLLERS), "Law."]
        rows["keep"] = ["`keep`", "`controller.keep`", "none", ", ".join(KEEPERS), KEEP.bounds.help]
    if prefix == "estimator.":
        rows["kind"] = ["`kind`", "`estimator`", "ekf", ", ".join(ESTIMATORS), "Filter."]
    columns = ["key", *(["path"] if prefix else []), "default", "allowed", "meaning"]
    head = f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|\n"
    return head + "".join(f"| {' | '.join(row)} |\n" for row in rows.values())


def _allowed(leaf: Leaf) -> str:
    """Return the allowed values, "" for any text."""
    if "bool" in str(leaf.hint):
        return "true or false"
    return ", ".join(leaf.bounds.choices) or ("" if "str" in str(leaf.hint) else leaf.bounds.range)


def _shown(value: Any) -> str:
    if value is MISSING:
        return "required"
    if isinstance(value, tuple):
        return ", ".join(map(str, value)) or "none"
    if isinstance(value, float):
        return f"{value:g}"
    return "none" if value in ("", None) else str(value)


if __name__ == "__main__":
    PAGE.write_text(settings_page(), encoding="utf-8")
