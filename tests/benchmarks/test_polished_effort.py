"""Polished plans against an independent joint optimum, on itineraries that are not shipped.

    pytest -m benchmark tests/benchmarks/test_polished_effort.py -s

The independent optimum has the textbook's equations, casadi's Opti, trapezoidal collocation every 10 ms, and starts
from the same robust plan, with the same ends, time, holds and limits. Where its free optimum leaves the walk, it is
held to the robust plan by a weight, as small as keeps it.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from textbook import TwoArms

from dpcontrol import api
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.plans.plan import Plan
from dpcontrol.references.reference import Reference
from dpcontrol.runs.polish import SHARE, departure, stretches

RUNS, WORKERS = 48, 0
"""Runs of each plan, and processes."""
BAR = 1.1
STEP = 0.01
ENDS = 'start = "rest"\nfinish = "rest"\n'
HEAD = f'model = "lab"\n{ENDS}'
PART = '[[parts]]\nenergy = {}\nwalk = ["{}"]\nwraps = []\n'
SCENES = {
    "there-and-back": f'energy = 0.2\nwalk = ["down-up > up-down", "up-down > down-up"]\nwraps = [1]\n{HEAD}',
    "two-turns": HEAD + PART.format(-0.07, "down-up +") + PART.format(0.1, "down-up +"),
    "turn-and-stand": HEAD + PART.format(0.0, "down-up -") + '[[parts]]\nhold = "up-up"\nseconds = 2.0\n',
}


@dataclass
class Sampled:
    """A motion as its states (K, 6) at even times from 0 s: as much of a reference as `departure` looks at."""

    duration: float
    states: np.ndarray
    mesh: tuple[float, ...] = (0.0,)

    def state(self, times: np.ndarray) -> np.ndarray:
        clock = np.linspace(0.0, self.duration, len(self.states))
        return np.stack([np.interp(times, clock, column) for column in self.states.T], axis=-1)


def acceleration(arms: ArmChainParameters) -> ca.Function:
    """Return (state, input) -> rate of change, for arms on a cart with prescribed acceleration, by the textbook."""
    state, push = ca.SX.sym("x", 6), ca.SX.sym("u")
    rate = ca.vertcat(*TwoArms(arms, viscous=arms.viscous).slope(state, push), state[5], push)
    return ca.Function("rate", [state, push], [rate])


def joint_optimum(plan: Plan, begin: float, end: float, weight: float) -> tuple[np.ndarray, float]:
    """Return states (K, 6) and effort of the optimum from `begin` to `end` s, started at the plan."""
    count = round((end - begin) / STEP) + 1
    times, h = np.linspace(begin, end, count), (end - begin) / (count - 1)
    robust = plan.reference
    first, pushes = robust.state(times).T, robust.input(times).T
    opti = ca.Opti()
    x, u = opti.variable(6, count), opti.variable(1, count)
    slope = acceleration(plan.itinerary.model.arms).map(count)(x, u)
    opti.subject_to(ca.vec(x[:, 1:] - x[:, :-1] - h / 2 * (slope[:, 1:] + slope[:, :-1])) == 0)
    opti.subject_to(x[:, 0] == first[:, 0])
    opti.subject_to(x[:, -1] == first[:, -1])
    bounds = {name: max(SHARE * bound, robust.largest[name]) for name, bound in plan.itinerary.limits.named().items()}
    for values, name in ((x[4, :], "position"), (x[5, :], "velocity"), (u, "acceleration")):
        opti.subject_to(opti.bounded(-bounds[name], ca.vec(values), bounds[name]))
    effort = h * (ca.sumsqr(u) - (u[0] ** 2 + u[-1] ** 2) / 2)
    away = (x[:4, :] - first[:4]) / ca.DM([np.pi, np.pi, 10, 10])
    opti.minimize(effort + weight * h * ca.sumsqr(away))
    opti.set_initial(x, first)
    opti.set_initial(u, pushes)
    # With IPOPT's default barrier, the search along two turns stalls from iteration 140 on.
    options = {"print_level": 0, "max_iter": 500, "tol": 1e-6, "mu_strategy": "adaptive"}
    opti.solver("ipopt", {"print_time": False}, options)
    found = opti.solve()
    return np.array(found.value(x)).T, float(found.value(effort))


def independent(plan: Plan) -> float:
    """Return the effort of the independent optimum that keeps the walk."""
    for weight in (0.0, 1.0, 10.0):
        pieces, total = list[np.ndarray](), 0.0
        for begin, end, moves in stretches(plan.reference):
            times = np.linspace(begin, end, round((end - begin) / STEP) + 1)
            if moves:
                states, effort = joint_optimum(plan, begin, end, weight)
                total += effort
            else:
                states = plan.reference.state(times)
            even = np.arange(begin, end, 1e-3)
            pieces.append(np.stack([np.interp(even, times, column) for column in states.T], axis=-1))
        whole: Reference = Sampled(plan.reference.duration, np.concatenate(pieces))  # type: ignore[assignment]
        if not departure(plan.reference, whole):
            return total
    pytest.fail("no independent optimum keeps the walk")


@pytest.mark.benchmark
@pytest.mark.parametrize("name", SCENES)
def test_a_polished_plan_costs_no_more_than_a_tenth_above_an_independent_optimum(name: str, tmp_path: Path) -> None:
    file = tmp_path / f"{name}.toml"
    file.write_text(SCENES[name])
    found = api.polish(str(file), runs=RUNS, workers=WORKERS)
    assert found.converged, found.status
    alone = independent(found.robust)
    robust, polished = found.sides
    efforts = f"robust {robust.effort:.1f}, polished {polished.effort:.1f}, independent {alone:.1f} m²/s³"
    sys.stdout.write(f"\n{name}: {efforts}; {[side.completed for side in found.sides]}\n")
    assert polished.effort <= BAR * alone
