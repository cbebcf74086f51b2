"""Documents: results as JSON values, derived from the fields of their classes.

`KEYS` of a class lists the entries of its document, separated by spaces:

    status                  an attribute
    from=source.saddle      an attribute under another name, here of a part
    names=parts.name        the attribute of each item of a sequence
    count=#connections      the length of an attribute
    margins?                an attribute, which is left out if it is None
    ends:energy,reason      these entries of a part or of each item (plain tuples get the names in order)
    **orbit                 the entries of a part beside those of the object
    **                      the object's own document
    *                       all fields

Methods without arguments are called. A dataclass without `KEYS` has all its fields.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from inspect import ismethod
from pathlib import Path
from typing import Any, ClassVar


class Documented:
    """Base of results with a JSON document."""

    KEYS: ClassVar[str] = "*"

    def document(self) -> dict[str, Any]:
        """Return the result as JSON values, with the keys that `--json` prints."""
        return document_of(self, self.KEYS)

    def lines(self) -> Iterable[Any]:
        """Return the result as lines and tables of text, which verbs print."""
        return import_module("dpcontrol.words.texts").text_of(self)

    @property
    def missed(self) -> str:
        """Why a verb with this result ends with exit code 1: the status of a result that is not `converged`, or ""."""
        return "" if getattr(self, "converged", True) else str(getattr(self, "status", ""))


def counted(count: int, noun: str) -> str:
    """Return a count with its noun, as in "no connections", "1 connection" and "2 connections".

    Args:
        count: number of things.
        noun: the noun in the singular.
    """
    return f"{count or 'no'} {noun}{'' if count == 1 else 's'}"


def document_of(result: Any, keys: str = "*") -> dict[str, Any]:
    """Return the entries of a result's document, which `KEYS` of its class lists.

    Args:
        result: a dataclass, mapping or other object.
        keys: entries as at the head of this module, separated by spaces (default: all fields).
    """
    document: dict[str, Any] = {}
    for entry in keys.split():
        name, _, columns = entry.partition(":")
        key, _, path = name.replace("?", "").partition("=")
        # All fields need no value, and the object's own document ("**") is made of the object itself.
        value = result if key == "**" else None if key == "*" else _part(result, path or key.lstrip("*"))
        if value is None and "?" in name:
            continue
        if columns:
            value = _rows(value, columns)
        if key == "*":
            document |= fields_of(type(result), result)
        elif key.startswith("**"):
            document |= plain(value)
        else:
            document[key] = value
    return plain(document)


def _part(value: Any, path: str) -> Any:
    """Return the value at the end of a path below an object, as an entry of `KEYS` names it.

    A name of the path is an attribute, the key of a mapping, or the place in a sequence. Another name at a sequence
    gives the list of this attribute of its items. Methods are called without arguments. If a value on the way is None,
    the result is None.

    Args:
        value: object at which the path begins.
        path: names separated by dots. A path that begins with "#" stands for the length of its value.
    """
    for name in path.lstrip("#").split("."):
        if value is None:
            return None
        # A named tuple is an object with attributes, not a sequence.
        if isinstance(value, list | tuple) and not hasattr(value, "_fields"):
            value = value[int(name)] if name.isdigit() else [getattr(item, name) for item in value]
        else:
            value = value.get(name) if isinstance(value, Mapping) else getattr(value, name)
        value = value() if ismethod(value) else value
    return len(value) if path.startswith("#") else value


def _rows(value: Any, columns: str) -> Any:
    """Return selected entries of an object, or of each item of a list or mapping.

    Args:
        value: object, list or mapping.
        columns: entries as at the head of this module, separated by commas.

    Returns:
        A dictionary of the entries, or a list or mapping of such dictionaries.
    """
    if isinstance(value, list | tuple):
        return [_row(item, columns) for item in value]
    if isinstance(value, Mapping):
        return {key: _row(item, columns) for key, item in value.items()}
    return _row(value, columns)


def _row(value: Any, columns: str) -> dict[str, Any]:
    """Return selected entries of one object, a dictionary by name; a plain tuple gets the names in order.

    `columns` are entries as at the head of this module, separated by commas.
    """
    if type(value) is tuple:
        return dict(zip(columns.split(","), value, strict=True))
    return document_of(value, columns.replace(",", " "))


def picked(result: Any, *names: str) -> dict[str, Any]:
    """Return some attributes of a result by name, as a part of its document.

    Args:
        result: any object.
        *names: names of its attributes.
    """
    return {name: getattr(result, name) for name in names}


def fields_of(kind: type, record: Any) -> dict[str, Any]:
    """Return the fields of a dataclass from a record, by name.

    Args:
        kind: dataclass that declares the fields.
        record: object with at least these attributes.
    """
    return picked(record, *(field.name for field in fields(kind)))


def plain(value: Any) -> Any:
    """Return `value` as JSON values.

    Dataclasses become mappings, arrays lists, complex numbers [re, im], paths text, and infinite numbers and NaN null.

    Args:
        value: nested mappings, lists, arrays (…) and scalars.
    """
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if hasattr(value, "tolist"):  # arrays and numbers of NumPy, which is not imported here for a quick start of verbs
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, Documented):
        return value.document()
    if is_dataclass(value):
        return document_of(value)
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
