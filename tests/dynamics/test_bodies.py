"""Plausibility of arms: shipped models pass, unusual ones have remarks, impossible ones are refused."""

from dataclasses import replace
from pathlib import Path

import pytest
from command_line import dpcontrol
from shadowing_stand_in import LAB

from dpcontrol.dynamics.chain import oddities
from dpcontrol.foundation.shipped import find


def with_first(name: str, value: float) -> str:
    """Return the lab's file with another value for its first arm."""
    lines = find("models", "lab").read_text().splitlines()
    (at,) = [k for k, line in enumerate(lines) if line.split("=")[0].strip() == name]
    second = lines[at].split(",")[1]
    lines[at] = f"{name} = [{value!r},{second}"
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("name", "value", "code", "said"),
    [
        # Values by hand: 0.0938 kg, 0.1727 m, centre at 0.1086 m; gravity torque with the outer arm 0.333 N m.
        ("inertia", 0.0, 0, "0.000233 kg m²"),
        ("inertia", 4e-3, 0, "0.206 m"),
        ("centre_of_mass", 0.2, 0, "1.16 times its length"),
        ("viscous", 0.5, 0, "0.333 N m turns it at 0.67 rad/s"),
        ("inertia", 4.4, 2, "is it given in kg cm² (0.00044 kg m²)?"),
        ("inertia", -1e-9, 2, "inertia"),
        ("mass", 5e-324, 2, "mass"),
    ],
)
def test_an_unusual_arm_has_a_remark_and_an_unrealistic_one_is_refused(
    name: str, value: float, code: int, said: str, tmp_path: Path
) -> None:
    file = tmp_path / "odd.toml"
    file.write_text(with_first(name, value))
    ended = dpcontrol("model", file)
    assert ended.code == code
    assert f"{file}" in ended.message
    assert f"{name} = {value:g}" in ended.message
    assert said in ended.message


def test_friction_of_every_law_is_compared_with_gravity() -> None:
    for law in ("coulomb", "quadratic"):
        assert not oddities(replace(LAB, **{law: (1e-3, 1e-3)}))
        assert any(text.startswith(law) for text in oddities(replace(LAB, **{law: (10.0, 0.0)})))
