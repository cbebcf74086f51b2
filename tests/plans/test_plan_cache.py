"""Plans kept by content: found again, and never taken for another's."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dpcontrol.loop.assembly import LAW
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan, plan_key
from dpcontrol.references.problem import PLANNING
from dpcontrol.references.reference import load_reference
from dpcontrol.runs.run import assembled


def test_a_kept_plan_whose_states_were_changed_is_never_served(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path / "cache"))
    turn = load_itinerary("outer-turn")
    sound = load_reference(io.BytesIO(plan.archive))
    monkeypatch.setattr("dpcontrol.plans.planning.planned", lambda *_, **__: sound)
    file = make_plan(turn).file
    assert make_plan(turn).cached
    with np.load(file) as archive:
        arrays = dict(archive)
    np.savez(file, **(arrays | {"states": 1.5 * arrays["states"]}))
    assert load_reference(file).converged
    again = make_plan(turn)
    assert not again.cached
    assert np.array_equal(again.reference.states, sound.states)
    assert make_plan(turn).cached


def test_a_changed_title_or_limit_requires_another_plan() -> None:
    scene = load_itinerary("outer-turn")
    assert plan_key(replace(scene, title="Another")) != plan_key(scene)
    assert plan_key(replace(scene, limits=replace(scene.limits, position=0.3))) != plan_key(scene)
    assert plan_key(scene.with_run({"mismatch": 0.1}, seed=5)) == plan_key(scene)


SAME = 1e-6
"""rad, m and s: solvers stop at 1e-9, and round differently on other machines."""
GOLDEN = {
    "outer-turn": (4.875020469, 0.000282251, 6.300574958, -9.908868663, 21.680241972, 0.002770174, -4.4847e-05),
    "keep-down-up": (60.189199553, -0.0, 3.1441012, 7.754027425, 4.41736804, 0.001139996, -9.6537e-05),
    "one-arm": (5.629211667, 3.141592654, 0.0, 0.0, 0.0),
}
"""By itinerary, of planning version 5: the duration in s, and the state in its middle."""


@pytest.mark.parametrize("name", ["outer-turn", "keep-down-up", pytest.param("one-arm", marks=pytest.mark.slow)])
def test_a_plan_is_the_golden_one_of_its_planning_version(name: str) -> None:
    reference = make_plan(load_itinerary(name), fresh=True).reference
    found = [reference.duration, *reference.state(reference.duration / 2)]
    assert PLANNING == 5, "give this version's figures"
    assert found == pytest.approx(GOLDEN[name], abs=SAME), "planning has changed: raise PLANNING, and give its figures"


GOLDEN_GAINS = {"gains": 91.367845, "extra_gains": 58.471972, "pair_gains": 234.507587}
"""rms of each table of the adaptive controller of `outer-turn`, of law version 1."""


def test_gains_are_the_golden_ones_of_their_law_version(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path))
    tables = vars(assembled(plan).controller)
    found = {name: float(np.sqrt(np.mean(np.square(tables[name])))) for name in ("gains", "extra_gains", "pair_gains")}
    assert LAW == 1, "give this version's figures"
    assert found == pytest.approx(GOLDEN_GAINS, rel=1e-5), "gains have changed: raise LAW, and give their figures"
