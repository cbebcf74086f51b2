"""`dpcontrol campaign` and `preflight`: their documents, and failures that `dpcontrol run` replays."""

from pathlib import Path

import pyarrow.parquet as pq
import pytest
from command_line import dpcontrol

HARD = ("--mismatch", "0.15", "--initial-error", "0.1", "--controller", "feedforward")


def test_the_document_agrees_with_the_table_and_failures_repeat(tmp_path: Path) -> None:
    file = tmp_path / "turn.parquet"
    ended = dpcontrol(
        "campaign", "outer-turn", *HARD, "--runs", "2", "--seed-from", "7", "--workers", "1", "--out", file, "--json"
    )
    assert ended.code == 0
    shown, rows = ended.document, pq.read_table(file).to_pylist()
    assert [row["seed"] for row in rows] == [7, 8]
    assert (shown["runs"], shown["completed"]) == (2, sum(row["completed"] for row in rows))
    assert shown["success_rate"] == shown["completed"] / 2
    low, high = shown["wilson_95"]
    assert 0 <= low <= shown["success_rate"] <= high <= 1
    assert shown["file"] == str(file)
    failed = shown["failures"][0]
    again = dpcontrol("run", "outer-turn", *HARD, "--seed", failed["seed"], "--out", tmp_path / "run.mcap", "--json")
    assert again.code == 1
    assert failed["replays"] is True
    assert again.document["completed"] is False
    assert again.document["reason"] == failed["reason"]


@pytest.mark.slow  # Compiles the loop in lockstep.
def test_a_preflight_reports_its_share_and_draws_its_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dpcontrol.runs.preflight.hazards", lambda plan, scene, **most: [])
    monkeypatch.setattr("dpcontrol.runs.preflight.changes", lambda scene: [])
    page = tmp_path / "page.png"
    call = ("preflight", "hold-down-down", "--runs", "16", "--workers", "1", "--picture", page)
    ended = dpcontrol(*call, "--json")
    assert ended.code == 0
    shown = ended.document
    assert (shown["runs"], shown["confidence"], shown["picture"]) == (16, 0.99, str(page))
    low, high = shown["wilson"]
    assert 0 <= low <= shown["success_rate"] <= high <= 1
    assert sum(ending["runs"] for ending in shown["endings"]) == 16 - shown["completed"]
    assert page.read_bytes().startswith(b"\x89PNG")
