"""Orbits refined in 113-bit arithmetic, to 30 digits instead of 12.

These are periodic orbits, connections, and orbits of walks.

The equations are those in double precision. Their residuals are evaluated in 113 bits and divided by the largest, so
the step can be computed in double precision without underflow. Each Newton step leaves about 1e-12 of the residual.

Open orbits are extended along both local manifolds until their amplitude is a < 1e-20. The errors of the linear
manifold, a², and of the double Floquet vector, a · 1e-12, are then far below the tolerance. Closed orbits close at the
exact energy and need no manifold. Angles are lifted about resting positions, which are whole multiples of π at full
precision.

Source: Higham, Accuracy and Stability of Numerical Algorithms (2002), chapter 12 (refinement with extended residuals).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Exact, Extended, ExtendedPropagator, digits, extended, pi_times
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import RefinementCause
from dpcontrol.foundation.errors import GoalMissed, InputError, shortened
from dpcontrol.foundation.shown import Brief
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.orbits.manifold import local_manifold
from dpcontrol.shooting.newton import Guess, ManifoldEnd, ShootingEquations, Unknowns
from dpcontrol.words.searches import Concluded


@dataclass(frozen=True)
class RefinementSettings:
    """Tolerance and effort of refining an orbit.

    Attributes:
        amplitude: scaled amplitude on the local manifolds at the outer nodes.
        segments: nodes per period of the extensions; a periodic orbit has twice as many.
        iterations: largest number of Newton steps.
        tolerance: largest residual (rad, rad/s, J).
        stalled: refinement ends if a step leaves more than this share of the residual.
    """

    amplitude: float = 1e-20
    segments: int = 8
    iterations: int = 10
    tolerance: float = 1e-24
    stalled: float = 0.3


@dataclass(frozen=True, eq=False)
class ExtendedOrbit(Brief, Concluded):
    """An orbit in extended precision: periodic, or between two periodic orbits.

    Attributes:
        times (K + 1,): times of the nodes, s, zero at the first marked node.
        states (K + 1, N): states of the nodes.
        marked (k,): nodes on the sections of the symbols.
        residual: largest gap at a node, distance from a section or energy error (rad, rad/s, J).
        correction: largest error of the double nodes.
        ends: first and last periodic orbit; empty for a periodic orbit.
    """

    guess: Guess
    propagator: ExtendedPropagator
    times: Extended
    states: Extended
    marked: NDArray[np.intp]
    residual: Any
    correction: float
    iterations: int
    cause: RefinementCause
    ends: tuple["ExtendedOrbit", ...] = ()

    @property
    def converged(self) -> bool:
        """True if the residual is within the tolerance."""
        return self.cause is RefinementCause.REFINED

    @property
    def state(self) -> Extended:
        """The state (N,) at the first marked node, on the first symbol's section or at phase zero."""
        return self.states[self.marked[0]]

    @property
    def digits(self) -> list[str]:
        """The components of the state as decimal digits."""
        return digits(self.state)

    @property
    def duration(self) -> Any:
        """Time from the first node to the last, s; the period of a periodic orbit."""
        return self.times[-1] - self.times[0]

    def at(self, phase: Any) -> Extended:
        """Return the lifted state (N,) of a periodic orbit at a phase, in extended precision.

        Args:
            phase: 113-bit real, 1 for a period.

        Raises:
            InputError: the orbit is not periodic, or the phase is not a finite number.
        """
        if self.guess.turn is None:
            raise InputError("the orbit is not periodic and has no phase; use its `times` and `states`")
        try:
            rounds = float(np.floor(float(phase)))
        except (TypeError, ValueError) as error:
            raise InputError(f"phase = {shortened(phase)}: must be a number, in periods") from error
        if not np.isfinite(rounds):
            raise InputError(f"phase = {shortened(phase)}: must be a finite number, in periods")
        elapsed = (phase - extended(rounds)[()]) * self.duration
        node = int(np.searchsorted(self.times.astype(float), float(elapsed), side="right")) - 1
        node = min(max(node, 0), len(self.times) - 2)
        state = self.propagator.flow(self.states[node], elapsed - self.times[node])
        return state + exact_position(self.guess.system, rounds * self.guess.turn)


