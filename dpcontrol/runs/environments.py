"""The bench as environments of gymnasium, one or many in lockstep.

Files of `definitions` hold model, limits, bench and errors of an environment, which is the simulated bench of an
itinerary. The seed of an episode draws the same bench as a run of this itinerary with the seed. A step is one period.
The observation of n arms has what encoders show, and the target (4n+2,):

    sin θ, cos θ (n each),  θ̇/(10 rad/s) (n),  x/limit, ẋ/limit,  cos θ* (n)      rates: differences of two readings

The action is the acceleration of the cart over its limit. With one target, the reward of a step is the product of
(1 + cos(θ_i - θ_i*))/2 over the true angles. With several targets, it is 1 if all true angles have been within 0.2 rad
of the present target for 50 steps, which leads to the next one. The episode ends at the last target. If the cart meets
an end of its track, it ends too.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.interface import MANY
from dpcontrol.dynamics.compiled import VECTOR
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.version import PACKAGE
from dpcontrol.loop.simulated import BatchBench
from dpcontrol.orbits.lyapunov import equilibria
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.layout import HoldPart

Values = NDArray[Any]
DEFINITIONS = PACKAGE / "runs" / "definitions"
"""Folder of the environments' itineraries."""
NEAR, STAY = 0.2, 50
"""Largest error of an angle at a target, rad, and steps at one of several targets."""
_RATE, _ENDLESS, _SEEDS, _FAR = 10.0, 1 << 40, 1 << 31, 1e3
"""Scale of observed rates, rad/s, ticks of an endless draw, number of random seeds, and half length of the track, m."""


