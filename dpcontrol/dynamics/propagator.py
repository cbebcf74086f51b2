"""Propagation to machine precision by Taylor's method (heyoka).

It covers flows, variational equations and Poincaré sections.

An integrator is compiled when it is first needed. Parameters and inputs are run-time values, so a changed mass costs
nothing. heyoka caches compiled code on disk, and a process builds each integrator of its equations once. Propagators
use copies. Of many trajectories, eight share each vector instruction.

In 113-bit arithmetic (34 decimal digits) numbers are numpy arrays whose dtype is heyoka's 113-bit real; +, -, *, /, @
and comparisons keep the precision. Doubles enter exactly, fractions and decimals correctly rounded. π has 36 digits,
since 2 * np.pi is off by 2e-16. Arrays of doubles must be converted by `extended` first, because numpy does not mix the
two types.

Source: Biscani & Izzo, Revisiting high-order Taylor methods for astrodynamics and celestial mechanics (2021).
"""

from collections.abc import Callable, Hashable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from decimal import Decimal, localcontext
from fractions import Fraction
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.dynamics.compiled import COMPACT, QUICK, first_use, hy, to_heyoka
from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.checked import number, numbers
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.shown import Brief

Row = Sequence[float] | Array


@dataclass(frozen=True)
class Section:
    """A Poincaré section n·x = offset with coordinates on it, where trajectories, tubes and connections are compared.

    For an angle, it is n·x = offset + period · k with every integer k: parallel planes, here called sheets.

    Attributes:
        normal: n (N,).
        position: row (N,) of the section's coordinate q = position · x.
        momentum: conjugate combination of canonical momenta (n,).
        period: of n·x, or None on a line.
        side: row (N,) of the condition side · x > middle, or |side · x - middle| > reach; None for no condition.
    """

    name: str
    normal: tuple[float, ...]
    position: tuple[float, ...]
    momentum: tuple[float, ...]
    offset: float = 0.0
    period: float | None = None
    side: tuple[float, ...] | None = None
    middle: float = 0.0
    reach: float | None = None

    @classmethod
    def plane(cls, name: str, normal: Row, *, offset: float = 0.0, period: float | None = None) -> "Section":
        """Return the section normal · q = offset of two coordinates.

        Args:
            name: name of the section.
            normal: row (2,) of the coordinates.
            offset: in the coordinates' unit.
            period: distance of the sheets offset + period · k of an angle; None on a line.
        """
        coordinate_row, along = _plane_rows(normal)
        if period is not None and not number("period", period) > 0:
            raise InputError(f"period = {period:g} of the section {name}: must be positive, or None on a line")
        return cls(name, (*coordinate_row, 0.0, 0.0), (*along, 0.0, 0.0), along, number("offset", offset), period)

    @classmethod
    def turning(cls, name: str, direction: Row) -> "Section":
        """Return the section direction · v = 0 of turning points.

        v is the second half of the states of two coordinates.

        Args:
            name: name of the section.
            direction: row (2,) of v.
        """
        rate_row, along = _plane_rows(direction)
        return cls(name, (0.0, 0.0, *rate_row), (*along, 0.0, 0.0), along)

    def where(self, side: Row, *, middle: float = 0.0, reach: float | None = None) -> "Section":
        """Return the part of the section on one side.

        With a reach, it is the part beyond the reach on both sides.

        Args:
            side: row (2,) of coordinates.
            middle: value of side · q at the border, or between the two parts.
            reach: distance from `middle`; None for one side.
        """
        side_row = (*(float(value) for value in side), 0.0, 0.0)
        return replace(self, side=side_row, middle=middle, reach=reach)

    def height(self, states: Array) -> Array:
        """Return the signed distance n·x - offset (…) of states from the section, in the unit of n·x.

        The value is zero, or a multiple of the period, on the section.

        Args:
            states: states (…, N).
        """
        return np.asarray(states) @ np.asarray(self.normal) - self.offset

    def level(self, state: Array) -> float:
        """Return the value of n·x on the section, which is a condition for the state of a refined crossing.

        For an angle, it is the value on the sheet nearest to the state.

        Args:
            state: state (N,).
        """
        if self.period is None:
            return self.offset
        return self.offset + float(np.rint(self.height(state) / self.period)) * self.period

    def sheets(self, states: Array) -> Array:
        """Return the number of the sheet below each state (…); it changes where a trajectory crosses the section.

        Without a period it is 1 above the section and 0 elsewhere.

        Args:
            states: states (…, N).
        """
        heights = self.height(states)
        return (heights > 0).astype(float) if self.period is None else np.floor(heights / self.period)

    def sense(self, rate: Array) -> int:
        """Return the sign, 1 or -1, of a crossing, which tells forward from backward crossings of one section.

        It is the sign of n·ẋ. A normal with entries for rates only defines turning points: the trajectory turns back,
        so the sign is that of n·v just before the turn.

        Args:
            rate: rate ẋ (N,) at the crossing.
        """
        positions = self.normal[: len(self.normal) // 2]
        return int(np.sign(np.dot(self.normal, rate))) * (1 if any(positions) else -1)

    def mark(self, state: Array) -> str:
        """Return "+" or "-" for the side of a state, which the names of connections contain.

        The result is "" if the section does not have two sides.

        Args:
            state: state (N,).
        """
        if self.reach is not None and self.side is not None:
            return "+" if float(np.dot(self.side, state)) > self.middle else "-"
        return ""

    def admits(self, state: Array) -> bool:
        """True if a crossing at `state` (N,) satisfies the section's condition on the side, so that it counts.

        Args:
            state: state (N,) at a crossing.
        """
        if self.side is None:
            return True
        distance = float(np.dot(self.side, state)) - self.middle
        return distance > 0 if self.reach is None else abs(distance) > self.reach

    def kept_by(self, reverser: Array, centre: Array) -> bool:
        """True if a reverser maps the section onto itself.

        The stable tube's cut by such a section mirrors that of the unstable tube. The section's side must also map onto
        itself.

        Args:
            reverser: matrix (N, N).
            centre: state (N,) about which it acts.
        """
        shift = centre - reverser @ centre

        def maps_onto_itself(
            row: tuple[float, ...], level: float, period: float | None, signs: tuple[float, ...]
        ) -> bool:
            """True if the reverser maps the planes row · x = level + period · k onto themselves.

            It may turn the row into its negative only if `signs` contain -1.
            """
            for sign in signs:
                if np.allclose(np.asarray(row) @ reverser, sign * np.asarray(row)):
                    distance = (sign - 1) * level + float(np.dot(row, shift))
                    return abs(distance - (np.rint(distance / period) * period if period else 0.0)) < 1e-9
            return False

        either_sign = (1.0, -1.0)
        return maps_onto_itself(self.normal, self.offset, self.period, either_sign) and (
            self.side is None
            or maps_onto_itself(
                self.side, self.middle, None, either_sign if self.reach is not None else either_sign[:1]
            )
        )


@dataclass(frozen=True)
class Crossing(Brief):
    """Crossing of a section by a trajectory: state (N,), time, s, from the trajectory's start."""

    state: Array
    time: float


def _plane_rows(normal: Row) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return a plane section's normal (2,) in the two coordinates, and the direction (2,) along the section.

    The largest entry of the direction is positive, so that normals of either sign give the same side. Adding 0.0 turns
    -0.0 into 0.0.
    """
    first, second = numbers("normal", tuple(normal), 2)
    if not (first or second):
        raise InputError("normal = (0, 0): a section needs a direction")
    sign = 1.0 if max(first, -second, key=abs) < 0 else -1.0
    return (first, second), (sign * second + 0.0, -sign * first + 0.0)


_MADE: WeakKeyDictionary[Equations, dict[Hashable, tuple[Any, int]]] = WeakKeyDictionary()
"""Code of each kind, and the work that remains until unoptimised code is optimised."""

_LONG_WORK = 20_000
"""Flights to sections, or entries of states in other propagations, that lose in unoptimised code what optimisation
takes."""


def _original(equations: Equations, kind: Hashable, make: Callable[[int], Any], *, work: int | None = None) -> Any:
    """Return the code that `make` compiles from equations, which callers copy.

    Even with cached machine code, building an integrator takes 8 to 60 ms, and copying it 2 ms. The original is never
    used itself.

    Unoptimised code takes 2 to 3 times as long, but compiles 5 to 8 times faster. So the first use on a computer does
    not optimise; the second use and long work do. Both agree within rounding. Work is counted rather than timed, so the
    computer's speed does not decide.

    Args:
        equations: equations of the code.
        kind: key of the code among those of these equations.
        make: compiles with heyoka's `opt_level`, 0 or 1.
        work: work that follows, in the unit of `_LONG_WORK`, or None if `make` sets the level.
    """
    integrators = _MADE.setdefault(equations, {})
    original, remaining = integrators.get(kind, (None, 0))
    if original is None:
        remaining = _LONG_WORK if work is not None and first_use(equations.function(), str(kind)) else 0
        original = make(0 if remaining else 1)
    elif work and 0 < remaining <= work:
        original = make(1)
    integrators[kind] = original, max(remaining - (work or 0), 0)
    return original


# Measured on 1,000 tube trajectories of the pendulum, optimised and without compact_mode: 0.039 s with 8 lanes, 0.024 s
# of it for Taylor steps, 0.007 s for the detection of crossings and 0.008 s for this module. Sixteen lanes gain nothing
# and waste more on the few trajectories of a refinement.
LANES = 8

_MOST_STEPS = 50_000
"""Limit of Taylor steps between two crossings, a hundred times that of tubes.

It also ends flights that never cross.
"""

_PACE = 1_000
"""Taylor steps between measurements of a flight's pace; those of tubes rarely need as many."""

_MOST_PACES = 1_000
"""A flight ends if the rest of its time, or the time so far, needs this many times `_PACE` steps.

Near a singularity, steps shrink without end.
"""


INTERVAL_STEPS = 2_000
"""Limit of Taylor steps over a short interval, a hundred times that of fast motions."""


class CrossingFinder:
    """Propagates trajectories of one set of equations to sections, eight at once in the lanes of vector instructions.

    It is compiled when made and cannot be shared between threads.

    A finished trajectory leaves its lane to the next one, so no trajectory is continued beyond the section. The
    section's normal and the two adjacent sheets are run-time values: one compilation covers every section of the
    equations.

    Args:
        equations: equations with N states and p parameters.
        parameters: values (p,).
    """

    def __init__(self, equations: Equations, parameters: Array) -> None:
        self.equations, self.parameters = equations, parameters
        n, first = equations.dimension, len(parameters)
        # Places among the integrator's parameters, see `_made`.
        self._normal, self._events = slice(first, first + n), slice(first + n, first + n + 4)
        # The code of which this finder has a copy, `_integrator`; both change once optimised code is made.
        self._original: Any = None

    def _made(self, level: int) -> Any:
        """Compile the integrator of `LANES` trajectories that stops a lane at the sheet below or above its trajectory.

        Its parameters are the p parameters of the equations, the section's normal (N,), then for each lane the gains of
        the two sheets (1 for on, 0 for off) and their levels. `level` is heyoka's optimisation, 0 or 1.
        """
        system, gain = _at_rest(self.equations), self._events.start
        height = sum((hy.par[self._normal.start + i] * x for i, (x, _) in enumerate(system)), hy.expression(0.0))
        # heyoka isolates the roots of each step's Taylor polynomial, so a double crossing within one step is detected.
        # A gain of zero switches a sheet off. A distant sheet would do so too, but heyoka uses the size of events to
        # choose its step.
        events = [hy.t_event_batch(hy.par[gain + k] * height - hy.par[gain + 2 + k]) for k in range(2)]
        # Straight-line code deserves the highest optimisation.
        start = np.zeros((len(system), LANES))
        return hy.taylor_adaptive_batch(system, start, compact_mode=False, opt_level=3 * level, t_events=events)

    @cached_property
    def _rate(self) -> Any:
        """The compiled rates f(x), for the check of starts and the direction in which a section is crossed."""

        def made(_: int) -> Any:
            """Compile the rates; the optimisation level is that of `QUICK`, not the argument."""
            variables, rates = zip(*_at_rest(self.equations), strict=True)
            return hy.cfunc(rates, vars=variables, **QUICK)

        return copy(_original(self.equations, "rates", made))

    def _rates(self, states: Array) -> Array:
        """Return the rates f(x) (N, K) at states (K, N)."""
        # Parameters that the equations never use are not part of the compiled code.
        used = self.parameters[: self._rate.nparams, None]
        return self._rate(np.ascontiguousarray(states.T), pars=np.repeat(used, len(states), axis=1))

    def find(self, states: Array, section: Section, *, longest: float, hit: int) -> tuple[Array, Array]:
        """Return each state's crossing of a section (K, N) and its time (K,), s, or NaN and infinity.

        The eight lanes of the integrator work through the list of states: a lane whose trajectory has ended takes the
        next state from the list. A state has no crossing if it or its rate is not finite, if its trajectory does not
        reach the crossing in the time `longest`, or if it needs too many steps for it.

        Args:
            states: states (K, N).
            section: section of the equations.
            longest: time limit, s; negative for backward.
            hit: number of the crossing, from 1.
        """
        crossed, times = np.full(states.shape, np.nan), np.full(len(states), np.inf)
        waiting = self._fit_to_fly(states)
        if not waiting:
            return crossed, times
        integrator = self._prepared(section, len(waiting))
        # A lane without a trajectory rests at the last of these states, with both sheets switched off.
        starts = np.vstack([states, states[waiting[-1]]])
        levels, limits = self._levels(starts, section), np.append(np.full(len(states), longest), 0.0)
        state, events = integrator.state, integrator.pars[self._events]
        clock, halves = integrator.time, integrator.dtime
        running_outcomes = {int(hy.taylor_outcome.success), int(hy.taylor_outcome.step_limit)}
        # Index of each lane's trajectory, -1 without one. A cooldown is the time in which heyoka ignores a sheet after
        # its crossing.
        flights, end_times = [-1] * LANES, np.zeros(LANES)
        hits, steps_done, unpaced_steps, mark_times = [0] * LANES, [0] * LANES, [0] * LANES, [0.0] * LANES
        free = list(range(LANES))
        while True:
            # Clocks run in twice the precision; setting the leading half alone would touch the companions' last digits.
            clock_leading, clock_trailing = halves[0].copy(), halves[1].copy()
            for lane in free:
                flights[lane] = k = waiting.pop() if waiting else -1
                state[:, lane], events[:, lane], end_times[lane] = starts[k], levels[k], limits[k]
                clock_leading[lane] = clock_trailing[lane] = mark_times[lane] = 0.0
                hits[lane] = steps_done[lane] = unpaced_steps[lane] = 0
                integrator.reset_cooldowns(lane)
            if max(flights) < 0:
                return crossed, times
            if free:
                integrator.set_dtime(clock_leading, clock_trailing)
            integrator.propagate_until(end_times, max_steps=_PACE)
            free = []
            for lane, (outcome, _, _, steps) in enumerate(integrator.propagate_res):
                if (k := flights[lane]) < 0:
                    continue
                steps_done[lane] += steps
                unpaced_steps[lane] += steps
                may_continue = steps_done[lane] < _MOST_STEPS
                if unpaced_steps[lane] >= _PACE:
                    time = float(clock[lane])
                    may_continue &= abs(time - mark_times[lane]) * _MOST_PACES > min(abs(longest - time), abs(time))
                    unpaced_steps[lane], mark_times[lane] = 0, time
                code = int(outcome)
                if may_continue and code in running_outcomes:
                    continue
                # A stopping terminal event reports -1 - its index. Any other outcome ends the flight.
                if code in (-1, -2):
                    hits[lane] += section.admits(state[:, lane])
                    if hits[lane] >= hit:
                        crossed[k], times[k] = state[:, lane], clock[lane]
                    elif may_continue:
                        steps_done[lane] = 0
                        self._pass(lane, -1 - code, section, np.sign(longest))
                        continue
                free.append(lane)

    def _prepared(self, section: Section, work: int) -> Any:
        """Return the integrator of sections with this section's normal in all lanes, its clocks at zero.

        `work` is the number of trajectories that follow, which decides whether the code is optimised first.
        """
        original = _original(self.equations, "crossings", self._made, work=work)
        if original is not self._original:
            self._original, self._integrator = original, copy(original)
        integrator = self._integrator
        integrator.set_time(0.0)
        integrator.reset_cooldowns()
        integrator.pars[: len(self.parameters)] = self.parameters[:, None]
        integrator.pars[self._normal] = np.asarray(section.normal, dtype=float)[:, None]
        return integrator

    def _fit_to_fly(self, states: Array) -> list[int]:
        """Return the indices, last first, of the states (K, N) that can be propagated: those finite with finite rates.

        Other states would corrupt their lane's clock, which heyoka cannot restart.
        """
        rates = self._rates(states).T
        return np.flatnonzero((np.isfinite(states) & np.isfinite(rates)).all(axis=1))[::-1].tolist()

    def _levels(self, states: Array, section: Section) -> Array:
        """Return the sheets that each state (K, N) may cross first, in the order of the integrator's parameters.

        The columns (K, 4) are the gains of the sheets below and above, then their levels n·x. A section without period
        has one sheet only. The last row belongs to a lane that rests, and has no sheets. The levels are run-time values
        of a lane.
        """
        levels = np.tile([1.0, 0.0, section.offset, 1.0], (len(states), 1))
        if section.period is not None:
            levels[:, 2] += section.period * np.floor(section.height(states) / section.period)
            levels[:, 1], levels[:, 3] = 1.0, levels[:, 2] + section.period
        levels[-1] = 0.0, 0.0, 1.0, 1.0
        return levels

    def _pass(self, lane: int, sheet: int, section: Section, sense: float) -> None:
        """Let a lane continue through a sheet whose crossing did not count.

        Time runs forward (`sense` 1) or backward (-1). A periodic section is two parallel sheets, one period apart,
        whose levels are parameters of the lane. The crossed one (`sheet` 0 or 1) stays, since heyoka ignores it until
        the trajectory has left it. The other one moves to the next level in the direction of motion.
        """
        if section.period is None:
            return
        integrator = self._integrator
        rate = self._rates(integrator.state[None, :, lane])[:, 0]
        onward = float(np.sign(np.dot(section.normal, rate)) * sense)
        levels = integrator.pars[self._events][2:, lane]
        levels[1 - sheet] = levels[sheet] + onward * section.period


def taylor_system(equations: Equations, inputs: list[Any], first: int = 0) -> list[tuple[Any, Any]]:
    """Return the equations as (variable, rate) pairs, of which heyoka compiles its Taylor integrators.

    Args:
        equations: equations with N states and p parameters.
        inputs: expressions (m,) of the inputs.
        first: index of the first parameter in hy.par.
    """
    states = hy.make_vars(*[f"x{i}" for i in range(equations.dimension)])
    parameters = [hy.par[first + i] for i in range(equations.parameters.shape[0])]
    return list(zip(states, to_heyoka(equations.function(), [states, inputs, parameters]), strict=True))


def _at_rest(equations: Equations) -> list[tuple[Any, Any]]:
    """Return the (variable, rate) pairs of heyoka with the inputs at zero, as for the search of orbits."""
    return taylor_system(equations, [hy.expression(0.0)] * equations.input_count)


def _with_tangents(equations: Equations) -> list[tuple[Any, Any]]:
    """Return the (variable, rate) pairs of the states (N,) and of one tangent vector (N,).

    The flow carries the tangent along. Its rate is v' = Df(x) v: half the work of a state-transition matrix.
    """
    pairs = _at_rest(equations)
    tangent = hy.make_vars(*[f"v{i}" for i in range(len(pairs))])
    rates = [hy.sum([hy.diff(rate, x) * v for (x, _), v in zip(pairs, tangent, strict=True)]) for _, rate in pairs]
    return [*pairs, *zip(tangent, rates, strict=True)]


def check_arrival(integrator: Any, outcome: Any) -> None:
    """Raise ArithmeticError if a propagation ended before its time, as close to a singularity.

    Args:
        integrator: integrator after the propagation.
        outcome: its outcome, a `hy.taylor_outcome`.
    """
    if outcome != hy.taylor_outcome.time_limit:
        raise ArithmeticError(f"propagation stopped at t = {float(integrator.time):g} s: {outcome}")


class Propagator:
    """Propagates one set of equations at machine precision, their inputs at zero.

    Instances cannot be shared between threads because calls reuse the compiled integrators.

    Args:
        equations: equations with N states and p parameters.
        parameters: values (p,).
        tolerance: relative tolerance of a Taylor step, 0 for rounding, which `crossings` always use.
    """

    def __init__(self, equations: Equations, parameters: ArrayLike, *, tolerance: float = 0.0) -> None:
        self.equations = equations
        self.parameters = np.asarray(parameters, dtype=float)
        self.tolerance = tolerance
        # The code and this propagator's copy of it, by the kind of states.
        self._compiled: dict[Hashable, tuple[Any, Any]] = {}

    @cached_property
    def _finder(self) -> CrossingFinder:
        """The search of crossings, compiled when first needed."""
        return CrossingFinder(self.equations, self.parameters)

    def _at_zero(self, states: Array, *, stm: bool) -> Any:
        """Return the integrator for this kind of states, set to time zero and to these states.

        States are (N,) for a single trajectory, or (N, LANES) with one column for each lane. With (2 N,) or (2 N,
        LANES), the second half are tangents, which the flow carries along. With `stm`, the state-transition matrix,
        first the identity, follows the states in the integrator's state.
        """
        in_lanes, states_only = states.ndim == 2, not stm and len(states) == self.equations.dimension
        kind = (stm, len(states), in_lanes, self.tolerance)

        def compiled(level: int) -> Any:
            """Compile the integrator of this kind with heyoka's `opt_level`, 0 or 1."""
            system = (_at_rest if len(states) == self.equations.dimension else _with_tangents)(self.equations)
            system = hy.var_ode_sys(system, args=hy.var_args.vars, order=1) if stm else system
            compile_integrator = hy.taylor_adaptive_batch if in_lanes else hy.taylor_adaptive
            options = QUICK if states_only else {**COMPACT, "opt_level": level}
            return compile_integrator(system, np.zeros(states.shape), tol=self.tolerance, **options)

        # Code of plain states is quick to compile and needs no optimised version.
        work = None if states_only else len(states) * (1 + stm * len(states))
        original = _original(self.equations, kind, compiled, work=work)
        if self._compiled.get(kind, (None, None))[0] is not original:
            integrator = copy(original)
            # Parameters that the equations never use are not part of the compiled code.
            used = self.parameters[: len(integrator.pars)]
            integrator.pars[:] = used[:, None] if in_lanes else used
            self._compiled[kind] = original, integrator
        integrator, n = self._compiled[kind][1], len(states)
        if in_lanes:
            integrator.set_time(0.0)
        else:
            integrator.time = 0.0
        integrator.state[:n] = states
        if stm:
            identity = np.eye(n).ravel()
            integrator.state[n:] = identity[:, None] if in_lanes else identity
        return integrator

    def flow(self, state: ArrayLike, duration: float) -> Array:
        """Return the state (N,) after a duration.

        Args:
            state: state (N,) at time zero.
            duration: time, s; negative for before.

        Raises:
            ArithmeticError: the state became infinite or undefined.
        """
        integrator = self._at_zero(np.asarray(state, dtype=float), stm=False)
        check_arrival(integrator, integrator.propagate_until(float(duration))[0])
        return integrator.state.copy()

    def flow_with_stm(self, state: ArrayLike, duration: float) -> tuple[Array, Array]:
        """Return the state (N,) after a duration, and its derivative.

        The derivative is the state-transition matrix (N, N).

        Args:
            state: state (N,) at time zero.
            duration: time, s; negative for before.

        Raises:
            ArithmeticError: the state became infinite or undefined.
        """
        states, matrices = self.sample_with_stm(state, [duration])
        return states[0], matrices[0]

    def sample(self, state: ArrayLike, times: ArrayLike, *, most_steps: int = 0) -> Array:
        """Return the states (K, N) of a trajectory at given times.

        Args:
            state: state (N,) at time zero.
            times: monotonic times (K,), s.
            most_steps: limit of Taylor steps, 0 for none.

        Raises:
            ArithmeticError: the state became infinite or undefined, or the limit was reached.
        """
        grid = np.asarray(times, dtype=float)
        if grid.size == 0:
            return np.empty((0, self.equations.dimension))
        # heyoka's grid must begin at the integrator's time.
        leading = int(grid[0] != 0.0)
        integrator = self._at_zero(np.asarray(state, dtype=float), stm=False)
        result = integrator.propagate_grid(np.concatenate([[0.0] * leading, grid]), max_steps=most_steps)
        check_arrival(integrator, result[0])
        return np.array(result[-1])[leading:]

    def followed(self, state: ArrayLike, times: Array) -> Array:
        """Return the states (M, N) at the first M of the times.

        At later times the state is infinite or undefined, or absurdly fast: an interval needs over 2,000 Taylor steps.
        M is the number K of times if this does not happen.

        Args:
            state: state (N,) at time zero.
            times: rising times (K,), s.
        """
        integrator = self._at_zero(np.asarray(state, dtype=float), stm=False)
        reached = np.empty((len(times), self.equations.dimension))
        for k, time in enumerate(times):
            if integrator.propagate_until(float(time), max_steps=INTERVAL_STEPS)[0] != hy.taylor_outcome.time_limit:
                return reached[:k]
            reached[k] = integrator.state
        return reached

    def sample_with_stm(self, state: ArrayLike, times: ArrayLike) -> tuple[Array, Array]:
        """Return the states (K, N) of a trajectory and its state-transition matrices (K, N, N) from time zero.

        Args:
            state: state (N,) at time zero.
            times: monotonic times (K,) from zero, s.

        Raises:
            ArithmeticError: the state became infinite or undefined.
        """
        integrator, n = self._at_zero(np.asarray(state, dtype=float), stm=True), self.equations.dimension
        # A grid must not repeat a time. All times have the sign of their sum.
        distinct, places = np.unique(np.abs(np.append(0.0, times)), return_inverse=True)
        result = integrator.propagate_grid(np.copysign(distinct, np.sum(times)))
        check_arrival(integrator, result[0])
        reached = np.array(result[-1])[places[1:]]
        return reached[:, :n], reached[:, n:].reshape(-1, n, n)

    def crossings(self, states: ArrayLike, section: Section, *, longest: float, hit: int = 1) -> tuple[Array, Array]:
        """Return each state's crossing of a section (K, N) and its time (K,), s, or NaN and infinity.

        Many trajectories are computed together, which is four times faster; results are independent of each other.

        Args:
            states: states (K, N).
            section: section of the equations.
            longest: time limit, s; negative for backward.
            hit: number of the crossing, from 1.
        """
        many = np.asarray(states, dtype=float).reshape(-1, self.equations.dimension)
        return self._finder.find(many, section, longest=float(longest), hit=hit)

    def crossing(self, state: ArrayLike, section: Section, *, longest: float, hit: int = 1) -> Crossing | None:
        """Return a state's crossing of a section, or None if its trajectory does not reach it in the time `longest`.

        Args:
            state: state (N,).
            section: section of the equations.
            longest: time limit, s; negative for backward.
            hit: number of the crossing, from 1.
        """
        # An integrator for a single state takes 0.6 times as long per flight, but needs its own compilation.
        states, times = self.crossings(state, section, longest=longest, hit=hit)
        return Crossing(states[0], float(times[0])) if np.isfinite(times[0]) else None

    def flows(self, states: Array, durations: Array) -> Array:
        """Return the states (K, N) after short durations.

        The durations are short as in multiple shooting, since the number of Taylor steps is not limited.

        In a batch, a segment is four times cheaper. A solve with 128 symbols propagates five thousand per step.

        Args:
            states: states (K, N) at the starts.
            durations: times (K,), s.

        Raises:
            ArithmeticError: a state became infinite or undefined.
        """
        return self._flown(states, durations, stm=False)

    def flows_with_stm(self, states: Array, durations: Array) -> tuple[Array, Array]:
        """Return the states of `flows` with state-transition matrices, for the Newton steps of multiple shooting.

        The matrices are (K, N, N).

        Args:
            states: states (K, N) at the starts.
            durations: times (K,), s.

        Raises:
            ArithmeticError: a state became infinite or undefined.
        """
        n = self.equations.dimension
        final_states = self._flown(states, durations, stm=True)
        return final_states[:, :n].copy(), final_states[:, n:].reshape(-1, n, n).copy()

    def flows_with_tangents(self, states: Array, durations: Array, tangents: Array) -> tuple[Array, Array]:
        """Return the states (K, N) of `flows` and images of tangents.

        Rows are NaN if a state or tangent became infinite or undefined, as it does close to a collision.

        Args:
            states: states (K, N) at the starts.
            durations: times (K,), s.
            tangents: tangents (K, N) at the starts.
        """
        n = self.equations.dimension
        final_states = self._flown(np.hstack([states, tangents]), durations, stm=False, keep_lost=True)
        return final_states[:, :n], final_states[:, n:]

    def _flown(self, states: Array, durations: Array, *, stm: bool, keep_lost: bool = False) -> Array:
        """Return the states (K, N) at the ends of K segments, propagated `LANES` at a time.

        With `stm`, each row continues with the entries of the state-transition matrix (N²), row by row. States (K, 2 N)
        have tangents behind them. With `keep_lost`, a segment that could not be propagated gives a row of NaN instead
        of an ArithmeticError. `durations` (K,) are in s, negative for before.
        """
        if not (np.isfinite(states).all() and np.isfinite(durations).all()):
            raise ArithmeticError("the start or the duration of a segment is not finite")
        n = states.shape[1]
        final_states = np.empty((len(states), n + n * n if stm else n))
        for first in range(0, len(states), LANES):
            # A partial last batch repeats its last segment.
            segments = np.minimum(np.arange(first, first + LANES), len(states) - 1)
            integrator = self._at_zero(states[segments].T, stm=stm)
            integrator.propagate_until(durations[segments])
            arrived = np.array([result[0] == hy.taylor_outcome.time_limit for result in integrator.propagate_res])
            if not (keep_lost or arrived.all()):
                raise ArithmeticError(f"a segment of {np.max(np.abs(durations[segments])):g} s could not be propagated")
            final_states[segments] = np.where(arrived[:, None], integrator.state.T, np.nan)
        return final_states


class PolynomialInputPropagator:
    """Propagates equations under inputs that are polynomials in time.

    It has machine precision, for one set of equations and inputs of one polynomial degree.

        ẋ = f(x, u(t); p),      u(t) = Σ_k c_k t^k        (t from the start of the propagation)

    `degree` 0 is a constant input. The coefficients are run-time values, so one compilation covers every interval of a
    reference. Instances cannot be shared between threads because calls reuse the integrator.
    """

    def __init__(self, equations: Equations, parameters: ArrayLike, *, degree: int) -> None:
        self.equations = equations
        self.parameters = np.asarray(parameters, dtype=float)
        self.degree = degree

    @cached_property
    def _views(self) -> tuple[Any, Array, Array]:
        """The integrator, and views into it that set its state (N,) and the inputs' coefficients ((degree+1) m,)."""
        input_size = (self.degree + 1) * self.equations.input_count
        integrator = copy(_original(self.equations, ("polynomial", self.degree), lambda _: self._made(input_size)))
        # Parameters that the equations never use are not part of the compiled code.
        used = max(len(integrator.pars) - input_size, 0)
        integrator.pars[input_size:] = self.parameters[:used]
        return integrator, integrator.state, integrator.pars[:input_size]

    def _made(self, input_size: int) -> Any:
        """Compile the integrator, whose first `input_size` parameters are the coefficients c_k, input by input.

        The equations' parameters follow. Horner's scheme evaluates the polynomials at the integrator's time.
        """
        inputs = []
        for i in range(self.equations.input_count):
            first = (self.degree + 1) * i
            value: Any = hy.par[first + self.degree]
            for k in reversed(range(self.degree)):
                value = hy.par[first + k] + hy.time * value
            inputs.append(value)
        system = taylor_system(self.equations, inputs, input_size)
        return hy.taylor_adaptive(system, [0.0] * self.equations.dimension, **QUICK, time=0.0)

    def flow(self, state: ArrayLike, coefficients: ArrayLike, duration: float) -> Array:
        """Return the state (N,) after an interval with one polynomial of the inputs.

        Args:
            state: state (N,) at time zero.
            coefficients: coefficients ((degree+1) m,), input by input, from the constant term up.
            duration: time, s.

        Raises:
            ArithmeticError: the state became infinite or undefined, or is absurdly fast.
        """
        integrator, state_view, coefficient_view = self._views
        integrator.time, state_view[:], coefficient_view[:] = 0.0, state, coefficients
        check_arrival(integrator, integrator.propagate_until(duration, max_steps=INTERVAL_STEPS)[0])
        return state_view.copy()

    def sample(self, state: ArrayLike, coefficients: ArrayLike, times: ArrayLike) -> Array:
        """Return the states (K, N) within an interval with one polynomial of the inputs.

        Args:
            state: state (N,) at the first time, 0.
            coefficients: see `flow`.
            times: rising times (K,), s.

        Raises:
            ArithmeticError: the state became infinite or undefined, or is absurdly fast.
        """
        integrator, state_view, coefficient_view = self._views
        integrator.time, state_view[:], coefficient_view[:] = 0.0, state, coefficients
        result = integrator.propagate_grid(np.asarray(times, dtype=float), max_steps=INTERVAL_STEPS)
        check_arrival(integrator, result[0])
        return np.array(result[-1])


Extended = NDArray[Any]
"""A numpy array of 113-bit reals."""

Exact = int | float | Fraction | Decimal

_PI = "3.141592653589793238462643383279502884197169399375105820974944592307816406"


def _real() -> Any:
    """Return heyoka's type of 113-bit reals.

    Raises:
        GoalMissed: this build of heyoka does not support them.
    """
    if not hasattr(hy, "real128"):
        raise GoalMissed("this build of heyoka has no 113-bit reals (it needs libquadmath); use double precision")
    return hy.real128


def extended(values: ArrayLike | Sequence[Exact]) -> Extended:
    """Return numbers as an array of 113-bit reals, of the same shape.

    Args:
        values: doubles, whole numbers, fractions or decimals, of any shape.

    Raises:
        GoalMissed: this build of heyoka does not support them.
    """
    array = np.asarray(values)
    if array.dtype == np.float64 or np.issubdtype(array.dtype, np.integer):
        return array.astype(_real())
    # Sixty digits suffice for the nearest 113-bit number.
    with localcontext(prec=60):
        exact = [Fraction(value) for value in array.ravel()]
        flat = [_real()(str(Decimal(fraction.numerator) / Decimal(fraction.denominator))) for fraction in exact]
    return np.array(flat, dtype=_real()).reshape(array.shape)


def pi_times(multiples: ArrayLike) -> Extended:
    """Return multiples of π, each rounded once to 113 bits, for angles of exact states.

    Args:
        multiples: doubles of any shape.
    """
    return extended(multiples) * np.array(_real()(_PI))


def digits(values: Extended) -> list[str]:
    """Return the decimal digits of 113-bit reals as texts for files.

    There are 36 significant ones, which reproduce each number.

    Args:
        values: 113-bit reals (K,).
    """
    return [str(value) for value in values]


class ExtendedPropagator:
    """Propagates one set of equations in 113-bit arithmetic, with Taylor tolerance 2e-34.

    Instances cannot be shared between threads.

    Args:
        equations: equations with N states and p parameters.
        parameters: exact values (p,).
    """

    def __init__(self, equations: Equations, parameters: Sequence[Exact] | Array) -> None:
        self.equations = equations
        self.parameters = extended(parameters)

    @cached_property
    def _integrator(self) -> Any:
        """The integrator in 113-bit reals with the exact parameters."""

        def compiled(_: int) -> Any:
            """Compile the integrator; the optimisation level is that of `COMPACT`, not the argument."""
            system = taylor_system(self.equations, [])
            zero = extended(np.zeros(len(system)))
            return hy.taylor_adaptive(system, zero, time=zero[0], fp_type=_real(), **COMPACT)

        integrator = copy(_original(self.equations, "extended", compiled))
        # Parameters that the equations never use are not part of the compiled code.
        integrator.pars[:] = self.parameters[: len(integrator.pars)]
        return integrator

    @cached_property
    def _energy(self) -> Any:
        """The compiled energy H of a state (N,) in 113-bit reals."""
        equations = self.equations

        def compiled(_: int) -> Any:
            """Compile the energy; the optimisation level is that of `COMPACT`, not the argument."""
            states, parameters = (
                [x for x, _ in taylor_system(equations, [])],
                [hy.par[i] for i in range(equations.parameters.shape[0])],
            )
            function = ca.Function("energy", [equations.state, equations.parameters], [equations.hamiltonian])
            value = to_heyoka(function, [states, parameters])
            return hy.cfunc(value, vars=states, fp_type=_real(), **COMPACT)

        return copy(_original(equations, "extended energy", compiled))

    def flow(self, state: Extended, duration: Any) -> Extended:
        """Return the state (N,) after a duration.

        Args:
            state: state (N,) at time zero.
            duration: time, s, a 113-bit real; negative for before.

        Raises:
            ArithmeticError: the state became infinite or undefined.
        """
        return self.sample(state, np.array([duration]))[0]

    def sample(self, state: Extended, times: Extended) -> Extended:
        """Return the states (K, N) at given times.

        Args:
            state: state (N,) at time zero.
            times: monotonic times (K,), s.

        Raises:
            ArithmeticError: the state became infinite or undefined.
        """
        integrator = self._integrator
        integrator.time = _real()(0)
        integrator.state[:] = state
        states = []
        for time in times:
            check_arrival(integrator, integrator.propagate_until(time)[0])
            states.append(integrator.state.copy())
        return np.array(states)

    def energy(self, state: Extended) -> Any:
        """Return the energy H at a state, a 113-bit real.

        The energy is in the equations' unit (J for a pendulum).

        Args:
            state: state (N,).
        """
        return self._energy(state, pars=self.parameters[: self._energy.nparams])[0]
