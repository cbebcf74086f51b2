"""Arguments of the wrong type are refused by name."""

from math import inf, nan

import numpy as np
import pytest

import dpcontrol as dp
from dpcontrol.foundation.arguments import path, whole
from dpcontrol.foundation.checked import number
from dpcontrol.foundation.errors import InputError


@pytest.mark.parametrize("value", [None, "x", nan, inf, True, pytest.param(10**5000, id="thousands of digits")])
def test_values_that_are_not_finite_numbers_are_refused(value):
    with pytest.raises(InputError, match=r"energy = .*: must be a finite number"):
        number("energy", value)


@pytest.mark.parametrize("value", [None, "3", 0, 1.5, True])
def test_values_that_are_not_integers_in_range_are_refused(value):
    with pytest.raises(InputError, match=r"hits = .*: must be a whole number from 1 to 9"):
        whole("hits", value, least=1, most=9)
    assert whole("hits", 3.0, least=1, most=9) == 3


def test_values_that_are_not_paths_are_refused():
    with pytest.raises(InputError, match="must be the path of a file"):
        path("file", b"log.mcap")


@pytest.mark.slow
def test_values_of_options_are_one_a_list_or_an_array():
    one, listed, array = (
        dp.campaign("hold-down-down", runs=1, over={"lag": lag}, workers=1)
        for lag in (0.002, [0.002], np.array([0.002]))
    )
    assert one.rows == listed.rows == array.rows
