"""NIS and NEES of many simulated runs at once: is the filter consistent with what it assumes?

The truth obeys the filter's own equations, its process noise and its prior, so only linearisation, and optional
rounding to encoder counts, violates the filter's assumptions. A truth without process noise would not do: the filter
then expects more error than there is, and too many values fall inside.

    z⁺ = F(z, u) + w,  w ~ N(0, Q(z));    m = H z + v,  v ~ N(0, R), or relative angles rounded to counts
Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, section 5.4.2.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.ekf import CompiledEkf, unpacked
from dpcontrol.control.estimator_settings import nees, share_inside
from dpcontrol.dynamics.compiled import Compiled

Array = NDArray[np.float64]

_SETTLING = 0.2
"""Initial time without evaluation, s, because it depends on the prior."""
_EVERY = 20
"""Ticks between two values of NEES."""


@dataclass(frozen=True, eq=False)
class Consistency:
    """Shares of values within their 95 % bands, and means (freedom: n+1, N+E)."""

    nis_inside_95: float
    nees_inside_95: float
    mean_nis: float
    mean_nees: float


def simulated_consistency(
    ekf: CompiledEkf,
    *,
    first: Array,
    commands: Array,
    runs: int,
    seed: int,
    steps: Array | None = None,
    process_noise: bool = True,
) -> Consistency:
    """Run `runs` filters over `commands` (K,) m/s² from `first` (N,), with truths drawn from what the filter assumes.

    The measurement has the noise that the filter assumes, unless `steps` (n+1,) are given, the encoders' resolutions in
    rad and m: then readings are rounded to them.
    """
    random = np.random.default_rng(seed)
    equations, size, arms = ekf.equations, ekf.equations.dimension, ekf.model.arms
    sigmas = np.sqrt(ekf.settings.first_covariance(arms).diagonal())
    h, root = equations.observation, np.linalg.cholesky(ekf.noise)
    linear = Compiled(equations.prediction(with_jacobian=True))
    start = np.concatenate([first, np.zeros(size - len(first))])[:, None]
    truth = start + sigmas[:, None] * random.standard_normal((size, runs))
    inputs, memory = (np.repeat(a[:, None], runs, axis=1) for a in (ekf.inputs, ekf.first(first).memory))
    inputs[ekf.whole.slices["present"]] = 1.0
    known = np.zeros((linear.size_in, runs))
    known[linear.slices["parameters"]] = ekf.model.parameters[:, None]
    known[linear.slices["process"]] = ekf.process[:, None]
    out, moved = np.empty((ekf.whole.size_out, runs)), np.empty((linear.size_out, runs))
    settled = int(_SETTLING / ekf.model.period)
    relative = np.eye(arms + 1) - np.diag([*([1.0] * (arms - 1)), 0.0], -1)
    sums = np.linalg.inv(relative)
    nis, errors = [], []
    for k, command in enumerate(commands):
        if k:
            known[linear.slices["z"]], known[linear.slices["command"]] = truth, command
            if equations.shares:
                # The noise that covers the squares of the parameters' errors follows from the filter's own variances.
                variances = unpacked(memory[size:].T)[:, equations.shares, equations.shares]
                known[linear.slices["noise_inputs"].start] = variances.mean(axis=1)
            linear(known, moved)
            truth = moved[:size].copy()
            if process_noise:
                q = moved[size + size * size :].T.reshape(runs, size, size)
                truth += np.einsum("sij,js->is", np.linalg.cholesky(q), random.standard_normal((size, runs)))
        positions = h @ truth
        if steps is None:
            positions = positions + root @ random.standard_normal((arms + 1, runs))
        else:
            positions = sums @ (np.rint(relative @ positions / steps[:, None]) * steps[:, None])
        inputs[ekf.whole.slices["memory"]] = memory
        inputs[ekf.whole.slices["command"]] = command
        inputs[ekf.whole.slices["measured"]] = positions
        (ekf.whole if k else ekf.correct)(inputs, out)
        memory = out[: ekf.out.slices.covariance.stop].copy()
        if k >= settled:
            nis.append(out[ekf.out.slices.nis][0].copy())
            if k % _EVERY == 0:
                p = unpacked(memory[size:].T)
                errors.append(nees((truth - memory[:size]).T, p))
    all_nis, all_nees = np.array(nis), np.array(errors)
    return Consistency(
        share_inside(all_nis, arms + 1),
        share_inside(all_nees, size),
        float(all_nis.mean()),
        float(all_nees.mean()),
    )
