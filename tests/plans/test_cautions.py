"""Cautions of plans: figures that are known without a run, and changes that help."""

import re
from dataclasses import replace

import numpy as np
import pytest

from dpcontrol.control.interface import sampled_model
from dpcontrol.control.tracking import TvlqrSettings, tracking_controller
from dpcontrol.foundation.causes import CautionCause
from dpcontrol.foundation.errors import InputError
from dpcontrol.plans.authority import connection_loss, peak_gains
from dpcontrol.plans.cautions import REHEARSED, Caution, cautions_of, figures_of, hidden_angles
from dpcontrol.plans.itinerary import Itinerary, itinerary_from, load_itinerary
from dpcontrol.plans.model import load_model
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.plans.planning import shadowing_orbit
from dpcontrol.tubes.connections import find_connections, orbits_between

EXACT = 1e-9  # the same arithmetic on another setting

WITHOUT_AUTHORITY: dict[str, tuple[float, float]] = {
    "mass": (0.189375, 0.0761645),
    "centre_of_mass": (0.166402, 0.106205),
    "length": (0.367051, 0.229191),
    "inertia": (0.00154606, 0.000243133),
}
"""Arms near those whose cart cannot hold Down-Up: s² = g S₁ / (m₁ a₁ (l₁ - a₁) - J₁)."""


def cautions(plan: Plan, **settings: object) -> dict[CautionCause, Caution]:
    return {one.cause: one for one in figures_of(plan.itinerary.with_run(settings), plan.reference)}


def test_a_shipped_itinerary_has_no_caution(plan: Plan) -> None:
    assert plan.warnings == ()
    assert plan.document()["warnings"] == []


def test_arms_with_dry_friction_have_cautions_too(plan: Plan) -> None:
    itinerary = plan.itinerary
    dry = replace(itinerary.model, parameters=replace(itinerary.model.arms, coulomb=(0.05, 0.05)))
    found = {one.cause: one for one in figures_of(replace(itinerary, model=dry), plan.reference)}
    assert found[CautionCause.GAINS].place == "friction"
    # Gravity turns the outer arm by at most m₂ g a₂ = 0.158 N m, so 0.05 N m hide 0.317 rad.
    hidden = hidden_angles(replace(itinerary, model=dry))
    assert hidden["friction"] == pytest.approx(0.05 / (0.137596 * 9.80858 * 0.116779), rel=1e-4)


def test_coarse_encoders_cost_the_feedback_what_finer_ones_do_not(plan: Plan) -> None:
    coarse = cautions(plan, counts=20)[CautionCause.GAINS]
    assert (coarse.place, coarse.change, coarse.value) == ("counts", "counts", 80)
    assert coarse.changed == pytest.approx(coarse.figure / 4, rel=EXACT)
    assert coarse.changed < coarse.limit
    assert CautionCause.GAINS not in cautions(plan, counts=80)
    assert "80 counts" in coarse.remedy


def test_an_untold_lag_is_a_caution_until_it_is_told(plan: Plan) -> None:
    untold = cautions(plan, lag=0.03)
    assert untold[CautionCause.LAG].change == "drive_lag"
    told = cautions(plan, lag=0.03, drive_lag=untold[CautionCause.LAG].value)
    assert CautionCause.LAG not in told
    assert CautionCause.LATE not in told
    slower = cautions(plan, lag=0.15, drive_lag=0.15)[CautionCause.LATE]
    assert (slower.place, slower.changed) == ("lag", pytest.approx(slower.figure / 2, rel=0.1))


def test_a_start_far_off_asks_for_more_than_the_drive_has(plan: Plan) -> None:
    far = cautions(plan, initial_error=0.3)[CautionCause.START]
    assert CautionCause.START not in cautions(plan, initial_error=0.99 * far.value)
    assert CautionCause.START in cautions(plan, initial_error=1.01 * far.value)


def test_a_weight_at_the_tip_gives_arms_without_authority_what_they_need(plan: Plan) -> None:
    itinerary = plan.itinerary
    heavy = replace(itinerary.model.arms, **WITHOUT_AUTHORITY)
    model = replace(itinerary.model, parameters=heavy)
    found = {c.cause: c for c in figures_of(replace(itinerary, model=model), plan.reference)}[CautionCause.AUTHORITY]
    assert found.place == "down-up"
    assert found.figure == heavy.need(np.array([0.0, np.pi]))
    own, weight = heavy.mass[-1], found.value
    assert weight > 0
    middle = (own * heavy.centre_of_mass[-1] + weight * heavy.length[-1]) / (own + weight)
    about = heavy.inertia[-1] + own * heavy.centre_of_mass[-1] ** 2 + weight * heavy.length[-1] ** 2
    changed = replace(
        heavy,
        mass=(heavy.mass[0], own + weight),
        centre_of_mass=(heavy.centre_of_mass[0], middle),
        inertia=(heavy.inertia[0], about - (own + weight) * middle**2),
    )
    assert changed.need(np.array([0.0, np.pi])) == pytest.approx(found.changed, rel=EXACT)
    assert found.changed < found.figure / 5


def test_only_figures_that_rehearsed_runs_confirm_are_cautions(plan: Plan) -> None:
    def found(**settings: object) -> tuple[Caution, ...]:
        return cautions_of(plan.itinerary.with_run(settings), plan.reference)

    # A start this far off succeeds, although its figure is beyond the limit.
    settings = {"initial_error": 0.08}
    assert CautionCause.START in cautions(plan, **settings)
    assert found(**settings) == ()
    assert {one.document()["failed"] for one in found(counts=20)} == {REHEARSED}


FINER = 0.25  # gains at 1 kHz instead of 200 Hz, and a law that weighs the angles more towards the end
MIRRORED = 1e-3  # mirror images to the error of their states and the steps' places


def test_peak_gains_are_those_of_the_law_that_tracks_the_plan() -> None:
    plan = make_plan(load_itinerary("outer-turn"))
    arms = plan.itinerary.model.arms
    law = tracking_controller(plan.reference, sampled_model(arms, 1000.0), TvlqrSettings(closing=1.0))
    assert peak_gains(arms, plan.reference).max() == pytest.approx(np.abs(law.gains[:, :2]).max(), rel=FINER)


def test_mirror_images_of_a_connection_ask_for_the_same_gains() -> None:
    lab = load_model("lab")
    pair = orbits_between(lab.system, "down-up", "down-up", -0.07)
    turns = [c for c in find_connections(*pair).connections if c.symmetric]
    losses = {c.sense: connection_loss(lab.arms, c) for c in sorted(turns, key=lambda c: c.transversality_angle)}
    assert losses[1] == pytest.approx(losses[-1], rel=MIRRORED)


def crossing(energy: object) -> Itinerary:
    return itinerary_from(f'energy = {energy}\nwalk = ["down-up > up-down"]\n', "crossing", load_model("lab"))


@pytest.mark.slow
def test_an_energy_without_the_connection_is_refused_with_one_that_has_it() -> None:
    with pytest.raises(InputError) as refused:
        shadowing_orbit(refusing := crossing(0.178), refusing.walks[0])
    advised = re.search(r"at (\S+) J there are connections for each symbol$", str(refused.value))
    assert advised is not None, str(refused.value)
    itinerary = crossing(advised[1])
    assert shadowing_orbit(itinerary, itinerary.walks[0]).converged
