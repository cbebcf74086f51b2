"""OGY control: an unstable orbit held by one pulse of bounded size from each section to the next.

    at the crossing of section j:   clock := phase of section j,   ξ = x̂ - x*,   p_j = -K_j ξ - s_j · δ̂,  |p_j| ≤ limit
    until section j+1:              u(s) = u*(clock) + p_j sin(π s / duration)

Classic OGY aims the pulse so that the unstable direction vanishes at the next section, p_j = -(f·A_j ξ)/(f·B_j), f the
left eigenvector of the map around the period at section j+1; nothing then holds the cart, and nothing makes up for a
plant that differs from the model. The other law is linear-quadratic over all sections, cart included, and learns (see
`section_law`). An error q grows to q λ in a period: at one section a period no pulse of either law is right.
Source: Ott, Grebogi & Yorke, Controlling chaos, Physical Review Letters 64 (1990), 1196.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.interface import Action, Mode
from dpcontrol.control.lqr import QuadraticWeights
from dpcontrol.control.model import SampledModel
from dpcontrol.control.periodic import check_orbit
from dpcontrol.control.phase import PhaseTable, phase_table
from dpcontrol.control.section_law import Learning, classic_gains, learning, section_gains
from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import Settings, setting

if TYPE_CHECKING:
    from dpcontrol.references.sustained import SustainedOrbit

Array = NDArray[np.float64]

_EARLY = 0.125
"""Share of a period by which a crossing may come before or after its time, and no more than half way to the next."""


@dataclass(frozen=True)
class ClassicOgySettings(Settings, table="controller"):
    """OGY as published: sections in a period, and the largest pulse in m/s²."""

    kind: str = "ogy-classic"
    sections: int = setting(16, least=1, most=1000)
    pulse_limit: float = setting(5.0, above=0, unit="m/s²")


@dataclass(frozen=True)
class OgySettings(QuadraticWeights):
    """OGY with linear-quadratic pulses: sections in a period, and the largest pulse in m/s².

    parameter_error: share by which the plant's inertial parameters may differ from the model's, friction five times
    as much; what a run tells about them corrects the pulses. Zero: it tells nothing.
    """

    position: float = 30.0
    velocity: float = 3.0
    effort: float = 0.3
    kind: str = "ogy"
    sections: int = setting(16, least=1, most=1000)
    pulse_limit: float = setting(5.0, above=0, unit="m/s²")
    parameter_error: float = setting(0.05, least=0, most=1)


@dataclass(frozen=True, eq=False)
class OgyController:
    """Sections (k) with their times (k,) s, states, normals and gains (k, N), and the pendulum's projections onto them
    (k, 2n, 2n); pulses of `duration` s.

    model: foresees where a flight between sections comes to; learning: None if nothing is to be learnt; ticks: for how
    long.
    """

    kind: str
    table: PhaseTable
    times: Array
    states: Array
    normals: Array
    projections: Array
    gains: Array
    duration: float
    pulse_limit: float
    model: SampledModel
    learning: Learning | None
    ticks: int
    status: str

    @property
    def first_state(self) -> Array:
        """Return the state (N,) from which it starts: the orbit at its first section, so that a pulse comes at once."""
        return self.states[0]

    @property
    def window(self) -> float:
        """Return by how many seconds a crossing may be off its time."""
        return min(self.duration / 2, _EARLY * self.table.period)

    def begin(self) -> "OgySession":
        """Return a fresh session for one run."""
        return OgySession(self)

    def begin_runs(self, count: int) -> "OgyRuns":
        """Return what answers `commands` for `count` runs, each with a clock and so with a reference of its own."""
        return OgyRuns(self, count)

    def join(self, tick: int, state: Array) -> "OgySession":
        """Return a session that starts at `tick` from `state` (N,), at the nearest phase and on its turns."""
        session = self.begin()
        session.resynchronise(tick, state)
        return session

    def distance(self, state: Array) -> float:
        """Return the scaled distance of the pendulum's `state` (N,) from the orbit, modulo turns."""
        return float(self.table.nearest(state)[1])


