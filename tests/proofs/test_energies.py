"""Statements for intervals of energies, their certificates, and intervals that are covered piece by piece."""

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import dpcontrol
from test_certificates import corrupted, put, rejected

import dpcontrol as dp

pytest.importorskip("flint")

from dpcontrol.proofs.balls import working
from dpcontrol.proofs.check import check
from dpcontrol.proofs.connect import chart_of
from dpcontrol.proofs.prove import Energies, Proof, over_range, surface_of
from dpcontrol.walks.edges import Edges

pytestmark = pytest.mark.slow
WITHIN = 2e-8
"""J; half the width that closes in one piece."""


@pytest.fixture(scope="module")
def interval(graph: Edges) -> Proof:
    """Of one connection, for all energies of an interval."""
    search = dp.connections(dp.orbit("lab", "down-up", energy=-0.07))
    proof = dp.prove_statement(
        "connection", "lab", saddle="down-up", energy=-0.07, within=WITHIN, names=[search.connections[2].name]
    )
    assert isinstance(proof, Proof)
    assert proof.proved, proof.status
    return proof


@pytest.fixture(scope="module")
def content(interval: Proof) -> dict[str, Any]:
    return json.loads(json.dumps(interval.certificate))


def test_one_proof_holds_for_an_interval_and_its_boxes_move_with_the_energy(content: dict[str, Any]) -> None:
    """The periodic orbit of another energy is in the moved boxes, and not in those of the middle."""
    assert check(content).proved
    assert "at each energy from -0.07000002 to -0.06999998, with boxes that move with it" in content["statement"]
    model = dp.load_model("lab")
    data, away = content["orbits"][0], 1e-4
    beside = [dp.orbit(model, "down-up", energy=-0.07 + sign * away) for sign in (-1, 1)]
    for k, chart in enumerate(data["charts"]):
        basis, node, tilt = (np.array(chart[key], dtype=float) for key in ("basis", "node", "tilt"))
        share = k / len(data["charts"])
        states = [other.system.propagator.flow(other.state, share * other.period) for other in beside]
        (low, high) = (np.linalg.solve(basis, state - node)[:2] for state in states)
        assert np.allclose((high - low) / (2 * away), tilt, rtol=1e-3, atol=1e-3)
        assert np.abs(tilt).max() > 0.1
    with working(128):
        surface = surface_of(model.system, Energies.of("-0.07", WITHIN))
        assert chart_of(data["charts"][0]).tilt[0] == Fraction(data["charts"][0]["tilt"][0])
        assert float(surface.energy.rad()) == pytest.approx(WITHIN)


def steeper(content: dict[str, Any]) -> None:
    chart = content["links"][0]["charts"][20]
    chart["tilt"] = [repr(100 * float(v)) for v in chart["tilt"]]


@pytest.mark.usefixtures("remembered")
@pytest.mark.parametrize(
    "change",
    [put("within", value="2e-6"), put("within", value="-2e-8"), put("energy", value="-0.0699"), steeper],
    ids=["wider", "negative", "another energy", "another tilt"],
)
def test_altered_intervals_are_rejected(content: dict[str, Any], change: Any) -> None:
    assert rejected(corrupted(content, change, sealed=True))


def test_an_interval_is_covered_by_pieces_without_gap() -> None:
    """Pieces are halved until one closes, and the next ones keep its width."""
    asked = list[Energies]()

    def prove(energies: Energies) -> Proof:
        asked.append(energies)
        closes = energies.within <= Fraction(1, 8)
        return Proof("graph", closes, "proved: it" if closes else "not proved", "", {"entropy": 0.5, "wraps": 4}, 1.0)

    whole = over_range(Energies.of(1, 1), prove)
    assert whole.proved
    assert [e.middle for e in asked[-8:]] == [Fraction(2 * k + 1, 8) for k in range(8)]
    assert (len(whole.figures["pieces"]), whole.figures["entropy"], whole.seconds) == (8, 0.5, 8.0)
    assert not over_range(Energies.of(1, 1), lambda _: Proof("graph", False, "not proved", "", {}, 1.0)).proved


def test_pieces_are_checked_and_a_gap_between_them_is_rejected(tmp_path: Path) -> None:
    file = tmp_path / "orbit.json"
    ended = dpcontrol(
        *("prove", "orbit", "lab", "--saddle", "down-up", "--energy", "-0.07", "--within", "8e-9"),
        *("--out", str(file), "--json"),
    )
    assert ended.code == 0, ended.stderr
    assert len(json.loads(ended.stdout)["pieces"]) > 1
    pieces = json.loads(file.read_text(encoding="utf-8"))
    assert check(pieces).proved
    assert "each energy from -0.070000008 to -0.069999992 is in one of" in pieces["statement"]
    assert "leave gaps" in check(corrupted(pieces, put("pieces", 1, "within", value="3.9e-9"), sealed=True)).status
    assert (
        "interval 1" in check(corrupted(pieces, put("pieces", 0, "period", value=["0.1", "0.2"]), sealed=True)).status
    )
