"""Golden plans: one that changes asks for another planning version, since the cache would serve the old one."""

import pytest

from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.references.problem import PLANNING

SAME = 1e-6
"""rad, m and s: solvers stop at 1e-9, and round differently on other machines."""
GOLDEN = {
    "outer-turn": (4.875020469, 0.000282251, 6.300574958, -9.908868663, 21.680241972, 0.002770174, -4.4847e-05),
    "keep-down-up": (60.189199553, -0.0, 3.1441012, 7.754027425, 4.41736804, 0.001139996, -9.6537e-05),
    "one-arm": (5.629211667, 3.141592654, 0.0, 0.0, 0.0),
}
"""By itinerary, of planning version 4: the duration in s, and the state in its middle."""


@pytest.mark.parametrize("name", ["outer-turn", "keep-down-up", pytest.param("one-arm", marks=pytest.mark.slow)])
def test_a_plan_is_the_golden_one_of_its_planning_version(name: str) -> None:
    reference = make_plan(load_itinerary(name), fresh=True).reference
    found = [reference.duration, *reference.state(reference.duration / 2)]
    assert PLANNING == 4, "give this version's figures"
    assert found == pytest.approx(GOLDEN[name], abs=SAME), "planning has changed: raise PLANNING, and give its figures"
