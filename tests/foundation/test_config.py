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
    from dpcontrol.foundation import config

    assert sources()["logs"] == ("logs", "default")
    file.write_bytes(b'\xef\xbb\xbflogs = "of-file"\r\nworkers = 2\r\n')
    config._read.cache_clear()
    assert sources()["logs"] == ("of-file", str(file))
    monkeypatch.setenv("DPCONTROL_LOGS", "of-environment")
    assert sources()["logs"] == ("of-environment", "DPCONTROL_LOGS")
    assert sources()["workers"] == (2, str(file))
    assert log_folder() == Path("of-environment")
    Path("still.toml").write_text(STILL)
    assert dpcontrol("run", "still.toml").code == 0
    assert [one.name for one in Path("of-environment").iterdir()] == ["still-0.mcap"]
    assert dpcontrol("run", "still.toml", "--out", "of-option.mcap").code == 0
    assert Path("of-option.mcap").is_file()
    assert not Path("of-file").exists()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("workers = '3'\n", "workers = '3': must be a whole number, 1 to 4096"),
        ("log = 'x'\n", "the key 'log' is unknown: did you mean 'logs'?"),
        ("colour = 'sometimes'\n", "colour = 'sometimes': allowed: auto, always, never"),
        ("workers = 2\nworkers = 3\n", "is not valid TOML"),
    ],
)
def test_a_mistake_in_the_file_ends_every_verb_but_help(file: Path, text: str, told: str) -> None:
    file.write_text(text)
    ended = dpcontrol("model", "lab")
    assert ended.code == 2
    assert ended.message.startswith(f"dpcontrol: {file}")
    assert told in ended.message
    for call in (("run", "--help"), ("help", "run"), ("run", "-h")):
        assert dpcontrol(*call).stdout.startswith("Usage: dpcontrol run")


@pytest.mark.parametrize("value", ["x", "-1", "", "1.5", "5000"])
def test_a_wrong_variable_is_named(monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    monkeypatch.setenv("DPCONTROL_WORKERS", value)
    ended = dpcontrol("model", "lab", "--json")
    assert ended.code == 2
    assert "DPCONTROL_WORKERS" in ended.document["status"]


def test_a_folder_does_not_take_the_name_of_a_log() -> None:
    Path("still.toml").write_text(STILL)
    Path("logs/still-0.mcap").mkdir(parents=True)
    assert dpcontrol("run", "still.toml").stdout.splitlines()[0] == "logs/still-0.2.mcap"


@pytest.mark.parametrize(
    ("name", "folder", "reason"),
    [
        ("HOME", f"/tmp/{'x' * 300}", "File name too long"),
        ("XDG_CONFIG_HOME", f"/tmp/{'x' * 300}", "File name too long"),
        ("XDG_CONFIG_HOME", "~nobody-here/config", "there is no home folder '~nobody-here'"),
    ],
)
def test_a_file_that_cannot_be_looked_at_counts_as_none_with_one_remark(
    monkeypatch: pytest.MonkeyPatch, name: str, folder: str, reason: str
) -> None:
    monkeypatch.delenv("XDG_CONFIG_HOME")
    monkeypatch.setenv(name, folder)
    ended = dpcontrol("config")
    assert ended.code == 0
    assert "(not found)" in ended.stdout
    assert ended.stderr.count("\n") == 1
    assert f"({reason}), so built-in defaults apply; set XDG_CONFIG_HOME" in ended.stderr
    assert dpcontrol("help", "plan").stdout.startswith("Usage: dpcontrol plan")


def test_a_tilde_in_the_folder_of_logs_is_the_home_folder_for_every_verb(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/someone")
    monkeypatch.setenv("DPCONTROL_LOGS", "~/runs")
    assert log_folder() == Path("/home/someone/runs")
    assert "[default: /home/someone/runs]" in " ".join(dpcontrol("demo", "--help").stdout.split())


def test_a_home_folder_of_nobody_is_not_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DPCONTROL_LOGS", "~nobody-here/runs")
    ended = dpcontrol("model", "lab")
    assert ended.code == 2
    assert "logs = '~nobody-here/runs': there is no home folder '~nobody-here'; set DPCONTROL_LOGS" in ended.message
