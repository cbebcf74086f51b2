"""An orbit that shadows a walk, refined in 113-bit arithmetic: 30 digits instead of 12.

The equations are those of `dpcontrol.itineraries.shooting_equations`, with free segment lengths. Their residuals are
evaluated in 113 bits and divided by the largest before the step is solved for in double, where nothing underflows; so
each Newton step leaves about 1e-12 of the residual. Open orbits are led out along both local manifolds until their
amplitude is a < 1e-20: what the linear manifold leaves out, a², and the double Floquet vector's share, a · 1e-12, are
then far below what is asked. Closed orbits close, at the exact energy, and need no manifold.

Source: Higham, Accuracy and Stability of Numerical Algorithms (2002), chapter 12 (refinement with extended residuals).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from dpcontrol.dynamics.extended import Exact, Extended, ExtendedPropagator, digits, extended, pi_times
from dpcontrol.foundation.errors import InputError
from dpcontrol.itineraries.shadowing import ShadowingOrbit
from dpcontrol.itineraries.shooting_equations import Guess, ShootingEquations
from dpcontrol.tubes.connecting_orbit import ManifoldEnd
from dpcontrol.tubes.connection import Connection
from dpcontrol.tubes.extended_orbit import ExtendedOrbit, RefinementSettings, exact_position, refine_orbit

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ExtendedShadowing:
    """A shadowing orbit in extended precision.

    times (K + 1,) s, zero where the first symbol crosses its section; states (K + 1, N) of the nodes; symbols (k,):
    nodes on the symbols' sections. residual: largest gap at a node, distance from a section or energy error (rad,
    rad/s, J); correction: how far the double nodes were off, largest component.
    """

    orbit: ShadowingOrbit
    times: Extended
    states: Extended
    symbols: NDArray[np.intp]
    residual: Any
    correction: float
    iterations: int
    converged: bool
    status: str

    @property
    def digits(self) -> list[str]:
        """The state at the first symbol's section as decimal digits, one string for each component."""
        return digits(self.states[self.symbols[0]])

    @property
    def duration_digits(self) -> str:
        """Seconds from the first node to the last as decimal digits: of a closed orbit, its period."""
        return str(self.times[-1] - self.times[0])


@dataclass(frozen=True)
class _Exact:
    """What the equations need at full precision.

    levels: of the marked nodes' sections; bases (N,) of the ends; turn (N,) of a closed orbit; energy.
    """

    levels: dict[int, Any]
    bases: tuple[Extended, ...]
    turn: Extended | None
    energy: Any


def refine_shadowing(
    orbit: ShadowingOrbit,
    *,
    energy: Exact | None = None,
    parameters: Sequence[Exact] | None = None,
    settings: RefinementSettings | None = None,
) -> ExtendedShadowing:
    """Refine a converged shadowing orbit, open or closed, in 113-bit arithmetic.

    energy: exact, that of the double orbit by default; parameters (p,): exact values of the equations' parameters, by
    default the doubles of the system as the binary numbers that they are. An orbit that cannot be refined comes back
    with `converged` False and a status that says why.

    Raises:
        InputError: the double orbit has not converged, or an open one ends at an orbit that is no Lyapunov orbit.
        GoalMissed: a Lyapunov orbit could not be refined, or heyoka has no 113-bit reals.
    """
    settings = settings or RefinementSettings()
    if not orbit.converged:
        raise InputError(f"only an orbit that has converged can be refined; this one has not: {orbit.status}")
    system = orbit.shot.guess.system
    propagator = ExtendedPropagator(system.equations, system.parameters if parameters is None else parameters)
    height = extended(np.array(orbit.shot.guess.energy if energy is None else energy))[()]
    guess, led = _lengthened(orbit, settings)
    equations = ShootingEquations(guess)
    exact = _exact(orbit, guess, propagator, height, settings)
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
    residual, states, durations = best
    converged = bool(residual <= settings.tolerance)
    symbols = np.array(sorted(guess.markers))
    times = np.concatenate([extended(np.zeros(1)), np.cumsum(durations)])
    kept = slice(led, led + len(orbit.shot.states))
    correction = float(np.abs(states[kept] - extended(orbit.shot.states)).max())
    if converged:
        status = f"refined in {iteration} iterations to a gap of {float(residual):.1e}; the double nodes were off by "
        status += f"{correction:.1e}"
    else:
        status = (
            f"not refined: the gap stays at {float(residual):.1e} after {iteration} iterations{failure}; put nodes "
            "nearer together, or use double precision"
        )
    return ExtendedShadowing(
        orbit, times - times[symbols[0]], states, symbols, residual, correction, iteration, converged, status
    )


