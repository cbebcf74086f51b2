"""`dpcontrol import`, `replay` and `identify`: a recording comes in, is predicted, and gives a model."""

from pathlib import Path

import numpy as np
import pytest
from bench_recordings import rig_variables, table_columns, write_csv, write_mat
from command_line import dpcontrol

from dpcontrol.plans.model import load_model
from dpcontrol.recordings.recording import load_recording, simulated_recording, write_recording

ROUNDING = 1e-12


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let default names point into the test's folder."""
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


def test_a_fault_is_rejected_with_the_option_that_corrects_it() -> None:
    columns = table_columns()
    columns["angle_1"][50] = ""
    write_csv(Path("swing.csv"), columns)
    refused = dpcontrol("import", "swing.csv")
    assert refused.code == 2
    assert "row 51 (t = 0.05 s): angle 1 is not finite" in refused.message
    assert "--repair nan" in refused.message
    assert not Path("logs").exists()
    mended = dpcontrol("import", "swing.csv", "--repair", "nan,gaps", "--out", "mended.mcap")
    assert mended.code == 0
    assert "1 rows filled" in mended.stdout
    assert load_recording("mended.mcap").notes


def test_simulated_swings_are_those_of_the_model_and_of_the_seed() -> None:
    options = ["--swings", "2", "--seconds", "0.5"]
    first = dpcontrol("import", "--simulated", "lab-identified", *options, "--json").document
    assert first["log"] == str(Path("logs/lab-identified-swings-0.mcap"))
    assert [part["samples"] for part in first["segments"]] == [501, 501]
    assert first["source"] == "simulated"
    dpcontrol("import", "--simulated", "lab-identified", *options, "--out", "again.mcap")
    dpcontrol("import", "--simulated", "lab-identified", *options, "--seed", "1", "--out", "other.mcap")
    swings = [load_recording(log).angles for log in (first["log"], "again.mcap", "other.mcap")]
    assert np.array_equal(swings[0], swings[1])
    assert np.abs(swings[0] - swings[2]).max() > 0.1


@pytest.mark.slow
def test_replay_reports_the_error_of_each_segment_and_writes_a_log_for_review() -> None:
    write_mat(Path("swing.mat"), rig_variables(segments=2, samples=600))
    dpcontrol("import", "swing.mat")
    ended = dpcontrol("replay", "logs/swing.mcap", "--model", "lab", "--json")
    assert ended.code == 0
    document = ended.document
    assert document["log"] == str(Path("logs/swing-replay.mcap"))
    for part, start in zip(document["segments"], (0.0, 0.6), strict=True):
        assert part["start"] == pytest.approx(start, abs=ROUNDING)
        squares = part["rms_angle_1"] ** 2 + part["rms_angle_2"] ** 2
        assert part["rms"] == pytest.approx((squares / 2) ** 0.5)
        # The recording is exact, and of the model's own motion.
        assert part["rms"] < 1e-6
    assert 0.0 <= document["nis_inside_95"] <= 1.0
    assert set(document["rms_ahead"]) == {"1", "100"}
    picture = dpcontrol("review", "logs/swing-replay.mcap", "--picture", "replay.png")
    assert picture.code == 0
    assert Path("replay.png").stat().st_size > 10_000


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
