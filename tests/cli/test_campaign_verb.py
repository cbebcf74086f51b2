"""`dpcontrol campaign`: its document, its overrides, its failures replayed by `dpcontrol run`, and what it refuses."""

from pathlib import Path

import pyarrow.parquet as pq
import pytest
from command_line import dpcontrol

HARD = ("--mismatch", "0.15", "--initial-error", "0.1", "--controller", "feedforward")


def test_the_document_agrees_with_the_table_and_failures_repeat(tmp_path: Path) -> None:
    file = tmp_path / "turn.parquet"
    ended = dpcontrol(
        "campaign", "outer-turn", *HARD, "--runs", "3", "--seed-from", "7", "--workers", "1", "--out", file, "--json"
    )
    assert ended.code == 0
    shown, rows = ended.document, pq.read_table(file).to_pylist()
    assert {"runs", "completed", "success_rate", "wilson_95", "failures", "seconds", "file"} <= shown.keys()
    assert [row["seed"] for row in rows] == [7, 8, 9]
    assert (shown["runs"], shown["completed"]) == (3, sum(row["completed"] for row in rows))
    assert shown["success_rate"] == shown["completed"] / 3
    low, high = shown["wilson_95"]
    assert 0 <= low <= shown["success_rate"] <= high <= 1
    assert shown["file"] == str(file)
    failed = shown["failures"][0]
    assert {"seed", "symbol", "reason"} <= failed.keys()
    again = dpcontrol("run", "outer-turn", *HARD, "--seed", failed["seed"], "--out", tmp_path / "run.mcap", "--json")
    assert again.code == 1
    assert failed["replays"] is True
    assert again.document["completed"] is False
    assert again.document["reason"] == failed["reason"]


@pytest.mark.parametrize(
    ("arguments", "naming"),
    [
        (("--over", "mismach=0.1"), "mismatch"),
        (("--over", "mismatch"), "PATH=VALUE"),
        (("--over", "mismatch=low"), "low"),
        (("--over", "mismatch=0.1", "--over", "mismatch=0.2"), "twice"),
        (("--over", "controller=tvlqg"), "tvlqr"),
        (("--standard", "--over", "lag=0.1"), "lag"),
        (("--mismatch", "2"), "mismatch = 2"),
        (("--out", "table.csv"), "--out"),
        (("--runs", "0"), "--runs"),
    ],
)
def test_user_errors_are_one_sentence_and_exit_with_two(
    arguments: tuple[str, ...], naming: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ended = dpcontrol("campaign", "outer-turn", "--workers", "1", *arguments)
    assert ended.code == 2
    assert ended.stdout == ""
    assert naming in ended.message
    assert "Traceback" not in ended.stderr
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_a_file_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    out = tmp_path / "file" / "table.parquet"
    ended = dpcontrol("campaign", "outer-turn", "--runs", "1", "--workers", "1", "--out", out)
    assert ended.code == 2
    assert str(tmp_path / "file") in ended.message
    assert "Traceback" not in ended.stderr
