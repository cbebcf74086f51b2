"""The gymnasium environment of the examples: gymnasium's own check, what ends an episode, and the score at its end."""

import warnings

import pytest

gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed: pip install 'dpcontrol[gym]'")


def test_gymnasium_finds_nothing_wrong_with_it() -> None:
    from gymnasium.utils.env_checker import check_env

    from dpcontrol.examples.gym_env import BenchEnv

    with warnings.catch_warnings():
        warnings.simplefilter("error", category=DeprecationWarning)
        check_env(BenchEnv(), skip_render_check=True)
