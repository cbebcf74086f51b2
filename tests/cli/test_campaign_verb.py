"""`dpcontrol campaign` and `preflight`: their documents, and failures that `dpcontrol run` replays."""

from pathlib import Path

import pyarrow.parquet as pq
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
