"""A small bench for tests of controllers: encoders, filter, one tick of delay, and a plant with other parameters."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from shadowing_stand_in import LAB

from dpcontrol.control.ekf import CompiledEkf
from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.interface import Action, SampledModel, Session
from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.loop.bench import SensorSettings

Array = NDArray[np.float64]
PERIOD = 1e-3
COUNT = 2 * np.pi / 40_000


def model_of(parameters: Array | None = None) -> SampledModel:
    """The lab's arms at the cart level at 1 kHz, or others with the same equations."""
    return SampledModel(
        arm_chain_equations(2, Level.CART), LAB.base() if parameters is None else parameters, period=PERIOD
    )


def plant_of(seed: int, mismatch: float) -> SampledModel:
    return model_of(LAB.mismatched(mismatch, np.random.default_rng(seed)).base())


@dataclass
class Flight:
    """States (K, N) of the plant, what was done (K), and the largest command."""

    states: Array
    actions: list[Action]

    @property
    def feedback(self) -> float:
        """Root mean square of the feedback, m/s²."""
        return float(np.sqrt(np.mean([action.feedback**2 for action in self.actions])))

    @property
    def events(self) -> list[str]:
        return [action.event for action in self.actions if action.event]


def read(state: Array) -> Array:
    """Return the readings of relative encoders and the cart's scale."""
    inner, outer = np.rint(state[0] / COUNT) * COUNT, np.rint((state[1] - state[0]) / COUNT) * COUNT
    return np.array([inner, inner + outer, np.rint(state[4] * 1e6) / 1e6])


def fly(
    session: Session, plant: SampledModel, start: Array, seconds: float, *, believed: Array | None = None
) -> Flight:
    """One run by encoders and filter, one tick of delay; it stops where an arm or the cart is far off."""
    model = model_of()
    ekf = CompiledEkf(model, EkfSettings(augment=()), noise=SensorSettings().covariance(2))
    state = np.array(start)
    estimate = ekf.first(start if believed is None else believed)
    none = np.zeros(0)
    first = session.command(0, estimate.state, none)
    on_its_way = first.feedforward + first.feedback
    states, actions, acted = [], [], 0.0
    for k in range(round(seconds / PERIOD)):
        measured = read(state)
        estimate = ekf.step(estimate, acted, measured) if k else ekf.update(estimate, measured)
        action = session.command(k + 1, ekf.ahead(estimate, [on_its_way]), none)
        acted, on_its_way = on_its_way, float(np.clip(action.feedforward + action.feedback, -30, 30))
        states.append(state)
        actions.append(action)
        state = plant.step(state, acted)
        if np.abs(state[:2] - action.reference[:2]).max() > 1.5 or abs(state[4]) > 0.8:
            break
    return Flight(np.array(states), actions)
