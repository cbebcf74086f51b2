"""Walks whose stops are kept: the plan has whole periods of sustained orbits between flights, and OGY hands over to
TVLQR and back. Expected times come from the connections' own, and states from flying the stored input again.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol

from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.handover import Program
from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.dynamics.propagator import PolynomialInputPropagator
from dpcontrol.foundation.errors import InputError
from dpcontrol.judge.decoding import decode_run
from dpcontrol.judge.score import score
from dpcontrol.logs import RunLog, read_log
from dpcontrol.loop.assembly import Assembly
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan, plan_key
from dpcontrol.references.problem import state_scale
from dpcontrol.references.trajectory import power_coefficients
from dpcontrol.runs.run import run_plan

FLOWN_AGAIN = 1e-6
"""Scaled: the tolerance of the mesh, for an interval flown again on its own input."""
NO_JUMP = 1e-9
"""Scaled: flights end on the orbits that are joined, but for the solver's bounds."""
NEAR_ORBIT = 0.1
"""rad: what a completed period asks for."""
TRAVEL = 0.4
WALK = {"energy": "-0.07", "walk": '["down-up +", "down-up -"]', "wraps": "[6]", "lead_in": "3", "lead_out": "3"}
Writer = Callable[..., Path]


@pytest.fixture
def scene(tmp_path: Path) -> Writer:
    """Write an itinerary: keys of the walk replaced, a value of None left out, tables as they are."""

    def write(*tables: str, keep: str = 'keep = "ogy"', **changes: str | None) -> Path:
        keys = {**WALK, **changes}
        lines = [f"{key} = {value}" for key, value in keys.items() if value is not None]
        file = tmp_path / "scene.toml"
        file.write_text("\n".join([*lines, "[controller]", keep, *tables]) + "\n")
        return file

    return write


@pytest.fixture(scope="module")
def linger() -> Plan:
    return make_plan(load_itinerary("linger"))


def stays(plan: Plan) -> list[int]:
    """The whole periods of each stay."""
    return [entry["periods"] for entry in plan.notes["program"] if "keep" in entry]


def planned_wraps(plan: Plan) -> tuple[int | None, ...]:
    """The wraps of a reference itself, counted as those of a run are."""
    times = np.arange(0.0, plan.reference.duration, 1e-3)
    angles = plan.reference.state(times)[:, :2]
    decoded = decode_run(times, angles, plan.reference)
    assert decoded.matched == len(plan.notes["stops"])
    return decoded.wraps


@pytest.mark.slow
def test_the_reference_has_the_requested_wraps(linger: Plan) -> None:
    assert planned_wraps(linger) == linger.itinerary.wraps == (8, 6)
    assert len(stays(linger)) == 4
    assert stays(linger)[1] >= 6
    assert stays(linger)[2] >= 5


@pytest.mark.slow
def test_flights_and_stays_are_one_motion(linger: Plan) -> None:
    """Each interval, flown again on its own input, ends where the next begins."""
    reference, model = linger.reference, linger.itinerary.model
    assert reference.converged
    points = reference.method.points
    propagator = PolynomialInputPropagator(
        arm_chain_equations(2, Level.CART), model.arms.base(), degree=len(points) - 1
    )
    scale = state_scale(6, reference.limits)
    coefficients, lengths = power_coefficients(points, reference.inputs[..., 0]), np.diff(reference.mesh)
    for k in range(len(lengths) - 1):
        landed = propagator.flow(
            reference.states[k, 0], coefficients[k] / lengths[k] ** np.arange(len(points)), lengths[k]
        )
        assert (np.abs(landed - reference.states[k + 1, 0]) / scale).max() < FLOWN_AGAIN
    assert reference.constraint_violation < NO_JUMP


def test_a_stay_repeats_one_period_of_its_orbit(linger: Plan) -> None:
    entry = linger.notes["program"][2]
    first, last = entry["rows"]
    states, rows = linger.reference.states, last - first
    for k in range(entry["periods"]):
        begin = first + k * rows
        assert np.array_equal(states[begin : begin + rows], states[first:last])


@pytest.mark.slow
def test_a_long_stay_costs_no_more_than_a_short_one(scene: Writer) -> None:
    short = make_plan(load_itinerary(str(scene())))
    long = make_plan(load_itinerary(str(scene(wraps="[40]"))))
    assert planned_wraps(long) == (40,)
    assert stays(long)[1] - stays(short)[1] == 34
    assert long.reference.iterations == short.reference.iterations


def test_a_stop_without_room_for_a_period_is_flown_through(scene: Writer) -> None:
    plan = make_plan(load_itinerary(str(scene(wraps="[0]"))))
    flights = [entry["fly"] for entry in plan.notes["program"] if "fly" in entry]
    assert flights == ["down-up +, down-up -"]
    assert planned_wraps(plan) == (0,)


def test_only_the_file_decides_the_plan(scene: Writer) -> None:
    kept = load_itinerary(str(scene()))
    assert plan_key(kept.with_run({"keep": "none", "controller": "adaptive"})) == plan_key(kept)
    assert plan_key(load_itinerary(str(scene(keep="")))) != plan_key(kept)
    assert kept.with_run({"controller": "adaptive"}).loop.keep == "none"


def flown(plan: Plan, out: Path, seed: int, **settings: float | str) -> RunLog:
    itinerary = plan.itinerary.with_run({**settings}, seed=seed)
    run_plan(replace(plan, itinerary=itinerary), out)
    return read_log(out)


