"""The guide's tables of settings and the files' JSON Schema.

Both are made from the declarations of the settings.
"""

from collections.abc import Iterable, Mapping
from dataclasses import MISSING
from typing import Annotated, Any

from dpcontrol.foundation.settings import Leaf, Setting, leaves_of
from dpcontrol.loop.bench import Push
from dpcontrol.loop.controllers import CONTROLLERS, ESTIMATORS, KEEPERS
from dpcontrol.loop.result import SupervisorSettings
from dpcontrol.plans.layout import BENCH, KEEP, RUN, ZEROS, Header, HoldPart, OrbitPart, WalkPart
from dpcontrol.plans.model import OPTIONAL, REQUIRED, Title
from dpcontrol.references.problem import Limits, ReferenceSettings

_PAGE = """\
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
    return _PAGE + "".join(f"\n## {title}\n\n{_table(prefix, kinds)}" for title, prefix, kinds in tables)


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
    return ", ".join(leaf.bounds.choices) or ("" if "str" in str(leaf.hint) else leaf.bounds.range)


def _shown(value: Any) -> str:
    if value is MISSING:
        return "required"
    if isinstance(value, tuple):
        return ", ".join(map(str, value)) or "none"
    if isinstance(value, float):
        return f"{value:g}"
    return "none" if value in ("", None) else str(value)


def schema(of: str) -> dict[str, Any]:
    """Return the JSON Schema of model or itinerary files.

    Args:
        of: "model" or "itinerary".
    """
    return {"itinerary": _itinerary_schema, "model": _model_schema}[of]()


_DRAFT = "https://json-schema.org/draft/2020-12/schema"


def _itinerary_schema() -> dict[str, Any]:
    parts = [_object(leaves_of(kind)) for kind in (WalkPart, HoldPart, OrbitPart)]
    part_keys = {key: value for part in reversed(parts) for key, value in part["properties"].items()}
    run = _object({**{key: leaf for key, (_, leaf) in RUN.items()}, "zeros": ZEROS})
    run["properties"]["blows"] = {
        "type": "array",
        "items": _object(leaves_of(Push)),
        "description": "Blows at given times.",
    }
    alone = [*part_keys, "parts"]
    tables = {
        "limits": _object(leaves_of(Limits)),
        "reference": _object(leaves_of(ReferenceSettings)),
        "run": run,
        "controller": _controller_schema(),
        "estimator": {"anyOf": _kinds(ESTIMATORS, "ekf")},
        "supervisor": _object(leaves_of(SupervisorSettings)),
        "parts": {"type": "array", "items": {"anyOf": parts}, "minItems": 1},
    }
    return {
        "$schema": _DRAFT,
        "title": "Itinerary of dpcontrol",
        "type": "object",
        "properties": {**_object(leaves_of(Header))["properties"], **part_keys, **tables},
        "anyOf": [
            *({"required": part["required"], "properties": _absent(alone, part["properties"])} for part in parts),
            {"required": ["parts"], "properties": _absent(part_keys)},
        ],
        "additionalProperties": False,
    }


def _absent(keys: Iterable[str], allowed: Iterable[str] = ()) -> dict[str, bool]:
    """Return the schema of keys that must be absent, except those allowed."""
    return {key: False for key in keys if key not in set(allowed)}


def _model_schema() -> dict[str, Any]:
    systems = []
    for system, required in REQUIRED.items():
        arms = system == "arm-chain"
        made = _object(leaves_of(Title))
        tables = {**required, **(OPTIONAL if arms else {})}
        made["properties"] |= {name: _object(leaves_of(kind)) for name, kind in tables.items()}
        made["properties"]["system"] = {"const": system, "default": "arm-chain"}
        made["required"] += [*required, *(() if arms else ("system",))]
        systems.append(made)
    return {"$schema": _DRAFT, "title": "Model of dpcontrol", "anyOf": systems}


def _kinds(kinds: Mapping[str, type], default: str, keep: Mapping[str, Leaf] | None = None) -> list[dict[str, Any]]:
    """Return the schemas of a table whose `kind` chooses its keys."""
    made = []
    for name, kind in kinds.items():
        known = Leaf(
            "kind", Annotated[str, Setting(choices=(name,), help="Kind.")], name if name == default else MISSING
        )
        made.append(_object({"kind": known, **leaves_of(kind), **(keep or {})}))
    return made


def _controller_schema() -> dict[str, Any]:
    """Return the schema of [controller].

    Only TVLQR hands over to a keeper, and is then the default.
    """
    none, *laws = KEEPERS
    alone = Leaf("keep", Annotated[str, Setting(choices=(none,), help=KEEP.bounds.help)], none)
    keeping = Leaf("keep", Annotated[str, Setting(choices=tuple(laws), help=KEEP.bounds.help)], MISSING)
    follow = _kinds(CONTROLLERS, "adaptive", {"keep": alone})
    return {"anyOf": [*follow, *_kinds({"tvlqr": CONTROLLERS["tvlqr"]}, "tvlqr", {"keep": keeping})]}


def _object(leaves: Mapping[str, Leaf]) -> dict[str, Any]:
    """Return the schema of a table."""
    return {
        "type": "object",
        "properties": {key: leaf.schema() for key, leaf in leaves.items()},
        "required": [key for key, leaf in leaves.items() if leaf.default is MISSING],
        "additionalProperties": False,
    }
