"""The tick's parts, each against what it must do: commands on their way, the filter, the law, and what is judged."""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from shadowing_stand_in import LAB

from dpcontrol.control.bench_period import DriveLimits
from dpcontrol.control.ekf import CompiledEkf
from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.interface import clip_number, sampled_model
from dpcontrol.control.tick import LOST_AFTER_FALLBACK, TickProgram
from dpcontrol.control.tick_parts import Outcome
from dpcontrol.loop.bench import SensorSettings
from dpcontrol.references.problem import Limits

EXACT = 1e-12  # Sums of a few numbers of order ten.
PERIOD = 1e-3
WIDE = Limits(position=10.0, velocity=1e6, acceleration=1e6)
NARROW = Limits(position=1.0, velocity=3.0, acceleration=20.0)
DELAYS = [0.0, 1.5, *(pytest.param(delay, marks=pytest.mark.slow) for delay in (0.2, 1.0, 2.6, 7.99))]
"""Each takes seconds to compile."""
HANGING = np.zeros(6)
MODEL = sampled_model(LAB, 1 / PERIOD)
NOISE = SensorSettings().covariance(2)
PLAIN = EkfSettings(augment=(), cart_noise=1e-3)


class Ticked:
    """A program of one run with prescribed commands and readings."""

    def __init__(self, delay: float = 1.0, limits: Limits = WIDE, *, state=HANGING, estimator=PLAIN, **bounds) -> None:
        known = {
            "acceleration": limits.acceleration, "velocity": limits.velocity, "travel": 1e9, "reaction": 2e-3,
            "onset": 2e-3, "brake": limits.acceleration, "margin": 0.0, "lost_tracking": 1e9, "lost_estimate": 1e12,
            "resynchronise": 0.0, "restarts": 2.0, "missing": 1.0, "can_hold": 0.0, "trust": 0.0, "mode": 1.0,
        }  # fmt: skip
        self.program = TickProgram(MODEL, estimator, noise=NOISE, delay=delay, bounds={**known, **bounds})
        self.state = state
        # A delay that is not unrolled is looked ahead period by period: its tick has two parts.
        self.begin(np.zeros(self.program.lead))

    def begin(self, queued: np.ndarray, velocity: float = 0.0) -> None:
        self.program.begin(self.state, queued[:, None], velocity=velocity)

    def __call__(self, command: float, *, positions=None, present=None, **row: np.ndarray) -> dict[str, float]:
        """Run a tick with readings of the state by default, and further parts of the row of gains."""
        program = self.program
        measured = self.state[MODEL.position_indices] if positions is None else positions
        program.take(measured[:, None], present, 0, None)
        program.row[:] = 0.0
        parts = program.equations.row.of(program.row)
        for name, value in {"feedforward": np.array([command]), "wanted": self.state[:2], **row}.items():
            getattr(parts, name)[:] = value[:, None]
        program.tick()
        return {name: part.item(0) for name, part in program.report._asdict().items() if part.size}

    def kept(self, name: str) -> np.ndarray:
        return getattr(self.program.memory, name)[:, 0]

    def told(self, name: str) -> np.ndarray:
        return getattr(self.program.report, name)[:, 0]


def superposed(commands: np.ndarray, delay: float, first: int, last: int) -> np.ndarray:
    """Return the mean of what acts in each period from `first` up to `last`, command k acting in [k + d, k + d + 1)."""
    begins, periods = np.arange(len(commands)) + delay, np.arange(first, last)[:, None]
    overlaps = np.minimum(begins, periods) + 1 - np.maximum(begins, periods)
    return np.maximum(overlaps, 0.0) @ commands


@pytest.mark.parametrize("delay", DELAYS)
def test_the_acceleration_now_and_until_the_next_command_superposes_the_commands(delay: float) -> None:
    commands, tick, acting = np.random.default_rng(2).normal(0, 10, 40), Ticked(delay), []
    for k, command in enumerate(commands):
        coming = [float(one[0]) for one in tick.program.pending_commands()]
        assert len(coming) == tick.program.lead == round(delay)
        known = commands[:k]
        # Command k, not yet sent, may still act in a part of the last of these periods where the delay was rounded up;
        # until it is known the newest stands for it.
        held = np.append(known, known[-1] if k else 0.0)
        assert coming == pytest.approx(superposed(held, delay, k, k + tick.program.lead), abs=EXACT)
        acting.append(tick(float(command))["acting"])
    # After command k has been sent, tick k's period begins.
    assert acting == pytest.approx(superposed(commands, delay, 0, 40), abs=EXACT)


