import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shadowing_stand_in import StandIn

from dpcontrol.references.reference import Reference, load_reference, save_reference


@pytest.fixture
def stored(turn: tuple[StandIn, Reference], tmp_path: Path) -> tuple[Reference, Path]:
    reference = turn[1]
    path = tmp_path / "turn.npz"
    save_reference(path, reference)
    return reference, path


def test_a_reference_is_restored_exactly(stored: tuple[Reference, Path]) -> None:
    reference, path = stored
    back = load_reference(path)
    times = np.linspace(0.0, reference.duration, 333)
    assert (back.state(times) == reference.state(times)).all()
    assert (back.input(times) == reference.input(times)).all()
    assert back.plan is None
    for name in ("status", "converged", "limits", "max_error_between_nodes", "iterations", "duration"):
        assert getattr(back, name) == getattr(reference, name)


def test_the_file_is_readable_with_numpy_alone(stored: tuple[Reference, Path]) -> None:
    reference, path = stored
    with np.load(path, allow_pickle=False) as file:
        header = json.loads(str(file["header"]))
        assert header["format"] == "dpcontrol-reference"
        assert file["states"].shape == reference.states.shape
        # The documented layout suffices to evaluate the input by a polynomial fit.
        fit = np.polyfit(file["points"], file["inputs"][7, :, 0], len(file["points"]) - 1)
        time = file["mesh"][7] + 0.3 * (file["mesh"][8] - file["mesh"][7])
    assert np.polyval(fit, 0.3) == pytest.approx(float(reference.input(time)[0]), abs=1e-9)


def test_a_failed_reference_is_stored_without_infinities(stored: tuple[Reference, Path]) -> None:
    reference, path = stored
    save_reference(path, replace(reference, converged=False, max_error_between_nodes=float("inf")))
    back = load_reference(path)
    assert not back.converged
    assert back.max_error_between_nodes == float("inf")
