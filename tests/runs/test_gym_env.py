"""The gymnasium environment of the examples: gymnasium's own check, what ends an episode, and the score at its end."""

import warnings

import numpy as np
import pytest

import dpcontrol as dp

gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed: pip install 'dpcontrol[gym]'")


def test_gymnasium_finds_nothing_wrong_with_it() -> None:
    from gymnasium.utils.env_checker import check_env

    from dpcontrol.examples.gym_env import BenchEnv

    with warnings.catch_warnings():
        warnings.simplefilter("error", category=DeprecationWarning)
        check_env(BenchEnv(), skip_render_check=True)


@pytest.mark.slow
def test_the_gains_of_tvlqr_complete_the_itinerary_and_nothing_done_does_not() -> None:
    from dpcontrol.examples.gym_env import COMPLETED, BenchEnv

    env, law = BenchEnv("outer-turn", ticks=1), dp.closed_loop("outer-turn", controller="tvlqr").assembly.controller
    _, found = env.reset(seed=4)
    over, total, info = False, 0.0, found
    while not over:
        k = min(env.tick, len(law.gains) - 1)
        share = float(law.gains[k] @ (env.states[env.tick] - env.rig.truth)) / env.most
        _, reward, over, _, info = env.step(np.array([np.clip(share, -1, 1)], dtype=np.float32))
        total += reward
    assert info["completed"], info
    assert total > COMPLETED
    env.reset(seed=4)
    over = False
    while not over:
        _, _, over, _, info = env.step(np.zeros(1, dtype=np.float32))
    assert not info["completed"]
    assert info["reason"]
