"""Passages of the lab pendulum's necks, counted over the microcanonical ensemble without any code of the package.

The arms come from `models/lab.toml`. The equations of the textbook are integrated by the classical Runge-Kutta method.
States are drawn evenly from the energy surface by rejection. A neck is passed when the arm that stands up comes
from `margin` before to `margin` after its upright position; this distance exceeds the swing of the Lyapunov orbit, so
motions that turn back in the neck do not count. The flow keeps the ensemble, so passages are counted over a window of
the time after a start that tells on which side each motion is.

`python tests/independent_passages.py` writes the table of the figure `transport`.
"""

import json
import tomllib
from dataclasses import asdict, dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from textbook import TwoArms

Array = np.ndarray
ROOT = Path(__file__).parents[1]
TABLE = ROOT / "dpcontrol" / "pages" / "paper" / "passages.json"
STEP = 0.005
"""s; the energy drifts by less than 3e-4 J."""
BEFORE = 1.5
"""Time before the window, s."""
UPRIGHT = {"down-up": 1, "up-down": 0}
MARGINS = {"down-up": 0.75, "up-down": 0.5}
"""rad; the orbits swing by at most 0.66 rad up to 0.2 J, and by 0.23 rad up to 0.3 J."""
ENERGIES = {"down-up": (-0.12, -0.07, 0.0, 0.1, 0.2), "up-down": (0.2, 0.23, 0.26, 0.3)}
"""J."""


@dataclass(frozen=True)
class Passages:
    """Mean time between passages with its standard error, s, from `motions` followed for `window` s.

    `again` is the share of the passages after which the next crossing of the section is a passage again, with its
    standard error.
    """

    saddle: str
    energy: float
    mean_time: float
    error: float
    again: float
    again_error: float
    motions: int
    window: float
    drift: float


class Arms(TwoArms):
    """Two arms, inner arm first, with A ω₁'² + … in base parameters."""

    def __init__(self) -> None:
        model = tomllib.loads((ROOT / "models" / "lab.toml").read_text(encoding="utf-8"))
        super().__init__(SimpleNamespace(**model["arms"], gravity=model["gravity"]["acceleration"]))
        self.weights = [self.gravity * moment for moment in self.moments]

    def potential(self, angles: Array) -> Array:
        return -self.weights[0] * np.cos(angles[0]) - self.weights[1] * np.cos(angles[1])

    def energy(self, states: Array) -> Array:
        first, second, rate, other = states
        kinetic = (self.inner * rate**2 + self.outer * other**2) / 2 + self.both * np.cos(first - second) * rate * other
        return kinetic + self.potential(states[:2])

    def step(self, states: Array) -> Array:
        k1 = np.array(self.slope(states))
        k2 = np.array(self.slope(states + STEP / 2 * k1))
        k3 = np.array(self.slope(states + STEP / 2 * k2))
        k4 = np.array(self.slope(states + STEP * k3))
        return states + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def ensemble(self, energy: float, count: int, random: np.random.Generator) -> Array:
        """Return states (4, count) of an energy: angles with the weight √det M, momenta of any direction."""
        angles = random.uniform(-np.pi, np.pi, (2, 40 * count))
        mixed = self.both * np.cos(angles[0] - angles[1])
        weight = np.sqrt(1 - mixed**2 / (self.inner * self.outer))
        taken = (self.potential(angles) < energy) & (random.uniform(size=weight.shape) < weight)
        angles, mixed = angles[:, taken][:, :count], mixed[taken][:count]
        assert angles.shape == (2, count)
        # With p = L n and M = L Lᵀ, the rates are ω = L⁻ᵀ n.
        low, side = np.sqrt(self.inner), mixed / np.sqrt(self.inner)
        corner = np.sqrt(self.outer - side**2)
        size, way = np.sqrt(2 * (energy - self.potential(angles))), random.uniform(0, 2 * np.pi, count)
        other = size * np.sin(way) / corner
        return np.stack([*angles, (size * np.cos(way) - side * other) / low, other])


def count_passages(saddle: str, energy: float, *, motions: int, window: float, seed: int) -> Passages:
    """Count the passages of a neck."""
    arms, arm, margin = Arms(), UPRIGHT[saddle], MARGINS[saddle]
    states = arms.ensemble(energy, motions, np.random.default_rng(seed))
    side = np.full(motions, np.nan)  # number of the valley that the arm was in last, between upright positions
    counts, again, followed = np.zeros(motions), np.zeros(motions), np.zeros(motions)
    lap = np.floor(states[arm] / (2 * np.pi))  # number of the crossing of "hanging" below
    last = np.zeros(motions)  # sense of the last crossing of the section
    passed = np.zeros(motions, dtype=bool)  # whether the last crossing came after a passage
    for k in range(round((BEFORE + window) / STEP)):
        states = arms.step(states)
        turns = (states[arm] + np.pi) / (2 * np.pi)
        valley = np.rint(turns - 0.5)
        inside = np.abs(states[arm] - 2 * np.pi * valley) < np.pi - margin
        new = np.where(inside, valley, side)
        counts += (k * STEP >= BEFORE) * np.nan_to_num(np.abs(new - side))
        side = new
        now = np.floor(states[arm] / (2 * np.pi))
        sense = np.sign(now - lap)
        crosses, passes = sense != 0, (sense != 0) & (sense == last)
        # Each crossing that came after a passage has a next crossing, which comes after another passage or does not.
        followed += crosses & passed & (k * STEP >= BEFORE)
        again += passes & passed & (k * STEP >= BEFORE)
        passed, last, lap = np.where(crosses, passes, passed), np.where(crosses, sense, last), now
    rate, error = counts.mean() / window, counts.std(ddof=1) / np.sqrt(motions) / window
    share = again.sum() / max(followed.sum(), 1.0)
    spread = np.sqrt(np.sum((again - share * followed) ** 2)) / max(followed.sum(), 1.0)
    drift = float(np.abs(arms.energy(states) - energy).max())
    return Passages(saddle, energy, 1 / rate, error / rate**2, share, spread, motions, window, drift)


if __name__ == "__main__":
    rows = [
        count_passages(saddle, energy, motions=10_000, window=6.0, seed=100 * arm + k)
        for arm, (saddle, energies) in enumerate(ENERGIES.items())
        for k, energy in enumerate(energies)
    ]
    TABLE.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n", encoding="utf-8")
