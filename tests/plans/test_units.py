"""Numbers in another unit: each key of a model and of a rig is named, with the unit that it was probably given in."""

import re

import pytest

from dpcontrol.foundation.errors import Remark
from dpcontrol.foundation.shipped import find, shipped_names
from dpcontrol.plans.itinerary import itinerary_from, load_itinerary
from dpcontrol.plans.model import load_model, model_from

MODEL = find("models", "lab").read_text()
SCENE = """
title = "Hold both arms hanging"
start = "hold"
hold = "down-down"
"""


@pytest.mark.parametrize(
    ("key", "values", "meant"),
    [
        ("acceleration", "981.0", "cm/s² (9.81 m/s²)"),
        ("mass", "[94.0, 61.0]", "g (0.094 kg)"),
        ("length", "[173.0, 240.0]", "mm (0.173 m)"),
    ],
)
def test_a_unit_slip_in_a_model_is_remarked_on_with_the_key_and_the_likely_unit(
    key: str, values: str, meant: str
) -> None:
    text, count = re.subn(rf"(?m)^{key} *= .*$", f"{key} = {values}", MODEL)
    assert count == 1
    found = model_from(text, "own").remarks
    assert f"{key} = " in found[0]
    assert meant in found[0]
    assert "inertia" not in " ".join(found)


@pytest.mark.parametrize(
    ("table", "line", "meant"),
    [
        ("limits", "position = 40", "cm (0.4 m) or in mm (0.04 m)"),
        ("run", "travel = 400", "mm (0.4 m)"),
        ("run", "rate = 1", "kHz (1e+03 Hz)"),
        ("run", "cart_resolution = 1.0", "µm (1e-06 m)"),
        ("run", "cart_mass = 1500", "g (1.5 kg)"),
        ("[run.blows]", "time = 1.0\nimpulse = 20", "mN m s (0.02 N m s)"),
        ("run", "cable_torque = 50", "mN m (0.05 N m)"),
        ("supervisor", "lost_tracking = 86", "degrees (1.5 rad)"),
    ],
)
def test_a_unit_slip_in_a_rig_is_remarked_on_with_the_key_and_the_likely_unit(
    table: str, line: str, meant: str
) -> None:
    with pytest.warns(Remark) as made:
        itinerary_from(f"{SCENE}[{table}]\n{line}\n", "scene", load_model("lab")).remark_on_rig()
    (found,) = (str(one.message) for one in made)
    assert line.splitlines()[-1].partition(" = ")[0] in found
    assert meant in found


@pytest.mark.filterwarnings("error::dpcontrol.foundation.errors.Remark")
def test_nothing_is_remarked_on_in_what_is_shipped() -> None:
    for name in shipped_names("models"):
        load_model(name)
    for name in shipped_names("itineraries"):
        load_itinerary(name)
