"""The gain of recovery and catching under blows: the guide's figures of two blows in a run, and catching alone.

Each takes some ten minutes of one core.
"""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from dpcontrol.judge.decoding import stays
from dpcontrol.judge.score import Flown, verdict_on
from dpcontrol.logs import CATCH, RESUME, RETURN
from dpcontrol.loop import recovery
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.result import BatchRun, Events
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.night import night_itinerary

pytestmark = pytest.mark.benchmark

COMMON = {"mismatch": 0.05, "lag": 0.005, "command_noise": 0.3, "zero_error": 0.01}
BENCH = {**COMMON, "drive_lag": 0.005, "knocks_per_minute": 2.0, "knock_impulse": 0.03}
TWICE = {**COMMON, "on_fall": "resume", "initial_error": 0.05, "travel": 0.8, "pushes": 2}
BLOWN = range(70_000, 70_100)
"""Seeds of runs with two blows."""
SEEDS, SECONDS = range(40_001, 40_009), 300
ITINERARY, SPARED = "round-trip", 1
"""Where catching spares at least so many falls."""


def times(sink: Events, which: str) -> list[float]:
    """Return when something happened, of returns those after a fall, s."""
    return [event.time for event in sink.kept if event.name == which and (which != RETURN or event.level == "warn")]


@pytest.mark.parametrize("name", ["outer-turn", "turn-from-rest"])
@pytest.mark.parametrize("impulse", [0.003, 0.01])
def test_two_blows_are_recovered_from(name: str, impulse: float) -> None:
    scene = load_itinerary(name).with_run({**TWICE, "push_impulse": impulse})
    plan = make_plan(scene)
    law = Assembly(plan.reference, scene.model.arms, scene.loop).controller
    how = Assembly(plan.reference, scene.model.arms, scene.loop, law=law, stays=stays(plan.reference)).recovery
    done, falls, catches, back = 0, 0, 0, list[float]()
    for seed in BLOWN:
        told, settings = Events(), replace(scene.loop, seed=seed)
        result = Assembly(plan.reference, scene.model.arms, settings, law=law).simulate(recovery=how, sink=told)
        flown = Flown.of(BatchRun.of(result), rate_hz=settings.rate, limits=settings.limits(plan.reference.limits))
        done += verdict_on(flown, plan.reference).completed
        falls, catches = falls + result.falls, catches + len(times(told, CATCH))
        resumed = np.array(times(told, RESUME))
        back += [float(resumed[resumed > time].min(initial=math.inf)) - time for time in times(told, RETURN)]
    back = [seconds for seconds in back if seconds < math.inf] or [0.0]
    sys.stdout.write(
        f"\n{name}, {impulse} N m s: {done} completed, {falls} falls, {catches} catches, "
        f"back {np.median(back):.1f} s ({np.quantile(back, 0.99):.1f} s)\n"
    )
    assert done == len(BLOWN)


def test_catching_spares_falls(monkeypatch) -> None:
    scene = night_itinerary(load_itinerary(ITINERARY).with_run(BENCH), overrides={})
    plan = make_plan(scene)
    scene = plan.followed().itinerary
    assembly = Assembly(plan.reference, scene.model.arms, scene.loop, stays=stays(plan.reference))
    falls = {}
    for catches in (False, True):
        with monkeypatch.context() as patch:
            if not catches:
                patch.setattr(recovery, "_FAR", math.inf)
            falls[catches] = caught = 0
            for seed in SEEDS:
                told = Events()
                until = round(SECONDS * scene.loop.rate)
                assembly.simulate(draw=assembly.draw(seed=seed), sink=told, until=until, keep=False)
                falls[catches] += len(times(told, RETURN))
                caught += len(times(told, CATCH))
        sys.stdout.write(f"\ncatching {catches}: {falls[catches]} falls, caught {caught} times\n")
    assert falls[False] - falls[True] >= SPARED
