"""Logs of many complete files with continuous times, thinning of older files, and full disks."""

import errno
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dpcontrol.foundation.causes import Cause
from dpcontrol.foundation.errors import Remark
from dpcontrol.logs import Event, LogWriter, read_log
from dpcontrol.logs.container import McapFile
from dpcontrol.logs.rolling import Digest, RollingLog, digest_of_log

RATE = 100.0
EXTRAS = ("zero_1", "zero_2")
JOINED = {"at": 0.0, "symbol": 1, "symbols": 1, "name": "down-up +", "attempt": 1}


def make(path: Path, more: Mapping[str, str]) -> LogWriter:
    return LogWriter(
        path, arm_lengths=(0.2, 0.3), rate_hz=RATE, limits=(0.4, 3.0, 30.0), extras=EXTRAS,
        metadata={"seed": "7", **more}, attachments={"scene.toml": b"title = 1"},
    )  # fmt: skip


def rolling(folder: Path, **given: float) -> RollingLog:
    options = {"seconds": 1.0, "rate_hz": RATE, "limit": 0.4, "extras": EXTRAS, **given}
    return RollingLog(folder, folder.name, make, **options)  # type: ignore[arg-type]


def feed(log: RollingLog, first: int, end: int, *, off: float = 0.0) -> None:
    """Ticks from `first` to `end` of this session, five at a time, `off` rad from the reference."""
    for k in range(first, end, 5):
        rows = np.arange(k, min(k + 5, end))
        reference = np.column_stack([np.sin(rows[:, None] / 50 + np.arange(5)), 1e-3 * rows])
        state = reference + np.array([off, -off, 0, 0, 0, 0])
        state[:, 4] = 0.3 * np.sin(rows / 30)
        log.ticks(
            rows / RATE, measured=state[:, [0, 1, 4]], estimate=state, reference=reference, truth=state,
            control=np.zeros((len(rows), 13)), extras=np.column_stack([np.full((len(rows), 2), 1e-3), state[:, :2]]),
        )  # fmt: skip


def written(folder: Path, **given: float) -> list[Path]:
    with rolling(folder, **given) as log:
        log.event(Event(0.0, "info", "start", words="adaptive, ekf"))
        log.event(Event(0.0, "info", "resume", Cause.JOINED, JOINED))
        feed(log, 0, 130, off=0.1)
        log.event(Event(1.3, "warn", "return", Cause.TRACKING_LOST, {"time": 1.3, "error": 2.0}))
        feed(log, 130, 330, off=2.0)
        log.event(Event(3.3, "info", "resume", Cause.JOINED, JOINED))
        feed(log, 330, 520, off=0.1)
        log.result(ending="finished")
    return sorted(folder.glob("*.mcap"))


def test_each_file_opens_by_itself_and_times_go_on(tmp_path: Path) -> None:
    files = written(tmp_path / "turn-7")
    assert [file.name for file in files] == [f"turn-7-000{k}.mcap" for k in range(1, 7)]
    logs = [read_log(file) for file in files]
    assert np.concatenate([log.time for log in logs]) == pytest.approx(np.arange(520) / RATE)
    assert [log.time[0] for log in logs] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    for k, log in enumerate(logs):
        assert log.attachments == {"scene.toml": b"title = 1"}
        assert log.metadata["seed"] == "7"
        assert json.loads(log.metadata["night"]) == {"number": k + 1, "session": 1, "on": k in (1, 4, 5)}
    assert [event.name for log in logs for event in log.events] == ["start", "resume", "return", "resume"]
    assert logs[-1].metadata["ending"] == "finished"


def test_digests_of_written_and_of_read_data_are_equal(tmp_path: Path) -> None:
    for file in written(tmp_path / "turn-7"):
        told = Digest.of(file.with_suffix(".json").read_text())
        read = digest_of_log(read_log(file), size=file.stat().st_size)
        assert (told.number, told.on, told.ticks) == (read.number, read.on, read.ticks)
        assert [replace(event, words=event.text) for event in told.events] == read.events
        assert (told.first, told.end, told.cart) == pytest.approx((read.first, read.end, read.cart))
        assert (told.squares, told.followed, told.size) == pytest.approx((read.squares, read.followed, read.size))
        # The log has the extras at a slower rate.
        assert [v for v, _ in told.extras.values()] == pytest.approx([v for v, _ in read.extras.values()], abs=0.05)
        assert told.memory > 1e7


def test_older_files_are_thinned_and_their_digests_stay(tmp_path: Path) -> None:
    files = written(tmp_path / "turn-7", keep_every=3)
    assert [file.stem[-1] for file in files] == ["1", "4", "5", "6"]
    assert len([*(tmp_path / "turn-7").glob("*.json")]) == 6


def test_a_resumed_night_continues_in_time_and_number(tmp_path: Path) -> None:
    written(tmp_path / "turn-7")
    with rolling(tmp_path / "turn-7", session=2, number=7, begin=5.2) as log:
        feed(log, 0, 100)
    (seventh, eighth) = sorted((tmp_path / "turn-7").glob("*.mcap"))[6:]
    assert read_log(seventh).time[[0, -1]] == pytest.approx([5.2, 5.99])
    assert read_log(eighth).time[[0, -1]] == pytest.approx([6.0, 6.19])


def test_a_full_disk_costs_the_file_that_was_being_written_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, full = McapFile.add_chunk, [False]

    def add_chunk(self: McapFile, *given: object) -> None:
        if full[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(self, *given)  # type: ignore[arg-type]

    monkeypatch.setattr(McapFile, "add_chunk", add_chunk)
    folder = tmp_path / "turn-7"

    def run() -> None:
        with rolling(folder) as log:
            feed(log, 0, 130)
            full[0] = True
            feed(log, 130, 270)
            full[0] = False
            feed(log, 270, 450)

    with pytest.warns(Remark, match=r"No space left.*goes on, without a log up to"):
        run()
    whole = [read_log(file).time[[0, -1]].tolist() for file in sorted(folder.glob("*.mcap"))]
    assert whole == [[0.0, 0.99], [3.0, 3.99], [4.0, 4.49]]
    lost = [Digest.of(file.read_text()) for file in sorted(folder.glob("*.json"))][1:3]
    assert [(digest.number, digest.size, digest.ticks) for digest in lost] == [(2, 0, 100), (3, 0, 100)]
    assert "No space left" in lost[0].loss
