"""Lyapunov orbits by symmetric shooting, continued in energy from the linear centre.

Symmetric shooting finds periodic orbits as arcs between the fixed sets of two reversers. About a saddle x*, each
reverser acts as R(x) = A (x - x*) + x*. A symmetric orbit starts on Fix R_a and reaches Fix R_b after a quarter of its
period (half if a = b). Let x(0) = x* + B c, with a basis B of Fix A_a. The unknowns (c, τ) solve

    C_b (x(τ) - x*) = 0,

in which the rows of C_b vanish on Fix A_b. These are n equations for n + 1 unknowns, with exact derivatives from the
variational equations. They define the family as a curve. Another equation selects a member, by its energy
H(x(0)) = energy or by a length along the curve.

The module also computes the energy, eigenvalues and type of equilibria, from which the families start.

Source: Lamb & Roberts, Time-reversal symmetry in dynamical systems (1998), theorem 4.2.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System, saddle_index
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import OrbitCause
from dpcontrol.foundation.checked import checked, number
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.shown import Brief, checked_times
from dpcontrol.orbits.continuation import TO_ROUNDING, Bounds, Function, Newton, member, stepped
from dpcontrol.orbits.orbit import OrbitOutcome, PeriodicOrbit

if TYPE_CHECKING:
    from dpcontrol.orbits.manifold import OrbitCurve
    from dpcontrol.orbits.tube import Tube


@dataclass(frozen=True)
class Equilibrium(Brief):
    """A point of rest with its energy and linear stability.

    Attributes:
        state (N,): rad and rad/s for arms.
        energy: J.
        eigenvalues (N,): 1/s.
        kind: "centre" or "index-k saddle".
    """

    name: str
    state: Array
    energy: float
    eigenvalues: NDArray[np.complex128]
    kind: str


def equilibrium(system: System, name: str) -> Equilibrium:
    """Return an equilibrium with its energy, eigenvalues and kind.

    Args:
        system: Hamiltonian system.
        name: name of the equilibrium.

    Raises:
        InputError: unknown name.
    """
    state = system.equilibrium(name)
    eigenvalues = np.asarray(np.linalg.eigvals(system.numeric.jacobian(state)), dtype=complex)
    index = saddle_index(system.numeric, state)
    order = np.lexsort((np.imag(eigenvalues), -np.real(eigenvalues)))
    return Equilibrium(
        name=name,
        state=state,
        energy=float(system.numeric.hamiltonian(state)),
        eigenvalues=eigenvalues[order],
        kind="centre" if index == 0 else f"index-{index} saddle",
    )


def equilibria(system: System) -> dict[str, Equilibrium]:
    """Return all equilibria of the system by name."""
    return {name: equilibrium(system, name) for name in system.equilibria}


def resting_place(system: System) -> str:
    """Return the name of the equilibrium of lowest energy, with arms hanging."""
    return min(system.equilibria, key=lambda name: float(system.numeric.hamiltonian(system.equilibrium(name))))


_LONGEST = 3.0
"""Largest arc duration in Newton's method, relative to the initial guess."""


