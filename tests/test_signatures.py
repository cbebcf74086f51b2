"""Functions of the loop and of what runs it have few parameters, and hide none."""

import ast
from pathlib import Path

import pytest

import dpcontrol

MOST = 8
OPEN = {
    ("control", "__init__"): "names of a layout's parts; what a library's program hands on to its base",
    ("control", "compute_process_sigmas"): "overrides a method of filterpy",
    ("plans", "__init__"): "the deprecated options of a run, by any name",
    ("runs", "_log_in_memory"): "metadata of a log, by any name",
    ("runs", "log_writer"): "metadata of a log, by any name",
}
"""Functions that take any names, and why."""


@pytest.mark.parametrize("package", ["control", "loop", "plans", "runs"])
def test_no_function_has_more_than_eight_parameters_or_takes_any_name(package: str) -> None:
    files = sorted((Path(dpcontrol.__file__).parent / package).rglob("*.py"))
    assert files
    many, hidden = [], []
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            count = sum(one.arg not in ("self", "cls") for one in given) + (node.args.vararg is not None)
            if count > MOST:
                many.append(f"{file.name}: {node.name} has {count}")
            if node.args.kwarg is not None and (package, node.name) not in OPEN:
                hidden.append(f"{file.name}: {node.name}")
    assert (many, hidden) == ([], [])
