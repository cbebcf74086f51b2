"""Effort of an itinerary over energies."""

import pytest
from command_line import dpcontrol

from dpcontrol.bench import energies


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