@dataclass(frozen=True)
class SymmetricShooting(Brief):
    """The shooting problem about one saddle.

    The unknowns (n + 1,) are (c, τ): the coordinates c (n,) of the orbit's initial state on the first fixed set, and
    the duration τ of the arc to the last fixed set, s.

    Attributes:
        centre (N,): the saddle.
        start (N, n): basis of the initial fixed set.
        target (n, N): rows that vanish on the final fixed set.
        quarters: arcs per period, 4, or 2 with one reverser.
    """

    system: System
    centre: Array
    start: Array
    target: Array
    quarters: int

    def state(self, unknowns: Array) -> Array:
        """Return the orbit's initial state (N,), on the first fixed set, for given unknowns.

        Args:
            unknowns: (c, τ) (n + 1,), τ in s.
        """
        return self.centre + self.start @ unknowns[:-1]

    def period(self, unknowns: Array) -> float:
        """Return the orbit's period in s.

        Args:
            unknowns: (c, τ) (n + 1,), τ in s.
        """
        return self.quarters * float(unknowns[-1])

    def arc(self, unknowns: Array) -> tuple[Array, Array]:
        """Return the residual (n,) of the arc's end on the final fixed set, and its Jacobian (n, n + 1).

        Args:
            unknowns: (c, τ) (n + 1,), τ in s.

        Raises:
            ArithmeticError: the arc diverged.
        """
        end, stm = self.system.propagator.flow_with_stm(self.state(unknowns), unknowns[-1])
        jacobian = np.column_stack([self.target @ stm @ self.start, self.target @ self.system.numeric.rate(end)])
        return self.target @ (end - self.centre), jacobian

    def quantity(self, unknowns: Array) -> tuple[float, Array]:
        """Return the energy, J, that continuation follows, and its derivative (n + 1,) by the unknowns.

        Args:
            unknowns: (c, τ) (n + 1,), τ in s.
        """
        state, numeric = self.state(unknowns), self.system.numeric
        return float(numeric.hamiltonian(state)), np.append(numeric.gradient(state) @ self.start, 0.0)

    def birth(self, linear: "LinearCentre") -> tuple[Array, Array]:
        """Return the unknowns (n + 1,) of a family at its saddle, where continuation begins, and their units (n + 1,).

        Args:
            linear: linear limit of the family.
        """
        arc = 2 * np.pi / linear.frequency / self.quarters
        units = np.append(np.abs(self.start.T) @ self.system.scale, arc)
        return np.append(0.0 * linear.direction, arc), units

    @property
    def units(self) -> Array:
        """Factors on the n residuals of the arc and, last, on that of the equation that `bordered` adds."""
        return np.append(np.abs(self.target) @ (1 / self.system.scale), 1.0)

    @property
    def scale(self) -> float:
        """Typical energy, J."""
        return self.system.energy_scale

    def near(self, guess: Array) -> Function:
        """Return the equations of the arc; they do not depend on the guess.

        Args:
            guess: unknowns (n + 1,).
        """
        return self.arc

    def bounds(self, guess: Array) -> Bounds:
        """Return the lowest and highest unknowns (n + 1,) near a guess.

        Only the duration is bounded, because long arcs are slow to integrate.

        Args:
            guess: unknowns (n + 1,).
        """
        high = np.append(np.full(len(guess) - 1, np.inf), _LONGEST * guess[-1])
        return np.append(-high[:-1], 0.0), high


def fixed_and_moved(reverser: Array) -> tuple[Array, Array]:
    """Return a basis (N, n) of a reverser's fixed set, and rows (n, N) that vanish on it.

    A symmetric orbit starts in the first fixed set (the basis), and its arc ends where the rows of the last one vanish.

    Args:
        reverser: matrix (N, N).
    """
    values, vectors = (np.asarray(part, dtype=complex) for part in np.linalg.eig(reverser))
    fixed = np.real(vectors[:, np.real(values) > 0])
    basis, _ = np.linalg.qr(fixed)
    projector = (np.eye(len(reverser)) - reverser) / 2
    _, singular_values, right_vectors = np.linalg.svd(projector)
    # The projector onto the moved directions has singular values 1 on them and 0 on the fixed set.
    return basis, right_vectors[singular_values > 0.5]


@dataclass(frozen=True)
class LinearCentre(Brief):
    """The linear limit of a family at its saddle.

    Attributes:
        energy: of the saddle, J.
        direction (n,): derivative of c, per √J.
        frequency: rad/s.
        sign: +1 if energies lie above the saddle's, else -1.
    """

    energy: float
    direction: Array
    frequency: float
    sign: float


def symmetric_shooting(system: System, saddle: str, family: int) -> tuple[SymmetricShooting, LinearCentre]:
    """Return the shooting problem of one family of Lyapunov orbits, and its linear limit at the saddle.

    Args:
        system: Hamiltonian system with reversers.
        saddle: name of the equilibrium.
        family: number of the family, slowest first.

    Raises:
        InputError: unknown saddle or family, an equilibrium other than an index-1 saddle, or a system without
            reversers.
    """
    point = equilibrium(system, saddle)
    if saddle not in system.saddles:
        raise InputError(
            f"{saddle} of {system.name} has the type {point.kind}, not index-1 saddle, and so no tubes; choose one of "
            + ", ".join(system.saddles)
        )
    if not system.reversers:
        raise InputError(
            f"{system.name} has no known time-reversal symmetry about {', '.join(system.saddles)}, which the search "
            "for Lyapunov orbits requires; declare its reversers, or omit the saddles that they move"
        )
    first, last = system.reversers[-1], system.reversers[0]
    start, _ = fixed_and_moved(first)
    _, target = fixed_and_moved(last)
    problem = SymmetricShooting(system, point.state, start, target, 4 if len(system.reversers) > 1 else 2)
    return problem, _linear_centre(problem, saddle, family)


