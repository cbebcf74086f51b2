"""Flights of the same states by each method: Taylor's, compiled and symplectic schemes, CasADi's and scipy's.

Errors are against 113-bit arithmetic; the energy drift is the largest change of H over the energy scale.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from dpcontrol.bench.schemes import Stepper, buffered_rate, runge_kutta_4, symplectic_gauss
from dpcontrol.dynamics.compiled import fixed_step
from dpcontrol.dynamics.extended import ExtendedPropagator, extended
from dpcontrol.dynamics.propagator import Propagator, SegmentPropagator
from dpcontrol.dynamics.system import System

Array = NDArray[np.float64]

TAYLOR = (0.0, 1e-12, 1e-9, 1e-6)
STEPS = (5e-4, 1e-3, 2e-3, 5e-3)
MOST_CALLS = 60_000


@dataclass(frozen=True)
class Work:
    """States (K, N) to be flown for `duration` s, and where they arrive (K, N) by 113-bit arithmetic."""

    system: System
    states: Array
    duration: float
    truth: Array

    @cached_property
    def energies(self) -> Array:
        """Energies (K,) of the states."""
        return self.system.numeric.hamiltonian(self.states)

    def error(self, arrived: Array) -> float:
        """Return the largest scaled error of arrivals (K, N)."""
        return float(np.abs((arrived - self.truth[: len(arrived)]) / self.system.scale).max())

    def drift(self, arrived: Array) -> float:
        """Return the largest change of the energy over the energy scale."""
        change = self.system.numeric.hamiltonian(arrived) - self.energies[: len(arrived)]
        return float(np.abs(change).max() / self.system.energy_scale)


@dataclass(frozen=True)
class Candidate:
    """A method at one setting: flies `take` of a work's states and returns the arrivals (take, N)."""

    method: str
    setting: str
    fly: Callable[[], Array]
    take: int
    default: bool = False


def work_of(system: System, states: Array, duration: float) -> Work:
    """Return the work with its truth.

    Raises:
        GoalMissed: this build of heyoka has no 113-bit reals.
    """
    exact = ExtendedPropagator(system.equations, system.parameters)
    length = extended(np.array([duration]))[0]
    return Work(system, states, duration, np.array([exact.flow(extended(x), length) for x in states]).astype(float))


def candidates(work: Work, *, batches: bool, quick: bool) -> list[Candidate]:
    """Return all methods; slow ones fly fewer trajectories. batches: also many at once."""
    few = work.states[: 2 if quick else 4]
    return [
        *_taylor(work, batches=batches),
        *_stepped(work, batches=batches, quick=quick),
        *_casadi(work, few),
        *_scipy(work, few[: 1 if quick else 2], quick=quick),
    ]


def _taylor(work: Work, *, batches: bool) -> list[Candidate]:
    system, states, seconds = work.system, work.states, work.duration
    found = []
    for tolerance in TAYLOR:
        one = Propagator(system.equations, system.parameters, tolerance=tolerance)
        label = f"{tolerance:.0e}" if tolerance else "rounding"

        def fly(one: Propagator = one) -> Array:
            return np.array([one.flow(x, seconds) for x in states])

        # The product flies one trajectory by itself, many in a batch.
        found.append(Candidate("Taylor", label, fly, len(states), default=not tolerance and not batches))
        if batches:
            many = SegmentPropagator(one)
            durations = np.full(len(states), seconds)

            def fly_many(many: SegmentPropagator = many, durations: Array = durations) -> Array:
                return many.flows(states, durations)

            found.append(Candidate("Taylor, 8 at once", label, fly_many, len(states), default=not tolerance))
    return found


