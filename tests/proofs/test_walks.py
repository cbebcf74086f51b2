"""Closed walks are proved with their symbols."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_walks import MOST_SECONDS, proved, read, summary

import dpcontrol as dp

pytest.importorskip("flint")

from dpcontrol.proofs.balls import flint, working
from dpcontrol.proofs.prove import Proof, ProofSettings
from dpcontrol.walks.edges import Edges
from dpcontrol.walks.shadowing import ShadowingOrbit


@pytest.mark.slow
def test_a_closed_walk_is_proved_with_its_period_multiplier_symbol_and_wraps(
    proofs: dict[str, Proof], turn: ShadowingOrbit
) -> None:
    proof = proofs["walk"]
    estimate = turn.estimate
    assert estimate is not None
    assert estimate.multipliers is not None
    with working(128):
        # The walk's estimate in doubles is near the enclosures.
        assert abs(flint.arb(proof.figures["period"]) - turn.duration) < 1e-10
        outside = flint.arb(proof.figures["multipliers"][0])
        assert abs(abs(outside).log() - estimate.multipliers.log_unstable) < 1e-3
        assert (outside > 0) == (estimate.multipliers.sign > 0)
    assert [(s["crossings"], s["wraps"]) for s in proof.figures["symbols"]] == [(1, 0)]
    assert proof.certificate is not None
    assert proof.certificate["turns"] == [0, 1, 0, 0]
    assert float(proof.figures["exists_within"]) < 1e-11 < float(proof.figures["unique_within"])


@pytest.mark.slow
def test_a_walk_with_other_symbols_wraps_or_turns_is_not_proved(graph: Edges, turn: ShadowingOrbit) -> None:
    other = next(c for c in graph.connections if c.sense > 0 and c.name != turn.walk[0])
    for wrong in (
        replace(turn, connections=(other,)),
        replace(turn, wraps=(1,)),
        replace(turn, offsets=turn.offsets + np.array([[0.0] * 4, [0.0, 1.0, 0.0, 0.0]])),
    ):
        found = dp.prove(wrong, rivals=graph)
        assert not found.proved
        assert found.status.startswith("not proved: a closed orbit exists")


@pytest.mark.slow
def test_a_perturbed_orbit_is_not_proved(turn: ShadowingOrbit) -> None:
    states = turn.orbit.states.copy()
    states[5] += 1e-5
    found = dp.prove(replace(turn, orbit=replace(turn.orbit, states=states)), settings=ProofSettings(tries=1))
    assert not found.proved
    assert found.status.startswith("not proved: ")


@pytest.mark.slow
def test_random_walks_are_proved_and_reported(tmp_path: Path) -> None:
    """Seed 10 has a rival connection that is nearer than the length of a step."""
    found = proved(10, tmp_path / "walks.jsonl")
    assert found["code"] == 0, found
    assert found["cpu"] < MOST_SECONDS
    (line,) = read(tmp_path / "walks.jsonl")
    assert line["seed"] == 10
    assert "1 of 1 proved" in summary([line])
