"""Damped Newton's method for multiple shooting: an orbit from a guess, and what tells how well it is known.

Steps are damped by the natural monotonicity test, which does not depend on how the equations are scaled: a step counts
as good when the simplified step from its end (same Jacobian) is shorter than itself. Lengths are largest scaled
components. With h = ω ‖Δx‖ < 1/2, ω the affine-invariant Lipschitz constant and Δx the last Newton step, a solution
lies within (1 - √(1 - 2h))/ω. Here ω is what one step showed and all is computed in double: an estimate, no proof.

A periodic orbit that shadows a walk of eight symbols has λ ≈ 1e100: its monodromy matrix holds nothing but λ_u in
double precision. The segments' matrices are small, and products of vectors through them keep their logarithms.

Source: Deuflhard, Newton Methods for Nonlinear Problems (2011), section 3.3, algorithm NLEQ-ERR, and theorem 2.3
(Newton–Kantorovich in affine-covariant form).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.orbits.manifold import OrbitCurve
from dpcontrol.shooting.equations import Guess, ShootingEquations, ShootingOrbit, Unknowns

Array = NDArray[np.float64]

_NO_STEP = (
    "no step towards an orbit, however short, brings it nearer: there may be none so near to a tangency of two tubes; "
    "ask for more wraps beside it"
)


@dataclass(frozen=True)
class NewtonSettings:
    """When to stop. tolerance: largest gap at a node (rad, rad/s); smallest_damping: below it the guess is given up.

    settled: a step of this scaled length moves nothing but rounding; certain: one of this length is taken untested;
    stretched: a segment that grows by this many
    times its guessed length, or shrinks as much, has lost its guess; stalled: this many such steps that do not halve
    the gap end the search.
    """

    iterations: int = 30
    tolerance: float = 1e-11
    smallest_damping: float = 1e-3
    settled: float = 1e-13
    certain: float = 1e-8
    stretched: float = 5.0
    stalled: int = 4


@dataclass(frozen=True)
class Shot:
    """What Newton's method left.

    orbit: its time is zero at the first marked node. correction: scaled length of the last Newton step; lipschitz: the
    affine-invariant Lipschitz constant ω as the last long step showed it, None where no step was long enough to;
    condition: 1-norm condition number of the scaled Jacobian; stms (K, N, N) of the segments; fault: the symbol at
    which the last step was largest.
    """

    guess: Guess
    orbit: ShootingOrbit
    correction: float
    lipschitz: float | None
    condition: float
    stms: Array
    fault: int

    @property
    def solution(self) -> Guess:
        """The guess with the nodes and ends that were found for it."""
        orbit = self.orbit
        return replace(self.guess, states=orbit.states, durations=np.diff(orbit.times), ends=orbit.ends)


@dataclass(frozen=True)
class _Linear:
    """The equations linearised at one point: the Newton step, its length, and the symbol where it is largest."""

    factors: Any
    matrix: csc_array
    step: Array
    length: float
    fault: int
    residual: float
    stms: Array


@dataclass(frozen=True)
class _Step:
    """An accepted step: where it led, how it was damped, the simplified step from there, and ω if it was long."""

    unknowns: Unknowns
    damping: float
    simplified: Array
    lipschitz: float | None


class _Lost(Exception):
    """Newton's method cannot go on; the message says why."""


