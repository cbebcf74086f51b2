"""The guide's tables of settings and the files' JSON Schema.

Both are made from the declarations of the settings.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields
from typing import Any, get_type_hints

from dpcontrol.foundation.settings import adapter, bounds_of, help_of
from dpcontrol.loop.bench import Push
from dpcontrol.loop.controllers import CONTROLLERS, ESTIMATORS, KEEPERS
from dpcontrol.loop.result import SupervisorSettings
from dpcontrol.plans.layout import BENCH, Header, HoldPart, OrbitPart, RunTable, WalkPart
from dpcontrol.plans.model import OPTIONAL, REQUIRED, Title
from dpcontrol.references.problem import Limits, ReferenceSettings

_PAGE = """\
# Settings

All settings of itineraries and runs, with their defaults and allowed values. This page is generated from the program.

The headings name the tables of an itinerary's file, and *key* is the key in that table. On the command line,
`--set PATH=VALUE` overrides a setting of a run, and `campaign --over PATH=V1,V2` varies it. In Python,
`settings={"drive.lag": 0.005}` does the same. *Path* is given where it differs from the key. Its last part is enough if
it is unique or a key of `[run]`: `--set jerk=100`. Ten settings have options: `--mismatch`, `--initial-error`, `--lag`,
`--delay`, `--counts`, `--travel`, `--controller`, `--estimator`, `--rate` and `--on-fall`.

`dpcontrol schema itinerary` and `dpcontrol schema model` print the JSON Schema of files. Save it, and name it in the
first line of a file, such as `#:schema itinerary.schema.json`. Editors with a TOML language server, such as Taplo, then
complete and check the keys.
"""


def settings_page() -> str:
    """Return the guide's page on settings."""
    bench = {name for kind in BENCH.values() for name in bounds_of(kind)}
    tables: list[tuple[str, str, Mapping[str, type], set[str]]] = [
        ("Top level", "", {"": Header}, set()),
        ("A walk", "", {"": WalkPart}, set()),
        ("A hold", "", {"": HoldPart}, set()),
        ("An orbit", "", {"": OrbitPart}, set()),
        ("[limits]", "", {"": Limits}, set()),
        ("[reference]", "", {"": ReferenceSettings}, set()),
        ("[run]: the run", "", {"": RunTable}, {*bench, "blows"}),
        *((f"[run]: {name}", f"{name}.", {"": kind}, set()) for name, kind in BENCH.items()),
        ("[[run.blows]]", "", {"": Push}, set()),
        ("[controller]", "controller.", CONTROLLERS, set()),
        ("[estimator]", "estimator.", ESTIMATORS, set()),
        ("[supervisor]", "supervisor.", {"": SupervisorSettings}, set()),
    ]
    return _PAGE + "".join(
        f"\n## {title}\n\n{_table(prefix, kinds, without)}" for title, prefix, kinds, without in tables
    )


def _table(prefix: str, kinds: Mapping[str, type], without: set[str]) -> str:
    """Return a table in Markdown.

    With several kinds, each has its own default.
    """
    rows: dict[str, list[str]] = {}
    for kind, declared in kinds.items():
        bounds, helps = bounds_of(declared), help_of(declared)
        for one in fields(declared):  # type: ignore[arg-type]
            if one.name not in bounds or one.name in without:
                continue
            allowed = ", ".join(bounds[one.name].choices) or bounds[one.name].range
            text = "" if "str" in str(get_type_hints(declared)[one.name]) and not bounds[one.name].choices else allowed
            path = [f"`{prefix}{one.name}`"] if prefix else []
            row = rows.setdefault(one.name, [f"`{one.name}`", *path, "", text, helps[one.name]])
            value = "required" if one.default is MISSING else _shown(one.default)
            row[-3] += f"{', ' if row[-3] else ''}{value}{f' ({kind})' if kind else ''}"
    if set(kinds) == set(CONTROLLERS):
        rows["kind"] = ["`kind`", "`controller`", "adaptive", ", ".join(CONTROLLERS), "Law."]
        rows["keep"] = ["`keep`", "`controller.keep`", "none", ", ".join(KEEPERS), "Law that keeps a walk's stops."]
    if set(kinds) == set(ESTIMATORS):
        rows["kind"] = ["`kind`", "`estimator`", "ekf", ", ".join(ESTIMATORS), "Filter."]
    columns = ["key", *(["path"] if prefix else []), "default", "allowed", "meaning"]
    head = f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|\n"
    return head + "".join(f"| {' | '.join(row)} |\n" for row in rows.values())