def test_the_velocity_is_the_sum_of_all_that_was_sent_within_the_limits() -> None:
    tick = Ticked(1.0, Limits(position=1.0, velocity=0.05, acceleration=20.0))
    tick.begin(np.array([5.0]), velocity=-0.01)
    velocity = -0.01 + 5.0 * PERIOD
    for command in (50.0, 10.0, 20.0, 20.0, -100.0, 3.0):
        report = tick(command)
        velocity = float(np.clip(velocity + np.clip(command, -20, 20) * PERIOD, -0.05, 0.05))
        assert tick.kept("velocity")[0] == pytest.approx(velocity, abs=EXACT)
        assert report["command"] == float(np.clip(command, -20, 20))
        assert report["saturated"] == (abs(command) > 20 or abs(velocity) >= 0.05)


@pytest.mark.slow
def test_a_stopped_cart_is_braked_to_rest_and_not_beyond_and_then_the_run_is_done() -> None:
    tick = Ticked(3.0, NARROW, travel=0.0)
    tick.begin(np.zeros(3), velocity=0.123)
    reports = [tick(7.0) for _ in range(80)]
    assert reports[0]["outcome"] == Outcome.CART
    assert [report["outcome"] for report in reports[1:]] == [Outcome.GO_ON] * 79
    assert all(report["stop"] for report in reports)
    speed = 0.123 + np.cumsum([report["command"] * PERIOD for report in reports])
    assert all(later <= earlier + EXACT for earlier, later in pairwise(speed))
    assert speed[5] > 0
    assert speed[7:] == pytest.approx(np.zeros(73), abs=EXACT)
    assert next(k for k, report in enumerate(reports) if report["done"]) == pytest.approx(57, abs=1)


@pytest.mark.parametrize(
    ("speed", "command"), [(3.1, 10.0), (3.1, -5.0), (-3.4, 0.0), (3.005, 10.0), (-2.9, -20.0), (2.995, 10.0)]
)
def test_a_cart_at_or_beyond_its_greatest_speed_is_treated_as_the_drive_does(speed: float, command: float) -> None:
    drive = DriveLimits(NARROW.acceleration, NARROW.velocity, np.inf, 1.0, clip_number)
    tick = Ticked(0.0, NARROW, state=np.array([0, 0, 0, 0, 0, speed]))
    acting = tick(command)["acting"]
    assert acting == pytest.approx(drive.acting(command, speed, PERIOD), abs=1e-9)
    assert abs(acting) <= NARROW.acceleration


@pytest.mark.parametrize("augment", [(), pytest.param(("friction", "parameters"), marks=pytest.mark.slow)])
def test_the_ticks_filter_is_the_filter(augment: tuple[str, ...]) -> None:
    settings, random = EkfSettings(augment=augment), np.random.default_rng(5)
    ekf = CompiledEkf(MODEL, settings, noise=NOISE)
    tick = Ticked(estimator=settings, state=np.array([0.3, -0.2, 1.0, -2.0, 0.01, 0.2]))
    estimate, acted = ekf.first(tick.state), 0.0
    for k in range(50):
        measured = np.array([0.3, -0.2, 0.01]) + 0.002 * k + random.normal(0, 1e-3, 3) * [1, 1, 1e-3]
        present = np.array([True, k % 5 != 2, True])
        command = float(random.normal(0, 5))
        estimate = ekf.step(estimate, acted, measured, present) if k else ekf.update(estimate, measured, present)
        # Readings of no motion of these arms would be taken for readings of unknown age.
        tick.kept("timing")[:] = 0.0
        acted = tick(command, positions=measured, present=present)["acting"]
        assert tick.told("state") == pytest.approx(estimate.state, rel=1e-8, abs=1e-8)
        # The filter has the parameters' logarithms; a report gives relative errors.
        factors = np.exp([x if name[0] in "MS" else 0 for name, x in zip(ekf.extra_names, estimate.extra, strict=True)])
        shown = np.where(factors == 1, estimate.extra, factors - 1)
        assert tick.told("extra") == pytest.approx(shown, rel=1e-6, abs=1e-8)
        assert tick.told("sigmas") == pytest.approx(estimate.sigmas * np.append(np.ones(6), factors), rel=1e-8)
        assert tick.told("nis")[0] == pytest.approx(estimate.nis, rel=1e-7)
        assert tick.told("used")[0] == estimate.used


