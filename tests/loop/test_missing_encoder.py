"""Arms without an encoder: their angle is ignored whatever a rig sends, and the others suffice for a hold."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dpcontrol as dp
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.protocols import Reading
from dpcontrol.loop.result import LoopResult
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.runs.run import assembled

SCENE = 'title = "A hold"\nmodel = "lab"\nstart = "hold"\nhold = "up-up"\nseconds = {}\n[controller]\nkind = "lqr"\n'
BAR, RUNS = 38, 40  # Completed runs of all, which a laboratory asked for.


def hold(folder: Path, encoders: Any, *, seconds: float, **run: Any) -> Plan:
    (folder / "hold.toml").write_text(SCENE.format(seconds))
    scene = load_itinerary(str(folder / "hold.toml"))
    return make_plan(scene.with_run({"encoders": encoders, "initial_error": 0.02, **run}))


class NonsenseRig(SimulatedRig):
    """A simulated rig that sends a number in place of the outer arm's angle."""

    sent = 0.0

    def read(self) -> Reading:
        reading = super().read()
        return reading._replace(positions=np.where([False, True, False], self.sent, reading.positions))


def with_nonsense(assembly: Assembly, sent: float) -> LoopResult:
    loop, start = assembly.loop(), assembly.controller.first_state
    rig = NonsenseRig(assembly.draw(), assembly.settings.bench, limits=assembly.limits, start=start, queued=loop.queued)
    rig.sent = sent
    return loop.run(rig)


@pytest.mark.parametrize("estimator", ["ekf", "ukf"])
def test_the_angle_of_an_arm_without_an_encoder_has_no_effect(estimator: str, tmp_path: Path) -> None:
    assembly = assembled(hold(tmp_path, (True, False), seconds=0.5, estimator=estimator))
    runs = [with_nonsense(assembly, sent).ticks for sent in (0.0, 1e6, np.nan)]
    for ticks in runs:
        assert np.isnan(ticks.measured[:, 1]).all()
        assert np.isfinite(ticks.measured[:, ::2]).all()
        assert ticks.control.tobytes() == runs[0].control.tobytes()
        assert ticks.estimates.tobytes() == runs[0].estimates.tobytes()


def test_a_model_names_the_encoders_that_an_observer_can_miss() -> None:
    """Compare with the rank of Kalman's matrix; a mass at the outer joint alone does not turn the inner arm."""
    lab, single = dp.describe("lab"), dp.describe("single")
    for name, equilibrium in lab.equilibria.items():
        flow = lab.model.system.numeric.jacobian(equilibrium.state) / 10
        ranks = [
            np.linalg.matrix_rank(np.vstack([np.eye(4)[[other]] @ np.linalg.matrix_power(flow, k) for k in range(4)]))
            for other in (1, 0)
        ]
        assert lab.spare_encoders(name) == [arm for arm, rank in enumerate(ranks, start=1) if rank == 4] == [1, 2]
    assert not any(single.spare_encoders(name) for name in single.equilibria)
    arms = replace(lab.model.arms, centre_of_mass=(lab.model.arms.centre_of_mass[0], 1e-9))
    loose = dp.describe(replace(lab.model, parameters=arms))
    assert 2 not in loose.spare_encoders("up-up")


@pytest.mark.slow
def test_the_inner_angle_and_the_cart_suffice_to_hold_up_up(tmp_path: Path) -> None:
    plan = hold(tmp_path, (True, False), seconds=5.0, mismatch=0.05)
    (held,) = dp.campaign(plan, runs=RUNS, workers=1).results
    assert held.completed.successes >= BAR
