"""Stops, symbols and wraps decoded from angles, on plans written by hand with known motions."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dpcontrol.judge.decoding import decode_run
from dpcontrol.plans.model import load_model
from dpcontrol.references.content import (
    FlightSegment,
    Origin,
    PlanContent,
    PlanOrbit,
    PlanSaddle,
    PlanSection,
    PlanStop,
    PlanSymbol,
    Shadowing,
)

PERIOD = 0.8
WRAPS = 4
TURN = 2 * np.pi
SWING = 0.9
"""rad: of the inner arm on the orbit about down-up; the outer one keeps upright."""


def wobble(times: np.ndarray) -> np.ndarray:
    return SWING * np.sin(TURN * times / PERIOD)


def turn(times: np.ndarray, at: float, direction: float = 1.0) -> np.ndarray:
    """Return a whole turn around `at`, in a third of a second."""
    return direction * np.pi * (1 + np.tanh((times - at) / 0.08))


def motion(times: np.ndarray, first: float, second: float, directions: tuple[float, float] = (1.0, 1.0)) -> np.ndarray:
    """Wobble about down-up and turn the outer arm at two times, s."""
    outer = np.pi + turn(times, first, directions[0]) + turn(times, second, directions[1])
    return np.array([wobble(times), outer]).T


FIRST, SECOND, END = 2.0, 5.4, 8.0
ORBIT = PlanOrbit("down-up", 0.0, PERIOD, 1e3, np.zeros((2, 4)))


def plan(*, directions: tuple[float, float] = (1.0, 1.0), **more):
    """A plan of two turns of the outer arm, `FIRST` and `SECOND` s after its start."""
    lifts = np.cumsum([0.0, *directions]) * TURN
    gap = (SECOND - FIRST) / PERIOD - WRAPS
    assert 0 <= gap < 1
    symbols = []
    for at, middle in zip((FIRST, SECOND), np.pi + (lifts[:-1] + lifts[1:]) / 2, strict=True):
        section = PlanSection((0.0, 1.0, 0.0, 0.0), middle, (float(wobble(np.array(at))), middle))
        where = {"source": "down-up", "target": "down-up", "winding": (0, 1), "phase_out": gap % 1.0}
        symbols.append(PlanSymbol(text="down-up", time=at, section=section, **where))
    content = PlanContent(
        itinerary="turns",
        title="Two turns",
        model="lab",
        shadowing=Shadowing(),
        origin=Origin("", "", "", "", "", load_model("lab").arms),
        stops=tuple(PlanStop("down-up", (0.0, np.pi + lift), 0) for lift in lifts),
        symbols=tuple(symbols),
        wraps=(WRAPS,),
        orbits=(ORBIT,),
        saddles={"down-up": PlanSaddle((0.0, np.pi), 0.0), "up-down": PlanSaddle((np.pi, 0.0), 1.0)},
    )
    return SimpleNamespace(
        content=replace(content, **more), duration=END, mesh=np.array([0.0, END]),
        state=lambda t: np.moveaxis(motion(np.asarray(t, dtype=float), FIRST, SECOND, directions).T, 0, -1),
    )  # fmt: skip


TIMES = np.arange(0.0, END, 1e-3)


@pytest.mark.parametrize("late", [-0.1, 0.0, 0.1])
def test_a_run_that_is_early_or_late_does_its_symbols_and_departs_at_them_only(late: float) -> None:
    found = decode_run(TIMES, motion(TIMES - late, FIRST, SECOND), plan())
    assert (found.matched, found.wraps, found.lost) == (3, (WRAPS,), None)
    assert found.crossings == pytest.approx((FIRST + late, SECOND + late), abs=1e-3)
    assert [visit.angles[1] for visit in found.visits] == pytest.approx([np.pi, 3 * np.pi, 5 * np.pi])
    stay = found.visits[1]
    assert TIMES[stay.first] == pytest.approx(FIRST + late, abs=0.2)
    assert TIMES[stay.last] == pytest.approx(SECOND + late, abs=0.2)


@pytest.mark.parametrize("more", [-1, 1, 2])
def test_wobbles_more_or_fewer_are_counted(more: int) -> None:
    times = np.arange(0.0, END + more * PERIOD, 1e-3)
    found = decode_run(times, motion(times, FIRST, SECOND + more * PERIOD), plan())
    assert found.wraps == (WRAPS + more,)


def test_a_turn_in_the_wrong_direction_is_lost_at_its_start() -> None:
    found = decode_run(TIMES, motion(TIMES, FIRST, SECOND, (1.0, -1.0)), plan())
    assert found.matched == 2
    assert TIMES[found.lost] == pytest.approx(SECOND, abs=0.3)


@pytest.mark.parametrize("missing", [0, 1])
def test_a_turn_left_out_is_lost(missing: int) -> None:
    angles = motion(TIMES, *((99.0, SECOND) if missing == 0 else (FIRST, 99.0)))
    found = decode_run(TIMES, angles, plan())
    assert found.matched == 1 + missing
    assert found.lost is not None


def test_an_additional_turn_and_back_is_lost() -> None:
    angles = motion(TIMES, FIRST, SECOND)
    angles[:, 1] += turn(TIMES, 3.2) - turn(TIMES, 4.0)
    found = decode_run(TIMES, angles, plan())
    assert found.matched <= 2
    assert TIMES[found.lost] == pytest.approx(3.2, abs=0.2)


def test_angles_that_are_no_numbers_follow_nothing() -> None:
    angles = motion(TIMES, FIRST, SECOND)
    angles[3000:] = np.nan
    found = decode_run(TIMES, angles, plan())
    assert (found.matched, found.lost) == (2, 3000)


def test_a_turn_back_at_the_same_angles_is_distinguished_by_its_direction() -> None:
    there_and_back = plan(directions=(1.0, -1.0))
    found = decode_run(TIMES, motion(TIMES, FIRST, SECOND, (1.0, -1.0)), there_and_back)
    assert (found.matched, found.wraps) == (3, (WRAPS,))
    assert found.crossings == pytest.approx((FIRST, SECOND), abs=1e-3)


def test_a_run_can_wobble_after_the_plans_end() -> None:
    times = np.arange(0.0, END + 2.3 * PERIOD, 1e-3)
    found = decode_run(times, motion(times, FIRST, SECOND), plan())
    assert (found.matched, found.lost) == (3, None)
    angles = motion(times, FIRST, SECOND)
    angles[times > END + PERIOD, 0] += 4.0
    assert times[decode_run(times, angles, plan()).lost] == pytest.approx(END + PERIOD, abs=2e-3)


def test_a_run_whose_clock_skips_a_short_stop_ends_before_it() -> None:
    """The second turn comes a period early, so the plan's time jumps from 3.3 to 4.1 s, over the hold at 3.6 s."""
    turns = plan().content
    first, second = turns.symbols
    before, _, after = turns.stops
    held = plan(
        symbols=(first, replace(first, section=None, time=3.3), replace(first, section=None, time=3.9), second),
        transfers=((3.0, 3.6), (3.7, 4.2)),
        stops=(before, *[replace(before, angles=(0.0, np.pi + TURN))] * 3, after),
        wraps=(None,) * 3,
    )  # fmt: skip
    times = np.arange(0.0, END, 0.005)
    decoded = decode_run(times, motion(times, FIRST, SECOND - PERIOD), held)
    assert decoded.matched == 2


def test_a_kept_stop_may_have_any_phase_of_its_own_orbit() -> None:
    """The other orbit of the plan is faster, and half its period is no bound for the phase at this stop."""
    faster = PlanOrbit("up-down", 1.0, PERIOD / 8, 1e3, np.zeros((2, 4)))
    kept = plan(segments=(FlightSegment("down-up", (0, 1)),), orbits=(ORBIT, faster), wraps=(None,))
    times = np.arange(0.0, END, 0.005)
    angles = motion(times, FIRST, SECOND)
    angles[:, 0] = wobble(times + PERIOD / 2 * np.clip((times - 6.2) / PERIOD, 0, 1))
    decoded = decode_run(times, angles, kept)
    assert decoded.lost is None
    assert decoded.matched == 3
