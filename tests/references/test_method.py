import numpy as np
import pytest
from scipy.special import roots_jacobi

from dpcontrol.references.method import interpolation_matrix, radau

ROUNDING = 1e-12  # Sums of a few terms of order ten in double precision.
COUNTS = range(2, 9)


@pytest.mark.parametrize("count", COUNTS)
def test_radau_points_are_zeros_of_a_jacobi_polynomial_and_the_end(count: int) -> None:
    zeros, _ = roots_jacobi(count - 1, 1.0, 0.0)
    assert radau(count).points == pytest.approx([*((zeros + 1) / 2), 1.0], abs=ROUNDING)
    assert radau(count).closes


@pytest.mark.parametrize("count", COUNTS)
def test_quadrature_is_exact_to_degree_two_less_than_twice_the_points(count: int) -> None:
    method = radau(count)
    for degree in range(2 * count - 1):
        assert method.weights @ method.points**degree == pytest.approx(1 / (degree + 1), abs=ROUNDING)
    assert method.weights @ method.points ** (2 * count - 1) != pytest.approx(1 / (2 * count), abs=1e-9)


@pytest.mark.parametrize("count", COUNTS)
def test_differentiation_and_end_are_exact_for_polynomials_of_the_states_degree(count: int) -> None:
    method = radau(count)
    curve = np.polynomial.Polynomial(np.cos(np.arange(count + 1.0)))
    values = curve(method.support)
    assert method.differentiation @ values == pytest.approx(curve.deriv()(method.points), abs=100 * ROUNDING)
    assert method.end @ values == pytest.approx(curve(1.0), abs=ROUNDING)


def test_interpolation_reproduces_the_points_and_the_polynomial() -> None:
    points = radau(5).points
    curve = np.polynomial.Polynomial([1.0, -2.0, 0.5, 3.0, -1.0])
    at = np.concatenate([points, np.linspace(0.0, 1.0, 17)])
    assert interpolation_matrix(points, at) @ curve(points) == pytest.approx(curve(at), abs=ROUNDING)
