"""Parameters of proofs are the file's decimals, also where doubles cannot hold them."""

from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import pytest

import dpcontrol as dp
from dpcontrol.plans.model import load_model, model_from

pytest.importorskip("flint")

from dpcontrol.proofs.balls import flint, working
from dpcontrol.proofs.prove import Proof

LAB = load_model("lab").text
TYPED = "0.0938439747983407"
LONGER = TYPED + "00000123456789"
"""The mass of lab's inner arm with digits that its double does not hold."""


def test_digits_beyond_doubles_reach_the_equations_parameters() -> None:
    short, longer = (model_from(LAB.replace(TYPED, text), "own") for text in (TYPED, LONGER))
    assert short.parameters == longer.parameters
    assert longer.decimals["mass"][0] == Fraction(LONGER)
    m, a, joint = (Fraction(Decimal(v)) for v in (LONGER, "0.108565214610396", "0.172719203817519"))
    inertia, outer = Fraction("0.00043752942975691"), Fraction("0.137595970499412")
    assert longer.exact_parameters[0] == inertia + m * a**2 + outer * joint**2
    assert short.exact_parameters[0] != longer.exact_parameters[0]


def test_integers_underscores_and_exponents_are_read_as_typed() -> None:
    text = LAB.replace("9.8085802336215", "10").replace(TYPED, "9.384_397e-2")
    model = model_from(text, "own")
    assert model.decimals["gravity"] == (Fraction(10),)
    assert model.decimals["mass"][0] == Fraction("0.09384397")


@pytest.mark.slow
def test_the_enclosed_period_moves_by_the_digits_that_doubles_lose(proofs: dict[str, Proof], tmp_path: Path) -> None:
    """The shift of the period is proportional to that of the mass, by a difference quotient of double orbits."""
    file = tmp_path / "own.toml"
    file.write_text(LAB.replace(TYPED, LONGER), encoding="utf-8")
    more = dp.prove(dp.orbit(dp.load_model(str(file)), "down-up", energy=-0.07))
    step = 1e-6
    changed = model_from(LAB.replace(TYPED, str(float(TYPED) + step)), "changed")
    slope = (
        dp.orbit(changed, "down-up", energy=-0.07).period - dp.orbit(load_model("lab"), "down-up", energy=-0.07).period
    ) / step
    with working(128):
        short, longer = (flint.arb(proof.figures["period"]) for proof in (proofs["orbit"], more))
        expected = slope * float(Fraction(LONGER) - Fraction(TYPED))
        assert abs(longer - short - expected) < abs(expected) * 1e-3
    assert more.certificate is not None
    assert more.certificate["system"]["mass"][0] == LONGER
