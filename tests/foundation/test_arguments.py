"""Arguments of Python functions that are of the wrong kind are refused in a sentence that names them."""

from math import inf, nan

import pytest

import dpcontrol as dp
from dpcontrol.foundation.arguments import number, path, whole
from dpcontrol.foundation.errors import InputError

HUGE = 10**400


@pytest.fixture(scope="module")
def orbit():
    return dp.orbit(dp.load_model("lab"), "down-up", energy=-0.07)


@pytest.mark.parametrize(
    "value", [None, "x", 1j, nan, inf, HUGE, True, [], pytest.param(10**5000, id="thousands of digits")]
)
def test_what_is_no_finite_number_is_refused(value):
    with pytest.raises(InputError, match=r"energy = .*: must be a finite number"):
        number("energy", value)


@pytest.mark.parametrize("value", [None, "3", 0, 1.5, nan, HUGE, True])
def test_what_is_no_whole_number_in_bounds_is_refused(value):
    with pytest.raises(InputError, match=r"hits = .*: must be a whole number from 1 to 9"):
        whole("hits", value, least=1, most=9)
    assert whole("hits", 3.0, least=1, most=9) == 3


@pytest.mark.parametrize("value", [None, 3, b"log.mcap", []])
def test_what_is_no_path_is_refused(value):
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
        (lambda orbit: dp.graph(orbit.system, energy=-0.07, symbols=[None]), "a symbol is a text"),
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
        (lambda _: dp.picture(3), "int: a picture is of a run"),
        (lambda _: dp.Section.plane("x", (0, 0)), "needs a direction"),
        (lambda _: dp.Section.plane("x", (0, 1), period=0), "must be positive"),
    ],
)
def test_functions_refuse_arguments_of_the_wrong_kind(orbit, call, words):
    with pytest.raises(InputError) as refused:
        call(orbit)
    assert words in str(refused.value)
