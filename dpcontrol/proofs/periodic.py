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
from fractions import Fraction
from functools import reduce
from itertools import pairwise
from typing import Any

import numpy as np

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.proofs.balls import ball, columns, exact, flint, largest, located, symmetric
from dpcontrol.proofs.charts import Leg, SectionChart, Surface, segment
from dpcontrol.proofs.covering import ChartSegment
from dpcontrol.proofs.flow import FlowSettings
from dpcontrol.tubes.frames import closed_frames

Chain = tuple[Leg, ...]
"""A closed chain of legs, each of which ends at the next one's first chart."""


def closed_chain(system: System, states: Array, durations: Array, turns: Sequence[int]) -> Chain:
    """Return a closed orbit as a chain of legs from chart to chart, the last of which has its whole turns.

    A chart is a node with a basis of the section through it, and a leg is the flight from one chart to the next.

    Args:
        system: system of two degrees of freedom.
        states: nodes (K, N).
        durations: flight times (K,), s.
        turns: whole turns in a period (N,).
    """
    bases, _ = closed_frames(system, states, durations)
    # The last chart is the first one again, at which the chain closes.
    charts = [
        SectionChart(tuple(map(Fraction, state)), tuple(tuple(row) for row in basis))
        for state, basis in zip([*states.tolist(), states[0].tolist()], bases.tolist(), strict=True)
    ]
    shifts = [(0,) * len(turns)] * (len(durations) - 1) + [tuple(int(k) for k in turns)]
    pairs = zip(pairwise(charts), durations.tolist(), shifts, strict=True)
    return tuple(Leg(first, second, Fraction(time), shift) for (first, second), time, shift in pairs)


def enclose(
    surface: Surface,
    chain: Sequence[Leg],
    widths: Sequence[Sequence[Any]],
    settings: FlowSettings,
    progress: Progress = no_progress,
) -> list[ChartSegment]:
    """Enclose the maps from chart to chart of a chain over boxes, in order.

    A chart is a node of an orbit with two coordinates y on the section through it; a leg is the flight between two
    charts. Each map is that of the flow from a box |y_i| ≤ width_i to the next section, with its derivative.

    Args:
        surface: equations and energy.
        chain: legs (K,).
        widths: half-widths (K + 1, 2) of the boxes, including those of the last leg's end.
        settings: settings of the integrator.
        progress: called with a label and the completed share.

    Raises:
        NotClosed: an enclosure does not close; the message names the segment.
    """
    enclosures = []
    for k, leg in enumerate(chain):
        progress("enclosing the flow", k / len(chain))
        with located(f"in segment {k + 1} of {len(chain)}"):
            before, after = ([ball(v) for v in row] for row in widths[k : k + 2])
            enclosures.append(segment(surface, leg, before, after, settings))
    return enclosures


def even(chain: Chain, radius: Any) -> list[list[Any]]:
    """Return half-widths (K + 1, 2) of boxes of the same radius for all charts of a chain.

    Args:
        chain: legs (K,).
        radius: half-width in both coordinates.
    """
    return [[radius, radius]] * (len(chain) + 1)


@dataclass(frozen=True)
class KantorovichBounds:
    """Result of Newton–Kantorovich, whose numbers Y and Z are those of the module's text.

    Attributes:
        residual: Y, the largest component of the Newton step, a ball.
        contraction: Z, the largest row sum of the derivative's deviation, a ball.
        exists: radius about the nodes within which the solution is, Y/(1 - Z).
        unique: radius about the nodes within which there is no other solution.
        step (2 K,): the Newton step in the coordinates y of the K charts.
    """

    residual: Any
    contraction: Any
    exists: Any
    unique: Any
    step: list[float]

    @property
    def proved(self) -> bool:
        """True if there is exactly one solution within `unique`."""
        return bool(self.contraction < 1 and self.exists <= self.unique)


def newton(segments: Sequence[ChartSegment], radius: Any) -> KantorovichBounds:
    """Apply the theorem of Newton–Kantorovich to a closed chain over boxes of one radius.

    The unknowns are two coordinates of the orbit in the chart of each of its nodes.

    Args:
        segments: enclosed maps from chart to chart over the boxes, in order.
        radius: half-width in both coordinates.

    Returns:
        Bounds, which prove the orbit or not, and the Newton step from the nodes.
    """
    size = 2 * len(segments)
    rows = [[flint.arb(0)] * size for _ in range(size)]
    # Rows are the derivatives of g_k(y_k) - y_{k+1}, for the map g_k from chart k to the next one.
    for k, piece in enumerate(segments):
        for i, slopes in enumerate(piece.slope.tolist()):
            rows[2 * k + i][2 * k : 2 * k + 2] = slopes
            rows[2 * k + i][(2 * k + 2 + i) % size] -= 1
    inverse = columns(np.linalg.inv(np.array([[float(v.mid()) for v in row] for row in rows])).tolist())
    step = (inverse * columns([[-v] for piece in segments for v in piece.value])).entries()
    product = (inverse * columns(rows)).tolist()
    sums = [sum((abs(v - int(i == j)) for j, v in enumerate(row)), flint.arb(0)) for i, row in enumerate(product)]
    residual, contraction = largest(step), largest(sums)
    exists = flint.arb((residual / (1 - contraction)).upper())
    return KantorovichBounds(residual, contraction, exists, ball(radius), [float(v.mid()) for v in step])


def improved(surface: Surface, chain: Chain, segments: Sequence[ChartSegment], bounds: KantorovichBounds) -> Chain:
    """Return the chain after a Newton step, with the durations up to the moved sections, rounded to decimals.

    Args:
        surface: equations and energy.
        chain: legs (K,), the flights from node to node.
        segments: their enclosures (K,).
        bounds: Newton step.
    """
    charts = []
    for leg, y in zip(chain, np.reshape(bounds.step, (-1, 2)).tolist(), strict=True):
        state, _ = leg.first.lift(surface.field, surface.energy, [ball(v) for v in y])
        charts.append(replace(leg.first, node=tuple(exact(v) for v in state)))
    return tuple(
        replace(leg, first=first, second=second, duration=exact(piece.at_node))
        for leg, first, second, piece in zip(chain, charts, [*charts[1:], charts[0]], segments, strict=True)
    )


def multipliers(segments: Sequence[ChartSegment]) -> tuple[Any, Any] | None:
    """Return enclosures of the Floquet multipliers λ and 1/λ of a closed orbit, or None if |λ| > 1 is not proved.

    The segments' derivatives are enclosed over boxes that contain the orbit.

    Args:
        segments: enclosures along one period, in order.
    """
    product = reduce(lambda before, piece: piece.slope * before, segments, flint.arb_mat([[1, 0], [0, 1]]))
    half = product.trace() / 2
    if not abs(half) > 1:
        return None
    root = (half * half - 1).sqrt()
    outside = half + root if half > 0 else half - root
    return outside, 1 / outside


def total_time(segments: Sequence[ChartSegment], radius: Any) -> Any:
    """Return the duration of one period from points near the nodes, s.

    Args:
        segments: enclosures along one period.
        radius: distance of the points from the nodes.
    """
    slopes = [(piece.at_node, abs(piece.delays[0]) + abs(piece.delays[1])) for piece in segments]
    return sum((time + slope * symmetric(radius) for time, slope in slopes), flint.arb(0))
