"""Blocks of ticks have the results of single ticks, which pass through `SimulatedRig` and `Ticker` one by one."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import dpcontrol.loop.loop
from dpcontrol.loop.blocks import Blocks
from dpcontrol.loop.result import Events
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.runs.run import assembled


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
