"""Attributes of results with their descriptions, from the docstrings of their classes."""

import inspect
import pkgutil
import re
from dataclasses import fields, is_dataclass
from functools import cache, cached_property
from importlib import import_module
from types import FunctionType

import dpcontrol as dp
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.shown import Shown
from dpcontrol.judge.score import Score, Scores
from dpcontrol.tubes.connections import Connection, ConnectionSearch

ITEMS: dict[type, type] = {ConnectionSearch: Connection, Scores: Score}
"""Classes of the items of results that most scripts use."""
DESCRIBED = re.compile(r"^ {4}([\w, ]+?)( \([^)]*\))?: (.+(?:\n {8}.+)*)", re.MULTILINE)
"""An entry of a docstring's list of attributes: names, shape and text."""
BELOW = re.compile(r'^ {4}(\w+)\b[^\n]*(?:\n {8}[^\n]*)*\n {4}"""(.+?)"""', re.MULTILINE | re.DOTALL)
"""A field with its description below."""


@cache
def by_name() -> dict[str, type]:
    """Return the classes of results of the package by name."""
    for found in pkgutil.walk_packages(dp.__path__, "dpcontrol."):
        if "examples" not in found.name and "__main__" not in found.name:
            import_module(found.name)
    kinds, open_ = {}, [Documented, Shown]
    while open_:
        below = open_.pop().__subclasses__()
        kinds |= {kind.__name__: kind for kind in below}
        open_ += below
    return kinds


def results_of(name: str) -> list[type]:
    """Return the classes of results in the return type of a function of `dp`."""
    text = str(inspect.signature(getattr(dp, name)).return_annotation)
    return [by_name()[word] for word in re.findall(r"\w+", text) if word in by_name()]


def _own(kind: type) -> bool:
    return kind.__module__.startswith("dpcontrol.")


@cache
def attributes(kind: type) -> dict[str, str]:
    """Return the public attributes of a class, inherited ones first, each with its description or ""."""
    names = [field.name for field in fields(kind)] if is_dataclass(kind) else []
    names += [name for name, value in inspect.getmembers_static(kind) if isinstance(value, property | cached_property)]
    found = dict.fromkeys(name for name in names if not name.startswith("_"))
    for base in reversed([base for base in kind.__mro__ if _own(base)]):
        listed = inspect.cleandoc(base.__doc__ or "").partition("Attributes:\n")[2]
        texts = {
            name: f"{shape} {text}".strip()
            for some, shape, text in DESCRIBED.findall(listed)
            for name in some.split(", ")
        }
        texts |= dict(BELOW.findall(inspect.getsource(base).replace(base.__doc__ or "", "")))
        own = {name: value for name, value in vars(base).items() if isinstance(value, property | cached_property)}
        for name, value in own.items():
            texts[name] = inspect.getdoc(value.fget if isinstance(value, property) else value.func) or ""
        found |= {
            name: " ".join(text.split("\n\n")[0].split()) for name, text in texts.items() if name in found and text
        }
    return {name: text or "" for name, text in found.items()}


def methods(kind: type) -> dict[str, str]:
    """Return the public methods of a class, each as it is called, with the first sentence of its docstring."""
    found = {}
    for name, value in inspect.getmembers(kind, inspect.isfunction):
        doc = inspect.getdoc(value)
        if not name.startswith("_") and doc and isinstance(inspect.getattr_static(kind, name), FunctionType):
            arguments = list(inspect.signature(value).parameters.values())[1:]
            called = inspect.Signature([one.replace(annotation=inspect.Parameter.empty) for one in arguments])
            found[f"{name}{called}"] = " ".join(doc.split("\n\n")[0].split())
    return found


def classes() -> list[type]:
    """Return the classes of results of all functions, and of the items of results that most scripts use."""
    functions = [name for name in dp.__all__ if inspect.isfunction(getattr(dp, name))]
    return list(dict.fromkeys([*(kind for name in functions for kind in results_of(name)), *ITEMS.values()]))
