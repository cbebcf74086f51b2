"""Margins of the loop: limits of gain, further delay and further lag, by simulation.

The whole loop, with filter and supervisor, is simulated along its reference from a small initial error. Arms and
sensors match the model, dry friction included. The runs of a batch differ in their drive:

    mean of period k: through a lag τ, g · (command a delay D + d ago)

For each margin, a series of values is tried, starting from the nominal one. The limit lies before the first value that
loses the reference. A second series refines it. The growth of small errors does not tell this limit: dry friction makes
the loop oscillate with an amplitude that rises as the gain falls, and a flight may pass through a stretch in which
errors grow.

Source: Åström & Murray, Feedback Systems (2008), section 9.3.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dpcontrol.control.interface import GainSchedule, SampledModel
from dpcontrol.control.tick import TickProgram
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.document import Documented
from dpcontrol.references.problem import Limits

FIRST_ERROR = 2e-3
"""Bound of the initial error of each angle, rad; large compared with a count, small compared with tolerable errors."""
_STARTS = 8
"""Runs of each drive, with random initial errors."""
ASTRAY, _PHASE = 0.2, 0.1
"""Maximum distance from the reference over the last tenth, rad, and maximum time offset, s; as in the score."""
SHAKEN = 0.5
"""Maximum rms difference between acceleration and feedforward over a tenth, as a share of the maximum acceleration.

