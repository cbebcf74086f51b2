"""Every block of commands, Python and TOML in the README and the guide runs and prints the shown output.

Each section of a page is a separate slow test in a new folder with the page's files. Its blocks run in order, Python in
one namespace. Blocks of ```text are not run.

The two lines that set up an environment are not run here, but compared with the project's files. `.ci/run` extracts the
line that runs the tests from the README and executes it.
"""

import os
import re
import shlex
import tomllib
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from command_line import Ended, dpcontrol
from once import time_once

from dpcontrol.bifurcations import bifurcations
from dpcontrol.cli.verbs import VERBS
from dpcontrol.pages.figures import FIGURES
from dpcontrol.runs import preflight, remedies

ROOT = Path(__file__).parents[1]
GUIDE = ROOT / "dpcontrol" / "guide"
PAGES = {path: path.read_text(encoding="utf-8") for path in (ROOT / "README.md", *sorted(GUIDE.glob("*.md")))}
README = PAGES[ROOT / "README.md"]
ENVIRONMENT = "python3 -m venv .venv && .venv/bin/pip install -e "


class Block(NamedTuple):
    """A fenced block of a page: its kind and its text."""

    kind: str
    text: str

    def conversations(self) -> list[tuple[str, list[str]]]:
        """Return each `$ command` with its expected output."""
        found: list[tuple[str, list[str]]] = []
        for line in self.text.splitlines() if self.kind == "console" else ():
            if line.startswith("$ "):
                found.append((line[2:], []))
            elif line:
                found[-1][1].append(line)
        return found


