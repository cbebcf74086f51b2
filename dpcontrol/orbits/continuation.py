"""Newton's method, and continuation of solutions along their curve.

A problem of k unknowns y has k - 1 independent equations F(y) = 0. Their solutions form a curve, along which a quantity
λ(y) such as the energy changes. Pseudo-arclength continuation places the next point on the plane through the predicted
point, normal to the tangent, so the curve may fold in λ. The step is halved if Newton's method leaves the curve, and
grows afterwards. A test is a function of a point. Each of its zeros is located along the curve, with every trial point
corrected onto it.

Without folds, `stepped` continues a solution in λ itself.

Source: Allgower & Georg, Introduction to Numerical Continuation Methods (2003), chapters 3, 6 and 8.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.shown import Brief

Function = Callable[[Array], tuple[Array, Array]]
"""Residual (m,) and Jacobian (m, k) at unknowns (k,)."""
UNSOLVED = (ArithmeticError, InputError, np.linalg.LinAlgError)
"""Errors of a diverging Newton iteration, which may reach unknowns without a residual."""

SLOPE = "slope"
"""Measure of every point: the scaled derivative of the followed quantity along the curve, zero at a fold."""
FIRST_STEP = 0.01
"""Largest first step along the curve, scaled."""
_AT_REST = 1e-7
"""Step of Newton's method, relative to the reach, that moves a solution by rounding only."""
Bounds = tuple[Array, Array]


@dataclass(frozen=True)
class Solution(Brief):
    """The best unknowns (k,) of Newton's method.

    Attributes:
        residual: largest of the equations' residuals, scaled by their units; infinite if the first step fails.
        slope (k,): derivative of the unknowns by the last equation's value, for example by the energy in J.
    """

    unknowns: Array
    residual: float
    slope: Array


@dataclass(frozen=True)
class Newton:
    """Newton's method with its limits.

    Attributes:
        iterations: largest number of steps.
        tolerance: residual below which a step without improvement is rounding, and ends the iteration.
        enough: residual at which the iteration ends.
        rounded: with large multipliers, rounding limits the residual. Below this residual, a step at rounding level
            ends the iteration.
        stride: longest step, relative to the bounds' half width.
    """

    iterations: int
    tolerance: float
    enough: float = 0.0
    rounded: float = 0.0
    stride: float = np.inf

    def solve(self, equations: Function, guess: Array, bounds: Bounds, units: Array | float = 1.0) -> Solution:
        """Return the unknowns with the smallest residual that Newton's method finds.

        One of the equations may be redundant.

        Args:
            equations: residual (m,) and Jacobian (m, k), m ≥ k.
            guess: first unknowns (k,).
            bounds: lowest and highest unknowns (k,). Far from the guess lie other solutions.
            units: factors (m,) on the residuals, in the order of the equations; a float for all.
        """
        low, high = bounds
        best, unknowns, reach = Solution(guess, np.inf, np.zeros_like(guess)), guess, (high - low) / 2
        for _ in range(self.iterations):
            try:
                residuals, jacobian = equations(unknowns)
                # The second solution is the slope: the change of the unknowns by the last equation's value.
                right_sides = np.column_stack([residuals, np.append(np.zeros(len(residuals) - 1), 1.0)])
                if len(residuals) == len(guess):
                    step, slope = np.linalg.solve(jacobian, right_sides).T
                else:
                    step, slope = np.linalg.lstsq(jacobian, right_sides, rcond=1e-13)[0].T
            except UNSOLVED:
                break
            residual = float(np.max(np.abs(residuals) * units))
            if residual < best.residual:
                best = Solution(unknowns, residual, slope)
            elif best.residual < self.tolerance:
                break
            # With large multipliers, rounding limits the residual, and the small step shows convergence.
            at_rest = residual < self.rounded and np.all(np.abs(step) <= _AT_REST * reach)
            if at_rest or best.residual <= self.enough:
                break
            unknowns = unknowns - step / max(1.0, float(np.max(np.abs(step) / reach)) / self.stride)
            if not np.all((low < unknowns) & (unknowns < high)):
                break
        return best


TO_ROUNDING = Newton(12, 1e-12)
"""Newton's method for scaled equations of double precision."""


def bordered(equations: Function, row: Callable[[Array], tuple[float, Array]]) -> Function:
    """Return equations with another one at their end, which selects one solution of a curve.

    Args:
        equations: residual (m,) and Jacobian (m, k).
        row: function of the unknowns (k,) that returns the residual and the gradient (k,) of the added equation.
    """

    def both(unknowns: Array) -> tuple[Array, Array]:
        """Return the residual (m + 1,) and Jacobian (m + 1, k) with the added equation as the last row."""
        (value, jacobian), (last, gradient) = equations(unknowns), row(unknowns)
        return np.append(value, last), np.vstack([jacobian, gradient])

    return both


