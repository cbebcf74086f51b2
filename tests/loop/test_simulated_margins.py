"""Margins of whole runs, against runs on the simulated bench with a drive that differs, with and without dry friction.

The bench has its own integrator, encoders and drive; none of it is shared with what computes the margins.
"""

from dataclasses import replace

import numpy as np
import pytest

from dpcontrol.control.lqr import HoldController
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.result import BatchRun, Ending
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan

NEAR, NEAR_WITH_DRY_FRICTION, LOST_WITH_DRY_FRICTION = 0.25, 0.35, 1.0
"""Share by which a margin may miss the border of the simulated runs. In flight with dry friction the border is no line:
runs with other first errors are lost one by one over a range of lags and gains, most of them within twice the margin.
"""
KEPT = 0.3
"""rad from the reference, over the last tenth of a run."""
SHAKEN = 0.5
"""rms of what feedback moves the cart by, as a share of its greatest acceleration: more is a swing that limits contain.
"""
SEEDS = range(16)
BENCH = {"initial_error": 2e-3, "counts": 40_000, "travel": 0.8}


def keeps(run: BatchRun, most: float) -> bool:
    tail, n = len(run.times) // 10, run.references.shape[1]
    away = np.abs(run.truth[-tail:, :n] - run.references[-tail:]).max()
    return run.ending is Ending.FINISHED and away < KEPT and run.rms_feedback < most


FLIGHTS = [
    pytest.param("turn-from-rest", 0.0, marks=pytest.mark.benchmark),
    pytest.param("cross-from-rest", 0.005, marks=pytest.mark.benchmark),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "coulomb"), [("hold-up-up", 0.005), *FLIGHTS])
def test_runs_are_lost_where_their_margins_end(name: str, coulomb: float) -> None:
    scene = load_itinerary(name).with_run(BENCH)
    reference, settings = make_plan(scene).reference, scene.loop
    arms = replace(scene.model.arms, coulomb=(coulomb, coulomb / 2), smoothing=0.005) if coulomb else scene.model.arms
    law = Assembly(reference, arms, settings).controller
    if isinstance(law, HoldController):
        law = replace(law, ticks=round(10 * settings.rate))
    believed, wrong = settings.drive.delay, []
    for margin, (value, _) in Assembly(reference, arms, settings, law=law).margins().least().items():

        def most_keep(value: float, key: str = margin.partition("_")[0]) -> bool:
            changes = {
                "gain": {"response": value},
                "delay": {"delay": believed + value * settings.rate},
                "lag": {"lag": value},
            }
            changed = replace(settings, drive=replace(settings.drive, **changes[key]))
            bench = Assembly(reference, arms, changed, law=law, believed_delay=believed)
            runs = bench.batch(SEEDS)
            most = SHAKEN * bench.limits.acceleration / changed.drive.response
            return 2 * sum(keeps(run, most) for run in runs) > len(SEEDS)

        line = not coulomb or isinstance(law, HoldController)
        near, far = (NEAR, NEAR) if line else (NEAR_WITH_DRY_FRICTION, LOST_WITH_DRY_FRICTION)
        inside, outside = (1 + near, 1 - near) if margin == "gain_low" else (1 - near, 1 + far)
        wrong += [f"{margin} {value:.3g}: lost inside"] * int(not most_keep(value * inside))
        # A drive that gives more than ten times its command is not simulated.
        outside = min(value * outside, 10.0) / value
        wrong += [f"{margin} {value:.3g}: kept outside"] * int(most_keep(value * outside))
    assert not wrong
