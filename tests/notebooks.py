"""Writes the outputs of the notebooks in dpcontrol/examples: `python tests/notebooks.py`."""

import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import nbformat
from nbclient import NotebookClient

import dpcontrol

NOTEBOOKS = sorted((Path(dpcontrol.__file__).parent / "examples").glob("*.ipynb"))
LONGEST = 900
"""Time limit of a cell, s."""


def executed(file: Path) -> nbformat.NotebookNode:
    os.environ.update(OMP_NUM_THREADS="1", MPLBACKEND="module://matplotlib_inline.backend_inline")
    notebook = nbformat.read(file, as_version=4)
    with TemporaryDirectory() as folder:
        client = NotebookClient(
            notebook, timeout=LONGEST, kernel_name="python3", resources={"metadata": {"path": folder}}
        )
        client.execute()
    for cell in notebook.cells:
        cell.metadata = {}
        if cell.cell_type == "code":
            cell.outputs = [one for one in cell.outputs if one.get("name") != "stderr"]
    notebook.metadata = {"kernelspec": notebook.metadata.kernelspec, "language_info": {"name": "python"}}
    return notebook


if __name__ == "__main__":
    for file in NOTEBOOKS:
        if not sys.argv[1:] or file.stem in sys.argv[1:]:
            nbformat.write(executed(file), file)
