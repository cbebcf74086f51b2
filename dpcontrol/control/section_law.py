"""Pulses from section to section: linear-quadratic, classic, and corrected by what a run teaches about the plant.

    ξ_{j+1} = A_j ξ_j + B_j p_j + D_j δ,        p_j = -K_j ξ_j - s_j · δ̂

K from the periodic Riccati equation. δ: relative errors of the model's base parameters. A plant that differs from the
model has another orbit, and a law that aims for the model's fights the difference at every section. After each
section what the model foresaw is compared with what came, D_j δ, and δ̂ follows by a Kalman filter (recursive least
squares with prior and drift). s is the optimum for a disturbance D_j δ known for all sections to come:

    s_j = (r + BᵀP_{j+1}B)⁻¹ Bᵀ v_j,    v_j = P_{j+1} D_j + g_{j+1},    g_j = (A_j - B_j K_j)ᵀ v_j

Source: Anderson & Moore, Optimal Control: Linear Quadratic Methods, sections 3.4 (known disturbances) and 4.3; Åström &
Wittenmark, Adaptive Control, section 2.2, for the least squares.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.periodic import periodic_gains
from dpcontrol.control.tracking import riccati_gains
from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.errors import GoalMissed

if TYPE_CHECKING:
    from dpcontrol.references.sustained import SectionMap, SustainedOrbit

Array = NDArray[np.float64]

ANGLE_ERROR, RATE_ERROR = 3e-4, 0.05
"""rad and rad/s: what an estimate from 40,000 counts may be off by while an arm swings."""
DRIFT = 0.02
"""Share of its prior by which a parameter's error may change from section to section."""
_FRICTION = 5.0
"""Friction is known five times worse than inertia."""
_STEP = 5e-4
"""s: of the flights whose differences are the sensitivities; their own error is far below that of the differences."""
_DIFFERENCE = 1e-3
_SETTLED = 1e-9
_MOST_PERIODS = 5000


@dataclass(frozen=True, eq=False)
class Learning:
    """What sections teach: sensitivities D (k, 2n, m), noise (k, 2n, 2n), shifts s (k, m) in m/s², prior (m, m)."""

    sensitivities: Array
    noise: Array
    shifts: Array
    prior: Array

    def updated(self, section: NDArray[np.intp] | int, guess: Array, covariance: Array, surprise: Array
                ) -> tuple[Array, Array]:  # fmt: skip
        """Return δ̂ (…, m) and its covariance (…, m, m) after the flights from `section` (…).

        surprise (…, 2n): the pendulum's state on the section it came to, less what the model foresaw.
        """
        d = self.sensitivities[section]
        spread = covariance + DRIFT**2 * self.prior
        there = d @ spread
        total = there @ np.swapaxes(d, -1, -2) + self.noise[section]
        gain = np.swapaxes(np.linalg.solve(total, there), -1, -2)
        news = surprise - (d @ guess[..., None])[..., 0]
        return guess + (gain @ news[..., None])[..., 0], spread - gain @ there


def section_gains(maps: "tuple[SectionMap, ...]", *, weights: Array, effort: float) -> Array:
    """Return the gains (k, N) of the periodic Riccati equation of the section maps.

    Raises:
        GoalMissed: the recursion does not settle.
    """
    matrices, responses = _arrays(maps)
    return periodic_gains(matrices, responses, weights=weights, effort=effort)


def classic_gains(maps: "tuple[SectionMap, ...]") -> Array:
    """Return the gains (k, N) whose pulses take the unstable direction to zero at the next section.

    Raises:
        GoalMissed: a pulse does not move the unstable direction.
    """
    gains = []
    for j, here in enumerate(maps):
        product = np.eye(len(here.response))
        for later in maps[j + 1 :] + maps[: j + 1]:
            product = later.matrix @ product
        values, left = np.linalg.eig(product.T)
        direction = np.real(left[:, np.argmax(np.abs(values))])
        reach = float(direction @ here.response)
        if abs(reach) <= 1e-12 * float(np.linalg.norm(here.response)):
            raise GoalMissed(f"a pulse after section {j + 1} does not move the unstable direction; take more sections")
        gains.append(direction @ here.matrix / reach)
    return np.array(gains)


