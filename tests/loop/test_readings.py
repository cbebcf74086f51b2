"""Arms without an encoder, whose angle is ignored whatever a rig sends; readings of unknown and of reported age."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shadowing_stand_in import LAB

import dpcontrol as dp
from dpcontrol.control.estimator_settings import ADAPTIVE, EkfSettings
from dpcontrol.control.tracking import AdaptiveSettings
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.bench import DriveSettings, SensorSettings
from dpcontrol.loop.loop import ControlLoop, LoopSettings
from dpcontrol.loop.protocols import Reading
from dpcontrol.loop.result import Ending, LoopResult
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.references.reference import Reference
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


PERIOD = 1e-3
UNSTEADY = LoopSettings(
    seed=5, mismatch=0.05, initial_error=0.05, travel=0.8, controller=AdaptiveSettings(),
    estimator=EkfSettings(**ADAPTIVE), drive=DriveSettings(lag=0.005, command_noise=0.3),
)  # fmt: skip
SPREAD = 0.35
"""Share by which the found deviation of the ages may miss the true one: arms at rest show none of it."""


def on_the_turn(reference: Reference, sensors: SensorSettings) -> tuple[LoopResult, ControlLoop]:
    settings = replace(UNSTEADY, sensors=sensors)
    assembly = Assembly(reference, LAB, settings)
    loop, start = assembly.loop(), assembly.controller.first_state
    bench = SimulatedRig(assembly.draw(), settings.bench, limits=assembly.limits, start=start, queued=loop.queued)
    return loop.run(bench), loop


def deviation(loop: ControlLoop) -> float:
    """Return the standard deviation of the readings' age that the loop has found, s."""
    return float(np.sqrt(loop.ticker.program.memory.timing[0, 0]))


def rate_errors(result: LoopResult) -> float:
    truth = result.ticks.truth
    return float(np.sqrt(np.mean((result.ticks.estimates - truth)[500:, 2:4] ** 2)))


@pytest.mark.slow
@pytest.mark.parametrize("jitter", [0.0, 1e-3])
def test_the_spread_of_the_readings_ages_is_found(reference: Reference, jitter: float) -> None:
    result, loop = on_the_turn(reference, SensorSettings(jitter=jitter))
    assert result.ending is Ending.FINISHED
    # Uniform ages: their variance is a twelfth of their span squared.
    uniform = jitter / np.sqrt(12)
    assert deviation(loop) == pytest.approx(uniform, rel=SPREAD, abs=0.02 * PERIOD)


@pytest.mark.slow
def test_a_reported_age_leaves_the_rates_as_good_as_without_jitter(reference: Reference) -> None:
    jitter = SensorSettings(jitter=PERIOD)
    steady, unknown, known = (
        rate_errors(on_the_turn(reference, sensors)[0])
        for sensors in (SensorSettings(), jitter, replace(jitter, ages="reported"))
    )
    assert known < 1.2 * steady
    assert unknown > 1.5 * known


LATE_RATE = 0.9
"""Largest error of a rate in the first 50 ms, rad/s: the filter assumes 0.1 rad/s at the start."""


@pytest.mark.slow
def test_a_late_reading_after_a_few_punctual_ones_is_no_error_of_the_rates() -> None:
    # The arms start at 7.6 rad/s. In some of these runs, the first readings are by chance of about the same age.
    settings = replace(UNSTEADY, sensors=SensorSettings(jitter=0.3 * PERIOD), drive=DriveSettings())
    assembly, errors = Assembly(make_plan(load_itinerary("outer-turn")).reference, LAB, settings), list[float]()
    for seed in range(9):
        ticks = assembly.simulate(draw=assembly.draw(seed=seed)).ticks
        errors.append(float(np.abs(ticks.estimates - ticks.truth)[:50, 2:4].max()))
    assert max(errors) < LATE_RATE
