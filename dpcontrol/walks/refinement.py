"""Iterative refinement of multiple shooting: residuals in 113 bits, steps in double.

The equations are those of `dpcontrol.walks.shooting_equations`. Their residuals are divided by the largest before
the step is solved for in double, where nothing underflows; so each Newton step leaves about 1e-12 of the residual.

Source: Higham, Accuracy and Stability of Numerical Algorithms (2002), chapter 12 (refinement with extended residuals).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse.linalg import splu

from dpcontrol.dynamics.extended import Extended, ExtendedPropagator, extended
from dpcontrol.tubes.extended_orbit import RefinementSettings
from dpcontrol.walks.shooting_equations import Guess, ShootingEquations


@dataclass(frozen=True)
class ExactTerms:
    """What the equations need at full precision.

    levels: of the marked nodes' sections; bases (N,) of the ends; turn (N,) of a closed orbit; energy.
    """

    levels: dict[int, Any]
    bases: tuple[Extended, ...]
    turn: Extended | None
    energy: Any


@dataclass(frozen=True, eq=False)
class Refined:
    """What refinement left: states (K + 1, N), durations (K,), residual; failure: what stopped it, or empty."""

    states: Extended
    durations: Extended
    residual: Any
    iterations: int
    failure: str

    @property
    def times(self) -> Extended:
        """Times (K + 1,) s of the nodes, from zero."""
        return np.concatenate([extended(np.zeros(1)), np.cumsum(self.durations)])


def refined(guess: Guess, exact: ExactTerms, propagator: ExtendedPropagator, settings: RefinementSettings) -> Refined:
    """Refine a double solution by Newton steps with residuals in extended precision; keep the best."""
    equations = ShootingEquations(guess)
    system = guess.system
    states, durations = extended(guess.states), extended(guess.durations)
    free = extended(np.array([0.0] if guess.ends is None else [*(e.amplitude for e in guess.ends), 0.0]))
    best: tuple[Any, Extended, Extended] = (np.inf, states, durations)
    iteration, failure = 0, ""
    for iteration in range(settings.iterations + 1):
        _place_ends(states, equations, exact, free)
        try:
            arrived = np.array([propagator.flow(x, h) for x, h in zip(states[:-1], durations, strict=True)])
            right, residual = _residuals(equations, exact, propagator, states, arrived, free[-1])
            doubles, segments = states.astype(float), durations.astype(float)
            flown, stms = system.segments.flows_with_stm(doubles[:-1], segments)
        except ArithmeticError as error:
            failure = f" ({error})"
            break
        previous = best[0]
        if residual < previous:
            best = (residual, states.copy(), durations.copy())
        if residual == 0 or residual > settings.stalled * previous or iteration == settings.iterations:
            break
        matrix = equations.matrix(doubles, stms, flown)
        # The right-hand side is as large as its own largest entry here, whatever the residual has shrunk to.
        scaled = (right / residual).astype(float) * equations.rows
        change = extended(splu(matrix).solve(-scaled) * equations.columns) * residual
        inner = slice(equations.first_node, equations.first_node + equations.nodes)
        states[inner] = states[inner] + change[: equations.states_end].reshape(-1, system.dimension)
        durations = durations + change[equations.states_end : equations.durations_end]
        free = free + change[equations.durations_end :]
    return Refined(best[1], best[2], best[0], iteration, failure)


def _place_ends(states: Extended, equations: ShootingEquations, exact: ExactTerms, free: Extended) -> None:
    """Put the last node (and the first, if open) where closure, or the amplitudes, have it."""
    if exact.turn is not None:
        states[-1] = states[0] + exact.turn
        return
    for place, base, slope, amplitude in zip((0, -1), exact.bases, equations.ends.slopes, free[:2], strict=True):
        states[place] = base + extended(slope) * amplitude


def _residuals(
    equations: ShootingEquations,
    exact: ExactTerms,
    propagator: ExtendedPropagator,
    states: Extended,
    arrived: Extended,
    unfolding: Any,
) -> tuple[Extended, Any]:
    """Return the right-hand side, unscaled, and the largest gap, distance from a section or energy error."""
    gaps = arrived - states[1:]
    off = extended(np.zeros(equations.nodes))
    for node, level in exact.levels.items():
        normal = equations.guess.markers[node][0]
        length = extended(np.linalg.norm(normal))
        off[node - equations.first_node] = (extended(normal) @ states[node] - level) / length
    first = states[0] if exact.turn is not None else states[min(exact.levels)]
    wrong = propagator.energy(first) - exact.energy
    residual = max(np.abs(gaps).max(), np.abs(off).max(), abs(wrong))
    gradients = equations.system.numeric.gradient(states[1:][equations.unfolded].astype(float))
    gaps[equations.unfolded] = gaps[equations.unfolded] + extended(gradients) * unfolding
    parts = [gaps.ravel(), off]
    if exact.turn is not None:
        parts.append(np.array([wrong]))
    return np.concatenate(parts), residual
