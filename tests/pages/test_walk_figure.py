"""The page of a walk: what it says is what the orbit does, and it is drawn for every kind of walk."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from dpcontrol.pages.layout import save_figure
from dpcontrol.pages.walk_story import WalkStory
from dpcontrol.pages.walk_symbols import symbol_text, symbol_words
from dpcontrol.pages.walks import draw_walk
from dpcontrol.plans.model import load_model
from dpcontrol.walks.edges import Edges, find_edges
from dpcontrol.walks.shadowing import ShadowingOrbit, WalkSolver
from dpcontrol.walks.walks import resolve, through

LEAST_BYTES = 60_000  # of the page: an empty one of that size takes about 15,000
LOW, HIGH = -0.07, 0.2


@cache
def edges(energy: float) -> Edges:
    pairs = [("down-up", "down-up")] if energy == LOW else None
    return find_edges(load_model("lab").system, energy, pairs=pairs)


def found(
    texts: list[str], *, energy: float = LOW, wraps: list[int] | None = None, periodic: bool = False
) -> ShadowingOrbit:
    chain = resolve(texts, edges(energy))
    count = len(chain) if periodic else len(chain) - 1
    orbit = WalkSolver(edges(energy).connections).solve(chain, wraps or [1] * count, periodic=periodic)
    assert orbit.converged
    return orbit


def story(orbit: ShadowingOrbit) -> WalkStory:
    return WalkStory(orbit, load_model("lab").arms.length)


def drawn(orbit: ShadowingOrbit) -> Figure:
    return draw_walk(orbit, arm_lengths=load_model("lab").arms.length, model="lab")


def words(figure: Figure) -> str:
    """Return all that is written on a page."""
    return " ".join(" ".join(text.get_text() for text in figure.findobj(Text)).split())


def test_wobbles_lie_between_the_symbols_and_carry_the_wraps_of_the_orbit() -> None:
    orbit = found(["down-up +", "down-up -", "down-up +"], wraps=[1, 3])
    spans = story(orbit).wobbles()
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


def test_symbols_are_described_in_words() -> None:
    chain = resolve(["down-up +", "down-up > up-down -", "up-down -", "up-down > down-up"], edges(HIGH))
    assert [symbol_text(c) for c in chain][:3] == ["down-up +", "down-up > up-down -", "up-down -"]
    assert [symbol_words(c) for c in chain] == [
        "outer arm turns once counter-clockwise",
        "crosses from down-up to up-down",
        "inner arm turns once clockwise",
        "crosses from up-down to down-up",
    ]
    for connection in chain:
        assert resolve([symbol_text(connection)], edges(HIGH))[0].sense == connection.sense


@pytest.mark.slow
def test_a_system_without_arms_is_drawn_in_its_plane(tmp_path: Path) -> None:
    model = load_model("three-body")
    found = find_edges(model.system, -1.5175, pairs=[("L1", "L1")])
    chain = through(["L1", "L1", "L1"], found)
    orbit = WalkSolver(found.connections).solve(chain, [1])
    assert orbit.converged
    file = tmp_path / "walk.png"
    save_figure(draw_walk(orbit, arm_lengths=None, model="three-body"), file)
    assert file.stat().st_size > LEAST_BYTES
    said = words(draw_walk(orbit, arm_lengths=None, model="three-body"))
    assert "The orbit in the plane" in said
    assert "θ" not in said
    assert "arm" not in said
    assert "leaves L1 and comes back" in said
