"""Estimates and true values in closed-loop runs of many seeds, sampled at given times.

True values of the extras follow from the drawn plants. Shares are those of the base parameters over M12 with friction.
The zero of an angle is the sum of its encoder's zero and those before it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.interface import MANY, Controller
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.lockstep import Lockstep
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.result import BatchRun, Ending
from dpcontrol.loop.simulated import BatchBench
from dpcontrol.references.reference import Reference

Array = NDArray[np.float64]


def true_extras(names: Sequence[str], plant: ArmChainParameters, model: ArmChainParameters, zeros: Array) -> Array:
    """Return the true constants (E,) of the extras, NaN for decaying ones."""
    n = model.count
    joints = range(1, n + 1)
    order = [f"M{i}{j}" for i in joints for j in range(i, n + 1)]
    order += [f"{kind}{i}" for kind in ("G", "S", "friction_") for i in joints]
    unit = order.index("M12" if n > 1 else "M11")
    true, assumed = plant.viscous_only().base(), model.viscous_only().base()
    share = dict(zip(order, (true / true[unit]) / (assumed / assumed[unit]) - 1, strict=False))
    dry = [np.array(arms.coulomb or (0.0,) * n) / base[unit] for arms, base in ((plant, true), (model, assumed))]
    for i in joints:
        told = dry[1][i - 1] * (1 + share[f"friction_{i}"])
        share[f"dry_{i}"] = (dry[0][i - 1] - told) * assumed[unit] / assumed[order.index(f"G{i}")]
    share |= {f"zero_{i}": zero for i, zero in zip(joints, np.cumsum(zeros), strict=True)}
    return np.array([share.get(name, np.nan) for name in names])


@dataclass(frozen=True, eq=False)
class Beliefs:
    """S runs sampled at T times: truth, estimate and sigma (T, N+E, S) of state and extras; NIS (T', S) of all ticks.

    alive (T, S): which runs had not ended; names: of the state's entries and the extras.
    """

    times: Array
    names: tuple[str, ...]
    truth: Array
    estimate: Array
    sigma: Array
    alive: NDArray[np.bool_]
    nis: Array
    runs: list[BatchRun]

    def of(self, *kinds: str) -> list[int]:
        """Return the indices of quantities by prefix of their names."""
        return [i for i, name in enumerate(self.names) if name.startswith(kinds)]

    def error(self, which: Sequence[int]) -> Array:
        """Return estimate minus truth (T, len(which), S), NaN after the end of a run."""
        out = (self.estimate - self.truth)[:, which]
        return np.where(self.alive[:, None], out, np.nan)

    def over_sigma(self, which: Sequence[int]) -> Array:
        """Return the rms over the runs of error over sigma (T, len(which))."""
        with np.errstate(invalid="ignore"):
            return np.sqrt(np.nanmean((self.error(which) / self.sigma[:, which]) ** 2, axis=2))


class _Recorder:
    """A ticker that also stores its reports at some ticks."""

    def __init__(self, ticker, bench: BatchBench, ticks: Sequence[int]) -> None:
        self._ticker, self._bench, self._ticks = ticker, bench, set(ticks)
        self.kept: list[tuple[Array, Array, Array]] = []
        self.nis: list[Array] = []

    def __getattr__(self, name: str):
        return getattr(self._ticker, name)

    def __call__(self, k, reading, rate_error=None):
        report = self._ticker(k, reading, rate_error)
        self.nis.append(report.nis[0].copy())
        if k in self._ticks:
            estimate = np.concatenate([report.state, report.extra])
            self.kept.append((self._bench.truth.copy(), estimate, report.sigmas.copy()))
        return report


def beliefs(
    reference: Reference,
    model: ArmChainParameters,
    *,
    settings: LoopSettings,
    controller: Controller,
    seeds: Sequence[int],
    times: Sequence[float],
) -> Beliefs:
    """Run the seeds in lockstep and sample them at `times` s (negative: before the end)."""
    period, count = 1 / settings.rate, controller.ticks + 1
    ticks = sorted({min(max(round((t if t >= 0 else count * period + t) / period), 0), count - 1) for t in times})
    limits = settings.limits(reference.limits)
    lanes = [*seeds, *[seeds[-1]] * (-len(seeds) % 8)]
    draws = [settings.draw(model, ticks=count, seed=seed) for seed in lanes]
    ticker = Assembly(reference, model, settings, law=controller).ticker(runs=len(lanes))
    start, queued = controller.first_state, list(ticker.queued)
    bench = BatchBench(draws, settings.bench, limits=limits, start=start, queued=queued, lanes=MANY)
    recorder = _Recorder(ticker, bench, ticks)
    runs = Lockstep(recorder, bench, draws).run()[: len(seeds)]
    n = model.count
    names = [f"angle_{i + 1}" for i in range(n)] + [f"rate_{i + 1}" for i in range(n)] + ["cart", "velocity"]
    names += ticker.extra_names
    extras = np.stack([true_extras(ticker.extra_names, d.plant.arms, model, d.zeros) for d in draws], axis=1)
    s = len(seeds)
    done = ticks[: len(recorder.kept)]
    truth = np.stack([np.concatenate([state, extras])[:, :s] for state, _, _ in recorder.kept])
    estimate = np.stack([one[:, :s] for _, one, _ in recorder.kept])
    sigma = np.stack([one[:, :s] for _, _, one in recorder.kept])
    ends = np.array([len(run.times) if run.ending is not Ending.FINISHED else count for run in runs])
    alive = np.array(done)[:, None] < ends
    return Beliefs(
        np.array(done) * period, tuple(names), truth, estimate, sigma, alive, np.array(recorder.nis)[:, :s],
        runs,
    )  # fmt: skip
