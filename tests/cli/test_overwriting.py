"""A file that --out names is replaced by the command that made it, and by no other without --force. Default names are
free names.
"""

import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import claimed
from dpcontrol.logs import LogWriter, check_replaced, recover
from dpcontrol.runs.campaign import Job, run_job

STILL = "still.toml"
SCENE = """
title = "Hold both arms hanging"
start = "hold"
hold = "down-down"
seconds = 0.5
[controller]
kind = "lqr"
[supervisor]
lost_tracking = 1.5
"""
LOG = Path("logs/still-0.mcap")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("logs").mkdir()
    Path(STILL).write_text(SCENE)
    return tmp_path


def kept(file: Path, line: str, naming: str) -> None:
    """Check that a command keeps a file, reports this in one sentence, and replaces it with --force."""
    content = file.read_bytes()
    ended = dpcontrol(*line.split())
    assert ended.code == 2, ended.stderr
    assert ended.stdout == ""
    assert f"{file} is there already and {naming}" in ended.message
    assert "choose another name, or replace it with --force" in ended.message
    assert file.read_bytes() == content
    assert [one.name for one in file.parent.iterdir()] == [file.name]
    assert dpcontrol(*line.split(), "--force").code == 0
    assert file.read_bytes() != content


def test_a_run_with_other_settings_leaves_the_log_of_a_run() -> None:
    assert dpcontrol("run", STILL).code == 0
    assert dpcontrol("run", STILL).code == 0
    kept(LOG, f"run {STILL} --mismatch 0.07 --out {LOG}", "holds another log (not the same: run_settings)")
    kept(LOG, f"run {STILL} --seed 5 --out {LOG}", "holds another log (not the same: ")


def test_a_file_that_is_not_a_log_is_not_replaced() -> None:
    LOG.write_text("my notes")
    kept(LOG, f"run {STILL} --out {LOG}", "is not a complete log")


def written(path: Path, *, rig: str | None = None, ticks: int = 50) -> None:
    """Write a log of a bench at rest."""
    with LogWriter(path, arm_lengths=(0.2, 0.2), rate_hz=1000.0, metadata={"seed": "0"}) as log:
        log.ticks(np.arange(ticks) / 1000, measured=np.zeros((ticks, 3)))
        log.result(**({} if rig is None else {"rig": rig}))


def test_logs_of_a_rig_are_always_kept() -> None:
    written(LOG, rig="udp://127.0.0.1:47000")
    with pytest.raises(InputError, match="is a log from a rig"):
        check_replaced(LOG, {"seed": "0"})
    # Before any bench is looked for: nothing answers there.
    ended = dpcontrol("run", STILL, "--rig", "udp://127.0.0.1:9", "--out", str(LOG))
    assert ended.code == 2
    assert "is a log from a rig" in ended.message
    written(LOG)
    check_replaced(LOG, {"seed": "0", "commit": "another"})
    with pytest.raises(InputError, match="not the same: rig"):
        check_replaced(LOG, {"seed": "0", "rig": "udp"})


@pytest.mark.slow
def test_a_campaign_continues_in_its_own_table_and_keeps_other_tables() -> None:
    table = Path("logs/still.parquet")
    line = f"campaign {STILL} --workers 1 --out {table} --runs"
    assert dpcontrol(*line.split(), "1").code == 0
    assert dpcontrol(*line.split(), "2").code == 0
    kept(table, f"{line} 1", "holds another campaign, or more runs of this one")
    kept(table, f"{line} 1 --mismatch 0.07", "holds another campaign, or more runs of this one")
    table.write_text("my notes")
    kept(table, f"{line} 1", "is no table of a campaign")


def test_an_import_leaves_the_log_of_another_recording() -> None:
    log = Path("logs/lab-swings-0.mcap")
    line = f"import --simulated lab --seconds 0.5 --out {log} --swings"
    assert dpcontrol(*line.split(), "2").code == 0
    assert dpcontrol(*line.split(), "2").code == 0
    kept(log, f"{line} 1", "holds another log (not the same: ")


def test_a_replay_by_other_settings_leaves_a_replay() -> None:
    record = "import --simulated lab --seconds 0.5 --swings 1 --out swings.mcap"
    assert dpcontrol(*record.split()).code == 0
    line = "replay swings.mcap --out logs/replay.mcap"
    assert dpcontrol(*line.split()).code == 0
    assert dpcontrol(*line.split()).code == 0
    kept(Path("logs/replay.mcap"), f"{line} --counts 400", "holds another log (not the same: summary)")


