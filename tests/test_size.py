"""The size of the package, which only falls: what exceeds a limit today is listed in `size.toml` by name."""

import ast
import re
import tomllib
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import networkx as nx
import pytest

ROOT = Path(__file__).parent.parent / "dpcontrol"
RECORD = tomllib.loads((Path(__file__).parent / "size.toml").read_text(encoding="utf-8"))

LINES, EXPRESSION_LINES = 60, 80  # of a function without its docstring; the second if its body is one statement
MAP = 0.25  # a map that is further off misleads, and one that is closer needs an edit with each change
PARAMETERS = 6  # without self and cls: a function with more misses an object


@cache
def modules() -> dict[str, ast.Module]:
    """Return the package's modules by their paths. Parsing takes seconds, of the worker that needs it only."""
    return {
        path.relative_to(ROOT).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
        for path in sorted(ROOT.rglob("*.py"))
        if path.relative_to(ROOT).parts[0] != "examples"
    }


def _is_docstring(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _statements(tree: ast.Module) -> int:
    return sum(isinstance(node, ast.stmt) and not _is_docstring(node) for node in ast.walk(tree))


def _functions() -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    for name, tree in modules().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield f"{name}:{node.name}", node


def _is_long(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    body = function.body[_is_docstring(function.body[0]) :]
    if not body:
        return False
    first, last = body[0].lineno, body[-1].end_lineno or body[-1].lineno
    signature = function.body[0].lineno - function.lineno
    return signature + last - first + 1 > (EXPRESSION_LINES if len(body) == 1 else LINES)


def _parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    arguments = function.args
    named = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    return sum(argument.arg not in ("self", "cls") for argument in named)


def _imported(name: str, tree: ast.Module) -> Iterator[str]:
    """The modules of the package that a module imports anywhere, functions and type checking included."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("dpcontrol"):
            folder = "/".join((node.module or "").split(".")[1:])
            for alias in node.names:
                inner = f"{folder}/{alias.name}.py".lstrip("/")
                yield inner if inner in modules() else f"{folder}.py"
        elif isinstance(node, ast.Import):
            for alias in node.names:
                yield "/".join(alias.name.split(".")[1:]) + ".py"


def _circles() -> list[list[str]]:
    graph = nx.DiGraph(
        (name, other) for name, tree in modules().items() for other in _imported(name, tree) if other in modules()
    )
    return sorted(sorted(circle) for circle in nx.strongly_connected_components(graph) if len(circle) > 1)


def _imports_of_the_top(tree: ast.Module) -> Iterator[str]:
    """What a module imports of the top package itself."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name == "dpcontrol")
        elif isinstance(node, ast.ImportFrom) and node.module == "dpcontrol":
            yield from (alias.name for alias in node.names)


def test_no_module_imports_the_top_package_but_verbs_import_its_functions() -> None:
    imports = {(name.split("/")[0], what) for name, tree in modules().items() for what in _imports_of_the_top(tree)}
    assert imports == {("cli", "api")}


def test_the_package_has_no_more_statements_than_recorded() -> None:
    assert sum(map(_statements, modules().values())) <= RECORD["statements"]


def test_the_map_of_the_house_gives_about_the_number_of_statements_of_each_package() -> None:
    page = (ROOT.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")
    sizes = {name: int(size.replace(",", "")) for name, size in re.findall(r"^(\w+) +([\d,]+)  \w", page, re.MULTILINE)}
    counts = Counter[str]()
    for name, tree in modules().items():
        counts[name.split("/")[0].removesuffix(".py")] += _statements(tree)
    assert sizes == {package: pytest.approx(counts[package], rel=MAP) for package in sizes}


def test_each_package_has_a_forecast_and_the_forecasts_add_up_to_the_goal() -> None:
    packages = {name.split("/")[0] for name in modules() if "/" in name}
    assert packages <= set(RECORD["forecast"]) | {"cli"}
    assert sum(RECORD["forecast"].values()) <= RECORD["goal"]


@pytest.mark.parametrize(
    ("limit", "offenders"),
    [
        ("long", lambda: [name for name, function in _functions() if _is_long(function)]),
        ("parameters", lambda: [name for name, function in _functions() if _parameters(function) > PARAMETERS]),
        ("circles", lambda: [" ".join(circle) for circle in _circles()]),
        (
            "names",
            lambda: [
                name
                for name, count in Counter(path.split("/")[-1] for path in modules()).items()
                if count > 1 and name != "__init__.py"
            ],
        ),
        (
            "unformatted",
            lambda: [
                f"{name}: {count}"
                for name in modules()
                if (count := (ROOT / name).read_text(encoding="utf-8").count("# fmt: skip"))
            ],
        ),
    ],
    ids=["length of functions", "parameters", "import circles", "unique names of modules", "formatting"],
)
def test_only_listed_places_exceed_a_limit_and_each_listed_place_still_does(limit: str, offenders: object) -> None:
    assert callable(offenders)
    assert sorted(offenders()) == sorted(RECORD["exceptions"][limit])


USES = {
    "cli/commands.py": "reads the arguments of a docstring, and marks their defaults for the help",
    "control/export.py": "takes apart C that casadi generated, and the linker's list of sizes",
    "dynamics/system.py": "names of a user's system",
    "foundation/cache.py": "names of files in the cache's folder",
    "foundation/errors.py": "shortens and escapes texts from outside for the terminal",
    "foundation/guide.py": "the list of pages in the guide's README",
    "foundation/toml.py": "the line of a TOML error, which Python 3.13 gives in its text only",
    "logs/recovery.py": "the beginning of a damaged file, and names of interrupted logs",
    "proofs/balls.py": "decimal numbers of a certificate",
    "recordings/bags.py": "names of fields and message definitions in bags",
    "recordings/importing.py": "numbers and paths of variables in a laboratory's tables",
    "rig/client.py": "addresses of rigs",
    "walks/symbols.py": "symbols and names of connections that users type",
}
"""Modules that import `re`, each with the text that it reads."""


def test_each_module_with_regular_expressions_has_a_reason() -> None:
    """Regular expressions are used on texts that come from outside, never on texts of the program."""
    users = {
        name
        for name, tree in modules().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        and "re" in (*(alias.name for alias in node.names if isinstance(node, ast.Import)), getattr(node, "module", ""))
    }
    assert users - USES.keys() == set()


def test_class_names_are_unique() -> None:
    names = Counter(node.name for tree in modules().values() for node in tree.body if isinstance(node, ast.ClassDef))
    assert {name for name, count in names.items() if count > 1} == set()