@pytest.mark.parametrize("delay", [0.0, 3.0])
def test_the_law_answers_for_the_state_that_is_expected_when_the_command_acts(delay: float) -> None:
    state = np.array([0.4, 0.1, 1.0, -1.0, 0.02, 0.3])
    tick = Ticked(delay, state=state)
    queued = np.array([3.0, -2.0, 1.0])[: tick.program.lead]
    tick.begin(queued)
    gains, due = np.array([10.0, -3.0, 2.0, 1.0, 5.0, 4.0]), np.array([0.5, 0.0, 0.0, 0.0, 0.1, 0.0])
    report = tick(1.5, gains=gains, state=due)
    ahead = tick.told("state")
    for command in queued:
        ahead = MODEL.step(ahead, float(command))
    assert tick.told("ahead") == pytest.approx(ahead, abs=1e-12)
    assert report["feedback"] == pytest.approx(float(gains @ (due - ahead)), abs=1e-10)
    assert report["wish"] == pytest.approx(1.5 + report["feedback"], abs=EXACT)


def test_a_fallback_is_abandoned_only_if_feedback_cannot_return() -> None:
    tick = Ticked(lost_tracking=0.05, can_hold=1.0)

    def outcome(error: float, ticks: int) -> float:
        seen = (tick(0.0, wanted=HANGING[:2] + error)["outcome"] for _ in range(ticks))
        return next((one for one in seen if one), Outcome.GO_ON)

    assert outcome(0.5, 300) == Outcome.HOLD
    assert outcome(0.9 * LOST_AFTER_FALLBACK, 20_000) == Outcome.GO_ON
    assert outcome(1.1 * LOST_AFTER_FALLBACK, 20_000) == Outcome.TRACKING_LOST


def test_a_joint_that_pauses_with_its_model_is_not_stuck() -> None:
    tick = Ticked()
    random = np.random.default_rng(3)
    for k in range(100):
        # Hanging still, beside a reference that turns on and another arm whose encoder is so bad that the NIS is high.
        seen = np.array([1e-4 * min(k, 5), 0.0, 0.0]) + random.normal(0, 0.05, 3) * [0, 1, 1e-3]
        report = tick(0.0, positions=seen, wanted=np.array([0.01 * k, 0.0]))
        assert report["outcome"] != Outcome.STUCK
    assert report["mean_nis"] > 300
    assert tick.kept("same")[0] > 90


def watched_scale(velocity: Callable[[float], float], *, step: float, frozen_at: float = math.inf) -> float:
    """Return when a scale of resolution `step` m is called stuck on a cart of this velocity; infinite if never."""
    tick, state = Ticked(scale=step, delay=0.0), HANGING.copy()
    state[-1] = velocity(0.0)
    tick.begin(np.zeros(0), velocity=velocity(0.0))
    seen = 0.0
    for k in range(2000):
        now = k * PERIOD
        if now < frozen_at:
            seen = step * round(state[4] / step)
        sent = (velocity(now + PERIOD) - velocity(now)) / PERIOD
        if tick(sent, positions=np.array([*state[:2], seen]), wanted=state[:2])["outcome"] == Outcome.STUCK:
            assert tick.told("sensor")[0] == 3
            return now
        state = MODEL.step(state, sent)
    return math.inf


VELOCITIES = {
    "swings": lambda time: 0.4 * math.sin(4 * time),
    # The commands act against it when the scale freezes, at 0.15 s.
    "turns": lambda time: 0.05 * math.cos(9 * time),
    "creeps": lambda time: 0.03,
}


@pytest.mark.parametrize("step", [1e-6, 2e-4])
@pytest.mark.parametrize("name", VELOCITIES)
def test_a_frozen_scale_is_found_within_50_ms_of_a_millimetre(step: float, name: str) -> None:
    velocity = VELOCITIES[name]
    assert watched_scale(velocity, step=step) == math.inf
    for frozen_at in (0.15, 0.4, 1.1):
        times = np.arange(frozen_at, 2, PERIOD)
        travelled = np.abs(np.cumsum([velocity(t) * PERIOD for t in times]))
        gone = times[np.argmax(travelled >= 1e-3)]
        assert frozen_at < watched_scale(velocity, step=step, frozen_at=frozen_at) <= gone + 0.05


@pytest.mark.parametrize(("share", "lag"), [(0.5, 0.0), (1.5, 0.0), (1.0, 0.04)])
def test_a_drive_that_follows_its_commands_in_another_way_has_no_frozen_scale(share: float, lag: float) -> None:
    tick = Ticked(scale=2e-4, delay=0.0)
    omega = 2 * math.pi * 0.4
    for k in range(4000):
        # A cart turns back at each end of its swing, where its reading stands longest.
        angle = omega * k * PERIOD
        x, sent = 0.05 * math.sin(angle), -0.05 * omega**2 * (math.sin(angle) + lag * omega * math.cos(angle)) / share
        if not k:
            tick.begin(np.zeros(0), velocity=0.05 * omega)
        seen = np.array([0.0, 0.0, 2e-4 * round(x / 2e-4)])
        assert tick(sent, positions=seen)["outcome"] != Outcome.STUCK


