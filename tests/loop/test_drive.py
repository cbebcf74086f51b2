"""The drive's limits, and disturbances' settings."""

import math

import pytest

from dpcontrol.control.interface import clip_number
from dpcontrol.loop.bench import DriveSettings
from dpcontrol.references.problem import Limits

LIMITS = Limits(position=0.4, velocity=3.0, acceleration=30.0)
PERIOD = 1e-3


def test_acceleration_and_velocity_stay_inside() -> None:
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


def test_a_weaker_drive_than_the_itinerarys_gives_less() -> None:
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


def test_braking_ends_at_rest_and_not_beyond() -> None:
    drive = DriveSettings().within(LIMITS, PERIOD, clip=clip_number)
    velocity, steps = 1.0, 0
    while velocity:
        velocity += drive.braking(velocity, PERIOD) * PERIOD
        velocity = 0.0 if abs(velocity) < 1e-15 else velocity
        steps += 1
        assert velocity >= 0
    assert steps == math.ceil(1.0 / 30.0 / PERIOD)


def test_its_own_track_replaces_the_scenes_limit() -> None:
    assert DriveSettings().limits(LIMITS).position == 0.4
    assert DriveSettings(track=0.25).limits(LIMITS).position == 0.25
