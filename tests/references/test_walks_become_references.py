"""Random itineraries at 0.2 J become references with the stops of their walks."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from independent_decoder import Plan, labels

from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.orbits.manifold import OrbitCurve
from dpcontrol.plans.model import Model, load_model
from dpcontrol.references.find import find_reference
from dpcontrol.references.problem import ReferenceProblem, ReferenceSettings
from dpcontrol.references.reference import Reference
from dpcontrol.walks.edges import Edges, find_edges
from dpcontrol.walks.shadowing import ShadowingOrbit, WalkSolver
from dpcontrol.walks.walks import random_walk


@dataclass(frozen=True)
class Followed:
    orbit: ShadowingOrbit
    friction: float
    reference: Reference


def problem_of(model: Model, orbit: ShadowingOrbit, friction: float = 1.0) -> ReferenceProblem:
    """Return the problem of following a walk's orbit with scaled friction of the arms."""
    arms = replace(model.arms, viscous=tuple(friction * k for k in model.arms.viscous))
    return ReferenceProblem(
        arm_chain_equations(model.arms.count, Level.CART), arms.base(), orbit.states, orbit.duration
    )  # fmt: skip


def random_references(
    model: Model, edges: Edges, count: int, *, seed: int, lengths: tuple[int, int], settings: ReferenceSettings
) -> Iterator[Followed]:
    """Draw walks, up to three wraps above the fewest, and 0.5 to 2 times the arms' friction."""
    generator, solver = np.random.default_rng(seed), WalkSolver(edges.connections)
    for _ in range(count):
        chain = random_walk(edges, int(generator.integers(lengths[0], lengths[1] + 1)), generator)
        extra = generator.integers(0, 4, len(chain) - 1)
        orbit = solver.solve(chain, (np.array(solver.least(chain), dtype=int) + extra).tolist())
        assert orbit.converged, orbit.status
        friction = float(2.0 ** generator.uniform(-1, 1))
        yield Followed(orbit, friction, find_reference(problem_of(model, orbit, friction), settings))


def complaints(model: Model, followed: Followed) -> list[str]:
    """Return the failures of a reference: convergence, limits or the walk's stops."""
    orbit, reference = followed.orbit, followed.reference
    what = f"{' '.join(orbit.walk)}, wraps {orbit.wraps}, friction ×{followed.friction:.2f}"
    if not reference.converged:
        return [f"{what}: {reference.status}"]
    n, system = model.arms.count, model.system
    names = [orbit.connections[0].source.saddle, *(c.target.saddle for c in orbit.connections)]
    wanted = [
        (system.equilibrium(name) + offset * system.turn_lengths)[:n]
        for name, offset in zip(names, [orbit.offsets[0], *orbit.offsets[1:]], strict=True)
    ]
    states = reference.state(np.arange(0.0, reference.duration, 0.001))
    orbits = {c.saddle: c for c in (orbit.connections[0].source, *(c.target for c in orbit.connections))}
    notes = {
        "saddles": {name: {"angles": system.equilibrium(name)[:n].tolist()} for name in orbits},
        "orbits": [{"saddle": name} for name in orbits],
    }
    curves = [OrbitCurve(one).samples for one in orbits.values()]
    plan = Plan(notes, curves, states, 1000.0, (np.inf, np.inf, np.inf))
    seen = [
        np.array(notes["saddles"][name]["angles"]) + 2 * np.pi * np.array(turns)
        for (name, turns), *_ in labels(plan, states)
    ]
    # A connection may pass close to another orbit.
    left = iter(seen)
    same = all(any(np.allclose(one, stop) for one in left) for stop in wanted)
    return [] if same else [f"{what}: stops {np.round(seen, 2).tolist()}, not {np.round(wanted, 2).tolist()}"]


@pytest.mark.slow
def test_random_itineraries_converge_with_the_stops_of_their_walks() -> None:
    model = load_model("lab")
    edges = find_edges(model.system, 0.2)
    settings = ReferenceSettings(method="radau-7", interval=0.05)
    found = list(random_references(model, edges, 3, seed=4, lengths=(1, 3), settings=settings))
    assert [text for followed in found for text in complaints(model, followed)] == []
    for followed in found:
        assert followed.reference.max_error_between_nodes <= settings.tolerance
        assert followed.reference.max_cart_position <= 0.4
    assert max(len(followed.orbit.walk) for followed in found) > 1
    assert len({followed.friction for followed in found}) == 3
