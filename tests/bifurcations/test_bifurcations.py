"""Bifurcations of connections: saddle-nodes, pitchforks and section artefacts."""

from dataclasses import replace

import numpy as np
import pytest
from quick_rate import flown_by_scipy

from dpcontrol.bifurcations.bifurcations import Sweep, SweepSettings, find_bifurcations
from dpcontrol.bifurcations.links import Quantity, follow
from dpcontrol.foundation.causes import BranchCause
from dpcontrol.orbits.cut import CutSettings, section_points
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.plans.model import load_model
from dpcontrol.shooting.newton import solve_shooting
from dpcontrol.tubes.connections import find_connections, orbits_between
from dpcontrol.tubes.intersections import ConnectionSettings, Crossings, intersect_cuts

REPEATABLE = 1e-7  # J: required; 1e-11 is achieved
RESIDUAL = 1e-8
LAW = 0.02  # relative error of the square-root law, a few microjoules from the bifurcation
ON_MIRROR = 1e-7  # rad

SADDLE_NODE, PITCHFORK, GRAZE = (-0.1425, -0.1415), (-0.1008, -0.0998), (0.0170, 0.0195)
"""Energies in J about three events of the lab pendulum's Down-Up homoclinics."""
UP_DOWN, BETWEEN = (0.1775, 0.1790), (0.1883, 0.1885)
"""Energies in J about the first events of Up-Down's homoclinics (a saddle-node, a pitchfork) and of heteroclinics."""
SADDLES = {
    SADDLE_NODE: ("down-up", "down-up"),
    PITCHFORK: ("down-up", "down-up"),
    GRAZE: ("down-up", "down-up"),
    UP_DOWN: ("up-down", "up-down"),
    BETWEEN: ("down-up", "up-down"),
}


def located(system, energies, *, source="down-up", target="down-up", distance=1e-4, chord=0.05, samples=2):
    search = ConnectionSettings(distance=distance, cut=CutSettings(chord=chord))
    settings = SweepSettings(samples=samples, search=search)
    return find_bifurcations(Quantity.of_energy(system), source, target, values=energies, settings=settings)


class Events(dict):
    """Events of every kind of connection in order of energy, located when they are needed."""

    def __init__(self, system):
        self.system = system

    def __missing__(self, energies):
        source, target = SADDLES[energies]
        found = located(self.system, energies, source=source, target=target)
        assert found.complete
        self[energies] = found.events
        return found.events


@pytest.fixture(scope="module")
def events(system):
    return Events(system)


def connections_at(system, energy, saddles=("down-up", "down-up")):
    return find_connections(*orbits_between(system, saddles[0], saddles[1], energy)).connections


def off_mirror(connection):
    return abs(np.sin(connection.state[0]))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        (SADDLE_NODE, [("saddle-node", 0, 4)]),
        (PITCHFORK, [("pitchfork", 4, 8)]),
        pytest.param(GRAZE, [("section-artefact", 8, 10)], marks=pytest.mark.slow),
        pytest.param(UP_DOWN, [("saddle-node", 0, 4), ("pitchfork", 4, 8)], marks=pytest.mark.slow),
    ],
)
def test_each_event_has_its_kind_and_counts(events, name, expected):
    found = events[name]
    assert [(e.kind, e.count_below, e.count_above) for e in found] == expected
    assert max(e.residual for e in found) < RESIDUAL
    assert found[0].symmetric


@pytest.mark.slow
def test_an_interval_that_ends_just_beyond_a_pitchfork_includes_it(system, events):
    energy = events[PITCHFORK][0].energy
    found = located(system, (energy - 1e-5, energy + 1e-6))
    assert [(e.kind, e.count_below, e.count_above) for e in found.events] == [("pitchfork", 4, 8)]
    assert found.complete


def test_the_angle_at_a_saddle_node_follows_a_square_root(system, events):
    energy = events[SADDLE_NODE][0].energy
    angles = [min(c.transversality_angle for c in connections_at(system, energy + d)) for d in (1e-5, 4e-5)]
    assert angles[1] / angles[0] == pytest.approx(2.0, rel=LAW)


