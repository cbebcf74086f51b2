"""The simulated bench as the loop sees it, tick by tick."""

import math
from dataclasses import replace
from itertools import takewhile

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from shadowing_stand_in import LAB

from dpcontrol.control.interface import clip_number
from dpcontrol.dynamics.chain import Level, Uncertainty, arm_chain_equations, base_ratios, ratio_names
from dpcontrol.loop.bench import (
    BenchDraw,
    BenchSettings,
    DisturbanceSettings,
    DriveSettings,
    Push,
    SensorSettings,
    Unlike,
    draw_bench,
)
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.references.problem import Limits

PERIOD = 1e-3
EXACT = 1e-10  # DOP853 at 1e-12 over some hundredths of a second.
LIMITS = Limits(position=0.4, velocity=3.0, acceleration=30.0)
UNROUNDED = SensorSettings(counts=0, cart_resolution=0.0)
START = np.array([0.4, 2.8, 6.0, -9.0, 0.1, -0.3])
RATE = arm_chain_equations(2, Level.CART).function()


def drawn(settings: BenchSettings, *, ticks: int = 200, seed: int = 3, **given: float) -> BenchDraw:
    return draw_bench(LAB, settings, seed=seed, ticks=ticks, period=PERIOD, unlike=Unlike(**given))


def rig_of(settings: BenchSettings, *, start: np.ndarray = START, ticks: int = 200, **given: float) -> SimulatedRig:
    return SimulatedRig(drawn(settings, ticks=ticks, **given), settings, limits=LIMITS, start=start)


def flown(state: np.ndarray, u: float, duration: float) -> np.ndarray:
    def slope(_: float, x: np.ndarray) -> np.ndarray:
        return np.array(RATE(x, u, LAB.base())).ravel()

    return solve_ivp(slope, (0, duration), state, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]


@pytest.mark.parametrize("delay", [0.0, 1.0, 2.75])
def test_a_command_acts_after_its_delay_to_the_fraction_of_a_period(delay: float) -> None:
    rig = rig_of(BenchSettings(sensors=UNROUNDED, drive=DriveSettings(delay=delay)))
    commands = np.random.default_rng(2).uniform(-20, 20, 12)
    whole, fraction = math.floor(delay), delay % 1

    def given(k: int) -> float:
        return float(commands[k]) if k >= 0 else 0.0

    expected = START.copy()
    for k, command in enumerate(commands):
        reading = rig.read()
        assert reading.time == pytest.approx(k * PERIOD)
        assert rig.truth == pytest.approx(expected, abs=EXACT)
        assert reading.positions == pytest.approx(expected[[0, 1, 4]], abs=EXACT)
        rig.command(float(command))
        if fraction:
            expected = flown(expected, given(k - whole - 1), fraction * PERIOD)
        expected = flown(expected, given(k - whole), (1 - fraction) * PERIOD)


def test_the_cart_stops_at_the_end_of_its_track_and_the_bench_reports_it() -> None:
    settings = BenchSettings(drive=DriveSettings(delay=0.0, switch_margin=0.05))
    start = np.array([0.3, -0.4, 1.0, 2.0, 0.3, 1.5])
    rig = rig_of(settings, start=start, ticks=400)
    touched = []
    for _ in range(120):
        reading = rig.read()
        if reading.switch and not rig.fault:
            touched.append(rig.truth[4])
        rig.command(5.0)
    assert 0.35 <= min(touched) < 0.36
    # 0.3 + 1.5 t + 2.5 t² = 0.4.
    speed = math.sqrt(1.5**2 + 4 * 2.5 * 0.1)
    place = {"time": (speed - 1.5) / 5, "position": 0.4, "velocity": speed}
    assert rig.fault.figures == pytest.approx(place, rel=1e-9)
    assert rig.truth[4:] == pytest.approx([0.4, 0.0], abs=1e-12)
    assert rig.read().switch == 1
    # It is not glued there, and the switch is released on the way back.
    for _ in range(200):
        rig.command(-5.0)
        reading = rig.read()
    assert rig.truth[4] < 0.35
    assert reading.switch == 0
    assert not rig_of(settings).fault


