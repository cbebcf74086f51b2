"""A family of symmetric periodic orbits as a curve in (c, τ), followed by pseudo-arclength.

The shooting equations (module symmetric_shooting) leave a curve. The next point lies on the plane through the predicted
point across the tangent, so that the curve may turn back in energy; step lengths halve where Newton's method leaves the
curve and grow again after. What is measured at each point (its test functions) belongs to the family; a place between
two points at which a measure takes a value is a root along the curve, every trial point corrected onto it.

Source: Doedel et al., Computation of periodic solutions of conservative systems with application to the 3-body problem
(2003).
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from dpcontrol.tubes.symmetric_shooting import SymmetricShooting

Array = NDArray[np.float64]

SLOPE = "slope"
"""Measure of every point: the energy's derivative along the curve, in energy scales; zero at a fold."""

FIRST_STEP = 0.01
"""Along the curve, scaled: the first step's length at most."""


@dataclass(frozen=True)
class FamilyPoint:
    """One point of the curve: unknowns and tangent, both (n + 1,); energy in J; measures by name."""

    unknowns: Array
    tangent: Array
    energy: float
    residual: float
    measures: Mapping[str, float]

    def reversed(self) -> "FamilyPoint":
        """Return the point as the curve passes it the other way."""
        measures = {**self.measures, SLOPE: -self.measures[SLOPE]}
        return replace(self, tangent=-self.tangent, measures=measures)


@dataclass(frozen=True)
class FamilyCurve:
    """The curve of one shooting problem.

    weights (n + 1,): units of (c, τ). measure: unknowns -> the family's own measures of a point. iterations,
    tolerance: of Newton's method; accept: the largest scaled residual of a point.
    """

    problem: SymmetricShooting
    weights: Array
    measure: Callable[[Array], Mapping[str, float]]
    iterations: int
    tolerance: float
    accept: float

    def point(self, unknowns: Array, heading: Array | None, residual: float) -> FamilyPoint:
        """Describe a point that lies on the curve; the tangent looks along `heading`, or up in energy without one."""
        _, jacobian = self.problem.arc(unknowns)
        tangent = np.linalg.svd(jacobian * self.weights)[2][-1]
        energy, gradient = self.problem.energy(unknowns)
        slope = float((gradient * self.weights) @ tangent) / self.problem.system.energy_scale
        if (slope if heading is None else tangent @ heading) < 0:
            tangent, slope = -tangent, -slope
        return FamilyPoint(unknowns, tangent, energy, residual, {**self.measure(unknowns), SLOPE: slope})

    def step(self, start: FamilyPoint, length: float) -> FamilyPoint | None:
        """Return the curve's point `length` on from `start`, None where Newton's method does not find it."""
        guess = start.unknowns + length * start.tangent * self.weights
        found, residual = self.problem.along(
            guess, start.tangent, self.weights, iterations=self.iterations, tolerance=self.tolerance
        )
        moved = float(np.linalg.norm((found - guess) / self.weights))
        # A correction as long as half the step has left for another curve; so has a tangent that turned by 25 degrees.
        if residual > self.accept or moved > 0.5 * abs(length):
            return None
        try:
            point = self.point(found, start.tangent, residual)
        except (ArithmeticError, np.linalg.LinAlgError):
            return None
        return point if point.tangent @ start.tangent > 0.9 else None

    def followed(
        self,
        start: FamilyPoint,
        *,
        step: float,
        smallest: float,
        too_long: Callable[[FamilyPoint, FamilyPoint], bool] = lambda here, following: False,
    ) -> Iterator[tuple[FamilyPoint, FamilyPoint, float]]:
        """Yield (point, next point, length between) from `start` on; ends where no step of `smallest` converges.

        too_long: whether a step that converged hides what lies within it and is halved, as long as it may be.
        """
        here, length = start, min(step, FIRST_STEP)
        while length >= smallest:
            following = self.step(here, length)
            if following is None or (length > 2 * smallest and too_long(here, following)):
                length /= 2
                continue
            yield here, following, length
            here, length = following, min(step, 1.5 * length)

    def located(self, start: FamilyPoint, length: float, value: Callable[[FamilyPoint], float]) -> FamilyPoint | None:
        """Return the point between `start` and `length` on where `value` vanishes, None if the curve is left."""

        def at(h: float) -> float:
            point = start if h == 0 else self.step(start, h)
            if point is None:
                raise ArithmeticError("left the curve")
            return value(point)

        try:
            return self.step(start, float(brentq(at, 0.0, length, xtol=1e-13)))  # type: ignore[arg-type]
        except (ArithmeticError, ValueError):
            return None
