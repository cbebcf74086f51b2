import numpy as np
import pytest
from shadowing_stand_in import LAB

from dpcontrol.control.interface import SampledModel
from dpcontrol.control.tracking import (
    TrackingController,
    TvlqrSettings,
    tracking_controller,
)
from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.references.reference import Reference


@pytest.fixture(scope="module")
def model() -> SampledModel:
    return SampledModel(arm_chain_equations(2, Level.CART), LAB.base(), period=2e-3)


def asked(controller: TrackingController, tick: int, state: np.ndarray) -> tuple[float, float]:
    action = controller.join(0, state).command(tick, state, np.zeros(0))
    return action.feedforward, action.feedback


def test_feedback_is_zero_on_the_reference_and_pulls_back_beside_it(reference: Reference, model: SampledModel) -> None:
    controller = tracking_controller(reference, model, TvlqrSettings())
    k = 700
    wanted = controller.reference_states[k]
    assert wanted == pytest.approx(reference.state(k * 2e-3), abs=1e-12)
    feedforward, feedback = asked(controller, k, wanted)
    assert feedback == 0.0
    assert feedforward == pytest.approx(float(reference.input(k * 2e-3 + 1e-3)[0]), abs=1e-12)
    beside = wanted + np.array([1e-4, 0, 0, 0, 0, 0])
    for j in range(k, k + 1500):
        u = sum(asked(controller, j, beside))
        beside = model.step(beside, u)
    assert np.abs(beside - controller.reference_states[k + 1500])[:4].max() < 2e-5


def late_start(reference: Reference, model: SampledModel, schedule: str) -> tuple[list[float], list[float]]:
    """Feedback and distance from the reference's path of a run that begins 40 ms ahead of the clock."""
    controller = tracking_controller(reference, model, TvlqrSettings(schedule=schedule))
    session, state = controller.join(0, controller.first_state), reference.state(0.04)
    path, feedback, away = reference.state(np.arange(0, 1.2, 5e-4)), [], []
    for k in range(400):
        action = session.command(k, state, np.zeros(0))
        feedback.append(abs(action.feedback))
        away.append(float(np.abs(path[:, :2] - state[:2]).max(1).min()))
        state = model.step(state, action.feedforward + action.feedback)
    return feedback, away


def test_by_phase_a_run_that_is_early_is_left_its_lead_and_by_time_it_is_pulled_back(
    reference: Reference, model: SampledModel
) -> None:
    by_time, by_phase = (late_start(reference, model, schedule) for schedule in ("time", "phase"))
    # The clock glides by half a tick a tick: it makes up the lead of 20 ticks in 40, pulled back meanwhile.
    assert max(by_phase[0][60:]) < 0.5 * max(by_time[0][60:])
    assert max(by_phase[1][60:]) < 0.5 * max(by_time[1][60:])


def test_by_phase_the_clock_is_estimated(reference: Reference, model: SampledModel) -> None:
    controller = tracking_controller(reference, model, TvlqrSettings(schedule="phase"))
    session = controller.begin()
    assert session.resynchronise(10, reference.state(0.3)) == "clock of the reference moved by +140 ticks"
    assert np.abs(session.command(10, reference.state(0.3), np.zeros(0)).feedback) < 1e-6
    assert controller.join(5, reference.state(0.3)).command(5, reference.state(0.3), np.zeros(0)).feedback < 1e-6
