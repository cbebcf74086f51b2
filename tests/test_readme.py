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
from command_line import Ended, dpcontrol

from dpcontrol.cli.main import VERBS

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)
ENVIRONMENT = "python3 -m venv .venv && .venv/bin/pip install -e "


def blocks(kind: str) -> list[str]:
    return [text for name, text in BLOCKS if name == kind]


def conversations(text: str = README) -> list[tuple[str, list[str]]]:
    """Return each `$ command` of the console blocks of `text` with the lines that it is said to print."""
    found: list[tuple[str, list[str]]] = []
    for block in re.findall(r"^```console\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        for line in block.splitlines():
            if line.startswith("$ "):
                found.append((line[2:], []))
            elif line:
                found[-1][1].append(line)
    return found


SECTIONS = {text.split("\n", 1)[0]: conversations(text) for text in README.split("\n## ")[1:] if conversations(text)}
"""The README's sections that hold commands, by title."""
LONG = [title for title, shown in SECTIONS.items() if "dpcontrol bench" in str(shown)] + [
    "The atlas of an energy",
    "Write an itinerary",
    "The bench, and what controls it",
    "Recordings from a rig",
]
"""Sections that take longest: they draw a chart, search many energies, fly several itineraries, or fit a model."""


def makers(text: str) -> list[str]:
    """Return the commands that make the logs which `text` names: those that print a log's name first."""
    found: dict[str, str] = {}
    for command, lines in conversations():
        for name in re.findall(r"^logs/\S+", "\n".join(lines), re.MULTILINE):
            found.setdefault(name, command)
    return [command for name, command in found.items() if name in text]


def commands_in_text() -> list[str]:
    """Return the complete `dpcontrol …` commands that tables quote: those of the numbers reached."""
    return re.findall(r"\| `(dpcontrol [^`]+)` \|$", README, re.MULTILINE)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the files that the README shows, under the names it gives them."""
    for text in blocks("toml"):
        (name,) = re.findall(r"\A# ([\w/-]+\.toml)\n", text)
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.fixture(autouse=True)
def in_the_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work there, without a renderer, and with a viewer that only looks on."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("VK_DRIVER_FILES", "/nonexistent")
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("dpcontrol.review.picture.viewer_program", lambda: Path("/bin/true"))


def said(line: str) -> re.Pattern[str]:
    """Return what matches a line of the README in a program's output: … is anything, spaces may differ in number."""
    words = [".*?".join(map(re.escape, word.split("…"))) for word in line.split()]
    return re.compile(r"\s+".join(words), re.MULTILINE)


def ended_as_said(command: str) -> Ended:
    """Run a command of the README and check its exit code."""
    words = shlex.split(command, comments=True)
    assert words[0] == "dpcontrol"
    ended = dpcontrol(*words[1:])
    assert ended.code == (1 if "exits with 1" in command or "feedforward" in command else 0), (command, ended.stderr)
    return ended


def test_the_readme_shows_every_verb_at_work() -> None:
    assert {command.split()[1] for command, _ in conversations()} >= set(VERBS) - {"demo", "rig"}


@pytest.mark.parametrize(
    "section",
    [pytest.param(title, marks=pytest.mark.slow if title in LONG else []) for title in SECTIONS],
)
def test_the_commands_of_a_section_print_what_it_shows(section: str) -> None:
    own = [command for command, _ in SECTIONS[section]]
    for command in makers("\n".join(own)):
        if command not in own:
            ended_as_said(command)
    for command, lines in SECTIONS[section]:
        ended = ended_as_said(command)
        for line in lines:
            assert said(line).search(ended.stdout), f"{command}\ndid not print\n{line}\nbut\n{ended.stdout}"
        for name in re.findall(r"--(?:out|save|picture) (\S+)", command):
            assert Path(name).exists(), f"{command} did not write {name}"


@pytest.mark.parametrize("block", [pytest.param(text, id=text.split("\n")[0]) for text in blocks("python")[1:]])
def test_the_python_shown_runs(block: str) -> None:
    """The first block, the front door, is run by test_api."""
    for command in makers(block):
        ended_as_said(command)
    exec(compile(block, "README.md", "exec"), {})


def test_the_commands_that_show_the_numbers_run() -> None:
    assert len(commands_in_text()) >= 4
    for command in commands_in_text():
        ended_as_said(command)


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
    assert len(topics) == 10
    assert set(re.findall(r"`(/[a-z_/]+)`", table)) == topics
