"""One and three arms go through the same code: planned, run, scored, reviewed, reported and exported."""

from pathlib import Path
from typing import Any

import pytest
from command_line import dpcontrol

from dpcontrol.control import export


def document(*arguments: str | Path) -> Any:
    ended = dpcontrol(*arguments, "--json")
    assert ended.code == 0, ended.message
    return ended.document


@pytest.mark.slow
@pytest.mark.parametrize("arms", [1, 3])
def test_any_number_of_arms_goes_through_every_stage(
    arms: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Compiling the code of three arms to measure it takes a quarter of a minute.
    monkeypatch.setattr(export, "_measured", lambda files: (None, None))
    scene = {1: "one-arm", 3: "third-arm"}[arms]
    log, folder = tmp_path / "run.mcap", tmp_path / "controller"
    planned = document("plan", scene)
    assert len(planned["transfers"]) == 2
    assert planned["reference"]["max_error_between_nodes"] <= 1e-6
    bench = ("--seed", "1", "--mismatch", "0.02", "--delay", "1", "--lag", "0.005", "--counts", "40000")
    assert document("run", scene, *bench, "--out", log)["completed"]
    assert document("score", log)["completed"]
    document("review", log, "--save", tmp_path / "run.rrd")
    document("report", log, "--picture", tmp_path / "page.png")
    document("export", scene, "--out", folder)
    assert (tmp_path / "run.rrd").stat().st_size > 1e4
    assert (tmp_path / "page.png").stat().st_size > 1e4
    assert list(folder.glob("*.c"))
