"""Symbols outside the graph: other sections and hits, composite edges and rotating orbits."""

import shlex

import numpy as np
import pytest
from command_line import dpcontrol

from dpcontrol.foundation.version import PACKAGE
from dpcontrol.plans.model import load_model
from dpcontrol.tubes.connections import find_connections, orbits_between
from dpcontrol.walks.edges import find_edges, rotating_named, rotating_names
from dpcontrol.walks.following import SymbolBranches
from dpcontrol.walks.shadowing import shadow
from dpcontrol.walks.symbols import choose, parse_symbol, parse_walk
from dpcontrol.walks.walks import resolve, through, vertex_names, ways

LOW = -0.06985  # J: the outer arm's fastest rotating orbit has λ = -2.74
MULTIPLIER = -2.7436245634812297  # computed independently in 113-bit arithmetic
SAME_ORBIT = 1e-10  # rad, rad/s; two solutions with defects of 1e-12 and a condition number of 1e3
SADDLES = ("down-up", "up-down")
GROWN = "(down-up +)·1·(down-up -)"


@pytest.fixture(scope="module")
def edges(system):
    return find_edges(system, -0.07)


def walk_edges(system, energy, *texts, **more):
    return find_edges(system, energy, symbols=parse_walk(texts, vertex_names(system)), **more)


@pytest.fixture(scope="module")
def aligned(system):
    pair = orbits_between(system, "down-up", "down-up", -0.07)
    return find_connections(*pair, hits=(1, 2), section=system.named_sections["aligned"]).connections


@pytest.fixture(scope="module")
def found(system, aligned):
    return walk_edges(system, -0.07, aligned[0].name, "down-up +")


def test_a_symbol_passes_over_connections_of_more_than_twice_the_smallest_loss(edges):
    (symbol,) = parse_walk(["down-up +"], SADDLES)
    fitting = [c for c in edges.between("down-up", "down-up") if c.sense == 1]
    usual = choose(symbol, fitting)
    assert usual.symmetric
    losses = {c.name: 1.9 for c in fitting} | {usual.name: 2.1}
    assert choose(symbol, fitting, lambda c: losses[c.name]) is usual
    least = min(fitting, key=lambda c: c.transversality_angle)
    chosen = choose(symbol, fitting, lambda c: losses[c.name] - (c is least))
    assert chosen is not usual


@pytest.mark.slow
def test_connections_on_other_sections_can_be_symbols(aligned, found):
    assert aligned
    assert all(":aligned@" in c.name for c in aligned)
    assert [c.name for c in found.named] == [c.name for c in aligned]
    for c in aligned:
        chain = resolve([c.name, "down-up +"], found)
        assert chain[0].name == c.name
        assert np.abs(chain[0].state - c.state).max() < SAME_ORBIT
    orbit = shadow(resolve([aligned[0].name, "down-up +"], found), wraps=[2], rivals=found.known)
    assert orbit.converged
    assert orbit.wraps_realised == (2,)


@pytest.mark.slow
def test_named_symbols_do_not_change_other_symbols_or_counts(edges, found):
    """The symbol "down-up +" selects the most transversal first hit, regardless of other searches."""
    assert found.named
    assert [c.name for c in found.connections] == [c.name for c in edges.connections]
    assert resolve(["down-up +"], found)[0].name == resolve(["down-up +"], edges)[0].name


@pytest.mark.slow
def test_a_composite_edge_is_solved_from_its_parts(edges):
    (edge,) = resolve([GROWN], edges)
    plain = resolve(["down-up +", "down-up -"], edges)
    orbit = shadow(plain, wraps=[1])
    assert np.abs(edge.state - orbit.states(orbit.symbol_times[:1])[0]).max() < SAME_ORBIT
    # Its full name is also valid, and the dots are optional.
    assert resolve([edge.name], edges)[0].name == edge.name
    assert resolve([GROWN.replace("·", " ")], edges)[0].name == edge.name
    again = resolve([f"({edge.name})·2·(down-up +)"], edges)[0]
    twice = shadow(resolve(["down-up +", "down-up -", "down-up +"], edges), wraps=[1, 2])
    assert np.abs(again.state - twice.states(twice.symbol_times[:1])[0]).max() < SAME_ORBIT