def _linear_centre(problem: SymmetricShooting, saddle: str, family: int) -> LinearCentre:
    """Return the linear limit of a family: the saddle's oscillation with the number `family`, slowest first.

    Raises:
        InputError: the saddle has no such oscillation.
    """
    system, centre, start = problem.system, problem.centre, problem.start
    values, vectors = (np.asarray(part, dtype=complex) for part in np.linalg.eig(system.numeric.jacobian(centre)))
    oscillations = [i for i in np.argsort(np.abs(np.imag(values))) if np.imag(values[i]) > 1e-6 * abs(values[i])]
    if not 0 <= family < len(oscillations):
        raise InputError(
            f"{saddle} of {system.name} has {len(oscillations)} families of Lyapunov orbits; family = {family} "
            f"does not exist, use 0 to {len(oscillations) - 1}"
            if oscillations
            else f"{saddle} of {system.name} has no Lyapunov orbits: no imaginary eigenvalues"
        )
    # The fixed set of the first reverser contains one phase of each oscillation.
    mode = start @ (start.T @ vectors[:, oscillations[family]])
    # The phase of the mode is chosen so that its largest entry is real.
    mode = np.real(mode / (mode[np.argmax(np.abs(mode))] / np.abs(mode).max()))
    if system.orientation @ mode < 0:
        mode = -mode
    small_step = 1e-3 * np.linalg.norm(system.scale) / np.linalg.norm(mode)
    saddle_energy = float(system.numeric.hamiltonian(centre))
    height = float(system.numeric.hamiltonian(centre + small_step * mode)) - saddle_energy
    direction = start.T @ mode * small_step / np.sqrt(abs(height))
    return LinearCentre(saddle_energy, direction, float(np.imag(values[oscillations[family]])), float(np.sign(height)))


_ON_THE_WAY = 1e-7
"""Scaled residual of intermediate orbits."""


@dataclass(frozen=True)
class ContinuationSettings:
    """Steps and tolerance of continuation in energy.

    Attributes:
        step: largest change of √(energy above the saddle), relative to √(energy scale).
        smallest_step: relative to `step`.
        tolerance: scaled residual.
    """

    step: float = 0.2
    smallest_step: float = 1e-4
    newton_iterations: int = 12
    tolerance: float = 1e-13


@dataclass(frozen=True)
class LyapunovOrbit(PeriodicOrbit):
    """A periodic orbit about a saddle."""

    @cached_property
    def _curve(self) -> "OrbitCurve":
        """The orbit as a curve with interpolation; imported here, since the module of manifolds imports orbits."""
        from dpcontrol.orbits.manifold import OrbitCurve

        return OrbitCurve(self)

    def states(self, times: Any = None) -> Array:
        """Return the states at given times.

        Args:
            times: times (K,) from the orbit's start, s; by default 200 over one period.

        Returns:
            States (K, N), with whole turns counted.

        Raises:
            InputError: the times are not finite numbers.
        """
        return self.sample() if times is None else self._curve.states(checked_times(times) / self.period)

    @checked
    def manifold(self, *, stable: bool = False, branch: Literal[-1, 0, 1] = 0) -> "Tube":
        """Return the orbit's tube.

        Args:
            stable: the stable tube, whose trajectories approach the orbit; by default the unstable one.
            branch: +1 or -1, by default 0 for both.

        Raises:
            GoalMissed: the orbit did not converge.
        """
        if not self.converged:
            raise GoalMissed(f"the orbit about {self.saddle}: {self.status}")
        from dpcontrol.orbits.tube import Tube

        return Tube(self, stable, branch)


