"""Lyapunov orbits by symmetric shooting, continued in energy from the linear centre.

About a saddle x* each reverser acts as R(x) = A (x - x*) + x*. A symmetric orbit crosses the fixed sets of the
reversers: it starts on Fix R_a and reaches Fix R_b after a quarter of its period (half, where a = b). With
x(0) = x* + B c, B a basis of Fix A_a, the unknowns (c, τ) solve

    C_b (x(τ) - x*) = 0,      H(x(0)) = energy,

C_b the rows that vanish on Fix A_b: n + 1 equations for two arms, with exact derivatives from the variational
equations. Source: Lamb & Roberts, Time-reversal symmetry in dynamical systems (1998), theorem 4.2.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError
from dpcontrol.tubes.equilibria import equilibrium

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ContinuationSettings:
    """How a family is followed. step: largest change of √(energy above the saddle) over √(energy scale)."""

    step: float = 0.1
    smallest_step: float = 1e-4
    newton_iterations: int = 12
    tolerance: float = 1e-13


@dataclass(frozen=True)
class LyapunovOrbit:
    """A periodic orbit about a saddle.

    state (N,): where it crosses the saddle's fixed set. period in s. floquet_multipliers (N,), largest first.
    residual: closure over one period, the largest component of x(T) - x(0). newton_residual: of the shooting
    equations, scaled. status: a sentence.
    """

    system: System
    saddle: str
    family: int
    energy: float
    state: Array
    period: float
    floquet_multipliers: NDArray[np.complex128]
    monodromy: Array
    residual: float
    newton_residual: float
    converged: bool
    status: str

    @property
    def unstable_multiplier(self) -> float:
        """The largest Floquet multiplier, real for a saddle's orbit."""
        return float(self.floquet_multipliers[0].real)

    @property
    def centre(self) -> Array:
        """State (N,) of the saddle that the orbit surrounds."""
        return self.system.equilibrium(self.saddle)


def _fixed_and_moved(reverser: Array) -> tuple[Array, Array]:
    """Return a basis (N, n) of the fixed set of an involution and rows (n, N) that vanish on it."""
    values, vectors = (np.asarray(a, dtype=complex) for a in np.linalg.eig(reverser))
    fixed = np.real(vectors[:, values.real > 0])
    basis, _ = np.linalg.qr(fixed)
    projector = (np.eye(len(reverser)) - reverser) / 2
    _, s, vt = np.linalg.svd(projector)
    return basis, vt[s > 0.5]


@dataclass(frozen=True)
class _Shooting:
    """The shooting problem about one saddle."""

    system: System
    centre: Array
    start: Array
    target: Array
    quarters: int

    def residual(self, unknowns: Array, energy: float) -> tuple[Array, Array]:
        """Return the residual (n + 1,) and its Jacobian (n + 1, n + 1) at (c, τ)."""
        c, duration = unknowns[:-1], unknowns[-1]
        state = self.centre + self.start @ c
        end, stm = self.system.propagator.flow_with_stm(state, duration)
        numeric = self.system.numeric
        value = np.append(self.target @ (end - self.centre), numeric.hamiltonian(state) - energy)
        jacobian = np.zeros((len(value), len(unknowns)))
        jacobian[:-1, :-1] = self.target @ stm @ self.start
        jacobian[:-1, -1] = self.target @ numeric.rate(end)
        jacobian[-1, :-1] = numeric.gradient(state) @ self.start
        return value, jacobian


def _linear_centre(system: System, saddle: str, family: int, start: Array) -> tuple[Array, float, float]:
    """Return (c per unit of √energy, angular frequency, sign of the energy above the saddle)."""
    centre = system.equilibrium(saddle)
    values, vectors = (np.asarray(a, dtype=complex) for a in np.linalg.eig(system.numeric.jacobian(centre)))
    rotating = [i for i in np.argsort(np.abs(values.imag)) if values[i].imag > 1e-6 * abs(values[i])]
    if family >= len(rotating):
        raise InputError(
            f"{saddle} of {system.name} has {len(rotating)} families of Lyapunov orbits; family = {family} "
            f"does not exist, use 0 to {len(rotating) - 1}"
            if rotating
            else f"{saddle} of {system.name} has no Lyapunov orbits: no imaginary eigenvalues"
        )
    mode = start @ (start.T @ vectors[:, rotating[family]])
    mode = np.real(mode / (mode[np.argmax(np.abs(mode))] / np.abs(mode).max()))
    if system.orientation @ mode < 0:
        mode = -mode
    tiny = 1e-3 * np.linalg.norm(system.scale) / np.linalg.norm(mode)
    height = float(system.numeric.hamiltonian(centre + tiny * mode) - system.numeric.hamiltonian(centre))
    return start.T @ mode * tiny / np.sqrt(abs(height)), float(values[rotating[family]].imag), np.sign(height)