def test_an_identified_model_leaves_a_file_that_was_not_identified_from_the_same_logs() -> None:
    Path("mine.toml").write_text('title = "mine"\n')
    written(Path("logs/swing.mcap"))
    ended = dpcontrol("identify", "logs/swing.mcap", "--out", "mine.toml")
    assert ended.code == 2
    assert "mine.toml is there already and was not identified from these logs" in ended.message
    assert Path("mine.toml").read_text() == 'title = "mine"\n'


def test_a_recovered_log_takes_no_other_logs_place(folder: Path) -> None:
    written(folder / "whole.mcap", ticks=200)
    (folder / "cut.mcap").write_bytes((folder / "whole.mcap").read_bytes()[:-600])
    content = (folder / "whole.mcap").read_bytes()
    with pytest.raises(InputError, match=r"whole\.mcap is there already and holds another log"):
        recover(folder / "cut.mcap", folder / "whole.mcap")
    assert (folder / "whole.mcap").read_bytes() == content
    recover(folder / "cut.mcap", folder / "new.mcap")
    recover(folder / "cut.mcap", folder / "new.mcap")
    recover(folder / "cut.mcap", folder / "whole.mcap", force=True)
    assert (folder / "whole.mcap").read_bytes() != content


@pytest.mark.parametrize(
    ("line", "link"),
    [
        (f"review {LOG} --save o.rrd", "o.rrd"),
        (f"report {LOG} --picture o.png", "o.png"),
        (f"plan {STILL} --out a.npz", "a.npz"),
        (f"run {STILL} --out o.mcap --force", "o.mcap"),
    ],
)
@pytest.mark.parametrize("hard", [False, True])
def test_no_verb_replaces_its_input_through_a_link(line: str, link: str, hard: bool) -> None:
    written(LOG)
    read = Path(line.split()[1])
    content = read.read_bytes()
    Path(link).hardlink_to(read) if hard else Path(link).symlink_to(read)
    ended = dpcontrol(*line.split())
    assert ended.code == 2, ended.stdout
    assert ended.message.endswith(f"{link}: that is the input {read}; choose another name")
    assert read.read_bytes() == content


@pytest.mark.parametrize("line", [f"plan {STILL} --out link.npz", f"run {STILL} --out link.mcap --force"])
def test_a_link_to_a_file_of_another_kind_is_not_followed(line: str) -> None:
    Path("notes.txt").write_text("mine")
    link = Path(line.split()[3])
    link.symlink_to("notes.txt")
    ended = dpcontrol(*line.split())
    assert ended.code == 2, ended.stdout
    assert f"cannot write {link}: it is a link to {Path('notes.txt').resolve()}; " in ended.message
    assert Path("notes.txt").read_text() == "mine"
    link.unlink()
    link.symlink_to(f"own{link.suffix}")
    assert dpcontrol(*line.split()).code == 0
    assert Path(f"own{link.suffix}").is_file()


def named(line: str) -> str:
    """Return the file or folder that a command wrote, as it printed it."""
    ended = dpcontrol(*line.split(), "--json")
    assert ended.code == 0, ended.stderr
    written = ended.document.get("log") or ended.document["file"]
    return str(written)


@pytest.mark.slow
def test_a_default_name_is_a_free_name_and_the_same_command_keeps_its_own() -> None:
    first, second, third = f"run {STILL}", f"run {STILL} --mismatch 0.07", f"run {STILL} --mismatch 0.08"
    for _ in range(2):
        assert named(first) == "logs/still-0.mcap"
        assert named(second) == "logs/still-0.2.mcap"
        assert named(third) == "logs/still-0.3.mcap"
    assert named(f"{third} --force") == "logs/still-0.mcap"
    line = "import --simulated lab --seconds 0.5 --swings"
    assert [named(f"{line} {k}") for k in (1, 2, 1)] == [f"logs/lab-swings-0{k}.mcap" for k in ("", ".2", "")]
    line = "replay logs/lab-swings-0.mcap --counts"
    assert [named(f"{line} {k}") for k in (400, 500)] == [f"logs/lab-swings-0-replay{k}.mcap" for k in ("", ".2")]


def test_a_log_that_is_being_written_gives_the_next_name() -> None:
    with claimed(LOG):
        assert named(f"run {STILL}") == "logs/still-0.2.mcap"
    assert named(f"run {STILL} --seed 0") == "logs/still-0.mcap"


def test_a_campaign_with_other_settings_gets_a_table_of_the_next_name() -> None:
    line = f"campaign {STILL} --workers 1 --runs"
    assert [named(f"{line} {k}") for k in ("1", "2", "1", "2 --mismatch 0.07")] == [
        "logs/still.parquet", "logs/still.parquet", "logs/still.2.parquet", "logs/still.3.parquet",
    ]  # fmt: skip


