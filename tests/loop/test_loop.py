from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from shadowing_stand_in import DOWN_UP_LOW, LAB, UP_DOWN_HIGH, StandIn

from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.interface import Action, Mode
from dpcontrol.control.tracking import FeedforwardSettings, TrackingController, tracking_controller
from dpcontrol.foundation.errors import InputError
from dpcontrol.logs.layout import control_fields
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.bench import DriveSettings, SensorSettings, Unlike, draw_bench
from dpcontrol.loop.loop import LoopSettings, sampled_model
from dpcontrol.loop.result import Ending, LoopResult, LoopSink, SinkBeside, Ticks
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import Reference

FINAL = 0.1  # Rad: how far a completed run's last period may be from the orbit.
COUNT = 2 * np.pi / 40_000
FIELDS = {name: k for k, name in enumerate(control_fields(2, has_cart=True))}
REAL = LoopSettings(seed=0, mismatch=0.02, initial_error=0.02)


@dataclass
class Kept:
    """A sink that keeps what it is given."""

    blocks: list[Ticks] = field(default_factory=list)
    events: list[tuple[float, str, str, str]] = field(default_factory=list)

    def ticks(self, rows: Ticks) -> None:
        self.blocks.append(deepcopy(rows))

    def whole(self, name: str) -> np.ndarray:
        return np.concatenate([getattr(block, name) for block in self.blocks])

    def event(self, time_s: float, level: str, name: str, text: str) -> None:
        self.events.append((time_s, level, name, text))


@dataclass(frozen=True)
class Scripted:
    """A controller that does what a function of the tick says."""

    first_state: np.ndarray
    ticks: int
    says: Callable[[int], float]
    kind: str = "scripted"

    def begin(self) -> "Scripted":
        return self

    def command(self, tick: int, state: np.ndarray, extra: np.ndarray) -> Action:
        return Action(self.says(tick), 0.0, self.first_state, Mode.TRACKING)

    def resynchronise(self, tick: int, state: np.ndarray) -> str:
        return ""


@pytest.fixture(scope="module")
def controller(turn: tuple[StandIn, Reference]) -> TrackingController:
    return tracking_controller(turn[1], sampled_model(LAB, 1000.0), REAL.controller)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def distance_to_orbit(result: LoopResult, orbit: StandIn, period: float) -> float:
    last = result.ticks.truth[-round(period * 1000) :, :2]
    return float(np.abs(orbit.final[None, :, :2] - last[:, None]).max(2).min(1).max())


@pytest.mark.slow
def test_real_runs_follow_to_the_end_and_show_the_orbit(tracked: tuple[StandIn, Reference]) -> None:
    orbit, reference = tracked
    period = DOWN_UP_LOW.period if reference.duration < 8 else UP_DOWN_HIGH.period
    tvlqr = tracking_controller(reference, sampled_model(LAB, REAL.rate), REAL.controller)
    for seed in range(3):
        result = Assembly(reference, LAB, replace(REAL, seed=seed), law=tvlqr).simulate()
        assert result.ending is Ending.FINISHED, result.reason
        assert distance_to_orbit(result, orbit, period) < FINAL
        assert np.abs(result.ticks.truth[:, 4]).max() < reference.limits.position
        assert 0.9 < result.nis_inside_95 <= 1.0


def test_feedforward_alone_is_lost_with_a_reason(tracked: tuple[StandIn, Reference]) -> None:
    settings = replace(REAL, controller=FeedforwardSettings())
    result = Assembly(tracked[1], LAB, settings).simulate()
    # The duration of the run includes that of all its ticks.
    assert result.elapsed > result.thinking.sum()
    assert result.ending is Ending.TRACKING_LOST
    assert "tracking lost at t = " in result.reason
    assert not result.finished
    assert result.ticks.control[-1, FIELDS["mode"]] == Mode.ABORTED
    flying = result.ticks.control[:, FIELDS["mode"]] != Mode.ABORTED
    assert not result.ticks.control[flying, FIELDS["feedback"]].any()


