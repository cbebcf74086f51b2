"""Arms exported to MuJoCo have the same motion there; the example's rig runs."""

import re
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol
from scipy.integrate import solve_ivp
from textbook import TwoArms

import dpcontrol as dp
from dpcontrol.plans.model import load_model

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'dpcontrol[mujoco]'")

SAME = 1e-6
"""Error of fourth-order Runge-Kutta at 0.5 ms after one second, rad."""
LAB, START = load_model("lab").arms, np.array([0.5, -1.3, 2.0, -4.0])


def moved(text: str, *, clamped: bool, push: float = 0.0) -> np.ndarray:
    """Return angles and rates after one second, with a clamped or pushed cart (m/s²)."""
    if clamped:
        text = re.sub(r'<joint name="cart".*?/>', "", text)
        text = re.sub(r"<actuator>.*?</actuator>", "", text)
    model = mujoco.MjModel.from_xml_string(text)
    data, first = mujoco.MjData(model), 0 if clamped else 1
    data.qpos[first:] = [START[0], START[1] - START[0]]
    data.qvel[first:] = [START[2], START[3] - START[2]]
    for k in range(round(1 / model.opt.timestep)):
        if not clamped:
            data.ctrl[0] = push * (k + 0.5) * model.opt.timestep
        mujoco.mj_step(model, data)
    return np.concatenate([np.cumsum(data.qpos[first:]), np.cumsum(data.qvel[first:])])


def by_hand(*, viscous: tuple[float, float] = (0.0, 0.0), push: float = 0.0) -> np.ndarray:
    """Return the same by the textbook and scipy."""
    arms = TwoArms(LAB, viscous=viscous)
    return solve_ivp(lambda _, y: arms.slope(y, push), (0, 1), START, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]


@pytest.mark.parametrize("viscous", [(0.0, 0.0), (2e-3, 5e-4)])
def test_arms_move_as_by_lagranges_equations(viscous: tuple[float, float]) -> None:
    found = moved(dp.mjcf(replace(LAB, viscous=viscous)), clamped=True)
    assert np.abs(found - by_hand(viscous=viscous))[:2].max() < SAME


def test_the_servo_accelerates_the_cart_with_its_lag() -> None:
    # The arms have no effect on a cart of 1e6 kg. A lag of 2 ms changes the result by some milliradians.
    found = moved(dp.mjcf(LAB.frictionless(), cart_mass=1e6), clamped=False, push=2.0)
    assert np.abs(found - by_hand(push=2.0))[:2].max() < 0.02
    assert np.abs(found - by_hand())[:2].max() > 0.2


def test_mujoco_loads_the_file_of_the_verb(tmp_path: Path) -> None:
    file = tmp_path / "lab.xml"
    done = dpcontrol("model", "lab", "--mjcf", str(file))
    assert done.code == 0, done.stderr
    model = mujoco.MjModel.from_xml_path(str(file))
    assert (model.nq, model.nu) == (3, 1)
    assert model.body_mass[-2:] == pytest.approx(LAB.mass)


@pytest.mark.slow
def test_the_rig_of_the_example_runs_and_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    runs = runpy.run_module("dpcontrol.examples.mujoco_rig", run_name="__main__")["runs"]
    assert {name: run.status for name, run in runs.items() if not run.converged} == {}
    assert (tmp_path / "mujoco-rig.png").stat().st_size > 10_000


@pytest.mark.benchmark
def test_nineteen_of_twenty_seeds_complete_the_turn_in_mujoco() -> None:
    from dpcontrol.examples.mujoco_rig import flown

    assert sum(run.converged for run in flown("outer-turn", range(20))) >= 19
