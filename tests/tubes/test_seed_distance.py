"""Optimal distance of a tube's seeds from their orbit, by the error of the cuts' intersections.

True values were computed independently in 113-bit arithmetic. At small distances, rounding causes an error in phase. At
large distances, the linear approximation departs from the manifold. The default must be near the optimum.
"""

import numpy as np
import pytest

from dpcontrol.orbits.cut import tube_cut
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.plans.model import load_model
from dpcontrol.tubes.connections import find_connections, orbits_between
from dpcontrol.tubes.intersections import ConnectionSettings, intersect_cuts
from tests.reference_values import CONNECTIONS, images

DISTANCES = (1e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 1e-2)
CHARTED = (("down-up", "down-up", -0.07), ("up-down", "up-down", 0.2))
BESIDE_THE_BEST = 3.01  # required: within a factor of three
REFINED = 1e-12  # multiple shooting removes the effect of the distance


def off(state, truths):
    """Scaled distance of a state from the nearest true value, with angles modulo a turn."""
    gap = np.abs(state - truths)
    gap[:, :2] = np.abs(2 * np.sin(gap[:, :2] / 2)) / np.pi
    gap[:, 2:] /= 10
    return float(gap.max(axis=1).min())


def unrefined_errors(key, distance):
    system, settings = load_model("lab").system, ConnectionSettings(distance=distance)
    orbit, _ = orbits_between(system, *key)
    manifold, section = UnstableManifold(orbit, distance), system.sections[key[:2]]
    cut = tube_cut(manifold, section, settings=settings.cut)
    found = intersect_cuts(system, section, (manifold, manifold), (cut, cut), settings)
    return [off(crossing.states[0], images(key)) for crossing in found.found]


@pytest.fixture(scope="module")
def chart():
    """Geometric mean of the errors at each distance, because single errors depend on rounding."""
    return np.array([
        np.exp(np.mean(np.log([e for key in CHARTED for e in unrefined_errors(key, distance)])))
        for distance in DISTANCES
    ])  # fmt: skip


@pytest.mark.slow
def test_the_default_distance_is_near_the_optimum(chart):
    best = DISTANCES[int(np.argmin(chart))]
    default = ConnectionSettings().distance
    assert max(best / default, default / best) < BESIDE_THE_BEST
    assert chart[DISTANCES.index(default)] < 3 * chart.min()


@pytest.mark.parametrize("distance", [DISTANCES[0], DISTANCES[-1]])
def test_refined_connections_are_independent_of_the_distance(distance):
    key = CHARTED[0]
    orbits = orbits_between(load_model("lab").system, *key)
    found = find_connections(*orbits, settings=ConnectionSettings(distance=distance))
    assert len(found.connections) == CONNECTIONS[key][0]
    assert max(off(c.state, images(key)) for c in found.connections) < REFINED
