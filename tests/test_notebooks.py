"""The notebooks run without changes, and print what is stored in them."""

import ast
import re
from pathlib import Path
from typing import Any

import nbformat
import pytest

from tests.notebooks import NOTEBOOKS, executed

MOST_BYTES = 1_000_000
ALLOWED = {"dpcontrol", "matplotlib.pyplot", "numpy"}


def texts(notebook: Any) -> list[str]:
    """Return what each cell prints, and the text of its value without the size of a figure.

    Numbers below 1e-9 are rounding errors, which differ by processor.
    """
    found = []
    for cell in notebook.cells:
        printed = [one.text for one in cell.get("outputs", []) if one.output_type == "stream"]
        values = [one.data["text/plain"] for one in cell.get("outputs", []) if one.output_type != "stream"]
        text = "".join([*printed, *(value for value in values if "Figure" not in value)])
        found.append(re.sub(r"\d(\.\d+)?e-[1-9]\d", "…", text))
    return found


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_notebook_has_its_outputs_and_imports_no_subpackage(file: Path) -> None:
    notebook = nbformat.read(file, as_version=4)
    assert file.stat().st_size <= MOST_BYTES
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    nodes = [node for cell in code for node in ast.walk(ast.parse(cell.source))]
    assert not [node for node in nodes if isinstance(node, ast.ImportFrom)]
    assert {name.name for node in nodes if isinstance(node, ast.Import) for name in node.names} == ALLOWED
    pictures = [one for cell in code for one in cell.outputs if "image/png" in one.get("data", {})]
    assert len(pictures) >= 2
    assert {one.get("name") for cell in code for one in cell.outputs} <= {None, "stdout"}
    assert "error" not in {one.output_type for cell in code for one in cell.outputs}


@pytest.mark.slow
@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_notebook_prints_what_it_shows(file: Path) -> None:
    assert texts(executed(file)) == texts(nbformat.read(file, as_version=4))
