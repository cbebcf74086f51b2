"""Numbers in another unit: each key of a model and of a rig is named, with the unit that it was probably given in."""

import re
import warnings
from pathlib import Path

import pytest

from dpcontrol.foundation.errors import InputError, InputErrors, Remark
from dpcontrol.foundation.shipped import find, known
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.model import load_model

MODEL = find("models", "lab").read_text()
SCENE = """
title = "Hold both arms hanging"
start = "hold"
hold = "down-down"
"""


def remarks_on_model(folder: Path, key: str, values: str) -> list[str]:
    """Return the remarks on the lab's model with other values of a key."""
    text, count = re.subn(rf"(?m)^{key} *= .*$", f"{key} = {values}", MODEL)
    assert count == 1
    (folder / "model.toml").write_text(text)
    with warnings.catch_warnings(record=True) as made:
        warnings.simplefilter("always", Remark)
        load_model(str(folder / "model.toml"))
    return [str(one.message) for one in made]


def remarks_on_rig(folder: Path, table: str, line: str) -> list[str]:
    """Return the remarks on a scene with one line in a table."""
    (folder / "scene.toml").write_text(f"{SCENE}[{table}]\n{line}\n")
    with warnings.catch_warnings(record=True) as made:
        warnings.simplefilter("always", Remark)
        load_itinerary(str(folder / "scene.toml"))
    return [str(one.message) for one in made]


@pytest.mark.parametrize(
    ("key", "values", "meant"),
    [
        ("acceleration", "981.0", "cm/s² (9.81 m/s²)"),
        ("acceleration", "9810.0", "mm/s² (9.81 m/s²)"),
        ("mass", "[94.0, 61.0]", "g (0.094 kg)"),
        ("length", "[17.3, 24.0]", "cm (0.173 m)"),
        ("length", "[173.0, 240.0]", "mm (0.173 m)"),
    ],
)
def test_a_unit_slip_in_a_model_is_remarked_on_with_the_key_and_the_likely_unit(
    tmp_path: Path, key: str, values: str, meant: str
) -> None:
    found = remarks_on_model(tmp_path, key, values)
    assert f" {key} = " in found[0]
    assert meant in found[0]
    assert "inertia" not in " ".join(found)


def test_arms_of_a_few_grams_are_recognised_by_what_their_length_weighs(tmp_path: Path) -> None:
    (first, *_) = remarks_on_model(tmp_path, "mass", "[9.4, 0.06]")
    assert "mass = 9.4 kg of arm 1 is much for a length of" in first
    assert "is it given in g (0.0094 kg)?" in first


@pytest.mark.parametrize(
    ("table", "line", "meant"),
    [
        ("limits", "position = 40", "cm (0.4 m) or in mm (0.04 m)"),
        ("limits", "velocity = 3000", "mm/s (3 m/s)"),
        ("limits", "acceleration = 3000", "cm/s² (30 m/s²)"),
        ("run", "track = 40", "cm (0.4 m)"),
        ("run", "travel = 400", "mm (0.4 m)"),
        ("run", "rate = 1", "kHz (1e+03 Hz)"),
        ("run", "initial_error = 2.0", "degrees (0.0349 rad)"),
        ("run", "drive_lag = 1.0", "ms (0.001 s)"),
        ("run", "lag = 0.5", "ms (0.0005 s)"),
        ("run", "jitter = 0.5", "ms (0.0005 s)"),
        ("run", "cart_resolution = 1.0", "µm (1e-06 m)"),
        ("run", "zero_error = 1.0", "degrees (0.0175 rad)"),
        ("run", "zeros = [180.0, 0.0]", "degrees (3.14 rad)"),
        ("run", "cart_mass = 1500", "g (1.5 kg)"),
        ("run", "knock_velocity = 100", "mm/s (0.1 m/s)"),
        ("run", "push_impulse = 10", "mN m s (0.01 N m s)"),
        ("run", "tilt = 0.5", "degrees (0.00873 rad)"),
        ("run", "switch_margin = 10", "mm (0.01 m)"),
        ("[run.blows]", "time = 1.0\nimpulse = 20", "mN m s (0.02 N m s)"),
        ("[run.blows]", "impulse = 0.002\ntime = 2000", "ms (2 s)"),
        ("run", "stuck_sensor = 1\nstuck_at = 3000", "ms (3 s)"),
        ("run", "stuck_sensor = 1\nstuck_at = 3\nstuck_for = 500", "ms (0.5 s)"),
        ("run", "cable_torque = 50", "mN m (0.05 N m)"),
        ("run", "stiction = 5", "mN m (0.005 N m)"),
        ("run", "play = [0.01, 0.6]", "degrees (0.0105 rad)"),
        ("run", "initial_rate = 500", "degrees/s (8.73 rad/s)"),
        ("run", "initial_cart = 50", "cm (0.5 m)"),
        ("supervisor", "lost_tracking = 86", "degrees (1.5 rad)"),
        ("supervisor", "resynchronise = 30", "degrees (0.524 rad)"),
        ("supervisor", "missing = 50", "ms (0.05 s)"),
        ("estimator", "first_angle = 2.0", "degrees (0.0349 rad)"),
    ],
)
def test_a_unit_slip_in_a_rig_is_remarked_on_with_the_key_and_the_likely_unit(
    tmp_path: Path, table: str, line: str, meant: str
) -> None:
    (found,) = remarks_on_rig(tmp_path, table, line)
    assert line.splitlines()[-1].partition(" = ")[0] in found
    assert meant in found


@pytest.mark.parametrize(
    ("table", "line", "said"),
    [
        ("run", "zeros = [1e9, 0.0]", "[run] zeros = 1e+09 rad"),
        ("run", "stuck_sensor = 9", "[run] stuck_sensor = 9: must be 0 to 2"),
        ("limits", "position = 40000", "[limits] position = 40000 m"),
    ],
)
def test_impossible_numbers_of_a_rig_are_rejected(tmp_path: Path, table: str, line: str, said: str) -> None:
    with pytest.raises(InputError, match=re.escape(said)):
        remarks_on_rig(tmp_path, table, line)


def test_settings_of_one_run_are_judged_as_those_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(SCENE)
    scene = load_itinerary(str(tmp_path / "scene.toml"))
    with pytest.raises(InputError, match="stuck_sensor = 9: must be 0 to 2"):
        scene.with_run({"stuck_sensor": 9})
    with pytest.warns(Remark, match=r"^setting travel = 40 m"):
        scene.with_run({"travel": 40.0})


def test_an_option_is_told_from_a_key_of_the_same_name_in_another_table(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(SCENE + "[estimator]\nzero_error = 1.0\n")
    with pytest.warns(Remark, match=r"scene\.toml: \[estimator\] zero_error = 1 rad"):
        load_itinerary(str(file)).with_run({"sensors.zero_error": 0.01})


def test_nothing_is_remarked_on_in_what_is_shipped() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", Remark)
        for name in known("models"):
            load_model(name)
        for name in known("itineraries"):
            load_itinerary(name)


def test_each_mistake_of_a_named_model_has_its_own_sentence(tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text("[arms]\nmass = [0.1]\n")
    (tmp_path / "scene.toml").write_text('model = "bad.toml"\nstart = "rest"\nfinish = "rest"\nhold = "up-up"\n')
    with pytest.raises(InputErrors) as caught:
        load_itinerary(str(tmp_path / "scene.toml"))
    assert len(caught.value.mistakes) > 2
    assert all("model = 'bad.toml'" in mistake and "\n" not in mistake for mistake in caught.value.mistakes)
