"""Failures of the loop: every run ends with a name and a true reason, the cart inside its limits, the log complete.

The cart is watched for a second after the run as well, on a track without hard stops that would keep it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from ending_truth import Flight, class_of, flights, untrue, untrue_score
from kept_rows import Kept
from shadowing_stand_in import LAB

import dpcontrol as dp
from dpcontrol.control.interface import Mode
from dpcontrol.control.tracking import TrackingController
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.bench import DisturbanceSettings, DriveSettings, SensorSettings
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.result import Ending, LoopResult, SupervisorSettings
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.plans.plan import Plan
from dpcontrol.references.reference import Reference
from dpcontrol.runs.closed_loop import ClosedLoop

AFTER = 1000  # Ticks for which the bench goes on when the loop has ended.
TRACK = 10.0  # m: the hard stops are far away, so that it is the loop that keeps the cart inside its limits.
AT_REST = 0.01  # m/s, of a cart that was braked.
REAL = LoopSettings(seed=0, mismatch=0.02, initial_error=0.02, drive=DriveSettings(track=TRACK))


@dataclass
class Ended:
    """A run that has ended: what the loop and the log have of it, and how far the cart ever was."""

    record: LoopResult
    log: Kept
    farthest: float
    speed: float


@pytest.fixture(scope="module")
def ended(reference: Reference, controller: TrackingController) -> Callable[..., Ended]:
    def run(settings: LoopSettings, *, believed_delay: float | None = None) -> Ended:
        log, bench = Kept(), settings.bench
        assembly = Assembly(reference, LAB, settings, law=controller, believed_delay=believed_delay)
        draw = settings.draw(LAB, ticks=controller.ticks + 1 + AFTER)
        loop = assembly.loop(sink=log)
        rig = SimulatedRig(draw, bench, limits=assembly.limits, start=controller.first_state, queued=loop.queued)
        record = loop.run(rig)
        after = []
        for _ in range(AFTER):
            rig.read()
            after.append(np.abs(rig.truth[4:6]))
        farthest = max(np.abs(record.ticks.truth[:, 4]).max(), np.array(after)[:, 0].max())
        # The least speed: a knock may come even then.
        return Ended(record, log, float(farthest), float(np.array(after)[:, 1].min()))

    return run


def check(run: Ended, ending: Ending, reason: str, *, limit: float = 0.4) -> None:
    record, log = run.record, run.log
    assert record.ending is ending, record.reason
    assert reason in record.reason
    assert run.farthest <= limit
    assert run.speed < AT_REST
    # Every tick is in the log, in order; the first event begins it and the last one is the ending, at the last tick.
    logged = log.whole("times").tolist()
    assert logged == record.ticks.times.tolist() == sorted(set(logged))
    assert np.isfinite(record.ticks.estimates).all()
    assert log.names[0] == "start"
    assert (log.kept[-1].level, log.kept[-1].name) == ("error", ending.value)
    assert log.kept[-1].time == pytest.approx(logged[-1])
    times = [event.time for event in log.kept]
    assert times == sorted(times)
    assert "stop" in log.names
    assert record.ticks.control[-1, 6] == Mode.ABORTED


@pytest.mark.parametrize(
    ("sensor", "name"), [(0, "the encoder of joint 1"), (1, "the encoder of joint 2"), (2, "the cart's scale")]
)
def test_a_stuck_sensor_is_named_before_the_cart_runs_away(ended: Callable[..., Ended], sensor: int, name: str) -> None:
    for at in (0.5, 2.0, 3.7):
        settings = replace(REAL, sensors=SensorSettings(stuck_at=at, stuck_sensor=sensor))
        run = ended(settings)
        check(run, Ending.ESTIMATE_LOST, f"{name} is stuck", limit=0.05)
        assert run.log.whole("times")[-1] < at + 0.6


def test_a_restart_and_a_move_of_the_clock_are_events(ended: Callable[..., Ended]) -> None:
    nervous = SupervisorSettings(lost_estimate=5.0)
    strict = replace(REAL.estimator, parameter_error=0.0, rate_noise=1e-4)
    run = ended(replace(REAL, mismatch=0.3, supervisor=nervous, estimator=strict))
    assert run.log.names.count("restart the estimator") == nervous.restarts
    check(run, Ending.ESTIMATE_LOST, "check the encoders")
    wandering = SupervisorSettings(resynchronise=0.06)
    moved = ended(replace(REAL, mismatch=0.3, supervisor=wandering))
    assert "re-synchronise" in moved.log.names


def nasty(seed: int) -> tuple[LoopSettings, float]:
    """Return a run of all that can go wrong, and the delay that the loop believes in."""
    random = np.random.default_rng([seed, 99])
    sensors = SensorSettings(
        stuck_at=random.uniform(0.2, 3.0) if random.random() < 0.5 else math.inf,
        stuck_sensor=int(random.integers(3)),
        dropout=float(random.choice([0.0, 0.0, 0.3])),
    )
    delay = float(random.choice([1.0, 30.0]))
    drive = DriveSettings(delay=delay, lag=float(random.choice([0.0, 0.02])), command_noise=0.3, track=TRACK)
    blows = DisturbanceSettings(
        pushes=3,
        push_impulse=float(random.choice([0.0, 0.01, 0.05])),
        knocks=int(random.choice([0, 2])),
        knock_velocity=0.3,
    )
    settings = LoopSettings(
        seed=seed, mismatch=0.5, initial_error=float(random.choice([0.05, 0.5])), sensors=sensors, drive=drive,
        disturbances=blows,
    )  # fmt: skip
    return settings, float(random.choice([1.0, delay]))


@pytest.mark.slow
def test_the_cart_stays_inside_its_limits_in_all_failures(ended: Callable[..., Ended]) -> None:
    for seed in range(24):
        settings, believed = nasty(seed)
        run = ended(settings, believed_delay=believed)
        assert run.farthest <= 0.4, (seed, run.record.reason)
        assert run.speed < AT_REST
        if run.record.ending is not Ending.FINISHED:
            check(run, run.record.ending, "at t = ")
        if math.isinf(settings.sensors.stuck_at):
            assert "stuck" not in run.record.reason, seed


BENCH = {"initial_error": 0.05, "command_noise": 0.3, "controller": "tvlqr"}


def flown(plan: Plan, *, seed: int = 0, **options: Any) -> Flight:
    (flight,) = flights(plan.itinerary.with_run({**{**BENCH, **options}}), plan.reference, [seed])
    return flight


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        ({"travel": 0.05, "mismatch": 0.1}, "cart at its stop"),
        ({"pushes": 3, "push_impulse": 0.03, "travel": 2.0, "seed": 3}, "tracking lost"),
        ({"stuck_at": 1.0, "stuck_sensor": 0}, "sensor stuck"),
        ({"stuck_at": 1.0, "stuck_sensor": 1}, "sensor stuck"),
        ({"stuck_at": 1.0, "stuck_sensor": 2}, "sensor stuck"),
        ({"dropout": 0.99}, "no measurement"),
    ],
)
def test_the_reason_of_an_ending_is_true(plan: Plan, options: dict[str, Any], kind: str) -> None:
    flight = flown(plan, **options)
    assert class_of(flight) == kind, flight.run.reason
    assert untrue(flight) == untrue_score(flight) == ""


def test_a_lost_estimate_is_one_that_was_wrong(plan: Plan) -> None:
    scene = plan.itinerary.with_run({**BENCH, "mismatch": 0.8, "lag": 0.03, "travel": 10.0})
    # A filter that knows nothing of its model's errors.
    strict = replace(scene.loop.estimator, augment=("zeros",), parameter_error=0.0, rate_noise=1e-5, cart_noise=1e-3)
    found = flights(replace(scene, loop=replace(scene.loop, estimator=strict)), plan.reference, range(8))
    lost = [flight for flight in found if flight.run.ending is Ending.ESTIMATE_LOST]
    assert lost
    assert [untrue(flight) for flight in lost] == [""] * len(lost)


def test_a_limit_switch_is_at_its_nominal_place(plan: Plan) -> None:
    scene = plan.itinerary.with_run({**BENCH, "mismatch": 0.1})
    short = replace(scene.loop, drive=replace(scene.loop.drive, track=0.02))
    (flight,) = flights(replace(scene, loop=short), plan.reference, range(1))
    assert class_of(flight) == "limit switch"
    assert untrue(flight) == ""
    assert np.abs(flight.run.truth[:, -2]).max() == pytest.approx(0.02, abs=1e-6)


SOON = 0.05
"""Longest time from visible commanded motion to the end of the run, s."""
MOVED = 5e-3
"""Commanded motion of a resting cart that must show, m: less can be noise if the commands stay below 1 m/s²."""
ITINERARY = "turn-from-rest"
ERROR = 0.05
"""Initial error of simulated arms, rad, so that the commands begin at once."""


@pytest.fixture(scope="module")
def loop() -> ClosedLoop:
    return dp.closed_loop(ITINERARY, initial_error=ERROR)


def ended_soon(result: LoopResult, *, fails: float = 0.0) -> bool:
    """Return true if the run ended soon after its commands demanded a visible motion of a resting cart."""
    assert result.ending is Ending.DRIVE_FAILED, result.reason
    times, applied, mode = result.ticks.times, result.ticks.control[:, 3], result.ticks.control[:, 6]
    moved = np.abs(np.cumsum(np.cumsum(np.where(times >= fails, applied, 0.0))) * (times[1] - times[0]) ** 2)
    due = times[moved >= MOVED]
    return not due.size or times[np.argmax(mode == Mode.ABORTED)] <= due[0] + SOON


@pytest.mark.slow
@pytest.mark.parametrize("failure", ["off", "reversed"])
@pytest.mark.parametrize("fails", [0.0, 1.0, 1.3])
def test_a_simulated_drive_that_fails_ends_the_run_soon(loop: ClosedLoop, failure: str, fails: float) -> None:
    settings = loop.assembly.settings
    drive = replace(settings.drive, failed_at=fails, failure=failure)
    faulty = loop.assembly.under(replace(settings, drive=drive))
    for seed in range(2):
        assert ended_soon(faulty.simulate(draw=faulty.draw(seed=seed)), fails=fails)
