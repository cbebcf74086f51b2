"""Base-parameter ratios, which a clamped cart determines, and the nearest arms with given ratios."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from dpcontrol.dynamics.chain import (
    ArmChainParameters,
    Friction,
    Level,
    base_from_ratios,
    base_ratios,
    equations_of,
    nearest_arms,
    ratio_names,
    with_laws,
)
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.plans.model import load_model

# A few rounding errors.
EXACT = 1e-12
# Error of scipy's constrained minimiser.
MINIMISED = 1e-6

LAB = with_laws(load_model("lab").arms, tuple(Friction))
LAB = replace(LAB, coulomb=(3e-4, 2e-4), quadratic=(2e-3, 1e-3))
TRIPLE = load_model("triple").arms
SINGLE = replace(
    LAB, **{k: getattr(LAB, k)[:1] for k in ("mass", "centre_of_mass", "length", "inertia", "viscous", *Friction)}
)
EACH = pytest.mark.parametrize("arms", [SINGLE, LAB, TRIPLE], ids=["single", "double", "triple"])


def grown(arms: ArmChainParameters, factor: float) -> ArmChainParameters:
    names = ("mass", "inertia", "viscous", *arms.friction)
    return replace(arms, **{name: tuple(factor * v for v in getattr(arms, name)) for name in names})


@EACH
def test_scaled_arms_have_the_same_motion_and_ratios(arms: ArmChainParameters) -> None:
    larger = grown(arms, 3.7)
    rate = equations_of(arms, Level.DISSIPATIVE).function()
    state = np.linspace(0.3, 2.0, 2 * arms.count)
    assert np.allclose(rate(state, [], arms.base()), rate(state, [], larger.base()), rtol=1e-9, atol=0)
    assert base_ratios(larger) == pytest.approx(base_ratios(arms), rel=EXACT)


@EACH
def test_equations_from_ratios_equal_those_of_the_arms(arms: ArmChainParameters) -> None:
    rate = equations_of(arms, Level.CART).function()
    state = np.linspace(-0.7, 2.0, 2 * arms.count + 2)
    again = base_from_ratios(base_ratios(arms), arms)
    assert np.allclose(rate(state, 1.3, arms.base()), rate(state, 1.3, again), rtol=1e-9, atol=0)
    assert len(ratio_names(arms)) == len(base_ratios(arms))


@EACH
def test_nearest_arms_have_the_requested_ratios(arms: ArmChainParameters) -> None:
    wanted = base_ratios(arms) * np.random.default_rng(1).uniform(0.97, 1.03, len(base_ratios(arms)))
    assert base_ratios(nearest_arms(wanted, arms)) == pytest.approx(wanted, rel=1e-9)


def test_the_nearest_arms_agree_with_constrained_minimisation() -> None:
    wanted = base_ratios(LAB) * np.array([1.02, 0.99, 1.01, 1.015, 1, 1, 1, 1, 1, 1])
    columns = ("mass", "centre_of_mass", "inertia")

    def arms_at(logs: np.ndarray) -> ArmChainParameters:
        values = {name: tuple(getattr(LAB, name) * np.exp(logs[2 * k : 2 * k + 2])) for k, name in enumerate(columns)}
        return replace(LAB, **values, length=(LAB.length[0] * float(np.exp(logs[6])), LAB.length[1]))

    found = minimize(
        lambda logs: logs @ logs,
        np.zeros(7),
        constraints={"type": "eq", "fun": lambda logs: np.log(base_ratios(arms_at(logs))[:4] / wanted[:4])},
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    ours = nearest_arms(wanted, LAB)
    logs = np.concatenate([np.log(np.divide(getattr(ours, name), getattr(LAB, name))) for name in columns])
    distance = logs @ logs + np.log(ours.length[0] / LAB.length[0]) ** 2
    assert found.success
    assert distance == pytest.approx(found.fun, rel=1e-3, abs=MINIMISED)


def test_ratios_of_friction_below_zero_become_zero_and_those_of_no_pendulum_are_refused() -> None:
    wanted = base_ratios(LAB)
    wanted[4] = -0.1
    assert nearest_arms(wanted, LAB).viscous[0] == 0.0
    for wanted[0] in (0.0, float("nan")):
        with pytest.raises(GoalMissed, match="no arms near"):
            nearest_arms(wanted, LAB)
