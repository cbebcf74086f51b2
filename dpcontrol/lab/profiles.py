"""Profiles of an identification: the least misfit with one number held off its best value, the others fitted again.

Where a profile is the parabola that the linearised fit promises, the standard error describes the number; where it is
flat, or stops at a bound, the recordings do not determine it.

Source: Raue et al., Structural and practical identifiability analysis of partially observed dynamical models (2009).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.swing_fit import FitSettings, fit_swings
from dpcontrol.control.swings import Swings
from dpcontrol.dynamics.base_ratios import inertial_count
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.lab.identification import Identification

Array = NDArray[np.float64]

_AT = (-3.0, -1.5, 1.5, 3.0)


@dataclass(frozen=True, eq=False)
class Profile:
    """Of one unknown: values (K,), the share (K,) by which the loss rises, and what the linearised fit promises."""

    name: str
    best: float
    error: float
    values: Array
    rises: Array
    promised: Array


def profiles(
    found: Identification, *, settings: FitSettings | None = None, progress: Progress = no_progress
) -> tuple[Profile, ...]:
    """Return the profile of each unknown within three standard errors, by fitting the others again."""
    fit = found.candidates[found.chosen].fit
    settings = replace(settings or FitSettings(), bend=fit.bend, tolerance=1e-5)
    model = Swings(found.arms)
    m, swings = model.parameters, [s for s, about in zip(found.swings, found.segments, strict=True) if about.used]
    every = np.concatenate([fit.parameters, fit.zeros.ravel()])
    inside = np.diag(found.covariance) > 0
    information = np.where(np.outer(inside, inside), fit.information, 0.0)
    information[~inside, ~inside] = np.diag(fit.information)[~inside]
    # What lies on a bound has the standard error, and the curve, that it would have without it.
    curvature = np.where(
        inside,
        1 / np.diag(np.linalg.pinv(information, hermitian=True)),
        1 / np.maximum(np.diag(np.linalg.pinv(fit.information, hermitian=True)), 1e-300),
    )
    out: list[Profile] = []
    for k, (name, index) in enumerate(zip(found.names, fit.unknowns, strict=True)):
        progress("profiles", k / len(found.names))
        best, error = float(every[index]), float(found.errors[k])
        values = best + error * np.array(_AT)
        values = np.unique(np.maximum(values, 0.0) if inertial_count(found.arms.count) <= index < m else values)
        values = values[np.abs(values - best) > 1e-3 * error] if np.isfinite(error) else values[:0]
        rises = []
        for value in values:
            held = every.copy()
            held[index] = value
            free = np.ones(m, dtype=bool)
            if index < m:
                free[index] = False
            again = fit_swings(
                model,
                swings,
                parameters=held[:m],
                zeros=held[m:].reshape(fit.zeros.shape),
                free=free,
                # A zero is held together with the others of its kind: they hardly mix.
                free_zeros=len(fit.unknowns) > m and index < m,
                friction_from=inertial_count(found.arms.count),
                settings=settings,
                near=fit.window_starts,
            )
            rises.append(again.loss / fit.loss - 1)
        promised = curvature[k] * (values - best) ** 2 / 2 / fit.loss
        out.append(Profile(name, best, error, values, np.array(rises), promised))
    progress("profiles", 1.0)
    return tuple(out)
