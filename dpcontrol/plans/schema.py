"""JSON Schema of the files of itineraries and models, from the tables that read them."""

from typing import Any

from dpcontrol.foundation.settings import Leaf
from dpcontrol.foundation.toml import Choice, Table, Tables
from dpcontrol.plans.itinerary import FILE, PART
from dpcontrol.plans.model import FILE as MODEL


def schema(of: str) -> dict[str, Any]:
    """Return the JSON Schema of model or itinerary files, by which editors check and complete them.

    Args:
        of: "model" or "itinerary".
    """
    if of == "model":
        return {"$schema": _DRAFT, "title": "Model of dpcontrol", **schema_of(MODEL)}
    # One part is at the top level, or several under [[parts]].
    common = {key: part for key, part in FILE.keys.items() if key not in ("", "parts")}
    list_of_parts = {"parts": Tables(PART, required=True)}
    files = [Table({**common, **keys}) for keys in (list_of_parts, *(part.keys for part in PART.tables.values()))]
    return {"$schema": _DRAFT, "title": "Itinerary of dpcontrol", "anyOf": [schema_of(file) for file in files]}


_DRAFT = "https://json-schema.org/draft/2020-12/schema"


def schema_of(part: Leaf | Table | Choice | Tables) -> dict[str, Any]:
    """Return the JSON Schema of a part of a file, from the declaration that also reads it.

    Args:
        part: setting, table, choice of tables or list of tables.
    """
    if isinstance(part, Leaf):
        return part.schema()
    if isinstance(part, Choice):
        return {"anyOf": [schema_of(table) for table in part.tables.values()]}
    if isinstance(part, Tables):
        return {"type": "array", "items": schema_of(part.each), "minItems": 1}
    return {
        "type": "object",
        "properties": {key: schema_of(entry) for key, entry in part.keys.items()},
        "required": [key for key, entry in part.keys.items() if entry.required],
        "additionalProperties": False,
    }
