from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from shadowing_stand_in import DOWN_UP_LOW, LAB, UP_DOWN_HIGH, StandIn

from dpcontrol.control.interface import Mode
from dpcontrol.control.tracking import FeedforwardSettings, TrackingController, tracking_controller
from dpcontrol.foundation.errors import InputError
from dpcontrol.lab.bench import Plant, SensorSettings
from dpcontrol.lab.loop import LoopSettings, run_loop, sampled_model
from dpcontrol.lab.result import Ending, LoopResult
from dpcontrol.logs.layout import control_fields
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import Reference

FINAL = 0.1  # Rad: how far a completed run's last period may be from the orbit.
COUNT = 2 * np.pi / 40_000
FIELDS = {name: k for k, name in enumerate(control_fields(2, has_cart=True))}
REAL = LoopSettings(seed=0, mismatch=0.02, initial_error=0.02)


@dataclass
class Kept:
    """A sink that keeps what it is given."""

    ticks: list[dict[str, Any]] = field(default_factory=list)
    events: list[tuple[float, str, str, str]] = field(default_factory=list)

    def tick(self, time_s: float, **parts: Any) -> None:
        self.ticks.append({"time": time_s} | {k: np.array(v) for k, v in parts.items()})

    def event(self, time_s: float, level: str, name: str, text: str) -> None:
        self.events.append((time_s, level, name, text))


@pytest.fixture(scope="module")
def controller(turn: tuple[StandIn, Reference]) -> TrackingController:
    return tracking_controller(turn[1], sampled_model(LAB, 1000.0), REAL.controller)


def distance_to_orbit(result: LoopResult, orbit: StandIn, period: float) -> float:
    last = result.truth[-round(period * 1000) :, :2]
    return float(np.abs(orbit.final[None, :, :2] - last[:, None]).max(2).min(1).max())


def test_real_runs_follow_to_the_end_and_show_the_orbit(tracked: tuple[StandIn, Reference]) -> None:
    orbit, reference = tracked
    period = DOWN_UP_LOW.period if reference.duration < 8 else UP_DOWN_HIGH.period
    tvlqr = tracking_controller(reference, sampled_model(LAB, REAL.rate), REAL.controller)
    for seed in range(3):
        result = run_loop(reference, LAB, settings=replace(REAL, seed=seed), controller=tvlqr)
        assert result.ending is Ending.FINISHED, result.reason
        assert distance_to_orbit(result, orbit, period) < FINAL
        assert result.max_cart_position < reference.limits.position
        assert 0.9 < result.nis_inside_95 <= 1.0


def test_feedforward_alone_is_lost_and_says_so(tracked: tuple[StandIn, Reference]) -> None:
    settings = replace(REAL, controller=FeedforwardSettings())
    result = run_loop(tracked[1], LAB, settings=settings)
    assert result.ending is Ending.TRACKING_LOST
    assert "tracking lost at t = " in result.reason
    assert not result.finished
    assert result.control[-1, FIELDS["mode"]] == Mode.ABORTED
    assert not result.control[:, FIELDS["feedback"]].any()


def test_the_right_model_tracks_to_encoder_counts(
    turn: tuple[StandIn, Reference], controller: TrackingController
) -> None:
    result = run_loop(turn[1], LAB, settings=LoopSettings(seed=0), controller=controller)
    assert result.finished
    assert result.rms_tracking_error < COUNT
    assert result.rms_cart_acceleration < 2 * turn[1].rms_cart_acceleration


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_command_acts_after_the_delay_and_not_before(turn: tuple[StandIn, Reference], delay: int) -> None:
    @dataclass
    class Ramp:
        """Tells its commands apart: a thousandth of a m/s² for each."""

        reference_states: np.ndarray
        kind: str = "ramp"
        calls: int = 0

        def command(self, tick: int, state: np.ndarray) -> tuple[float, float]:
            self.calls += 1
            return 0.001 * self.calls, 0.0

    short = Ramp(turn[1].state(1e-3 * np.arange(40)))
    settings = LoopSettings(seed=0, delay=delay)
    result = run_loop(turn[1], LAB, settings=settings, controller=short)
    command, applied = result.control[:, FIELDS["command"]], result.control[:, FIELDS["applied"]]
    assert applied[delay:] == pytest.approx(command[: 40 - delay], abs=1e-15)
    # The plant itself moved by what was applied from each tick to the next.
    speed = np.diff(result.truth[:, 5]) / 1e-3
    assert speed == pytest.approx(applied[:-1], abs=1e-9)


def test_a_late_command_that_nobody_expects_is_worse(turn: tuple[StandIn, Reference]) -> None:
    slow = replace(REAL, delay=20)
    model = sampled_model(LAB, REAL.rate)
    expected = run_loop(turn[1], LAB, settings=slow)

    @dataclass
    class Unaware:
        """Takes the predicted state for that of the tick `delay` before."""

        inner: TrackingController
        kind: str = "unaware"

        @property
        def reference_states(self) -> np.ndarray:
            return self.inner.reference_states

        def command(self, tick: int, state: np.ndarray) -> tuple[float, float]:
            return self.inner.command(max(tick - 20, 0), state)

    inner = tracking_controller(turn[1], model, REAL.controller)
    unaware = run_loop(turn[1], LAB, settings=slow, controller=Unaware(inner))
    assert expected.finished
    assert not unaware.finished or unaware.rms_tracking_error > 3 * expected.rms_tracking_error


