"""Preflights agree with campaigns of other seeds: the rate is in its interval, each limit within 25 % of a finer one.

It prints a row for each limit; `-k up-up` runs one itinerary alone. Each takes some three minutes of two cores.
"""

import math
import resource
import sys
from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from scipy.optimize import isotonic_regression

from dpcontrol.judge.preflight import HazardBorder, Preflight
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.runs.campaign import CampaignSettings, Case, cases_of, run_campaign
from dpcontrol.runs.preflight import PreflightSettings, preflight

pytestmark = pytest.mark.benchmark

SCENES = ("turn-from-rest", "up-up", "round-trip-from-rest", "outer-turn", "cross", "turn-cross-turn-return")
BENCH = {
    "lag": 0.005,
    "command_noise": 0.3,
    "initial_error": 0.05,
    "zero_error": 0.02,
    "counts": 40_000,
    "travel": 0.8,
    "mismatch": 0.1,
}
RUNS, FINER_RUNS, FIRST_SEED = 1000, 300, 30_000
SIZE = PreflightSettings()
NEAR = 1.25
RATIOS = NEAR ** np.array([-1.0, 0.0, 1.0])
"""Factors on a limit at which a finer campaign searches for its own limit."""
PROCESSOR_SECONDS = 240.0
"""Two minutes of two processors, in processor time, which other work hardly changes."""


@cache
def planned(name: str) -> Plan:
    return make_plan(load_itinerary(name))


@cache
def own_rate(name: str) -> float:
    (rate,) = shares(name, cases_of(load_itinerary(name), fixed=BENCH, over={}), RUNS)
    return rate


@cache
def found_for(name: str) -> tuple[Preflight, float]:
    """Return a scene's preflight, and what it took of processors in s: next to nothing where it was kept."""
    planned(name)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    found = preflight(planned(name), BENCH, settings=SIZE)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return found, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def shares(name: str, cases: Sequence[Case], runs: int) -> list[float]:
    settings = CampaignSettings(runs=runs, first_seed=FIRST_SEED, replayed=0)
    return [result.completed.rate for result in run_campaign(planned(name), cases, settings=settings, yes=True).results]


def finer(name: str, border: HazardBorder, values: Sequence[float], own: float) -> list[float]:
    """Return success rates at these values, in the limit's unit, relative to that of the unchanged bench."""
    factor = 1000 / load_itinerary(name).loop.rate if border.setting == "delay" else SHOWN.get(border.setting, 1.0)
    settings = [value / factor for value in values]
    over = {border.setting: [round(v) for v in settings] if border.setting in ("delay", "counts") else settings}
    fixed = {**BENCH, "pushes": 2} if border.setting == "push_impulse" else BENCH
    cases = cases_of(load_itinerary(name), fixed=fixed, over=over)
    return [share / own for share in shares(name, cases, FINER_RUNS)]


SHOWN = {"lag": 1e3, "mismatch": 100.0, "push_impulse": 1e3, "zero_error": 1e3, "travel": 1e3}
"""Factors from settings to their printed values."""


@pytest.mark.parametrize("name", SCENES)
def test_the_rate_of_a_campaign_lies_in_the_interval(name: str) -> None:
    found, seconds = found_for(name)
    rate = own_rate(name)
    sys.stdout.write(f"\n{name}: {found.status}; {rate:.1%} of {RUNS:,}, in {seconds:.0f} s of processor time\n")
    assert found.share.low <= rate <= found.share.high
    assert seconds < PROCESSOR_SECONDS


@pytest.mark.parametrize("name", SCENES)
def test_borders_are_those_of_a_finer_campaign(name: str) -> None:
    own = own_rate(name)
    wrong = []
    for border in found_for(name)[0].borders:
        if border.border is None:
            (share,) = finer(name, border, [border.end], own)
            said, right = f"{share:.0%} at {border.end:.3g}", share >= 0.4
        else:
            values = sorted(border.border * RATIOS, reverse=border.falling)
            curve = isotonic_regression(finer(name, border, values, own), increasing=False).x
            at = crossing(np.log(values), curve)
            right = at is not None and abs(at - math.log(border.border)) <= math.log(NEAR)
            percent = ", ".join(f"{share:.0%}" for share in curve)
            said = f"{'nowhere near' if at is None else f'{math.exp(at):.3g}'} ({percent})"
        sys.stdout.write(f"\n{name}, {border.name}: {border.sentence} ({border.interval}), finer {said}")
        if not right:
            wrong.append(f"{border.name}: {border.sentence}, by a finer campaign {said}")
    sys.stdout.write("\n")
    assert not wrong, f"{name}: {'; '.join(wrong)}"


def crossing(x: np.ndarray, falls: np.ndarray) -> float | None:
    """Return the place at which a falling curve is a half, or None."""
    return float(np.interp(0.5, falls[::-1], x[::-1])) if falls[-1] < 0.5 <= falls[0] else None
