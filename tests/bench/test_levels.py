"""Levels of the model: errors by an independent integrator, sufficient levels and remarks."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evidence_text import evidence_text
from quick_rate import quick_rate
from scipy.integrate import solve_ivp

from dpcontrol.bench.levels import WINDOW, can_be_conservative, motions, plant_at
from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.plans.itinerary import Itinerary, load_itinerary
from dpcontrol.plans.model import load_model
from dpcontrol.plans.run_options import RunOptions
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import ANGLE_SCALE, RATE_SCALE, Limits
from dpcontrol.references.reference import Reference, still
from dpcontrol.runs import evidence as shipped
from dpcontrol.runs.evidence import (
    Evidence,
    LevelRuns,
    known_evidence,
    motion_key,
    plan_remarks,
    run_remarks,
)

SCENES = sorted(path.stem for path in (Path(__file__).parents[2] / "itineraries").glob("*.toml"))
SAME = 1e-6  # Relative, of errors of 1e-3 that both integrators know to 1e-10.
ARMS = load_model("lab").arms
FULL = LevelRuns(5, 5, 1.0, 0.02)


def released(angles: tuple[float, float]) -> Reference:
    """A reference that stands where nothing can stand: what the levels do from there is a free fall."""
    state = np.array([*angles, 3.0, -2.0, 0.0, 0.0])
    return still(state, 0.5, method=method_named("radau-3"), limits=Limits(), interval=0.1)


def fallen(equations, parameters, state: np.ndarray) -> np.ndarray:
    function, held = quick_rate(equations), np.zeros(equations.input_count)

    def rate(_, x):
        return np.array(function(x, held, parameters)).ravel()

    return solve_ivp(rate, (0, WINDOW), state, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]


def test_errors_of_levels_are_distances_between_falls_by_another_integrator():
    state = np.array([0.4, 2.8, 3.0, -2.0, 0.0, 0.0])
    full = plant_at("force", ARMS)
    expected = {}
    ends = {"force": fallen(full.equations, full.numbers(), np.append(state, 0.0))}
    for name, level, arms in (
        ("conservative", Level.CONSERVATIVE, ARMS.frictionless()),
        ("dissipative", Level.DISSIPATIVE, ARMS),
    ):
        ends[name] = fallen(arm_chain_equations(2, level), arms.base(), state[:4])
    for name in ("conservative", "dissipative"):
        away = (ends[name][:4] - ends["force"][:4]) / [ANGLE_SCALE, ANGLE_SCALE, RATE_SCALE, RATE_SCALE]
        expected[name] = np.abs(away).max()
    found = {p.method: p.error for p in motions(released((0.4, 2.8)), ARMS).points}
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=SAME)


def test_a_level_that_adds_nothing_makes_no_error():
    found = {p.method: p.error for p in motions(released((1.0, 2.0)), ARMS.frictionless()).points}
    # Without friction and with a cart at rest, the three lower levels are equal.
    assert found["conservative"] == found["dissipative"] == found["cart"]
    assert found["drive"] == pytest.approx(found["cart"], rel=SAME)
    # Only a cart that the arms push about differs.
    assert found["cart"] > 1e-4


def evidence(*, conservative: LevelRuns | None = None, cart: LevelRuns = FULL, drive: LevelRuns = FULL) -> Evidence:
    references = {"cart": FULL} if conservative is None else {"conservative": conservative, "cart": FULL}
    return Evidence("scene", "key", references, {"cart": cart, "drive": drive, "force": FULL})


@pytest.mark.parametrize(
    ("runs", "enough"),
    [
        (replace(FULL, error=0.0165), "cart"),
        (replace(FULL, error=0.0155), "drive"),
        (replace(FULL, error=0.0255), "drive"),
        (replace(FULL, completed=4), "drive"),
        (replace(FULL, effort=0.3), "cart"),
    ],
)
def test_a_plant_level_is_enough_if_completion_and_error_stay_within_a_fifth(runs, enough):
    assert evidence(cart=runs).plant_level == enough


def test_where_no_lower_plant_agrees_the_fullest_is_needed():
    assert evidence(cart=replace(FULL, completed=3), drive=replace(FULL, completed=4)).plant_level == "force"


@pytest.mark.parametrize(
    ("effort", "completed", "enough"), [(1.19, 5, "conservative"), (1.21, 5, "cart"), (1.0, 4, "cart")]
)
def test_a_conservative_reference_is_enough_up_to_a_fifth_more_effort(effort, completed, enough):
    found = evidence(conservative=LevelRuns(5, completed, effort, 0.5))
    assert found.reference_level == enough


def test_evidence_reads_back_as_it_was_written(monkeypatch, tmp_path):
    written = [
        evidence(conservative=replace(FULL, effort=2.125)),
        replace(evidence(), scene="two-part", motion="other"),
    ]
    (tmp_path / "level_evidence.toml").write_text(evidence_text(written))
    monkeypatch.setattr(shipped, "files", lambda package: tmp_path)
    known_evidence.cache_clear()
    try:
        assert list(known_evidence().values()) == written
    finally:
        known_evidence.cache_clear()


@pytest.mark.parametrize("name", [name for name in SCENES if load_itinerary(name).model.arms.count == 2])
def test_each_shipped_scene_of_two_arms_has_evidence_of_its_own_motion(name):
    found = known_evidence().get(motion_key(load_itinerary(name)))
    assert found is not None, f"{name} changed: make its evidence anew, see dpcontrol/runs/level_evidence.toml"
    assert found.scene == name
    assert ("conservative" in found.references) == can_be_conservative(load_itinerary(name))


def with_reference(scene: Itinerary, level: str) -> Itinerary:
    return replace(scene, reference=replace(scene.reference, level=level))


def test_what_fits_the_evidence_is_not_remarked():
    scene = load_itinerary("outer-turn")
    assert plan_remarks(scene) == run_remarks(scene) == ()


def test_a_reference_without_friction_is_called_less_than_the_evidence_supports():
    (text,) = plan_remarks(with_reference(load_itinerary("outer-turn"), "conservative"))
    assert '[reference] level = "conservative" is less than the evidence asks for, "cart"' in text
    assert 'with "conservative" 1 of 1 runs completed' in text


def test_a_plant_with_a_drive_and_a_heavy_cart_is_called_more_than_the_evidence_supports():
    scene = load_itinerary("outer-turn").with_run(RunOptions(lag=0.005, cart_mass=3.0))
    (text,) = run_remarks(scene)
    assert '[run] plant = "force" is more than the evidence supports: "cart" is enough' in text
    assert "5 of 5 runs completed" in text


@pytest.mark.parametrize(
    "asked",
    [{"lag": 0.02}, {"lag": 0.005, "mismatch": 0.1}, {"lag": 0.005, "rate": 500.0}, {"lag": 0.005, "cart_mass": 0.2}],
)
def test_of_a_longer_lag_a_lighter_cart_or_other_settings_than_the_evidences_nothing_is_said(asked):
    assert run_remarks(load_itinerary("outer-turn").with_run(RunOptions(**asked))) == ()


def test_of_another_motion_or_other_arms_nothing_is_said():
    scene = with_reference(load_itinerary("outer-turn"), "conservative")
    (walk,) = scene.walks
    other = replace(scene, parts=(replace(walk, energy=-0.06),))
    heavier = replace(scene, model=load_model("printed"))
    assert plan_remarks(other) == plan_remarks(heavier) == ()
