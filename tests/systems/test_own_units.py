"""Results of systems with their own units are printed and drawn without J, s and rad."""

import re
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

import dpcontrol as dp
from dpcontrol.examples.henon_heiles import henon_heiles
from dpcontrol.plans.atlas import load_atlas, save_atlas

FOREIGN = re.compile(r"\d J\b|\d s\b|\((J|s|rad|rad/s)\)|θ|ω")


def texts(figure: Figure) -> str:
    return "\n".join(one.get_text() for one in figure.findobj(Text))


@pytest.mark.slow
def test_results_of_an_own_system_show_no_unit_of_si(tmp_path: Path) -> None:
    system = henon_heiles()
    orbit = dp.orbit(system, "top", energy=0.2)
    found = dp.connections(orbit)
    save_atlas(tmp_path / "atlas.npz", dp.atlas(system, energy=0.2))
    for result in (
        orbit,
        dp.family(system, "top", energies=(0.17, 0.2)),
        orbit.manifold(),
        found.connections[0],
        dp.shadow(found, [found.connections[0].name]),
        load_atlas(tmp_path / "atlas.npz"),
        dp.find_bifurcations(system, "top", "top", energies=(0.19, 0.2), samples=2),
    ):
        for shown in (repr(result), str(getattr(result, "status", "")), texts(result.plot())):
            assert not FOREIGN.search(shown), shown
