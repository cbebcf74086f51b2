"""Proofs that several modules use, made once per session, and their certificates."""

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

import dpcontrol as dp
from dpcontrol.walks.edges import Edges
from dpcontrol.walks.shadowing import ShadowingOrbit

if TYPE_CHECKING:
    # It needs flint, without which the modules here are skipped.
    from dpcontrol.proofs.prove import Proof


@pytest.fixture(scope="session")
def graph() -> Edges:
    """Lab's connections at -0.07 J."""
    return dp.graph(dp.load_model("lab"), energy=-0.07)


@pytest.fixture(scope="session")
def turn(graph: Edges) -> ShadowingOrbit:
    """The shortest closed walk of one forward turn."""
    return dp.shadow(graph, ["down-up +"], wraps=[0], periodic=True)


@pytest.fixture(scope="session")
def proofs(graph: Edges, turn: ShadowingOrbit) -> "dict[str, Proof]":
    """Of lab's orbit about Down-Up at -0.07 J, of the closed walk, and of an orbit of the three bodies about L1."""
    found = {
        "orbit": dp.prove(dp.orbit(dp.load_model("lab"), "down-up", energy=-0.07)),
        "walk": dp.prove(turn, rivals=graph),
        "three bodies": dp.prove(dp.orbit(dp.load_model("three-body"), "L1", energy=-1.515)),
    }
    assert all(proof.proved for proof in found.values())
    return found


@pytest.fixture(scope="session")
def network(graph: Edges) -> "Proof":
    """Of both symmetric connections of lab at -0.07 J that are nearest to orthogonal."""
    proof = dp.prove_graph(replace(graph, connections=tuple(graph.connections[k] for k in (2, 5))))
    assert proof.proved, proof.status
    return proof


@pytest.fixture(scope="session")
def certificates(proofs: "dict[str, Proof]") -> dict[str, dict[str, Any]]:
    """Their certificates, as files hold them."""
    return {name: json.loads(json.dumps(proof.certificate)) for name, proof in proofs.items()}


FLIGHTS: dict[str, Any] = {}


@pytest.fixture
def remembered() -> Iterator[None]:
    """Let the check enclose flights of equal nodes once, since most alterations leave them as they are."""
    from dpcontrol.proofs import check as checking

    fly = checking._Flow.flight

    def flight(flow: Any, x: Any, spread: Any, duration: Any) -> Any:
        key = repr(([str(v) for v in [*flow.numbers, *x, *spread.entries()]], duration))
        if key not in FLIGHTS:
            FLIGHTS[key] = fly(flow, x, spread, duration)
        return FLIGHTS[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checking._Flow, "flight", flight)
        yield
