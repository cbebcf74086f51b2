"""Proofs of connections with their angles, and of a horseshoe of lab at -0.07 J."""

from dataclasses import replace

import numpy as np
import pytest
from command_line import dpcontrol

import dpcontrol as dp
from dpcontrol.foundation.version import PACKAGE

pytest.importorskip("flint")

from dpcontrol.proofs.balls import flint
from dpcontrol.proofs.prove import Energies, ProofSettings, prove_network
from dpcontrol.tubes.connections import Connection, ConnectionSearch

ENERGY = Energies.of("-0.07")
COMMAND = "dpcontrol prove horseshoe lab --from down-up --energy -0.07"
PAGE = (PACKAGE / "guide" / "theorems.md").read_text(encoding="utf-8")


def most_transversal(search: ConnectionSearch) -> Connection:
    return max(search.connections, key=lambda c: c.transversality_angle)


@pytest.fixture(scope="module")
def found() -> ConnectionSearch:
    return dp.connections(dp.orbit(dp.load_model("lab"), "down-up", energy=-0.07))


@pytest.mark.slow
def test_a_connection_between_strongly_unstable_orbits_is_proved_with_default_settings() -> None:
    """The multiplier of the orbit is 7e10."""
    found = dp.connections(dp.orbit(dp.load_model("lab"), "up-down", energy=0.49033))
    one = most_transversal(found)
    proof = prove_network("connection", [one], energy=Energies.of("0.49033"))
    assert proof.proved, proof.status


@pytest.mark.slow
def test_one_connection_given_twice_a_nonexistent_one_and_large_boxes_are_not_proved(found: ConnectionSearch) -> None:
    one = found.connections[0]
    proof = prove_network("connection", [one] * 2, energy=ENERGY)
    assert not proof.proved
    assert "link 2 is not proved to avoid the box of link 1" in proof.status
    assert not prove_network("connection", [one], energy=ENERGY, settings=replace(ProofSettings(), box=1e-2)).proved
    states = one.orbit.states + 1e-4 * np.sin(np.arange(4))
    proof = prove_network("connection", [replace(one, orbit=replace(one.orbit, states=states))], energy=ENERGY)
    assert not proof.proved
    assert proof.status.startswith("not proved: 1 of 1 (")
    assert "false" not in proof.status


@pytest.mark.slow
def test_all_eight_homoclinics_are_proved_as_the_guide_shows(found: ConnectionSearch) -> None:
    """Each walk on them is realised. Angles and states are those that the search computed."""
    ended = dpcontrol(*COMMAND.split()[1:], "--json")
    assert ended.code == 0, ended.stderr
    proof = ended.document
    assert f"$ {COMMAND}\n{proof['status']}\n" in PAGE
    for one in proof["links"]:
        computed = next(c for c in found.connections if c.name == one["name"])
        assert float(flint.arb(one["angle_deg"])) == pytest.approx(computed.transversality_angle, abs=0.01)
        for text, value in zip(one["state"], computed.state, strict=True):
            assert flint.arb(text).overlaps(flint.arb(float(value), 1e-9))
    least = np.array(proof["least"])
    assert least.shape == (8, 8)
    assert proof["wraps"] == least.max()
    assert proof["entropy"] > 0.6


@pytest.mark.slow
def test_the_heteroclinics_at_a_fifth_of_a_joule_are_proved() -> None:
    lab = dp.load_model("lab")
    found = dp.connections(dp.orbit(lab, "down-up", energy=0.2), dp.orbit(lab, "up-down", energy=0.2))
    proof = dp.prove(found)
    assert proof.proved, proof.status
    assert len(proof.figures["links"]) == 4
