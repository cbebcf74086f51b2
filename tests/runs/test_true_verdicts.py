"""Verdicts held against a second decoder of another method; thousands of runs are among the benchmarks."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from generated_itineraries import write_itinerary
from verdict_runs import Comparison, drawn_options, for_plan

from dpcontrol.foundation.causes import Fault, ShortfallCause
from dpcontrol.judge.decoding import shortfall
from dpcontrol.judge.score import Flown, verdict_on
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan

_SETTLES = 0.1
"""Time before the first transfer at which the arm of a timely run hangs, s; less than the next case is late."""


def exact(plan: Plan) -> Flown:
    """The run that follows the reference exactly."""
    reference = plan.reference
    times = np.arange(0.0, reference.duration, 1e-3)
    states = reference.state(times)
    limits = reference.limits
    return Flown(
        time=times, states=states, reference_angles=states[:, :2], applied=np.zeros(len(times)), rate_hz=1000.0,
        limits=(limits.position + 1e-6, limits.velocity, limits.acceleration),
    )  # fmt: skip


@pytest.mark.slow
def test_a_wide_orbit_between_a_transfer_and_a_hold_is_a_stop() -> None:
    plan, random, found = make_plan(load_itinerary("two-energies")), np.random.default_rng(1), Comparison()
    assert verdict_on(exact(plan), plan.reference).completed
    found.add(plan, {"mismatch": 0.0}, [0, 1], random)
    assert found.completed == 2
    found.add(plan, {"mismatch": 0.3}, [0, 1, 2, 3], random)
    found.add(plan, {"mismatch": 0.02, "controller": "feedforward"}, [0], random)
    assert found.completed < found.runs
    assert not found.false


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 12])
def test_drawn_itineraries_are_judged_as_a_second_decoder_judges_them(seed: int, tmp_path: Path) -> None:
    """One whose stops are kept; one that ends without a wobble, which the plan must refuse, and then with one."""
    file, random, found = write_itinerary(tmp_path, seed), np.random.default_rng(seed), Comparison()
    plan = make_plan(load_itinerary(str(file)))
    if seed != 11:
        assert not plan.converged
        assert "raise lead_out to 1" in plan.status
        file.write_text(file.read_text().replace("lead_out = 0", "lead_out = 1"))
        plan = make_plan(load_itinerary(str(file)))
    assert plan.converged
    assert verdict_on(exact(plan), plan.reference).completed
    found.add(plan, for_plan(drawn_options(random), plan), list(range(2 if seed == 11 else 6)), random)
    found.add(plan, {"mismatch": 0.0}, [0], random)
    assert found.completed > 0
    assert found.wrong > 0
    assert not found.false


@pytest.mark.slow
@pytest.mark.parametrize("on_fall", ["resume", "restart"])
def test_runs_that_fall_and_go_on_are_judged_as_a_second_decoder_judges_them(on_fall: str, plan: Plan) -> None:
    options = {"on_fall": on_fall, "knocks_per_minute": 20.0, "knock_impulse": 0.05, "travel": 0.8, "mismatch": 0.05}
    plan = replace(plan, itinerary=plan.itinerary.with_run(options))
    found = Comparison()
    found.add(plan, options, [0, 1], np.random.default_rng(0))
    assert not found.false


@pytest.mark.slow
def test_a_run_from_rest_is_judged_from_its_first_transfer_on() -> None:
    """An arm that starts upright hangs when the transfer begins, later, or only once the transfer has ended."""
    plan, random, found = make_plan(load_itinerary("turn-from-rest")), np.random.default_rng(0), Comparison()
    flown, begin = exact(plan), plan.content.transfers[0][0]
    for late, completed in ((0.0, True), (0.2, False), (3.0, False)):
        states = flown.states.copy()
        states[:, 1] += np.pi * (flown.time < begin - _SETTLES + late)
        other = replace(flown, states=states)
        assert verdict_on(other, plan.reference).completed is completed, late
    found.add(plan, {"initial_error": np.pi, "initial_rate": 10.0, "travel": 0.8}, list(range(6)), random)
    assert 0 < found.completed < found.runs
    assert not found.false


def test_an_itinerary_on_an_orbit_asks_for_its_start(plan: Plan) -> None:
    flown = exact(plan)
    states = flown.states.copy()
    states[:, 0] += np.pi * (flown.time < 0.05)
    assert verdict_on(replace(flown, states=states), plan.reference).fault is Fault.NOT_BEGUN


def test_a_run_of_another_plan_is_not_completed(plan: Plan) -> None:
    """The same turn the other way round, and the arms exchanged."""
    flown = exact(plan)
    assert verdict_on(flown, plan.reference).completed
    mirrored = flown.states.copy()
    mirrored[:, 1] = 2 * np.pi - mirrored[:, 1]
    mirrored[:, 0] *= -1
    for states in (mirrored, flown.states[:, [1, 0, 3, 2, 4, 5]]):
        other = replace(flown, states=states, reference_angles=states[:, :2])
        assert not verdict_on(other, plan.reference).completed


def test_a_reference_that_does_not_do_its_itinerary_is_refused_with_what_to_change(plan: Plan) -> None:
    reference = plan.reference
    assert shortfall(reference) is None
    content = reference.content
    stops = content.stops[0], replace(content.stops[1], angles=(0.0, 5 * np.pi))
    far = shortfall(replace(reference, plan=replace(content, stops=stops)))
    assert (far.cause, far.stop, far.content.lead_out) == (ShortfallCause.FAR, 1, 2)
    short = reference.mesh[-1] - content.orbits[0].period * 2.5
    rows = int(np.searchsorted(reference.mesh, short))
    cut = replace(
        reference, mesh=reference.mesh[: rows + 1], states=reference.states[:rows], inputs=reference.inputs[:rows]
    )
    missed = shortfall(cut)
    assert missed.cause is ShortfallCause.LAST_FAR