class BenchVector(gymnasium.vector.VectorEnv[Values, Values, Values]):
    """Benches of one environment in lockstep.

    Args:
        definition: name of a file in `DEFINITIONS`.
        max_episode_steps: steps after which an episode is cut off.
        num_envs: number of benches.
    """

    metadata = {"render_modes": [], "autoreset_mode": gymnasium.vector.AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(self, definition: str, *, max_episode_steps: int, num_envs: int = 1) -> None:
        """Read the environment's itinerary, and define the spaces of observations and actions.

        `_targets` (M, n) are the angles of the equilibria to reach, rad, and `_start` (2n+2,) the state at the start.
        """
        itinerary = load_itinerary(str(DEFINITIONS / f"{definition}.toml"))
        self.itinerary, self.num_envs, self._steps = itinerary, num_envs, max_episode_steps
        equilibrium_points, self._arms = equilibria(itinerary.model.system), itinerary.model.arms.count
        hold_angles = np.array(
            [
                equilibrium_points[part.hold].state[: self._arms]
                for part in itinerary.parts
                if isinstance(part, HoldPart)
            ]
        )
        self._start = np.zeros(2 * self._arms + 2)
        if itinerary.start == "hold":
            self._start[: self._arms] = hold_angles[0]
        # A tour begins at its first stop.
        self._targets = hold_angles[1:] if len(hold_angles) > 1 else hold_angles
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (4 * self._arms + 2,), np.float32)
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Values, dict[str, Any]]:
        """Begin new episodes on all benches, and return their first observations and their seeds.

        For each bench, `_age` counts the steps of its episode, `_stop` the targets reached, and `_stayed` the steps
        near the present one. `_over` is not 0 if the episode has ended. `_reading` are the present positions
        (n+1, num_envs), and `_before` those of the step before.

        Args:
            seed: seed of the first bench, from which the others count up, or one for each; None to continue.
            options: ignored.
        """
        first = self._random_seeds(self.num_envs) if seed is None else seed
        seeds = [first + k for k in range(self.num_envs)] if isinstance(first, int) else list(first)
        self.np_random = np.random.default_rng(seeds)
        self.bench = self._benches(seeds)
        self._reading = self._before = self.bench.read().positions
        self._age, self._stop, self._stayed, self._over = np.zeros((4, self.num_envs), dtype=int)
        return self._observations(), {"seed": np.array(seeds)}

    def _random_seeds(self, count: int) -> list[int]:
        """Return random seeds for new episodes, from the generator that `reset` has seeded."""
        return self.np_random.integers(_SEEDS, size=count).tolist()

    def _benches(self, seeds: Sequence[int]) -> BatchBench:
        """Return simulated benches with the draws of these seeds, at the start of their episodes."""
        loop, arms = self.itinerary.loop, self.itinerary.model.arms
        draws = {seed: loop.draw(arms, ticks=_ENDLESS, seed=seed) for seed in set(seeds)}
        # The episode ends at the end of the track, before the cart would be stopped there.
        limits = replace(self.itinerary.limits, position=_FAR)
        return BatchBench([draws[seed] for seed in seeds], loop.bench, limits=limits, start=self._start, lanes=MANY)

    def step(self, actions: Values) -> tuple[Values, Values, Values, Values, dict[str, Any]]:
        """Advance all benches by one period, and begin new episodes on those whose episode is over.

        Return observations (num_envs, 4n+2), rewards, ends and cut-offs of episodes (num_envs,), and no further data.
        With one target, the reward is 1 where all arms have its angles, and 0 where one has the opposite angle. With
        several, it is 1 in the step that completes `STAY` steps near one, after which the next one is the target. An
        episode ends with the last target or beyond the cart's limit. A bench that begins a new episode has reward 0 in
        this step.

        Args:
            actions: accelerations over their limit (num_envs, 1), -1 to 1.

        Raises:
            InputError: an action is not a finite number.
        """
        if not np.isfinite(actions).all():
            raise InputError(f"actions = {actions!r}: must be finite numbers from -1 to 1")
        limits, n, finished = self.itinerary.limits, self._arms, np.flatnonzero(self._over)
        self._before = self._reading
        self.bench.command(np.clip(np.reshape(actions, -1), -1.0, 1.0) * limits.acceleration)
        self._reading = self.bench.read().positions
        self._age += 1
        errors = self.bench.truth[:n] - self._targets[self._stop].T
        self._stayed = np.where(np.abs((errors + np.pi) % (2 * np.pi) - np.pi).max(axis=0) < NEAR, self._stayed + 1, 0)
        rewards, is_ended = np.prod((1 + np.cos(errors)) / 2, axis=0), np.abs(self.bench.truth[2 * n]) > limits.position
        if len(self._targets) > 1:
            rewards = (self._stayed == STAY).astype(float)
            is_ended |= (rewards > 0) & (self._stop + 1 == len(self._targets))
            self._stop = np.minimum(self._stop + (rewards > 0), len(self._targets) - 1)
            self._stayed[rewards > 0] = 0
        is_cut_off = self._age >= self._steps
        if len(finished):
            self._restart(finished)
            for values in (rewards, is_ended, is_cut_off):
                values[finished] = 0
        self._over = is_ended | is_cut_off
        return self._observations(), rewards, is_ended, is_cut_off & ~is_ended, {}

    def _restart(self, lanes: Values) -> None:
        """Begin new episodes, with random seeds, on some benches, whose numbers are `lanes`.

        Positions and counts of these benches begin anew; their rates are then zero, since `_before` equals `_reading`.
        """
        new_benches = self._benches(self._random_seeds(len(lanes)))
        self._reading[:, lanes] = self._before[:, lanes] = new_benches.read().positions
        self.bench.replace_runs(lanes.tolist(), new_benches)
        for counts in (self._age, self._stop, self._stayed):
            counts[lanes] = 0

    def _observations(self) -> Values:
        """Return the observations (num_envs, 4n+2) of all benches, as the head of this module defines them."""
        limits, n = self.itinerary.limits, self._arms
        rates = (self._reading - self._before) * self.itinerary.loop.rate
        angles, cart = self._reading[:n], [self._reading[n] / limits.position, rates[n] / limits.velocity]
        parts = [np.sin(angles), np.cos(angles), rates[:n] / _RATE, cart, np.cos(self._targets[self._stop].T)]
        return np.concatenate(parts).T.astype(np.float32)


class BenchEnvironment(gymnasium.Env[Values, Values]):
    """One bench, in lanes of a whole vector, so that it repeats a run to the last bit.

    Args:
        options: those of `BenchVector`.
    """

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(self, **options: Any) -> None:
        """Make a vector of benches that all have the same seed, of which only the first is shown."""
        self.vector = BenchVector(**options, num_envs=VECTOR)
        self.observation_space, self.action_space = (
            self.vector.single_observation_space,
            self.vector.single_action_space,
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Values, dict[str, Any]]:
        """Begin a new episode, and return its first observation and the seed of its bench.

        Args:
            seed: seed of the bench; None to continue.
            options: ignored.
        """
        super().reset(seed=seed)
        bench_seed = int(self.np_random.integers(_SEEDS)) if seed is None else seed
        return self.vector.reset(seed=[bench_seed] * VECTOR)[0][0], {"seed": bench_seed}

    def step(self, action: Values) -> tuple[Values, float, bool, bool, dict[str, Any]]:
        """Advance the bench by one period.

        Return observation (4n+2,), reward, end and cut-off of the episode, and no further data.

        Args:
            action: acceleration over its limit (1,), -1 to 1.

        Raises:
            InputError: the action is not a finite number.
        """
        observations, rewards, ended, cut_off, _ = self.vector.step(np.tile(action, (VECTOR, 1)))
        return observations[0], float(rewards[0]), bool(ended[0]), bool(cut_off[0]), {}