@pytest.mark.slow
def test_the_right_model_tracks_to_encoder_counts(
    turn: tuple[StandIn, Reference], controller: TrackingController
) -> None:
    # Zeros that have to be found first cost their share.
    for augment, most in (((), COUNT), (("zeros",), 3 * COUNT)):
        settings = LoopSettings(seed=0, estimator=EkfSettings(augment=augment))
        result = Assembly(turn[1], LAB, settings, law=controller).simulate()
        assert result.finished
        assert rms((result.ticks.truth - result.ticks.references)[:, :2]) < most
        assert rms(result.ticks.control[:, FIELDS["applied"]]) < 2 * most / COUNT * turn[1].rms_cart_acceleration


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0, 1, 3, 0.5, 1.25])
def test_a_command_acts_after_the_delay_and_not_before(turn: tuple[StandIn, Reference], delay: float) -> None:
    first = turn[1].state(0.0)
    ramp = Scripted(first, 39, lambda tick: 0.001 * (tick + 1))
    settings = LoopSettings(seed=0, drive=DriveSettings(delay=delay))
    result = Assembly(turn[1], LAB, settings, law=ramp).simulate()
    command, applied = result.ticks.control[:, FIELDS["command"]], result.ticks.control[:, FIELDS["applied"]]
    # A ramp's mean over a period that two commands share lies between them as the delay's fraction says.
    first_known = int(np.ceil(delay))
    expected = np.interp(np.arange(first_known, 40) - delay, np.arange(40), command)
    assert applied[first_known:] == pytest.approx(expected, abs=1e-12)
    # The plant itself moved by what was applied from each tick to the next.
    truth = result.ticks.truth
    assert truth is not None
    assert np.diff(truth[:, 5])[first_known:] / 1e-3 == pytest.approx(applied[first_known:-1], abs=1e-9)


@pytest.mark.slow
def test_an_unmodelled_delay_is_worse(turn: tuple[StandIn, Reference], controller: TrackingController) -> None:
    # Beyond the margin: the unstable direction grows by half in that time.
    slow = replace(REAL, drive=DriveSettings(delay=50.0))
    expected = Assembly(turn[1], LAB, slow).simulate()
    draw = draw_bench(
        LAB, slow.bench, seed=0, ticks=controller.ticks + 1, period=1e-3, unlike=Unlike(initial_error=0.02)
    )
    loop = Assembly(turn[1], LAB, slow, law=controller, believed_delay=0.0).loop()
    unaware = loop.run(SimulatedRig(draw, slow.bench, limits=turn[1].limits, start=controller.first_state))
    assert expected.finished
    assert unaware.ending is not Ending.FINISHED


def test_truth_between_ticks_is_the_mismatched_plant_under_the_applied_command(
    turn: tuple[StandIn, Reference], controller: TrackingController
) -> None:
    result = Assembly(turn[1], LAB, REAL, law=controller).simulate()
    assert result.plant != LAB
    for value, nominal in zip(result.plant.mass, LAB.mass, strict=True):
        assert abs(value / nominal - 1) <= 0.02
    model = sampled_model(result.plant, REAL.rate)
    for k in range(0, len(result.ticks.times) - 1, 501):
        following = model.step(result.ticks.truth[k], float(result.ticks.control[k, FIELDS["applied"]]))
        assert result.ticks.truth[k + 1] == pytest.approx(following, abs=1e-6)
    # The model's own arms would have gone elsewhere.
    own = sampled_model(LAB, REAL.rate).step(result.ticks.truth[0], float(result.ticks.control[0, FIELDS["applied"]]))
    assert result.ticks.truth[1] != pytest.approx(own, abs=1e-6)


@pytest.mark.slow
def test_a_seed_repeats_its_run_and_another_draws_another(
    turn: tuple[StandIn, Reference], controller: TrackingController
) -> None:
    assembly = Assembly(turn[1], LAB, REAL, law=controller)
    once, again, other = (assembly.simulate(draw=assembly.draw(seed=s)) for s in (4, 4, 5))
    assert (once.ticks.truth == again.ticks.truth).all()
    assert (once.ticks.control == again.ticks.control).all()
    assert once.plant != other.plant
    start = once.ticks.truth[0, :2] - once.ticks.references[0, :2]
    assert 0 < np.abs(start).max() <= REAL.initial_error
    assert (once.ticks.truth[0, 2:] == once.ticks.references[0, 2:]).all()
    # One setting's draw does not depend on the other.
    exact = assembly.simulate(draw=assembly.draw(seed=4, mismatch=0.0))
    assert (exact.ticks.truth[0] == once.ticks.truth[0]).all()