def _place_ends(states: Extended, equations: ShootingEquations, exact: _Exact, free: Extended) -> None:
    """Put the last node (and the first, if open) where closure, or the amplitudes, have it."""
    if exact.turn is not None:
        states[-1] = states[0] + exact.turn
        return
    for place, base, slope, amplitude in zip((0, -1), exact.bases, equations.ends.slopes, free[:2], strict=True):
        states[place] = base + extended(slope) * amplitude


def _residuals(
    equations: ShootingEquations,
    exact: _Exact,
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


def _exact(
    orbit: ShadowingOrbit, guess: Guess, propagator: ExtendedPropagator, energy: Any, settings: RefinementSettings
) -> _Exact:
    system = guess.system
    markers = sorted(guess.markers)
    levels = {
        node: _level(connection, guess.markers[node][1])
        for node, connection in zip(markers, orbit.connections, strict=True)
    }
    if guess.turn is not None:
        return _Exact(levels, (), exact_position(system, guess.turn), energy)
    assert guess.ends is not None
    refined: list[tuple[Any, ExtendedOrbit]] = []
    bases = []
    for end in guess.ends:
        lyapunov = end.manifold.orbit
        known = next((r for o, r in refined if o.saddle == lyapunov.saddle), None)
        if known is None:
            if lyapunov.saddle not in system.equilibria:
                raise InputError(
                    f"the orbit ends at {lyapunov.saddle}, which is no Lyapunov orbit: only closed orbits, and those "
                    "between Lyapunov orbits, can be refined"
                )
            known = refine_orbit(lyapunov, propagator, energy, settings)
            refined.append((lyapunov, known))
        bases.append(_base(end, known))
    return _Exact(levels, tuple(bases), None, energy)


def _base(end: ManifoldEnd, refined: ExtendedOrbit) -> Extended:
    """Return γ(φ) (N,) at the end's phase, turned around for a stable manifold, lifted by the end's whole turns."""
    system = refined.orbit.system
    state = refined.at(extended(end.phase)[()])
    if end.stable:
        centre = exact_position(system, refined.orbit.centre)
        state = extended(system.reversers[0]) @ (state - centre) + centre
    return state + exact_position(system, np.asarray(end.turns) * system.turn_lengths)


def _level(connection: Connection, value: float) -> Any:
    """Return the value of normal · x on a connection's section, where it is `value` in double."""
    section = connection.section
    if section.period is None:
        return extended(section.offset)[()]
    turns = np.rint((value - section.offset) / section.period)
    if np.isclose(section.period, 2 * np.pi, rtol=1e-15):
        return (extended(section.offset) + pi_times(2.0 * turns))[()]
    return (extended(section.offset) + extended(turns) * extended(section.period))[()]


def _lengthened(orbit: ShadowingOrbit, settings: RefinementSettings) -> tuple[Guess, int]:
    """Return the double orbit led farther out on both local manifolds, and how many nodes were put before its own."""
    shot = orbit.shot
    guess = replace(shot.guess, states=shot.states, durations=shot.durations, ends=shot.ends)
    if shot.ends is None:
        return guess, 0
    states, durations, owners, ends = [shot.states], [shot.durations], [guess.owners], []
    first = 0
    for end, before in zip(shot.ends, (True, False), strict=True):
        manifold = end.manifold
        step = manifold.orbit.period / settings.segments
        length = abs(end.amplitude) * float(manifold.frame(np.array([end.phase])).lengths[0])
        periods = max(0.0, np.log(length / settings.amplitude) / manifold.exponent)
        count = int(np.ceil(periods * settings.segments))
        seconds = (-step if before else step) * np.arange(1.0, count + 1.0)
        led = end.states(seconds)
        ends.append(end.moved(float(seconds[-1])) if count else end)
        owner = np.full(count, 0 if before else guess.owners[-1], dtype=np.intp)
        if before:
            first = count
        place = 0 if before else len(states)
        states.insert(place, led[::-1] if before else led)
        durations.insert(place, np.full(count, step))
        owners.insert(place, owner)
    return replace(
        guess,
        states=np.vstack(states),
        durations=np.concatenate(durations),
        owners=np.concatenate(owners),
        markers={node + first: marker for node, marker in guess.markers.items()},
        joints=tuple(joint + first for joint in guess.joints),
        ends=(ends[0], ends[1]),
    ), first
