"""The story of a walk on its page is what the orbit does."""

from functools import cache

import numpy as np
import pytest

from dpcontrol.pages.walks import WalkStory
from dpcontrol.plans.model import load_model
from dpcontrol.walks.edges import Edges, find_edges
from dpcontrol.walks.shadowing import ShadowingOrbit, WalkSolver
from dpcontrol.walks.walks import resolve


@cache
def edges() -> Edges:
    return find_edges(load_model("lab").system, -0.07, pairs=[("down-up", "down-up")])


def found(texts: list[str], *, wraps: list[int] | None = None) -> ShadowingOrbit:
    chain = resolve(texts, edges())
    orbit = WalkSolver(edges().connections).solve(chain, wraps or [1] * (len(chain) - 1))
    assert orbit.converged
    return orbit


def test_wobbles_lie_between_the_symbols_and_carry_the_wraps_of_the_orbit() -> None:
    orbit = found(["down-up +", "down-up -", "down-up +"], wraps=[1, 3])
    spans = WalkStory(orbit, load_model("lab").arms.length).wobbles()
    assert [w.wraps for w in spans] == [2, 1, 3, 2]
    assert [w.saddle for w in spans] == ["down-up"] * 4
    bounds = [0.0, *orbit.symbol_times, orbit.duration]
    for wobble, before, after in zip(spans, bounds[:-1], bounds[1:], strict=True):
        assert before <= wobble.start < wobble.end <= after
    # The leads are whole wobbles, by definition; at the stops, flights to and from a thousandth take their part.
    period = orbit.connections[0].source.period
    assert spans[0].end == pytest.approx(2 * period, abs=1e-9)
    assert spans[-1].end - spans[-1].start == pytest.approx(2 * period, abs=1e-9)
    assert np.rint((spans[2].end - spans[2].start) / period) >= 3
