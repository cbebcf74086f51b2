"""What a motion asks of its feedback."""

import numpy as np
import pytest

from dpcontrol.control.interface import sampled_model
from dpcontrol.control.tracking import TvlqrSettings, tracking_controller
from dpcontrol.plans.authority import connection_loss, peak_gains
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.model import load_model
from dpcontrol.plans.plan import make_plan
from dpcontrol.tubes.connections import find_connections, orbits_between

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
