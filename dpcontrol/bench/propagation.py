"""Chart of propagation: trajectories of a tube, a chaotic swing of 10 s, and a tick of the closed loop.

All methods start from the same states and are judged at the same time against 113-bit arithmetic.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from dpcontrol.bench.chart import ChartPage, Diagram
from dpcontrol.bench.measure import Alternative, Judged, compare
from dpcontrol.control.interface import SampledModel
from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.dynamics.compiled import Compiled, fixed_step
from dpcontrol.dynamics.equations import Equations, runge_kutta_4
from dpcontrol.dynamics.propagator import ExtendedPropagator, PolynomialInputPropagator, Propagator, extended
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.plans.model import load_model
from dpcontrol.references.problem import Limits, state_scale


def classical_step(equations: Equations) -> ca.Function:
    """Return the classical Runge-Kutta step of order 4 with held inputs.

    The function is (state, inputs, duration, parameters) -> following.

    Args:
        equations: equations with N states and m inputs.
    """
    f, u, p, h = equations.function(), equations.inputs, equations.parameters, ca.SX.sym("h")
    following = runge_kutta_4(lambda state, _: f(state, u, p), equations.state, h)
    names = ["state", "inputs", "duration", "parameters"]
    return ca.Function("scheme", [equations.state, u, h, p], [ca.cse(ca.densify(following))], names, ["following"])


class Stepper:
    """A fixed-step integrator in machine code, for states (N,), or (N, S) in lanes.

    Parameters (p,) and inputs (m,) are held. Do not share it between threads.

    Args:
        function: step (state, inputs, duration, parameters) -> following.
        parameters: parameters (p,).
        lanes: number S of states at once, 0 for one.
    """

    def __init__(self, function: ca.Function, parameters: Array, *, lanes: int = 0) -> None:
        """Compile the step, and allocate its inputs, whose parameters do not change."""
        self._step = Compiled(function)
        shape = (lanes,) if lanes else ()
        self._given, self._out = (np.zeros((size, *shape)) for size in (self._step.size_in, self._step.size_out))
        self._given[self._step.slices["parameters"]] = parameters.reshape(-1, *([1] * len(shape)))

    def fly(self, states: Array, duration: float, *, step: float, command: float = 0.0) -> Array:
        """Return the states (N,) or (N, S) after a duration, which is divided into equal steps.

        Args:
            states: states (N,) or (N, S) at the start.
            duration: time from the start to the returned states, s.
            step: length of a step, s, which is changed so that a whole number of steps fits.
            command: value of all inputs: the cart's acceleration, m/s².
        """
        step_inputs, slices, advance = self._given, self._step.slices, self._step
        count = max(1, round(duration / step))
        step_inputs[slices["inputs"]], step_inputs[slices["duration"]] = command, duration / count
        state = step_inputs[slices["state"]]
        state[:] = states
        for _ in range(count):
            state[:] = advance(step_inputs, self._out)
        return state.copy()


def compiled_rate(equations: Equations, parameters: Array, command: float = 0.0) -> Callable[[float, Array], Array]:
    """Return the equations' rate (t, x) -> (N,) for scipy, as machine code.

    Args:
        equations: equations with N states.
        parameters: values (p,).
        command: value of all inputs: the cart's acceleration, m/s².
    """
    values = [command] * equations.input_count + list(parameters)
    rate = ca.substitute(equations.rate, ca.vertcat(equations.inputs, equations.parameters), ca.SX(values))
    rate_function, result = (
        Compiled(ca.Function("rate", [equations.state], [ca.densify(rate)])),
        np.zeros(equations.dimension),
    )
    return lambda _, state: rate_function(state, result).copy()


ENERGY = 0.2
"""Energy of the orbit whose tube is propagated, J."""
LANES = 64
"""Number of trajectories of a tube, and of ticks at once."""
TOLERANCES = (0.0, 1e-12, 1e-9, 1e-6)
"""Tolerances of Taylor's method; zero stands for rounding."""
STEPS = (5e-4, 1e-3, 2e-3, 5e-3)
"""Lengths of fixed steps, s."""
MOST_CALLS = 60_000
"""Number of calls of the rate after which an integrator of scipy is stopped."""
TICK, COMMAND = 1e-3, 5.0
"""Duration in s and command in m/s² of a tick."""