def test_the_sink_sees_every_tick_and_the_ending(
    turn: tuple[StandIn, Reference], controller: TrackingController
) -> None:
    kept, heard = Kept(), []
    result = Assembly(turn[1], LAB, REAL, law=controller).simulate(
        sink=kept, progress=lambda what, done: heard.append((what, done))
    )
    for name in ("times", "truth", "estimates", "control"):
        assert (kept.whole(name) == getattr(result.ticks, name)).all()
    assert max(len(block.times) for block in kept.blocks) <= 20
    assert kept.whole("times")[-1] == pytest.approx(turn[1].duration, abs=1e-3)
    assert kept.events[0][2] == "start"
    assert kept.events[-1][1:] == ("info", "finished", result.reason)
    assert heard[-1] == ("run", 1.0)
    assert all(0 <= done <= 1 for _, done in heard)
    assert np.isfinite(result.ticks.control).all()


def test_a_sink_beside_the_loop_sees_the_same_and_what_fails_there_ends_the_run(
    turn: tuple[StandIn, Reference], controller: TrackingController
) -> None:
    def run(sink: LoopSink) -> None:
        Assembly(turn[1], LAB, REAL, law=controller).simulate(sink=sink)

    here, there = Kept(), Kept()
    run(here)
    with SinkBeside(there) as beside:
        run(beside)
    for name in ("times", "truth", "estimates", "control"):
        assert (here.whole(name) == there.whole(name)).all()
    assert here.events == there.events

    class Fails(Kept):
        def event(self, time_s: float, level: str, name: str, text: str) -> None:
            raise InputError("the disk is full")

    with pytest.raises(InputError, match="the disk is full"), SinkBeside(Fails()) as beside:
        run(beside)


def test_the_cart_is_braked_before_its_stop_and_the_run_ends_by_name(
    turn: tuple[StandIn, Reference], controller: TrackingController
) -> None:
    short = replace(turn[1], limits=Limits(position=0.012))
    kept = Kept()
    for seed in range(5):
        result = Assembly(short, LAB, replace(REAL, seed=seed), law=controller).simulate(sink=kept)
        assert result.ending is Ending.CART_STOP
        assert "cart at its stop at t = " in result.reason
        assert kept.events[-1][1:3] == ("error", "cart at its stop")
        truth = result.ticks.truth
        assert truth is not None
        assert np.abs(truth[:, 4]).max() < 0.012
        assert abs(truth[-1, 5]) < 0.01


def test_a_weak_drive_is_reported_as_saturated(turn: tuple[StandIn, Reference], controller: TrackingController) -> None:
    weak = replace(turn[1], limits=Limits(acceleration=0.3))
    kept = Kept()
    result = Assembly(weak, LAB, REAL, law=controller).simulate(sink=kept)
    assert np.abs(result.ticks.control[:, FIELDS["applied"]]).max() <= 0.3
    assert result.ticks.control[:, FIELDS["saturated"]].any()
    assert "saturated" in [e[2] for e in kept.events]


def test_arms_of_another_kind_lose_the_estimate_by_name(
    turn: tuple[StandIn, Reference], controller: TrackingController
) -> None:
    other = replace(LAB, gravity=3 * LAB.gravity)
    strict = replace(
        REAL.estimator, augment=("zeros",), parameter_error=0.0, rate_noise=1e-4, cart_noise=1e-3, zero_error=0.02,
        first_angle=0.05,
    )  # fmt: skip
    settings = replace(REAL, estimator=strict, plant=other, mismatch=0.0)
    result = Assembly(turn[1], LAB, settings, law=controller).simulate()
    assert result.ending is Ending.ESTIMATE_LOST
    assert "NIS" in result.reason


def test_coarse_encoders_still_serve(turn: tuple[StandIn, Reference], controller: TrackingController) -> None:
    settings = replace(REAL, sensors=SensorSettings(counts=1024))
    assert Assembly(turn[1], LAB, settings, law=controller).simulate().finished


def test_a_controller_for_other_arms_is_refused(
    turn: tuple[StandIn, Reference], controller: TrackingController
) -> None:
    other = replace(controller, reference_states=controller.reference_states[:, :4])
    with pytest.raises(InputError, match="these arms have"):
        Assembly(turn[1], LAB, REAL, law=other).simulate()


def test_impossible_runs_are_refused() -> None:
    for wrong in ({"rate": 0.0}, {"travel": -1.0}, {"mismatch": 2.0}, {"initial_error": -0.1}, {"seed": -1}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            replace(REAL, **wrong)
