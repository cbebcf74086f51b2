"""Estimators on the same swings seen through encoders: their errors, their consistency, their time.

A plant with parameters and encoder zeros of its own swings under a known input; every estimator knows the nominal
parameters and sees the same readings. Error: root mean square over ticks of the arms' scaled errors (π rad, 10 rad/s).

Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, section 5.4.2.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.derivative_filter import DerivativeFilter
from dpcontrol.control.consistency import nees, share_inside
from dpcontrol.control.interface import Estimate, Estimator
from dpcontrol.control.model import SampledModel
from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.loop.bench import SensorSettings
from dpcontrol.references.problem import ANGLE_SCALE, RATE_SCALE

Array = NDArray[np.float64]

PERIOD = 1e-3
"""s: the loop's."""
SETTLING = 0.3
"""s left out at the start, where the first guess is judged, not the filter."""
CART_RESOLUTION = 1e-6
_EVERY = 20
"""Ticks between two values of NEES."""
_SWING = (0.4, 2.8, 2.0, -3.0, 0.0, 0.0)
_START_ERROR = 0.02


@dataclass(frozen=True, eq=False)
class Swing:
    """Commands (K,) m/s², true states (K, N), relative angles with the encoders' zeros and the cart (K, n+1)."""

    commands: Array
    states: Array
    joints: Array

    def measured(self, counts: int) -> Array:
        """Return absolute angles and the cart's position (K, n+1) as encoders of `counts` per turn give them."""
        n = self.joints.shape[1] - 1
        steps = np.array([2 * np.pi / counts] * n + [CART_RESOLUTION])
        read = np.rint(self.joints / steps) * steps
        return np.column_stack([np.cumsum(read[:, :n], axis=1), read[:, n]])


def swing(arms: ArmChainParameters, *, seconds: float, seed: int, mismatch: float, zero_error: float) -> Swing:
    """Return a free-hand swing: parameters off by `mismatch`, zeros by `zero_error` rad, a sine of 0.5 m/s²."""
    random = np.random.default_rng(seed)
    plant = arms.mismatched(mismatch, random)
    model = SampledModel(equations_of(plant, Level.CART), plant.base(), period=PERIOD)
    n, count = arms.count, round(seconds / PERIOD)
    commands = 0.5 * np.sin(2.5 * PERIOD * np.arange(count))
    x = np.array(_SWING)
    x[:n] += _START_ERROR * random.uniform(-1, 1, n)
    states = np.empty((count, len(x)))
    for k, command in enumerate(commands.tolist()):
        x = model.step(x, command) if k else x
        states[k] = x
    zeros = zero_error * random.uniform(-1, 1, n)
    relative = np.diff(states[:, :n], axis=1, prepend=0.0) + zeros
    return Swing(commands, states, np.column_stack([relative, states[:, 2 * n]]))


@dataclass(frozen=True)
class Trial:
    """What came of one method on some swings: rms scaled error, shares inside 95 % bands (nan: it has none)."""

    error: float
    nis_inside_95: float
    nees_inside_95: float


def estimator_trial(estimator: Estimator, swings: list[Swing], *, counts: int) -> Trial:
    """Return errors and consistency of an estimator over the swings."""
    errors, nis, normalised = [], [], []
    settled, m = round(SETTLING / PERIOD), swings[0].joints.shape[1]
    n = m - 1
    zeros = [k for k, name in enumerate(estimator.extra_names) if name.startswith("zero_")]
    for flown in swings:
        measured = flown.measured(counts)
        bias = np.cumsum(flown.joints[0, :n] - np.diff(flown.states[0, :n], prepend=0.0))
        estimate = estimator.update(estimator.first(np.array(_SWING)), measured[0])
        for k in range(1, len(flown.commands)):
            # A command acts over the period that ends with the reading.
            estimate = estimator.step(estimate, float(flown.commands[k]), measured[k])
            if k < settled:
                continue
            errors.append(_scaled(estimate.state - flown.states[k], n))
            nis.append(estimate.nis)
            if k % _EVERY == 0:
                normalised.append(_nees(estimator, estimate, flown.states[k], bias, zeros))
    size = swings[0].states.shape[1] + len(zeros)
    return Trial(
        float(np.sqrt(np.mean(np.square(errors)))),
        share_inside(np.array(nis), m),
        share_inside(np.array(normalised), size),
    )


def _nees(estimator: Estimator, estimate: Estimate, truth: Array, bias: Array, zeros: list[int]) -> float:
    n = len(truth)
    which = [*range(n), *(n + k for k in zeros)]
    error = np.concatenate([truth - estimate.state, bias[: len(zeros)] - estimate.extra[zeros]])
    return float(nees(error, estimator.covariance(estimate)[np.ix_(which, which)]))


def derivative_trial(law: DerivativeFilter, swings: list[Swing], *, counts: int) -> Trial:
    """Return the errors of positions as read and rates by differences."""
    errors, settled = [], round(SETTLING / PERIOD)
    for flown in swings:
        measured = flown.measured(counts)
        n = measured.shape[1] - 1
        rates = flown.states[0, n : 2 * n]
        for k in range(1, len(measured)):
            rates = law.step(rates, measured[k - 1, :n], measured[k, :n])
            if k >= settled:
                state = np.concatenate([measured[k, :n], rates])
                errors.append(_scaled(state - flown.states[k, : 2 * n], n))
    return Trial(float(np.sqrt(np.mean(np.square(errors)))), float("nan"), float("nan"))


def _scaled(away: Array, n: int) -> Array:
    return np.concatenate([away[:n] / ANGLE_SCALE, away[n : 2 * n] / RATE_SCALE])


def one_step(estimator: Estimator, flown: Swing, *, counts: int) -> Callable[[], Estimate]:
    """Return what a tick of the estimator costs, as a function to be timed."""
    measured = flown.measured(counts)
    last = estimator.update(estimator.first(np.array(_SWING)), measured[0])
    return lambda: estimator.step(last, 0.1, measured[1])


def noise_of(arms: ArmChainParameters, counts: int) -> Array:
    """Return what the estimators assume of encoders of `counts` per turn, (n+1, n+1)."""
    return SensorSettings(counts=counts, cart_resolution=CART_RESOLUTION).covariance(arms.count)
