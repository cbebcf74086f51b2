"""Certificates that several modules alter, proved once per session."""

import json
from typing import Any

import pytest

import dpcontrol as dp


@pytest.fixture(scope="session")
def certificates() -> dict[str, dict[str, Any]]:
    """Of lab's orbit about Down-Up, and of the shortest closed walk of one forward turn, at -0.07 J."""
    lab = dp.load_model("lab")
    graph = dp.graph(lab, energy=-0.07)
    walk = dp.shadow(graph, ["down-up +"], wraps=[0], periodic=True)
    proofs = {"orbit": dp.prove(dp.orbit(lab, "down-up", energy=-0.07)), "walk": dp.prove(walk, rivals=graph)}
    assert all(proof.proved for proof in proofs.values())
    return {name: json.loads(json.dumps(proof.certificate)) for name, proof in proofs.items()}