def test_arms_keep_their_momenta_when_the_cart_stops_dead() -> None:
    settings = BenchSettings(drive=DriveSettings(delay=0.0))
    # 1 m/s and 0.5 mm to go: the contact is in the middle of the first period.
    start = np.array([0.3, -0.4, 1.0, 2.0, 0.3995, 1.0])
    rig = rig_of(settings, start=start)
    rig.read()
    rig.command(0.0)
    rig.read()
    at_stop = flown(start, 0.0, 5e-4)
    struck = flown(np.array([*at_stop[:4], 0.4, 1.0]), -1.0 / 1e-8, 1e-8)
    assert rig.truth[:4] == pytest.approx(flown(struck, 0.0, 5e-4)[:4], abs=1e-5)


@pytest.mark.parametrize("drive", [DriveSettings(lag=0.004), DriveSettings(lag=0.004, cart_mass=0.5)])
def test_drives_that_lag_stay_at_the_stop_while_they_push(drive: DriveSettings) -> None:
    rig = rig_of(BenchSettings(drive=drive), start=np.array([0.3, -0.4, 1.0, 2.0, -0.39, -1.0]), ticks=400)
    for _ in range(60):
        rig.read()
        rig.command(-20.0)
        assert abs(rig.truth[4]) <= 0.4 + 1e-12
    assert rig.fault.figures["position"] == -0.4
    for _ in range(60):
        rig.command(20.0)
        rig.read()
    assert rig.truth[4] > -0.4


def test_stop_brakes_at_once_and_for_good() -> None:
    rig = rig_of(BenchSettings(drive=DriveSettings(delay=5.0)), start=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.6]))
    rig.read()
    rig.command(30.0)
    rig.stop()
    for _ in range(20):
        rig.read()
        rig.command(30.0)
    assert rig.truth[5] == pytest.approx(0.0, abs=1e-12)
    rest = rig.truth[4]
    rig.read()
    assert rig.truth[4] == pytest.approx(rest, abs=1e-12)
    assert rest == pytest.approx(0.6**2 / (2 * 30.0), abs=1e-9)


def test_dropped_readings_are_marked_and_hold_the_last_value() -> None:
    settings = BenchSettings(sensors=SensorSettings(dropout=0.3))
    draw = drawn(settings)
    dropped = draw.drawn("dropped")
    assert 0.15 < dropped.mean() < 0.45
    rig = SimulatedRig(draw, settings, limits=LIMITS, start=START)
    last = np.zeros(3)
    for k in range(100):
        reading = rig.read()
        assert (reading.present is not None) == dropped[k]
        if reading.present is None:
            last = reading.positions
        else:
            assert not reading.present.any()
            assert reading.positions == pytest.approx(last, abs=0)
        rig.command(0.0)


@pytest.mark.parametrize("delay", [1.0, 0.4])
def test_a_jittery_reading_is_of_a_state_as_old_as_was_drawn(delay: float) -> None:
    settings = BenchSettings(sensors=replace(UNROUNDED, jitter=8e-4), drive=DriveSettings(delay=delay))
    draw = drawn(settings)
    rig = SimulatedRig(draw, settings, limits=LIMITS, start=np.array([0, 0, 0, 0, 0, 1.0]))
    plain = rig_of(
        BenchSettings(sensors=UNROUNDED, drive=DriveSettings(delay=delay)), start=np.array([0, 0, 0, 0, 0, 1.0])
    )
    ages = draw.drawn("ages")
    plain.read()
    assert rig.read().positions[2] == 0.0
    for k in range(1, 50):
        for one in (rig, plain):
            one.command(0.0 if k < 40 else 3.0)
        reading, ideal = rig.read(), plain.read()
        if k < 40:
            assert reading.positions[2] == pytest.approx(k * PERIOD - ages[k], abs=1e-12)
        else:
            assert reading.positions[2] <= ideal.positions[2]
        assert rig.truth == pytest.approx(plain.truth, abs=EXACT)


def test_blows_strike_at_their_tick_right_after_its_reading() -> None:
    push = Push(0.01, arm=1, rate=0.7, knock=0.2)
    struck = rig_of(BenchSettings(disturbances=DisturbanceSettings(explicit=(push,))))
    calm = rig_of(BenchSettings())
    for k in range(15):
        struck.read()
        calm.read()
        difference = np.abs(struck.truth - calm.truth).max()
        assert (difference > 0.1) == (k > 10)
        struck.command(0.0)
        calm.command(0.0)