def refine(
    solution: Guess,
    *,
    energy: Exact | None = None,
    parameters: Sequence[Exact] | None = None,
    settings: RefinementSettings | None = None,
) -> ExtendedOrbit:
    """Refine the double solution of multiple shooting in 113-bit arithmetic.

    The orbit can be open or closed.

    Rounding a parameter to double moves a connection by 1e-15 and limits the time for which free flight follows it.
    If the parameters are decimals, pass them as decimals or fractions.

    Args:
        solution: solution in doubles.
        energy: exact energy, by default that of the double orbit.
        parameters: exact parameters (p,) of the equations, by default the doubles of the system.
        settings: tolerance and iterations.

    Returns:
        The refined orbit. If the refinement fails, `converged` is False and the status has the reason.

    Raises:
        GoalMissed: a periodic orbit at an end cannot be refined, or heyoka has no 113-bit reals.
    """
    settings = settings or RefinementSettings()
    system = solution.system
    propagator = ExtendedPropagator(system.equations, system.parameters if parameters is None else parameters)
    height = extended(np.array(solution.energy if energy is None else energy))[()]
    if solution.ends is None:
        return _newton(solution, propagator, height, settings)
    lengthened, first = _lengthened(solution, solution.ends, settings)
    assert lengthened.ends is not None
    refined_orbits: dict[str, ExtendedOrbit] = {}
    for end in lengthened.ends:
        vertex = end.manifold.orbit
        if vertex.saddle not in refined_orbits:
            refined_orbits[vertex.saddle] = refine_orbit(
                vertex, energy=height, propagator=propagator, settings=settings
            )
    ends = tuple(refined_orbits[end.manifold.orbit.saddle] for end in lengthened.ends)
    return _newton(lengthened, propagator, height, settings, kept=slice(first, first + len(solution.states)), ends=ends)


def exact_position(system: System, state: Array) -> Extended:
    """Return a resting state (N,) in extended precision: angles as whole multiples of π, the rest from doubles.

    Args:
        system: system of the state.
        state: resting state (N,).
    """
    halves = np.where(np.isfinite(system.periods), state / np.pi, 0.0)
    whole = np.rint(halves)
    angular = np.isfinite(system.periods) & (np.abs(halves - whole) < 1e-12)
    return pi_times(np.where(angular, whole, 0.0)) + extended(np.where(angular, 0.0, state))


def _exact_level(system: System, level: float) -> Any:
    """Return a section's value of normal · x in extended precision, exact if it rounds to a multiple of π."""
    whole = np.rint(level / np.pi)
    if np.isfinite(system.periods).any() and abs(level / np.pi - whole) < 1e-12:
        return pi_times(whole)[()]
    return extended(level)[()]


def refine_orbit(
    orbit: LyapunovOrbit,
    *,
    energy: Any = None,
    propagator: ExtendedPropagator | None = None,
    settings: RefinementSettings | None = None,
) -> ExtendedOrbit:
    """Return a periodic orbit refined as a closed orbit, with its first node on a plane of one coordinate.

    Args:
        orbit: orbit in doubles.
        energy: 113-bit real, by default the energy of the double orbit.
        propagator: by default that of the system's doubles.
        settings: tolerance, iterations and segments.

    Raises:
        GoalMissed: the residual stays above the tolerance, or heyoka has no 113-bit reals.
    """
    settings = settings or RefinementSettings()
    energy = extended(orbit.energy)[()] if energy is None else energy
    propagator = propagator or ExtendedPropagator(orbit.system.equations, orbit.system.parameters)
    system, count = orbit.system, 2 * settings.segments
    states = local_manifold(orbit).frame(np.linspace(0.0, 1.0, count + 1)).states
    moving = int(np.argmax(np.abs(system.numeric.rate(states[0])) / system.scale))
    guess = Guess(
        system=system,
        states=states,
        durations=np.full(count, orbit.period / count),
        owners=np.zeros(count + 1, dtype=np.intp),
        markers={0: (np.eye(system.dimension)[moving], float(states[0, moving]))},
        energy=orbit.energy,
        turn=orbit.turn,
    )
    exact = _newton(guess, propagator, energy, settings)
    if not exact.converged:
        raise GoalMissed(
            f"the refinement of the periodic orbit {orbit.saddle} stops at a residual of {float(exact.residual):.1e}; "
            "use double precision"
        )
    return exact


def _newton(
    guess: Guess,
    propagator: ExtendedPropagator,
    energy: Any,
    settings: RefinementSettings,
    *,
    kept: slice = slice(None),
    ends: tuple[ExtendedOrbit, ...] = (),
) -> ExtendedOrbit:
    """Return the orbit of the best Newton step, with residuals in extended precision and steps in doubles.

    Each step leaves about 1e-12 of the residual, and the iteration ends when rounding dominates.

    `energy`: 113-bit real. `settings`: tolerance and number of steps. `kept`: nodes whose correction is reported.
    `ends`: refined periodic orbits of an open orbit.
    """
    from scipy.sparse.linalg import splu

    system, equations = guess.system, _ExactEquations(guess, propagator, energy, ends)
    amplitudes = extended(np.array([end.amplitude for end in guess.ends or ()]))
    unknowns = equations.placed(
        Unknowns(extended(guess.states), extended(guess.durations), amplitudes, extended(0.0)[()])
    )
    best: tuple[Any, Unknowns] = (np.inf, unknowns)
    iteration = 0
    for iteration in range(settings.iterations + 1):
        try:
            flights = zip(unknowns.states[:-1], unknowns.durations, strict=True)
            right_side = equations.residuals(unknowns, arrived := np.array([propagator.flow(x, h) for x, h in flights]))
            residual = equations.largest(unknowns, arrived, right_side)
            doubles, segments = unknowns.states.astype(float), unknowns.durations.astype(float)
            double_ends, stms = system.propagator.flows_with_stm(doubles[:-1], segments)
        except ArithmeticError:
            break
        previous = best[0]
        if residual < previous:
            best = (residual, unknowns)
        if residual == 0 or residual > settings.stalled * previous or iteration == settings.iterations:
            break
        matrix = equations.matrix(doubles, stms, double_ends)
        # The division keeps the right-hand side of order one for any residual.
        scaled = (right_side / residual).astype(float) * equations.rows
        unknowns = equations.moved(unknowns, extended(splu(matrix).solve(-scaled) * equations.columns) * residual)
    residual, unknowns = best
    correction = float(np.abs(unknowns.states[kept] - extended(guess.states[kept])).max())
    cause = RefinementCause.REFINED if residual <= settings.tolerance else RefinementCause.STALLED
    marked = np.array(sorted(guess.markers))
    times = np.concatenate([extended(np.zeros(1)), np.cumsum(unknowns.durations)])
    return ExtendedOrbit(
        guess,
        propagator,
        times - times[marked[0]],
        unknowns.states,
        marked,
        residual,
        correction,
        iteration,
        cause,
        ends,
    )


