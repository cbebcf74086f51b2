"""The closed loop of many simulated runs in lockstep.

One call computes a tick of all runs. A run that would brake, fly back or resume elsewhere leaves the others.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.tick_parts import Outcome, Report
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import Cause
from dpcontrol.logs import Event, Stretch
from dpcontrol.loop.bench import BenchDraw
from dpcontrol.loop.own import LARGEST, wrong_command
from dpcontrol.loop.recovery import Departures
from dpcontrol.loop.result import BatchRun, JudgedTicks, ended
from dpcontrol.loop.simulated import BatchBench
from dpcontrol.loop.ticker import Ticker


class Lockstep:
    """The closed loop of S runs that advance tick by tick, which is faster than one run after another.

    Args:
        ticker: controller and estimator of all runs.
        bench: their simulated benches.
        draws: random draws, one for each run.
        departures: finds the runs in which a recovery would act. These end at that tick, since they must be run alone.
    """

    def __init__(
        self, ticker: Ticker, bench: BatchBench, draws: Sequence[BenchDraw], departures: Departures | None = None
    ) -> None:
        """Begin with all runs alive.

        `_alive` (S,) is True for runs that have not ended, and `_over` is True once all have. `_counts` has the ticks
        of each run until its end, `_stopped_at` the tick at which its cart was stopped, and `_ends` the event of its
        end. `_departed` (S,) is True for runs that ended because a recovery would act.
        """
        self._ticker, self._bench, self._runs, self._departures = ticker, bench, len(draws), departures
        self._period, self._arms = ticker.program.period, ticker.program.model.arms
        noises = [draw.drawn("rate_noise") for draw in draws if "rate_noise" in draw.streams]
        self._rate_noise = np.stack(noises, axis=2) if noises else None
        self._alive, self._over = np.ones(self._runs, dtype=bool), False
        self._counts, self._stopped_at = [ticker.count] * self._runs, [ticker.count] * self._runs
        self._ends = [ended(Cause.FINISHED)] * self._runs
        self._departed = np.zeros(self._runs, dtype=bool)

    def run(self) -> list[BatchRun]:
        """Run to the last tick, or until every run has ended, and return the runs in the order of the draws."""
        ticker, bench, noise = self._ticker, self._bench, self._rate_noise
        rows = JudgedTicks(ticker.count, self._runs, self._arms)
        with np.errstate(all="ignore"):
            for k in range(ticker.count):
                reading = bench.read()
                report = ticker(k, reading, None if noise is None else noise[k])
                bench.command(report.command[0])
                rows.take(k, report, bench.truth)
                if (failed_lanes := bench.failed) is not None:
                    self._end(failed_lanes, k, ended(Cause.PLANT_FAILED, {"time": k * self._period}))
                for commands in report.own:
                    self._check(k, commands)
                if np.add.reduce(report.notable[0]):
                    self._handle_outcomes(k, report, rows)
                    for lane in np.flatnonzero(report.done[0] * self._alive).tolist():
                        self._end([lane], k + 1, self._ends[lane])
                for lane, fault in bench.faults.items():
                    if self._ends[lane].name != fault.name:
                        self._end([lane], k + 1, fault)
                if self._departures is not None:
                    self._depart(self._departures.lanes(k, report, ticker), k)
                if self._over:
                    break
        references = ticker.references
        angles = references[:, : self._arms, None] if references.ndim == 2 else references
        runs = [
            rows.run(
                lane, self._counts[lane], angles[:, :, lane % angles.shape[2]], still_from=self._stopped_at[lane],
                period=self._period, end=self._ends[lane],
            )
            for lane in range(self._runs)
        ]  # fmt: skip
        if self._departures is not None:
            runs = [
                replace(run, stretches=(Stretch(0, len(run.times), 0.0),), departed=has_departed)
                for run, has_departed in zip(runs, self._departed.tolist(), strict=True)
            ]
        return [
            replace(run, hardest=float(acceleration)) for run, acceleration in zip(runs, bench.hardest, strict=True)
        ]

    def _depart(self, lanes: NDArray[np.bool_], k: int) -> None:
        """End runs in which a recovery would act at tick k.

        `lanes` (S,) is True for these runs. Their results are marked as departed, so that the caller runs them alone.
        """
        departing = lanes & self._alive
        if departing.any():
            self._departed |= departing
            self._end(departing, k + 1, self._ends[0])

    def _check(self, k: int, commands: Array) -> None:
        """End runs whose symbolic law returned an invalid command at tick k.

        `commands` (S,) are the law's outputs, m/s²; a user wrote the law, so they may be infinite or absurd.
        """
        for lane in np.flatnonzero(~(np.abs(commands) <= LARGEST)).tolist():
            message = f"{wrong_command(self._ticker.kind, commands.item(lane))}, at t = {k * self._period:.3f} s"
            self._end([lane], k + 1, ended(Cause.OBJECT_FAILED, words=message))

    def _handle_outcomes(self, k: int, report: Report, rows: JudgedTicks) -> None:
        """Act on the outcomes of tick k: clear the NIS of a restarted filter, or stop the carts of runs that end.

        With departures, a run with any other outcome departs instead. `rows` stores the ticks that judge the runs.
        """
        outcomes = report.outcome[0] * self._alive
        for lane in np.flatnonzero(outcomes).tolist():
            outcome = Outcome(int(outcomes[lane]))
            if outcome is Outcome.RESTART:
                rows.without_nis(k, lane)
                continue
            if self._departures is not None:
                self._depart(np.arange(self._runs) == lane, k)
                continue
            self._ends[lane] = ended(Cause[outcome.name], self._ticker.figures(k, lane))
            self._stopped_at[lane] = k
            self._bench.stop([lane])

    def _end(self, lanes: Any, count: int, end: Event) -> None:
        """End the runs of `lanes`, indices or a mask (S,), after `count` ticks, unless they have ended before."""
        for lane in np.arange(self._runs)[lanes].tolist():
            if self._alive[lane]:
                self._ends[lane], self._counts[lane] = end, count
                self._alive[lane] = False
        self._over = not self._alive.any()
