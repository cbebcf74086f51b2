"""Help is quick and its examples run, words are completed, and stdout holds one JSON document and nothing else."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from click.shell_completion import ShellComplete
from command_line import dpcontrol, dpcontrol_program

from dpcontrol.cli.main import cli
from dpcontrol.loop.controllers import CONTROLLERS

ITINERARIES = Path(__file__).parents[2] / "itineraries"
HEAVY = {"casadi", "heyoka", "rerun", "scipy", "matplotlib", "numpy"}
LOADED = """
import sys
from dpcontrol.cli.main import main
try:
    main(sys.argv[1:])
except SystemExit as ended:
    assert ended.code == 0
print("loaded", *sys.modules)
"""


def loaded_by(*arguments: str) -> set[str]:
    """Return the modules that a call of the program has loaded when it ends."""
    done = subprocess.run([sys.executable, "-c", LOADED, *arguments], capture_output=True, text=True, check=True)
    return set(done.stdout.strip().splitlines()[-1].split()[1:])


def test_help_loads_nothing_heavy() -> None:
    assert HEAVY & loaded_by("--help") == set()
    # And the check can see them: a verb that computes loads these.
    assert {"casadi", "heyoka", "numpy"} <= loaded_by("orbit", "lab", "--saddle", "down-up", "--energy", "-0.07")


@pytest.mark.parametrize(
    "verb", ["model", "orbit", "connect", "plan", "score", pytest.param("run", marks=pytest.mark.slow)]
)
def test_the_example_in_a_verbs_help_runs(verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = dpcontrol(verb, "--help")
    assert shown.code == 0
    assert "--json" in shown.stdout
    (example,) = re.findall(r"Example: +(dpcontrol .*?)(?:  |$)", shown.stdout, re.MULTILINE)
    words = shlex.split(example)
    assert words[:2] == ["dpcontrol", verb]
    monkeypatch.chdir(tmp_path)
    if "logs/outer-turn-0.mcap" in words:
        assert dpcontrol("run", "outer-turn").code == 0
    ended = dpcontrol(*words[1:])
    assert ended.code == 0, ended.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "line",
    [
        "model lab",
        "connect lab --from down-up --to up-down --energy 0.2",
        "plan hold-down-down --fresh",
        "run outer-turn --controller feedforward",
        "review whole.mcap --save whole.rrd",
    ],
)
def test_json_is_one_document_on_stdout_and_messages_go_to_stderr(line: str, tmp_path: Path) -> None:
    if "whole.mcap" in line:
        hold = ("run", "hold-down-down", "--set", "seconds=1")
        assert dpcontrol(*hold, "--out", tmp_path / "whole.mcap").code == 0
    ended = dpcontrol_program(*line.split(), "--json", folder=tmp_path)
    assert ended.code == (1 if "feedforward" in line else 0)
    assert isinstance(ended.document, dict)
    assert ("not completed" in ended.stderr) is bool(ended.code)


def offered(line: str) -> list[str]:
    """Return the completions of the last word of a line; "" if the shell completes files."""
    *words, last = line.split(" ")
    found = ShellComplete(cli, {}, "dpcontrol", "_DPCONTROL_COMPLETE").get_completions(words[1:], last)
    return [item.value if item.type == "plain" else "" for item in found]


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("dpcontrol plan ", {file.stem for file in ITINERARIES.glob("*.toml")}),
        ("dpcontrol run outer-turn --set drive.la", {"drive.lag="}),
        ("dpcontrol run outer-turn --controller ", set(CONTROLLERS)),
        ("dpcontrol connect three-body --from ", {"L1", "L2", "L3"}),
        ("dpcontrol run outer-turn --rig ./my", {""}),
        ("dpcontrol import x.csv --repair nan,g", {"nan,gaps"}),
        ("dpcontrol campaign outer-turn --over controller=lqr,a", {"controller=lqr,adaptive"}),
        ("dpcontrol campaign outer-turn --over nosuch=", set()),
    ],
)
def test_values_are_completed(line: str, wanted: set[str]) -> None:
    assert set(offered(line)) == wanted
