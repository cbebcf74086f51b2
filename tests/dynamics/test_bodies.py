"""Plausibility of arms: shipped models pass, unusual ones have remarks, impossible ones are refused."""

from dataclasses import replace
from pathlib import Path

import pytest
from command_line import dpcontrol
from shadowing_stand_in import LAB

from dpcontrol.dynamics.chain import oddities
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.shipped import find, known
from dpcontrol.plans.model import load_model


@pytest.mark.parametrize("name", known("models"))
@pytest.mark.filterwarnings("error")
def test_shipped_models_have_no_remarks(name: str) -> None:
    assert load_model(name).remarks == ()


def with_first(name: str, value: float) -> str:
    """Return the lab's file with another value for its first arm."""
    lines = find("models", "lab").read_text().splitlines()
    (at,) = [k for k, line in enumerate(lines) if line.split("=")[0].strip() == name]
    second = lines[at].split(",")[1]
    lines[at] = f"{name} = [{value!r},{second}"
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("name", "value", "odd"),
    [
        # Values by hand: 0.0938 kg, 0.1727 m, centre at 0.1086 m; gravity torque with the outer arm 0.333 N m.
        ("inertia", 0.0, "a uniform rod of 0.093844 kg has 0.000233 kg m², and with this centre at most 0.000654"),
        ("inertia", 1e-6, "is that of a point mass 0.108565 m along a weightless rod of 0.172719 m"),
        ("inertia", 4e-3, "puts its mass of 0.093844 kg 0.206 m from its centre in the mean"),
        ("centre_of_mass", 0.2, "is 1.16 times its length of 0.172719 m from its joint, beyond its end"),
        ("viscous", 0.5, "gravity's torque on it of at most 0.333 N m turns it at 0.67 rad/s at the fastest"),
    ],
)
def test_an_unusual_arm_has_a_remark_with_its_numbers(name: str, value: float, odd: str, tmp_path: Path) -> None:
    file = tmp_path / "odd.toml"
    file.write_text(with_first(name, value))
    ended = dpcontrol("model", file, "--json")
    assert ended.code == 0
    (remark,) = ended.document["remarks"]
    assert remark.startswith(f"{name} = {value:g}")
    assert odd in remark
    assert ended.stderr == f"dpcontrol: {file}: {remark}\n"


@pytest.mark.parametrize(
    ("name", "value"),
    [("inertia", 4.4), ("inertia", -1e-9), ("centre_of_mass", 108.6), ("viscous", 1e6), ("mass", 5e-324)],
)
def test_an_unrealistic_arm_is_refused(name: str, value: float, tmp_path: Path) -> None:
    file = tmp_path / "impossible.toml"
    file.write_text(with_first(name, value))
    ended = dpcontrol("model", file)
    assert ended.code == 2
    assert str(file) in ended.message
    assert f"{name} = {value:g}" in ended.message


def test_a_chain_of_too_many_arms_is_refused() -> None:
    many = {name: getattr(LAB, name) * 5 for name in ("mass", "centre_of_mass", "length", "inertia", "viscous")}
    with pytest.raises(InputError, match="mass has 10 values: a chain has at most 8 arms"):
        replace(LAB, **many)


@pytest.mark.parametrize(
    ("value", "unit"), [(0.44, "g m²"), (4.4, "kg cm²"), (440.0, "kg mm²"), (4400.0, "g cm²"), (440000.0, "g mm²")]
)
def test_an_inertia_in_another_unit_is_refused_with_the_likely_unit(value: float, unit: str, tmp_path: Path) -> None:
    file = tmp_path / "slip.toml"
    file.write_text(with_first("inertia", value))
    assert f"is it given in {unit} (0.00044 kg m²)?" in dpcontrol("model", file).message


def test_a_smoothing_in_another_unit_has_a_remark() -> None:
    (found,) = oddities(replace(LAB, coulomb=(1e-3, 1e-3), smoothing=50.0))
    assert found == "smoothing = 50 rad/s is more than the usual 20 rad/s; is it given in degrees/s (0.873 rad/s)?"


def test_friction_of_every_law_is_compared_with_gravity() -> None:
    for law in ("coulomb", "quadratic"):
        assert not oddities(replace(LAB, **{law: (1e-3, 1e-3)}))
        assert any(text.startswith(f"{law} = 10 ") for text in oddities(replace(LAB, **{law: (10.0, 0.0)})))
        with pytest.raises(InputError, match=f"{law} = 1e\\+06"):
            oddities(replace(LAB, **{law: (0.0, 1e6)}))