@pytest.mark.slow
def test_a_pitchforks_pair_leaves_the_symmetry_line_as_a_square_root(system, events):
    energy = events[PITCHFORK][0].energy
    offsets = []
    for d in (1e-5, 4e-5):
        found = connections_at(system, energy + d)
        assert sum(off_mirror(c) < ON_MIRROR for c in found) == 4
        offsets.append(max(off_mirror(c) for c in found))
    assert offsets[1] / offsets[0] == pytest.approx(2.0, rel=LAW)


@pytest.mark.benchmark
@pytest.mark.parametrize(
    ("model", "saddles", "energies"),
    [
        *(("lab", saddles, energies) for energies, saddles in SADDLES.items()),
        ("printed", ("down-up", "down-up"), (-0.1637, -0.1633)),
        ("printed", ("down-up", "down-up"), (-0.1536, -0.1532)),
    ],
)
def test_energies_are_independent_of_sampling_and_seed_distance(model, saddles, energies):
    pendulum = load_model(model).system
    once, again = (
        located(pendulum, energies, source=saddles[0], target=saddles[1], distance=distance, chord=chord).events
        for distance, chord in ((1e-4, 0.05), (5e-5, 0.025))
    )
    assert once
    for one, other in zip(once, again, strict=True):
        assert one.kind == other.kind
        assert abs(one.energy - other.energy) < REPEATABLE
        if model == "lab" and saddles == ("down-up", "down-up"):
            assert np.abs(one.state - other.state)[2:].max() < 1e-5


@pytest.mark.parametrize("name", [SADDLE_NODE, PITCHFORK], ids=["saddle-node", "pitchfork"])
def test_the_state_at_a_bifurcation_reaches_its_orbit_in_both_directions(system, events, name):
    event = events[name][0]
    orbit, _ = orbits_between(system, "down-up", "down-up", event.energy)
    curve = system.propagator.sample(orbit.state, np.linspace(0, orbit.period, 4000))
    for sign in (1, -1):
        flown = flown_by_scipy(system, event.state, sign * 1.25)
        # With 4,000 samples, chords are about 5e-4 of the orbit's length.
        assert system.scaled_distance(np.broadcast_to(flown, curve.shape), curve).min() < 1e-3


@pytest.mark.slow
def test_a_connection_that_grazes_its_section_continues_beyond(system, events):
    """Multiple shooting is independent of hits and continues it below the energy at which the list ends."""
    event = events[GRAZE][0]
    assert abs(event.state[3]) < 1e-8
    above, below = event.energy + 4e-4, event.energy - 4e-4
    grazing = min(
        (c for c in connections_at(system, above) if c.sense > 0),
        key=lambda c: np.abs(c.state[2:] - event.state[2:]).max(),
    )
    orbit, _ = orbits_between(system, "down-up", "down-up", below)
    manifold, old = UnstableManifold(orbit), grazing.orbit
    middle = int(np.argmin(np.abs(old.times)))
    guess = replace(
        grazing.solution,
        ends=(replace(old.start, manifold=manifold), replace(old.end, manifold=manifold)),
        energy=below,
        # The inner arm's angle is the condition, because it is fast when the outer arm is at rest on the section.
        markers={middle: (np.array([1.0, 0.0, 0.0, 0.0]), float(old.states[middle, 0]))},
    )
    carried = solve_shooting(guess).orbit
    assert carried.converged
    assert not any(np.abs(c.state - carried.states[middle]).max() < 1e-2 for c in connections_at(system, below))
    # It is no longer in the list, because it crosses three times instead of once.
    for shot, crossings in ((old, 1), (carried, 3)):
        heights = shot.sample(np.linspace(-0.3, 0.3, 6001))[:, 1] - 2 * np.pi
        assert np.count_nonzero(np.diff(np.sign(heights[np.abs(heights) > 1e-12]))) == crossings


