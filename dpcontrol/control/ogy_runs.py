"""OGY of many runs at once: `OgySession`'s arithmetic on arrays, run by run, for campaigns.

Runs cross their sections at different ticks, so that each has a clock of its own.
"""

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.ogy import OgyController
from dpcontrol.dynamics.compiled import Compiled

Array = NDArray[np.float64]


class OgyRuns:
    """`count` sessions of one controller in lockstep, all from its first state and at the loop's ticks one by one."""

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
