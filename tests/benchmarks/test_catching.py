"""What catching buys: the same runs under blows, where one that errs goes on from an earlier place, and where not.

Prints a row for each, and how often a catch at so much of a cost to go was followed by a fall within 1.5 s. Takes some
ten minutes of one core.
"""

import math
import re
import sys
from dataclasses import replace

import numpy as np
import pytest

from dpcontrol.logs import CATCH, RETURN
from dpcontrol.loop import recovery
from dpcontrol.loop.loop import loop_controller, loop_recovery, run_loop
from dpcontrol.loop.result import NoSink
from dpcontrol.scenes.itinerary import load_itinerary
from dpcontrol.scenes.night import night_itinerary
from dpcontrol.scenes.plan import make_plan
from dpcontrol.scenes.run_options import RunOptions

pytestmark = pytest.mark.benchmark

BENCH = RunOptions(
    mismatch=0.05, lag=0.005, drive_lag=0.005, command_noise=0.3, zero_error=0.01, knocks_per_minute=2.0,
    knock_impulse=0.03,
)  # fmt: skip
SEEDS, SECONDS = range(40_001, 40_009), 300
EDGES = (10.0, 30.0, 100.0, 300.0, math.inf)
"""Of costs to go."""


class Told(NoSink):
    def __init__(self) -> None:
        self.events: list[tuple[float, str, str]] = []

    def event(self, time_s, level, name, text) -> None:
        if name == CATCH or (name == RETURN and level == "warn"):
            self.events.append((time_s, name, text))


def test_catching_spares_falls(monkeypatch) -> None:
    scene = night_itinerary(load_itinerary("round-trip").with_run(BENCH), asked={})
    plan = make_plan(scene)
    scene = plan.followed().itinerary
    law = loop_controller(plan.reference, scene.model.arms, scene.loop)
    how = loop_recovery(plan.reference, scene.model.arms, scene.loop, law)
    falls, costs, fell = {}, [], []
    for catches in (False, True):
        with monkeypatch.context() as patch:
            if not catches:
                patch.setattr(recovery, "_FAR", math.inf)
            falls[catches] = caught = 0
            for seed in SEEDS:
                told = Told()
                run_loop(
                    plan.reference, scene.model.arms, settings=replace(scene.loop, seed=seed), controller=law,
                    recovery=how, sink=told, until=round(SECONDS * scene.loop.rate), keep=False,
                )  # fmt: skip
                ends = np.array([time for time, name, _ in told.events if name == RETURN])
                for time, name, text in told.events:
                    if name == CATCH:
                        costs.append(float(re.search(r"instead of (\S+)", text)[1]))
                        fell.append(bool(((ends > time) & (ends < time + 1.5)).any()))
                falls[catches] += len(ends)
                caught += sum(name == CATCH for _, name, _ in told.events)
        minutes = len(SEEDS) * SECONDS / 60
        sys.stdout.write(f"\n{minutes:g} minutes, catching {catches}: {falls[catches]} falls, caught {caught} times")
    which = np.digitize(costs, EDGES)
    for k, least in enumerate(EDGES[:-1]):
        here = which == k + 1
        sys.stdout.write(f"\ncost to go from {least:g}: {here.sum()} catches, {np.array(fell)[here].sum()} then fell")
    sys.stdout.write("\n")
    assert falls[True] < falls[False]
