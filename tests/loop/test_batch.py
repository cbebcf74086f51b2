"""Many seeds side by side and each alone: the same code, so the same states to the last bit, and the same endings."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shadowing_stand_in import LAB

import dpcontrol.loop.loop
from dpcontrol.control.estimator_settings import EkfSettings, UkfSettings
from dpcontrol.control.tracking import FeedforwardSettings, TvlqrSettings
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.bench import DisturbanceSettings, DriveSettings, MechanicsSettings, SensorSettings
from dpcontrol.loop.blocks import Blocks
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.result import BatchRun, Ending, Events, SupervisorSettings
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.references.reference import Reference
from dpcontrol.runs.run import assembled

BY_ITSELF = 1e-9
"""Tolerance of the states, in rad, rad/s, m and m/s; of commands a thousand times more.

A law with internal timing sums its products in another order for one run than for many. The arms' instability amplifies
the rounding.
"""
SMOOTH = SensorSettings(counts=0, cart_resolution=0.0, noise=5e-5, cart_noise=1e-6)
"""Readings are not rounded, because rounding would turn a difference of 1e-16 into a count of 1e-4 rad."""
BASE = LoopSettings(seed=0, mismatch=0.05, initial_error=0.03)
SEEDS = (3, 4)


def with_drive(**values: float) -> LoopSettings:
    return replace(BASE, drive=DriveSettings(**values))


def with_sensors(**values: float) -> LoopSettings:
    return replace(BASE, sensors=SensorSettings(**values))


def with_mechanics(**values: Any) -> LoopSettings:
    return replace(BASE, mechanics=MechanicsSettings(**values))


KEPT_UP = {
    "as it is": BASE,
    "lag, 1.6 periods and a heavy cart": with_drive(lag=0.005, delay=1.6, cart_mass=4.0, cart_viscous=1.0),
    "noisy, weak, jerky drive, pushes and knocks": replace(
        with_drive(command_noise=0.3, response=0.95, jerk=2000.0),
        disturbances=DisturbanceSettings(pushes=3, push_impulse=2e-4, knocks=2, knock_velocity=0.02),
    ),
    "readings of unknown age, some missing, and a delay of 1.4 periods": replace(
        with_sensors(jitter=7e-4, dropout=0.1), drive=DriveSettings(delay=1.4, lag=0.005)
    ),
    "zeros that are estimated": replace(with_sensors(zero_error=0.02), estimator=EkfSettings(augment=("zeros",))),
    "gains by phase": replace(BASE, mismatch=0.02, controller=TvlqrSettings(schedule="phase"), sensors=SMOOTH),
    "a delay too long to unroll": with_drive(delay=10.0),
    "lag that the controller knows of": replace(with_drive(lag=0.02), drive_lag=0.02),
    "belt that the controller knows of": with_mechanics(belt=15.0, belt_scale="cart"),
    "play, stiction, a cable and another start": with_mechanics(
        play=(0.01, 0.006), stiction=5e-4, cable_torque=2e-3, cable_stiffness=1e-3, initial_rate=0.1, initial_cart=0.01
    ),
}
"""Bench and loop of runs that come to their end."""

WHERE_IT_BREAKS = {
    "no feedback": (replace(BASE, controller=FeedforwardSettings()), Ending.TRACKING_LOST),
    "short track": (replace(BASE, travel=0.03, initial_error=0.2), Ending.CART_STOP),
    "switch before the limit": (
        replace(BASE, initial_error=0.2, drive=DriveSettings(track=0.4, switch_margin=0.375)), Ending.CART_STOP,
    ),
    "hard stop before the limit": (replace(BASE, initial_error=0.2, drive=DriveSettings(track=0.02)), Ending.CART_STOP),
    "a drive that gives nothing": (replace(BASE, drive=DriveSettings(response=0.0), sensors=SensorSettings()),
        Ending.DRIVE_FAILED,
    ),
    "believing too much": (
        replace(
            BASE, mismatch=0.3, initial_error=0.1,
            estimator=EkfSettings(augment=("zeros",), parameter_error=0.0, rate_noise=1e-4, cart_noise=1e-3),
            supervisor=SupervisorSettings(lost_estimate=6.0),
        ),
        Ending.ESTIMATE_LOST,
    ),
}  # fmt: skip
"""Settings at which runs end early, and how at least one of them does."""


def both(reference: Reference, settings: LoopSettings) -> tuple[list[BatchRun], list[BatchRun]]:
    """Return the runs of SEEDS in lockstep, and tick by tick."""
    controller = Assembly(reference, LAB, settings).controller
    together = Assembly(reference, LAB, settings, law=controller).batch(SEEDS)
    assembly = Assembly(reference, LAB, settings, law=controller)
    alone = [BatchRun.of(assembly.simulate(draw=assembly.draw(seed=seed))) for seed in SEEDS]
    return together, alone


def assert_same(one: BatchRun, other: BatchRun, within: float = 0.0) -> None:
    assert (one.ending, one.reason) == (other.ending, other.reason)
    assert len(one.times) == len(other.times)
    for name in ("times", "truth", "references", "applied", "nis_inside_95", "rms_feedback"):
        first, second = np.asarray(getattr(one, name)), np.asarray(getattr(other, name))
        assert first.shape == second.shape
        bound = 1000 * within if name in ("applied", "rms_feedback") else within
        assert np.abs(first - second).max() <= bound * max(1.0, float(np.abs(second).max())), name


@pytest.mark.parametrize(
    "settings",
    [
        pytest.param(settings, id=name, marks=pytest.mark.slow if k else [])
        for k, (name, settings) in enumerate(KEPT_UP.items())
    ],
)
def test_a_seed_alone_is_the_seed_among_others(reference: Reference, settings: LoopSettings) -> None:
    together, alone = both(reference, settings)
    by_phase = isinstance(settings.controller, TvlqrSettings) and settings.controller.schedule == "phase"
    for one, other in zip(together, alone, strict=True):
        assert_same(one, other, within=BY_ITSELF if by_phase else 0.0)
        assert one.ending is Ending.FINISHED
    # A test of equal runs would prove nothing.
    assert np.abs(together[0].truth - together[1].truth).max() > 1e-3


@pytest.mark.parametrize(("settings", "ending"), WHERE_IT_BREAKS.values(), ids=WHERE_IT_BREAKS.keys())
def test_a_seed_alone_ends_where_and_as_it_does_among_others(
    reference: Reference, settings: LoopSettings, ending: Ending
) -> None:
    together, alone = both(reference, settings)
    for one, other in zip(together, alone, strict=True):
        assert_same(one, other)
    assert ending in {run.ending for run in together}


@pytest.mark.parametrize(
    "settings",
    [
        replace(BASE, estimator=UkfSettings()),
        with_sensors(stuck_at=1.0),
        replace(BASE, sensors=SensorSettings(missed_counts=1.0)),
        replace(BASE, supervisor=SupervisorSettings(resynchronise=0.5)),
    ],
)
def test_settings_without_lockstep_are_known(reference: Reference, settings: LoopSettings) -> None:
    assembly = Assembly(reference, LAB, BASE)
    assert assembly.lockstep
    assert not assembly.under(settings).lockstep


@cache
def planned() -> Plan:
    return make_plan(load_itinerary("cross"))


CASES: dict[str, Mapping[str, Any]] = {
    "as shipped": {},
    "noise and gaps": {"noise": 5e-4, "cart_noise": 1e-4, "rate_noise": 0.05, "command_noise": 0.3, "dropout": 0.05},
    "blows": {"knocks_per_minute": 60.0, "knock_impulse": 0.003, "zero_drift": 0.01},
    "a lag and a delay": {"lag": 0.005, "drive_lag": 0.005, "delay": 2.0, "jerk": 500.0, "response": 0.98},
    "a lost run": {"mismatch": 0.6},
    "exact sensors": {"counts": 0, "cart_resolution": 0.0},
    "a missing encoder": {"encoders": (True, False), "dropout": 0.05},
    "a fast loop": {"rate": 2000.0},
}


@pytest.mark.parametrize("name", CASES)
def test_a_run_in_blocks_equals_the_run_tick_by_tick(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = planned()
    assembly = assembled(replace(plan, itinerary=plan.itinerary.with_run(CASES[name])))
    computed: list[int] = []
    run = Blocks.run

    def counted(*arguments: Any) -> int:
        computed.append(run(*arguments))
        return computed[-1]

    monkeypatch.setattr(Blocks, "run", counted)
    draw, told, told_singly = assembly.draw(seed=3), Events(), Events()
    blocks = assembly.simulate(draw=draw, sink=told)
    monkeypatch.setattr(dpcontrol.loop.loop, "blocks_of", lambda *_: None)
    singly = assembly.simulate(draw=draw, sink=told_singly)
    for part in ("times", "measured", "estimates", "references", "truth", "control", "extras"):
        assert getattr(blocks.ticks, part).tobytes() == getattr(singly.ticks, part).tobytes()
    assert repr(told.kept) == repr(told_singly.kept)
    assert blocks.hardest == singly.hardest
    # Blocks end where the cart brakes after a fall.
    assert sum(computed) >= len(blocks.ticks.times) / 2
    assert len(blocks.thinking) == len(singly.thinking) == np.count_nonzero(singly.ticks.times >= 0)


def test_the_controller_of_a_plan_is_read_from_the_cache_for_equal_settings_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = make_plan(load_itinerary("turn-from-rest"))
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path))
    made, read = (assembled(plan).controller for _ in range(2))
    assert len(list((tmp_path / "controllers").iterdir())) == 1
    assert all(np.array_equal(vars(made)[name], vars(read)[name]) for name in ("gains", "extra_gains", "pair_gains"))
    for change in ({"angle": 5000.0}, {"rate": 800}, {"drive_lag": 0.002}):
        other = assembled(replace(plan, itinerary=plan.itinerary.with_run(change))).controller
        assert not np.array_equal(vars(other)["gains"], vars(made)["gains"])
