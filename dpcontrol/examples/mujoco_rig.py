# %% [markdown]
# # The arms in MuJoCo
# MuJoCo simulates the plant, for which `dp.mjcf` writes the arms on their cart. It needs
# `pip install 'dpcontrol[mujoco]'`. The rig has encoders, a delay of one period and drive lag. Its arms differ from the
# model by 2 %.

# %%
from collections.abc import Sequence
from typing import Any

import mujoco as mujoco_package
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import dpcontrol as dp
from dpcontrol.plans.plan import Plan
from dpcontrol.runs.run import Run

mujoco: Any = mujoco_package
"""MuJoCo has no type stubs."""
MISMATCH, ERROR, LAG, SUBSTEPS = 0.02, 0.02, 0.002, 2
COUNT, SCALE = 2 * np.pi / 40_000, 1e-6


class MujocoRig:
    """A rig with random arms near `model`, which starts near the reference."""

    def __init__(self, plan: Plan, *, seed: int) -> None:
        random, model, first = np.random.default_rng(seed), plan.itinerary.model, plan.reference.state(0.0)
        arms = model.arms.mismatched(MISMATCH, random)
        self.model = mujoco.MjModel.from_xml_string(dp.mjcf(arms, lag=LAG))
        self.data = mujoco.MjData(self.model)
        n = self.arms = arms.count
        angles = first[:n] + random.uniform(-ERROR, ERROR, n)
        self.data.qpos[:] = [first[2 * n], *np.diff(angles, prepend=0.0)]
        self.data.qvel[:] = [first[2 * n + 1], *np.diff(first[n : 2 * n], prepend=0.0)]
        self.wanted, self.acting, self.on_its_way, self.begun = first[2 * n + 1], 0.0, 0.0, False

    @property
    def truth(self) -> NDArray[np.float64]:
        """Angles and rates of the arms, position and velocity of the cart."""
        q, v = self.data.qpos, self.data.qvel
        return np.concatenate([np.cumsum(q[1:]), np.cumsum(v[1:]), [q[0], v[0]]])

    def read(self) -> NDArray[np.float64]:
        if self.begun:
            for _ in range(SUBSTEPS):
                step = self.model.opt.timestep
                # The servo's control is constant during a step, so it is the mean.
                self.data.ctrl[0] = self.wanted + self.acting * step / 2
                mujoco.mj_step(self.model, self.data)
                self.wanted += self.acting * step
            self.acting = self.on_its_way
        self.begun = True
        q = self.data.qpos
        return np.append(np.cumsum(COUNT * np.rint(q[1:] / COUNT)), SCALE * np.rint(q[0] / SCALE))

    def command(self, acceleration: float) -> None:
        self.on_its_way = acceleration

    def stop(self) -> None:
        self.on_its_way = self.acting = self.wanted = 0.0


def flown(name: str, seeds: Sequence[int]) -> list[Run]:
    """Simulate runs of an itinerary in MuJoCo.

    Args:
        name: name of the itinerary.
        seeds: seed of each run.
    """
    plan = dp.plan(name)
    loop = dp.closed_loop(plan, drive_lag=LAG)
    return [loop.run(rig=MujocoRig(plan, seed=seed)) for seed in seeds]


# %%
NAMES = ("outer-turn", "cross")
if __name__ == "__main__":
    runs = {name: flown(name, [1])[0] for name in NAMES}
    figure = Figure(figsize=(7, 5), layout="constrained")
    for axes, (name, run) in zip(figure.subplots(len(runs)), runs.items(), strict=True):
        print(name, run.status)
        axes.plot(run.log.time, run.log.states["truth"][:, :2])
        axes.plot(run.log.time, run.log.states["reference"][:, :2], "k:", linewidth=0.8)
        axes.set(xlabel="time (s)", ylabel="angles (rad)", title=f"{name} in MuJoCo {mujoco.__version__}")
    figure.savefig("mujoco-rig.png", dpi=110)
