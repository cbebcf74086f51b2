"""The environments for gymnasium: its checks, their definitions, lanes, and runs that they repeat."""

import subprocess
import sys
import time

import numpy as np
import pytest

import dpcontrol as dp

gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed: pip install 'dpcontrol[gym]'")

NAMES = ("SwingUp-v0", "FromAnywhere-v0", "Twelve-v0")
FASTEST = 20_000
"""Steps per second of 64 lanes; the environments use one processor of the two that they may."""
LAST: dict[str, tuple[list[float], float]] = {
    "SwingUp-v0": (
        [-0.228819, -0.248185, 0.973469, 0.968713, 0.207087, -0.276117, 0.2387, 0.104333, -1.0, -1.0],
        0.0012772,
    ),
    "FromAnywhere-v0": (
        [0.886578, 0.788818, -0.46258, -0.614627, 1.296214, -2.492719, 0.292375, 0.359, -1.0, -1.0],
        6.1231970,
    ),
    "Twelve-v0": (
        [-0.228819, -0.248185, 0.973469, 0.968713, 0.207087, -0.276117, 0.2387, 0.104333, 1.0, -1.0],
        0.0000000,
    ),
}
"""Observation after 25 steps with seed 2, and the return, as version 0 gave them when it was made."""


@pytest.mark.filterwarnings("ignore:.*Box observation space", "error::DeprecationWarning")
@pytest.mark.parametrize("name", [*NAMES, "the example"])
def test_gymnasium_finds_nothing_wrong(name: str) -> None:
    from gymnasium.utils.env_checker import check_env

    from dpcontrol.examples.gym_env import BenchEnv

    env = gymnasium.make(f"dpcontrol/{name}").unwrapped if name in NAMES else BenchEnv()
    check_env(env, skip_render_check=True)


@pytest.mark.parametrize(
    "text",
    [
        "import dpcontrol, gymnasium; gymnasium.spec('dpcontrol/SwingUp-v0')",
        "import gymnasium, dpcontrol; gymnasium.spec('dpcontrol/SwingUp-v0')",
        "import gymnasium; gymnasium.make('dpcontrol:dpcontrol/SwingUp-v0')",
        "import dpcontrol, sys; assert 'gymnasium' not in sys.modules",
    ],
)
def test_environments_are_registered_in_any_order_of_imports(text: str) -> None:
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("name", NAMES)
def test_a_definition_never_changes(name: str) -> None:
    """Published scores depend on it: a change needs a new version of the environment."""
    env = gymnasium.make(f"dpcontrol/{name}")
    env.reset(seed=2)
    actions = np.sin(np.arange(25) / 3) / 2
    seen = [env.step(np.array([action], dtype=np.float32)) for action in actions]
    assert not any(step[2] for step in seen)
    assert seen[-1][0] == pytest.approx(LAST[name][0], abs=2e-5)
    assert sum(step[1] for step in seen) == pytest.approx(LAST[name][1], abs=1e-5)


def test_lanes_are_single_environments_and_begin_anew_one_by_one() -> None:
    lanes, random = gymnasium.make_vec("dpcontrol/FromAnywhere-v0", num_envs=16), np.random.default_rng(0)
    seen, info = lanes.reset(seed=5)
    single = gymnasium.make("dpcontrol/FromAnywhere-v0")
    alone, _ = single.reset(seed=8)
    over, ended, ages = False, np.zeros(16, dtype=bool), np.zeros(16, dtype=int)
    assert list(info["seed"]) == list(range(5, 21))
    for _ in range(400):
        assert over or np.array_equal(seen[3], alone)
        actions = random.uniform(-1, 1, (16, 1)).astype(np.float32)
        before = ended
        seen, rewards, terminated, truncated, _ = lanes.step(actions)
        ended = terminated | truncated
        ages = np.where(before, 0, ages + 1)
        assert not ended[before].any()
        assert not rewards[before].any()
        # A lane that begins anew has no rates yet.
        assert not seen[before][:, [4, 5, 7]].any()
        assert (np.abs(seen[~ended, 6]) <= 1.01).all()
        if not over:
            alone, reward, *ends, _ = single.step(actions[3])
            over = any(ends)
            assert (reward, over) == (rewards[3], ended[3])
    assert over
    assert ages.max() < 400


def test_an_episode_is_cut_off_after_its_steps() -> None:
    env = gymnasium.make("dpcontrol/SwingUp-v0")
    env.reset(seed=1)
    steps = [env.step(np.zeros(1, dtype=np.float32)) for _ in range(1000)]
    assert [step[3] for step in steps].index(True) == 999
    assert sum(step[1] for step in steps) < 1


@pytest.mark.parametrize("action", [float("nan"), float("inf")])
def test_an_action_that_is_no_number_is_refused(action: float) -> None:
    env = gymnasium.make("dpcontrol/SwingUp-v0").unwrapped
    env.reset(seed=1)
    with pytest.raises(dp.InputError, match="must be finite"):
        env.step(np.array([action]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "settings", "least"), [("SwingUp-v0", {}, 800), ("FromAnywhere-v0", {}, 850), ("Twelve-v0", {}, 12)]
)
def test_an_environment_repeats_a_run_to_the_last_bit(name: str, settings: dict[str, str], least: float) -> None:
    from dpcontrol.examples.environment_scores import score

    total, apart = score(name, 1, **settings)
    assert apart == 0.0
    assert total >= least


@pytest.mark.benchmark
def test_sixty_four_lanes_make_twenty_thousand_steps_a_second() -> None:
    """Processor time of one process, so that other work does not count."""
    for name in NAMES:
        lanes, random = gymnasium.make_vec(f"dpcontrol/{name}", num_envs=64), np.random.default_rng(0)
        lanes.reset(seed=0)
        actions = random.uniform(-1, 1, (1000, 64, 1)).astype(np.float32)
        began = time.process_time()
        for action in actions:
            lanes.step(action)
        assert actions[..., 0].size / (time.process_time() - began) > FASTEST