def differenced(function: Callable[[Array], Array], at: Array, steps: Array) -> Array:
    """Return the Jacobian (m, k) of a function without derivatives, by central differences.

    Args:
        function: function of unknowns (k,).
        at: unknowns (k,).
        steps: step of each unknown (k,).
    """
    return np.column_stack([(function(at + step) - function(at - step)) / (2 * step.max()) for step in np.diag(steps)])


class Problem(Protocol):
    """Equations of a curve.

    Attributes:
        units: factors (m + 1,) on the m residuals and, last, on that of the equation that `bordered` adds; a float for
            all.
        scale: typical change of the followed quantity.
    """

    @property
    def units(self) -> Array | float: ...

    @property
    def scale(self) -> float: ...

    def near(self, guess: Array) -> Function:
        """Return the equations, whose Jacobian may have columns of the guess (k,)."""
        ...

    def quantity(self, unknowns: Array) -> tuple[float, Array]:
        """Return the followed quantity and its gradient (k,) at unknowns (k,)."""
        ...

    def bounds(self, guess: Array) -> Bounds:
        """Return the lowest and highest unknowns (k,) of solutions near a guess (k,)."""
        ...


@dataclass(frozen=True)
class CurvePoint(Brief):
    """A solution on a curve, with its unit tangent.

    Attributes:
        unknowns (k,), tangent (k,): the tangent in units of the curve's weights.
        value: the followed quantity, such as the energy, J.
        residual: scaled residual of the solution.
        measures: values by name of functions along the curve, such as `SLOPE` and tests for bifurcations.
    """

    unknowns: Array
    tangent: Array
    value: float
    residual: float
    measures: Mapping[str, float]

    def reversed(self) -> "CurvePoint":
        """Return the point with the opposite tangent, from which the curve is followed the other way."""
        measures = {**self.measures, SLOPE: -self.measures[SLOPE]}
        return replace(self, tangent=-self.tangent, measures=measures)