def test_one_settings_change_leaves_every_other_draw_as_it_was() -> None:
    everything = BenchSettings(
        SensorSettings(zero_error=0.02, noise=1e-4, missed_counts=50.0, dropout=0.1, jitter=1e-4, rate_noise=0.1),
        DriveSettings(command_noise=0.3),
        DisturbanceSettings(pushes=3, push_impulse=0.01, knocks=2, knock_velocity=0.1),
    )
    whole = drawn(everything, mismatch=0.05, initial_error=0.05)
    sensors = replace(everything.sensors, dropout=0.0, zero_error=0.0, jitter=0.0, noise=0.0)
    fewer = drawn(
        BenchSettings(sensors, everything.drive, DisturbanceSettings(knocks=2, knock_velocity=0.1)), mismatch=0.0,
        initial_error=0.05,
    )  # fmt: skip
    assert np.array_equal(whole.initial_error, fewer.initial_error)
    for name in ("command_noise", "missed", "rate_noise"):
        assert np.array_equal(whole.drawn(name), fewer.drawn(name)), name
    assert {k: b.knock for k, b in whole.blows.items() if b.knock} == {k: b.knock for k, b in fewer.blows.items()}
    for name in ("dropped", "ages", "noise"):
        assert name not in fewer.streams
    assert not fewer.zeros.any()
    longer = drawn(everything, ticks=300, mismatch=0.05, initial_error=0.05)
    for name in ("command_noise", "ages", "dropped", "missed", "noise", "rate_noise"):
        assert np.array_equal(longer.drawn(name)[:200], whole.drawn(name)), name


def test_blows_of_a_night_come_at_random_times_to_its_end() -> None:
    def blows(hours: float) -> list[tuple[float, float, float]]:
        settings = BenchSettings(disturbances=DisturbanceSettings(knocks_per_minute=1.0, knock_impulse=0.03))
        coming = drawn(settings).random_blows()
        ticks = takewhile(lambda blow: blow[0] * PERIOD < 3600 * hours, coming)
        return [(tick * PERIOD, *blow.impulses.tolist()) for tick, blow in ticks]

    night = np.array(blows(8.0))
    assert blows(1.0) == [tuple(row) for row in night[night[:, 0] < 3600].tolist()]
    assert len(night) == pytest.approx(480, abs=90)
    assert np.diff(night[:, 0]).std() == pytest.approx(60.0, rel=0.2)
    assert np.abs(night[:, 1:]).max() == pytest.approx(0.03, rel=0.02)
    assert (np.count_nonzero(night[:, 1:], axis=0) > 190).all()
    resumed = drawn(BenchSettings(disturbances=DisturbanceSettings(knocks_per_minute=1.0))).endless(since=3_600_000)
    first = next(resumed.random_blows())
    assert [first[0] * PERIOD + 3600, *first[1].impulses.tolist()] == pytest.approx(night[night[:, 0] >= 3600][0])


@pytest.mark.slow
def test_a_run_of_any_length_is_drawn_in_blocks_as_it_would_be_at_once() -> None:
    everything = BenchSettings(
        SensorSettings(noise=1e-4, missed_counts=50.0, dropout=0.1, jitter=1e-4, rate_noise=0.1),
        DriveSettings(command_noise=0.3),
    )
    once, night = drawn(everything, ticks=50_000), drawn(everything, ticks=50)
    for name in ("command_noise", "ages", "dropped", "missed", "noise", "rate_noise"):
        reader, later = night.endless().reader(name), night.endless(since=40_000).reader(name)
        assert [reader[k] for k in range(50_000)] == once.drawn(name).tolist(), name
        assert [later[k] for k in range(10_000)] == once.drawn(name)[40_000:].tolist(), name


