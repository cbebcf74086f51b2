"""What tubes buy: motions are checked by scipy, and the guide's table is that of the stored tries."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from payoff import ARMS, SETTINGS, STORE, TUBES, Tries, compared, guide_table, motion_rate, recomputed
from scipy.integrate import solve_ivp

from dpcontrol.dynamics.chain import Level, equations_of
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits
from dpcontrol.references.trajectory import Trajectory, even_mesh, times_on

GUIDE = Path(__file__).parents[2] / "dpcontrol" / "guide" / "payoff.md"
EQUATIONS = equations_of(ARMS, Level.CART)
SWUNG = np.array([0.7, -0.4, 2.0, -3.0, 0.01, 0.1])
ROUNDING = 1e-12


def free_fall(seconds: float = 0.3) -> Trajectory:
    """A motion under a known input, from scipy at the nodes."""
    method, mesh = method_named(SETTINGS.method), even_mesh(seconds, SETTINGS.interval)

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        return np.array(EQUATIONS.function()(x, np.cos(5 * t), ARMS.base())).ravel()

    times = times_on(mesh, method.support)
    instants, where = np.unique(times, return_inverse=True)
    done = solve_ivp(rate, (0, seconds), SWUNG, t_eval=instants, rtol=1e-12, atol=1e-13, method="DOP853")
    states = done.y.T[where.ravel()].reshape(*times.shape, 6)
    return Trajectory(method, mesh, states, np.cos(5 * times_on(mesh, method.points))[..., None])


def test_the_equations_by_hand_are_those_of_the_engine() -> None:
    rng = np.random.default_rng(1)
    states, inputs = rng.normal(size=(6, 20)) * 3, rng.normal(size=20)
    engine = np.array(EQUATIONS.function().map(20)(states, inputs[None], np.tile(ARMS.base()[:, None], 20)))
    assert np.abs(motion_rate(states, inputs) - engine).max() < ROUNDING * np.abs(engine).max()


def test_a_motion_is_recognised_with_its_effort_and_other_motions_are_rejected() -> None:
    motion = free_fall()
    ends = motion.states[0, 0], motion.states[-1, -1]
    assert recomputed(motion, ends, Limits()) == pytest.approx(0.15 + np.sin(3.0) / 20, rel=1e-9)
    bent = replace(motion, states=motion.states.copy())
    bent.states[3] += 0.01
    assert recomputed(bent, ends, Limits()) == np.inf
    elsewhere = (ends[0], ends[1] + np.array([0, 2 * np.pi, 0, 0, 0, 0]))
    assert recomputed(motion, elsewhere, Limits()) == np.inf
    assert recomputed(motion, ends, Limits(acceleration=0.5)) == np.inf
    assert recomputed(motion, ends, Limits(position=0.01)) == np.inf


def test_the_guide_has_the_table_of_the_stored_tries() -> None:
    assert guide_table(json.loads(STORE.read_text(encoding="utf-8"))) in GUIDE.read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_flight_along_tubes_is_valid_and_other_searches_are_compared_with_it() -> None:
    """Slow: searches, although no more than one of each kind."""
    rows = compared((("outer turn, -0.07 J", ("down-up +",), -0.07), Tries(1, 0, 1, 1)))
    ours = next(row for row in rows if row["method"] == TUBES)
    assert (ours["tries"], ours["flights"], ours["as_cheap"]) == (1, 1, 1)
    assert all(row["best_effort"] is None or row["best_effort"] > 0.9 for row in rows)
