"""Following a reference by phase: the clock goes on with time and is corrected to the phase nearest to the state.

    c := c + 1 + lateness,    lateness = (x̂ - x*(c))·n(c),    n = D⁻² ẋ* / (|D⁻¹ ẋ*|² + ε²)      in ticks

D: the pendulum's scale; the cart is left out, for where it stands does not tell the phase. ε: where the reference
stands still the clock goes on with time alone.
Source: Hauser & Hindman, Manoeuvre regulation from trajectory tracking, NOLCOS (1995), section 3.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.interface import Action, Mode
from dpcontrol.references.problem import ANGLE_SCALE, RATE_SCALE

Array = NDArray[np.float64]

STANDSTILL = 0.1
"""Scaled rate per second (π rad and 10 rad/s) below which the phase of a motion counts less and less."""
MOST = 0.5
"""Ticks by which the clock is moved at most, forth or back: it glides, whatever the estimate does."""


@dataclass(frozen=True, eq=False)
class PhaseController:
    """Feedforward (K,), gains (K, N), reference states (K+1, N) at ticks; normals n (K+1, N)."""

    kind: str
    reference_states: Array
    feedforward: Array
    gains: Array
    normals: Array
    status: str

    @property
    def first_state(self) -> Array:
        """Return the state (N,) from which it starts."""
        return self.reference_states[0]

    @property
    def ticks(self) -> int:
        """Return for how many periods it has something to do, if the clock went with time."""
        return len(self.feedforward)

    def begin(self) -> "PhaseSession":
        """Return a session for one run."""
        return PhaseSession(self)

    def begin_runs(self, count: int) -> "PhaseRuns":
        """Return what answers `commands` for `count` runs, each with a clock and so with a reference of its own."""
        return PhaseRuns(self, count)

    def join(self, tick: int, state: Array) -> "PhaseSession":
        """Return a session that starts at `tick` where the reference is nearest to `state` (N,), on the same turns."""
        return PhaseSession(self, tick=tick, place=self.nearest(state))

    def at(self, places: Array) -> Array:
        """Return reference states (…, N) at places (…) in ticks."""
        states = self.reference_states
        k = np.clip(places.astype(int), 0, len(states) - 2)
        share = np.clip(places - k, 0.0, 1.0)[..., None]
        return states[k] + share * (states[k + 1] - states[k])

    def nearest(self, state: Array) -> int:
        """Return the tick at which the pendulum's reference is nearest to `state` (N,)."""
        scale = _scale(len(state))
        away = (self.reference_states[:, : len(scale)] - state[: len(scale)]) / scale
        return int(np.argmin(np.square(away).sum(1)))


def phase_controller(kind: str, *, states: Array, feedforward: Array, gains: Array, period: float) -> PhaseController:
    """Return the controller for feedforward (K,), gains (K, N) and reference states (K+1, N), `period` s apart."""
    scale = _scale(states.shape[1])
    rates = np.gradient(states[:, : len(scale)], axis=0) / scale
    normals = np.zeros_like(states)
    normals[:, : len(scale)] = rates / scale / (np.square(rates).sum(1) + (STANDSTILL * period) ** 2)[:, None]
    text = f"gains for {len(gains)} ticks, by phase"
    return PhaseController(kind, states, feedforward, gains, normals, text)


def _scale(dimension: int) -> Array:
    arms = (dimension - 2) // 2
    return np.array([ANGLE_SCALE] * arms + [RATE_SCALE] * arms)


class PhaseRuns:
    """The clocks of `count` runs of one law, from the reference's tick `place` at the loop's `tick`."""

    def __init__(self, law: PhaseController, count: int, *, tick: int = 0, place: float = 0.0) -> None:
        self._law = law
        self._tick = tick
        self._places = np.full(count, float(place))

    def commands(self, tick: int, states: Array, extras: Array | None = None) -> tuple[Array, Array, Array]:
        """Return feedforwards (S,), feedbacks (S,) in m/s² and references (N, S) for `states` (N, S) at `tick`."""
        law, x, last = self._law, states.T, len(self._law.feedforward)
        self._places += max(tick - self._tick, 0)
        self._tick = tick
        k = np.clip(np.rint(self._places).astype(int), 0, last)
        late = ((x - law.at(self._places)) * law.normals[k]).sum(1)
        self._places += np.clip(late, -MOST, MOST)
        wanted = law.at(self._places)
        j = np.clip(np.rint(self._places).astype(int), 0, last - 1)
        return law.feedforward[j], (law.gains[j] * (wanted - x)).sum(1), wanted.T


class PhaseSession:
    """One run of a law: from the reference's tick `place` at the loop's `tick`."""

    def __init__(self, law: PhaseController, *, tick: int = 0, place: float = 0.0) -> None:
        self._law = law
        self._tick, self._place = tick, place

    @property
    def place(self) -> float:
        """Return the tick of the reference at which the clock stands."""
        return self._place

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return what to do in the period from `tick` at `state` (N,)."""
        law, last = self._law, len(self._law.feedforward)
        self._place += max(tick - self._tick, 0)
        self._tick = tick
        k = min(max(round(self._place), 0), last)
        late = float(law.normals[k].dot(state - self._at(self._place)))
        self._place += min(max(late, -MOST), MOST)
        wanted = self._at(self._place)
        j = min(max(round(self._place), 0), last - 1)
        feedback = float(law.gains[j].dot(wanted - state))
        return Action(float(law.feedforward[j]), feedback, wanted, Mode.TRACKING)

    def _at(self, place: float) -> Array:
        states = self._law.reference_states
        k = min(max(int(place), 0), len(states) - 2)
        share = min(max(place - k, 0.0), 1.0)
        return states[k] + share * (states[k + 1] - states[k])

    def resynchronise(self, tick: int, state: Array) -> str:
        """Move the clock to the phase nearest to `state` (N,); say by how much."""
        expected = self._place + tick - self._tick
        self._tick, self._place = tick, float(self._law.nearest(state))
        return f"clock of the reference moved by {self._place - expected:+.0f} ticks"
