"""The docstrings of a package have short summaries, and describe the arguments of its public functions."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1] / "dpcontrol"
"""Words of a summary, so that it fits on a line of an index or a tooltip."""
FEWEST_ARGUMENTS = 2
"""Arguments from which a function needs `Args:`; the summary can describe a single one. Overrides have no docstring."""
PACKAGES = (
    "bench", "bifurcations", "control", "dynamics", "foundation", "identification", "judge", "logs", "loop", "orbits",
    "pages", "planner", "plans", "proofs", "recordings", "references", "rig", "runs", "shooting", "tubes", "walks",
)  # fmt: skip
"""Packages whose docstrings are checked. Those of verbs in `cli` are help texts; `test_api_reference` checks `api`."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


def _modules(package: str) -> Iterator[tuple[str, ast.Module]]:
    """Yield the modules of a package with their paths."""
    for file in sorted((ROOT / package).rglob("*.py")):
        yield str(file.relative_to(ROOT)), ast.parse(file.read_text(encoding="utf-8"))


def _public_functions(body: list[ast.stmt], *, method: bool = False) -> Iterator[tuple[Function, list[str]]]:
    """Yield the public functions and methods in a body, with the names of their arguments."""
    for one in body:
        if isinstance(one, ast.ClassDef) and not one.name.startswith("_"):
            yield from _public_functions(one.body, method=True)
        if isinstance(one, Function) and not one.name.startswith("_"):
            given = one.args
            names = [argument.arg for argument in (*given.posonlyargs, *given.args)]
            names += [f"*{given.vararg.arg}"] if given.vararg else []
            names += [argument.arg for argument in given.kwonlyargs]
            names += [f"**{given.kwarg.arg}"] if given.kwarg else []
            yield one, names[1:] if method and names[:1] in (["self"], ["cls"]) else names


def _described(one: Function) -> list[str] | None:
    """Return the names in a function's `Args:`, or None if it has none."""
    found = re.search(r"^Args:\n((?: {4}.*\n?)+)", ast.get_docstring(one) or "", re.MULTILINE)
    return None if found is None else re.findall(r"^ {4}(\*{0,2}\w+):", found[1], re.MULTILINE)


def _place(file: str, one: Function) -> str:
    return f"{file}:{one.lineno} {one.name}"


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_function_of_several_arguments_describes_them(package: str) -> None:
    functions = [(file, *one) for file, module in _modules(package) for one in _public_functions(module.body)]
    assert functions
    lacking = [
        _place(file, one)
        for file, one, names in functions
        if len(names) >= FEWEST_ARGUMENTS and ast.get_docstring(one) and _described(one) is None
    ]
    assert not lacking


@pytest.mark.parametrize("package", PACKAGES)
def test_described_arguments_are_those_of_the_function_in_order(package: str) -> None:
    differing = [
        f"{_place(file, one)}: {described}, has {names}"
        for file, module in _modules(package)
        for one, names in _public_functions(module.body)
        if (described := _described(one)) is not None and described != names
    ]
    assert not differing