@dataclass(frozen=True)
class Curve(Brief):
    """The curve of solutions of one problem.

    Attributes:
        weights (k,): typical changes of the unknowns, by which lengths along the curve are measured.
        newton: limits of Newton's method.
        accept: largest scaled residual of a point.
        measure: function from unknowns to the curve's measures.
    """

    problem: Problem
    weights: Array
    newton: Newton
    accept: float
    measure: Callable[[Array], Mapping[str, float]] = lambda unknowns: {}

    def point(self, unknowns: Array, heading: Array | None, residual: float) -> CurvePoint:
        """Return a solution as a point of the curve, with its tangent, quantity and measures.

        Args:
            unknowns: solution (k,).
            heading: direction (k,), in units of the weights, along which the tangent points; None for the direction of
                higher values of the followed quantity.
            residual: scaled residual of the solution.
        """
        _, jacobian = self.problem.near(unknowns)(unknowns)
        tangent = np.linalg.svd(jacobian * self.weights)[2][-1]
        value, gradient = self.problem.quantity(unknowns)
        slope = float((gradient * self.weights) @ tangent) / self.problem.scale
        if (slope if heading is None else tangent @ heading) < 0:
            tangent, slope = -tangent, -slope
        return CurvePoint(unknowns, tangent, value, residual, {**self.measure(unknowns), SLOPE: slope})

    def onto(self, guess: Array, normal: Array) -> Solution:
        """Return the curve's solution on a plane, the corrector of each step along the curve.

        Args:
            guess: point (k,) of the plane.
            normal: its unit normal (k,), in units of the weights.
        """

        def row(unknowns: Array) -> tuple[float, Array]:
            """Return the signed distance from the plane, and its gradient (k,)."""
            return float(normal @ ((unknowns - guess) / self.weights)), normal / self.weights

        equations = bordered(self.problem.near(guess), row)
        return self.newton.solve(equations, guess, self.problem.bounds(guess), self.problem.units)

    def at(self, guess: CurvePoint, value: float) -> CurvePoint | None:
        """Return the point at a value of the followed quantity, such as an energy bound; None if Newton's method fails.

        Args:
            guess: point nearby.
            value: value of the quantity.
        """
        solution = member(self.problem, guess.unknowns, value, self.newton)
        if solution.residual > self.accept:
            return None
        return replace(self.point(solution.unknowns, guess.tangent, solution.residual), value=value)

    def step(self, start: CurvePoint, length: float) -> CurvePoint | None:
        """Return the point at a distance along the curve, or None if Newton's method fails or leaves the curve.

        Args:
            start: point of the curve.
            length: distance along the tangent, in units of the weights.
        """
        guess = start.unknowns + length * start.tangent * self.weights
        try:
            solution = self.onto(guess, start.tangent)
            distance = float(np.linalg.norm((solution.unknowns - guess) / self.weights))
            # A correction of over half the step, or a tangent turned by 25 degrees, indicates another curve.
            if solution.residual > self.accept or distance > 0.5 * abs(length):
                return None
            point = self.point(solution.unknowns, start.tangent, solution.residual)
        except UNSOLVED:
            return None
        return point if point.tangent @ start.tangent > 0.9 else None

    def followed(
        self,
        start: CurvePoint,
        *,
        step: float,
        smallest: float,
        first: float = FIRST_STEP,
        growth: float = 1.5,
        refused: Callable[[CurvePoint, CurvePoint], bool] = lambda point, following: False,
    ) -> Iterator[tuple[CurvePoint, CurvePoint, float]]:
        """Yield (point, next point, length) along the curve, with steps that adapt to success and failure.

        It ends when no step of `smallest` converges.

        Args:
            start: first point.
            step: longest step, in units of the weights.
            smallest: shortest step, in units of the weights.
            first: longest first step.
            growth: ratio of a step to the one before.
            refused: function of two successive points. If it returns True, the step is halved.
        """
        point, length = start, min(step, first)
        while length >= smallest:
            following = self.step(point, length)
            if following is None or refused(point, following):
                length /= 2
                continue
            yield point, following, length
            point, length = following, min(step, growth * length)

    def located(self, start: CurvePoint, length: float, value: Callable[[CurvePoint], float]) -> CurvePoint | None:
        """Return the point of a curve at which a function, such as a test for bifurcations, is zero.

        The result is None if the function has the same sign at both ends of the range, or if Newton's method fails.

        Args:
            start: point of the curve.
            length: range of the search from `start`, in units of the weights.
            value: continuous function of a point.
        """

        from scipy.optimize import brentq

        def at(h: float) -> float:
            """Return the function's value at a distance along the tangent from the start."""
            point = start if h == 0 else self.step(start, h)
            if point is None:
                raise ArithmeticError("no longer on the curve")
            return value(point)

        try:
            return self.step(start, float(brentq(at, 0.0, length, xtol=1e-13)))  # type: ignore[arg-type]
        except (ArithmeticError, ValueError):
            return None


def member(problem: Problem, guess: Array, value: float, newton: Newton) -> Solution:
    """Return the solution at a value of the followed quantity, with the curve's direction as its slope.

    Args:
        problem: equations of the curve.
        guess: unknowns (k,).
        value: value of the quantity.
        newton: limits of Newton's method.
    """

    def row(unknowns: Array) -> tuple[float, Array]:
        """Return the quantity's difference from the value, in units of its scale, and its gradient (k,)."""
        quantity, gradient = problem.quantity(unknowns)
        return (quantity - value) / problem.scale, gradient / problem.scale

    solution = newton.solve(bordered(problem.near(guess), row), guess, problem.bounds(guess), problem.units)
    return replace(solution, slope=solution.slope / problem.scale)


Place = TypeVar("Place")


def stepped(
    start: Place,
    values: tuple[float, float],
    following: Callable[[Place, float, float], Place | None],
    *,
    longest: float,
    smallest: float,
) -> tuple[Place, float]:
    """Return a solution continued from one value of a quantity to another, by steps that adapt to success and failure.

    Args:
        start: solution at the first value.
        values: first and last value.
        following: function of a solution, its value and another value, which returns the solution there, or None if
            the step is too long.
        longest: longest step.
        smallest: shortest step.

    Returns:
        The last solution and its value, which is the goal if all steps succeed.
    """
    solution, (value, goal), step = start, values, longest
    while value != goal:
        # A final step at rounding level would be too short for the test of the correction.
        target = goal if abs(goal - value) <= (1 + 1e-6) * step else value + np.copysign(step, goal - value)
        next_solution = following(solution, value, float(target))
        if next_solution is None:
            step = abs(target - value) / 2
            if step < smallest:
                break
            continue
        solution, value, step = next_solution, float(target), min(longest, 1.5 * step)
    return solution, value
