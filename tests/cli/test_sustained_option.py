"""`dpcontrol orbit --sustained`: what it prints, draws and refuses."""

from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol
from reference_values import LYAPUNOV_ORBITS

RESIDUAL = 1e-9
"""Scaled: the error between nodes that sustained orbits promise."""
EFFORT = 0.02
"""Relative; the efforts compared with were given to two or three digits."""
EFFORTS = {("down-up", -0.07): 0.056, ("down-up", 0.2): 0.119, ("up-down", 0.2): 0.0095}


@pytest.mark.parametrize(("saddle", "energy"), EFFORTS)
def test_a_sustained_orbit_is_near_its_lyapunov_orbit_at_the_known_effort(saddle: str, energy: float) -> None:
    state, period, multiplier, _ = LYAPUNOV_ORBITS["lab", saddle, energy]
    ended = dpcontrol("orbit", "lab", "--saddle", saddle, "--energy", str(energy), "--sustained", "--json")
    assert ended.code == 0
    shown = ended.document
    assert shown["converged"] is True
    assert shown["energy"] == energy
    assert shown["u_rms"] == pytest.approx(EFFORTS[saddle, energy], rel=EFFORT)
    assert 0 < shown["error_between_nodes"] <= shown["residual"] <= RESIDUAL
    assert shown["period"] == pytest.approx(period, rel=1e-3)
    np.testing.assert_allclose(shown["state"][:4], state, rtol=0, atol=0.02)
    assert 0 < max(map(abs, shown["state"][4:])) <= shown["max_cart_position"] < 0.01
    for key, count in (("multipliers", 6), ("section_multipliers", 5)):
        values = [complex(*pair) for pair in shown[key]]
        assert len(values) == count
        assert abs(values[0]) == pytest.approx(multiplier, rel=0.05)
        assert abs(values[-1]) == pytest.approx(1 / multiplier, rel=0.1)
        assert sum(abs(v - 1) < 1e-9 for v in values) == 2


@pytest.mark.slow
def test_the_text_has_period_effort_and_both_kinds_of_multipliers_and_the_picture_is_drawn(
    tmp_path: Path,
) -> None:
    file = tmp_path / "orbit.png"
    words = ("orbit", "lab", "--saddle", "up-down", "--energy", "0.2", "--sustained", "--sections", "8")
    ended = dpcontrol(*words, "--picture", file)
    assert ended.code == 0
    for text in ("Sustained orbit about up-down", "0.81379", "m/s² rms", "multipliers", "by 8 sections", str(file)):
        assert text in ended.stdout
    assert file.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("lab", "--saddle", "down-up"), "needs --saddle and --energy"),
        (("lab", "--rotating", "inner", "--energy", "0.2"), "needs --saddle and --energy"),
        (("lab", "--saddle", "down-up", "--energies", "-0.1", "0.1"), "needs --saddle and --energy"),
        (("lab", "--saddle", "down-up", "--energy", "-0.3"), "exist only above"),
        (("lab", "--saddle", "down-up", "--energy", "0.2", "--picture", "orbit.pdf"), "ends in .png"),
        (("three-body", "--saddle", "L1", "--energy", "-1.515"), "no arms"),
    ],
)
def test_an_impossible_sustained_orbit_is_rejected_in_one_sentence(words: tuple[str, ...], says: str) -> None:
    ended = dpcontrol("orbit", *words, "--sustained", "--json")
    assert ended.code == 2
    assert says in ended.document["status"]


@pytest.mark.slow
def test_friction_beyond_reach_ends_with_1_and_a_reason(tmp_path: Path) -> None:
    shipped = (Path(__file__).parents[2] / "models" / "lab.toml").read_text()
    before, rest = shipped.split("viscous =", 1)
    # So much that the solver soon sees it.
    model = tmp_path / "sticky.toml"
    model.write_text(f"{before}viscous = [50.0, 10.0]\n" + "".join(rest.partition("\n")[2:]))
    ended = dpcontrol("orbit", model, "--saddle", "down-up", "--energy", "0.2", "--sustained", "--json")
    assert ended.code == 1
    assert ended.document["converged"] is False
    assert ended.document["multipliers"] is None
    assert ended.document["status"] in ended.message


def test_a_system_without_arms_is_rejected_before_the_search_for_its_orbit(monkeypatch: pytest.MonkeyPatch) -> None:
    # Following the family up to this energy takes minutes.
    monkeypatch.setattr("dpcontrol.cli.connections._lyapunov", lambda *_: pytest.fail("the orbit was sought"))
    ended = dpcontrol("orbit", "three-body", "--saddle", "L1", "--energy", "0.5", "--sustained")
    assert ended.code == 2
    assert "has no arms" in ended.message
