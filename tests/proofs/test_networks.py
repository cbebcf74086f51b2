"""Graphs and open walks are proved by covering relations, and altered certificates of them are rejected."""

import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import dpcontrol
from scipy.optimize import brentq
from test_certificates import corrupted, put, rejected

import dpcontrol as dp
from dpcontrol.walks.edges import Edges

pytest.importorskip("flint")

from dpcontrol.proofs.check import check
from dpcontrol.proofs.prove import Energies, Proof, prove_network

pytestmark = pytest.mark.slow
THROUGH_FIRST_BOX = 0.9
"""Passages that avoid the first box are shorter by less than a period of about ten."""
NEARLY_TANGENT = 0.1
"""Degrees; the cones of boxes of 1e-7 are wider at such an angle."""

Change = Callable[[dict[str, Any]], None]


def scaled(factor: float, *path: Any) -> Change:
    """Return a function that multiplies one number of a certificate."""

    def change(content: dict[str, Any]) -> None:
        place: Any = content
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = repr(factor * float(place[path[-1]]))

    return change


def dropped_link(content: dict[str, Any]) -> None:
    content["links"].pop()


def doubled_link(content: dict[str, Any]) -> None:
    content["links"].append(content["links"][0])


ALTERATIONS: dict[str, Change] = {
    "another format": put("format", value="dpcontrol proof 2"),
    "another statement": put("statement", value="the topological entropy is at least 1"),
    "names": put("names", value=["down-up +", "down-up -"]),
    "no orbit": put("orbits", value=[]),
    "a source that is absent": put("links", 0, "source", value=1),
    "a chart less": put("links", 0, "charts", 3),
    "a duration less": put("links", 1, "durations", 3),
    "a box without width": put("links", 0, "widths", 5, 0, value="0"),
    "a negative width": put("orbits", 0, "widths", 2, 1, value="-1e-8"),
    "a wide box": scaled(3, "links", 0, "widths", 20, 0),
    "a narrow box": scaled(0.1, "orbits", 0, "widths", 2, 0),
    "a negative duration": put("links", 0, "durations", 9, value="-0.1"),
    "a node": put("links", 0, "charts", 12, "node", 1, by="1e-6"),
    "a basis": put("links", 1, "charts", 12, "basis", 0, value=["0", "0", "0", "0"]),
    "a duration": put("links", 0, "durations", 9, by="1e-3"),
    "the winding": put("links", 0, "turns", value=[0, -1, 0, 0]),
    "turns of a rate": put("links", 0, "turns", value=[0, 1, 1, 0]),
    "the hits": put("links", 0, "symbols", 0, "hits", value=[1, 2]),
    "a section that is not crossed": put("links", 0, "symbols", 0, "section", "normal", value=["1", "0", "0", "0"]),
    "the marked node": put("links", 0, "symbols", 0, "node", value=3),
    "the stop": put("links", 0, "symbols", 0, "stop", 1, value="-3.2"),
    "the box that it joins": put("links", 1, "joins", value=0),
    "the energy": put("energy", by="1e-6"),
    "a mass": put("system", "mass", 0, by="1e-6"),
    "the arrival": put("links", 0, "time_in", by="-0.5"),
    "fewer wraps": put("wraps", value=3),
    "more wraps": put("wraps", value=5),
    "a greater entropy": put("entropy", by="1e-3"),
    "a missing link": dropped_link,
    "a link given twice": doubled_link,
}


@pytest.fixture(scope="module")
def content(network: Proof) -> dict[str, Any]:
    return json.loads(json.dumps(network.certificate))


def test_the_check_confirms_a_graph_with_its_wraps_and_its_entropy(network: Proof, content: dict[str, Any]) -> None:
    found = check(content)
    assert found.proved, found.status
    lines = str(found.statement).splitlines()
    assert [line.split(":")[0] for line in lines if line.startswith("link")] == ["link 1", "link 2"]
    assert any(f"at least {network.figures['wraps']} wraps" in line for line in lines)
    assert any(f"entropy is at least {network.figures['entropy']}" in line for line in lines)