class OgySession:
    """The section crossed last, the time since, the pulse under way; and what was learnt about the plant."""

    def __init__(self, controller: OgyController) -> None:
        self._law = controller
        self._tick = 0
        self._lift = np.zeros(len(controller.first_state))
        # As if the last section had just been left behind: the first is crossed at once.
        self._section = len(controller.times) - 1
        self._elapsed = controller.duration
        self._pulse = 0.0
        self._sent = 0.0
        self._foreseen: Array | None = None
        if controller.learning is not None:
            self._guess = np.zeros(len(controller.learning.prior))
            self._covariance = controller.learning.prior
        self.crossings = 0

    @property
    def time(self) -> float:
        """Return the time on the orbit's clock in s."""
        return (float(self._law.times[self._section]) + self._elapsed) % self._law.table.period

    @property
    def orbit_period(self) -> float:
        """Return the orbit's period in s."""
        return self._law.table.period

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return what to do in the period from `tick` at `state` (N,)."""
        law, event = self._law, ""
        period = law.model.period
        passed = tick - self._tick
        self._elapsed += passed * period
        self._tick = tick
        x = state - self._lift
        if self._foreseen is not None:
            self._foreseen = law.model.step(self._foreseen, self._sent) if passed == 1 else None
        if self._elapsed > law.duration - law.window:
            ahead = self._section + 1 if self._section + 1 < len(law.times) else 0
            late = float((x - law.states[ahead]).dot(law.normals[ahead]))
            if late >= 0.0:
                self._cross(ahead, min(late, law.window), x)
            elif self._elapsed > law.duration + law.window:
                event = f"section {ahead + 1} was not crossed: " + self.resynchronise(tick, state)
        clock = float(law.times[self._section]) + self._elapsed
        middle = self._elapsed + period / 2
        feedback = 0.0
        if self._pulse and middle < law.duration:
            feedback = self._pulse * float(np.sin(np.pi * middle / law.duration))
        feedforward = law.table.input(clock + period / 2)
        self._sent = feedforward + feedback
        mode = Mode.PULSING if feedback else Mode.HOLDING
        return Action(feedforward, feedback, law.table.state(clock) + self._lift, mode, event)

    def _cross(self, section: int, late: float, x: Array) -> None:
        law = self._law
        if law.learning is not None and self._foreseen is not None:
            n = len(x) - 2
            surprise = law.projections[section].dot(x[:n] - self._foreseen[:n])
            self._guess, self._covariance = law.learning.updated(self._section, self._guess, self._covariance, surprise)
        self._section, self._elapsed, self._foreseen = section, late, x
        away = x - law.table.state(float(law.times[section]) + late)
        pulse = -float(law.gains[section].dot(away))
        if law.learning is not None:
            pulse -= float(law.learning.shifts[section].dot(self._guess))
        self._pulse = min(max(pulse, -law.pulse_limit), law.pulse_limit)
        self.crossings += 1

    def resynchronise(self, tick: int, state: Array) -> str:
        """Move the clock to the phase nearest to `state` (N,); say by how much. The next crossing starts a pulse."""
        law = self._law
        expected = self.time + (tick - self._tick) * law.model.period
        time, _, turns = law.table.nearest(state)
        since = np.mod(float(time) - law.times, law.table.period)
        self._section = int(np.argmin(since))
        self._elapsed, self._tick, self._pulse = float(since[self._section]), tick, 0.0
        self._lift = np.concatenate([turns, np.zeros(len(state) - len(turns))])
        self._foreseen = None
        half = law.table.period / 2
        return f"clock of the orbit moved by {(float(time) - expected + half) % (2 * half) - half:+.4f} s"


class OgyRuns:
    """`OgySession`'s arithmetic for `count` runs in lockstep, all from the first state and at every tick of the loop.

    Runs cross their sections at different ticks, so that each has a clock of its own.
    """

    def __init__(self, controller: OgyController, count: int) -> None:
        self._law = controller
        self._tick = 0
        self._lift = np.zeros((count, len(controller.first_state)))
        self._section = np.full(count, len(controller.times) - 1)
        self._elapsed = np.full(count, controller.duration)
        self._pulse, self._sent = np.zeros(count), np.zeros(count)
        self._foreseen = np.zeros((count, len(controller.first_state)))
        self._flying = np.zeros(count, dtype=bool)
        if controller.learning is not None:
            self._guess = np.zeros((count, len(controller.learning.prior)))
            self._covariance = np.tile(controller.learning.prior, (count, 1, 1))
            self._prepare(count)
        self.missed = np.zeros(count, dtype=int)
        """How often a run did not cross the section it came from."""
        self.cut = np.zeros(count, dtype=int)
        """How many of a run's pulses were cut at the limit."""

    def _prepare(self, count: int) -> None:
        model = self._law.model
        function = model.equations.discrete_step(model.period)
        names = function.name_in()
        self._step = Compiled(function.factory("plain", names, [function.name_out(0)]))
        self._slices = [self._step.slices[name] for name in names]
        self._inputs = np.zeros((self._step.size_in, count))
        self._inputs[self._slices[2]] = model.parameters[:, None]

    def commands(self, tick: int, states: Array, extras: Array | None = None) -> tuple[Array, Array, Array]:
        """Return feedforwards (S,), feedbacks (S,) in m/s² and references (N, S) for `states` (N, S) at `tick`."""
        law = self._law
        period = law.model.period
        passed = tick - self._tick
        self._elapsed += passed * period
        self._tick = tick
        x = states.T - self._lift
        if law.learning is not None and passed == 1:
            self._inputs[self._slices[0]], self._inputs[self._slices[1]] = self._foreseen.T, self._sent
            self._foreseen = self._step(self._inputs, np.empty(states.shape)).T
        elif passed:
            self._flying[:] = False
        ahead = (self._section + 1) % len(law.times)
        late = ((x - law.states[ahead]) * law.normals[ahead]).sum(1)
        near = self._elapsed > law.duration - law.window
        crossing = np.flatnonzero(near & (late >= 0.0))
        if len(crossing):
            self._cross(crossing, ahead[crossing], np.minimum(late[crossing], law.window), x[crossing])
        missed = np.flatnonzero(near & (late < 0.0) & (self._elapsed > law.duration + law.window))
        if len(missed):
            self._resynchronise(missed, states[:, missed].T)
        clock = law.times[self._section] + self._elapsed
        middle = self._elapsed + period / 2
        feedback = np.where(middle < law.duration, self._pulse * np.sin(np.pi * middle / law.duration), 0.0)
        table = law.table
        entries = np.rint(np.mod(clock + period / 2, table.period) / table.step).astype(int)
        feedforward = table.inputs[entries]
        self._sent = feedforward + feedback
        return feedforward, feedback, (table.states_at(clock) + self._lift).T

    def _cross(self, runs: NDArray[np.intp], section: NDArray[np.intp], late: Array, x: Array) -> None:
        law = self._law
        if law.learning is not None:
            taught = self._flying[runs]
            who, n = runs[taught], x.shape[1] - 2
            away = (x[taught] - self._foreseen[who])[:, :n]
            surprise = (law.projections[section[taught]] @ away[..., None])[..., 0]
            self._guess[who], self._covariance[who] = law.learning.updated(
                self._section[who], self._guess[who], self._covariance[who], surprise
            )
        self._section[runs], self._elapsed[runs] = section, late
        self._foreseen[runs], self._flying[runs] = x, True
        pulse = -(law.gains[section] * (x - law.table.states_at(law.times[section] + late))).sum(1)
        if law.learning is not None:
            pulse -= (law.learning.shifts[section] * self._guess[runs]).sum(1)
        self._pulse[runs] = np.clip(pulse, -law.pulse_limit, law.pulse_limit)
        self.cut[runs] += np.abs(pulse) > law.pulse_limit

    def _resynchronise(self, runs: NDArray[np.intp], states: Array) -> None:
        law = self._law
        times, _, turns = law.table.nearest(states)
        since = np.mod(times[:, None] - law.times, law.table.period)
        self._section[runs] = np.argmin(since, axis=1)
        self._elapsed[runs] = since.min(1)
        self._pulse[runs], self._flying[runs] = 0.0, False
        self._lift[runs, : turns.shape[1]] = turns
        self.missed[runs] += 1


