"""Ends, places of the cart and times of transfers that an itinerary can ask for."""

import numpy as np
import pytest

from dpcontrol.plans.itinerary import Itinerary, itinerary_from
from dpcontrol.plans.model import load_model
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.runs.run import run_plan

ROUNDING = 1e-9
COARSE = '[reference]\nmethod = "radau-5"\ninterval = 0.1\ntolerance = 1e-3\n'
"""What is asked here is where motions lead, not how exact they are."""
UP_AND_ASIDE = """
start = "rest"
[[parts]]
hold = "up"
seconds = 1.0
[[parts]]
hold = "up"
seconds = 1.0
[[parts]]
hold = "up"
seconds = 1.0
cart = 0.1
"""


def asked(text: str, model: str = "lab") -> Itinerary:
    return itinerary_from(text, "motion", load_model(model))


@pytest.fixture(scope="module")
def up_and_aside() -> Plan:
    return make_plan(asked(UP_AND_ASIDE + COARSE, "single"))


def test_an_itinerary_ends_at_its_last_hold_with_the_cart_where_it_says(up_and_aside: Plan) -> None:
    itinerary, reference = up_and_aside.itinerary, up_and_aside.reference
    assert (itinerary.start, itinerary.finish) == ("rest", "hold")
    assert reference.converged
    first, last = reference.state(0.0), reference.state(reference.duration)
    assert first == pytest.approx(np.zeros(4), abs=ROUNDING)
    assert [np.cos(last[0]), *last[1:]] == pytest.approx([-1, 0, 0.1, 0], abs=ROUNDING)


def test_a_hold_that_goes_on_has_no_transfer_and_a_side_step_has_one(up_and_aside: Plan) -> None:
    content = up_and_aside.content
    assert [symbol.text for symbol in content.symbols] == ["rest to up", "side-step at up"]
    assert [stop.saddle for stop in content.stops] == ["down", "up", "up"]
    (_, landed), (left, _) = content.transfers
    assert left - landed == pytest.approx(2.0), "two holds of a second without a motion between them"


def test_a_run_that_stays_up_is_scored(up_and_aside: Plan) -> None:
    score = run_plan(up_and_aside).score()
    assert score.completed
    assert "held at up to the end" in score.reason


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "saddles"),
    [
        (
            'start = "rest"\nfinish = "hold"\nenergy = -0.07\nwalk = ["down-up +"]\n',
            ["down-down", "down-up", "down-up"],
        ),
        ('start = "hold"\nfinish = "orbit"\nenergy = -0.07\nwalk = ["down-up +"]\n', ["down-up", "down-up"]),
        ('start = "hold"\nfinish = "rest"\nhold = "down-up"\n', ["down-up", "down-down"]),
    ],
)
def test_each_end_follows_any_part(text: str, saddles: list[str]) -> None:
    plan = make_plan(asked(text))
    assert plan.converged
    assert [stop.saddle for stop in plan.content.stops] == saddles
    states = plan.reference.state(np.array([0.0, plan.reference.duration]))
    orbits = [not np.allclose(state[2:], 0) for state in states]
    assert orbits == [False, 'finish = "orbit"' in text]


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ('start = "hold"\nhold = "up-up"\n', "lqr"),
        ('start = "hold"\nhold = "up-up"\ncart = 0.1\n', "adaptive"),
        ('start = "hold"\nfinish = "rest"\nhold = "up-up"\n', "adaptive"),
        ('start = "rest"\nfinish = "hold"\nhold = "up-up"\n', "adaptive"),
    ],
)
def test_only_a_stay_in_the_middle_is_held_by_default(text: str, kind: str) -> None:
    assert asked(text).loop.controller.kind == kind