class _ExactEquations(ShootingEquations):
    """The equations of multiple shooting with sections' levels, ends, closure and energy in 113 bits.

    They replace the attributes of the base class that residuals are computed from; the matrix stays in doubles.
    """

    numbers = staticmethod(extended)

    def __init__(
        self, guess: Guess, propagator: ExtendedPropagator, energy: Any, ends: tuple[ExtendedOrbit, ...]
    ) -> None:
        """Set the equations.

        Args:
            guess: nodes, durations and conditions in doubles.
            propagator: propagator in 113 bits.
            energy: energy, 113-bit real.
            ends: refined periodic orbits at the ends of an open orbit.
        """
        super().__init__(guess)
        self.energy, self.hamiltonian = energy, propagator.energy
        self.levels = {node: _exact_level(guess.system, level) for node, level in self.levels.items()}
        self.turn = None if guess.turn is None else exact_position(guess.system, guess.turn)
        self.slopes = [extended(slope) for slope in self.slopes]
        self.bases = [_base(end, refined) for end, refined in zip(guess.ends or (), ends, strict=True)]

    def largest(self, now: Unknowns, arrived: Extended, right: Extended) -> Any:
        """Return the largest gap, distance from a section or energy error, by which the iteration is judged.

        `arrived` (K, N): ends of the segments. `right`: residuals of `ShootingEquations.residuals`.
        """
        first = now.states[0 if self.guess.closed else min(self.levels)]
        distances = right[self.n * self.count :][: self.nodes]
        energy_error = self.hamiltonian(first) - self.energy
        return max(np.abs(arrived - now.states[1:]).max(), np.abs(distances).max(), abs(energy_error))


def _base(end: ManifoldEnd, known: ExtendedOrbit) -> Extended:
    """Return the periodic orbit's lifted state γ(φ) (N,) at an end's phase φ, time-reversed for a stable manifold.

    `known`: the refined periodic orbit at this end.
    """
    orbit = end.manifold.orbit
    system = orbit.system
    state = known.at(extended(end.phase)[()])
    if end.stable:
        centre = exact_position(system, orbit.centre)
        state = extended(orbit.reverser) @ (state - centre) + centre
    return state + exact_position(system, np.asarray(end.turns) * system.turn_lengths)


def _lengthened(guess: Guess, ends: tuple[ManifoldEnd, ManifoldEnd], settings: RefinementSettings) -> tuple[Guess, int]:
    """Return an open orbit that is extended on both local manifolds, and the number of nodes added in front.

    The amplitudes at its ends are then so small that the linear manifolds have no error above the tolerance.
    """
    states, durations, owners, moved_ends = [guess.states], [guess.durations], [guess.owners], []
    first = 0
    for end, in_front in zip(ends, (True, False), strict=True):
        manifold = end.manifold
        step = manifold.orbit.period / settings.segments
        length = abs(end.amplitude) * float(manifold.frame(np.array([end.phase])).lengths[0])
        periods = max(0.0, np.log(length / settings.amplitude) / manifold.exponent)
        count = int(np.ceil(periods * settings.segments))
        seconds = (-step if in_front else step) * np.arange(1.0, count + 1.0)
        added_states = end.states(seconds)
        moved_ends.append(end.moved(float(seconds[-1])) if count else end)
        added_owners = np.full(count, 0 if in_front else guess.owners[-1], dtype=np.intp)
        if in_front:
            first = count
        index = 0 if in_front else len(states)
        states.insert(index, added_states[::-1] if in_front else added_states)
        durations.insert(index, np.full(count, step))
        owners.insert(index, added_owners)
    return replace(
        guess,
        states=np.vstack(states),
        durations=np.concatenate(durations),
        owners=np.concatenate(owners),
        markers={node + first: marker for node, marker in guess.markers.items()},
        joints=tuple(joint + first for joint in guess.joints),
        ends=(moved_ends[0], moved_ends[1]),
    ), first
