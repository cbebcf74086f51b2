"""Results of systems with their own units are printed and drawn without J, s and rad."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

import dpcontrol as dp
from dpcontrol.examples.henon_heiles import henon_heiles
from dpcontrol.plans.atlas import load_atlas, save_atlas
from dpcontrol.walks.following import SymbolChange
from tests.command_line import dpcontrol

FOREIGN = re.compile(r"\d J\b|\d s\b|\((J|s|rad|rad/s)\)|θ|ω")


def texts(figure: Figure) -> str:
    return "\n".join(one.get_text() for one in figure.findobj(Text))


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    system = henon_heiles()
    orbit = dp.orbit(system, "top", energy=0.2)
    found = dp.connections(orbit)
    return {
        "orbit": orbit,
        "family": dp.family(system, "top", energies=(0.17, 0.2)),
        "tube": orbit.manifold(),
        "search": found,
        "connection": found.connections[0],
        "walk": dp.shadow(found, [found.connections[0].name]),
        "atlas": dp.atlas(system, energy=0.2),
        "bifurcations": dp.find_bifurcations(system, "top", "top", energies=(0.19, 0.2), samples=2),
    }


@pytest.mark.parametrize("name", ["orbit", "family", "tube", "search", "connection", "walk", "atlas", "bifurcations"])
def test_results_of_an_own_system_show_no_unit_of_si(name: str, results: dict[str, Any]) -> None:
    result = results[name]
    for shown in (repr(result), str(getattr(result, "status", "")), texts(result.plot())):
        assert not FOREIGN.search(shown), shown


def test_a_saved_atlas_keeps_its_labels(results: dict[str, Any], tmp_path: Path) -> None:
    save_atlas(tmp_path / "atlas.npz", results["atlas"])
    opened = load_atlas(tmp_path / "atlas.npz")
    assert opened.labels == ("x", "y", "p_x", "p_y")
    assert (opened.si, opened.unit("J")) == (False, "")


def test_arms_keep_their_units() -> None:
    lab = dp.load_model("lab").system
    assert lab.labels == ("θ₁ (rad)", "θ₂ (rad)", "ω₁ (rad/s)", "ω₂ (rad/s)")
    assert lab.unit("J") == " J"
    shown = texts(dp.orbit(lab, "down-up", energy=-0.07).plot())
    assert "-0.07 J" in shown
    assert " s" in shown


def test_other_coordinates_keep_their_names() -> None:
    system = dp.System.from_hamiltonian(
        "spring-pendulum",
        lambda q, p, c: (p[0] / q[1]) ** 2 / 2 + p[1] ** 2 / 2 + 10 * (q[1] - 1) ** 2 + q[1] * (q[0] - np.pi) ** 2 / -2,
        coordinates=("angle", "length"),
        equilibria={"up": (np.pi, 1.0)},
    )
    assert system.labels == ("angle", "length", "p_angle", "p_length")


def test_a_change_of_symbol_has_the_unit_of_its_system() -> None:
    for unit in (" J", ""):
        assert f"beyond 0.2{unit} (±0.01)" in SymbolChange("top +", 0.2, 0.01, "a", "b", False, unit).sentence


@pytest.mark.parametrize(
    "command",
    [
        "model three-body",
        "orbit three-body --saddle L1 --energy -1.515",
        "orbit three-body --saddle L1 --energies -1.518 -1.515",
        "orbit three-body --saddle L1 --energy -1.6",
    ],
)
def test_three_bodies_are_printed_without_units_of_si(command: str) -> None:
    ended = dpcontrol(*command.split())
    assert not FOREIGN.search(ended.stdout + ended.stderr.replace("done", ""))