@pytest.mark.skipif(sys.platform == "darwin", reason="names of macOS are UTF-8")
def test_a_campaign_runs_in_a_folder_of_any_name_and_its_table_is_never_an_address(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (folder := Path(os.fsdecode(b"a\xff"))).mkdir()
    monkeypatch.chdir(folder)
    for table in ("logs/still.parquet", "s3:folder/still.parquet"):
        line = f"campaign ../{STILL} --workers 1 --runs 1" + f" --out {table}" * table.startswith("s3:")
        assert [named(line), named(line)] == [table, table]
        assert dpcontrol("report", table).code == 0


def test_a_law_that_does_not_fit_the_plan_is_refused_before_the_runs_of_others() -> None:
    ended = dpcontrol("campaign", STILL, "--runs", "1", "--workers", "1", "--over", "controller=lqr,ogy")
    assert ended.code == 2
    assert 'kind = "ogy" keeps an orbit' in ended.message
    assert not list(Path("logs").iterdir())


@pytest.mark.parametrize(
    ("line", "naming"),
    [
        ("campaign still.toml --out pipe.parquet --force", "pipe.parquet: it is not a regular file"),
        ("campaign still.toml --out loop.parquet", "loop.parquet: it is a link that leads to itself"),
        ("campaign still.toml --out full.parquet", "full.parquet.parts: full.parquet.parts is not a folder"),
        ("campaign still.toml --out /proc/x.parquet", "/proc/x.parquet: No such file or directory"),
        ("export still.toml --out full.parquet.parts", "full.parquet.parts: full.parquet.parts is not a folder"),
        ("export still.toml --out /proc/x", "/proc/x: No such file or directory"),
        ("figures graph --out /dev/null", "/dev/null: /dev/null is not a folder"),
        ("bench propagation --out /proc/x", "/proc/x: No such file or directory"),
        ("demo --folder /dev/null", "/dev/null: /dev/null is not a folder"),
        ("walk lab --energy -0.07 --length 2 --solve --out /dev/null", "/dev/null: /dev/null is not a folder"),
        ("run still.toml", "logs/still-0.mcap: it is not a regular file"),
    ],
)
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="/proc is Linux's")
def test_an_output_that_cannot_be_written_is_refused_before_the_work(
    line: str, naming: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo("pipe.parquet")
    os.mkfifo(LOG)
    Path("loop.parquet").symlink_to("loop.parquet")
    Path("full.parquet.parts").touch()
    before = sorted(Path().rglob("*"))
    for work in (
        "runs.campaign.run_locally", "runs.run._exported", "api.draw_figures", "bench.run.draw_charts", "api.plan",
        "plans.model.load_model", "runs.run.run_plan",
    ):  # fmt: skip
        monkeypatch.setattr(f"dpcontrol.{work}", None)
    ended = dpcontrol(*line.split())
    assert ended.code == 2, ended.stderr
    assert f"cannot write {naming}; choose another " in ended.message
    assert ended.message.endswith((" file or folder", " file name", " folder"))
    assert sorted(Path().rglob("*")) == before


def test_an_interrupted_campaign_continues_its_own_table(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(jobs: Sequence[Job], workers: int) -> Iterator[tuple[Job, list[dict[str, object]]]]:
        yield jobs[0], run_job(jobs[0])
        raise KeyboardInterrupt

    line = f"campaign {STILL} --workers 1 --runs 2 --over mismatch=0.01,0.02"
    with monkeypatch.context() as patched:
        patched.setattr("dpcontrol.runs.campaign.run_locally", interrupted)
        assert dpcontrol(*line.split()).code == 130
    kept = list(Path("logs/still.parquet.parts").glob("*.parquet"))
    assert len(kept) == 1
    assert named(f"campaign {STILL} --workers 1 --runs 2 --mismatch 0.07") == "logs/still.2.parquet"
    assert list(Path("logs/still.parquet.parts").glob("*.parquet")) == kept
    asked: list[int] = []

    def counted(jobs: Sequence[Job], workers: int) -> Iterator[tuple[Job, list[dict[str, object]]]]:
        asked.append(len(jobs))
        return ((job, run_job(job)) for job in jobs)

    monkeypatch.setattr("dpcontrol.runs.campaign.run_locally", counted)
    assert named(line) == "logs/still.parquet"
    assert asked == [1]
    assert not Path("logs/still.parquet.parts").exists()
