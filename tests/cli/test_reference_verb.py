"""`dpcontrol reference FILE` describes and draws the file of a plan, and rejects other files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import dpcontrol

AGREES = 1e-9
"""Relative; sums and interpolation in double precision."""
LARGEST = 1e-3
"""Relative; a maximum on the nodes' grid against one between nodes too."""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("reference") / "turn.npz"
    assert dpcontrol("plan", "outer-turn", "--out", path).code == 0
    return path


def arrays(file: Path) -> dict[str, Any]:
    with np.load(file, allow_pickle=False) as found:
        return dict(found)


def test_the_document_agrees_with_the_arrays(file: Path) -> None:
    shown = dpcontrol("reference", file, "--json").document
    held = arrays(file)
    lengths = np.diff(held["mesh"])
    assert shown["intervals"] == len(lengths)
    assert shown["duration"] == pytest.approx(lengths.sum(), rel=AGREES)
    assert shown["shortest_interval"] == pytest.approx(lengths.min(), rel=AGREES)
    assert shown["longest_interval"] == pytest.approx(lengths.max(), rel=AGREES)
    # Radau's inputs and their squares are integrated exactly by Gauss's rule on the interpolating polynomials.
    places, weights = np.polynomial.legendre.leggauss(8)
    degrees = np.arange(len(held["points"]))
    powers = held["points"][:, None] ** degrees
    curves = np.linalg.solve(powers, held["inputs"][..., 0].T)
    at = ((places + 1) / 2)[:, None] ** degrees @ curves
    assert shown["effort"] == pytest.approx((weights / 2 @ at**2) @ lengths, rel=1e-3)
    for name, values in (("position", held["states"][..., 4]), ("velocity", held["states"][..., 5])):
        use = shown["limits"][name]
        assert use["largest"] == pytest.approx(np.abs(values).max(), rel=LARGEST)
        assert use["share"] == pytest.approx(use["largest"] / use["bound"], rel=AGREES)
        interval = int(np.searchsorted(held["mesh"], use["time"]) - 1)
        near = np.abs(values[max(interval - 1, 0) : interval + 2]).max()
        assert near == pytest.approx(use["largest"], rel=LARGEST)
    assert set(shown["limits"]) == {"position", "velocity", "acceleration"}
    assert shown["method"] == "radau-7"


def test_the_error_is_measured_again_and_agrees_with_the_one_stored(file: Path, tmp_path: Path) -> None:
    shown = dpcontrol("reference", file, "--json").document
    assert shown["measured_error_between_nodes"] == pytest.approx(shown["max_error_between_nodes"], rel=1e-3)
    # A file that claims more than it holds is found out.
    parts = arrays(file)
    parts["inputs"] = parts["inputs"] * 1.01
    np.savez(tmp_path / "off.npz", **parts)
    off = dpcontrol("reference", tmp_path / "off.npz", "--json").document
    assert off["measured_error_between_nodes"] > 10 * off["max_error_between_nodes"]
