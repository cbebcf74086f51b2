# %% [markdown]
# # A force instead of an acceleration
# Gymnasium's task InvertedDoublePendulum-v5: two poles on a cart that a force moves, 20 times a second. The model is
# the task's own MJCF. `model.force` turns accelerations into forces, and so it tells the acceleration of a force that
# is held during a step. A regulator for this step balances the poles. It needs
# `pip install 'dpcontrol[gym,mujoco]'`.

# %%
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from matplotlib.figure import Figure
from scipy import linalg as scipy_linalg

import dpcontrol as dp
from dpcontrol.dynamics.chain import Level, equations_of

linalg: Any = scipy_linalg
Array = np.ndarray[Any, np.dtype[Any]]
TASK, STRONGEST, SUBSTEPS = "InvertedDoublePendulum-v5", 500.0, 5
"""The task, its largest force (N), and steps of Runge-Kutta in one of its steps."""
ERRORS, EFFORT = np.array([1.0, 1.0, 0.1, 0.1, 0.1, 0.1]), 1e-4
"""Weights of squared errors of angles, rates and cart, and of squared forces."""


def pushed(model: dp.Model, *, cart_mass: float, cart_viscous: float) -> Callable[[Array, float], Array]:
    """Return the rate of the state of arms and cart as a function of state and force.

    Args:
        model: model of the arms.
        cart_mass: mass of the cart, kg.
        cart_viscous: friction of the cart, N s/m.
    """
    equations, base = equations_of(model.arms, Level.CART).function(), model.arms.base()

    def rate(state: Array, force: float) -> Array:
        none, one = (model.force(state, u, cart_mass=cart_mass, cart_viscous=cart_viscous) for u in (0.0, 1.0))
        return np.asarray(equations(state, (force - none) / (one - none), base), dtype=float).ravel()

    return rate


def after(rate: Callable[[Array, float], Array], state: Array, force: float, seconds: float) -> Array:
    """Return the state after a time with a constant force."""
    h = seconds / SUBSTEPS
    for _ in range(SUBSTEPS):
        first = rate(state, force)
        second = rate(state + h / 2 * first, force)
        third = rate(state + h / 2 * second, force)
        state = state + h / 6 * (first + 2 * second + 2 * third + rate(state + h * third, force))
    return state


# %%
def gains(rate: Callable[[Array, float], Array], seconds: float) -> Array:
    """Return the gains (6,) of the linear-quadratic regulator of upright poles for a force that is held.

    Args:
        rate: see `pushed`.
        seconds: time between forces, s.
    """
    upright, small = np.array([np.pi, np.pi, 0.0, 0.0, 0.0, 0.0]), 1e-5
    slopes = [
        after(rate, upright + e, 0.0, seconds) - after(rate, upright - e, 0.0, seconds) for e in small * np.eye(6)
    ]
    a = np.array(slopes).T / (2 * small)
    b = (after(rate, upright, 1.0, seconds) - after(rate, upright, -1.0, seconds))[:, None] / 2
    p: Array = linalg.solve_discrete_are(a, b, np.diag(ERRORS), np.array([[EFFORT]]))
    return np.asarray(np.linalg.solve(EFFORT + b.T @ p @ b, b.T @ p @ a)[0])


def errors(seen: Array) -> Array:
    """Return the deviation (6,) of the state from upright poles.

    The joints turn against the model's angles, as `dpcontrol model` says: angle_1 = π - hinge.

    Args:
        seen: observation of the task: cart, sines, cosines, then rates of cart and joints.
    """
    joints, rates = np.arctan2(seen[1:3], seen[3:5]), seen[6:8]
    return np.concatenate([-np.cumsum(joints), -np.cumsum(rates), [seen[0], seen[5]]])


def returns(seed: int) -> Array:
    """Return the sum of rewards after each step of an episode.

    Args:
        seed: seed of the first state.
    """
    env: Any = gymnasium.make(TASK)
    own = env.unwrapped
    with warnings.catch_warnings():
        # What the model leaves out is known here: the damping of the slider, and a gravity that is tilted by 1e-6.
        warnings.simplefilter("ignore")
        model = dp.load_model(own.fullpath)
    mass, drag = float(own.model.body("cart").mass[0]), float(own.model.joint("slider").damping[0])
    gain = gains(pushed(model, cart_mass=mass, cart_viscous=drag), own.dt)
    seen, _ = env.reset(seed=seed)
    rewards, over = list[float](), False
    while not over:
        force = -float(gain @ errors(seen))
        seen, reward, ended, cut, _ = env.step(np.clip([force / STRONGEST], -1.0, 1.0))
        rewards.append(float(reward))
        over = ended or cut
    return np.cumsum(rewards)


# %%
if __name__ == "__main__":
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for seed in range(10):
        total = returns(seed)
        print(f"seed {seed}: {len(total)} steps, return {total[-1]:.1f}")
        axes.plot(total - 9.36 * np.arange(1, len(total) + 1), label=f"seed {seed}")
    axes.set(xlabel="step", ylabel="return less 9.36 a step", title=TASK)
    axes.legend(ncols=2, fontsize="small")
    figure.savefig("inverted-double-pendulum.png", dpi=110)
