"""`dpcontrol import`, `replay` and `identify`: a recording comes in, is predicted, and gives a model."""

from pathlib import Path

import numpy as np
import pytest
from bench_recordings import rig_variables, write_mat
from command_line import dpcontrol

from dpcontrol.plans.model import load_model
from dpcontrol.recordings.recording import load_recording, simulated_recording, write_recording

ROUNDING = 1e-12


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_import_writes_a_log_named_after_the_file_and_reports_its_segments() -> None:
    write_mat(Path("swing.mat"), rig_variables(segments=3))
    document = dpcontrol("import", "swing.mat", "--json").document
    assert document["log"] == str(Path("logs/swing.mcap"))
    assert (document["arms"], document["samples"], document["sampling_period"]) == (2, 900, 1e-3)
    assert [part["index"] for part in document["segments"]] == [0, 1, 2]
    assert [part["start"] for part in document["segments"]] == pytest.approx([0.0, 0.3, 0.6], abs=ROUNDING)
    assert (document["rates"], document["cart"], document["notes"]) == (True, False, [])
    assert load_recording("logs/swing.mcap").segments == ((0, 300), (300, 600), (600, 900))


@pytest.mark.slow
def test_a_model_with_uncertainty_and_a_picture_are_written() -> None:
    starts = [np.array([1.0, 0.3]) * (-0.8) ** k for k in range(3)]
    write_recording(simulated_recording(load_model("lab").arms, starts, seconds=1.0, period=2e-3), Path("swing.mcap"))
    ended = dpcontrol("identify", "swing.mcap", "--no-zeros", "--picture", "found.png", "--json")
    assert ended.code == 0, ended.stderr
    document = ended.document
    assert document["file"] == str(Path("models/swing.toml"))
    assert document["friction_terms"] == ["viscous"]
    assert set(document["parameters"]["M11/M12"]) == {"value", "standard_error"}
    assert document["candidates"][0]["terms"] == ["viscous"]
    assert sum(c["chosen"] for c in document["candidates"]) == 1
    assert [(s["index"], s["used"]) for s in document["segments"]] == [(0, True), (1, True), (2, False)]
    assert load_model("swing").uncertainty is not None
    assert Path("found.png").read_bytes().startswith(b"\x89PNG")
    # The model that was found runs every other verb that takes one.
    assert dpcontrol("model", "swing", "--json").document["parameters"]["m1"]["value"] > 0
