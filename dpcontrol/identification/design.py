"""Which recordings would reveal most about a model: free swings from rest, and swings that the cart's motion drives.

    I = 1/σ² (J_pᵀJ_p - J_pᵀJ_x (J_xᵀJ_x)⁻¹ J_xᵀJ_p),     digits = ½ log₁₀(det I) / f          (D-optimality)

J_p: slopes of all sampled angles over the logarithms of the f ratios in use; J_x: over start and encoder zeros, which
each recording has to itself; σ: one encoder's rounding. 10^-digits is the geometric mean of the relative standard
errors that independent rounding alone would leave: real ones are larger, but rank alike. Swings that magnify a small
error of their start manyfold promise most and keep least; they are marked as not usable.

Sources: Atkinson, Donev, Tobias, Optimum experimental designs, with SAS (2007), chapter 10; Swevers et al., Optimal
robot excitation and identification (1997).
"""

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import ArmChainParameters, base_ratios, ratio_names
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import picked
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.settings import Settings, setting
from dpcontrol.identification.fit import Swings

Array = NDArray[np.float64]

_LANES = 64
_CHAOTIC = 20.0


@dataclass(frozen=True)
class DesignSettings(Settings, table="design"):
    """What is compared. seconds: of each recording; period s: between samples; counts: of the encoders, per turn.

    steps: of each angle's grid over half a turn; amplitudes m/s² and frequencies Hz: of the cart's sine; track m: half
    its length.
    """

    seconds: float = setting(2.667, above=0, unit="s")
    period: float = setting(4e-3, above=0, unit="s")
    counts: int = setting(40_000, least=1)
    steps: int = setting(9, least=2)
    amplitudes: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    frequencies: tuple[float, ...] = (0.5, 0.7, 0.9, 1.1, 1.3, 1.5, 1.8, 2.1, 2.5, 3.0)
    track: float = setting(0.4, above=0, unit="m")


@dataclass(frozen=True, eq=False)
class Experiment:
    """One recording: kind "swing" from rest at angles (n,) rad, or "cart": hanging, the cart's acceleration a sine.

    information: digits; amplification: how much an error of the start may grow; matrix (f, f): its information.
    """

    kind: str
    angles: tuple[float, ...]
    amplitude: float
    frequency: float
    information: float
    amplification: float
    usable: bool
    matrix: Array

    @property
    def text(self) -> str:
        """Say what to do."""
        if self.kind == "swing":
            return "let go at " + ", ".join(f"{np.degrees(a):.0f}°" for a in self.angles)
        return f"cart's acceleration a sine of {self.amplitude:g} m/s², {self.frequency:g} Hz"


@dataclass(frozen=True, eq=False)
class Design:
    """Experiments compared for the ratios `names` (f,) of a model."""

    names: tuple[str, ...]
    experiments: tuple[Experiment, ...]
    settings: DesignSettings
    status: str

    def ranked(self) -> list[Experiment]:
        """Return the usable experiments, the most informative first."""
        return sorted((e for e in self.experiments if e.usable), key=lambda e: -e.information)

    def best_pair(self) -> tuple[Experiment, Experiment]:
        """Return the most informative experiment and the one that adds most to it (it may be the same again)."""
        ranked = self.ranked()
        first = ranked[0]
        return first, max(ranked, key=lambda e: digits(first.matrix + e.matrix))

    def document(self) -> dict[str, Any]:
        """Return what `dpcontrol identify --design --json` prints."""
        experiment = ("kind", "angles", "amplitude", "frequency", "information", "amplification", "usable")
        return {
            "unknowns": list(self.names),
            "experiments": [picked(e, *experiment) for e in self.experiments],
            "best": [e.text for e in self.ranked()[:5]],
            "pair": [e.text for e in self.best_pair()],
        }


def digits(matrix: Array) -> float:
    """Return ½ log₁₀ det / f of an information matrix (f, f), -inf where it is singular."""
    sign, logarithm = np.linalg.slogdet(matrix)
    return float(logarithm / np.log(10) / 2 / len(matrix)) if sign > 0 else -np.inf