def blocks(text: str, *kinds: str) -> list[Block]:
    """Return the blocks of a text, limited to `kinds` if any are given."""
    found = re.findall(r"^```(\w+)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [Block(kind, inside) for kind, inside in found if not kinds or kind in kinds]


EVERYTHING = "\n".join(PAGES.values())
FRONT_DOOR = blocks(README, "python")[0].text
"""The first example in Python, which test_api runs."""
COMMANDS = [one for block in blocks(EVERYTHING, "console") for one in block.conversations()]
TOML = [block.text for block in blocks(EVERYTHING, "toml")]


def sections(text: str) -> list[str]:
    """Return the parts of a page, from heading to heading of the second level, each beginning with its title."""
    return text.removeprefix("# ").split("\n## ")


class Section(NamedTuple):
    """A part of a page under one heading, with the blocks that run."""

    page: Path
    title: str
    blocks: list[Block]


SECTIONS = [
    Section(page, part.split("\n", 1)[0], running)
    for page, text in PAGES.items()
    for part in sections(text)
    if (running := [one for one in blocks(part, "console", "python") if one.text != FRONT_DOOR])
]


def made_by() -> dict[str, str]:
    """Return the commands that make the files of pages: those that print a log first, or write a file."""
    found: dict[str, str] = {}
    for command, lines in COMMANDS:
        makes = command.split()[1] in ("run", "import", "replay", "campaign")
        names = re.findall(r"^logs/\S+", "\n".join(lines), re.MULTILINE) if makes else []
        for name in [*names, *re.findall(r"--(?:out|save) (\S+\.\w+)", command)]:
            found.setdefault(name, command)
    return found


def makers(text: str) -> list[str]:
    """Return the commands that make the files named in `text`, in the order of their dependencies."""
    found: list[str] = []
    for name, command in made_by().items():
        if re.search(rf"{re.escape(name)}(?![\w.-])", text) and command not in text:
            found += [one for one in [*makers(command), command] if one not in found]
    return found


def commands_in_text() -> list[str]:
    """Return the complete `dpcontrol …` commands that tables quote: those of the numbers reached."""
    return re.findall(r"\| `(dpcontrol [^`]+)` \|$", EVERYTHING, re.MULTILINE)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the files that the pages show, under their names."""
    for text in TOML:
        for name in re.findall(r"\A# ([\w/-]+\.toml)\n", text):
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_text(text)
    return tmp_path


@pytest.fixture(autouse=True)
def in_the_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Change to the folder, with a passive viewer."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("dpcontrol.pages.viewer.viewer_program", lambda: Path("/bin/true"))


@pytest.fixture
def briefly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time the work of a chart once, sweep few energies, and let a preflight seek one border and try three changes.

    Each further border or change takes seconds of runs; test_preflight has all of them, and test_bifurcations sweeps
    more energies.
    """
    time_once(monkeypatch)
    sweep = bifurcations.SweepSettings
    monkeypatch.setattr(bifurcations, "SweepSettings", lambda samples: sweep(samples=min(samples, 4)))
    hazards, changes = preflight.hazards, preflight.changes
    # Remedies of a failed run try all changes, whether they were imported before or not.
    assert remedies.changes is changes
    monkeypatch.setattr(preflight, "hazards", lambda plan, scene, **most: hazards(plan, scene, **most)[1:2])
    monkeypatch.setattr(preflight, "changes", lambda scene: islice(changes(scene), 3))


def expected(line: str) -> re.Pattern[str]:
    """Return a pattern for a line of a page, in which … matches anything and spaces may vary."""
    words = [".*?".join(map(re.escape, word.split("…"))) for word in line.split()]
    return re.compile(r"\s+".join(words), re.MULTILINE)


def run_as_documented(command: str) -> Ended:
    """Run a command of a page and check its exit code."""
    words = shlex.split(command, comments=True)
    assert words[0] == "dpcontrol"
    ended = dpcontrol(*words[1:])
    exits = re.search(r"# .*exits with (\d+)", command)
    code = int(exits[1]) if exits else int("feedforward" in command)
    assert ended.code == code, (command, ended.stderr)
    return ended


def check_output(block: Block) -> None:
    """Run a block's commands and check what they print and write."""
    for command, lines in block.conversations():
        ended = run_as_documented(command)
        output = ended.stdout + ended.stderr if ended.code == 2 else ended.stdout
        for line in lines:
            assert expected(line).search(output), f"{command}\ndid not print\n{line}\nbut\n{output}"
        for name in re.findall(r"--(?:out|save|picture|film) (\S+)", command):
            assert Path(name).exists(), f"{command} did not write {name}"


def test_no_page_is_longer_than_its_bound() -> None:
    # The reference of the Python interface is generated, and read by looking up a function.
    written = {page: text for page, text in PAGES.items() if not page.stem.startswith("api-")}
    for page, text in written.items():
        assert text.count("\n") <= (220 if text is README else 280), page.name


def test_the_pages_show_every_verb_at_work() -> None:
    assert {command.split()[1] for command, _ in COMMANDS} >= set(VERBS) - {"demo", "rig", "planner"}


@pytest.mark.slow
@pytest.mark.usefixtures("briefly")
@pytest.mark.parametrize("section", SECTIONS, ids=lambda one: f"{one.page.parent.name}-{one.page.stem}-{one.title}")
def test_the_blocks_of_a_section_run_and_print_the_shown_output(section: Section) -> None:
    for command in makers("\n".join(block.text for block in section.blocks)):
        run_as_documented(command)
    names: dict[str, Any] = {}
    for block in section.blocks:
        if block.kind == "python":
            exec(compile(block.text, section.page.name, "exec"), names)
        else:
            check_output(block)


@pytest.mark.parametrize("text", TOML, ids=lambda text: text.split("\n")[0])
def test_the_toml_shown_is_that_of_a_model_an_itinerary_or_a_part_of_one(text: str, folder: Path) -> None:
    """`# models/NAME.toml` begins a whole file, `# added to itineraries/NAME.toml` an addition to a shipped one."""
    from dpcontrol.plans.itinerary import load_itinerary
    from dpcontrol.plans.model import load_model

    head = text.split("\n")[0]
    (added, name), *_ = re.findall(r"^# (added to )?([\w/-]+\.toml)$", head) or [("", "")]
    assert name, f"{head}: the first line must be a comment that names the file"
    assert [other.split("\n")[0] for other in TOML].count(head) == 1, f"{head} is shown twice"
    shown = folder / name
    if added:
        shown.parent.mkdir(exist_ok=True)
        shown.write_text((ROOT / name).read_text(encoding="utf-8") + text, encoding="utf-8")
    assert tomllib.loads(shown.read_text(encoding="utf-8"))
    kind = shown.parent.name
    if kind in ("models", "itineraries"):
        assert {"models": load_model, "itineraries": load_itinerary}[kind](str(shown))


@pytest.mark.slow
@pytest.mark.usefixtures("briefly")
def test_the_commands_that_show_the_numbers_run() -> None:
    figures = [command.split()[2:] for command in commands_in_text() if command.split()[1] == "figures"]
    # tests/pages/test_legibility.py draws each of them.
    assert {name for names in figures for name in names} <= set(FIGURES)
    others = [command for command in commands_in_text() if command.split()[1] != "figures"]
    assert len(others) >= 4
    for command in others:
        run_as_documented(command)


def test_every_verb_and_option_that_the_text_mentions_exists() -> None:
    helps = {verb: dpcontrol(verb, "--help") for verb in VERBS}
    helps["the program"] = dpcontrol("--help")
    assert all(ended.code == 0 for ended in helps.values())
    known = set(re.findall(r"--[a-z][a-z-]*", "".join(ended.stdout for ended in helps.values())))
    for page, text in PAGES.items():
        mentioned = re.findall(r"`(?:dpcontrol )?(\w*)[^`\n]*?(--[a-z][a-z-]*)", text)
        assert {option for verb, option in mentioned if verb != "ruff"} <= known, page.name


def test_the_two_lines_that_set_up_an_environment_are_there() -> None:
    lines = "".join(block.text for block in blocks(README, "sh")).splitlines()
    assert len(lines) == 2
    demo, tests = lines
    assert demo == f"{ENVIRONMENT}'.[all]' && .venv/bin/dpcontrol demo"
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
    assert tests in "".join(block.text for block in blocks(README, "sh")).splitlines()
    assert os.access(script, os.X_OK)
    for tool in ("ruff check", "ruff format --check", "pyright", "lint-imports"):
        assert f".venv/bin/{tool}" in text


def anchors(text: str) -> set[str]:
    """Return the anchors that forges give a page's headings."""
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    titles = re.findall(r"^#+ (.+)$", prose, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: f"{page.parent.name}-{page.stem}")
def test_the_links_of_a_page_lead_to_files_and_headings(page: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", PAGES[page]):
        if link.startswith(("https://", "http://")):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.is_file(), link
        assert not anchor or anchor in anchors(PAGES[target]), link


def test_every_picture_is_shown_and_is_one() -> None:
    links = re.findall(r"!\[[^\]]+\]\(([^)]+)\)|(?:src|srcset)=\"([^\"]+)\"", EVERYTHING)
    assert {Path(markdown or html).name for markdown, html in links} == {
        file.name for file in (ROOT / ".assets").iterdir()
    }
    for file in (ROOT / ".assets").iterdir():
        head = {".png": b"\x89PNG\r\n\x1a\n", ".gif": b"GIF89a", ".webp": b"RIFF"}[file.suffix]
        assert file.read_bytes().startswith(head)
        assert file.stat().st_size <= 3e6


def test_the_table_of_topics_is_that_of_the_logs() -> None:
    from dpcontrol.logs import layout

    names = [value for value in vars(layout).values() if isinstance(value, str)]
    topics = {name for name in names if re.fullmatch(r"(/[a-z_]+)+", name)}
    tables = re.findall(r"^\| topic .*?\n\n", EVERYTHING, re.MULTILINE | re.DOTALL)
    assert len(topics) == 10
    assert tables
    for table in tables:
        assert set(re.findall(r"`(/[a-z_/]+)`", table)) == topics
