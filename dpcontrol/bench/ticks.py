"""One tick of the closed loop: the arms with friction on a cart whose acceleration is held for a millisecond.

Plants are flown by one step of DOP853 as machine code, one run as many; the filter's model takes one step of order 4.
Each is the default of its own use. Errors are against 113-bit arithmetic, over states of a fast swing.
"""

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from dpcontrol.bench.chart import Panel, Point
from dpcontrol.bench.measure import timed_in_turns
from dpcontrol.bench.schemes import Stepper, runge_kutta_4
from dpcontrol.control.model import SampledModel
from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.dynamics.compiled import fixed_step
from dpcontrol.dynamics.equations import Equations
from dpcontrol.dynamics.extended import ExtendedPropagator, extended
from dpcontrol.dynamics.polynomial_input import PolynomialInputPropagator
from dpcontrol.references.problem import Limits, state_scale

Array = NDArray[np.float64]

TICK = 1e-3
COMMAND = 5.0
COUNT = 64
ROUNDING = 1e-15


def tick_states(arms: ArmChainParameters) -> Array:
    """Return states (COUNT, N) along 3 s of free swing from high up, the cart moving."""
    equations = equations_of(arms, Level.CART)
    flow = PolynomialInputPropagator(equations, arms.base(), degree=0)
    start = np.zeros(equations.dimension)
    start[: arms.count] = 2.5
    start[-1] = 0.1
    return flow.sample(start, np.zeros(1), np.linspace(0.0, 3.0, COUNT))


def exact_ticks(equations: Equations, parameters: Array, states: Array) -> Array:
    """Return where the states are a tick later, from 113-bit arithmetic."""
    # The held input joins the parameters, which the extended propagator takes exactly.
    held = replace(equations, inputs=ca.SX.zeros(0), parameters=ca.vertcat(equations.parameters, equations.inputs))
    flow = ExtendedPropagator(held, np.append(parameters, COMMAND))
    tick = extended(np.array([TICK]))[0]
    return np.array([flow.flow(extended(x), tick) for x in states]).astype(float)


def tick_panels(arms: ArmChainParameters, *, quick: bool) -> tuple[Panel, Panel]:
    """Return the diagrams of a tick's time and error: of one run, and of many at once."""
    equations, parameters = equations_of(arms, Level.CART), arms.base()
    states = tick_states(arms)
    truth = exact_ticks(equations, parameters, states)
    scale = state_scale(equations.dimension, Limits())
    plant = PolynomialInputPropagator(equations, parameters, degree=0)
    model = SampledModel(equations, parameters, period=TICK)
    command = np.array([COMMAND])
    rk4, dop853 = runge_kutta_4(equations), fixed_step(equations)
    one = {name: Stepper(f, parameters) for name, f in (("rk4", rk4), ("dop853", dop853))}
    many = {name: Stepper(f, parameters, lanes=COUNT) for name, f in (("rk4", rk4), ("dop853", dop853))}
    program = {"x": equations.state, "u": equations.inputs, "p": equations.parameters, "ode": equations.rate}
    cvodes = ca.integrator("tick", "cvodes", program, 0.0, TICK, {"reltol": 1e-10, "abstol": 1e-10})
    rate = equations.function()

    def each(after: Callable[[Array], Array]) -> Callable[[], Array]:
        return lambda: np.array([after(x) for x in states])

    def by_cvodes(x: Array) -> Array:
        return np.array(cvodes(x0=x, u=COMMAND, p=parameters)["xf"]).ravel()

    def by_scipy(x: Array) -> Array:
        def slope(_: float, y: Array) -> Array:
            return np.array(rate(y, COMMAND, parameters)).ravel()

        return solve_ivp(slope, (0.0, TICK), x, method="DOP853", rtol=1e-10, atol=1e-10).y[:, -1]

    tried: list[tuple[str, str, Callable[[], Array], bool]] = [
        ("Taylor", "rounding", each(lambda x: plant.flow(x, command, TICK)), False),
        ("RK4 of CasADi, buffered", "filter's model", each(lambda x: model.step(x, COMMAND)), True),
        ("CVODES", "1e-10", each(by_cvodes), False),
        ("DOP853 of scipy", "1e-10", each(by_scipy), False),
    ]
    for name, label in (("rk4", "RK4, compiled"), ("dop853", "DOP853 step, compiled")):
        for pieces in (1, 2) if name == "rk4" else (1,):

            def after(x: Array, name: str = name, pieces: int = pieces) -> Array:
                return one[name].fly(x, TICK, step=TICK / pieces, command=COMMAND)

            def after_all(name: str = name, pieces: int = pieces) -> Array:
                return many[name].fly(states.T, TICK, step=TICK / pieces, command=COMMAND).T

            setting, flown = f"{pieces} step{'s' * (pieces > 1)}", name == "dop853"
            tried.append((label, setting, each(after), flown))
            tried.append((f"{label}, {COUNT} at once", setting, after_all, flown))
    points, start_up = [], {}
    runs = timed_in_turns({k: function for k, (_, _, function, _) in enumerate(tried)}, 9 if quick else 25)
    for (method, setting, _, default), run in zip(tried, runs.values(), strict=True):
        error = float(np.abs((run.result - truth) / scale).max())
        start_up[method] = max(start_up.get(method, 0.0), run.start_up)
        seconds = run.seconds / len(states)
        points.append(Point(method, setting, seconds, error, default=default, yardstick=run.yardstick))
    one_run = tuple(p for p in points if "at once" not in p.method)
    batch_points = tuple(p for p in points if "at once" in p.method)
    label = "time, s per tick"
    return (
        Panel("a tick of 1 ms, one run", label, "error, scaled", one_run, start_up, floor=ROUNDING),
        Panel(f"a tick of 1 ms, {COUNT} runs", label, "error, scaled", batch_points, start_up, floor=ROUNDING),
    )