def design_experiments(
    arms: ArmChainParameters, *, settings: DesignSettings | None = None, progress: Progress = no_progress
) -> Design:
    """Compare free swings over a grid of angles, and sines of the cart's acceleration, for what they reveal of `arms`.

    Raises:
        InputError: no experiment is usable.
    """
    settings = settings or DesignSettings()
    n = arms.count
    values = base_ratios(arms)
    used = np.flatnonzero(values)
    half = np.linspace(-np.pi, np.pi, 2 * settings.steps + 1)[1:-1]
    # A swing's mirror image reveals the same, so the first angle is taken as positive; at rest upright nothing moves.
    grid = [a for a in product(half[half > -1e-9], *[half] * (n - 1)) if np.abs(a).max() > 1e-9]
    sines = list(product(settings.amplitudes, settings.frequencies))
    times = np.arange(round(settings.seconds / settings.period) + 1) * settings.period
    plans = [("swing", a, 0.0, 0.0) for a in grid] + [("cart", (0.0,) * n, *sine) for sine in sines]
    starts = np.zeros((len(plans), 2 * n))
    u, v = np.zeros((2, len(plans), len(times)))
    for row, (kind, angles, amplitude, frequency) in enumerate(plans):
        starts[row, :n] = angles
        if kind == "swing":
            continue
        turning = 2 * np.pi * frequency
        u[row] = amplitude * np.cos(turning * (times + settings.period / 2))
        v[row] = amplitude / turning * np.sin(turning * times)
    model = Swings(arms)
    found: list[tuple[Array, float]] = []
    for first in range(0, len(starts), _LANES):
        progress("swings", first / len(starts))
        rows = slice(first, first + _LANES)
        _, slopes = model.flown(
            starts[rows],
            values,
            period=np.full(len(starts[rows]), settings.period),
            samples=len(times),
            accelerations=u[rows],
            velocities=v[rows],
        )
        found += [_information(one[:, :n], values, used, settings.counts) for one in slopes]
    progress("swings", 1.0)
    experiments: list[Experiment] = []
    for (kind, angles, amplitude, frequency), (matrix, growth) in zip(plans, found, strict=True):
        reach = amplitude / (2 * np.pi * frequency) ** 2 if kind == "cart" else 0.0
        information = digits(matrix)
        usable = growth < _CHAOTIC and 2 * reach <= settings.track and bool(np.isfinite(information))
        turns = tuple(float(angle) for angle in angles)
        experiments.append(Experiment(kind, turns, amplitude, frequency, information, growth, usable, matrix))
    usable = sum(e.usable for e in experiments)
    if not usable:
        raise InputError("no experiment is usable: none determines the arms' ratios; check the model's friction")
    left_out = [ratio_names(arms)[k] for k in range(len(values)) if k not in used]
    without = f"; without those that are zero: {', '.join(left_out)}" if left_out else ""
    return Design(
        names=tuple(ratio_names(arms)[k] for k in used),
        experiments=tuple(experiments),
        settings=settings,
        status=f"{usable} of {len(experiments)} experiments usable: an error of the start grows less than "
        f"{_CHAOTIC:g}-fold, and the cart stays on its track{without}",
    )


def _information(slopes: Array, values: Array, used: NDArray[np.intp], counts: int) -> tuple[Array, float]:
    """Return the information (f, f) on the logarithms of the ratios in use, and how an error of the start grows.

    slopes (K, n, 2n+m) of the angles over start and ratios.
    """
    samples, arms, _ = slopes.shape
    sigma = 2 * np.pi / counts / np.sqrt(12)
    of_start = slopes[:, :, : 2 * arms]
    growth = float(np.linalg.norm(of_start[:, :, :arms], axis=(1, 2)).max() / np.sqrt(arms))
    if not np.isfinite(slopes).all():
        return np.zeros((len(used), len(used))), np.inf
    zeros = np.broadcast_to(np.eye(arms), (samples, arms, arms))
    own = np.concatenate([of_start, zeros], axis=2).reshape(samples * arms, -1)
    shared = slopes[:, :, 2 * arms :][:, :, used].reshape(samples * arms, -1) * values[used]
    # Least squares against the recording's own unknowns leaves what only the shared ones explain.
    rest = shared - own @ np.linalg.lstsq(own, shared, rcond=1e-10)[0]
    return rest.T @ rest / sigma**2, growth