def test_a_drives_acceleration_and_velocity_stay_inside() -> None:
    drive = DriveSettings().within(LIMITS, PERIOD, clip=clip_number)
    assert drive.demanded(5.0, 0.0, 0.0) == 5.0
    assert drive.demanded(50.0, 0.0, 0.0) == 30.0
    assert drive.demanded(-50.0, 0.0, 0.0) == -30.0
    assert drive.acting(30.0, 2.99, PERIOD) == pytest.approx(10.0)
    assert 2.99 + drive.acting(30.0, 2.99, PERIOD) * PERIOD <= 3.0 + 1e-12
    assert drive.acting(-30.0, 3.0, PERIOD) == -30.0
    assert drive.acting(30.0, 3.0, PERIOD) == pytest.approx(0.0, abs=1e-9)
    # Over a fraction of a period more is allowed, to the same velocity.
    assert drive.acting(30.0, 2.99, PERIOD / 2) == pytest.approx(20.0)
    # Too fast by a knock: back with all the drive has, not more.
    assert drive.acting(30.0, 3.5, PERIOD) == -30.0
    assert drive.acting(-30.0, -3.5, PERIOD) == 30.0

    weak = DriveSettings(acceleration=4.0, velocity=0.5, response=0.8).within(LIMITS, PERIOD, clip=clip_number)
    assert weak.demanded(3.0, 0.1, 0.0) == pytest.approx(2.5)
    assert weak.demanded(20.0, 0.0, 0.0) == 4.0
    assert weak.acting(4.0, 0.5, PERIOD) == pytest.approx(0.0, abs=1e-12)


def test_jerk_is_bounded_from_demand_to_demand() -> None:
    drive = DriveSettings(jerk=2000.0).within(LIMITS, PERIOD, clip=clip_number)
    last, given = 0.0, []
    for _ in range(6):
        last = drive.demanded(9.0, 0.0, last)
        given.append(last)
    assert given == pytest.approx([2.0, 4.0, 6.0, 8.0, 9.0, 9.0])
    assert drive.demanded(-9.0, 0.0, 9.0) == pytest.approx(7.0)


RATIOS = base_ratios(LAB)
# 0.2 % of each ratio, equal errors of the first two. At ten times that, most drawn ratios belong to no arms.
CORRELATION = np.eye(len(RATIOS))
CORRELATION[0, 1] = CORRELATION[1, 0] = 0.8
SHARE = 2e-3
KNOWN_TO = Uncertainty(ratio_names(LAB), tuple((SHARE**2 * CORRELATION * np.outer(RATIOS, RATIOS)).ravel()))
DRAWS = 200
SPREAD = 0.2  # a standard deviation of 200 draws is itself known to 5 %
NOISY = BenchSettings(
    SensorSettings(noise=1e-4, zero_error=1e-3, missed_counts=2.0, dropout=0.01, jitter=1e-4, rate_noise=0.01),
    DriveSettings(command_noise=0.1),
    DisturbanceSettings(pushes=2, push_impulse=1e-3, knocks=1, knock_velocity=0.1),
)


def _draw(scale: float, seed: int = 3, *, mismatch: float = 0.0) -> BenchDraw:
    unlike = Unlike(mismatch, scale, KNOWN_TO, initial_error=0.02)
    return draw_bench(LAB, NOISY, seed=seed, ticks=200, period=PERIOD, unlike=unlike)


@pytest.mark.slow
@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_plants_have_the_covariance_times_the_scale(scale: float) -> None:
    away = np.stack([base_ratios(_draw(scale, seed).plant.arms) / RATIOS - 1 for seed in range(DRAWS)])
    assert away.std(axis=0) == pytest.approx(np.full(len(RATIOS), scale * SHARE), rel=SPREAD)
    alike = np.asarray(np.corrcoef(away[:, :4].T))
    assert alike[0, 1] == pytest.approx(0.8, abs=0.08)
    assert np.abs(alike[0, 2:]).max() < 0.25


def test_only_the_plant_is_drawn_anew_and_a_mismatch_comes_on_top() -> None:
    plain, alone, both, drawn = (_draw(scale, mismatch=m) for scale, m in ((0, 0), (0, 0.05), (1, 0.05), (1, 0)))
    assert plain.plant.arms == LAB != drawn.plant.arms
    for one in (alone, both, drawn):
        assert np.array_equal(one.initial_error, plain.initial_error)
        assert np.array_equal(one.zeros, plain.zeros)
        assert one.streams.keys() == plain.streams.keys()
        assert all(np.array_equal(one.drawn(name), plain.drawn(name)) for name in plain.streams)
        assert [(k, b.knock, *b.impulses) for k, b in one.blows.items()] == [
            (k, b.knock, *b.impulses) for k, b in plain.blows.items()
        ]
    share = np.array(alone.plant.arms.mass) / np.array(LAB.mass)
    assert np.array(both.plant.arms.mass) == pytest.approx(share * np.array(drawn.plant.arms.mass), rel=1e-12)