def handed_over(log: RunLog) -> list[str]:
    return [event.text.partition(":")[0] for event in log.events if event.text.startswith("hand over")]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, pytest.param(10, marks=pytest.mark.benchmark)])
def test_ogy_hands_over_to_tvlqr_and_back_with_a_plant_five_per_cent_off(
    linger: Plan, tmp_path: Path, seed: int
) -> None:
    # The first pulses have no time for zeros.
    loop = replace(linger.itinerary.loop, keep="ogy", estimator=EkfSettings(augment=()))
    by_pulses = replace(linger, itinerary=replace(linger.itinerary, loop=loop))
    log = flown(by_pulses, tmp_path / "run.mcap", seed, mismatch=0.05, initial_error=0.03)
    assert handed_over(log) == ["hand over to tvlqr", "hand over to ogy"] * 3
    assert log.truth is not None
    assert np.abs(log.truth[:, 4]).max() < TRAVEL
    # The orbit that it began on, whole turns apart: the last period is on it by the true state.
    orbit = linger.reference.extra["orbit_0"]
    period = linger.notes["orbits"][0]["period"]
    angles = log.truth[log.time > log.time[-1] - period, :2] - linger.notes["stops"][-1]["angles"] + [0, np.pi]
    gaps = np.abs(angles[:, None] - orbit[None, :, :2]).max(-1).min(1)
    assert gaps.max() < NEAR_ORBIT
    judged = score(log)
    assert judged.completed, judged.reason
    assert judged.wraps == (8, 6)


@pytest.mark.slow
def test_a_run_is_repeated_from_its_log_message_for_message(scene: Writer, tmp_path: Path) -> None:
    log = tmp_path / "first.mcap"
    done = dpcontrol("run", scene(), "--mismatch", "0.03", "--seed", "4", "--set", "hold=nearest", "--out", log)
    assert done.code == 0, done.message
    again = dpcontrol("run", "--from", log, "--out", tmp_path / "again.mcap")
    assert again.code == 0
    assert "messages are identical" in again.stdout


@pytest.mark.slow
def test_other_controllers_follow_the_same_reference(scene: Writer, tmp_path: Path) -> None:
    table = tmp_path / "c.parquet"
    shown = dpcontrol(
        "campaign", scene(), "--runs", "2", "--workers", "1", "--over", "keep=ogy,tvlqr,none", "--out", table, "--json"
    )
    assert shown.code == 0, shown.message
    assert [case["keep"] for case in shown.document["cases"]] == ["ogy", "tvlqr", "none"]
    assert shown.document["completed"] == 6


@pytest.mark.slow
def test_programs_and_fallbacks_are_left_to_the_loop(scene: Writer) -> None:
    plan = make_plan(load_itinerary(str(scene())))
    itinerary, arms = plan.itinerary, plan.itinerary.model.arms
    kept = Assembly(plan.reference, arms, itinerary.loop)
    assert isinstance(kept.controller, Program)
    assert kept.controller.kind == "tvlqr, stays by ogy"
    assert not kept.lockstep
    tracking = Assembly(plan.reference, arms, itinerary.with_run({"keep": "none"}).loop)
    assert tracking.lockstep
    assert not tracking.under(itinerary.with_run({"keep": "none", "hold": "nearest"}).loop).lockstep


def test_a_reference_without_stays_has_nothing_to_keep() -> None:
    plan = make_plan(load_itinerary("outer-turn"))
    loop = plan.itinerary.with_run({"controller": "tvlqr", "keep": "ogy"}).loop
    with pytest.raises(InputError, match="the reference was planned without stays"):
        _ = Assembly(plan.reference, plan.itinerary.model.arms, loop).controller


@pytest.mark.parametrize(
    ("changes", "naming"),
    [
        ({"keep": 'keep = "ogi"'}, "did you mean 'ogy'?"),
        ({"keep": 'kind = "adaptive"\nkeep = "ogy"'}, 'kind = "tvlqr", not "adaptive"'),
        ({"start": '"rest"'}, "one walk from orbit to orbit"),
        ({"tables": ("[reference]", 'level = "conservative"')}, "orbits are kept by the cart's motion"),
        ({"tables": ("[supervisor]", 'hold = "nerest"')}, "did you mean 'nearest'?"),
        ({"tables": ("[run]", 'keep = "ogy"')}, "'keep' is unknown"),
    ],
)
def test_a_mistake_is_one_sentence(changes: dict[str, str], naming: str, scene: Writer) -> None:
    tables = changes.pop("tables", ())
    ended = dpcontrol("plan", scene(*tables, **changes))
    assert ended.code == 2
    assert naming in ended.message
    assert len(ended.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("option", "naming"), [(("--set", "keep=ogi"), "'ogy'"), (("--set", "hold=neares"), "'nearest'"),
                           (("--controller", "adaptive", "--set", "keep=ogy"), 'not "adaptive"')],
)  # fmt: skip
def test_a_mistaken_option_is_one_sentence(option: tuple[str, ...], naming: str, scene: Writer) -> None:
    ended = dpcontrol("run", scene(), *option)
    assert ended.code == 2
    assert naming in ended.message
    assert len(ended.stderr.strip().splitlines()) == 1


def test_a_walk_with_kept_stops_and_recovery_is_rejected_before_planning() -> None:
    with pytest.raises(InputError, match=r"keep = 'tvlqr'.* run with --set keep=none"):
        load_itinerary("linger").with_run({"on_fall": "resume"})
    assert load_itinerary("linger").with_run({"on_fall": "resume", "keep": "none"}).loop.keep == "none"