def solve_shooting(guess: Guess, settings: NewtonSettings | None = None) -> Shot:
    """Refine a guess into an orbit by damped Newton steps on all nodes and durations at once."""
    settings = settings or NewtonSettings()
    equations = ShootingEquations(guess)
    amplitudes = np.array([end.amplitude for end in guess.ends or ()])
    now = equations.placed(Unknowns(guess.states.copy(), guess.durations.copy(), amplitudes, 0.0))
    linear: _Linear | None = None
    taken: _Step | None = None
    lipschitz: float | None = None
    iteration, failure, lowest, fault, stalled = 0, "", np.inf, 0, 0
    try:
        for iteration in range(settings.iterations + 1):
            before = linear
            linear = _linearised(equations, now)
            fault = linear.fault
            done = linear.residual <= settings.tolerance
            stalled = 0 if linear.residual < lowest / 2 else stalled + 1
            if (
                (done and (linear.length <= settings.settled or linear.residual > lowest / 4))
                or (stalled == settings.stalled and linear.length <= settings.certain)
                or iteration == settings.iterations
            ):
                break
            lowest = min(lowest, linear.residual)
            first = 1.0 if taken is None or before is None else _predicted(equations, before, linear, taken)
            try:
                taken = _step(equations, now, linear, first, settings)
            except _Lost:
                if not done:
                    raise
                # Steps from an orbit that is as good as rounding lets it be lead nowhere better.
                break
            # The first steps are far away; ω matters where the solution is.
            lipschitz = lipschitz if taken.lipschitz is None else taken.lipschitz
            now = taken.unknowns
    except (_Lost, ArithmeticError) as error:
        failure = str(error)
    residual = np.inf if linear is None else linear.residual
    # On the way an amplitude may change its sign: so small are they that any error of the guess moves them across and
    # the next step back.
    crossed = (float(a) * end.amplitude <= 0 for a, end in zip(now.amplitudes, guess.ends or (), strict=True))
    if not failure and any(crossed):
        failure = "the orbit left its first orbit, or met its last, on the other side of the tube"
    converged = residual <= settings.tolerance and not failure
    if converged:
        status = f"converged in {iteration} iterations to a gap of {residual:.1e}"
    else:
        if not failure and residual < 1e-6:
            failure = "rounding grows too far over a segment: put nodes nearer together"
        failure = failure or "the iterations were used up: ask for more wraps, or put nodes nearer together"
        status = f"not converged: gap {residual:.1e} after {iteration} iterations ({failure})"
    ends = None
    if guess.ends is not None:
        first, last = (replace(e, amplitude=float(a)) for e, a in zip(guess.ends, now.amplitudes, strict=True))
        ends = (first, last)
    times = np.concatenate([[0.0], np.cumsum(now.durations)])
    times -= times[min(guess.markers, default=0)]
    return Shot(
        guess=guess,
        orbit=ShootingOrbit(guess.system, times, now.states, ends, guess.turn, residual, iteration, converged, status),
        correction=np.inf if linear is None else linear.length,
        lipschitz=lipschitz,
        condition=_condition(linear) if converged and linear is not None else np.inf,
        stms=np.empty((0, 0, 0)) if linear is None else linear.stms,
        fault=fault,
    )


def _linearised(equations: ShootingEquations, now: Unknowns) -> _Linear:
    """Fly all segments with their state-transition matrices and return the Newton step."""
    arrived, stms = equations.system.propagator.flows_with_stm(now.states[:-1], now.durations)
    right = equations.residuals(now, arrived) * equations.rows
    matrix = equations.matrix(now.states, stms, arrived)
    try:
        factors = splu(matrix)
    except RuntimeError:
        raise _Lost("the linear system is singular: two tubes are tangent here; choose another energy") from None
    step = factors.solve(-right)
    sizes = equations.sizes(step)
    residual = float(np.abs(arrived - now.states[1:]).max())
    fault = int(equations.guess.owners[int(np.argmax(sizes))])
    return _Linear(factors, matrix, step, float(sizes.max()), fault, residual, stms)


def _predicted(equations: ShootingEquations, before: _Linear, linear: _Linear, taken: _Step) -> float:
    """Return the damping that the last step's error suggests (NLEQ-ERR, equation 3.48)."""
    wrong, after = (float(equations.sizes(x).max()) for x in (taken.simplified - linear.step, taken.simplified))
    if wrong == 0.0 or linear.length == 0.0:
        return 1.0
    return min(1.0, before.length * after / (wrong * linear.length) * taken.damping)


def _step(
    equations: ShootingEquations, now: Unknowns, linear: _Linear, damping: float, settings: NewtonSettings
) -> _Step:
    """Return the longest damped step that passes the natural monotonicity test."""
    reason = _NO_STEP
    while damping >= settings.smallest_damping:
        trial = equations.moved(now, damping * linear.step * equations.columns)
        ratios = trial.durations / equations.guess.durations
        if ratios.min() < 1 / settings.stretched or ratios.max() > settings.stretched:
            reason = "a segment lost its length: the walk needs more wraps, or nodes nearer together"
            damping /= 4
            continue
        try:
            landed = equations.system.propagator.flows(trial.states[:-1], trial.durations)
        except ArithmeticError as error:
            reason, damping = str(error), damping / 4
            continue
        reason = _NO_STEP
        simplified = linear.factors.solve(-(equations.residuals(trial, landed) * equations.rows))
        after, bent = (float(equations.sizes(x).max()) for x in (simplified, simplified - (1 - damping) * linear.step))
        length = damping * linear.length
        # Steps this short are good; what rounding leaves of the test would refuse them.
        if after <= (1 - damping / 4) * linear.length or length <= settings.certain:
            # Below 1e-7 the bend of the equations is hidden in rounding.
            return _Step(trial, damping, simplified, 2 * bent / length**2 if length > 1e-7 else None)
        damping = min(damping / 2, damping * length / (2 * bent))
    raise _Lost(reason)


