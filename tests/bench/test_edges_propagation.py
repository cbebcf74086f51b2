"""Fixed steps near equilibria: methods' own limits, and that the product is on the near side of them."""

import numpy as np
import pytest

from dpcontrol.bench.edges import DOP, RK4, model_step, plant_step, predicted_step, stability, step_border
from dpcontrol.dynamics.plant import PlantParameters, longest_step
from dpcontrol.plans.model import load_model

REAL_AXIS, IMAGINARY_AXIS = 2.785, 2.828  # of Runge-Kutta 4: Hairer & Wanner II, fig. IV.2.1 and the text beside it
LAB = load_model("lab").arms


def silent(h: float, saddle: str) -> str:
    return "said"


def test_the_stability_function_is_the_exponential_to_the_methods_order():
    for tableau, order in ((RK4, 4), (DOP, 8)):
        errors = [abs(stability(tableau, z * (0.6 + 0.8j)) - np.exp(z * (0.6 + 0.8j))) for z in (0.4, 0.2)]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order + 1, abs=0.3)


def test_runge_kuttas_borders_on_both_axes_are_the_published_ones():
    assert predicted_step(RK4, np.array([-1.0 + 0j])) == pytest.approx(REAL_AXIS, abs=2e-3)
    assert predicted_step(RK4, np.array([-1e-6 + 1j])) == pytest.approx(IMAGINARY_AXIS, abs=2e-3)


@pytest.mark.parametrize("saddle", ["down-down", "up-up"])
def test_steps_of_the_plant_grow_where_theory_has_it_and_the_bench_never_takes_them(saddle):
    found = step_border(LAB, saddle, tableau=DOP, step=plant_step(LAB), says=silent)
    assert found.off is not None
    assert found.off < 0.05
    assert longest_step(PlantParameters(LAB)) < found.near / 50


def test_steps_of_the_model_grow_where_theory_has_it():
    found = step_border(LAB, "down-up", tableau=RK4, step=model_step(LAB), says=silent)
    assert found.off is not None
    assert found.off < 0.05
    assert found.says == "said"
