"""The story of a walk on its page is what the orbit does."""

import numpy as np
import pytest

from dpcontrol.dynamics.system import System
from dpcontrol.pages.walks import WalkStory
from dpcontrol.walks.edges import find_edges
from dpcontrol.walks.shadowing import shadow
from dpcontrol.walks.walks import resolve


def test_stays_lie_between_the_symbols_and_carry_the_wraps_of_the_orbit(system: System) -> None:
    edges = find_edges(system, -0.07, pairs=[("down-up", "down-up")])
    orbit = shadow(resolve(["down-up +", "down-up -", "down-up +"], edges), wraps=[1, 3])
    assert orbit.converged
    stays = WalkStory(orbit).stays
    assert [stay.text for stay in stays] == [f"down-up {count}×" for count in (2, 1, 3, 2)]
    assert [stay.saddle for stay in stays] == ["down-up"] * 4
    bounds = [0.0, *orbit.symbol_times, orbit.duration]
    for stay, before, after in zip(stays, bounds[:-1], bounds[1:], strict=True):
        assert before <= stay.first < stay.last <= after
    # The leads are whole wraps, by definition; at the stops, flights to and from a thousandth take their part.
    period = orbit.connections[0].source.period
    assert stays[0].last == pytest.approx(2 * period, abs=1e-9)
    assert stays[-1].last - stays[-1].first == pytest.approx(2 * period, abs=1e-9)
    assert np.rint((stays[2].last - stays[2].first) / period) >= 3
