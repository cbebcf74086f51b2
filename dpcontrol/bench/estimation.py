"""Chart of estimators: error and consistency against the time of a tick, over the resolution of the encoders.

A plant with parameters and encoder zeros of its own swings under a known input; every estimator knows the nominal
parameters and sees the same readings. Error: root mean square over ticks of the arms' scaled errors (π rad, 10 rad/s).

Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, section 5.4.2.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.chart import Panel, PrecisionChart
from dpcontrol.bench.measure import Alternative, Judged, compare
from dpcontrol.control.estimator_settings import (
    AdaptiveEkfSettings,
    EkfSettings,
    EstimatorSettings,
    FilterpyEkfSettings,
    UkfSettings,
    nees,
    share_inside,
)
from dpcontrol.control.interface import Estimate, Estimator, SampledModel
from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.foundation.progress import Progress
from dpcontrol.loop.bench import SensorSettings
from dpcontrol.loop.controllers import make_estimator
from dpcontrol.references.problem import ANGLE_SCALE, RATE_SCALE
from dpcontrol.scenes.model import load_model

Array = NDArray[np.float64]

PERIOD = 1e-3
"""s: the loop's."""
SETTLED = 300
"""Ticks left out at the start, where the first guess is judged, not the filter."""
CART_RESOLUTION = 1e-6
MISMATCH = 0.02
ZERO_ERROR = 3e-3
"""rad, about what an arm's resting place is read to."""
CUTOFFS = (10.0, 30.0, 100.0, math.inf)
"""Hz."""
AUGMENTS = ((), ("zeros",), EkfSettings().augment, AdaptiveEkfSettings().augment)
_METHODS: tuple[tuple[str, type[EstimatorSettings]], ...] = (
    ("EKF, compiled", EkfSettings), ("EKF, filterpy", FilterpyEkfSettings), ("UKF, filterpy", UkfSettings)
)  # fmt: skip
_EVERY = 20
"""Ticks between two values of NEES."""
_SWING = (0.4, 2.8, 2.0, -3.0, 0.0, 0.0)
_START_ERROR = 0.02
_WHY = (
    "zeros of a few milliradians are what a feedback on the state alone fails by, and finding them costs less than "
    "twice the time; parameters are estimated where a controller asks for them"
)