def parameter_directions(equations: Equations, parameters: Array) -> Array:
    """Return changes (m, p) of base parameters by their own size: inertia, weights with couplings, friction × 5.

    Weight G_i and coupling S_i = G_i/g belong together: no bench changes gravity.
    """
    n = (equations.dimension - 2) // 2
    inertias = n * (n + 1) // 2
    rows = []
    for i in range(inertias + n):
        row = np.zeros(len(parameters))
        row[i] = parameters[i]
        if i >= inertias:
            row[i + n] = parameters[i + n]
        rows.append(row)
    for i in range(inertias + 2 * n, len(parameters)):
        row = np.zeros(len(parameters))
        row[i] = _FRICTION * parameters[i]
        rows.append(row)
    return np.array(rows)


def sensitivities(orbit: "SustainedOrbit", maps: "tuple[SectionMap, ...]", directions: Array) -> Array:
    """Return D (k, N, m): where flights between sections come to for plants changed along `directions` (m, p).

    By central differences of Runge-Kutta flights under the orbit's input.
    """
    k, m, duration = len(maps), len(directions), maps[0].duration
    count = max(int(np.ceil(duration / _STEP)), 1)
    step = duration / count
    function = orbit.equations.discrete_step(step)
    plain = function.factory("plain", function.name_in(), [function.name_out(0)]).map(2 * m * k)
    change = _DIFFERENCE * np.concatenate([directions, -directions])
    parameters = np.tile((orbit.parameters + change).T, (1, k))
    states = np.repeat(np.array([a.start.state for a in maps]), 2 * m, axis=0).T
    begins = np.array([a.start.time for a in maps])
    for i in range(count):
        inputs = np.repeat(orbit.input(begins + (i + 0.5) * step), 2 * m)[None, :]
        states = np.array(plain(states, inputs, parameters))
    flown = states.T.reshape(k, 2, m, -1)
    apart = (flown[:, 0] - flown[:, 1]) / (2 * _DIFFERENCE)
    return np.array([a.end.projection @ apart[j].T for j, a in enumerate(maps)])


def learning(
    orbit: "SustainedOrbit",
    maps: "tuple[SectionMap, ...]",
    gains: Array,
    *,
    weights: Array,
    effort: float,
    share: float,
) -> Learning:
    """Return what the sections teach about parameters of which each may be off by `share`; gains of `section_gains`.

    Raises:
        GoalMissed: the shifts do not settle.
    """
    directions = parameter_directions(orbit.equations, orbit.parameters)
    # A parameter that is zero has no relative error.
    directions = directions[np.abs(directions).sum(1) > 0]
    d = sensitivities(orbit, maps, directions)
    n, m = d.shape[1] - 2, len(directions)
    spread = np.array([ANGLE_ERROR**2] * (n // 2) + [RATE_ERROR**2] * (n // 2))
    noise = []
    for here in maps:
        before, after = here.matrix[:n, :n], here.end.projection[:n, :n]
        # The smallest of them keeps the direction along the orbit, which the section leaves out, from being singular.
        noise.append((before * spread) @ before.T + (after * spread) @ after.T + ANGLE_ERROR**2 * np.eye(n))
    shifts = disturbance_shifts(maps, gains, d, weights=weights, effort=effort)
    return Learning(d[:, :n], np.array(noise), shifts, share**2 * np.eye(m))


def disturbance_shifts(
    maps: "tuple[SectionMap, ...]", gains: Array, disturbances: Array, *, weights: Array, effort: float
) -> Array:
    """Return s (k, m): how much less to pulse for each unit of the known periodic disturbances D (k, N, m).

    Raises:
        GoalMissed: they do not settle.
    """
    matrices, responses = _arrays(maps)
    count, size, kinds = disturbances.shape
    costs = [np.diag(weights)] * (count + 1)
    g = np.zeros((size, kinds))
    before = np.full((count, kinds), np.inf)
    shifts = np.zeros((count, kinds))
    for _ in range(_MOST_PERIODS):
        costs[count] = costs[0]
        for j in range(count - 1, -1, -1):
            a, b = matrices[j], responses[j]
            _, costs[j] = riccati_gains(a[None], b[None], weights=weights, effort=effort, terminal=costs[j + 1])
            v = costs[j + 1] @ disturbances[j] + g
            shifts[j] = b @ v / (effort + b @ costs[j + 1] @ b)
            g = (a - np.outer(b, gains[j])).T @ v
        if np.abs(shifts - before).max() <= _SETTLED * max(np.abs(shifts).max(), 1e-300):
            return shifts
        before = shifts.copy()
    raise GoalMissed(
        "the pulses for a plant that differs from the model did not settle; take more sections in a period"
    )


def _arrays(maps: "tuple[SectionMap, ...]") -> tuple[Array, Array]:
    return np.array([m.matrix for m in maps]), np.array([m.response for m in maps])