def ogy_controller(
    orbit: "SustainedOrbit", model: SampledModel, settings: OgySettings | ClassicOgySettings, *, seconds: float
) -> OgyController:
    """Return the controller that holds `orbit` for `seconds` by pulses.

    Raises:
        InputError: the orbit did not converge or is of other arms, or its sections come faster than every second tick.
        GoalMissed: the section maps cannot be stabilised.
    """
    check_orbit(orbit, model)
    duration = orbit.period / settings.sections
    if duration < 2 * model.period:
        raise InputError(
            f"controller: sections = {settings.sections}: a pulse would last {duration:.2g} s, less than two ticks of "
            f"{model.period:g} s; take at most {int(orbit.period / (2 * model.period))}"
        )
    maps = orbit.section_maps(settings.sections)
    learnt = None
    if isinstance(settings, ClassicOgySettings):
        gains = classic_gains(maps)
    else:
        # The square of a half-sine of height 1 is a half on average.
        weights, effort = settings.weights(model.arms, duration)
        gains = section_gains(maps, weights=weights, effort=effort / 2)
        if settings.parameter_error:
            learnt = learning(orbit, maps, gains, weights=weights, effort=effort / 2, share=settings.parameter_error)
    n = 2 * model.arms
    return OgyController(
        kind=settings.kind,
        table=phase_table(orbit),
        times=np.array([m.start.time for m in maps]),
        states=np.array([m.start.state for m in maps]),
        normals=np.array([m.start.normal for m in maps]),
        projections=np.array([m.start.projection[:n, :n] for m in maps]),
        gains=gains,
        duration=duration,
        pulse_limit=settings.pulse_limit,
        model=model,
        learning=learnt,
        ticks=max(round(seconds / model.period), 1),
        status=f"{settings.sections} sections in a period of {orbit.period:.4g} s",
    )