def lyapunov_orbit(
    system: System,
    saddle: str,
    *,
    energy: float,
    family: int = 0,
    settings: ContinuationSettings | None = None,
) -> LyapunovOrbit:
    """Return the Lyapunov orbit about `saddle` at `energy` (J).

    Raises:
        InputError: unknown saddle or family, or an energy on the wrong side of the saddle's.
    """
    settings = settings or ContinuationSettings()
    point = equilibrium(system, saddle)
    if not point.kind.startswith("index-1"):
        raise InputError(
            f"{saddle} of {system.name} is: {point.kind}, no index-1 saddle: it has no tubes; choose one of "
            + ", ".join(k for k in system.equilibria if equilibrium(system, k).kind.startswith("index-1"))
        )
    if not np.isfinite(energy):
        raise InputError(f"energy = {energy}: must be a finite number of joules")
    first, last = system.reversers[-1], system.reversers[0]
    start, _ = _fixed_and_moved(first)
    _, target = _fixed_and_moved(last)
    problem = _Shooting(system, point.state, start, target, 4 if len(system.reversers) > 1 else 2)
    linear, frequency, sign = _linear_centre(system, saddle, family, start)
    height = (energy - point.energy) * sign
    if height <= 0:
        raise InputError(
            f"energy = {energy:g} J: the Lyapunov orbits about {saddle} exist only "
            f"{'above' if sign > 0 else 'below'} its energy of {point.energy:.6g} J"
        )
    unknowns, residual, converged, status = _follow(
        problem, settings, (linear, frequency, sign), (point.energy, energy)
    )
    state = point.state + start @ unknowns[:-1]
    period = problem.quarters * float(unknowns[-1])
    end, monodromy = system.propagator.flow_with_stm(state, period)
    multipliers = floquet_multipliers(system, state, period, monodromy)
    return LyapunovOrbit(
        system=system,
        saddle=saddle,
        family=family,
        energy=energy,
        state=state,
        period=period,
        floquet_multipliers=multipliers,
        monodromy=monodromy,
        residual=float(np.abs(end - state).max()),
        newton_residual=residual,
        converged=converged,
        status=status,
    )


def _newton(problem: _Shooting, guess: Array, energy: float, settings: ContinuationSettings) -> tuple[Array, float]:
    """Solve the shooting equations from `guess`; return (unknowns, scaled residual)."""
    system = problem.system
    weights = np.append(np.abs(problem.target) @ (1 / system.scale), 1 / system.energy_scale)
    best, best_residual = guess, np.inf
    unknowns = guess
    for _ in range(settings.newton_iterations):
        try:
            value, jacobian = problem.residual(unknowns, energy)
            step = np.linalg.solve(jacobian, value)
        except (ArithmeticError, np.linalg.LinAlgError):
            return best, best_residual
        residual = float(np.max(np.abs(value) * weights))
        if residual < best_residual:
            best, best_residual = unknowns, residual
        elif best_residual < settings.tolerance:
            # Newton has reached rounding: more steps only wander.
            return best, best_residual
        unknowns = unknowns - step
        if unknowns[-1] <= 0:
            return best, np.inf
    return best, best_residual


def _follow(
    problem: _Shooting,
    settings: ContinuationSettings,
    linear: tuple[Array, float, float],
    energies: tuple[float, float],
) -> tuple[Array, float, bool, str]:
    """Continue from the linear centre in s = √(energy above the saddle) with secant predictions."""
    direction, frequency, sign = linear
    saddle_energy, energy = energies
    goal = np.sqrt(abs(energy - saddle_energy))
    largest = settings.step * np.sqrt(problem.system.energy_scale)

    def linear_guess(s: float) -> Array:
        return np.append(direction * s, 2 * np.pi / frequency / problem.quarters)

    points: list[tuple[float, Array]] = [(0.0, linear_guess(0.0))]
    step = min(largest, goal)
    residual = np.inf
    while points[-1][0] < goal:
        s = min(points[-1][0] + step, goal)
        if len(points) == 1:
            guess = linear_guess(s)
        else:
            (s0, u0), (s1, u1) = points[-2:]
            guess = u1 + (u1 - u0) * (s - s1) / (s1 - s0)
        at = energy if s == goal else saddle_energy + sign * s * s
        unknowns, residual = _newton(problem, guess, at, settings)
        jumped = np.linalg.norm(unknowns - guess) > 0.5 * np.linalg.norm(guess)
        if residual > settings.tolerance or jumped:
            step = (s - points[-1][0]) / 2
            if step < settings.smallest_step * largest:
                reached = saddle_energy + sign * points[-1][0] ** 2
                return points[-1][1], residual, False, (
                    f"not converged: the family could be followed only to {reached:.6g} J (residual "
                    f"{residual:.1e} beyond); ask for an energy nearer to the saddle's"
                )  # fmt: skip
            continue
        points.append((s, unknowns))
        step = min(largest, step * 1.5)
    return points[-1][1], residual, True, f"converged in {len(points) - 1} continuation steps"


def floquet_multipliers(system: System, state: Array, period: float, monodromy: Array) -> NDArray[np.complex128]:
    """Return the N Floquet multipliers of a periodic orbit, largest modulus first.

    The pair at one belongs to the flow and the energy: M f = f and ∇Hᵀ M = ∇Hᵀ. The others are the eigenvalues
    of M on ker ∇H modulo f. Those inside the unit circle are taken from the backward monodromy matrix, since the
    forward one knows them only to rounding times the largest squared.
    """
    rate, gradient = system.numeric.rate(state), system.numeric.gradient(state)
    plane, _ = np.linalg.qr(np.column_stack([rate, gradient]))
    rest = np.linalg.svd(plane.T)[2][2:].T
    forward = np.linalg.eigvals(rest.T @ monodromy @ rest)
    _, backward_monodromy = system.propagator.flow_with_stm(state, -period)
    backward = np.linalg.eigvals(rest.T @ backward_monodromy @ rest)
    outside = forward[np.abs(forward) > 1 + 1e-6]
    inside = 1 / backward[np.abs(backward) > 1 + 1e-6]
    count = system.dimension - 2 - len(outside) - len(inside)
    neutral = forward[np.argsort(np.abs(np.abs(forward) - 1))[: max(count, 0)]]
    along = rate @ monodromy @ rate / (rate @ rate)
    across = gradient @ monodromy @ gradient / (gradient @ gradient)
    values = np.concatenate([outside, [along, across], neutral, inside]).astype(complex)
    return values[np.argsort(-np.abs(values), kind="stable")]
