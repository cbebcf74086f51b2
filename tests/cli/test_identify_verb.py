"""`dpcontrol identify`: one document with the agreed keys, a model that loads, pictures, and clear refusals."""

from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol

from dpcontrol.plans.model import load_model
from dpcontrol.recordings.recording import simulated_recording, write_recording

KEYS = {"parameters", "undetermined", "friction_terms", "candidates", "segments", "file"}
PNG = b"\x89PNG\r\n"


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let default names point into the test's folder."""
    monkeypatch.chdir(tmp_path)


def a_log(path: str, swings: int = 3, arms: str = "lab") -> str:
    """A log of simulated swings."""
    model = load_model(arms).arms
    starts = [np.array([1.0, 0.3, 0.1][: model.count]) * (-0.8) ** k for k in range(swings)]
    write_recording(simulated_recording(model, starts, seconds=1.0, period=2e-3), Path(path))
    return path


@pytest.mark.slow
def test_a_model_with_uncertainty_and_a_picture_are_written() -> None:
    ended = dpcontrol("identify", a_log("logs/swing.mcap"), "--no-zeros", "--picture", "found.png", "--json")
    assert ended.code == 0, ended.stderr
    document = ended.document
    assert set(document) >= KEYS
    assert document["file"] == str(Path("models/swing.toml"))
    assert document["friction_terms"] == ["viscous"]
    assert set(document["parameters"]["M11/M12"]) == {"value", "standard_error"}
    assert document["candidates"][0]["terms"] == ["viscous"]
    assert sum(c["chosen"] for c in document["candidates"]) == 1
    assert [(s["index"], s["used"]) for s in document["segments"]] == [(0, True), (1, True), (2, False)]
    assert load_model("swing").uncertainty is not None
    assert Path("found.png").read_bytes().startswith(PNG)
    # The model that was found runs every other verb that takes one.
    assert dpcontrol("model", "swing", "--json").document["parameters"]["m1"]["value"] > 0


@pytest.mark.slow
def test_designs_are_compared_without_a_log() -> None:
    ended = dpcontrol("identify", "--design", "--picture", "design.png", "--json")
    assert ended.code == 0, ended.stderr
    assert {e["kind"] for e in ended.document["experiments"]} == {"swing", "cart"}
    assert ended.document["best"]
    assert Path("design.png").read_bytes().startswith(PNG)