def test_continuation_finds_a_connection_that_a_search_misses(system, monkeypatch):
    sweep = Sweep(Quantity.of_energy(system), "down-up", "down-up", 1, SweepSettings())
    low, high = -0.13, -0.12
    whole = sweep.search(low)
    with monkeypatch.context() as patch:
        one = lambda *cuts: Crossings(intersect_cuts(*cuts).found[:1], 0)  # noqa: E731
        patch.setattr("dpcontrol.bifurcations.bifurcations.intersect_cuts", one)
        assert sweep.search(high).count == whole.count - 2
    interval = sweep.between(low, high)
    assert sweep.search(high).count == whole.count
    assert not interval.changes
    assert not interval.gaps
    assert len(interval.runs) == len(whole.points)


def test_a_path_passes_a_fold_and_returns_as_the_partner(system, events):
    fold = events[SADDLE_NODE][0].energy
    sweep = Sweep(Quantity.of_energy(system), "down-up", "down-up", 1, SweepSettings())
    start, goal = SADDLE_NODE[1], SADDLE_NODE[0]
    first, second = sweep.search(start).points
    path = follow(sweep.problem, first.link, start, goal)
    assert path.returned
    energies = np.array([p.value for p in path.points])
    (turn,) = path.turns
    # The path reaches the fold, does not go below it, and returns.
    assert np.all(np.diff(energies[: turn + 1]) < 0)
    assert np.all(np.diff(energies[turn + 1 :]) > 0)
    assert 0 < energies.min() - fold < 0.1 * (start - fold)
    assert sweep.problem.distance_between(path.points[-1].link, second.link) < 1e-8
    # The tangency changes its sign only at the fold, and every point is a connection.
    signs = np.sign([p.tangency for p in path.points])
    assert np.count_nonzero(np.diff(signs)) == 1
    assert max(np.abs(sweep.problem.match(p.link, p.value).gap).max() for p in path.points) < 1e-8


@pytest.mark.benchmark
def test_connections_of_a_strongly_unstable_orbit_are_followed_to_their_fold():
    """The printed pendulum's multiplier of 9e4 keeps gaps above 1e-10, but no connection is lost."""
    found = located(load_model("printed").system, (0.1783, 0.1790), target="up-down")
    assert found.complete
    assert [(e.kind, e.count_below, e.count_above) for e in found.events] == [
        ("saddle-node", 4, 8),
        ("saddle-node", 8, 12),
    ]


@pytest.mark.slow
def test_scattering_cuts_give_lower_bounds_and_explained_changes(system, monkeypatch):
    """Trajectories separate near the other orbit, so connections accumulate.

    The fold is sharp, with a change of σ from -0.78 to +0.81 between neighbouring points.
    """
    # Continuation finds no connections that the search misses.
    monkeypatch.setattr(Sweep, "_amend", lambda *_: pytest.fail("a search was amended"))
    found = located(system, (0.2358, 0.2370), target="up-down")
    assert not found.unexplained
    assert not found.complete
    assert found.scatters_from == 0.2370
    assert [c.complete for c in found.counts] == [True, False]
    causes = {branch.cause for cut in found.counts[-1].unresolved for branch in cut.unresolved}
    assert causes == {BranchCause.SCATTERS}
    assert [(e.kind, e.count_below, e.count_above, e.at_least) for e in found.events] == [("saddle-node", 20, 24, True)]
    assert found.events[0].residual < RESIDUAL


@pytest.mark.slow
def test_runs_follow_every_connection_around_its_fold(system):
    """Only one of each symmetric pair is followed, along both parts of a parabola."""
    top = -0.1380
    found = located(system, (SADDLE_NODE[0], top), samples=3)
    fold = min(found.runs, key=lambda run: run.values.min())
    assert 0 < fold.values.min() - found.events[0].energy < 1e-5
    assert np.abs(fold.points[int(np.argmin(fold.values))] - found.events[0].point).max() < 0.01
    arrived = sorted(abs(run.points[-1][1]) for run in found.runs if run.values[-1] == top)
    connections = connections_at(system, top)
    expected = {round(abs(float(section_points(system, c.section, c.state)[1])), 8) for c in connections}
    assert arrived == pytest.approx(sorted(expected), abs=1e-7)
