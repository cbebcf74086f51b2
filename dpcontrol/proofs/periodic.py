"""Proofs of periodic orbits and closed walks by Newton–Kantorovich.

The unknowns are two coordinates y_k in the chart of each multiple-shooting node, at constant energy. The equations are
g_k(y_k) - y_{k+1} = 0 around the orbit. Let A be an approximate inverse of their derivative, computed in doubles and
then treated as exact, and let

    Y = |A F(0)|,      Z = sup |1 - A DF(y)| over |y| ≤ r        (largest component, largest row sum)

If Z < 1 and Y ≤ (1 - Z) r, there is exactly one solution with |y| ≤ r, and it has |y| ≤ Y/(1 - Z). A solution closes:
each chart's state determines the next one's, so no energy is lost and no equation is redundant.

The map over one period preserves the symplectic area on the section, so its derivative at the orbit has determinant
one. With its trace τ, the two multipliers are τ/2 ± √(τ²/4 - 1), and the orbit is hyperbolic if |τ| > 2.

Source: Deuflhard, Newton Methods for Nonlinear Problems (2011), theorem 2.1; Neumaier, Interval Methods for Systems of
Equations (1990), section 5.1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.proofs.balls import Fraction, NotClosed, ball, exact, flint, symmetric
from dpcontrol.proofs.charts import ChartSegment, Leg, Surface, chart_of, directions, segment
from dpcontrol.proofs.flow import FlowSettings

Chain = tuple[Leg, ...]
"""A closed chain of legs, each of which ends at the next one's first chart."""


def closed_chain(system: System, states: Array, durations: Array, turns: Sequence[int]) -> Chain:
    """Return the chain of a closed orbit's nodes (K, N)."""
    _, stms = system.propagator.flows_with_stm(states, durations)
    ones = np.cos(np.arange(system.dimension) + 1.0) * system.scale
    bases = directions(system, states, stms, closed=True, first=ones, last=ones)
    charts = [chart_of(state, basis) for state, basis in zip(states, bases, strict=True)]
    shifts = [(0, 0, 0, 0)] * (len(charts) - 1) + [tuple(int(k) for k in turns)]
    legs = [
        Leg(chart, charts[(k + 1) % len(charts)], Fraction(float(durations[k])), shifts[k])
        for k, chart in enumerate(charts)
    ]
    return tuple(legs)


def enclose(
    surface: Surface, chain: Chain, radius: Any, settings: FlowSettings, progress: Progress = no_progress
) -> list[ChartSegment]:
    """Enclose all maps of a chain over boxes of one radius.

    Raises:
        NotClosed: an enclosure does not close; the message names the segment.
    """
    out, radii = [], [ball(radius)] * 2
    for k, leg in enumerate(chain):
        progress("enclosing the flow", k / len(chain))
        try:
            out.append(segment(surface, leg, radii, radii, settings))
        except NotClosed as error:
            raise NotClosed(f"in segment {k + 1} of {len(chain)} {error}") from error
    return out


@dataclass(frozen=True)
class Newton:
    """Result of Newton–Kantorovich: radii of existence and uniqueness, and the step."""

    residual: Any
    contraction: Any
    exists: Any
    unique: Any
    step: list[float]

    @property
    def proved(self) -> bool:
        """True if there is exactly one solution within `unique`."""
        return bool(self.contraction < 1 and self.exists <= self.unique)


def newton(segments: Sequence[ChartSegment], radius: Any) -> Newton:
    """Apply the theorem to a closed chain over boxes of one radius."""
    count = len(segments)
    slopes = [np.array([[float(v.mid()) for v in row] for row in s.slope.tolist()]) for s in segments]
    derivative = np.zeros((2 * count, 2 * count))
    for k in range(count):
        following = (k + 1) % count
        derivative[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += slopes[k]
        derivative[2 * k : 2 * k + 2, 2 * following : 2 * following + 2] -= np.eye(2)
    inverse = np.linalg.inv(derivative)
    values = flint.arb_mat(2 * count, 1, [v for s in segments for v in s.value])
    step = (-(flint.arb_mat(inverse.tolist()) * values)).entries()
    sums = [flint.arb(0)] * (2 * count)
    for k in range(count):
        # The columns of A DF for node k have terms from its own segment and from the previous one.
        own = flint.arb_mat(inverse[:, 2 * k : 2 * k + 2].tolist()) * segments[k].slope
        before = inverse[:, (2 * k - 2) % (2 * count) :][:, :2]
        entries = own.entries()
        for i in range(2 * count):
            for j in range(2):
                off = entries[2 * i + j] - float(before[i, j]) - int(i == 2 * k + j)
                sums[i] = sums[i] + off.abs_upper()
    residual, contraction = (reduce(lambda a, b: a.max(b.abs_upper()), vector, flint.arb(0)) for vector in (step, sums))
    exists = residual / (1 - contraction)
    return Newton(residual, contraction, flint.arb(exists.upper()), ball(radius), [float(v.mid()) for v in step])


def improved(surface: Surface, chain: Chain, segments: Sequence[ChartSegment], found: Newton) -> Chain:
    """Return the chain after a Newton step, rounded to decimals."""
    charts = []
    for leg, y in zip(chain, np.reshape(found.step, (-1, 2)).tolist(), strict=True):
        state, _ = leg.first.lift(surface.field, surface.height, [ball(v) for v in y])
        charts.append(replace(leg.first, node=tuple(exact(v) for v in state)))
    return tuple(
        replace(leg, first=first, second=second, duration=exact(one.at_node))
        for leg, first, second, one in zip(chain, charts, [*charts[1:], charts[0]], segments, strict=True)
    )


def multipliers(segments: Sequence[ChartSegment]) -> tuple[Any, Any] | None:
    """Return the multipliers, the unstable first, or None if not hyperbolic.

    The segments' derivatives are enclosed over boxes that contain the orbit.
    """
    product = reduce(lambda before, one: one.slope * before, segments, flint.arb_mat([[1, 0], [0, 1]]))
    trace = product.trace()
    if not abs(trace) > 2:
        return None
    half = trace / 2
    root = (half * half - 1).sqrt()
    outside = half + root if trace > 0 else half - root
    return outside, 1 / outside


def total_time(segments: Sequence[ChartSegment], radius: Any) -> Any:
    """Return the duration (s) of one period from points near the nodes."""
    slopes = [(one.at_node, abs(one.delays[0]) + abs(one.delays[1])) for one in segments]
    return sum((time + slope * symmetric(radius) for time, slope in slopes), flint.arb(0))
