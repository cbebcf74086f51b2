"""Installations are complete: the wheel includes models and itineraries, and a checkout uses its own."""

import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from extras_table import PAGE, TABLE, extras_table

import dpcontrol

ROOT = Path(__file__).parents[1]
WHERE = """
import json
import dpcontrol
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.model import load_model
print(json.dumps([dpcontrol.__file__, *(str(load(name).path.resolve()) for load, name in (
    (load_model, "lab"), (load_model, "printed"), (load_itinerary, "outer-turn"), (load_itinerary, "cross")))]))
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel as pip would build it from this checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (file,) = folder.glob("*.whl")
    return file


def found_from(folder: Path, *, path: Path | None) -> list[str]:
    """Return the paths of the package, its models and itineraries, by a new Python process in `folder`."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    if path is not None:
        environment["PYTHONPATH"] = str(path)
    done = subprocess.run(
        [sys.executable, "-c", WHERE], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_wheel_contains_every_model_and_itinerary_unchanged(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        carried = {n: archive.read(n) for n in archive.namelist() if n.startswith("dpcontrol/data/")}
    expected = {
        f"dpcontrol/data/{kind}/{file.name}": file.read_bytes()
        for kind in ("models", "itineraries")
        for file in (ROOT / kind).glob("*.toml")
    }
    assert {"dpcontrol/data/models/lab.toml", "dpcontrol/data/itineraries/outer-turn.toml"} <= set(expected)
    assert carried == expected


def test_the_wheel_carries_every_module_its_tables_and_pages_and_nothing_of_the_tests(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = {n for n in archive.namelist() if not n.startswith("dpcontrol/data/") and ".dist-info/" not in n}
    ends = ("*.py", "*.toml", "*.json", "*.md", "*.[ch]", "*.ipynb", "py.typed")
    package = {file for end in ends for file in (ROOT / "dpcontrol").rglob(end)}
    package |= set((ROOT / "dpcontrol/planner/static").iterdir())
    package |= {ROOT / "dpcontrol/control/target" / name for name in ("Makefile", "CMakeLists.txt")}
    assert names == {str(file.relative_to(ROOT)) for file in package}
    pages = {f"dpcontrol/guide/{name}.md" for name in ("README", "rig", "packets", "payoff")}
    assert {"dpcontrol/recordings/mappings/multi-arm.toml", "dpcontrol/py.typed", *pages} <= names


@pytest.mark.slow  # Two installations, seven seconds.
@pytest.mark.parametrize("kind", ["wheel", "sdist"])
def test_the_built_wheel_installs_and_runs_in_another_folder(kind: str, wheel: Path, tmp_path: Path) -> None:
    built, site = wheel, tmp_path / "site"
    if kind == "sdist":
        build = [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(tmp_path)]
        subprocess.run(build, cwd=ROOT, capture_output=True, check=True)
        (built,) = tmp_path.glob("*.tar.gz")
    # With nothing fetched: the packages that it needs, and what builds it, are this environment's.
    pip = [sys.executable, "-m", "pip", "install", "--no-deps", "--no-index", "--no-build-isolation", "--target"]
    done = subprocess.run([*pip, str(site), str(built)], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    environment = {**os.environ, "PYTHONPATH": str(site)}
    for program in ([sys.executable, site / "bin" / "dpcontrol"], [sys.executable, "-m", "dpcontrol"]):
        said = subprocess.run(
            [*program, "--version", "--json"], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        )
        versions = json.loads(said.stdout)
        assert versions["dpcontrol"] == dpcontrol.__version__
        assert set(versions) >= {"python", "system", "casadi", "heyoka", "numpy", "scipy", "rerun-sdk", "mcap"}
    assert found_from(tmp_path, path=site)[1:] == [
        str(site.resolve() / "dpcontrol" / "data" / kind / f"{name}.toml")
        for kind, name in (
            ("models", "lab"), ("models", "printed"), ("itineraries", "outer-turn"), ("itineraries", "cross")
        )
    ]  # fmt: skip


def test_the_guides_table_of_extras_is_the_one_that_the_project_gives() -> None:
    found = TABLE.search(PAGE.read_text(encoding="utf-8"))
    assert found is not None
    assert found[0] == extras_table()


def test_package_changes_and_citation_have_the_same_version() -> None:
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    cited = re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    released = [name for name in re.findall(r"^## \[(.+?)\]", changes, re.MULTILINE) if name != "Unreleased"]
    assert released[0] == dpcontrol.__version__
    assert cited is not None
    assert cited[1] == dpcontrol.__version__


@pytest.mark.slow
def test_the_working_folders_own_file_comes_before_the_shipped_one(tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    own = tmp_path / "models" / "lab.toml"
    own.write_bytes((ROOT / "models" / "lab.toml").read_bytes())
    _, lab, printed, *_ = found_from(tmp_path, path=ROOT)
    assert Path(lab) == own.resolve()
    assert Path(printed) == ROOT / "models" / "printed.toml"