def test_a_filter_that_has_slipped_a_turn_is_restarted_from_the_encoders() -> None:
    tick = Ticked()
    for _ in range(5):
        tick(0.0)
    # It believes in a rate that no reading shows, and so little of the readings that its NIS is small.
    tick.program.memory.z[0] = 4.0
    tick.program.memory.covariance[:] *= 1e12
    report = tick(3.0)
    assert report["outcome"] == Outcome.RESTART
    assert report["error"] < 0.1
    assert tick(0.0)["outcome"] == Outcome.GO_ON
    assert tick.told("state")[:2] == pytest.approx([0.0, 0.0], abs=1e-3)


def test_an_encoder_with_one_turn_can_jump_and_an_offset_of_a_turn_stays() -> None:
    tick = Ticked()
    for k in range(100):
        turned = 0.0 if k < 50 else -2 * math.pi
        assert tick(0.0, positions=np.array([2 * math.pi + turned, 0.0, 0.0]))["outcome"] == Outcome.GO_ON


def test_a_blow_on_the_cart_does_not_cost_the_estimate() -> None:
    tick = Ticked(lost_estimate=1e5)
    for k in range(50):
        assert tick(0.0, positions=np.array([0.0, 0.0, 0.0 if k < 25 else 0.01]))["outcome"] == Outcome.GO_ON


def test_an_estimator_can_restart_again_after_a_consistent_second() -> None:
    tick = Ticked(restarts=1.0)
    for wait, expected in ((0, Outcome.RESTART), (1200, Outcome.RESTART), (100, Outcome.ESTIMATE_LOST)):
        for _ in range(wait):
            assert tick(0.0)["outcome"] == Outcome.GO_ON
        tick.program.memory.covariance[:] = np.nan
        assert tick(0.0)["outcome"] == expected


@pytest.mark.parametrize(("away", "expected"), [(0.5, Outcome.CART), (1.6, Outcome.FALLEN)])
def test_a_cart_that_runs_after_fallen_arms_is_not_what_ended_the_run(away: float, expected: Outcome) -> None:
    tick = Ticked(3.0, NARROW, travel=0.0, lost_tracking=1.5)
    assert tick(0.0, wanted=HANGING[:2] + away)["outcome"] == expected


def test_a_failing_filter_keeps_its_prediction_and_restarts() -> None:
    tick, positions = Ticked(restarts=1.0), np.array([0.01, 0.02, 0.0])
    tick(0.0)
    tick.program.memory.covariance[:] = np.nan
    assert tick(3.0, positions=positions)["outcome"] == Outcome.RESTART
    assert np.isfinite(tick.told("state")).all()
    assert tick(0.0, positions=positions)["outcome"] == Outcome.GO_ON
    assert tick.told("state")[:2] == pytest.approx([0.01, 0.02], abs=1e-4)
    assert tick.told("sigmas")[2] == pytest.approx(10.0, rel=0.01)


@pytest.mark.parametrize("missing", [[0, 1, 2], [2], [0]], ids=str)
def test_a_missing_position_is_tolerated_up_to_the_time_limit(missing: list[int]) -> None:
    tick = Ticked(missing=0.03)
    present, positions = np.ones(3, dtype=bool), np.zeros(3)
    present[missing], positions[missing] = False, np.nan
    outcomes = [tick(0.0, positions=positions, present=present)["outcome"] for _ in range(40)]
    assert outcomes.index(Outcome.SILENT) in (29, 30)
    assert not any(outcomes[:29])


def test_a_cart_brakes_no_sooner_for_a_delay_that_is_looked_ahead() -> None:
    speed = 1.0
    for delay in (0.0, 3.0):
        state = np.array([0.0, 0.0, 0.0, 0.0, 0.0, speed])
        onset = PERIOD
        brakes = speed**2 / WIDE.acceleration + speed * (onset + delay * PERIOD)
        for travel, expected in ((brakes + 1e-4, Outcome.GO_ON), (brakes - 1e-4, Outcome.CART)):
            tick = Ticked(delay, state=state, travel=travel, onset=onset, reaction=(delay + 1) * PERIOD)
            tick.begin(np.zeros(tick.program.lead), velocity=speed)
            assert tick(0.0)["outcome"] == expected