def lyapunov_orbit(
    system: System,
    saddle: str,
    *,
    energy: float,
    family: int = 0,
    settings: ContinuationSettings | None = None,
) -> LyapunovOrbit:
    """Return the Lyapunov orbit about a saddle at an energy.

    Args:
        system: Hamiltonian system with reversers.
        saddle: name of the equilibrium.
        energy: energy of the orbit, J.
        family: number of the family, slowest first.
        settings: continuation from the saddle.

    Raises:
        InputError: unknown saddle or family, or an energy for which no orbit exists.
    """
    settings = settings or ContinuationSettings()
    energy = number("energy", energy)
    problem, linear = symmetric_shooting(system, saddle, family)
    if (energy - linear.energy) * linear.sign <= 0:
        raise InputError(
            f"energy = {energy!r}{system.unit('J')}: the Lyapunov orbits about {saddle} exist only "
            f"{'above' if linear.sign > 0 else 'below'} its energy of {linear.energy!r}{system.unit('J')}"
        )
    unknowns, outcome = _follow(problem, settings, linear, energy)
    return described_orbit(problem, unknowns, saddle=saddle, family=family, energy=energy, outcome=outcome)


def described_orbit(
    problem: SymmetricShooting, unknowns: Array, *, saddle: str, family: int, energy: float, outcome: OrbitOutcome
) -> LyapunovOrbit:
    """Return the orbit for solved unknowns (n + 1,), with its monodromy matrix and multipliers.

    Args:
        problem: shooting problem of the family.
        unknowns: solution (n + 1,).
        saddle: name of the equilibrium.
        family: number of the family.
        energy: energy of the orbit, J.
        outcome: how the unknowns were found.
    """
    system = problem.system
    state, period = problem.state(unknowns), problem.period(unknowns)
    end, monodromy = system.propagator.flow_with_stm(state, period)
    return LyapunovOrbit(
        system=system,
        saddle=saddle,
        family=family,
        energy=energy,
        state=state,
        period=period,
        floquet_multipliers=floquet_multipliers(system, state, period, monodromy),
        monodromy=monodromy,
        residual=float(np.abs(end - state).max()),
        outcome=outcome,
    )


def nearby_orbit(problem: SymmetricShooting, neighbour: LyapunovOrbit, energy: float) -> LyapunovOrbit:
    """Return the orbit of a family at an energy from a nearby one, without continuation from the saddle.

    Args:
        problem: shooting problem of the family.
        neighbour: orbit of the family, or of the same family of a similar system.
        energy: energy of the orbit, J.
    """
    guess = np.append(problem.start.T @ (neighbour.state - neighbour.centre), neighbour.period / problem.quarters)
    solution = member(problem, guess, energy, TO_ROUNDING)
    cause = OrbitCause.NEARBY if solution.residual < TO_ROUNDING.tolerance else OrbitCause.LOST
    outcome = OrbitOutcome(cause, solution.residual, reached=neighbour.energy)
    unknowns = solution.unknowns if cause is OrbitCause.NEARBY else guess
    return described_orbit(
        problem, unknowns, saddle=neighbour.saddle, family=neighbour.family, energy=energy, outcome=outcome
    )


@dataclass(frozen=True)
class _Passed:
    """An intermediate member at s = √|energy - saddle's energy|, √J: unknowns (n + 1,) and their derivative by s."""

    s: float
    unknowns: Array
    slope: Array


