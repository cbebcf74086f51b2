"""Chart of the adaptive law's weights: what a quiet run costs in runs completed by arms that are far off.

Up: completed at ±30 %, the mean of three itineraries on the bench of the README's table. Across: how far the command is
from the plan under the demo's conditions. Along each line the weights of angles and rates, in multiples of the default;
a line for each first variance of the parameters' errors.

Draws .assets/weights.png and writes weights.json beside this file with DPCONTROL_STORE_WEIGHTS=1. About six minutes
of one core.
"""

import json
import os
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import coarse_benches
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dpcontrol.control.estimator_settings import ADAPTIVE, EkfSettings
from dpcontrol.control.tracking import AdaptiveSettings
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, key, save_figure
from dpcontrol.pages.panels import name_point
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.campaign import Case, Job, cases_of, run_job

pytestmark = pytest.mark.benchmark

FACTORS = (0.5, 1.0, 2.0, 4.0)
FIRST = (0.03, ADAPTIVE["model_error"])
"""Standard deviations of the parameters' relative errors at the start."""
FAR_OFF = ("turn-from-rest", "outer-turn", "cross")
BENCH = {**coarse_benches.BENCH, "mismatch": 0.3}
QUIET, RUNS, FIRST_SEED = 24, 100, 30_000
STORED = Path(__file__).with_name("weights.json")
PICTURE = Path(__file__).parents[2] / ".assets" / "weights.png"


def rows(name: str, options: Mapping[str, Any], factor: float, first: float, runs: int) -> list[dict[str, Any]]:
    plan = make_plan(load_itinerary(name))
    (case,) = cases_of(plan.itinerary, fixed=options, over={})
    law, default = case.loop.controller, AdaptiveSettings()
    assert isinstance(law, AdaptiveSettings)
    loop = replace(
        case.loop,
        controller=replace(law, angle=factor * default.angle, rate=factor * default.rate),
        estimator=EkfSettings(**{**ADAPTIVE, "model_error": first}),
    )
    seeds = tuple(range(FIRST_SEED, FIRST_SEED + runs))
    job = Job(name, plan.archive, plan.itinerary.model.arms, Case("", (), loop), seeds, "compiled", replayed=0)
    return run_job(job)


def measured(factor: float, first: float) -> dict[str, float]:
    quiet = rows("outer-turn", {}, factor, first, QUIET)
    done = [row["completed"] for name in FAR_OFF for row in rows(name, BENCH, factor, first, RUNS)]
    feedback, error = (float(np.median([row[key] for row in quiet])) for key in ("rms_feedback", "rms_tracking_error"))
    return {
        "factor": factor, "first": first, "command_minus_plan": feedback, "tracking_error": error,
        "completed": float(np.mean(done)),
    }  # fmt: skip


def test_no_weights_are_both_quieter_and_safer_than_the_default_by_much() -> None:
    found = []
    for first in FIRST:
        for factor in FACTORS:
            found.append(measured(factor, first))
            sys.stdout.write(f"\n{json.dumps(found[-1])}\n")
    if os.environ.get("DPCONTROL_STORE_WEIGHTS") == "1":
        STORED.write_text(json.dumps(found, indent=1) + "\n")
        save_figure(drawn(found), PICTURE)
    default = next(one for one in found if one["factor"] == 1 and one["first"] == ADAPTIVE["model_error"])
    for one in found:
        quieter = one["command_minus_plan"] < 0.8 * default["command_minus_plan"]
        assert not (quieter and one["completed"] > default["completed"] + 0.02), one


def drawn(found: list[dict[str, float]]) -> Figure:
    colours = dict(zip(sorted({one["first"] for one in found}), (style.SERIES[0], style.SERIES[1]), strict=True))
    (default,) = (o for o in found if o["factor"] == 1 and o["first"] == ADAPTIVE["model_error"])
    best = max(found, key=lambda one: one["completed"])
    more = best["command_minus_plan"] / default["command_minus_plan"] - 1
    shares = (100 * one["completed"] for one in (best, default))
    title = "Heavier weights complete up to {:.0f} % instead of {:.0f} % of runs at ±30 %".format(*shares)
    title += f", for {100 * more:.0f} % more command"

    def draw(axes: Axes) -> None:
        axes.set(xlabel="command minus plan in the demo, m/s² rms", ylabel="runs completed at ±30 %")
        for first, colour in colours.items():
            line = [one for one in found if one["first"] == first]
            x, y = ([one[key_of] for one in line] for key_of in ("command_minus_plan", "completed"))
            axes.plot(x, y, "o-", color=colour, markersize=5)
            for one, across, up in zip(line, x, y, strict=True):
                name_point(axes, f"× {one['factor']:g}", (across, up), colour, weight="normal")
        ring = {"marker": "o", "linestyle": "none", "markerfacecolor": "none", "color": style.LIMIT}
        axes.plot(default["command_minus_plan"], default["completed"], markersize=14, **ring)
        axes.margins(0.1, 0.15)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        lines = [(f"parameters first known to {first:.0%}", colour) for first, colour in colours.items()]
        key(axes, [*lines, ("default", {"markersize": 9, **ring})])

    text = "Labels: weights of angles and rates, in multiples of the default."
    return Page(title, text, width=8.0).row(draw, height=3.6).figure()
