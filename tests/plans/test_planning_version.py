"""Golden plans: one that changes asks for another planning version, since the cache would serve the old one."""

import numpy as np
import pytest

from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.references.problem import PLANNING

SAME = 1e-6
"""rad, m and s: solvers stop at 1e-9, and round differently on other machines."""
GOLDEN = {
    "outer-turn": (
        3,
        4.875020469,
        -0.495087228,
        2.865318024,
        -6.203802474,
        -3.221348242,
        0.002600052,
        0.002769001,
        0.000282251,
        6.300574958,
        -9.908868663,
        21.680241972,
        0.002770174,
        -4.4847e-05,
        0.472529922,
        9.68462999,
        -6.376420708,
        -3.362735913,
        0.002780984,
        -0.002736911,
    ),
    "keep-down-up": (
        3,
        60.189199553,
        -0.0,
        3.1441012,
        7.754027425,
        4.41736804,
        0.001139996,
        -9.6537e-05,
        -0.0,
        3.1441012,
        7.754027425,
        4.41736804,
        0.001139996,
        -9.6537e-05,
        -0.0,
        3.1441012,
        7.754027425,
        4.41736804,
        0.001139996,
        -9.6537e-05,
    ),
    "one-arm": (
        3,
        6.5,
        2.447637238,
        4.557856833,
        -0.02139622,
        -0.169774391,
        3.141592654,
        0.0,
        0.0,
        0.0,
        -1.281111692,
        3.092218619,
        -0.10137328,
        -0.632085515,
    ),
}
"""By itinerary: the planning version, the duration in s, and the states at its quarters."""


@pytest.mark.parametrize("name", ["outer-turn", "keep-down-up", pytest.param("one-arm", marks=pytest.mark.slow)])
def test_a_plan_is_the_golden_one_of_its_planning_version(name: str) -> None:
    version, *figures = GOLDEN[name]
    reference = make_plan(load_itinerary(name), fresh=True).reference
    states = [reference.state(share * reference.duration) for share in (0.25, 0.5, 0.75)]
    found = [reference.duration, *np.concatenate(states).tolist()]
    assert version == PLANNING, "give this version's figures"
    assert found == pytest.approx(figures, abs=SAME), "planning has changed: raise PLANNING, and give its figures"
