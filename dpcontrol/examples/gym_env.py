# %% [markdown]
# # An environment for reinforcement learning
# A gymnasium environment on the simulated bench with encoders, delay, mismatch and blows. The agent adds a fraction of
# the cart's largest acceleration to the feedforward of a plan. Rewards are small errors of the angles and, at the end,
# a completed itinerary. It needs `pip install 'dpcontrol[gym]'`.

# %%
from typing import Any

import gymnasium
import numpy as np
from matplotlib.figure import Figure

import dpcontrol as dp
from dpcontrol.control.interface import schedule_of
from dpcontrol.judge.score import Flown, verdict_on
from dpcontrol.loop.simulated import SimulatedRig

Array = np.ndarray[Any, np.dtype[Any]]
LOST, COMPLETED, EFFORT = 1.5, 100.0, 0.01
"""Error that ends an episode (rad), reward of a completed itinerary, and cost of full acceleration."""


class BenchEnv(gymnasium.Env[Array, Array]):
    """An itinerary on the simulated bench.

    The observation consists of the sines and cosines of the measured angles, the angular rates over the last step (in
    10 rad/s), and the cart's position (m) and velocity (in 3 m/s). They are followed by the errors of angles and
    rates, and the feedforward relative to its limit.

    Args:
        itinerary: name or path.
        ticks: ticks per step.
        options: of the runs, such as `mismatch`.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - as gymnasium declares it

    def __init__(self, itinerary: str = "outer-turn", *, ticks: int = 10, **options: Any) -> None:
        self.loop = dp.closed_loop(itinerary, settings={"controller": "feedforward", "mismatch": 0.02, **options})
        self.assembly, self.ticks = self.loop.assembly, ticks
        schedule = schedule_of(self.assembly.controller, 1)
        assert schedule is not None
        self.states, self.forward = schedule.references, schedule.rows[:, 0]
        self.queued, self.arms = [float(one) for one in schedule.queued], self.assembly.arms.count
        self.most = self.assembly.limits.acceleration
        size = 5 * self.arms + 3
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Draw the bench's arms, initial errors and blows from a seed.

        Args:
            seed: seed of this and further episodes; None to continue.
            options: ignored.
        """
        super().reset(seed=seed)
        own, drawn = self.assembly, int(self.np_random.integers(1 << 31))
        draw = own.draw(seed=drawn)
        start = own.controller.first_state
        self.rig = SimulatedRig(draw, own.settings.bench, limits=own.limits, start=start, queued=self.queued)
        self.tick, self.truth, self.commands = 0, list[Array](), list[float]()
        self.measured = self.rig.read().positions
        self.before = self.measured
        return self._observed(), {"seed": drawn}

    def _observed(self) -> Array:
        n, wanted = self.arms, self.states[self.tick]
        rates = (self.measured - self.before) / (self.ticks * self.rig.period)
        angles = self.measured[:n]
        errors = np.concatenate([angles - wanted[:n], (rates[:n] - wanted[n : 2 * n]) / 10])
        parts = [np.sin(angles), np.cos(angles), rates[:n] / 10, [self.measured[n], rates[n] / 3], errors]
        return np.concatenate([*parts, [self.forward[self.tick] / self.most]]).astype(np.float32)

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Apply the agent's action for some ticks or until the run ends.

        Args:
            action: command beside the feedforward (1,), -1 to 1 of its limit.
        """
        own, last = float(np.clip(action, -1.0, 1.0)[0]) * self.most, len(self.states) - 1
        self.before, reason, distance = self.measured, "", 0.0
        for _ in range(self.ticks):
            command = float(np.clip(self.forward[self.tick] + own, -self.most, self.most))
            self.rig.command(command)
            self.truth.append(self.rig.truth.copy())
            self.commands.append(command)
            self.measured = self.rig.read().positions
            self.tick += 1
            distance = float(np.abs(self.rig.truth[: self.arms] - self.states[self.tick, : self.arms]).max())
            reason = self.rig.fault.text if self.rig.fault else "tracking lost" if distance > LOST else ""
            if reason or self.tick == last:
                break
        over = self.tick == last and not reason
        reward = 1 - distance / LOST - EFFORT * (own / self.most) ** 2
        completed = over and self._completed()
        info = {"reason": reason, "completed": completed, "distance": distance}
        return self._observed(), reward + COMPLETED * completed, bool(reason) or over, False, info

    def _completed(self) -> bool:
        """Return the verdict on the complete episode."""
        limits, count = self.assembly.limits, len(self.truth)
        flown = Flown(
            self.rig.period * np.arange(count, dtype=float), np.array(self.truth), self.states[:count, : self.arms],
            np.array(self.commands), 1 / self.rig.period, (limits.position, limits.velocity, limits.acceleration),
        )  # fmt: skip
        return verdict_on(flown, self.assembly.reference).completed


# %%
def rewards(env: BenchEnv, gain: float, *, seed: int) -> list[float]:
    """Return the rewards of an episode with proportional feedback of the angles.

    Args:
        env: environment.
        gain: action per rad.
        seed: seed of the episode.
    """
    seen, _ = env.reset(seed=seed)
    found, over, n = list[float](), False, env.arms
    while not over:
        action = np.array([gain * float(seen[3 * n + 2 : 4 * n + 2].sum())], dtype=np.float32)
        seen, reward, over, _, _ = env.step(np.clip(action, -1, 1))
        found.append(reward)
    return found


if __name__ == "__main__":
    env = BenchEnv("outer-turn", mismatch=0.02)
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for gain in (0.0, -0.5, 0.5):
        axes.plot(np.cumsum(rewards(env, gain, seed=1)), label=f"gain {gain:g}")
    axes.set(xlabel="step", ylabel="sum of rewards", title="Three simple agents on the outer turn")
    axes.legend()
    figure.savefig("gym-env.png", dpi=110)
