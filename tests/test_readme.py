"""Every command in the README runs and prints what the README says.

The two lines that set up an environment are not run here, where one is already set up: `.ci/run` takes the line that
runs the tests from the README itself and executes it; here both are checked against the project's own files.
"""

import os
import re
import shlex
import tomllib
from pathlib import Path

import pytest
from command_line import dpcontrol

from dpcontrol.cli.main import VERBS

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)
ENVIRONMENT = "python3 -m venv .venv && .venv/bin/pip install -e "


def blocks(kind: str) -> list[str]:
    return [text for name, text in BLOCKS if name == kind]


def conversations() -> list[tuple[str, list[str]]]:
    """Return each `$ command` of the console blocks with the lines that it is said to print."""
    found: list[tuple[str, list[str]]] = []
    for line in "".join(blocks("console")).splitlines():
        if line.startswith("$ "):
            found.append((line[2:], []))
        elif line:
            found[-1][1].append(line)
    return found


def commands_in_text() -> list[str]:
    """Return the complete `dpcontrol …` commands that tables quote: those of the numbers reached."""
    return re.findall(r"\| `(dpcontrol [^`]+)` \|$", README, re.MULTILINE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that the README shows, under the names it gives them."""
    folder = tmp_path_factory.mktemp("readme")
    for text in blocks("toml"):
        (name,) = re.findall(r"\A# ([\w/-]+\.toml)\n", text)
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    return folder


@pytest.fixture(autouse=True)
def in_the_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work there, without a renderer, and with a viewer that only looks on."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("VK_DRIVER_FILES", "/nonexistent")
    monkeypatch.setattr("dpcontrol.review.viewer.viewer_program", lambda: Path("/bin/true"))


def said(line: str) -> re.Pattern[str]:
    """Return what matches a line of the README in a program's output: … is anything, spaces may differ in number."""
    words = [".*?".join(map(re.escape, word.split("…"))) for word in line.split()]
    return re.compile(r"\s+".join(words), re.MULTILINE)


def test_every_command_of_the_walk_through_prints_what_is_shown() -> None:
    shown = conversations()
    assert {command.split()[1] for command, _ in shown} >= {
        "model", "orbit", "connect", "plan", "run", "score", "review", "atlas", "bifurcations", "figures",
        "walk", "reference", "campaign", "report", "info", "recover", "import", "identify", "replay", "bench",
    }  # fmt: skip
    for command, lines in shown:
        words = shlex.split(command, comments=True)
        assert words[0] == "dpcontrol"
        ended = dpcontrol(*words[1:])
        assert ended.code == (1 if "exits with 1" in command else 0), (command, ended.stderr)
        for line in lines:
            assert said(line).search(ended.stdout), f"{command}\ndid not print\n{line}\nbut\n{ended.stdout}"
    assert Path("turn.rrd").is_file()
    assert Path("turn.png").is_file()
    assert Path("walk.png").is_file()
    assert len(list(Path("orbits").iterdir())) == 3


def test_the_commands_that_show_the_numbers_run() -> None:
    assert len(commands_in_text()) >= 4
    for command in commands_in_text():
        ended = dpcontrol(*shlex.split(command)[1:])
        assert ended.code == (1 if "feedforward" in command else 0), (command, ended.stderr)


def test_every_verb_and_option_that_the_text_mentions_exists() -> None:
    helps = {verb: dpcontrol(verb, "--help") for verb in VERBS}
    assert all(ended.code == 0 for ended in helps.values())
    known = set(re.findall(r"--[a-z][a-z-]*", "".join(ended.stdout for ended in helps.values())))
    mentioned = re.findall(r"`(?:dpcontrol )?(\w*)[^`\n]*?(--[a-z][a-z-]*)", README)
    assert {option for verb, option in mentioned if verb != "ruff"} <= known


def test_the_two_lines_that_set_up_an_environment_are_there() -> None:
    lines = "".join(blocks("sh")).splitlines()
    assert len(lines) == 2
    demo, tests = lines
    assert demo == f"{ENVIRONMENT}. && .venv/bin/dpcontrol demo"
    assert tests.startswith(f"{ENVIRONMENT}'.[dev]' && .venv/bin/pytest")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert "dpcontrol" in project["scripts"]
    extra = {re.split(r"[<>=\[ ]", text)[0] for text in project["optional-dependencies"]["dev"]}
    assert {"pytest", "ruff", "pyright", "import-linter"} <= extra
    assert "-n" not in tests.split() or "pytest-xdist" in extra
    python = re.search(r"Python (\d\.\d+) or newer", README)
    assert python is not None
    assert project["requires-python"] == f">={python[1]}"


def test_the_check_in_ci_takes_its_command_from_the_readme() -> None:
    script = ROOT / ".ci" / "run"
    text = script.read_text()
    (pattern,) = re.findall(r"grep -E '([^']+)' README\.md", text)
    (tests,) = [line for line in README.splitlines() if re.search(pattern, line)]
    assert tests in "".join(blocks("sh")).splitlines()
    assert os.access(script, os.X_OK)
    for tool in ("ruff check", "ruff format --check", "pyright", "lint-imports"):
        assert f".venv/bin/{tool}" in text


def test_the_files_that_the_readme_shows_or_links_to_exist() -> None:
    links = re.findall(r"\]\(([^)]+)\)", README)
    shown = [link for link in links if link.startswith(".assets/")]
    assert sorted(shown) == sorted(f".assets/{file.name}" for file in (ROOT / ".assets").iterdir())
    for link in links:
        assert (ROOT / link).is_file(), link
    for picture in shown:
        assert (ROOT / picture).read_bytes().startswith(b"\x89PNG\r\n\x1a\n")


def test_the_table_of_topics_is_that_of_the_logs() -> None:
    from dpcontrol.logs import layout

    names = [value for value in vars(layout).values() if isinstance(value, str)]
    topics = {name for name in names if re.fullmatch(r"(/[a-z_]+)+", name)}
    (table,) = re.findall(r"^\| topic .*?\n\n", README, re.MULTILINE | re.DOTALL)
    assert len(topics) == 9
    assert set(re.findall(r"`(/[a-z_/]+)`", table)) == topics