def _shown(value: Any) -> str:
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
    parts = [_object(kind) for kind in (WalkPart, HoldPart, OrbitPart)]
    part_keys = {key: value for part in reversed(parts) for key, value in part["properties"].items()}
    run = _object(RunTable)
    run["properties"]["blows"] = {"type": "array", "items": _object(Push)}
    alone = [*part_keys, "parts"]
    tables = {
        "limits": _object(Limits),
        "reference": _object(ReferenceSettings),
        "run": run,
        "controller": _controller_schema(),
        "estimator": _kinds(ESTIMATORS, "ekf"),
        "supervisor": _object(SupervisorSettings),
        "parts": {"type": "array", "items": {"anyOf": parts}, "minItems": 1},
    }
    return {
        "$schema": _DRAFT,
        "title": "Itinerary of dpcontrol",
        "type": "object",
        "properties": {**_object(Header)["properties"], **part_keys, **tables},
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
    top = _object(Title)
    systems = []
    for system, required in REQUIRED.items():
        optional = OPTIONAL if system == "arm-chain" else {}
        tables = {name: _object(kind) for name, kind in {**required, **optional}.items()}
        own = {**top["properties"], "system": {"const": system, "default": "arm-chain"}}
        needed = ["title", *required, *(["system"] if system != "arm-chain" else [])]
        systems.append(
            {"type": "object", "properties": {**own, **tables}, "required": needed, "additionalProperties": False}
        )
    return {"$schema": _DRAFT, "title": "Model of dpcontrol", "anyOf": systems}


def _kinds(kinds: Mapping[str, type], default: str) -> dict[str, Any]:
    """Return the schema of a table whose `kind` chooses its keys."""
    found = []
    for name, kind in kinds.items():
        one = _object(kind)
        one["properties"] |= {"kind": {"const": name}}
        found.append(one | ({} if name == default else {"required": ["kind"]}))
    return {"anyOf": found}


def _controller_schema() -> dict[str, Any]:
    """Return the schema of [controller].

    Only TVLQR hands over to a keeper, and is then the default.
    """
    made = _kinds(CONTROLLERS, "adaptive")
    for one in made["anyOf"]:
        one["properties"]["keep"] = {"enum": ["none"], "default": "none"}
    tvlqr = next(one for one in made["anyOf"] if one["properties"]["kind"] == {"const": "tvlqr"})
    keeps = {"enum": [name for name in KEEPERS if name != "none"]}
    keeping = {**tvlqr, "properties": {**tvlqr["properties"], "keep": keeps}, "required": ["keep"]}
    return {"anyOf": [*made["anyOf"], keeping]}


def _object(kind: type) -> dict[str, Any]:
    """Return the schema of a dataclass: pydantic's, with bounds, units and help."""
    made = adapter(kind).json_schema()
    helps = help_of(kind)
    for name, bounds in bounds_of(kind).items():
        own = made["properties"][name]
        if name == "blows":
            continue
        own.pop("title", None)
        if own.get("default") in (math.inf, None):
            own.pop("default", None)
        values = [own, *own.get("anyOf", ()), *([own["items"]] if "items" in own else [])]
        for one in [*values, *(value["items"] for value in own.get("anyOf", ()) if "items" in value)]:
            if one.get("type") in ("number", "integer"):
                _bound(one, bounds)
            elif one.get("type") == "string" and bounds.choices:
                one["enum"] = list(bounds.choices)
        own["description"] = helps[name] + (f" Unit: {bounds.unit}." if bounds.unit else "")
    made.pop("$defs", None)
    made.pop("title", None)
    for one in (made, made["properties"].get("blows", {}).get("items", {})):
        if "description" in one:
            one["description"] = one["description"].partition("\n\n")[0]
    return {**made, "additionalProperties": False}


def _bound(number: dict[str, Any], bounds: Any) -> None:
    """Add bounds to the schema of a number.

    Zero or infinity is added if allowed.
    """
    limits = {"minimum": bounds.least, "exclusiveMinimum": bounds.above, "maximum": bounds.most}
    limits = {key: float(value) for key, value in limits.items() if math.isfinite(value)}
    if bounds.zero and limits.get("minimum", 0.0) > 0:
        number["anyOf"] = [{"const": 0}, limits]
    elif not bounds.infinite:
        number.update(limits)
    else:
        number.update({key: value for key, value in limits.items() if key != "maximum"})
