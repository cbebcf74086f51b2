"""Double turns of the outer arm, found by shadowing and as second-hit intersections of the tubes.

The unstable tube's second crossing of θ₂ = 2πk is a spiral at phases within 1e-3 of a turn's phase. Each
wrap reduces the distance by λ. The cut is sampled in logarithmic steps and searched like any other cut. From the seed
to the second crossing, errors grow by more than 1e10, which requires a wide acceptance before refinement.
"""

import numpy as np
import pytest

from dpcontrol.orbits.cut import Cut, Piece, Sampler
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.tubes.connections import find_connections, orbits_between
from dpcontrol.tubes.intersections import ConnectionSettings, TubeSide
from dpcontrol.walks.shadowing import WalkSolver

SAME = 1e-9
SETTINGS = ConnectionSettings(accept=0.3, same=1e-10)
NEAREST, FARTHEST = 5e-10, 1e-4  # distances from the turn's phase without wraps; wraps are nearer
PER_FACTOR_E = 20


@pytest.fixture(scope="module")
def turns(system):
    orbit, _ = orbits_between(system, "down-up", "down-up", -0.07)
    return find_connections(orbit, orbit)


def seed_phase(turn, manifold, section):
    """Return the phase of the seed whose trajectory is nearest to a connection."""
    start = turn.orbit.start
    side = TubeSide(manifold, section, False, 1, int(np.sign(start.amplitude)), 12 * turn.source.period)
    phase = start.phase
    for _ in range(50):
        amplitude = manifold.distance / float(manifold.frame(np.array([phase])).lengths[0])
        phase = start.phase + np.log(amplitude / abs(start.amplitude)) / manifold.exponent
    for _ in range(5):
        states, times, seeds = side.arrive(np.array([phase]))
        slope = side.slopes(seeds, states, times)[0]
        phase -= (states[0] - turn.state) @ slope / (slope @ slope)
    return phase


def cut_direction(turn):
    """Return the sign of a turn's section crossing."""
    return int(np.sign(turn.source.system.numeric.rate(turn.state) @ np.asarray(turn.section.normal)))


def spiral(turn, manifold, section):
    """Return the second-hit cut of the unstable tube on both sides of a turn's phase."""
    branch = int(np.sign(turn.orbit.start.amplitude))
    sampler = Sampler(manifold, section, 2, branch, SETTINGS.cut)
    count = int(PER_FACTOR_E * np.log(FARTHEST / NEAREST))
    away = np.geomspace(NEAREST, FARTHEST, count)
    own = seed_phase(turn, manifold, section)
    pieces = []
    for phases in (own - away[::-1], own + away):
        samples = sampler.fly(phases)
        parts = np.split(np.arange(count), np.flatnonzero(~samples.continuous(4 * sampler.chord)) + 1)
        for run in [samples[part] for part in parts]:
            direction = int(np.sign(run.rates[0]))
            # On the other side of the turn's phase, the trajectory returns without a turn.
            if len(run) > 3 and direction == cut_direction(turn):
                pieces.append(Piece(branch, run.phases, run.points, run.states, run.times, direction, closed=False))
    return Cut(section, 2, tuple(pieces), (), 2 * count, SETTINGS.cut.chord, np.inf)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(4))
def test_every_pair_of_turns_is_among_the_second_hits(turns, first):
    # If a symmetry exchanges the branches, only one branch is searched.
    plus = [c for c in turns.connections if c.orbit.start.amplitude > 0]
    assert len(plus) == 4
    manifold = UnstableManifold(turns.source, SETTINGS.distance)
    cut = spiral(plus[first], manifold, plus[first].section)
    second = find_connections(turns.source, turns.source, hits=(2, 1), cuts=(cut, turns.cuts[1]), settings=SETTINGS)
    twice = [c for c in second.connections if c.winding == tuple(2 * w for w in plus[first].winding)]
    solver = WalkSolver(turns.connections)
    for other in plus:
        least = solver.least([plus[first], other])
        orbit = solver.solve([plus[first], other], least)
        assert orbit.wraps_realised == least
        at = orbit.orbit.states[sorted(orbit.shot.guess.markers)[1]]
        assert min(float(np.max(np.abs(at - c.state))) for c in twice) < SAME, other.name
