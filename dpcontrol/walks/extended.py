"""An orbit that shadows a walk, refined in 113-bit arithmetic: 30 digits instead of 12.

The equations are those of `dpcontrol.walks.shooting_equations`, with free segment lengths, their residuals
evaluated in 113 bits (module refinement). Open orbits are led out along both local manifolds until their
amplitude is a < 1e-20: what the linear manifold leaves out, a², and the double Floquet vector's share, a · 1e-12, are
then far below what is asked. Closed orbits close, at the exact energy, and need no manifold.

Source: Higham, Accuracy and Stability of Numerical Algorithms (2002), chapter 12 (refinement with extended residuals).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.extended import Exact, Extended, ExtendedPropagator, digits, extended, pi_times
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.tubes.connecting_orbit import ManifoldEnd
from dpcontrol.tubes.connection import Connection
from dpcontrol.tubes.extended_orbit import ExtendedOrbit, RefinementSettings, exact_position, refine_orbit
from dpcontrol.tubes.orbit_curve import HyperbolicOrbit
from dpcontrol.walks.refinement import ExactTerms, Refined, refined
from dpcontrol.walks.shadowing import ShadowingOrbit
from dpcontrol.walks.shooting_equations import Guess

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
        InputError: the double orbit has not converged.
        GoalMissed: a periodic orbit at an open one's end could not be refined, or heyoka has no 113-bit reals.
    """
    settings = settings or RefinementSettings()
    if not orbit.converged:
        raise InputError(f"only an orbit that has converged can be refined; this one has not: {orbit.status}")
    system = orbit.shot.guess.system
    propagator = ExtendedPropagator(system.equations, system.parameters if parameters is None else parameters)
    height = extended(np.array(orbit.shot.guess.energy if energy is None else energy))[()]
    guess, led = _lengthened(orbit, settings)
    best = refined(guess, _exact(orbit, guess, propagator, height, settings), propagator, settings)
    residual, states, iteration = best.residual, best.states, best.iterations
    converged = bool(residual <= settings.tolerance)
    symbols = np.array(sorted(guess.markers))
    times = best.times
    kept = slice(led, led + len(orbit.shot.states))
    correction = float(np.abs(states[kept] - extended(orbit.shot.states)).max())
    if converged:
        status = f"refined in {iteration} iterations to a gap of {float(residual):.1e}; the double nodes were off by "
        status += f"{correction:.1e}"
    else:
        status = (
            f"not refined: the gap stays at {float(residual):.1e} after {iteration} iterations{best.failure}; put "
            "nodes nearer together, or use double precision"
        )
    return ExtendedShadowing(
        orbit, times - times[symbols[0]], states, symbols, residual, correction, iteration, converged, status
    )


def _exact(
    orbit: ShadowingOrbit, guess: Guess, propagator: ExtendedPropagator, energy: Any, settings: RefinementSettings
) -> ExactTerms:
    system = guess.system
    markers = sorted(guess.markers)
    levels = {
        node: _level(connection, guess.markers[node][1])
        for node, connection in zip(markers, orbit.connections, strict=True)
    }
    if guess.turn is not None:
        return ExactTerms(levels, (), exact_position(system, guess.turn), energy)
    assert guess.ends is not None
    known: dict[str, ExtendedOrbit | Refined] = {}
    bases = []
    for end in guess.ends:
        vertex = end.manifold.orbit
        if vertex.saddle not in known:
            known[vertex.saddle] = (
                _refined_vertex(vertex, propagator, energy, settings)
                if isinstance(vertex, HyperbolicOrbit)
                else refine_orbit(vertex, propagator, energy, settings)
            )
        bases.append(_base(end, known[vertex.saddle], propagator))
    return ExactTerms(levels, tuple(bases), None, energy)


def _refined_vertex(
    vertex: HyperbolicOrbit, propagator: ExtendedPropagator, energy: Any, settings: RefinementSettings
) -> Refined:
    """Refine a vertex as what it is, a closed orbit; its nodes keep their phases, across which they alone move.

    Raises:
        GoalMissed: the residual stays above the tolerance; says how large it is.
    """
    durations = np.diff(vertex.node_times)
    guess = Guess(
        system=vertex.system,
        states=vertex.node_states,
        durations=durations,
        owners=np.zeros(len(vertex.node_states), dtype=np.intp),
        markers={},
        energy=vertex.energy,
        turn=vertex.turn,
    )
    best = refined(guess, ExactTerms({}, (), exact_position(vertex.system, vertex.turn), energy), propagator, settings)
    if not best.residual <= settings.tolerance:
        raise GoalMissed(
            f"{vertex.saddle} could be refined only to a residual of {float(best.residual):.1e}; use double precision"
        )
    return best


def _vertex_state(vertex: HyperbolicOrbit, known: Refined, phase: float, propagator: ExtendedPropagator) -> Extended:
    """Return γ(φ) (N,), lifted, flown from the node before it."""
    rounds = float(np.floor(phase))
    times = known.times
    elapsed = (extended(phase) - extended(rounds))[()] * times[-1]
    node = int(np.clip(np.searchsorted(times.astype(float), float(elapsed), side="right") - 1, 0, len(times) - 2))
    state = propagator.flow(known.states[node], elapsed - times[node])
    return state + exact_position(vertex.system, rounds * vertex.turn)


def _base(end: ManifoldEnd, known: ExtendedOrbit | Refined, propagator: ExtendedPropagator) -> Extended:
    """Return γ(φ) (N,) at the end's phase, turned around for a stable manifold, lifted by the end's whole turns."""
    orbit = end.manifold.orbit
    system = orbit.system
    if isinstance(known, ExtendedOrbit):
        state = known.at(extended(end.phase)[()])
    else:
        assert isinstance(orbit, HyperbolicOrbit)
        state = _vertex_state(orbit, known, end.phase, propagator)
    if end.stable:
        centre = exact_position(system, orbit.centre)
        state = extended(orbit.reverser) @ (state - centre) + centre
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
