"""Arguments of the wrong type are refused by name."""

from math import inf, nan
from pathlib import Path

import numpy as np
import pytest

from dpcontrol.foundation.checked import Hit, check, number
from dpcontrol.foundation.errors import InputError


@pytest.mark.parametrize("value", [None, "x", nan, inf, True])
def test_values_that_are_not_finite_numbers_are_refused(value):
    with pytest.raises(InputError, match=r"energy = .*: must be a finite number"):
        number("energy", value)


@pytest.mark.parametrize("value", [None, "3", 0, 1.5, True])
def test_values_that_are_not_integers_in_range_are_refused(value):
    with pytest.raises(InputError, match=r"hit = .*: must be a whole number, 1 to 1000"):
        check("hit", value, Hit)
    check("hit", np.int64(3), Hit)


def test_values_that_are_not_paths_are_refused():
    with pytest.raises(InputError, match="must be one short line of text or the path of a file"):
        check("file", b"log.mcap", str | Path)
