"""Supervisors and stuck sensors of many runs in lockstep: `Supervisor` and `StuckWatch` on arrays (S,), (n+1, S)."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dpcontrol.loop.control_loop import SETTLING
from dpcontrol.loop.loop import LoopSettings, loop_supervisor
from dpcontrol.loop.result import Ending
from dpcontrol.loop.supervisor import SAME, Outcome, StuckWatch, Supervisor
from dpcontrol.references.problem import Limits

Array = NDArray[np.float64]


class BatchStuck:
    """Watches the sensors of S runs; one `StuckWatch` holds the bounds and finds the words."""

    def __init__(self, arms: int, *, period: float, reaction: float, runs: int) -> None:
        self._one = one = StuckWatch(arms, period=period, reaction=reaction)
        shape = (arms + 1, runs)
        self._arms, self._period = arms, period
        self._still = np.array(one.still)[:, None]
        self._soonest = min(one.still)
        self._least, self._doubt = np.array(one.least)[:, None], np.array(one.doubt)[:, None]
        self._last, self._steps = np.full(shape, np.nan), np.full(shape, np.inf)
        self._same, self._begin, self._moved = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self._value, self._should, self._step = np.empty(shape), np.empty(shape), np.empty(shape)
        self._is_same, self._is_new = np.empty(shape, dtype=bool), np.empty(shape, dtype=bool)
        self._sent = np.zeros(runs)

    def seen(
        self, positions: Array, wanted: Array, sent: Array, nis: Array, *, judged: NDArray[np.bool_] | None = None
    ) -> Mapping[int, str]:
        """Return what is stuck by the number of the run.

        positions (n+1, S): absolute angles and the carts' positions; wanted (n, 1) or (n, S): the references' angles;
        sent (S,) m/s: the velocities that the carts were sent to; nis (S,): their means of late, for each position.
        judged (S,): which runs are asked about; all by default.
        """
        n, one = self._arms, self._one
        # In place, and one operation for each thing: this is a tenth of a tick's time.
        value, should, step, same, new = self._value, self._should, self._step, self._is_same, self._is_new
        self._sent += sent * self._period
        value[:] = positions
        value[1:n] -= positions[: n - 1]
        should[:n] = wanted
        should[1:n] -= wanted[: n - 1]
        should[n] = self._sent
        np.subtract(value, self._last, out=step)
        np.abs(step, out=step)
        np.less(step, SAME, out=same)
        np.logical_not(same, out=new)
        np.copyto(self._last, value, where=new)
        np.copyto(self._begin, should, where=new)
        np.fmin(self._steps, step, out=self._steps, where=new)
        should -= self._begin
        np.abs(should, out=should)
        np.maximum(self._moved, should, out=self._moved)
        self._moved *= same
        self._same += 1
        self._same *= same
        if np.maximum.reduce(self._same, axis=None) < self._soonest:
            return {}
        still = (self._same >= self._still) & (self._moved >= self._least) & ~(nis <= self._doubt)
        if judged is not None:
            still &= judged
        if not still.any():
            return {}
        out: dict[int, str] = {}
        for i, lane in zip(*np.nonzero(still), strict=True):
            if int(lane) not in out:
                words = one.sentence(
                    int(i), same=int(self._same[i, lane]), moved=float(self._moved[i, lane]),
                    step=float(self._steps[i, lane]),
                )  # fmt: skip
                if words:
                    out[int(lane)] = words
        return out


class BatchWatch:
    """The supervisors of S runs. A single one is asked, for its words, only where it has to step in."""

    def __init__(self, settings: LoopSettings, limits: Limits, *, runs: int) -> None:
        self._settings, self._limits, self._runs = settings, limits, runs
        self._period = 1 / settings.rate
        one = loop_supervisor(settings, limits)
        self._one: Supervisor = one
        self._error, self._nis = np.zeros(runs), np.zeros(runs)
        self._restarts = np.zeros(runs, dtype=int)
        self._stuck: BatchStuck | None = None
        self._alive = np.ones(runs, dtype=bool)
        self._going: NDArray[np.bool_] | None = None
        self._since = np.full(runs, np.inf)
        self.braking = np.zeros(runs, dtype=bool)
        """Which runs (S,) are being brought to rest."""
        self.any_braking = False
        self.counts = [2**62] * runs
        """Ticks of each run that has ended."""
        self.stopped_at = [2**62] * runs
        """Tick at which each run was stopped."""
        self.endings = [Ending.FINISHED] * runs
        self.reasons = ["came to the reference's end"] * runs

    @property
    def all_ended(self) -> bool:
        """Tell whether no run goes on."""
        return self._going is not None and not self._alive.any()

    def judge(
        self,
        k: int,
        *,
        error: Array,
        nis: Array,
        used: Array,
        position: Array,
        velocity: Array,
        sent: Array,
        readings: tuple[Array, Array],
        switch: NDArray[np.bool_],
        fault: NDArray[np.bool_] | None,
    ) -> tuple[NDArray[np.intp] | None, list[int] | None]:
        """Judge tick k; return which runs are to be stopped now and whose estimators are to be restarted.

        readings: positions (n+1, S) and the references' angles (n, 1) or (n, S).
        """
        one = self._one
        if fault is not None:
            self._fail(k, fault)
        mean_nis = self._nis + (nis / used - self._nis) * one.estimate_share
        mean_error = self._error + (error - self._error) * one.tracking_share
        positions, wanted = readings
        if self._stuck is None:
            self._stuck = BatchStuck(len(wanted), period=self._period, reaction=one.reaction, runs=self._runs)
        before = (self._error, self._nis)
        self._error, self._nis = mean_error, mean_nis
        # Those that are restarted in this tick have no NIS to doubt by.
        doubt = np.where(mean_nis <= one.settings.lost_estimate, mean_nis, 0.0)
        stuck = self._stuck.seen(positions, wanted, sent, doubt, judged=self._going)
        if not stuck and self._all_well(mean_nis, mean_error, position, velocity, sent, switch):
            return None, None
        bad = (
            ~(mean_nis <= one.settings.lost_estimate) | ~np.isfinite(error) | (mean_error > one.settings.lost_tracking)
        )
        bad |= np.maximum(one.stopping_point(position, velocity), one.stopping_point(position, sent)) >= one.travel
        bad |= switch
        bad[list(stuck)] = True
        if self._going is not None:
            bad &= self._going
        if not bad.any():
            return None, None
        stopped, restarted = [], []
        for lane in np.flatnonzero(bad):
            supervisor = loop_supervisor(self._settings, self._limits)
            supervisor.error, supervisor.nis = float(before[0][lane]), float(before[1][lane])
            supervisor.restarts = int(self._restarts[lane])
            now = k * self._period
            verdict = supervisor.judge(
                now, error=float(error[lane]), nis=float(nis[lane]), used=int(used[lane]),
                position=float(position[lane]), velocity=float(velocity[lane]), sent=float(sent[lane]),
            )  # fmt: skip
            self._nis[lane], self._restarts[lane] = supervisor.nis, supervisor.restarts
            outcome, ending, why = supervisor.overruled(
                verdict, now, stuck=stuck.get(int(lane), ""), switch=bool(switch[lane])
            )
            if outcome is Outcome.RESTART:
                restarted.append(int(lane))
            elif outcome is Outcome.STOP:
                stopped.append(lane)
                self.endings[lane], self.reasons[lane], self.stopped_at[lane] = ending, why, k
        if stopped:
            self.braking[stopped] = True
            self._since[stopped] = k * self._period
            self._note()
        return np.array(stopped, dtype=np.intp) if stopped else None, restarted or None

    def _all_well(
        self, nis: Array, error: Array, position: Array, velocity: Array, sent: Array, switch: NDArray[np.bool_]
    ) -> bool:
        """Tell whether even the worst value of each kind among all runs, taken together, is well within bounds.

        Quicker than asking run by run, while all of them go well. NaN fails every comparison.
        """
        one, most = self._one, self._most
        if not (most(nis) <= one.settings.lost_estimate and most(error) <= one.settings.lost_tracking):
            return False
        fastest = max(most(np.abs(velocity)), most(np.abs(sent)))
        switched = switch if self._going is None else switch & self._going
        return one.far_from_ends(float(most(np.abs(position))), fastest) and not switched.any()

    def _most(self, values: Array) -> float:
        """Return the greatest of values (S,) among the runs that are judged."""
        if self._going is None:
            return np.maximum.reduce(values)
        return np.maximum.reduce(values, where=self._going, initial=-np.inf)

    def _note(self) -> None:
        """Note which runs are judged, and whether any is being brought to rest: some runs have just changed."""
        self._going = self._alive & ~self.braking
        self.any_braking = bool((self._alive & self.braking).any())

    def brake(self, k: int, velocity: Array) -> None:
        """Note which carts still move by the commands sent, `velocity` (S,) m/s, before tick k's."""
        self._since[self.braking & (velocity != 0)] = k * self._period

    def ended(self, k: int, faults: Mapping[int, str]) -> None:
        """End the runs whose carts have stood long enough at tick k, and those that hit a stop."""
        if self.any_braking:
            over = self._alive & self.braking & (k * self._period > self._since + SETTLING)
            if over.any():
                for lane in np.flatnonzero(over):
                    self.counts[lane] = k + 1
                self._alive &= ~over
                self._note()
        for lane, fault in faults.items():
            if self._alive[lane] and self.endings[lane] is not Ending.CART_STOP:
                self.endings[lane], self.reasons[lane], self.counts[lane] = Ending.CART_STOP, fault, k + 1
                self._alive[lane] = False
                self._note()

    def _fail(self, k: int, failed: NDArray[np.bool_]) -> None:
        for lane in np.flatnonzero(failed & self._alive):
            self.endings[lane] = Ending.PLANT_FAILED
            self.reasons[lane] = f"plant failed at t = {k * self._period:.3f} s: its state is no longer finite"
            self.counts[lane] = k
            self._alive[lane] = False
            self._note()
