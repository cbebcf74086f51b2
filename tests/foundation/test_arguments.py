"""Arguments of the wrong type are refused by name."""

from math import inf, nan

import numpy as np
import pytest

import dpcontrol as dp
from dpcontrol.foundation.arguments import path, whole
from dpcontrol.foundation.checked import number
from dpcontrol.foundation.errors import InputError

HUGE = 10**400


@pytest.fixture(scope="module")
def orbit():
    return dp.orbit(dp.load_model("lab"), "down-up", energy=-0.07)


@pytest.mark.parametrize(
    "value", [None, "x", 1j, nan, inf, HUGE, True, [], pytest.param(10**5000, id="thousands of digits")]
)
def test_values_that_are_not_finite_numbers_are_refused(value):
    with pytest.raises(InputError, match=r"energy = .*: must be a finite number"):
        number("energy", value)


@pytest.mark.parametrize("value", [None, "3", 0, 1.5, nan, HUGE, True])
def test_values_that_are_not_integers_in_range_are_refused(value):
    with pytest.raises(InputError, match=r"hits = .*: must be a whole number from 1 to 9"):
        whole("hits", value, least=1, most=9)
    assert whole("hits", 3.0, least=1, most=9) == 3


@pytest.mark.parametrize("value", [None, 3, b"log.mcap", []])
def test_values_that_are_not_paths_are_refused(value):
    with pytest.raises(InputError, match="must be the path of a file"):
        path("file", value)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda orbit: dp.orbit(orbit.system, "down-up", energy=HUGE), "energy = 1000"),
        (lambda orbit: dp.orbit(orbit.system, "down-up", energy=None), "energy = None"),
        (lambda orbit: dp.connections(orbit, seconds=HUGE), "seconds = "),
        (lambda orbit: dp.connections(orbit, longest="x"), "longest = 'x'"),
        (lambda orbit: dp.connections(orbit, hits=(0, 1)), "hits = 0"),
        (lambda orbit: dp.atlas(orbit.system, energy=-0.07, hits=(None, 1)), "hits = None"),
        (lambda orbit: dp.atlas(orbit.system, energy=1j), "energy = 1j"),
        (lambda orbit: dp.graph(orbit.system, energy=-0.07, symbols=[None]), "symbols = None: must be text"),
        (
            lambda orbit: dp.find_bifurcations(orbit.system, "down-up", "down-up", energies=("x", 1)),
            "energies = 'x'",
        ),
        (
            lambda orbit: dp.find_bifurcations(orbit.system, "down-up", "down-up", energies=(-0.1, 0), samples=0),
            "samples = 0",
        ),
        (lambda _: dp.load_model(3), "name = 3"),
        (lambda _: dp.open_log(None), "file = None"),
        (lambda _: dp.open_plan(3), "file = 3"),
        (lambda _: dp.picture(3), "result = 3: must be a Run"),
        (lambda _: dp.Section.plane("x", (0, 0)), "needs a direction"),
        (lambda _: dp.Section.plane("x", (0, 1), period=0), "must be positive"),
    ],
)
def test_functions_refuse_arguments_of_the_wrong_type(orbit, call, words):
    with pytest.raises(InputError) as refused:
        call(orbit)
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: dp.plan(3), "itinerary = 3"),
        (lambda: dp.plan("one-arm", workers="x"), "workers = 'x'"),
        (lambda: dp.run(None), "planned = None"),
        (lambda: dp.run("one-arm", settings=3), "settings = 3"),
        (lambda: dp.run("one-arm", log=3), "log = 3"),
        (lambda: dp.campaign([]), "planned = []"),
        (lambda: dp.campaign("one-arm", over=3), "over = 3"),
        (lambda: dp.campaign("one-arm", over={"lag": "x"}), "lag = 'x': must be a number"),
        (lambda: dp.campaign("one-arm", over={"lag": []}), "over: lag has no values"),
        (lambda: dp.campaign("one-arm", first_seed=None), "first_seed = None"),
        (lambda: dp.closed_loop(3), "planned = 3"),
        (lambda: dp.closed_loop("one-arm", settings=()), "settings = ()"),
        (lambda: dp.export("one-arm", 3), "folder = 3"),
        (lambda: dp.polish(3), "planned = 3"),
        (lambda: dp.polish("one-arm", runs="x"), "runs = 'x'"),
        (lambda: dp.reference(3), "walks = 3"),
        (lambda: dp.reference([None]), "walks = None"),
        (lambda: dp.shadow(3, ["down-up +"]), "found = 3"),
        (lambda: dp.shadow([3], ["down-up +"]), "found = 3"),
        (lambda: dp.orbit(3, "down-up", energy=0.1), "model = 3"),
        (lambda: dp.swings(3), "model = 3"),
        (lambda: dp.swings(dp.load_model("lab"), count="x"), "count = 'x'"),
        (lambda: dp.swings(dp.load_model("lab"), seconds=None), "seconds = None"),
        (lambda: dp.identify([3], model=dp.load_model("lab")), "recordings = 3"),
    ],
)
def test_objects_of_the_wrong_type_are_refused_by_name(call, words):
    with pytest.raises(InputError) as refused:
        call()
    assert str(refused.value).startswith(words)


@pytest.mark.slow
def test_one_option_value_needs_no_list():
    one, listed = (dp.campaign("outer-turn", runs=1, over={"lag": lag}, workers=1) for lag in (0.002, [0.002]))
    assert one.rows == listed.rows


@pytest.mark.slow
def test_option_values_can_be_an_array():
    campaign = dp.campaign("outer-turn", runs=1, over={"lag": np.array([0.0, 0.002])}, workers=1)
    assert campaign.completed.runs == 2
