"""Effort of an itinerary over energies."""

import pytest
from command_line import dpcontrol

from dpcontrol.bench import energies
from dpcontrol.bench.chart import Point
from dpcontrol.bench.energies import energy_text


def loop(energy: float, effort: float, completed: float, *, own: bool = False) -> Point:
    return Point("loop", "", energy, effort, default=own, others={"energy": energy, "completed": completed})


def test_an_energy_is_poor_where_another_takes_less_or_more_runs_come_through() -> None:
    mine = loop(0.2, 1.0, 1.0, own=True)
    assert "good choice" in energy_text(0.2, [mine, loop(0.1, 0.95, 1.0), loop(0.05, 0.1, 0.5)])
    assert energy_text(0.2, [mine, loop(0.1, 0.5, 1.0)]).startswith("0.2 J is a poor choice: 0.1 J takes 0.5 m²/s³")
    fewer = loop(0.2, 1.0, 0.5, own=True)
    assert energy_text(0.2, [fewer, loop(0.1, 2.0, 1.0)]).endswith("100% of runs complete it, not 50%")


@pytest.mark.slow
def test_energies_of_an_itinerary_are_compared_in_closed_loop(tmp_path, monkeypatch) -> None:
    """Slow: plans and flies an itinerary at two energies."""
    monkeypatch.setattr(energies, "ENERGIES", (0.65, 1.0))
    monkeypatch.setattr(energies, "RUNS", 4)
    picture = tmp_path / "energies.png"
    ended = dpcontrol("plan", "outer-turn", "--explore-energy", str(picture), "--json")
    assert ended.code == 0, ended.stderr
    found = ended.document["energies"]
    assert "choice" in found["chosen"]
    assert picture.read_bytes().startswith(b"\x89PNG")
    loops = [p for p in found["panels"][0]["points"] if p["method"] == "loop"]
    assert len(loops) == 2
    assert all(p["error"] > p["others"]["reference"] for p in loops)


def test_energies_of_more_than_a_walk_are_refused(tmp_path) -> None:
    ended = dpcontrol("plan", "hold-down-up", "--explore-energy", str(tmp_path / "e.png"))
    assert ended.code == 2
    assert "compares energies of one walk" in ended.message
