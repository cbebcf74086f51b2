"""Where references end: mesh by friction, and acceleration by track, for a turn of the outer arm.

The error between nodes of a method with K points falls as the interval's length h to the power K:

    e(h) = e(h₀) (h/h₀)^K,      so the longest interval for a tolerance ε is  h₀ (ε / e(h₀))^(1/K)

predicted from one solution on a finer mesh. What acceleration a track needs has no formula: that border is measured
only.

Source: Betts, Practical Methods for Optimal Control Using Nonlinear Programming, 3rd ed., section 4.7.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.edges import Attempt, Border, EdgeChart, EdgeMap, borders, find_border
from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.foundation.progress import Progress, part_of
from dpcontrol.references.find import find_reference
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits, ReferenceProblem, ReferenceSettings
from dpcontrol.references.reference import Reference
from dpcontrol.references.trajectory import first_trajectory
from dpcontrol.scenes.itinerary import Itinerary, load_itinerary
from dpcontrol.scenes.planning import shadowing_orbit

Array = NDArray[np.float64]

WALK = "outer-turn"
METHOD, TOLERANCE = ReferenceSettings().method, ReferenceSettings().tolerance
FINE = 0.012
"""s: the mesh from whose error the border is predicted, about one and a half times as long."""
FRICTIONS = (0.0, 1.0, 2.0, 4.0)
QUICK_FRICTIONS = (1.0,)
TRACKS = (0.4, 0.01, 0.002)
QUICK_TRACKS = (0.01,)


def chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: one friction, the whole track."""
    frictions, tracks = (QUICK_FRICTIONS, QUICK_TRACKS) if quick else (FRICTIONS, TRACKS)
    meshes = borders(
        lambda friction: mesh_border(friction, x=float(frictions.index(friction))), frictions,
        part_of(progress, 0.0, 0.4), "friction × {:g}",
    )  # fmt: skip
    pushed = borders(acceleration_border, tracks, part_of(progress, 0.4, 1.0), "track ± {:g} m")
    return EdgeChart(
        name="edges-references",
        title="Where references end: one turn of the outer arm",
        maps=(
            EdgeMap(f"Mesh, {METHOD}", "friction, × the arms' own", f"interval for {TOLERANCE:g} between nodes, s",
                    meshes, log_x=False, far="not as good",
                    theory="the error falls as the interval to the power of the points"),
            EdgeMap("Limits", "track, ± m", "acceleration, m/s²", pushed, far="no reference"),
        ),
        reading=(
            f"Left: the longest equal intervals with which the error between nodes stays below {TOLERANCE:g}.",
            "Right: the least acceleration with which the motion exists on a track; the status names the limit.",
            f"Diamonds: from the error on one finer mesh, {1e3 * FINE:g} ms. Planning splits intervals where they err, "
            "and so gets by with fewer.",
        ),
        chosen="Seven points on 50 ms, split where the error asks for it; limits of the bench leave room of a hundred.",
    )  # fmt: skip


@cache
def _walk() -> tuple[Itinerary, Callable[[Array], Array], float]:
    itinerary = load_itinerary(WALK)
    orbit = shadowing_orbit(itinerary)
    return itinerary, orbit.sample, orbit.duration


def problem_of(friction: float = 1.0, limits: Limits | None = None) -> ReferenceProblem:
    """Return the turn with `friction` times the arms' own viscous friction, within `limits`."""
    itinerary, guess, duration = _walk()
    arms = replace(itinerary.model.arms, viscous=tuple(friction * k for k in itinerary.model.arms.viscous))
    equations = arm_chain_equations(arms.count, Level.CART, friction=arms.friction)
    return ReferenceProblem(
        equations=equations, parameters=arms.base(), guess=guess, duration=duration, limits=limits or Limits()
    )


def on_equal_intervals(problem: ReferenceProblem, interval: float, *, tolerance: float = TOLERANCE) -> Reference:
    """Return what one round gives on intervals of at most `interval` s, whatever the guess's own error."""
    method = method_named(METHOD)
    mesh = np.linspace(0.0, problem.duration, int(np.ceil(problem.duration / interval)) + 1)
    settings = ReferenceSettings(method=METHOD, interval=interval, tolerance=tolerance, rounds=1)
    return find_reference(problem, settings, near=first_trajectory(problem, method, mesh))


def mesh_border(friction: float, *, x: float) -> Border:
    """Return the longest interval, s, with which the turn is good to the tolerance between its nodes in one round."""
    problem = problem_of(friction)

    def probe(interval: float) -> Attempt:
        found = on_equal_intervals(problem, interval)
        return Attempt(found.converged, "" if found.converged else found.status)

    fine = on_equal_intervals(problem, FINE).max_error_between_nodes
    # What the product accepts is a little less than the tolerance.
    predicted = FINE * (0.8 * TOLERANCE / fine) ** (1 / len(method_named(METHOD).points))
    return find_border(
        probe, x=x, line=f"× {friction:g}", near=predicted / 1.6, far=1.6 * predicted, predicted=predicted, ratio=1.12
    )


def acceleration_border(track: float) -> Border:
    """Return the least acceleration, m/s², with which the turn exists on a track of ± `track` m."""

    def probe(acceleration: float) -> Attempt:
        found = find_reference(problem_of(limits=Limits(position=track, acceleration=acceleration)), _QUICKLY)
        return Attempt(found.converged, "" if found.converged else found.status)

    free = find_reference(problem_of(limits=Limits(position=track)), _QUICKLY)
    taken = free.max_cart_acceleration if free.converged else 10.0
    return find_border(probe, x=track, line=f"± {track:g} m", near=1.2 * taken, far=taken / 8, ratio=1.2)


_QUICKLY = ReferenceSettings(tolerance=1e-4)
