"""Symmetric shooting: periodic orbits as arcs between the fixed sets of two reversers.

About a saddle x* each reverser acts as R(x) = A (x - x*) + x*. A symmetric orbit crosses the fixed sets of the
reversers: it starts on Fix R_a and reaches Fix R_b after a quarter of its period (half, where a = b). With
x(0) = x* + B c, B a basis of Fix A_a, the unknowns (c, τ) solve

    C_b (x(τ) - x*) = 0,

C_b the rows that vanish on Fix A_b: n equations for n + 1 unknowns, with exact derivatives from the variational
equations. They define the family as a curve; one equation more (an energy, a length along the curve) picks a member.
Source: Lamb & Roberts, Time-reversal symmetry in dynamical systems (1998), theorem 4.2.

Orbits grow from equilibria, which are described here too: energy, eigenvalues and what kind of point each is.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System, saddle_index
from dpcontrol.foundation.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Equilibrium:
    """state (N,), energy in J, eigenvalues (N,) in 1/s, kind: "centre" or "index-k saddle"."""

    name: str
    state: Array
    energy: float
    eigenvalues: NDArray[np.complex128]
    kind: str


def equilibrium(system: System, name: str) -> Equilibrium:
    """Describe the named equilibrium.

    Raises:
        InputError: there is no equilibrium of that name.
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
    """Describe every equilibrium of the system, by name."""
    return {name: equilibrium(system, name) for name in system.equilibria}


def resting_place(system: System) -> str:
    """Return the name of the equilibrium of least energy, where arms hang still."""
    return min(system.equilibria, key=lambda name: float(system.numeric.hamiltonian(system.equilibrium(name))))


Row = Callable[[Array], tuple[float, Array]]

_LONGEST = 3.0
"""Times the guessed arc's duration: what Newton's method may try."""


@dataclass(frozen=True)
class SymmetricShooting:
    """The shooting problem about one saddle.

    centre (N,): the saddle. start (N, n): basis of the fixed set on which orbits start. target (n, N): rows that
    vanish on the one where the arc ends. quarters: arcs to a period, 4, or 2 where there is one reverser.
    """

    system: System
    centre: Array
    start: Array
    target: Array
    quarters: int

    def state(self, unknowns: Array) -> Array:
        """Return the orbit's starting state (N,) of unknowns (c, τ)."""
        return self.centre + self.start @ unknowns[:-1]

    def period(self, unknowns: Array) -> float:
        """Return the orbit's period in s."""
        return self.quarters * float(unknowns[-1])

    def arc(self, unknowns: Array) -> tuple[Array, Array]:
        """Return how far the arc's end is off the target set (n,) and the derivative (n, n + 1) by (c, τ).

        Raises:
            ArithmeticError: the arc became infinite.
        """
        end, stm = self.system.propagator.flow_with_stm(self.state(unknowns), unknowns[-1])
        jacobian = np.column_stack([self.target @ stm @ self.start, self.target @ self.system.numeric.rate(end)])
        return self.target @ (end - self.centre), jacobian

    def energy(self, unknowns: Array) -> tuple[float, Array]:
        """Return the orbit's energy in J and its derivative (n + 1,) by (c, τ)."""
        state, numeric = self.state(unknowns), self.system.numeric
        return float(numeric.hamiltonian(state)), np.append(numeric.gradient(state) @ self.start, 0.0)

    @property
    def arc_weights(self) -> Array:
        """What divides (n,) the arc's miss into scaled units, inverted."""
        return np.abs(self.target) @ (1 / self.system.scale)

    def at_energy(self, guess: Array, energy: float, *, iterations: int, tolerance: float) -> tuple[Array, float]:
        """Solve for the member at `energy` from guessed unknowns (n + 1,); return (unknowns, scaled residual).

        The residual is infinite where Newton left the family: for arcs of no or of over three times the guessed
        duration.
        """
        found = self.member(guess, energy, iterations=iterations, tolerance=tolerance)
        return found.unknowns, found.residual

    def member(
        self, guess: Array, energy: float, *, iterations: int, tolerance: float, enough: float = 0.0
    ) -> "FamilyMember":
        """Solve for the member at `energy` as `at_energy` does, and tell where the family goes from there.

        enough: a residual with which Newton's method stops; else it goes on to rounding, which is to be below
        `tolerance`.
        """

        def row(unknowns: Array) -> tuple[float, Array]:
            here, slope = self.energy(unknowns)
            return (here - energy) / self.system.energy_scale, slope / self.system.energy_scale

        found = self._newton(guess, row, iterations=iterations, tolerance=tolerance, enough=enough)
        return replace(found, slope=found.slope / self.system.energy_scale)

    def along(
        self, guess: Array, tangent: Array, weights: Array, *, iterations: int, tolerance: float
    ) -> tuple[Array, float]:
        """Solve for the member on the plane through `guess` across `tangent` (both n + 1); as `at_energy` returns.

        weights (n + 1,) divide the unknowns in the plane's scalar product.
        """

        def row(unknowns: Array) -> tuple[float, Array]:
            return float(tangent @ ((unknowns - guess) / weights)), tangent / weights

        found = self._newton(guess, row, iterations=iterations, tolerance=tolerance)
        return found.unknowns, found.residual

    def _newton(
        self, guess: Array, row: Row, *, iterations: int, tolerance: float, enough: float = 0.0
    ) -> "FamilyMember":
        best = FamilyMember(guess, np.inf, np.zeros_like(guess))
        unknowns = guess
        for _ in range(iterations):
            try:
                miss, arc_jacobian = self.arc(unknowns)
                extra, slope = row(unknowns)
                right = np.column_stack([np.append(miss, extra), np.append(np.zeros_like(miss), 1.0)])
                step, along = np.linalg.solve(np.vstack([arc_jacobian, slope]), right).T
            except (ArithmeticError, np.linalg.LinAlgError):
                return best
            residual = float(np.max(np.append(np.abs(miss) * self.arc_weights, abs(extra))))
            if residual < best.residual:
                best = FamilyMember(unknowns, residual, along)
                if residual <= enough:
                    return best
            elif best.residual < tolerance:
                # Newton has reached rounding: more steps only wander.
                return best
            unknowns = unknowns - step
            # Far from the guess it is another orbit, and long arcs are slow to fly.
            if not 0 < unknowns[-1] <= _LONGEST * guess[-1]:
                return replace(best, residual=np.inf)
        return best