def chart(quick: bool, progress: Progress) -> PrecisionChart:
    """Return the chart; quick: two resolutions, one second of one swing, the UKF with and without zeros only."""
    arms = load_model("lab").arms
    resolutions = (4000, 40_000) if quick else (512, 4000, 40_000, 400_000)
    seconds, seeds = (1.0, 1) if quick else (3.0, 3)
    swings = [swing(arms, seconds=seconds, seed=k, mismatch=MISMATCH, zero_error=ZERO_ERROR) for k in range(seeds)]
    panels = []
    for k, counts in enumerate(resolutions):
        progress(f"estimation, {counts} counts", k / len(resolutions))
        panels.append(_panel(arms, swings, counts, quick=quick))
    return PrecisionChart(
        name="estimation",
        title=f"Estimation: plant off by {MISMATCH:.0%}, encoders' zeros by {ZERO_ERROR * 1e3:g} mrad",
        parts=tuple(panels),
        reading=(
            "Each point: an estimator on the same swings; across, a tick's time; up, the rms scaled error of angles "
            "and rates; a panel for each encoder.",
            "Points by their extras: what is estimated besides the state. Differences have no model to be wrong about, "
            "and no covariance that shows when they fail.",
            "The data hold the shares of NIS and NEES inside their 95 % bands: below 0.9 the estimator believes too "
            "much, near 1.0 too little.",
        ),
        chosen=(
            "The compiled EKF: the same numbers as filterpy's in a fraction of the time, and the UKF is no better "
            "here. Differences are as good only where counts are finer than the rig's, and do not find the zeros."
        ),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class KnownSwing:
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


def swing(arms: ArmChainParameters, *, seconds: float, seed: int, mismatch: float, zero_error: float) -> KnownSwing:
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
    return KnownSwing(commands, states, np.column_stack([relative, states[:, 2 * n]]))


def _panel(arms: ArmChainParameters, swings: list[KnownSwing], counts: int, *, quick: bool) -> Panel:
    model = SampledModel(equations_of(arms, Level.CART), arms.base(), period=PERIOD)
    judged: dict[tuple[str, str], Judged] = {}
    tried: list[Alternative[Any]] = []
    measured = swings[0].measured(counts)
    for name, settings in _METHODS:
        for augment in AUGMENTS[:2] if quick and settings is UkfSettings else AUGMENTS:
            default = settings is EkfSettings and augment in AUGMENTS[2:]
            kind = AdaptiveEkfSettings if default and augment == AUGMENTS[3] else settings
            estimator = make_estimator(kind(augment=augment), model, noise=noise_of(arms, counts))
            last = estimator.update(estimator.first(np.array(_SWING)), measured[0])
            one = Alternative(
                name, "+".join(augment) or "state only", partial(estimator.step, last, 0.1, measured[1]),
                default=default,
            )  # fmt: skip
            tried.append(one)
            judged[one.method, one.setting] = estimator_trial(estimator, swings, counts=counts)
    joints, rates = measured[:, : arms.count], swings[0].states[0, arms.count : 2 * arms.count]
    for cutoff in CUTOFFS:
        label = f"{cutoff:g} Hz" if cutoff < math.inf else "no low pass"
        tried.append(Alternative("differences", label, partial(differences, rates, joints[0], joints[1], cutoff)))
        judged["differences", label] = derivative_trial(cutoff, swings, counts=counts)
    found = compare(tried, lambda one, _: judged[one.method, one.setting])
    return found.titled(f"{counts} counts per turn", "s per tick", "rms error of the arms' state (scaled)", why=_WHY)


def estimator_trial(estimator: Estimator, swings: list[KnownSwing], *, counts: int) -> Judged:
    """Return the error of an estimator over the swings, and the shares of NIS and NEES inside their 95 % bands."""
    errors, nis, normalised = [], [], []
    m = swings[0].joints.shape[1]
    n = m - 1
    zeros = [k for k, name in enumerate(estimator.extra_names) if name.startswith("zero_")]
    for flown in swings:
        measured = flown.measured(counts)
        bias = np.cumsum(flown.joints[0, :n] - np.diff(flown.states[0, :n], prepend=0.0))
        estimate = estimator.update(estimator.first(np.array(_SWING)), measured[0])
        for k in range(1, len(flown.commands)):
            # A command acts over the period that ends with the reading.
            estimate = estimator.step(estimate, float(flown.commands[k]), measured[k])
            if k < SETTLED:
                continue
            errors.append(_scaled(estimate.state - flown.states[k], n))
            nis.append(estimate.nis)
            if k % _EVERY == 0:
                normalised.append(_nees(estimator, estimate, flown.states[k], bias, zeros))
    inside = share_inside(np.array(nis), m)
    of_state = share_inside(np.array(normalised), swings[0].states.shape[1] + len(zeros))
    note = f"NIS {inside:.0%}, NEES {of_state:.0%} inside"
    return Judged(_rms(errors), {"nis_inside_95": inside, "nees_inside_95": of_state}, note)


def _nees(estimator: Estimator, estimate: Estimate, truth: Array, bias: Array, zeros: list[int]) -> float:
    n = len(truth)
    which = [*range(n), *(n + k for k in zeros)]
    error = np.concatenate([truth - estimate.state, bias[: len(zeros)] - estimate.extra[zeros]])
    return float(nees(error, estimator.covariance(estimate)[np.ix_(which, which)]))


def differences(rates: Array, last: Array, measured: Array, cutoff: float) -> Array:
    """Return rates (m,) from positions `measured` (m,), `last` having been measured a period before.

        v_k = a v_{k-1} + (1 - a) (z_k - z_{k-1}) / T,      a = e^{-2π f T}

    cutoff: f in Hz of the first-order low pass, infinite for none. A difference is half a period old and carries the
    noise q/T of one count q; the low pass trades noise against a lag of 1/(2πf).
    Source: Franklin, Powell & Workman, Digital Control of Dynamic Systems, 3rd ed., section 6.1.
    """
    kept = math.exp(-2 * math.pi * cutoff * PERIOD)
    return kept * rates + (1 - kept) * (measured - last) / PERIOD


def derivative_trial(cutoff: float, swings: list[KnownSwing], *, counts: int) -> Judged:
    """Return the error of positions as read and rates by `differences`, which have no covariance."""
    errors = []
    for flown in swings:
        measured = flown.measured(counts)
        n = measured.shape[1] - 1
        rates = flown.states[0, n : 2 * n]
        for k in range(1, len(measured)):
            rates = differences(rates, measured[k - 1, :n], measured[k, :n], cutoff)
            if k >= SETTLED:
                state = np.concatenate([measured[k, :n], rates])
                errors.append(_scaled(state - flown.states[k, : 2 * n], n))
    return Judged(_rms(errors), note="no covariance")


def _rms(errors: list[Array]) -> float:
    # Two programs for the same equations differ by rounding, which shall not decide the front.
    return float(f"{np.sqrt(np.mean(np.square(errors))):.6g}")


def _scaled(away: Array, n: int) -> Array:
    return np.concatenate([away[:n] / ANGLE_SCALE, away[n : 2 * n] / RATE_SCALE])


def noise_of(arms: ArmChainParameters, counts: int) -> Array:
    """Return what the estimators assume of encoders of `counts` per turn, (n+1, n+1)."""
    return SensorSettings(counts=counts, cart_resolution=CART_RESOLUTION).covariance(arms.count)
