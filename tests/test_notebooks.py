"""The notebooks run without changes, and print what is stored in them."""

import ast
import re
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import nbformat
import pytest

from tests.notebooks import NOTEBOOKS


def settled(text: str) -> str:
    """Return a text without numbers below 1e-9: they are rounding errors, which differ by processor."""
    return re.sub(r"\d(\.\d+)?e-[1-9]\d", "…", text)


def stored(cell: Any) -> str:
    """Return what a cell prints, and the text of its value without a figure, which has a size."""
    printed = [one.text for one in cell.get("outputs", []) if one.output_type == "stream"]
    values = [one.data["text/plain"] for one in cell.get("outputs", []) if one.output_type != "stream"]
    return settled("".join([*printed, *(value for value in values if "Figure" not in value)]))


def run(cell: str, names: dict[str, Any]) -> str:
    """Run a cell in this process, draw its figures, and return the same texts as it would store."""
    tree, printed, value = ast.parse(cell), StringIO(), None
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    with redirect_stdout(printed):
        exec(compile(tree, "cell", "exec"), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    for number in plt.get_fignums():
        plt.figure(number).canvas.draw()
    plt.close("all")
    shown = "" if value is None or "Figure" in repr(value) else repr(value)
    return settled(printed.getvalue() + shown)


@pytest.mark.slow
@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_notebook_prints_what_it_shows(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    with mpl.rc_context(), mpl.rc_context({"backend": "Agg"}):
        for cell in nbformat.read(file, as_version=4).cells:
            if cell.cell_type == "code":
                assert run(cell.source, names) == stored(cell)
