"""Plans through dry friction that reverses faster than collocation resolves."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dpcontrol.dynamics.chain import Level, equations_of
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan

STRAYED = np.array([5e-3, 0.1])
"""rad and rad/s by which 0.1 s of the plan may miss its end under the stiff law: a few counts of a coarse encoder."""
SPAN = 0.1

ARMS = """
title = "One arm with stiff dry friction"
[arms]
source = "Drawn at random"
mass = [0.200827]
centre_of_mass = [0.0780082]
length = [0.146394]
inertia = [0.000271321]
[gravity]
source = "Standard gravity"
acceleration = 9.81
[friction]
source = "Drawn at random: 1.1 % of gravity's torque"
viscous = [0.000120877]
coulomb = [0.0016934]
smoothing = 0.01043
"""
SCENE = """
model = "stiff.toml"
start = "rest"
finish = "rest"
hold = "up"
seconds = 2.0
[limits]
position = 0.234
velocity = 2.68
acceleration = 28.5
"""


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    folder: Path = tmp_path_factory.mktemp("stiff")
    (folder / "stiff.toml").write_text(ARMS)
    (folder / "scene.toml").write_text(SCENE)
    return make_plan(load_itinerary(str(folder / "scene.toml")))


@pytest.mark.slow
def test_stiff_dry_friction_is_planned_and_the_stiff_law_hardly_departs_from_the_plan(plan):
    assert plan.converged
    reference, arms = plan.reference, plan.itinerary.model.arms
    assert arms.smoothing == 0.01043
    e = equations_of(arms, Level.CART)
    rate = ca.Function("rate", [e.state, e.inputs, e.parameters], [e.rate])

    def slope(t, x):
        return np.array(rate(x, reference.input(np.array([t]))[0, 0], arms.base())).ravel()

    begins = np.arange(0.0, reference.duration - SPAN, SPAN)
    ends = [
        solve_ivp(slope, (t, t + SPAN), reference.state(t), method="LSODA", rtol=1e-8, atol=1e-10, max_step=1e-3).y[
            :, -1
        ]
        for t in begins
    ]
    strayed = np.abs(np.array(ends) - reference.state(begins + SPAN)).max(0)[:2]
    assert (strayed < STRAYED).all(), strayed