Above it, only limits bound a swing.
"""
_TRIED = 16
"""Number of values per series."""
_LOST, _EVERY = 1.5, 10
"""Resolution of the search in rad and ticks."""
FARTHEST = {"gain_low": 1 / 64, "gain_high": 64.0, "delay": 0.128, "lag": 0.512}
_NEAREST = {"gain_low": 1.0, "gain_high": 1.0, "delay": 1e-3, "lag": 1e-3}


@dataclass(frozen=True)
class Margins(Documented):
    """Gain, delay and lag margins of the loop along its reference.

    Delay and lag are those beyond the assumed ones.

    Attributes:
        limits: (limit, time of the loss just beyond it, s) by name: the factors gain_low and gain_high, delay (s) and
            lag (s). The time is NaN at the farthest value that is tried. If a run is lost even if the plant equals the
            model, gains are 1, and delay and lag 0.
    """

    limits: Mapping[str, tuple[float, float]]

    @property
    def status(self) -> str:
        """Sentence on the margins and the times of the losses."""
        delay, time = self.limits["delay"]
        if not delay and np.isfinite(time):
            return f"a run is lost after {time:.2f} s even if the plant equals the model"
        text = {}
        for name, (value, time) in self.limits.items():
            number = f"{value:.2g}" if name.startswith("gain") else f"{1e3 * value:.1f} ms"
            loss = f" (at {time:.1f} s)" if np.isfinite(time) else ""
            text[name] = f"{'' if loss or name == 'gain_low' else 'at least '}{number}{loss}"
        return (
            f"gain {text['gain_low']} to {text['gain_high']}, further delay {text['delay']}, further lag {text['lag']}"
        )

    def least(self) -> dict[str, tuple[float, float]]:
        """Return each margin by name, with the time of the loss just beyond it, s."""
        return dict(self.limits)

    def document(self) -> dict[str, Any]:
        """Return the output of `dpcontrol plan --margins --json`."""
        limits = {
            name: {"value": value, "time": time if np.isfinite(time) else None}
            for name, (value, time) in self.limits.items()
        }
        return {**limits, "status": self.status}


@dataclass(frozen=True, eq=False)
class NominalLoop:
    """A loop whose arms and drive match the model.

    Attributes:
        plant: plant with the drive's lag.
        program_of: returns a tick for a number of runs, initialised for the law.
        readings_of: returns the readings (n+1, S) of states (2n+2, S), rounded by the sensors.
        delay: delay, in periods.
        limits: the cart's limits.
    """

    plant: SampledModel
    program_of: Callable[[int], TickProgram]
    readings_of: Callable[[Array], Array]
    law: GainSchedule
    delay: float
    limits: Limits

    def lost_at(self, gain: Array, delay: Array, lag: Array) -> Array:
        """Return the times (S,), s, at which half of the runs with each of S changed drives are lost.

        Each drive is tried with several initial errors. The time is infinite if fewer than half are lost. A run is lost
        if it is stopped, if it leaves the track or the reference, or if the loop shakes the cart. In the last tenth,
        the motion must be near the reference, but may be early or late.

        The plant's inputs are state, acceleration of the cart and parameters, in columns of the runs.

        Args:
            gain: gains (S,).
            delay: further delays (S,), s.
            lag: further lags (S,), s.
        """
        gain, delay, lag = (np.repeat(values, _STARTS) for values in (gain, delay, lag))
        count, period, n = len(gain), self.plant.period, self.plant.arms
        rows, references = self.law.rows, self.law.references
        program, step = self.program_of(count), self.plant.machine
        lanes = program.lanes
        drive_values = (gain, self.delay + delay / period, np.maximum(self.plant.lag + lag, 1e-9))
        gains, delays, lags = (program.spread(values) for values in drive_values)
        whole = np.floor(delays + 1e-9).astype(int)
        fraction, lag_keeps = np.maximum(delays - whole, 0.0), np.exp(-period / lags)
        lag_share = lags / period * (1 - lag_keeps)
        first = np.repeat(references[0][:, None], lanes, axis=1)
        states, errors = first.copy(), np.random.default_rng(0).uniform(-FIRST_ERROR, FIRST_ERROR, (n, _STARTS))
        states[:n] += errors[:, np.arange(lanes) % _STARTS]
        inputs = np.concatenate(
            [states, np.zeros((1, lanes)), np.repeat(self.plant.parameters[:, None], lanes, axis=1)]
        )
        memory_length, lane_index, acceleration = int(whole.max()) + 2, np.arange(lanes), np.zeros(lanes)
        sent, lost, shaking = np.zeros((memory_length, lanes)), np.full(lanes, np.inf), np.zeros(lanes)
        for k, command in enumerate(self.law.queued):
            sent[k - len(self.law.queued)] = command
        last_tenth, tenth, time_offset = len(rows) * 9 // 10, max(len(rows) // 10, 1), round(_PHASE / period)
        limit = self.limits.acceleration
        for k, row in enumerate(rows):
            program.take(self.readings_of(states), None, 0, None)
            program.row[:] = row[:, None]
            program.tick()
            report = program.report
            command = sent[k % memory_length] = report.command[0]
            acting = gains * (
                (1 - fraction) * sent[(k - whole) % memory_length, lane_index]
                + fraction * sent[(k - whole - 1) % memory_length, lane_index]
            )
            acting, intended = (np.clip(value, -limit, limit) for value in (acting, gains * command))
            inputs[len(states)] = acting + lag_share * (acceleration - acting)
            acceleration = lag_keeps * acceleration + (1 - lag_keeps) * acting
            states = inputs[: len(states)] = step(inputs, np.empty(states.shape))
            nearby = (
                references[k + 1 : k + 2, :n]
                if k < last_tenth
                else references[k - time_offset : k + time_offset : _EVERY, :n]
            )
            distance = np.abs(states[:n] - nearby[:, :, None]).max(axis=1).min(axis=0, initial=np.inf)
            follows = (distance < (_LOST if k < last_tenth else ASTRAY)) & (
                np.abs(states[2 * n]) < self.limits.position
            )
            shaking += (intended - (command - report.feedback[0])) ** 2 / tenth
            unharmed = follows & (report.stop[0] == 0)
            if (k + 1) % tenth == 0:
                unharmed &= (shaking < (SHAKEN * limit) ** 2) | (k < tenth)
                shaking[:] = 0.0
            lost[~unharmed & np.isinf(lost)] = (k + 1) * period
            failed = np.isfinite(lost)
            if failed.all():
                break
            # Lost runs stay at rest to prevent overflow.
            states = inputs[: len(states)] = np.where(failed, first, states)
        # The time at which the fourth of eight runs is lost, infinite if fewer are.
        return np.sort(lost[:count].reshape(-1, _STARTS), axis=1)[:, (_STARTS - 1) // 2]


def margins_of(loop: NominalLoop) -> Margins:
    """Return the margins of gain, delay and lag: the last values before those that lose the reference.

    Args:
        loop: loop whose arms and drive match the model.
    """
    (nominal,) = loop.lost_at(np.ones(1), np.zeros(1), np.zeros(1))
    nearest: dict[str, float] = dict(_NEAREST)
    farthest, loss_times = dict(FARTHEST), dict.fromkeys(FARTHEST, np.nan)
    if np.isfinite(nominal):
        return Margins({name: (1.0 if name.startswith("gain") else 0.0, float(nominal)) for name in farthest})
    margins = {name: 1.0 if name.startswith("gain") else 0.0 for name in farthest}
    for _ in range(2):
        series = {name: np.geomspace(nearest[name], farthest[name], _TRIED + 1) for name in farthest}
        # The nominal gain is known to be stable, but the shortest delay is not.
        values_by_name = {
            name: steps[1:] if margins[name] == nearest[name] else steps for name, steps in series.items()
        }
        lost = _of_all(loop, values_by_name)
        for name, values in values_by_name.items():
            first_loss = int(np.argmax(np.isfinite(lost[name]))) if np.isfinite(lost[name]).any() else len(values)
            if first_loss:
                margins[name] = nearest[name] = float(values[first_loss - 1])
            if first_loss < len(values):
                farthest[name], loss_times[name] = float(values[first_loss]), float(lost[name][first_loss])
    return Margins({name: (margins[name], float(loss_times[name])) for name in farthest})


def _of_all(loop: NominalLoop, tried: dict[str, Array]) -> dict[str, Array]:
    """Return the times of loss, s, for all values (V,) of each margin, from one batch of all runs.

    `tried`: values by the name of their margin. The other numbers of the drive are nominal.
    """
    drives: dict[str, Array] = {}
    ends = np.cumsum([0, *(len(values) for values in tried.values())])
    for key, usual in (("gain", 1.0), ("delay", 0.0), ("lag", 0.0)):
        drives[key] = np.concatenate(
            [values if name.startswith(key) else np.full(len(values), usual) for name, values in tried.items()]
        )
    all_losses = loop.lost_at(**drives)
    return {name: all_losses[ends[k] : ends[k + 1]] for k, name in enumerate(tried)}