def _condition(linear: _Linear, columns: int = 4, rounds: int = 5) -> float:
    """Return the 1-norm condition number of the scaled Jacobian, the inverse's norm estimated from below.

    Higham & Tisseur's block algorithm (SIAM J. Matrix Anal. Appl. 21, 2000). scipy's draws from the generator that all
    of a program shares: an orbit would not have the same estimate twice.
    """
    solve, size = linear.factors.solve, len(linear.step)
    probes = np.random.default_rng(0).choice([-1.0, 1.0], (size, columns)) / size
    probes[:, 0] = 1.0 / size
    norm = 0.0
    for _ in range(rounds):
        images = solve(probes)
        grown = float(np.abs(images).sum(axis=0).max())
        if grown <= norm:
            break
        norm = grown
        # The norm is reached at a unit vector: those along which the sum of magnitudes grows fastest come next.
        slopes = np.abs(solve(np.where(images < 0, -1.0, 1.0), "T")).max(axis=1)
        probes = np.zeros((size, columns))
        probes[np.argsort(-slopes, kind="stable")[:columns], np.arange(columns)] = 1.0
    return norm * float(np.max(abs(linear.matrix).sum(axis=0)))  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True)
class ClosedMultipliers:
    """Logarithms of |λ_u| (forward) and |λ_s| (backward, independently), and the sign of both."""

    log_unstable: float
    log_stable: float
    sign: int

    @property
    def reciprocity(self) -> float:
        """|λ_u λ_s| - 1: zero in a Hamiltonian system."""
        return float(np.expm1(self.log_unstable + self.log_stable))


def closed_multipliers(stms: Array, scale: Array) -> ClosedMultipliers:
    """Return the multipliers of a closed orbit from the state-transition matrices (K, N, N) of its segments.

    The unstable direction is carried around forward until it repeats, the stable one backward.
    """
    scaled = stms * scale / scale[:, None]
    forward, sign = _growth(scaled)
    backward, _ = _growth(np.asarray(np.linalg.inv(scaled)[::-1], dtype=float))
    return ClosedMultipliers(forward, -backward, sign)


def _growth(matrices: Array) -> tuple[float, int]:
    """Return the logarithm of the growth of a vector in one round, and whether it comes back turned around."""
    # A start with a share of every direction; the dominant one gains λ² a round.
    vector = np.cos(np.arange(matrices.shape[1]) + 1.0)
    before, total = vector, 0.0
    for _ in range(4):
        before, total = vector, 0.0
        for matrix in matrices:
            vector = matrix @ vector
            length = float(np.linalg.norm(vector))
            total += float(np.log(length))
            vector = vector / length
    return total, int(np.sign(vector @ before))


@dataclass(frozen=True)
class ErrorEstimate:
    """Lengths are scaled (largest component of a node's state, durations over the mean segment).

    condition: of the scaled Jacobian, 1-norm; kantorovich: h, None where no step was long enough to show ω; radius:
    within which the true orbit's nodes should lie, None where h ≥ 1/2; energy_error: largest over the nodes, in the
    energy's unit; departure: largest distance of a node from the guess; stops: distance from the periodic orbit at each
    stop's nearest node. multipliers: of a periodic orbit.
    """

    condition: float
    kantorovich: float | None
    radius: float | None
    energy_error: float
    departure: float
    stops: tuple[float, ...]
    multipliers: ClosedMultipliers | None


def estimate_error(shot: Shot, stops: Sequence[LyapunovOrbit]) -> ErrorEstimate:
    """Return the error estimate of a converged shot; stops: the periodic orbits after its marked nodes, in order."""
    guess, orbit = shot.guess, shot.orbit
    h = None if shot.lipschitz is None else shot.lipschitz * shot.correction
    # Without ω, and below rounding, the last step is what is known of the distance.
    radius: float | None = shot.correction
    if shot.lipschitz is not None and h is not None and h > 1e-8:
        radius = float((1 - np.sqrt(1 - 2 * h)) / shot.lipschitz) if h < 0.5 else None
    energies = guess.system.numeric.hamiltonian(orbit.states)
    return ErrorEstimate(
        condition=shot.condition,
        kantorovich=h,
        radius=radius,
        energy_error=float(np.max(np.abs(energies - guess.energy))),
        departure=float(np.max(np.abs(orbit.states - guess.states) / guess.system.scale)),
        stops=_stop_distances(shot, stops),
        multipliers=closed_multipliers(shot.stms, guess.system.scale) if guess.closed else None,
    )


def _stop_distances(shot: Shot, stops: Sequence[LyapunovOrbit]) -> tuple[float, ...]:
    """Return the scaled distance of the nearest node to the periodic orbit of each stop."""
    states, nodes = shot.orbit.states, sorted(shot.guess.markers)
    curves: dict[str, OrbitCurve] = {}
    out = []
    for first, last, orbit in zip(nodes, [*nodes[1:], len(states) - 1], stops, strict=False):
        curve = curves.setdefault(orbit.saddle, OrbitCurve(orbit))
        out.append(float(curve.distances(states[first : last + 1])[1].min()))
    return tuple(out)
