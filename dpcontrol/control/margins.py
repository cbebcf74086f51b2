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
        said = {}
        for name, (value, time) in self.limits.items():
            text = f"{value:.2g}" if name.startswith("gain") else f"{1e3 * value:.1f} ms"
            lost = f" (at {time:.1f} s)" if np.isfinite(time) else ""
            said[name] = f"{'' if lost or name == 'gain_low' else 'at least '}{text}{lost}"
        return (
            f"gain {said['gain_low']} to {said['gain_high']}, further delay {said['delay']}, further lag {said['lag']}"
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
        """Return the times at which half of the runs are lost, s.

        They are infinite if fewer are lost.

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
        changed = (gain, self.delay + delay / period, np.maximum(self.plant.lag + lag, 1e-9))
        g, d, tau = (program.spread(values) for values in changed)
        whole = np.floor(d + 1e-9).astype(int)
        part, kept = np.maximum(d - whole, 0.0), np.exp(-period / tau)
        mean = tau / period * (1 - kept)
        first = np.repeat(references[0][:, None], lanes, axis=1)
        x, errors = first.copy(), np.random.default_rng(0).uniform(-FIRST_ERROR, FIRST_ERROR, (n, _STARTS))
        x[:n] += errors[:, np.arange(lanes) % _STARTS]
        inputs = np.concatenate([x, np.zeros((1, lanes)), np.repeat(self.plant.parameters[:, None], lanes, axis=1)])
        slots, each, lagging = int(whole.max()) + 2, np.arange(lanes), np.zeros(lanes)
        sent, lost, swing = np.zeros((slots, lanes)), np.full(lanes, np.inf), np.zeros(lanes)
        for k, command in enumerate(self.law.queued):
            sent[k - len(self.law.queued)] = command
        tail, tenth, around = len(rows) * 9 // 10, max(len(rows) // 10, 1), round(_PHASE / period)
        most = self.limits.acceleration
        for k, row in enumerate(rows):
            program.take(self.readings_of(x), None, 0, None)
            program.row[:] = row[:, None]
            program.tick()
            report = program.report
            command = sent[k % slots] = report.command[0]
            acting = g * ((1 - part) * sent[(k - whole) % slots, each] + part * sent[(k - whole - 1) % slots, each])
            acting, wanted = (np.clip(a, -most, most) for a in (acting, g * command))
            inputs[len(x)] = acting + mean * (lagging - acting)
            lagging = kept * lagging + (1 - kept) * acting
            x = inputs[: len(x)] = step(inputs, np.empty(x.shape))
            path = references[k + 1 : k + 2, :n] if k < tail else references[k - around : k + around : _EVERY, :n]
            away = np.abs(x[:n] - path[:, :, None]).max(axis=1).min(axis=0, initial=np.inf)
            near = (away < (_LOST if k < tail else ASTRAY)) & (np.abs(x[2 * n]) < self.limits.position)
            swing += (wanted - (command - report.feedback[0])) ** 2 / tenth
            kept_up = near & (report.stop[0] == 0)
            if (k + 1) % tenth == 0:
                kept_up &= (swing < (SHAKEN * most) ** 2) | (k < tenth)
                swing[:] = 0.0
            lost[~kept_up & np.isinf(lost)] = (k + 1) * period
            gone = np.isfinite(lost)
            if gone.all():
                break
            # Lost runs stay at rest to prevent overflow.
            x = inputs[: len(x)] = np.where(gone, first, x)
        return np.sort(lost[:count].reshape(-1, _STARTS), axis=1)[:, (_STARTS - 1) // 2]


def margins_of(loop: NominalLoop) -> Margins:
    """Return the margins of gain, delay and lag.

    Args:
        loop: loop whose arms and drive match the model.
    """
    (nominal,) = loop.lost_at(np.ones(1), np.zeros(1), np.zeros(1))
    near: dict[str, float] = dict(_NEAREST)
    far, when = dict(FARTHEST), dict.fromkeys(FARTHEST, np.nan)
    if np.isfinite(nominal):
        return Margins({name: (1.0 if name.startswith("gain") else 0.0, float(nominal)) for name in far})
    kept = {name: 1.0 if name.startswith("gain") else 0.0 for name in far}
    for _ in range(2):
        rows = {name: np.geomspace(near[name], far[name], _TRIED + 1) for name in far}
        # The nominal gain is known to be stable, but the shortest delay is not.
        tried = {name: row[1:] if kept[name] == near[name] else row for name, row in rows.items()}
        lost = _of_all(loop, tried)
        for name, values in tried.items():
            first = int(np.argmax(np.isfinite(lost[name]))) if np.isfinite(lost[name]).any() else len(values)
            if first:
                kept[name] = near[name] = float(values[first - 1])
            if first < len(values):
                far[name], when[name] = float(values[first]), float(lost[name][first])
    return Margins({name: (kept[name], float(when[name])) for name in far})


def _of_all(loop: NominalLoop, tried: dict[str, Array]) -> dict[str, Array]:
    """Return the times of loss by margin.

    One batch computes all runs.
    """
    drives: dict[str, Array] = {}
    sizes = np.cumsum([0, *(len(values) for values in tried.values())])
    for key, usual in (("gain", 1.0), ("delay", 0.0), ("lag", 0.0)):
        drives[key] = np.concatenate(
            [values if name.startswith(key) else np.full(len(values), usual) for name, values in tried.items()]
        )
    lost = loop.lost_at(**drives)
    return {name: lost[sizes[k] : sizes[k + 1]] for k, name in enumerate(tried)}
