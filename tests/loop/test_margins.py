"""Margins of the loop with its filter, against the nonlinear loop run with a drive that differs."""

from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from dpcontrol.control.interface import Controller
from dpcontrol.control.lqr import HoldSettings
from dpcontrol.control.margins import Margins
from dpcontrol.control.tracking import FeedforwardSettings, TvlqrSettings
from dpcontrol.foundation.errors import InputError
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.loop import LoopSettings, sampled_model
from dpcontrol.loop.result import Reading
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.references.problem import Limits

NEAR = 0.07
"""Share of a margin: close to it, the nonlinear loop diverges slowly."""
FREE = Limits(position=1e6, velocity=1e6, acceleration=1e6)
RATE = 1000.0
"""Hz: of the loop along a flight."""
PERTURBED = 1e-7
"""rad: small, so that the difference of two runs is linear, and large against rounding."""


def plan_of(name: str) -> Plan:
    return make_plan(load_itinerary(name))


def difference(
    plan: Plan,
    settings: LoopSettings,
    law: Controller,
    *,
    gain: float = 1.0,
    delay: float = 0.0,
    lag: float = 0.0,
    settled: float,
) -> float:
    """Return by how much the difference of two nonlinear runs grows from the half to the end; at the end without one.

    After `settled` s the drive differs, and one of the two runs is perturbed. The drive is written out here: a queue of
    commands, of which a delay between ticks takes a mean, and a lag whose mean over a period acts.
    """  # fmt: skip
    arms, period = plan.itinerary.model.arms, 1 / settings.rate
    model, runs = sampled_model(arms, settings.rate), []
    begins, unbound = round(settled * settings.rate), replace(plan.reference, limits=FREE)
    for perturbation in (0.0, PERTURBED):
        ticker = Assembly(unbound, arms, settings, law=law, believed_delay=1.0).ticker()
        x, lagging, states = law.first_state.copy(), 0.0, []
        sent = deque([0.0] * 400, maxlen=400)
        for k in range(law.ticks):
            g, d, t = (gain, 1 + delay / period, lag) if k >= begins else (1.0, 1.0, 0.0)
            x[0] += perturbation if k == begins else 0.0
            report = ticker(k, Reading(0.0, x[model.position_indices]))
            sent.append(report[ticker.at["command"], 0])
            whole = int(d + 1e-9)
            acting = g * ((1 - d + whole) * sent[-1 - whole] + (d - whole) * sent[-2 - whole])
            left = np.exp(-period / t) if t else 0.0
            mean = acting + (lagging - acting) * t / period * (1 - left)
            lagging = left * lagging + (1 - left) * acting
            x = model.step(x, mean)
            states.append(x[:4].copy())
            if np.abs(x[:2]).max() > 50:
                return np.inf
        runs.append(np.array(states))
    apart = np.abs(runs[0] - runs[1]).max(axis=1)
    whole, part = len(apart) - begins, (len(apart) - begins) // 6
    before, after = apart[begins + whole // 2 :][:part].max(), apart[-part:].max()
    return np.inf if after > 1e-2 else after / max(before, 1e-14)


def settled_margins(margins: Margins) -> dict[str, float]:
    """Return the margins of the last window, by the names of `Margins.least`."""
    last = (margins.low[-1], margins.high[-1], margins.delay[-1], margins.lag[-1])
    return dict(zip(("gain_low", "gain_high", "delay", "lag"), map(float, last), strict=True))


def check_borders(
    plan: Plan, settings: LoopSettings, margins: Margins, law: Controller, *, settled: float, but: str = ""
) -> None:
    for name, value in settled_margins(margins).items():
        if name == but:
            continue
        key = name.partition("_")[0]
        inside, outside = (1 + NEAR, 1 - NEAR) if name == "gain_low" else (1 - NEAR, 1 + NEAR)
        works = difference(plan, settings, law, **{key: value * inside}, settled=settled)
        fails = difference(plan, settings, law, **{key: value * outside}, settled=settled)
        # Beyond the border what grows may end in a cycle, which does not shrink.
        assert works < 0.97 < fails, f"{name} = {value}: {works} inside, {fails} outside"


@pytest.mark.slow
def test_a_held_equilibrium_is_lost_where_its_margins_end() -> None:
    plan = plan_of("hold-up-up")
    settings = LoopSettings(seed=0, rate=200.0, controller=HoldSettings())
    arms = plan.itinerary.model.arms
    law = replace(Assembly(plan.reference, arms, settings).controller, ticks=1600)
    margins = Assembly(plan.reference, arms, settings, law=law).margins()
    # An eigenvalue without excitation, a zero of hanging arms, stays at 1 to rounding.
    assert margins.growth.max() < 1 + 1e-6
    check_borders(plan, settings, margins, law, settled=4.0)


@pytest.mark.benchmark  # a dozen nonlinear runs of 16 s
def test_a_kept_orbit_is_lost_where_its_margins_end() -> None:
    plan = plan_of("keep-down-up")
    settings = LoopSettings(seed=0)
    arms = plan.itinerary.model.arms
    law = replace(Assembly(plan.reference, arms, settings).controller, ticks=16_000)
    margins = Assembly(plan.reference, arms, settings, law=law).margins()
    # So many times the feedforward would move the orbit itself, which is another than the reference then.
    check_borders(plan, settings, margins, law, settled=6.0, but="gain_high")


@pytest.mark.benchmark(reason="windows along a long flight")
def test_a_flight_has_on_an_orbit_the_margins_of_the_orbit() -> None:
    plan, arms = plan_of("turn-from-rest"), plan_of("turn-from-rest").itinerary.model.arms
    settings = LoopSettings(seed=0, rate=RATE, controller=TvlqrSettings(closing=1.0))
    flight = Assembly(plan.reference, arms, settings).margins()
    kept = settled_margins(Assembly(plan_of("keep-down-up").reference, arms, settings).margins())
    # The walk's own orbit, which it wobbles on, away from both ends of its stay.
    on_orbit = (flight.times > 4.0) & (flight.times < 7.0)
    assert on_orbit.sum() > 4
    # Slow growth, as at too little gain, distinguishes the two limits.
    for name, key, near in (("gain_low", "low", 0.25), ("gain_high", "high", 0.1), ("lag", "lag", 0.1)):
        values = getattr(flight, key)[on_orbit]
        assert np.median(values) == pytest.approx(kept[name], rel=near), name


def test_a_law_without_margins_is_rejected() -> None:
    plan = plan_of("keep-down-up")
    arms = plan.itinerary.model.arms
    with pytest.raises(InputError, match="pulses"):
        Assembly(plan.reference, arms, plan.itinerary.loop).margins()
    with pytest.raises(InputError, match="has no feedback"):
        Assembly(plan.reference, arms, LoopSettings(seed=0, controller=FeedforwardSettings())).margins()
