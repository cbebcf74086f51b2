import numpy as np
import pytest
from scipy.special import roots_jacobi

from dpcontrol.references.method import radau

ROUNDING = 1e-12  # Sums of a few terms of order ten in double precision.


@pytest.mark.parametrize("count", range(2, 9))
def test_radau_methods_have_jacobis_points_and_are_exact_for_polynomials(count: int) -> None:
    method = radau(count)
    zeros, _ = roots_jacobi(count - 1, 1.0, 0.0)
    assert method.points == pytest.approx([*((zeros + 1) / 2), 1.0], abs=ROUNDING)
    for degree in range(2 * count - 1):
        assert method.weights @ method.points**degree == pytest.approx(1 / (degree + 1), abs=ROUNDING)
    assert method.weights @ method.points ** (2 * count - 1) != pytest.approx(1 / (2 * count), abs=1e-9)
    curve = np.polynomial.Polynomial(np.cos(np.arange(count + 1.0)))
    values = curve(method.support)
    assert method.differentiation @ values == pytest.approx(curve.deriv()(method.points), abs=100 * ROUNDING)
    assert method.end @ values == pytest.approx(curve(1.0), abs=ROUNDING)