def propagation_chart(quick: bool, progress: Progress) -> ChartPage:
    """Return the errors of integrators against their computing times.

    Args:
        quick: fewer trajectories, settings and repetitions.
        progress: called with a label and the completed share.
    """
    model = load_model("lab")
    system = model.system
    progress("propagation: truth in 113 bits", 0.0)
    orbit = lyapunov_orbit(system, "down-up", energy=ENERGY)
    seeds, _ = UnstableManifold(orbit).seeds(np.arange(LANES) / LANES, 1)
    tube = work_of(system, seeds[:: 8 if quick else 2], 2 * orbit.period)
    # A start from rest, whose initial error grows five-millionfold.
    swing = work_of(system, np.array([[1.7, 2.2, 0.0, 0.0]]), 10.0)
    batch_candidates, swing_candidates = (
        candidates(tube, batches=True, quick=quick),
        candidates(swing, batches=False, quick=quick),
    )
    tube_diagram = compared(batch_candidates, tube, quick=quick, progress=part_of(progress, 0.2, 0.5))
    swing_diagram = compared(swing_candidates, swing, quick=quick, progress=part_of(progress, 0.5, 0.8))
    labels = {"x_label": "time of a trajectory, s", "y_label": "error, scaled"}
    return ChartPage(
        name="propagation",
        title="Propagation",
        parts=(
            replace(tube_diagram, title=f"trajectory of a tube, {tube.duration:.2f} s", **labels),
            replace(swing_diagram, title=f"chaotic swing, {swing.duration:.0f} s", **labels),
            *tick_panels(model.arms, quick=quick),
        ),
        reading=(
            "A mark is a method at a setting: left is faster, low is nearer to 113-bit arithmetic; same start.",
            "Grey joins the front: no method is both faster and nearer than its marks. A ring: dpcontrol's choice.",
            "A chaotic swing (second diagram) multiplies every error by five million on its way.",
        ),
        chosen=(
            "Taylor's method at the tolerance of rounding, eight trajectories at once where there are many: a looser "
            "tolerance saves less than half of the time and costs the digits. Ticks of many plants use DOP853's step "
            "in machine code, the filter's model one step of order 4."
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class Work:
    """Trajectories that all methods propagate, with their true ends.

    Attributes:
        system: Hamiltonian system.
        states: first states (K, N).
        duration: time of the trajectories, s.
        truth: final states (K, N) from 113-bit arithmetic.
    """

    system: System
    states: Array
    duration: float
    truth: Array

    def error(self, arrived: Array) -> float:
        """Return the largest scaled error of final states.

        Args:
            arrived: final states (K, N), or the first ones of them.
        """
        return float(np.abs((arrived - self.truth[: len(arrived)]) / self.system.scale).max())


def work_of(system: System, states: Array, duration: float) -> Work:
    """Return trajectories with their true ends, from 113-bit arithmetic.

    Args:
        system: Hamiltonian system.
        states: first states (K, N) of the trajectories.
        duration: time of the trajectories, s.

    Raises:
        GoalMissed: this build of heyoka has no 113-bit reals.
    """
    exact = ExtendedPropagator(system.equations, system.parameters)
    length = extended(np.array([duration]))[0]
    return Work(
        system, states, duration, np.array([exact.flow(extended(state), length) for state in states]).astype(float)
    )


def compared(tried: list[Alternative[Array]], work: Work, *, quick: bool, progress: Progress = no_progress) -> Diagram:
    """Time each candidate and judge its final states; failures are missing with their reason.

    Args:
        tried: methods at their settings, as from `candidates`.
        work: trajectories with their true ends.
        quick: fewer rounds.
        progress: called with a label and the completed share.
    """

    def judge(_: Alternative[Array], arrived: Array) -> Judged | str:
        """Return the error of final states (K, N) against the true ones of `work`, or the reason if it is infinite."""
        if not np.isfinite(arrived).all():
            return "its step is too long: the state became infinite"
        return Judged(work.error(arrived))

    return compare(tried, judge, rounds=5 if quick else 9, most=0.1 if quick else 1.0, progress=progress)


def candidates(work: Work, *, batches: bool, quick: bool) -> list[Alternative[Array]]:
    """Return all methods for a work's states; slow ones propagate only its first few.

    Args:
        work: trajectories with their true ends.
        batches: add methods that propagate many trajectories at once.
        quick: fewer settings and states.
    """
    first_states = work.states[: 2 if quick else 4]
    return [
        *_taylor(work, batches=batches),
        *_stepped(work, batches=batches, quick=quick),
        *_casadi(work, first_states),
        *_scipy(work, first_states[: 1 if quick else 2], quick=quick),
    ]


def _each(fly: Callable[..., Array], states: Array, *args: Any, **more: Any) -> Callable[[], Array]:
    """Return a function that propagates one state (N,) after the other by `fly`, and returns the ends (K, N)."""
    return lambda: np.array([fly(state, *args, **more) for state in states])


def _together(fly: Callable[..., Array], states: Array, *args: Any, **more: Any) -> Callable[[], Array]:
    """Return a function that propagates all states (K, N) at once by `fly`, and returns the ends (K, N)."""
    return lambda: fly(states.T, *args, **more).T


def _taylor(work: Work, *, batches: bool) -> Iterator[Alternative[Array]]:
    """Yield Taylor's method at several tolerances, one trajectory after the other and, if `batches`, all together.

    `work` has the trajectories to propagate.
    """
    states, seconds = work.states, work.duration
    for tolerance in TOLERANCES:
        propagator = Propagator(work.system.equations, work.system.parameters, tolerance=tolerance)
        label, count = f"{tolerance:.0e}" if tolerance else "rounding", len(states)
        # The package flies a single trajectory alone, many in a batch.
        yield Alternative(
            "Taylor", label, _each(propagator.flow, states, seconds), not (tolerance or batches), units=count
        )
        if batches:
            batch = partial(propagator.flows, states, np.full(count, seconds))
            yield Alternative("Taylor, 8 at once", label, batch, not tolerance, units=count)


def _stepped(work: Work, *, batches: bool, quick: bool) -> Iterator[Alternative[Array]]:
    """Yield the fixed steps in machine code at several lengths, for one trajectory and, if `batches`, for many lanes.

    `work` has the trajectories to propagate; `quick` halves the number of lengths.
    """
    parameters, equations, lanes = work.system.parameters, work.system.equations, len(work.states)
    schemes = {"RK4, compiled": classical_step(equations), "DOP853 step, compiled": fixed_step(equations)}
    first_states = work.states[:2]
    for method, function in schemes.items():
        single, many = Stepper(function, parameters), Stepper(function, parameters, lanes=lanes)
        for step in STEPS[1::2] if quick else STEPS:
            label = f"{1e3 * step:g} ms"
            yield Alternative(
                method, label, _each(single.fly, first_states, work.duration, step=step), units=len(first_states)
            )
            if batches:
                fly = _together(many.fly, work.states, work.duration, step=step)
                yield Alternative(f"{method}, {lanes} at once", label, fly, units=lanes)


def _casadi(work: Work, states: Array) -> Iterator[Alternative[Array]]:
    """Yield the integrators of CasADi for `states` (K, N), which are the first ones of the trajectories of `work`."""
    equations, parameters = work.system.equations, ca.DM(work.system.parameters)
    program = {"x": equations.state, "p": equations.parameters, "ode": equations.rate}
    # The error shows any stalled steps.
    step_options = {"max_num_steps": 1_000_000, "disable_internal_warnings": True}
    cases: list[tuple[str, str, str, dict[str, Any]]] = [
        (kind.upper(), f"{tolerance:.0e}", kind, {"reltol": tolerance, "abstol": tolerance, **step_options})
        for kind, tolerances in (("cvodes", (1e-12, 1e-9, 1e-6)), ("idas", (1e-9, 1e-6)))
        for tolerance in tolerances
    ]
    cases += [
        ("RK of CasADi", f"{1e3 * step:g} ms", "rk", {"number_of_finite_elements": round(work.duration / step)})
        for step in (1e-3, 5e-3)
    ]
    for method, label, kind, options in cases:
        flow = ca.integrator("flow", kind, program, 0.0, work.duration, options)
        yield Alternative(method, label, _each(partial(_by_casadi, flow, p=parameters), states), units=len(states))


def _by_casadi(flow: ca.Function, x: Array, **inputs: Any) -> Array:
    """Return the final state (N,) of an integrator of CasADi from the state `x` (N,), with further inputs by name."""
    return np.array(flow(x0=x, **inputs)["xf"]).ravel()


def _scipy(work: Work, states: Array, *, quick: bool) -> Iterator[Alternative[Array]]:
    """Yield the integrators of scipy for `states` (K, N), which are the first ones of the trajectories of `work`.

    `quick` omits one tolerance of Radau's method.
    """
    rate = compiled_rate(work.system.equations, work.system.parameters)
    cases = [(method, tolerance, {}) for method in ("DOP853", "LSODA") for tolerance in (1e-12, 1e-9, 1e-6)]
    # Radau may repeat a tiny last step endlessly, so the rate's calls are counted.
    radau_options = {"jac": lambda _, x: work.system.numeric.jacobian(x), "max_step": 0.05}
    cases += [("Radau", tolerance, radau_options) for tolerance in ((1e-6,) if quick else (1e-8, 1e-6))]
    for method, tolerance, options in cases:
        fly = _each(partial(_by_scipy, rate, work.duration, method, tolerance, options), states)
        yield Alternative(f"{method} of scipy", f"{tolerance:.0e}", fly, units=len(states))


def _by_scipy(
    rate: Callable[[float, Array], Array], seconds: float, method: str, tolerance: float, more: Mapping[str, Any],
    x: Array,
) -> Array:  # fmt: skip
    """Return the final state (N,) of a trajectory from `x` (N,) by an integrator of scipy.

    Args:
        rate: rate of the equations, (t, x) -> (N,).
        seconds: duration of the trajectory, s.
        method: name of the integrator in `solve_ivp`, such as "DOP853".
        tolerance: relative and absolute tolerance.
        more: further options of `solve_ivp`.
        x: first state (N,).

    Raises:
        ArithmeticError: the integrator failed or needed too many calls of the rate.
    """
    calls_left = iter(range(MOST_CALLS))

    def counted_rate(time: float, state: Array) -> Array:
        """Return the rate (N,), or raise an `ArithmeticError` after `MOST_CALLS` calls."""
        if next(calls_left, None) is None:
            raise ArithmeticError(f"given up after {MOST_CALLS:,} calls of the rate")
        return rate(time, state)

    solution = solve_ivp(counted_rate, (0.0, seconds), x, method=method, rtol=tolerance, atol=tolerance, **more)
    if not solution.success:
        raise ArithmeticError(solution.message)
    return solution.y[:, -1]


def exact_ticks(equations: Equations, parameters: Array, states: Array) -> Array:
    """Return the states (K, N) one tick (`TICK`, s) later under the held `COMMAND`, m/s², from 113-bit arithmetic.

    The errors of faster methods are measured against them.

    Args:
        equations: equations with one input, the cart's acceleration.
        parameters: values (p,) of their parameters.
        states: states (K, N) at the start of the tick.
    """
    # The held input joins the parameters, which the extended propagator uses exactly.
    with_held_input = replace(
        equations, inputs=ca.SX.zeros(0), parameters=ca.vertcat(equations.parameters, equations.inputs)
    )
    flow = ExtendedPropagator(with_held_input, np.append(parameters, COMMAND))
    tick = extended(np.array([TICK]))[0]
    return np.array([flow.flow(extended(state), tick) for state in states]).astype(float)


def tick_panels(arms: ArmChainParameters, *, quick: bool) -> tuple[Diagram, Diagram]:
    """Return the diagrams of a tick's time and error, for a single run and for many runs at once.

    The arms have friction, and the cart's acceleration is held for a millisecond. Plants take one step of DOP853, in
    one run or in many. The filter's model takes one step of order 4. Each is the default of its use.

    Args:
        arms: arms with friction.
        quick: fewer rounds.
    """
    equations, parameters = equations_of(arms, Level.CART), arms.base()
    plant = PolynomialInputPropagator(equations, parameters, degree=0)
    # States along 3 s of free swing from high up, with the cart moving.
    start = np.concatenate([np.full(arms.count, 2.5), np.zeros(equations.dimension - arms.count - 1), [0.1]])
    states = plant.sample(start, np.zeros(1), np.linspace(0.0, 3.0, LANES))
    truth = exact_ticks(equations, parameters, states)
    scale = state_scale(equations.dimension, Limits())
    model = SampledModel(equations, parameters, period=TICK)
    program = {"x": equations.state, "u": equations.inputs, "p": equations.parameters, "ode": equations.rate}
    cvodes = ca.integrator("tick", "cvodes", program, 0.0, TICK, {"reltol": 1e-10, "abstol": 1e-10})
    rate = compiled_rate(equations, parameters, COMMAND)
    rows = [
        ("Taylor", "rounding", _each(plant.flow, states, np.array([COMMAND]), TICK), False),
        ("RK4 of CasADi, buffered", "filter's model", _each(model.step, states, COMMAND), True),
        ("CVODES", "1e-10", _each(partial(_by_casadi, cvodes, u=COMMAND, p=parameters), states), False),
        ("DOP853 of scipy", "1e-10", _each(partial(_by_scipy, rate, TICK, "DOP853", 1e-10, {}), states), False),
    ]
    steppers = [("RK4, compiled", classical_step(equations), pieces, False) for pieces in (1, 2)]
    for label, function, pieces, is_default in [*steppers, ("DOP853 step, compiled", fixed_step(equations), 1, True)]:
        single, many = Stepper(function, parameters), Stepper(function, parameters, lanes=LANES)
        setting, step_options = f"{pieces} step{'s' * (pieces > 1)}", {"step": TICK / pieces, "command": COMMAND}
        rows.append((label, setting, _each(single.fly, states, TICK, **step_options), is_default))
        rows.append(
            (f"{label}, {LANES} at once", setting, _together(many.fly, states, TICK, **step_options), is_default)
        )
    alternatives = [Alternative(*single, units=LANES) for single in rows]

    def judge(_: Alternative[Array], arrived: Array) -> Judged:
        """Return the largest scaled error of states (K, N) after a tick, against those from 113-bit arithmetic."""
        return Judged(float(np.abs((arrived - truth) / scale).max()))

    ticks = compare(alternatives, judge, rounds=9 if quick else 25)
    single_run, many_runs = (
        replace(
            ticks, title=f"a tick of 1 ms, {what}", x_label="time of a tick, s", y_label="error, scaled", floor=1e-15,
            points=tuple(point for point in ticks.points if ("at once" in point.method) is many),
        )
        for what, many in (("one run", False), (f"{LANES} runs", True))
    )  # fmt: skip
    return single_run, many_runs