def test_truth_between_ticks_is_the_mismatched_plant_under_the_applied_command(
    turn: tuple[StandIn, Reference], controller: TrackingController
) -> None:
    result = run_loop(turn[1], LAB, settings=REAL, controller=controller)
    assert result.plant != LAB
    for value, nominal in zip(result.plant.mass, LAB.mass, strict=True):
        assert abs(value / nominal - 1) <= 0.02
    model = sampled_model(result.plant, REAL.rate)
    for k in range(0, len(result.times) - 1, 501):
        following = model.step(result.truth[k], float(result.control[k, FIELDS["applied"]]))
        assert result.truth[k + 1] == pytest.approx(following, abs=1e-6)
    assert Plant(model.equations, LAB.base()).after(result.truth[0], 0.0, 1e-3) != pytest.approx(
        result.truth[1], abs=1e-9
    )


def test_a_seed_repeats_its_run_and_another_draws_another(
    turn: tuple[StandIn, Reference], controller: TrackingController
) -> None:
    once, again, other = (
        run_loop(turn[1], LAB, settings=replace(REAL, seed=s), controller=controller) for s in (4, 4, 5)
    )
    assert (once.truth == again.truth).all()
    assert (once.control == again.control).all()
    assert once.plant != other.plant
    start = once.truth[0, :2] - once.references[0, :2]
    assert 0 < np.abs(start).max() <= REAL.initial_error
    assert (once.truth[0, 2:] == once.references[0, 2:]).all()
    # One setting's draw does not depend on the other.
    exact = run_loop(turn[1], LAB, settings=replace(REAL, seed=4, mismatch=0.0), controller=controller)
    assert (exact.truth[0] == once.truth[0]).all()


def test_the_sink_sees_every_tick_and_the_ending(
    turn: tuple[StandIn, Reference], controller: TrackingController
) -> None:
    kept, heard = Kept(), []
    result = run_loop(
        turn[1], LAB, settings=REAL, controller=controller, sink=kept,
        progress=lambda what, done: heard.append((what, done)),
    )  # fmt: skip
    assert len(kept.ticks) == len(result.times)
    for name, array in (("truth", result.truth), ("estimate", result.estimates), ("control", result.control)):
        assert (np.array([t[name] for t in kept.ticks]) == array).all()
    assert kept.ticks[-1]["time"] == pytest.approx(turn[1].duration, abs=1e-3)
    assert kept.events[0][2] == "start"
    assert kept.events[-1][1:] == ("info", "finished", result.reason)
    assert heard[-1] == ("run", 1.0)
    assert all(0 <= done <= 1 for _, done in heard)
    assert np.isfinite(result.control).all()


def test_the_cart_at_its_stop_ends_the_run_by_name(
    turn: tuple[StandIn, Reference], controller: TrackingController
) -> None:
    short = replace(turn[1], limits=Limits(position=0.004))
    kept = Kept()
    result = run_loop(short, LAB, settings=REAL, controller=controller, sink=kept)
    assert result.ending is Ending.CART_STOP
    assert "cart at its stop at t = " in result.reason
    assert kept.events[-1][1:3] == ("error", "cart at its stop")
    assert result.max_cart_position >= 0.004
    assert result.max_cart_position < 0.005


def test_a_weak_drive_is_reported_as_saturated(turn: tuple[StandIn, Reference], controller: TrackingController) -> None:
    weak = replace(turn[1], limits=Limits(acceleration=0.3))
    kept = Kept()
    result = run_loop(weak, LAB, settings=REAL, controller=controller, sink=kept)
    assert np.abs(result.control[:, FIELDS["applied"]]).max() <= 0.3
    assert result.control[:, FIELDS["saturated"]].any()
    assert "saturated" in [e[2] for e in kept.events]


def test_arms_of_another_kind_lose_the_estimate_by_name(
    turn: tuple[StandIn, Reference], controller: TrackingController
) -> None:
    other = replace(LAB, gravity=3 * LAB.gravity)
    strict = replace(REAL.estimator, parameter_error=0.0, rate_noise=1e-4)
    settings = replace(REAL, estimator=strict)
    result = run_loop(turn[1], LAB, settings=settings, controller=controller, plant=other)
    assert result.ending is Ending.ESTIMATE_LOST
    assert "NIS" in result.reason


def test_coarse_encoders_still_serve(turn: tuple[StandIn, Reference], controller: TrackingController) -> None:
    settings = replace(REAL, sensors=SensorSettings(counts=1024))
    assert run_loop(turn[1], LAB, settings=settings, controller=controller).finished


def test_a_controller_for_other_arms_is_refused(
    turn: tuple[StandIn, Reference], controller: TrackingController
) -> None:
    other = replace(controller, reference_states=controller.reference_states[:, :4])
    with pytest.raises(InputError, match="these arms have"):
        run_loop(turn[1], LAB, settings=REAL, controller=other)


def test_impossible_runs_are_refused() -> None:
    for wrong in ({"rate": 0.0}, {"delay": -1}, {"mismatch": 2.0}, {"initial_error": -0.1}, {"seed": -1}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            replace(REAL, **wrong)
