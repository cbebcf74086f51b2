"""Users' scripts check under the strict modes of pyright and mypy, with the settings that the guide gives."""

import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import dpcontrol

pytestmark = pytest.mark.slow
ROOT = Path(dpcontrol.__file__).parents[1]
EXAMPLES = sorted((ROOT / "dpcontrol" / "examples").glob("[a-z]*.py"))
OUTSIDE = {
    "gym_env": "gymnasium",
    "environment_scores": "gymnasium",
    "mujoco_rig": "mujoco",
    "inverted_double_pendulum": "gymnasium",
}
"""Examples of packages that are extras."""
MISTAKEN = """# pyright: strict
import dpcontrol as dp

run = dp.run("outer-turn", mismatch="much")
law: dp.Law = "adaptive"
rig: dp.Rig = run.score().completed
"""
"""A script with three mistakes, which the checkers find only if they see the types."""


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a user's folder with the guide's settings and the examples."""
    folder = tmp_path_factory.mktemp("typed")
    guide = (ROOT / "dpcontrol" / "guide" / "python.md").read_text(encoding="utf-8")
    (config,) = re.findall(r"```toml\n(# pyproject\.toml\n.*?)```", guide, re.DOTALL)
    paths = f'extraPaths = ["{ROOT.as_posix()}"]'
    text = config.replace("[tool.pyright]", f"[tool.pyright]\n{paths}")
    (folder / "pyproject.toml").write_text(text, encoding="utf-8")
    for file in EXAMPLES:
        if file.stem not in OUTSIDE or find_spec(OUTSIDE[file.stem]) is not None:
            shutil.copy(file, folder)
    (folder / "mistaken.py").write_text(MISTAKEN, encoding="utf-8")
    return folder


def checked(folder: Path, *command: str) -> str:
    """Return the output of a checker."""
    pytest.importorskip(command[0])
    environment = {**os.environ, "MYPYPATH": str(ROOT), "PYTHONPATH": ""}
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    return done.stdout + done.stderr


PYRIGHT = ("pyright", "--pythonpath", sys.executable)
MYPY = ("mypy", "--strict", "--follow-imports=silent")


@pytest.mark.parametrize("checker", [PYRIGHT, MYPY], ids=lambda checker: checker[0])
def test_a_checker_accepts_the_examples_and_finds_mistakes(checker: tuple[str, ...], project: Path) -> None:
    found = checked(project, *checker, *sorted(file.name for file in project.glob("*.py")))
    wrong = re.findall(r"(\w+\.py):(\d+)(?::\d+)?[:\s-]+error", found)
    assert {(file, int(line)) for file, line in wrong} == {("mistaken.py", line) for line in (4, 5, 6)}, found