def _stepped(work: Work, *, batches: bool, quick: bool) -> list[Candidate]:
    system, equations = work.system, work.system.equations
    schemes = {
        "RK4, compiled": runge_kutta_4(equations),
        "DOP853 step, compiled": fixed_step(equations),
        "implicit midpoint": symplectic_gauss(equations, 1),
        "Gauss 4, symplectic": symplectic_gauss(equations, 2),
        "Gauss 6, symplectic": symplectic_gauss(equations, 3),
    }
    found = []
    for method, function in schemes.items():
        one = Stepper(function, system.parameters)
        lanes = len(work.states)
        many = Stepper(function, system.parameters, lanes=lanes)
        for step in STEPS[1::2] if quick else STEPS:
            label = f"{1e3 * step:g} ms"

            def fly(one: Stepper = one, step: float = step) -> Array:
                return np.array([one.fly(x, work.duration, step=step) for x in work.states[:2]])

            found.append(Candidate(method, label, fly, min(lanes, 2)))
            if batches and method in ("RK4, compiled", "DOP853 step, compiled"):

                def fly_many(many: Stepper = many, step: float = step) -> Array:
                    return many.fly(work.states.T, work.duration, step=step).T

                found.append(Candidate(f"{method}, {lanes} at once", label, fly_many, lanes))
    return found


def _casadi(work: Work, states: Array) -> list[Candidate]:
    e, parameters = work.system.equations, ca.DM(work.system.parameters)
    program = {"x": e.state, "p": e.parameters, "ode": e.rate}
    cases: list[tuple[str, str, str, dict[str, Any]]] = [
        (kind.upper(), f"{tolerance:.0e}", kind, {"reltol": tolerance, "abstol": tolerance, "max_num_steps": 1_000_000})
        for kind in ("cvodes", "idas")
        for tolerance in ((1e-12, 1e-9, 1e-6) if kind == "cvodes" else (1e-9, 1e-6))
    ]
    cases += [
        ("RK of CasADi", f"{1e3 * step:g} ms", "rk", {"number_of_finite_elements": round(work.duration / step)})
        for step in (1e-3, 5e-3)
    ]
    found = []
    for method, label, kind, options in cases:
        # The error shows where its steps stalled.
        if kind != "rk":
            options = {**options, "disable_internal_warnings": True}
        flow = ca.integrator("flow", kind, program, 0.0, work.duration, options)

        def fly(flow: ca.Function = flow) -> Array:
            return np.array([np.array(flow(x0=x, p=parameters)["xf"]).ravel() for x in states])

        found.append(Candidate(method, label, fly, len(states)))
    return found


def _scipy(work: Work, states: Array, *, quick: bool) -> list[Candidate]:
    rate = buffered_rate(work.system.equations, work.system.parameters)
    found = []
    cases = [(method, tolerance) for method in ("DOP853", "LSODA") for tolerance in (1e-12, 1e-9, 1e-6)]
    cases += [("Radau", tolerance) for tolerance in ((1e-6,) if quick else (1e-8, 1e-6))]
    for method, tolerance in cases:
        # Radau may repeat a last step of nearly no length without end: the rate's calls are counted.
        more: dict[str, Any] = {"jac": _jacobian(work.system), "max_step": 0.05} if method == "Radau" else {}

        def fly(method: str = method, tolerance: float = tolerance, more: dict[str, Any] = more) -> Array:
            ends = []
            for x in states:
                run = solve_ivp(
                    _counted(rate), (0.0, work.duration), x, method=method, rtol=tolerance, atol=tolerance, **more
                )
                if not run.success:
                    raise ArithmeticError(run.message)
                ends.append(run.y[:, -1])
            return np.array(ends)

        found.append(Candidate(f"{method} of scipy", f"{tolerance:.0e}", fly, len(states)))
    return found


def _counted(rate: Callable[[float, Array], Array]) -> Callable[[float, Array], Array]:
    """Return the rate, which gives up after MOST_CALLS."""
    left = iter(range(MOST_CALLS))

    def called(time: float, state: Array) -> Array:
        if next(left, None) is None:
            raise ArithmeticError(f"given up after {MOST_CALLS:,} calls of the rate")
        return rate(time, state)

    return called


def _jacobian(system: System) -> Callable[[float, Array], Array]:
    return lambda _, x: system.numeric.jacobian(x)
