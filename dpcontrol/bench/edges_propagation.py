"""Where fixed steps end: the longest step with which a motion about an equilibrium still dies out, method by method.

About an equilibrium a method multiplies the motion of an eigenvalue s by its stability function in a step,

    R(sh) = 1 + sh bᵀ (I - sh A)⁻¹ 1,      |R(sh)| ≤ 1 for those with Re s < 0

The first step at which |R| passes 1 makes a motion grow that dies out in truth: -λ of a saddle, or an oscillation that
friction damps. Measured with the product's own compiled steps on the nonlinear equations; predicted from A, b alone.

Source: Hairer & Wanner, Solving Ordinary Differential Equations II (1996), section IV.2.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

from dpcontrol.bench.edges import Attempt, Border, EdgeChart, EdgeMap, find_border
from dpcontrol.bench.edges_control import HELD_ERROR, ROOM, STRONG, held
from dpcontrol.bench.schemes import Stepper
from dpcontrol.control.model import SampledModel
from dpcontrol.dynamics.chain import ArmChainParameters, Level, arm_chain_equations
from dpcontrol.dynamics.compiled import fixed_step
from dpcontrol.dynamics.plant import PlantParameters, longest_step
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import Progress
from dpcontrol.references.problem import Limits
from dpcontrol.scenes.model import load_model

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Step = Callable[[Array, float], Array]
"""(state (N,), length in s) -> following state (N,)."""

SADDLES = ("down-down", "down-up", "up-down", "up-up")
AMPLITUDE = 1e-6
"""Of the motion at the start: small, so that it stays linear, and large against rounding."""
STEPS = 3
"""Few: rounding, in the direction that grows, must not reach the motion that is looked at."""
RK4 = (np.array([[0, 0, 0, 0], [0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1.0, 0]]), np.array([1, 2, 2, 1]) / 6)
DOP = (np.array(DOP853.A), np.array(DOP853.B))


def chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: two saddles."""
    arms = load_model("lab").arms
    saddles = ("down-up", "up-up") if quick else SADDLES
    split = longest_step(PlantParameters(arms))
    maps = []
    for title, tableau, step, says in (
        ("Model of controllers and filters: Runge-Kutta 4", RK4, model_step(arms), _run_at),
        ("Plant: 12 stages of DOP853", DOP, plant_step(arms),
         lambda h, saddle: f"never taken: the simulated bench splits what is longer than {split:g} s"),
    ):  # fmt: skip
        borders = []
        for k, saddle in enumerate(saddles):
            progress(f"edges of propagation, {title}, {saddle}", (len(maps) + k / len(saddles)) / 2)
            borders.append(step_border(arms, saddle, x=k + 1.0, tableau=tableau, step=step, says=says))
        maps.append(
            EdgeMap(title, "equilibrium", "step, s", tuple(borders), log_x=False, far="grows, though it should die out",
                    theory="|R(sh)| = 1 for the first of the motions that die out")
        )  # fmt: skip
    return EdgeChart(
        name="edges-propagation",
        title="Where fixed steps end: near the equilibria",
        maps=tuple(maps),
        reading=(
            "The longest step with which all motions that die out about an equilibrium do so: the fastest decides.",
            "Diamonds: from the method's coefficients and the eigenvalues alone.",
            "Loops of 25 Hz are five times from the border of their model, those of 1 kHz two hundred times.",
        ),
        chosen="Runge-Kutta 4 between ticks, stable down to 5 Hz; at most 2 ms at a time in the plant.",
    )  # fmt: skip


def model_step(arms: ArmChainParameters) -> Step:
    """Return the step of controllers' and filters' model, of any length, the cart's acceleration zero."""
    equations = arm_chain_equations(arms.count, Level.CART, friction=arms.friction)
    return lambda x, h: SampledModel(equations, arms.base(), period=h).step(x, 0.0)


def plant_step(arms: ArmChainParameters) -> Step:
    """Return the step of simulated plants, of any length, the cart's acceleration zero."""
    equations = arm_chain_equations(arms.count, Level.CART, friction=arms.friction)
    stepper = Stepper(fixed_step(equations), arms.base())
    return lambda x, h: stepper.fly(x, h, step=h)


def stability(tableau: tuple[Array, Array], z: complex) -> complex:
    """Return R(z) of an explicit method's A (S, S) and b (S,)."""
    a, b = tableau
    return complex(1 + z * b @ np.linalg.solve(np.eye(len(b)) - z * a, np.ones(len(b))))


def predicted_step(tableau: tuple[Array, Array], values: Complex, *, longest: float = 5.0) -> float:
    """Return the step in s at which the first of the eigenvalues `values` in 1/s, all damped, has |R| = 1."""
    steps = np.linspace(1e-3, longest, 5000) / np.abs(values).max() * 2

    def stable(step: float) -> bool:
        return max(abs(stability(tableau, s * step)) for s in values) <= 1

    low, high = next(((low, high) for low, high in pairwise(steps.tolist()) if not stable(high)), (0.0, 0.0))
    if not high:
        raise ValueError("no border up to the longest step")
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def decaying(arms: ArmChainParameters, saddle: str) -> tuple[Array, Complex, Complex, Complex]:
    """Return the equilibrium (N,), the damped eigenvalues (m,) in 1/s, their vectors (m, N) and left vectors (m, N)."""
    e = arm_chain_equations(arms.count, Level.CART, friction=arms.friction)
    state = np.concatenate([load_model("lab").system.equilibrium(saddle), np.zeros(2)])
    linear = ca.Function("linear", [e.state, e.inputs, e.parameters], [ca.jacobian(e.rate, e.state)])
    n = 2 * arms.count
    pairs = np.linalg.eig(np.array(linear(state, 0.0, arms.base()))[:n, :n].astype(np.complex128))
    values, right = (np.asarray(found, dtype=np.complex128) for found in pairs)
    damped = np.flatnonzero(values.real < -1e-9)
    left: Complex = np.asarray(np.linalg.inv(right), dtype=np.complex128)
    cart = np.zeros((len(damped), len(state) - n), dtype=np.complex128)
    return state, values[damped], np.hstack([right.T[damped], cart]), np.hstack([left[damped], cart])


def step_border(
    arms: ArmChainParameters, saddle: str, *, x: float, tableau: tuple[Array, Array], step: Step,
    says: Callable[[float, str], str], ratio: float = 1.05,
) -> Border:  # fmt: skip
    """Return the border of the step's length at an equilibrium."""
    state, values, right, left = decaying(arms, saddle)
    predicted = predicted_step(tableau, values)

    def probe(h: float) -> Attempt:
        for vector, dual in zip(right, left, strict=True):
            y = state + AMPLITUDE * np.real(vector) / np.abs(vector).max()
            before = abs(dual @ (y - state))
            for _ in range(STEPS):
                y = step(y, h)
            if abs(dual @ (y - state)) > before:
                return Attempt(False)
        return Attempt(True)

    found = find_border(
        probe, x=x, line=saddle, near=predicted / 1.5, far=1.5 * predicted, predicted=predicted, ratio=ratio
    )
    # Asked once, for it takes a run.
    return replace(found, says=says(found.far, saddle)) if found.far else found


def _run_at(h: float, saddle: str) -> str:
    """Return what a run says whose period is as long as the step, arms held at the equilibrium."""
    try:
        stand = held(1 / h, saddle=saddle, seconds=60.0)
    except (InputError, GoalMissed) as error:
        return str(error)
    limits = Limits(position=ROOM, velocity=ROOM, acceleration=STRONG)
    return stand.run(limits=limits, error=HELD_ERROR).says
