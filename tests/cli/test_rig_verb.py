"""`dpcontrol rig` as a separate program, and `dpcontrol run --rig` with it."""

import json
import subprocess
from pathlib import Path

import pytest
from command_line import PROGRAM, dpcontrol


@pytest.mark.slow
def test_a_run_on_a_bench_in_another_process_is_logged_without_truth(tmp_path: Path) -> None:
    command = [PROGRAM, "rig", "outer-turn", "--runs", "1", "--json"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as bench:
        assert bench.stdout is not None
        lines = [bench.stdout.readline()]
        while lines[-1].strip() != "}":
            lines.append(bench.stdout.readline())
        address = json.loads("".join(lines))["address"]
        log = tmp_path / "run.mcap"
        wrong = dpcontrol("run", "outer-turn", "--rig", address, "--rate", "500", "--out", tmp_path / "no.mcap")
        assert bench.wait(60) == 0
    assert wrong.code == 2
    assert "ticks at 1000 Hz, the loop at 500 Hz; run with --rate 1000" in wrong.message
    assert "orbit's exact rates, 7." in wrong.stderr
    ended = dpcontrol("run", "outer-turn", "--rig", "udp", "--real-time", "--out", log, "--json")
    shown = ended.document
    assert shown["completed"] is None
    assert "the true state is not known" in shown["reason"]
    # A computer that stalls for a tenth of a second loses the arms, and the run must report this.
    assert shown["deadlines"]["ticks"] > 0
    assert 0 < shown["thinking"]["median"] <= shown["thinking"]["within_99"]
    assert ended.code == (0 if shown["ending"] == "finished" and shown["symbols_completed"] == 1 else 1)
    found = dpcontrol("info", log, "--json").document
    assert found["metadata"]["deadlines_missed"] == str(shown["deadlines"]["missed"])
    assert "/estimate/joint_states" in json.dumps(found)
    assert "/truth/joint_states" not in json.dumps(found)
    again = dpcontrol("run", "--from", log)
    assert again.code == 2
    assert f"it was made on the rig at {found['metadata']['rig']}" in again.message
    assert not (tmp_path / "logs").exists()


def test_an_impossible_rig_gives_one_sentence() -> None:
    assert "must be udp://HOST:PORT" in dpcontrol("run", "outer-turn", "--rig", "tcp://x:1").message
    assert "--real-time applies to runs on a rig" in dpcontrol("run", "outer-turn", "--real-time").stderr
