"""The notebooks run without changes, and print what is stored in them."""

import re
from pathlib import Path
from typing import Any

import nbformat
import pytest

from tests.notebooks import NOTEBOOKS, executed


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


@pytest.mark.slow
@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_notebook_prints_what_it_shows(file: Path) -> None:
    assert texts(executed(file)) == texts(nbformat.read(file, as_version=4))
