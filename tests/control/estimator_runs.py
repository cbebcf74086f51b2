"""Swings with separate parameters, zeros and disturbance, read by encoders, for tests of estimators."""

from dataclasses import dataclass

import numpy as np
from shadowing_stand_in import LAB

from dpcontrol.control.interface import SampledModel
from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.loop.bench import SensorSettings

NOISE = SensorSettings().covariance(2)
EQUATIONS = arm_chain_equations(2, Level.CART)
MODEL = SampledModel(EQUATIONS, LAB.base(), period=1e-3)
SWING = (0.4, 2.8, 2.0, -3.0, 0.0, 0.0)
COUNT = 2 * np.pi / 40_000


@dataclass(frozen=True, eq=False)
class Run:
    """Commands (K,), true states (K, 6) and encoder counts as relative angles and cart position (K, 3)."""

    commands: np.ndarray
    states: np.ndarray
    relative: np.ndarray

    def measured(self, k: int) -> np.ndarray:
        inner, outer, cart = self.relative[k]
        return np.array([inner, inner + outer, cart])


def run(seconds: float, *, zeros: tuple[float, float] = (0.0, 0.0), torque: float = 0.0) -> Run:
    """torque: a further acceleration of the outer arm, rad/s², given as steps of its rate."""
    count = round(seconds * 1000)
    commands = 0.5 * np.sin(2.5e-3 * np.arange(count))
    x = np.array(SWING)
    x[:2] += 0.02 * np.random.default_rng(0).uniform(-1, 1, 2)
    states = np.empty((count, 6))
    for k, command in enumerate(commands):
        if k:
            x = MODEL.step(x, command)
            x[3] += torque * 1e-3
        states[k] = x
    inner, outer = states[:, 0] + zeros[0], states[:, 1] + zeros[1]
    angles = np.rint(np.array([inner, outer - inner]).T / COUNT) * COUNT
    return Run(commands, states, np.column_stack([angles, np.rint(states[:, 4] * 1e6) * 1e-6]))


def estimated(estimator, flown: Run, *, start: tuple[float, ...] = SWING) -> list:
    """Estimates at all ticks."""
    estimates = [estimator.update(estimator.first(np.array(start)), flown.measured(0))]
    for k in range(1, len(flown.commands)):
        estimates.append(estimator.step(estimates[-1], float(flown.commands[k]), flown.measured(k)))
    return estimates
