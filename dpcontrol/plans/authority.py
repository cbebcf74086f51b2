"""Sensitivity of a motion under feedback: gains and deviations that decide whether it can be followed, without a run.

Gains of the linear-quadratic feedback K are large where the cart hardly moves the arms' unstable direction. They
multiply whatever hides the arms' angles, so motions between the same ends differ by orders of magnitude.

Let e be the distance of the state from the motion under this feedback. To first order in a relative error of one of the
arms' parameters,

    e_{k+1} = (A_k - B_k K_k) e_k + E_k,      e_0 = 0.

The sensitivity is the largest root of the sum of squares of the angles' errors, over all arms and parameters.
"""

from dataclasses import replace

import numpy as np

from dpcontrol.control.interface import SampledModel
from dpcontrol.control.tracking import TvlqrSettings, regulator_along
from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.plans.candidates import PERIOD, shared_model
from dpcontrol.references.reference import Reference
from dpcontrol.references.trajectory import Trajectory
from dpcontrol.tubes.connections import Connection

_SHARE = 1e-4
"""Step of difference quotients by the arms' parameters."""


def _regulator(arms: ArmChainParameters, states: Array, commands: Array) -> tuple[Array, Array, Array]:
    """Return the linear-quadratic feedback along a motion, sampled at `PERIOD`.

    Args:
        arms: parameters of the arms.
        states: states (K, N) of the motion.
        commands: accelerations (K,) of the cart, m/s².

    Returns:
        Gains (K, N), matrices (K, N, N) of the closed loop and costs-to-go, see `regulator_along`.

    Raises:
        GoalMissed: the motion's end cannot be stabilised.
    """
    model = shared_model(equations_of(arms, Level.CART))
    return regulator_along(model, states, commands, TvlqrSettings(), parameters=arms.base())


def _sampled(motion: Trajectory | Reference) -> tuple[Array, Array]:
    """Return the states (K, N) and the cart's accelerations (K,), m/s², at steps of `PERIOD`."""
    times = np.arange(max(round(motion.duration / PERIOD), 1), dtype=float) * PERIOD
    return motion.state(times), motion.input(times + PERIOD / 2)[:, 0]


def peak_gains(arms: ArmChainParameters, motion: Trajectory | Reference) -> Array:
    """Return the largest gain on an arm's angle at each step of `PERIOD` (K,), m/s² per rad.

    Args:
        arms: parameters of the arms.
        motion: motion of arms and cart.

    Raises:
        GoalMissed: the motion's end cannot be stabilised.
    """
    gains, *_ = _regulator(arms, *_sampled(motion))
    return np.abs(gains[:, : arms.count]).max(axis=1)


def growth_along(arms: ArmChainParameters, motion: Trajectory | Reference) -> float:
    """Return the largest rate at which a small error of the arms grows along a motion, 1/s.

    Args:
        arms: parameters of the arms.
        motion: motion of arms and cart.
    """
    states, commands = _sampled(motion)
    frictionless_arms = arms.frictionless()
    model = shared_model(equations_of(frictionless_arms, Level.CART))
    jacobians, _ = model.linearised(states, commands, parameters=frictionless_arms.base())
    n = 2 * arms.count
    return float(np.log(np.abs(np.linalg.eigvals(jacobians[:, :n, :n])).max()) / PERIOD)


def connection_loss(arms: ArmChainParameters, connection: Connection) -> float:
    """Return the largest gain on an arm's angle along a connection, m/s² per rad, infinite if none holds its end.

    This is the loss by which a plan passes over connections that are hard to follow, see `walks.symbols.choose`.

    Args:
        arms: parameters of two arms.
        connection: connection of their flow without friction.
    """
    states = connection.states(np.arange(*connection.time_range, PERIOD))
    try:
        gains, *_ = _regulator(arms.frictionless(), np.pad(states, ((0, 0), (0, 2))), np.zeros(len(states)))
    except GoalMissed:
        return float("inf")
    return float(np.abs(gains[:, : arms.count]).max())


def sensitivity(arms: ArmChainParameters, motion: Trajectory | Reference) -> float:
    """Return the largest deviation of the angles per unit relative error of the arms' parameters, rad.

    The deviation is infinite if the motion's end cannot be stabilised.

    Args:
        arms: parameters of the arms.
        motion: motion of arms and cart.
    """
    states, commands = _sampled(motion)
    try:
        _, closed, _ = _regulator(arms, states, commands)
    except GoalMissed:
        return float("inf")
    effects = _effects(arms, shared_model(equations_of(arms, Level.CART)), states, commands)
    deviations, largest = np.zeros(effects.shape[1:]), 0.0
    for k in range(len(states)):
        deviations = closed[k] @ deviations + effects[k]
        largest = max(largest, float(np.square(deviations[: arms.count]).sum()))
    return float(np.sqrt(largest))


def _effects(arms: ArmChainParameters, model: SampledModel, states: Array, commands: Array) -> Array:
    """Return the change E (K, N, p) of the state after each step per relative error of each of p parameters.

    These are the masses, centres of mass, lengths and inertias of all arms, in this order.

    Args:
        arms: parameters of the arms.
        model: sampled model of the arms.
        states: states (K, N) at the steps.
        commands: accelerations (K,) of the cart, m/s².
    """
    variants = [arms]
    for name in ("mass", "centre_of_mass", "length", "inertia"):
        for i, value in enumerate(getattr(arms, name)):
            values = list(getattr(arms, name))
            values[i] = value * (1 + _SHARE)
            variants.append(replace(arms, **{name: tuple(values)}))
    step_ends = [model.steps(states, commands, variant.base()) for variant in variants]
    return np.stack([(step - step_ends[0]) / _SHARE for step in step_ends[1:]], axis=2)
