"""Many trajectories at once to a Poincaré section, to machine precision.

Eight trajectories share each vector instruction. A trajectory that has crossed gives its place to the next one, so
none is flown on into the motion after the section. The section's normal and the two of its sheets between which a
trajectory moves are run-time values: one compilation serves every section of the equations.

Source: Biscani & Izzo, Revisiting high-order Taylor methods for astrodynamics and celestial mechanics (2021).
"""

from functools import cached_property
from typing import Any

import heyoka as hy
import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.section import Crossing, Section

Array = NDArray[np.float64]

# Measured on 1,000 tube trajectories of the pendulum, without compact_mode: 8 lanes 0.053 s, 0.5 s to compile the first
# time; with it: 4 lanes 0.09 s, 8 lanes 0.067 s, 16 lanes 0.064 s, 0.2 s to compile. Sixteen waste more on the few
# trajectories of a refinement.
LANES = 8
_FLYING = hy.taylor_outcome.success


class CrossingFinder:
    """Flies trajectories of one set of equations to sections; compiled when made, not shared between threads.

    system: (variable, rate) pairs in heyoka's form; parameters (p,): what the system's hy.par[0..p) stand for.
    """

    def __init__(self, system: list[tuple[Any, Any]], parameters: Array) -> None:
        self.parameters, self._system = parameters, system
        n, first = len(system), len(parameters)
        height = sum((hy.par[first + i] * x for i, (x, _) in enumerate(system)), hy.expression(0.0))
        self._normal, self._gains = slice(first, first + n), slice(first + n, first + n + 2)
        self._sheets = slice(first + n + 2, first + n + 4)
        # heyoka isolates the roots of a step's own Taylor polynomial: a double crossing within one step is not missed.
        # A gain of zero switches a sheet off; a sheet put far away would do so too, but heyoka takes the events' size
        # for the state's when it chooses its step.
        events = [hy.t_event_batch(hy.par[first + n + k] * height - hy.par[first + n + 2 + k]) for k in range(2)]
        self._integrator: Any = hy.taylor_adaptive_batch(
            system, np.zeros((n, LANES)), compact_mode=False, t_events=events
        )

    @cached_property
    def _rates(self) -> Any:
        return hy.cfunc([rate for _, rate in self._system], vars=[x for x, _ in self._system], compact_mode=True)

    @property
    def _used(self) -> Array:
        # Parameters that the equations never use are not part of the compiled code.
        return self.parameters[: self._rates.nparams]

    def find(self, states: Array, section: Section, *, longest: float, hit: int) -> list[Crossing | None]:
        """Return each state's (K, N) `hit`-th crossing within `longest` seconds (negative: backward), or None."""
        found: list[Crossing | None] = [None] * len(states)
        waiting = self._fit_to_fly(states)
        if not waiting:
            return found
        integrator = self._integrator
        self._park(section, states[waiting[-1]])
        first_sheets = np.full(len(states), section.offset)
        if section.period is not None:
            first_sheets[waiting] += section.period * np.floor(section.height(states[waiting]) / section.period)
        ends = np.zeros(LANES)
        flying: list[int | None] = [None] * LANES
        seen = [0] * LANES

        def launch(lane: int) -> None:
            seen[lane] = 0
            flying[lane] = k = waiting.pop() if waiting else None
            ends[lane] = 0.0 if k is None else longest
            self._place(lane, None if k is None else (states[k], float(first_sheets[k])), section)

        for lane in range(LANES):
            launch(lane)
        while any(k is not None for k in flying):
            integrator.propagate_until(ends)
            for lane, (outcome, *_) in enumerate(integrator.propagate_res):
                k = flying[lane]
                if k is None or outcome == _FLYING:
                    continue
                # A stopping terminal event reports -1 - its index; everything else ends the flight.
                sheet = -1 - int(outcome)
                if sheet in (0, 1):
                    state = integrator.state[:, lane].copy()
                    seen[lane] += section.admits(state)
                    if seen[lane] < hit:
                        self._pass(lane, sheet, section, np.sign(longest))
                        continue
                    found[k] = Crossing(state, float(integrator.time[lane]))
                launch(lane)
        return found

    def _fit_to_fly(self, states: Array) -> list[int]:
        """Return the numbers, last first, of the states (K, N) that are finite and have finite rates.

        Any other would spoil its lane's clock, which heyoka then refuses to start again.
        """
        rates = self._rates(np.ascontiguousarray(states.T), pars=np.repeat(self._used[:, None], len(states), axis=1))
        return [
            int(k) for k in np.flatnonzero(np.isfinite(states.T).all(axis=0) & np.isfinite(rates).all(axis=0))[::-1]
        ]

    def _park(self, section: Section, state: Array) -> None:
        """Rest every lane at a finite state, and set what does not change from flight to flight."""
        integrator = self._integrator
        integrator.set_time(0.0)
        integrator.reset_cooldowns()
        integrator.state[:] = state[:, None]
        self._parked = state
        integrator.pars[: len(self.parameters)] = self.parameters[:, None]
        integrator.pars[self._normal] = np.asarray(section.normal, dtype=float)[:, None]

    def _place(self, lane: int, start: tuple[Array, float] | None, section: Section) -> None:
        """Put a trajectory into a lane, by its state (N,) and the sheet below it; None rests the lane."""
        integrator = self._integrator
        # Clocks run in twice the precision; setting the leading half alone would touch the companions' last digits.
        clocks = [half.copy() for half in integrator.dtime]
        for half in clocks:
            half[lane] = 0.0
        integrator.set_dtime(*clocks)
        integrator.reset_cooldowns(lane)
        state, sheet = (self._parked, None) if start is None else start
        integrator.state[:, lane] = state
        self._set_sheet(lane, 0, sheet)
        self._set_sheet(lane, 1, None if sheet is None or section.period is None else sheet + section.period)

    def _set_sheet(self, lane: int, which: int, level: float | None) -> None:
        """Put one of a lane's two sheets at n·x = level, or switch it off."""
        gain, place = self._gains.start + which, self._sheets.start + which
        self._integrator.pars[gain, lane] = 0.0 if level is None else 1.0
        self._integrator.pars[place, lane] = 1.0 if level is None else level

    def _pass(self, lane: int, sheet: int, section: Section, sense: float) -> None:
        """Let a lane fly on through a sheet, forward or backward in time: the other is now the next one beyond it.

        The sheet just crossed stays where it was, since heyoka ignores it until the trajectory has left it.
        """
        if section.period is None:
            return
        integrator = self._integrator
        rate = self._rates(integrator.state[:, lane].copy(), pars=self._used)
        onward = float(np.sign(np.dot(section.normal, rate)) * sense)
        crossed = float(integrator.pars[self._sheets.start + sheet, lane])
        self._set_sheet(lane, 1 - sheet, crossed + onward * section.period)
