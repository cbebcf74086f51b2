"""The Python interface: the README's example, and results as values."""

import ast
import inspect
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from result_attributes import attributes, classes

import dpcontrol as dp
from dpcontrol import api
from dpcontrol.plans.itinerary import itinerary_from
from tests.api_reference import CLASSES, FUNCTIONS, GROUPS, GUIDE, entry, page, results

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
EXAMPLE = README.partition("```python\n")[2].partition("```")[0]


@pytest.mark.slow
def test_the_example_of_the_readme_runs_unchanged(example: dict[str, Any]) -> None:
    assert len([line for line in EXAMPLE.splitlines() if line and not line.startswith("import")]) <= 20
    assert example["run"].score().sentence.startswith("completed: 1 of 1 symbols")
    assert example["campaign"].completed.runs == 200
    assert 150 < example["campaign"].completed.successes <= 200


def test_there_are_at_most_seventy_two_functions_and_none_has_the_name_of_a_subpackage() -> None:
    """Importing the subpackage would otherwise replace the function."""
    assert len([name for name in dp.__all__ if inspect.isfunction(getattr(dp, name))]) <= 72
    assert not {folder.name for folder in Path(dp.__file__).parent.iterdir()} & set(dp.__all__)


@pytest.mark.slow
def test_a_run_in_memory_is_the_one_that_is_logged(example: dict[str, Any]) -> None:
    """Figures agree to rounding, because a log has times in whole nanoseconds."""
    memory, logged = example["run"].document(), example["logged"].document()
    apart = {key for key, value in memory.items() if logged[key] != value}
    assert apart <= {"log", "real_time_factor", "thinking"}
    assert example["logged"].frame().shape == example["run"].frame().shape


@pytest.mark.slow
def test_a_plan_of_a_walk_is_that_of_the_file_it_writes(example: dict[str, Any]) -> None:
    plan = example["reference"]
    assert itinerary_from(plan.itinerary.text, "walk", plan.itinerary.model) == plan.itinerary
    again = dp.open_plan(plan.file)
    assert again.itinerary.parts == plan.itinerary.parts
    # Another process may have stored the same plan in the meantime.
    timeless = [{**p.document()["reference"], "solve_seconds": None} for p in (again, plan)]
    assert timeless[0] == timeless[1]
    figures = [run.document() for run in (dp.run(again, mismatch=0.02, seed=3), example["run"])]
    for shown in figures:
        del shown["real_time_factor"], shown["thinking"]
    assert figures[0] == figures[1]


def test_importing_the_package_imports_nothing_else() -> None:
    script = "import sys; before = set(sys.modules); import dpcontrol; print(*(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["dpcontrol"]


def test_modules_that_are_imported_on_first_use_are_those_that_type_checkers_see() -> None:
    tree = ast.parse(Path(api.__file__).read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    seen = {alias.asname or alias.name: f"{node.module}.{alias.name}" for node in imports for alias in node.names}
    assert {name: f"dpcontrol.{module}" for name, module in api.STAGES.items()}.items() <= seen.items()


@pytest.mark.slow
@pytest.mark.parametrize("stem", GROUPS)
def test_a_page_of_the_reference_is_generated_from_the_docstrings(stem: str) -> None:
    assert (GUIDE / f"{stem}.md").read_text(encoding="utf-8") == page(stem), "run python tests/api_reference.py"


def test_the_reference_has_every_function_once() -> None:
    listed = [name for _, names in GROUPS.values() for name in names]
    assert sorted(listed) == sorted([*FUNCTIONS, *CLASSES])


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_docstring_of_a_function_describes_every_argument(name: str) -> None:
    described = re.findall(r"^- \*\*(\w+)\*\* \(.*?\) – \S", entry(name), re.MULTILINE)
    assert described == list(inspect.signature(getattr(dp, name)).parameters)


@pytest.mark.parametrize("kind", classes(), ids=lambda kind: kind.__name__)
def test_the_docstrings_of_a_result_describe_every_public_attribute(kind: type) -> None:
    assert [name for name, text in attributes(kind).items() if not text] == []


def test_each_class_of_results_is_described_on_one_page() -> None:
    listed = [kind for stem in GROUPS for kind in results(stem)]
    assert len(set(listed)) == len(listed)
    assert {kind.__name__ for kind in listed} == {kind.__name__ for kind in classes()} - set(CLASSES)
