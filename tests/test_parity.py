"""Everything that the command line does is available in Python, under a name that no subpackage has."""

import inspect
from pathlib import Path

import pytest

import dpcontrol as dp
from dpcontrol.cli.main import VERBS
from dpcontrol.runs.closed_loop import ClosedLoop
from dpcontrol.runs.run import Run

CLASSES = {"ClosedLoop": ClosedLoop, "Run": Run}
IN_PYTHON = {
    "demo": ("run", "Run.plot"),
    "model": ("load_model", "equilibria", "mjcf"),
    "guide": ("read_guide",),
    "cache": ("cache",),
    "config": ("config",),
    "schema": ("schema",),
    "orbit": ("orbit", "family", "rotating_orbits", "rotating_families", "sustained_orbit"),
    "connect": ("connections", "refine"),
    "bifurcations": ("find_bifurcations",),
    "atlas": ("atlas", "open_atlas"),
    "walk": ("graph", "list_walks", "count_walks", "random_walks", "shortest_walk", "shadow", "symbol_changes"),
    "prove": ("prove", "check_proof"),
    "plan": ("plan", "polish", "explore_energies", "ClosedLoop.margins"),
    "reference": ("open_plan", "reference", "picture"),
    "planner": ("open_planner",),
    "run": ("run", "ClosedLoop.run", "ClosedLoop.night", "rig_link", "repeat"),
    "export": ("export", "ClosedLoop.export"),
    "campaign": ("campaign", "ClosedLoop.standard_score"),
    "rig": ("start_bench",),
    "commission": ("commission",),
    "preflight": ("ClosedLoop.preflight",),
    "score": ("open_log", "Run.score", "Run.why", "open_night"),
    "review": ("review", "compare_logs", "picture"),
    "report": ("Run.plot", "Run.margins", "open_night", "open_campaign"),
    "info": ("log_summary",),
    "recover": ("recover_log",),
    "import": ("open_recording", "write_recording", "swings"),
    "identify": ("identify", "design_experiments"),
    "replay": ("replay",),
    "figures": ("draw_figures",),
    "bench": ("draw_charts",),
}
"""For each verb the functions of `dp`, and methods of what they return, that do the same."""
SUBPACKAGES = {folder.name for folder in Path(dp.__file__).parent.iterdir() if folder.is_dir()}


def test_every_verb_has_its_names_in_python() -> None:
    assert set(IN_PYTHON) == set(VERBS), "add the names of the function or method for each new verb"


@pytest.mark.parametrize("name", sorted({name for names in IN_PYTHON.values() for name in names}))
def test_a_name_in_python_exists_and_is_documented(name: str) -> None:
    owner, _, method = name.rpartition(".")
    assert owner or name in dp.__all__
    function = getattr(CLASSES[owner], method) if owner else getattr(dp, name)
    assert callable(function)
    assert (inspect.getdoc(function) or "").splitlines()[0].endswith(".")


def test_no_public_name_is_that_of_a_subpackage() -> None:
    """Importing the subpackage would otherwise replace the function."""
    assert {"rig", "orbits", "walks", "guide"} <= SUBPACKAGES
    assert not SUBPACKAGES & set(dp.__all__)