def test_rotating_orbits_are_vertices_by_name(system):
    fastest = rotating_named(system, "outer-rotating", LOW)
    assert fastest.floquet_multipliers[0].real == pytest.approx(MULTIPLIER, rel=1e-11)
    back = rotating_named(system, "outer-rotating-back", LOW)
    assert back.period == pytest.approx(fastest.period, abs=1e-11)
    assert back.whole_turns.tolist() == [0, -1, 0, 0]
    second = rotating_named(system, "outer-rotating-2", LOW)
    assert second.period > fastest.period
    assert second.saddle == "outer-rotating-2"
    assert parse_symbol("down-up > outer-rotating-2", vertex_names(system)).target == "outer-rotating-2"
    assert rotating_names(load_model("three-body").system) == []


@pytest.mark.slow
def test_walks_turn_at_a_rotating_orbit_the_given_number_of_times(system):
    texts = ("down-up > outer-rotating", "outer-rotating > down-up")
    found = walk_edges(system, LOW, *texts)
    assert "outer-rotating" in found.saddles
    orbit = shadow(resolve(texts, found), wraps=[3], rivals=found.known)
    assert orbit.converged
    assert orbit.wraps_realised == (3,)
    longer = shadow(resolve(texts, found), wraps=[5], rivals=found.known)
    # Number of turns of the arm from end to end.
    turned = [o.states(np.array([o.duration]))[0, 1] - o.states(np.zeros(1))[0, 1] for o in (orbit, longer)]
    assert turned[1] - turned[0] == pytest.approx(4 * np.pi, abs=1e-3)
    # Named connections and stops give the same walk.
    named = [c.name for c in resolve(texts, found)]
    assert [c.name for c in resolve(named, walk_edges(system, LOW, *named))] == named
    stops = ("down-up", "outer-rotating", "down-up")
    assert [c.name for c in through(stops, find_edges(system, LOW, symbols=ways(stops)))] == named


COMMAND = 'dpcontrol walk printed --energy 0.1905 -s "down-up +" --compare 0.1915'
PAGE = (PACKAGE / "guide" / "walks.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def printed():
    system = load_model("printed").system
    return SymbolBranches(system, parse_symbol("down-up +", system.saddles))


@pytest.mark.slow
def test_a_change_of_the_selected_motion_is_reported_with_its_energy(printed):
    """The guide shows the change."""
    ended = dpcontrol(*shlex.split(COMMAND)[1:], "--json")
    assert ended.code == 0
    (change,) = ended.document["symbol_changes"]
    assert f'$ {COMMAND}\n"down-up +" selects another connection beyond {change["energy"]:.5f}…\n' in PAGE
    # Independently of continuation, the selected points on the section differ on both sides of the change.
    below, above = (printed.chosen(change["energy"] + way * 2 * max(change["within"], 1e-6)) for way in (-1, 1))
    assert below is not None
    assert above is not None
    assert abs(below.state[2] - above.state[2]) > 0.5


@pytest.mark.slow
def test_a_connection_is_followed_beyond_the_change_of_its_symbol(printed):
    first = printed.chosen(0.19)
    assert first is not None
    there = printed.followed(first, 0.195)
    assert there is not None
    other = printed.chosen(0.195)
    assert other is not None
    assert there.name != other.name
    # The motion is nearly the same, while the other one's rate differs by 26 rad/s.
    assert there.state == pytest.approx(first.state, abs=0.2)
    assert there.transversality_angle == pytest.approx(first.transversality_angle, abs=1.0)
    back = printed.followed(there, 0.19)
    assert back is not None
    assert back.name == first.name
