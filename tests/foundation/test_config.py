"""Defaults of the command line: option before environment before file before built-in default."""

from pathlib import Path

import pytest
from command_line import dpcontrol

from dpcontrol.foundation.config import config_file, log_folder

STILL = 'start = "hold"\nhold = "down-down"\nseconds = 0.5\n[run]\nrate = 200\n'


@pytest.fixture(autouse=True)
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's configuration file, which is empty at first."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    for name in ("LOGS", "WORKERS", "SCHEDULER", "VIEWER", "COLOUR"):
        monkeypatch.delenv(f"DPCONTROL_{name}", raising=False)
    monkeypatch.chdir(tmp_path)
    place = config_file()
    place.parent.mkdir(parents=True)
    place.write_text("")
    return place


def sources() -> dict[str, tuple[object, str]]:
    found = dpcontrol("config", "--json").document["settings"]
    return {name: (one["value"], one["source"]) for name, one in found.items()}


def test_each_source_has_priority_over_the_next(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert sources()["logs"] == ("logs", "default")
    file.write_bytes(b'\xef\xbb\xbflogs = "of-file"\r\nworkers = 2\r\n')
    assert sources()["logs"] == ("of-file", str(file))
    monkeypatch.setenv("DPCONTROL_LOGS", "of-environment")
    assert sources()["logs"] == ("of-environment", "DPCONTROL_LOGS")
    assert sources()["workers"] == (2, str(file))
    assert log_folder() == Path("of-environment")
    Path("still.toml").write_text(STILL)
    assert dpcontrol("run", "still.toml", "--out", "of-option.mcap").code == 0
    assert Path("of-option.mcap").is_file()
    assert not Path("of-environment").exists()