def _follow(
    problem: SymmetricShooting, settings: ContinuationSettings, linear: LinearCentre, energy: float
) -> tuple[Array, OrbitOutcome]:
    """Return the unknowns (n + 1,) of a family at an energy, J, and the outcome of their continuation from the saddle.

    `linear`: the family's limit at the saddle. The continuation steps in s = √(energy above the saddle), in which the
    orbits grow in proportion, with cubic prediction. For a family below the saddle, s is the root of the energy below
    it. If no step converges, the unknowns are the last ones.
    """
    sign, goal = linear.sign, float(np.sqrt(abs(energy - linear.energy)))
    largest_step = settings.step * np.sqrt(problem.system.energy_scale)
    unknowns, units = problem.birth(linear)
    birth = _Passed(0.0, unknowns, np.append(linear.direction, 0.0))
    residuals = [np.inf]

    def following(passed: tuple[_Passed, ...], _: float, s: float) -> tuple[_Passed, ...] | None:
        """Return the members with another one at s, or None if Newton's method fails or leaves the curve.

        Intermediate members need less accuracy than the last one. The value of s at the last member is not used, since
        `passed` holds it.
        """
        sufficient = 0.0 if s == goal else _ON_THE_WAY
        newton = Newton(settings.newton_iterations, settings.tolerance, sufficient)
        guess = _predicted(passed[-2:], s)
        solution = member(problem, guess, energy if s == goal else linear.energy + sign * s * s, newton)
        residuals.append(solution.residual)
        changes = solution.unknowns - guess, guess - passed[-1].unknowns
        corrected, predicted = (float(np.linalg.norm(change / units)) for change in changes)
        # A correction of over half the step indicates another curve, as in module continuation.
        if solution.residual > max(settings.tolerance, sufficient) or corrected > 0.5 * predicted:
            return None
        return *passed, _Passed(s, solution.unknowns, 2 * sign * s * solution.slope)

    smallest = settings.smallest_step * largest_step
    passed, s = stepped((birth,), (0.0, goal), following, longest=largest_step, smallest=smallest)
    cause, reached = OrbitCause.CONTINUED if s == goal else OrbitCause.LOST, linear.energy + sign * s**2
    return passed[-1].unknowns, OrbitOutcome(cause, residuals[-1], steps=len(passed) - 1, reached=reached)


def _predicted(points: Sequence[_Passed], s: float) -> Array:
    """Return the guess of a family's member at s, its unknowns (n + 1,), for Newton's method.

    It is extrapolated linearly from one member or cubically from two. s is √(energy above the saddle), √J, or below it
    for a family whose energies lie below the saddle's. `points`: the last one or two members of the continuation.
    """
    last = points[-1]
    linear = last.unknowns + (s - last.s) * last.slope
    if len(points) == 1:
        return linear
    # Newton form on the nodes last, last, first, first.
    first = points[0]
    width = first.s - last.s
    chord = (first.unknowns - last.unknowns) / width
    bend, far_bend = (chord - last.slope) / width, (first.slope - chord) / width
    return linear + (s - last.s) ** 2 * (bend + (s - first.s) * (far_bend - bend) / width)


def floquet_multipliers(system: System, state: Array, period: float, monodromy: Array) -> NDArray[np.complex128]:
    """Return the N Floquet multipliers of a periodic orbit, largest modulus first.

    The pair at one belongs to the flow and the energy, by M f = f and ∇Hᵀ M = ∇Hᵀ. The others are the eigenvalues
    of M on ker ∇H modulo f. Those inside the unit circle come from the backward monodromy matrix, because their
    errors in the forward matrix are proportional to the square of the largest multiplier.

    Args:
        system: Hamiltonian system.
        state: state (N,) on the orbit.
        period: period of the orbit, s.
        monodromy: matrix (N, N) from this state.
    """
    rate, gradient = system.numeric.rate(state), system.numeric.gradient(state)
    # The complement of flow and energy gradient, ker ∇H modulo f, on which the other multipliers act.
    plane, _ = np.linalg.qr(np.column_stack([rate, gradient]))
    reduced_basis = np.linalg.svd(plane.T)[2][2:].T
    forward = np.linalg.eigvals(reduced_basis.T @ monodromy @ reduced_basis)
    _, backward_monodromy = system.propagator.flow_with_stm(state, -period)
    backward = np.linalg.eigvals(reduced_basis.T @ backward_monodromy @ reduced_basis)
    outside = forward[np.abs(forward) > 1 + 1e-6]
    inside = 1 / backward[np.abs(backward) > 1 + 1e-6]
    count = system.dimension - 2 - len(outside) - len(inside)
    neutral = forward[np.argsort(np.abs(np.abs(forward) - 1))[: max(count, 0)]]
    flow_multiplier = rate @ monodromy @ rate / (rate @ rate)
    energy_multiplier = gradient @ monodromy @ gradient / (gradient @ gradient)
    values = np.concatenate([outside, [flow_multiplier, energy_multiplier], neutral, inside]).astype(complex)
    return values[np.argsort(-np.abs(values), kind="stable")]
