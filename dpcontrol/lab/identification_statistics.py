"""How well identified numbers are known: covariance, what cannot be told apart.

    Cov = H⁻¹ (b/(b-f) Σ_blocks g gᵀ) H⁻¹,     H = Σ w J̃ᵀJ̃,   g = Σ_block J̃ᵀ ψ(e)

J̃: slopes of the predicted angles over the unknowns, each swing's start following them; ψ: the residuals as the robust
loss counts them. Neighbouring residuals are alike (rounding of slow motion, what the model leaves out), so they are
summed over blocks several times as long as they stay alike; b blocks, f unknowns. Taking each sample as independent
would give errors too small by that factor's root.

Sources: White, Maximum likelihood estimation of misspecified models (1982); Cameron, Miller, A practitioner's guide to
cluster-robust inference (2015), section II.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.swing_fit import SwingFit

Array = NDArray[np.float64]

_BLOCK_TIMES = 4.0
_LEAST_BLOCK = 10
_BLOCKS_PER_UNKNOWN = 4
_UNSEEN = 1e-10
ALIKE = 0.95
"""Correlation from which two numbers are said not to be told apart."""


def correlation_time(residuals: Sequence[Array]) -> float:
    """Return over how many samples residuals (K, n) stay alike: their integrated autocorrelation time, at least 1.

    Summed until the autocorrelation first falls below 0.05, pooled over swings and angles.
    """
    longest = min(len(r) for r in residuals)
    power = np.zeros(longest)
    for residual in residuals:
        for column in residual.T:
            # Padded to twice the length, the transform does not wrap around.
            spectrum = np.abs(np.fft.rfft(column, 2 * len(column))) ** 2
            power += np.fft.irfft(spectrum)[:longest]
    if power[0] <= 0:
        return 1.0
    shape = power / power[0]
    low = np.flatnonzero(shape < 0.05)
    end = int(low[0]) if len(low) else longest
    return float(max(1.0, 1 + 2 * shape[1:end].sum()))


def covariance_at_bounds(fit: SwingFit, bound: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the covariance (f, f) of the fit's unknowns and their standard errors (f,).

    bound (f,): which lie on a bound. They are taken as held there for the others' sake, and have no variance; their own
    standard errors are those that they would have without it.
    """
    errors = np.sqrt(np.diag(covariance_of(fit)))
    covariance = np.zeros((len(bound), len(bound)))
    covariance[np.ix_(~bound, ~bound)] = covariance_of(fit, ~bound)
    errors[~bound] = np.sqrt(np.diag(covariance)[~bound])
    return covariance, errors


def covariance_of(fit: SwingFit, among: NDArray[np.bool_] | None = None) -> Array:
    """Return the covariance of the unknowns that are `among`, the others held; what the data do not see: infinite."""
    among = np.ones(len(fit.unknowns), dtype=bool) if among is None else among
    information, f = fit.information[np.ix_(among, among)], int(among.sum())
    lengths = [len(s) for s in fit.scores]
    block = max(int(_BLOCK_TIMES * correlation_time(fit.residuals)), _LEAST_BLOCK)
    # More unknowns than blocks would make the sum singular, and every error zero somewhere.
    block = max(min(block, sum(lengths) // max(_BLOCKS_PER_UNKNOWN * f, 1)), 1)
    sums: list[Array] = []
    for score in fit.scores:
        edges = np.linspace(0, len(score), max(round(len(score) / block), 1) + 1).round().astype(int)[:-1]
        sums.append(np.add.reduceat(score[:, among], edges, axis=0))
    blocks = np.concatenate(sums)
    middle = blocks.T @ blocks * len(blocks) / max(len(blocks) - f, 1)
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    sizes, axes = np.linalg.eigh(information * np.outer(scale, scale))
    seen = sizes > _UNSEEN * sizes[-1]
    inverse = (axes[:, seen] / sizes[seen]) @ axes[:, seen].T * np.outer(scale, scale)
    covariance = inverse @ middle @ inverse
    unseen = axes[:, ~seen] * scale[:, None]
    for direction in unseen.T:
        touched = np.abs(direction) > 1e-6 * np.abs(direction).max()
        covariance[touched, touched] = np.inf
    return (covariance + covariance.T) / 2


def undetermined_of(
    names: Sequence[str], values: Array, errors: Array, *, covariance: Array, friction: slice
) -> list[str]:
    """Return sentences on numbers that the data leave open, and on pairs that they cannot tell apart."""
    deviations = np.sqrt(np.diag(covariance))
    sentences: list[str] = []
    for k, name in enumerate(names):
        if not np.isfinite(errors[k]):
            sentences.append(f"{name}: these swings do not depend on it, or only together with another")
        elif k in range(*friction.indices(len(names))) and abs(values[k]) < 2 * errors[k]:
            sentences.append(f"{name}: {values[k]:.3g} ± {errors[k]:.2g} (standard error) may as well be zero")
    for i in range(len(names)):
        for j in range(i):
            product = deviations[i] * deviations[j]
            if not np.isfinite(product) or product == 0:
                continue
            alike = covariance[i, j] / product
            if abs(alike) >= ALIKE:
                factor = np.sqrt((1 + abs(alike)) / max(1 - abs(alike), 1e-12))
                kind = "sum" if alike < 0 else "difference"
                sentences.append(
                    f"{names[j]} and {names[i]} apart (correlation {alike:+.3f}): their {kind}, each over its standard "
                    f"error, is known {factor:.0f} times better than what is across it"
                )
    return sentences