def test_the_entropy_is_a_bound_of_that_of_computed_passages(network: Proof, graph: Edges) -> None:
    """Durations are those of the computed connections and orbit, in doubles.

    A passage between the marks of two links lasts as long as its wraps, with any number of extra rounds. So with
    x = exp(-h T) the entropy solves det(1 - A/(1 - x)) = 0. A has the exponentials of the shortest passages. The proof
    counts only passages through the orbit's first box.
    """
    first, second = (graph.connections[k] for k in (2, 5))
    period, pairs = first.source.period, list(product((first, second), repeat=2))
    least = np.ravel(network.figures["least"])
    phases = [(b.phase_out - a.phase_in) % 1.0 for a, b in pairs]
    stays = [a.time_in + b.time_out + (n + f) * period for (a, b), n, f in zip(pairs, least, phases, strict=True)]

    def gap(h: float) -> float:
        matrix = np.exp(-h * np.reshape(stays, (2, 2))) / (1 - np.exp(-h * period))
        return float(np.abs(np.linalg.eigvals(matrix)).max()) - 1

    exact = float(brentq(gap, 0.05, 5.0))
    assert THROUGH_FIRST_BOX * exact < network.figures["entropy"] < exact


@pytest.mark.usefixtures("remembered")
@pytest.mark.parametrize("name", list(ALTERATIONS))
def test_an_altered_certificate_of_a_graph_is_rejected_despite_a_valid_digest(
    content: dict[str, Any], name: str
) -> None:
    assert rejected(corrupted(content, ALTERATIONS[name], sealed=True))


def test_a_link_given_twice_counts_once(graph: Edges) -> None:
    once, twice = (dp.prove_graph(replace(graph, connections=(graph.connections[2],) * times)) for times in (1, 2))
    assert len(twice.figures["links"]) == 1
    assert twice.figures["entropy"] == once.figures["entropy"]
    assert twice.status.endswith("; left out: 1 connection")
    assert twice.figures["failed"] == [f"{graph.connections[2].name}: not proved to be apart"]


def test_a_graph_includes_a_connection_whose_manifolds_may_be_tangent() -> None:
    """The computed angle is 0.03°. Walks do not need it, but a proved connection does."""
    near = dp.graph("point-mass", energy=0.2)
    flat = min(near.connections, key=lambda c: c.transversality_angle)
    assert flat.transversality_angle < NEARLY_TANGENT
    proof = dp.prove_graph(replace(near, connections=(flat,)), energy=Fraction("0.2"))
    assert proof.proved, proof.status
    assert proof.status.startswith("proved: 1 distinct connection, of which 0 are proved to be transversal")
    assert [row["angle_deg"] for row in proof.figures["links"]] == [None]
    assert check(json.loads(json.dumps(proof.certificate))).proved
    alone = prove_network("connection", [flat], energy=Energies.of("0.2"))
    assert not alone.proved
    assert "the cones of both manifolds are not proved to be disjoint" in alone.status


def test_an_open_walk_is_proved_and_checked_on_the_command_line(tmp_path: Path) -> None:
    """Its statement has both symbols, with the wraps at the stop between them."""
    file = tmp_path / "walk.json"
    words = ("-s", "down-up +", "-s", "down-up -", "--wraps", "1")
    ended = dpcontrol("prove", "walk", "lab", "--energy", "-0.07", *words, "--out", file, "--json")
    assert ended.code == 0, ended.stderr
    assert ended.document["proved"]
    content = json.loads(file.read_text(encoding="utf-8"))
    found = check(content)
    assert found.proved, found.status
    assert "the next crossing follows after a time nearest to" in str(found.statement)
    assert rejected(corrupted(content, put("links", 0, "symbols", 0, "wraps", value=2), sealed=True))
    assert rejected(corrupted(content, put("links", 0, "symbols", 1, "turns", value=[0, 0, 0, 0]), sealed=True))


def test_an_open_walk_with_other_wraps_is_not_proved(graph: Edges) -> None:
    walk = dp.shadow(graph, ["down-up +", "down-up -"], wraps=[1])
    found = dp.prove(replace(walk, wraps=(2,)))
    assert not found.proved
    assert "the duration of its stop is that of 1 wraps instead of 2" in found.status
