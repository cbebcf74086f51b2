"""The watch of the drive, against carts that follow their commands well, badly or not at all."""

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dpcontrol.control.drive import CartReading, DriveWatch

PERIOD = 1e-3
SOON = 0.05
"""Longest time from a fault to its detection, s, while commands demand several m/s²."""
NOISE = 0.3
"""Standard deviation of the noise on each command, m/s²."""
SECONDS = 1.6
TURN = 2.0
"""Acceleration of the arm by 1 m/s² of the cart, rad/s²."""
FAILS = (0.0, 0.4, 0.9, 1.3)
BRAKES, FASTEST = 30.0, 3.0
"""Braking of a drive that is off, m/s², and a bound on the cart's velocity, m/s."""


WELL = {"response": 1.0, "lag": 1e-9, "count": 1e-6, "dropout": 0.0, "knock": 0.0, "fault": "", "fails": np.inf}
"""A cart with an arm, whose drive or scale fails at `fails` s, and that is struck by `knock` m/s at 0.7 s."""
Case = dict[str, Any]


def machine(period: float, lanes: int) -> tuple[ca.Function, np.ndarray]:
    """Return one tick of the watch of one arm without gravity, and its memories at rest."""
    watch = DriveWatch(1, period)
    memory, moved = ca.SX.sym("memory", watch.memory.size), ca.SX.sym("moved", 2)
    present, repeats, count, sent = (ca.SX.sym(name) for name in ("present", "repeats", "count", "sent"))
    visible = watch.visible(count, count**2 / 12, ca.SX(NOISE))
    judged = watch.update(memory, CartReading(present, repeats, moved, ca.SX(0), visible))
    m, after = watch.memory.of(judged), watch.predict(judged, sent, TURN * sent, TURN * sent)
    found = ca.vertcat(m.lasts >= watch.longest - period / 2, m.against < 0, m.doubt)
    step = ca.Function("watch", [memory, moved, present, repeats, count, sent], [after, found])
    return step.map(lanes), np.tile(watch.start(0.0, np.zeros(1))[:, None], lanes)


def lively(time: float) -> float:
    """Return a command of 20 m/s² at most that often changes its sign, m/s²."""
    return 9 * np.sin(23 * time) + 7 * np.sin(41 * time + 1) + 4 * np.sin(90 * time)


def firm(time: float) -> float:
    """Return a command that exceeds 7 m/s² for at least 50 ms after each of the times `FAILS`, m/s²."""
    return 15 * np.sin(10 * time + 1)


def findings(cases: Sequence[Case], command: Callable[[float], float], *, period: float = PERIOD) -> np.ndarray:
    """Return unfollowed, against and doubt of each tick and case (K, 3, S)."""
    step, memory = machine(period, len(cases))
    random, rows = np.random.default_rng(3), []
    response, lag, count, dropout, knock, fault, fails = (
        np.array([{**WELL, **case}[name] for case in cases]) for name in WELL
    )
    x, v, a, angle, rate, read = np.zeros((6, len(cases)))
    last = np.zeros((2, len(cases)))
    for k in range(round(SECONDS / period)):
        now, sent = k * period, command(k * period)
        failed = now >= fails
        read = np.where(failed & (fault == "scale"), read, count * np.rint(x / count))
        present = random.random(len(cases)) >= dropout
        seen = np.where(present, np.array([angle, read]), last)
        after, found = step(memory, seen - last, present, seen[1] == last[1], count, np.full(len(cases), sent))
        memory, last = np.array(after), seen
        rows.append(np.array(found))
        wanted = response * sent + random.normal(0, NOISE, len(cases))
        wanted = np.where(failed & (fault == "off"), np.clip(-v / period, -BRAKES, BRAKES), wanted)
        wanted = np.where(failed & (fault == "coasts"), 0.0, wanted)
        wanted = np.where(failed & (fault == "reversed"), -wanted, wanted)
        a = wanted + np.exp(-period / lag) * (a - wanted)
        v = v + np.where(k == round(0.7 / period), knock, 0.0)
        x, v = x + v * period + a * period**2 / 2, v + a * period
        angle, rate = angle + rate * period + TURN * a * period**2 / 2, rate + TURN * a * period
    return np.array(rows)


def test_a_cart_that_follows_badly_or_is_struck_still_follows() -> None:
    troubles = [{}, {"response": 0.6}, {"response": 1.5}, {"lag": 0.02}, {"dropout": 0.4}]
    cases = [{"count": count, **trouble} for count in (1e-6, 2e-4) for trouble in troubles]
    cases += [{"knock": knock} for knock in (-1.0, -0.3, 0.5, 1.0)]
    unfollowed = findings(cases, lively)[:, 0].any(axis=0)
    assert not [case for case, failed in zip(cases, unfollowed, strict=True) if failed]


@pytest.mark.parametrize("period", [1e-3, 5e-3])
def test_a_drive_that_fails_is_found_within_50_ms_and_the_arms_blame_it(period: float) -> None:
    cases = [{"fault": fault, "fails": fails} for fault in ("off", "coasts", "reversed") for fails in FAILS]
    rows = findings(cases, firm, period=period)
    for lane, case in enumerate(cases):
        first = int(np.argmax(rows[:, 0, lane] > 0))
        assert rows[first, 0, lane]
        stops = FASTEST / BRAKES if case["fault"] == "off" else 0.0
        assert case["fails"] < first * period <= case["fails"] + stops + SOON + period, case
        assert case["fault"] == "off" or (rows[first, 1, lane] > 0) == (case["fault"] == "reversed"), case
        assert rows[first, 2, lane] < 0, case


def test_the_arms_do_not_blame_the_drive_for_a_stuck_scale() -> None:
    cases = [{"fault": "scale", "fails": fails} for fails in FAILS]
    rows = findings(cases, firm)
    for lane in range(len(cases)):
        first = int(np.argmax(rows[:, 0, lane] > 0))
        assert rows[first, 0, lane]
        assert rows[first, 2, lane] > 0
