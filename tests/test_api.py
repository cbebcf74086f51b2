"""The Python interface: the README's example, and results as values."""

import inspect
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import dpcontrol as dp
from dpcontrol.plans.atlas import make_atlas
from dpcontrol.plans.itinerary import itinerary_from
from dpcontrol.references.reference import load_reference

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
EXAMPLE = README.partition("```python\n")[2].partition("```")[0]


def test_the_example_of_the_readme_runs_unchanged(example: dict[str, Any]) -> None:
    assert len([line for line in EXAMPLE.splitlines() if line and not line.startswith("import")]) <= 20
    assert example["run"].score().sentence.startswith("completed: 1 of 1 symbols")
    assert example["campaign"].completed.runs == 200
    assert 150 < example["campaign"].completed.successes <= 200


def test_there_are_at_most_sixty_functions() -> None:
    """Twice as many as verbs, because some verbs have several uses, such as orbits, families and rotating orbits."""
    functions = [name for name in dp.__all__ if inspect.isfunction(getattr(dp, name))]
    assert len(functions) <= 60
    assert all(hasattr(dp, name) for name in dp.__all__)
    assert set(dp.__all__) <= set(dir(dp))


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


@pytest.mark.slow
def test_runs_plans_and_atlases_draw_themselves(example: dict[str, Any], tmp_path: Path) -> None:
    assert len(example["run"].plot().axes) > 5
    for name, result in (
        ("plan", example["reference"]),
        ("atlas", dp.open_atlas(make_atlas(example["lab"], -0.07).file)),
    ):
        assert len(dp.picture(result, file=tmp_path / f"{name}.png").axes) > 1
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000


def test_results_show_themselves_in_a_line(example: dict[str, Any]) -> None:
    for name in ("lab", "orbit", "found", "walk", "reference", "run", "campaign"):
        assert len(repr(example[name])) < 300, name
        assert "\n" not in repr(example[name])


def test_a_failure_is_a_value_and_bad_input_an_error(example: dict[str, Any]) -> None:
    missed = dp.run(example["reference"], settings={"controller": "feedforward"}, mismatch=0.05)
    assert not missed.converged
    assert missed.status.startswith("NOT completed")
    with pytest.raises(dp.InputError, match="down-up"):
        dp.orbit(example["lab"], "down-upp", energy=-0.07)
    with pytest.raises(dp.InputError, match="mismatch = 2"):
        dp.run(example["reference"], mismatch=2.0)
    with pytest.raises(dp.InputError, match="no run has this setting; did you mean 'mismatch'"):
        dp.campaign(example["reference"], over={"mismach": [0.1]})
    with pytest.raises(dp.InputError, match="no arms"):
        _ = dp.load_model("three-body").arms


def test_an_interior_stop_has_the_fewest_wraps_by_default(example: dict[str, Any]) -> None:
    walk = dp.shadow(example["found"], ["down-up +", "down-up -"])
    assert walk.converged
    assert len(walk.wraps) == 1
    with pytest.raises(dp.InputError, match="1 interior stop"):
        dp.shadow(example["found"], ["down-up +", "down-up -"], wraps=[1, 2])


def test_progress_is_reported_to_a_function(example: dict[str, Any]) -> None:
    told: list[tuple[str, float]] = []
    dp.connections(example["orbit"], progress=lambda what, done: told.append((what, done)))
    assert told
    assert all(0 <= done <= 1 for _, done in told)


def test_importing_the_package_imports_nothing_else() -> None:
    script = "import sys; before = set(sys.modules); import dpcontrol; print(*(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["dpcontrol"]


def test_a_name_that_there_is_not_is_no_attribute() -> None:
    with pytest.raises(AttributeError, match="swing_up"):
        _ = dp.swing_up  # type: ignore[attr-defined]


def test_a_log_carries_the_plan_that_opens(example: dict[str, Any], tmp_path: Path) -> None:
    file = tmp_path / "reference.npz"
    file.write_bytes(example["logged"].log.attachments["reference.npz"])
    assert dp.open_plan(file).status == load_reference(file).status