@dataclass(frozen=True)
class FamilyMember:
    """What Newton's method found: unknowns (n + 1,), scaled residual, and their change (n + 1,) by the closing row's
    value: by the energy in J for a member at an energy.
    """

    unknowns: Array
    residual: float
    slope: Array


def fixed_and_moved(reverser: Array) -> tuple[Array, Array]:
    """Return a basis (N, n) of the fixed set of an involution (N, N) and rows (n, N) that vanish on it."""
    values, vectors = (np.asarray(a, dtype=complex) for a in np.linalg.eig(reverser))
    fixed = np.real(vectors[:, np.real(values) > 0])
    basis, _ = np.linalg.qr(fixed)
    projector = (np.eye(len(reverser)) - reverser) / 2
    _, s, vt = np.linalg.svd(projector)
    return basis, vt[s > 0.5]


@dataclass(frozen=True)
class LinearCentre:
    """The family at its birth: (c) direction (n,) per √J, angular frequency in rad/s, sign of the energy above."""

    energy: float
    direction: Array
    frequency: float
    sign: float


def symmetric_shooting(system: System, saddle: str, family: int) -> tuple[SymmetricShooting, LinearCentre]:
    """Return the shooting problem of one family of Lyapunov orbits, and the linear centre from which it grows.

    Raises:
        InputError: unknown saddle or family, a point that is no index-1 saddle, or a system without reversers.
    """
    point = equilibrium(system, saddle)
    if saddle not in system.saddles:
        raise InputError(
            f"{saddle} of {system.name} is: {point.kind}, no index-1 saddle: it has no tubes; choose one of "
            + ", ".join(system.saddles)
        )
    if not system.reversers:
        raise InputError(
            f"{system.name} has no known symmetry that reverses its motion about {', '.join(system.saddles)} in time, "
            "with which Lyapunov orbits are found; declare its reversers, or leave out the saddles that they move"
        )
    first, last = system.reversers[-1], system.reversers[0]
    start, _ = fixed_and_moved(first)
    _, target = fixed_and_moved(last)
    problem = SymmetricShooting(system, point.state, start, target, 4 if len(system.reversers) > 1 else 2)
    return problem, _linear_centre(problem, saddle, family)


def _linear_centre(problem: SymmetricShooting, saddle: str, family: int) -> LinearCentre:
    system, centre, start = problem.system, problem.centre, problem.start
    values, vectors = (np.asarray(a, dtype=complex) for a in np.linalg.eig(system.numeric.jacobian(centre)))
    rotating = [i for i in np.argsort(np.abs(np.imag(values))) if np.imag(values[i]) > 1e-6 * abs(values[i])]
    if not 0 <= family < len(rotating):
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
    lowest = float(system.numeric.hamiltonian(centre))
    height = float(system.numeric.hamiltonian(centre + tiny * mode)) - lowest
    direction = start.T @ mode * tiny / np.sqrt(abs(height))
    return LinearCentre(lowest, direction, float(np.imag(values[rotating[family]])), float(np.sign(height)))
