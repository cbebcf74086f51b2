"""Sustained orbits: periodic orbits with friction and cart that need the least effort of the cart.

    minimise ∫ u² + w_x x² dt  over one period T
    subject to  ẋ = f(x, u),  x(T) = x(0),  H(x(0)) = E,  θ_k(0) as at the saddle

x(T) = x(0) closes the cart's motion as well. H is fixed at one point of the orbit. Otherwise rest at the equilibrium
would be optimal. The input jumps there. The angle of the fastest arm at that point fixes the phase, w_x centres the
cart, and the period is free. The search starts on the Lyapunov orbit, which is the result without friction.

Multipliers. *Period map*: x(0) → x(T) with the input replayed by time. *Section map*: from one section through the
orbit to the next, at right angles to it (pendulum only, scaled). The clock is reset to the section's phase at each
crossing. Its multipliers are λ_u, λ_s and one near 1 for the decay of the energy. They depend on the number of resets.
The cart adds 1, 1 to either map: driven by its acceleration it is a double integrator, which drifts without feedback.

Linearised along the orbit, small differences and a pulse of the input become

    δẋ = A(t) δx + B(t) v(t),    A = ∂f/∂x,  B = ∂f/∂u  at (x*(t), u*(t));    δx(b) = Φ(b, a) δx(a) + Γ(b, a)

solved by Gauss collocation on the reference's intervals, whose polynomials are smooth there.

Sources: Ott, Grebogi & Yorke, Controlling chaos, Physical Review Letters 64 (1990), for control on sections. Betts,
Practical Methods for Optimal Control Using Nonlinear Programming, 3rd ed., section 4.7, for the resolution of
intervals. Hairer, Lubich & Wanner, Geometric Numerical Integration, section II.1, for the method.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import ReferenceCause
from dpcontrol.foundation.checked import Hit, checked
from dpcontrol.foundation.document import picked
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.shown import Brief, Timed, checked_times
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.orbits.manifold import OrbitCurve
from dpcontrol.references.ending import ReferenceEnding
from dpcontrol.references.find import find_reference
from dpcontrol.references.method import gauss
from dpcontrol.references.problem import EndConditions, Limits, ReferenceProblem, ReferenceSettings, state_scale
from dpcontrol.references.reference import ByReference, Reference
from dpcontrol.references.trajectory import times_on

Signal = Callable[[Array], Array]
"""From times (K,) in s to inputs (K,) in m/s²."""

_METHOD = gauss(8)
"""Method of order 16, whose error is at rounding on the reference's intervals."""
_SMALL = 0.5


def _multipliers(parts: Array) -> NDArray[np.complex128]:
    """Return the Floquet multipliers of a period from its parts, largest modulus first.

    They are the eigenvalues of the product parts[-1] … parts[0] (P, n, n) of the pendulum's transition matrices, and
    the cart's 1, 1.

    Eigenvalues well inside the unit circle come from the product of the parts' inverses, because the product itself
    resolves them only to rounding times its largest. The pendulum's motion does not depend on the cart.
    """
    forward, backward = np.eye(parts.shape[-1]), np.eye(parts.shape[-1])
    for part in parts:
        forward = part @ forward
        backward = backward @ np.linalg.inv(part)
    large_values, small_values = (
        np.linalg.eigvals(forward).astype(complex),
        1 / np.linalg.eigvals(backward).astype(complex),
    )
    large_values, small_values = (v[np.argsort(-np.abs(v), kind="stable")] for v in (large_values, small_values))
    multipliers = np.concatenate([np.where(np.abs(small_values) < _SMALL, small_values, large_values), [1.0, 1.0]])
    return multipliers[np.argsort(-np.abs(multipliers), kind="stable")]


STRETCH = 0.2
"""Allowed relative change of the period from the Lyapunov orbit's; at the bound, it is another orbit."""


SUSTAINED = ReferenceSettings(method="radau-8", tolerance=1e-9, pendulum_weight=0.0, cart_weight=1.0, iterations=60)
"""Settings for the cheapest orbit, without a weight on the distance from the Lyapunov orbit."""


@dataclass(frozen=True, eq=False)
class PhaseSection(Brief):
    """The plane through the orbit at one of its phases, at right angles to the orbit in the pendulum's scaled state.

    Attributes:
        phase: 0 to 1.
        time: on the orbit's clock, s.
        state, rate: x*, ẋ* there (N,).
        normal: normal (N,) with normal · rate = 1, zero for the cart, whose place does not determine the phase.
    """

    phase: float
    time: float
    state: Array
    rate: Array
    normal: Array

    @property
    def projection(self) -> Array:
        """The matrix (N, N) that projects onto the section, by a small move along the orbit."""
        return np.eye(len(self.rate)) - np.outer(self.rate, self.normal)


@dataclass(frozen=True, eq=False)
class SectionMap(Brief):
    """First-order map from section j to section j + 1.

    With the clock reset at j, ξ_{j+1} = matrix ξ_j + response p_j.

    ξ (N,) is the state minus the orbit's at the section. p_j, in m/s², is the height of a half-sine pulse added to the
    orbit's input from j to j + 1. It lasts the nominal time between the sections, `duration` s. matrix (N, N), response
    (N,).
    """

    start: PhaseSection
    end: PhaseSection
    duration: float
    matrix: Array
    response: Array

    def pulse(self, times: ArrayLike) -> Array:
        """Return the half-sine pulse of height 1 that control on sections adds to the input, zero before and after it.

        Args:
            times: times (…) after the start's crossing, s.

        Returns:
            Values (…).
        """
        share = np.asarray(times, dtype=float) / self.duration
        return np.where((share >= 0) & (share <= 1), np.sin(np.pi * np.clip(share, 0.0, 1.0)), 0.0)


@dataclass(frozen=True, eq=False)
class SustainedOrbit(ByReference, Timed):
    """A periodic orbit of pendulum and cart with the input that sustains it; time 0 is its phase 0.

    Attributes:
        lyapunov: the conservative orbit that it continues.
        arms: arms with friction.
        reference: one period.
        resets: sections per period at which the input's clock is reset, for the multipliers of the document.
    """

    lyapunov: LyapunovOrbit
    arms: ArmChainParameters
    reference: Reference
    resets: int = 1

    def __repr__(self) -> str:
        return f"<sustained orbit about {self.lyapunov.saddle} at {self.energy:g}: {self.status}>"

    @property
    def time_range(self) -> tuple[float, float]:
        """First and last time of a period, s."""
        return 0.0, self.period

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the N entries of a state."""
        return (*self.lyapunov.columns, "cart_position", "cart_velocity")

    def states(self, times: Any = None) -> Array:
        """Return the states of arms and cart at given times.

        Args:
            times: times (K,) from phase 0, s; by default 200 over one period.

        Returns:
            States (K, N): angles, rates, and the cart's position and velocity.

        Raises:
            InputError: the times are not finite numbers.
        """
        return self.sample() if times is None else self.state(checked_times(times))

    @property
    def energy(self) -> float:
        """The pendulum's energy where the orbit starts, J."""
        return self.lyapunov.energy

    @property
    def equations(self) -> Equations:
        """The equations that it solves, at the cart level."""
        return equations_of(self.arms, Level.CART)

    @cached_property
    def parameters(self) -> Array:
        """The equations' base parameters (p,)."""
        return self.arms.base()

    @property
    def _pendulum(self) -> Array:
        """The pendulum's states (K, 2n) at all nodes."""
        n = self.lyapunov.system.dimension
        return self.reference.states[..., :n].reshape(-1, n)

    @cached_property
    def energies(self) -> tuple[float, float]:
        """The pendulum's least and largest energy along the orbit, J."""
        energies = self.lyapunov.system.numeric.hamiltonian(self._pendulum)
        return float(energies.min()), float(energies.max())

    @cached_property
    def departure(self) -> float:
        """The largest scaled distance from the Lyapunov orbit."""
        return float(OrbitCurve(self.lyapunov).distances(self._pendulum)[1].max())

    @cached_property
    def multipliers(self) -> NDArray[np.complex128]:
        """Multipliers (N,) of the period map with replayed input, largest first; NaN if not converged."""
        n = self.lyapunov.system.dimension
        if not self.converged:
            return np.full(n + 2, np.nan, dtype=complex)
        return _multipliers(self.pieces(0.0, self.period)[0][:, :n, :n])

    @property
    def period(self) -> float:
        """Period in s."""
        return self.reference.duration

    @property
    def residual(self) -> float:
        """Scaled residual: the larger of error between nodes and violation of closing, energy or limits."""
        return self.reference.residual

    def state(self, times: ArrayLike) -> Array:
        """Return states (…, N) of angles, rates, cart position and velocity at any times.

        Args:
            times: times (…), s.
        """
        return self.reference.state(np.mod(times, self.period))

    def input(self, times: ArrayLike) -> Array:
        """Return the cart's acceleration (…), m/s², that sustains the orbit, at any times.

        Args:
            times: any times (…), s.
        """
        return self.reference.input(np.mod(times, self.period))[..., 0]

    @cached_property
    def _jacobians(self) -> ca.Function:
        """Function of state, input and parameters to A = ∂f/∂x (N, N) and B = ∂f/∂u (N, 1)."""
        equations = self.equations
        parts = [
            ca.densify(ca.jacobian(equations.rate, equations.state)),
            ca.densify(ca.jacobian(equations.rate, equations.inputs)),
        ]
        return ca.Function("linear", [equations.state, equations.inputs, equations.parameters], parts, {"cse": True})

    def pieces(self, begin: float, end: float, *, pulse: Signal | None = None) -> tuple[Array, Array]:
        """Return transition matrices (P, N, N) and pulse responses (P, N) of the pieces between two times.

        A piece ends where an interval of the reference does.

        Args:
            begin: start of the first piece, s.
            end: end of the last piece, s.
            pulse: added cart acceleration v(t), m/s²; None for none.
        """
        mesh = self.reference.mesh
        ends = np.concatenate([[begin], mesh[(mesh > begin + 1e-12) & (mesh < end - 1e-12)], [end]])
        lengths, n, count = np.diff(ends), self.equations.dimension, len(_METHOD.points)
        flat_times = times_on(ends, _METHOD.points).ravel()
        values = self._jacobians.map(len(flat_times))(
            self.reference.state(flat_times).T,
            self.reference.input(flat_times).T,
            ca.repmat(ca.DM(self.parameters), 1, len(flat_times)),
        )
        a, b = (np.array(v).reshape(n, len(flat_times), -1).transpose(1, 0, 2) for v in values)
        forcing = b[..., 0] * (np.zeros(len(flat_times)) if pulse is None else np.asarray(pulse(flat_times)))[:, None]
        a, forcing = a.reshape(-1, count, n, n), forcing.reshape(-1, count, n)
        # Unknowns: δx at the points, for each unit vector at the start and for the pulse. At each point k,
        # Σ_j D_kj δx_j = h (A_k δx_k + B_k v_k), with the method's differentiation D and the length h.
        system = np.tile(np.kron(_METHOD.differentiation[:, 1:], np.eye(n)), (len(lengths), 1, 1))
        right_side = np.empty((len(lengths), count * n, n + 1))
        right_side[..., :n] = -np.kron(_METHOD.differentiation[:, :1], np.eye(n))
        right_side[..., n] = (lengths[:, None, None] * forcing).reshape(len(lengths), -1)
        for k in range(count):
            rows = slice(k * n, (k + 1) * n)
            system[:, rows, rows] -= lengths[:, None, None] * a[:, k]
        solution = np.linalg.solve(system, right_side).reshape(len(lengths), count, n, n + 1)
        end_values = np.einsum("k,pkij->pij", _METHOD.end[1:], solution)
        end_values[..., :n] += _METHOD.end[0] * np.eye(n)
        return end_values[..., :n], end_values[..., n]

    def over(self, begin: float, duration: float, *, pulse: Signal | None = None) -> tuple[Array, Array]:
        """Return the linearised flow along the orbit over a time that can pass the period's end.

        Args:
            begin: begin, s.
            duration: time, s.
            pulse: v of the time from `begin` on, zero if there is none.

        Returns:
            State-transition matrix Φ (N, N), and response Γ (N,) of the state to the pulse.
        """
        n, period = self.equations.dimension, self.period
        matrix, response = np.eye(n), np.zeros(n)
        time_to_period_end = min(duration, period - begin)
        spans = [(begin, begin + time_to_period_end, -begin)]
        # The rest after the period's end starts at its clock's zero, unless it is rounding.
        if duration - time_to_period_end > 1e-12 * period:
            spans.append((0.0, duration - time_to_period_end, time_to_period_end))
        for start, end, shift in spans:
            shifted_pulse = None if pulse is None else lambda t, shift=shift: pulse(t + shift)
            part_matrix, part_response = self._span(start, end, pulse=shifted_pulse)
            matrix, response = part_matrix @ matrix, part_matrix @ response + part_response
        return matrix, response

    def _span(self, begin: float, end: float, *, pulse: Signal | None) -> tuple[Array, Array]:
        """Return the linearised flow between two times (s) within one period of the orbit's clock.

        `pulse` is an added cart acceleration v(t), m/s², or None.

        Returns:
            State-transition matrix Φ (N, N), and response Γ (N,) of the state to the pulse.
        """
        n = self.equations.dimension
        matrix, response = np.eye(n), np.zeros(n)
        for part_matrix, part_response in zip(*self.pieces(begin, end, pulse=pulse), strict=True):
            matrix, response = part_matrix @ matrix, part_matrix @ response + part_response
        return matrix, response

    def section(self, phase: float) -> PhaseSection:
        """Return the section across the orbit at a phase.

        Control on sections measures the deviation of a state where it crosses them.

        Args:
            phase: phase, 1 for a period, counted modulo 1.
        """
        phase = phase % 1.0
        time = phase * self.period
        state, acceleration = self.reference.state(time), self.reference.input(time)
        rate = np.array(self.equations.function()(state, acceleration, self.parameters)).ravel()
        scale = state_scale(len(state), self.reference.limits)
        normal = rate / scale**2
        normal[-2:] = 0.0
        return PhaseSection(phase, time, state, rate, normal / (normal @ rate))

    @checked
    def sections(self, count: Hit) -> tuple[PhaseSection, ...]:
        """Return sections at phases (j + 1/2) / count, farthest from the jump of the input at phase 0.

        Args:
            count: number of sections.

        Raises:
            InputError: `count` is less than 1 or more than 1,000.
        """
        return tuple(self.section((j + 0.5) / count) for j in range(count))

    def section_maps(self, count: int) -> tuple[SectionMap, ...]:
        """Return the linearised maps from each section to the next, and from the last to the first.

        Args:
            count: number of sections.

        Raises:
            InputError: `count` is less than 1 or more than 1,000.
        """
        sections = self.sections(count)
        return tuple(self._map(a, b, self.period / count) for a, b in pairwise((*sections, sections[0])))

    def _map(self, start: PhaseSection, end: PhaseSection, duration: float) -> SectionMap:
        """Return the linearised map from one section to the next, which is reached after about `duration`, s."""
        empty_map = SectionMap(start, end, duration, np.empty(0), np.empty(0))
        matrix, response = self.over(start.time, duration, pulse=empty_map.pulse)
        return replace(empty_map, matrix=end.projection @ matrix, response=end.projection @ response)

    def section_multipliers(self, count: int) -> NDArray[np.complex128]:
        """Return the multipliers (N-1,) of the section map over a period, largest first.

        They tell the growth of a deviation over a period if the input's clock is reset at each section.

        Args:
            count: number of sections.

        Raises:
            InputError: `count` is less than 1 or more than 1,000.
        """
        maps, n = self.section_maps(count), self.lyapunov.system.dimension
        # Each section is spanned by the directions of the pendulum's state that are at right angles to its normal.
        bases = [np.linalg.svd(section_map.start.normal[None, :n])[2][1:].T for section_map in maps]
        parts = [
            end_basis.T @ section_map.matrix[:n, :n] @ start_basis
            for section_map, start_basis, end_basis in zip(maps, bases, bases[1:] + bases[:1], strict=True)
        ]
        return _multipliers(np.array(parts))

    def document(self) -> dict[str, Any]:
        """Return the JSON output of `dpcontrol orbit --sustained`."""
        reference, converged = self.reference, self.converged
        return {
            **picked(self.lyapunov, "saddle", "family"),
            **picked(self, "energy", "energies", "period", "departure", "residual", "converged", "status"),
            "lyapunov_period": self.lyapunov.period,
            "state": self.state(0.0),
            "multipliers": self.multipliers if converged else None,
            "sections": self.resets,
            "section_multipliers": self.section_multipliers(self.resets) if converged else None,
            "u_rms": reference.rms_cart_acceleration,
            "u_max": reference.max_cart_acceleration,
            **picked(reference, "max_cart_position", "max_cart_velocity", "iterations", "solve_seconds"),
            "error_between_nodes": reference.max_error_between_nodes,
            "intervals": len(reference.mesh) - 1,
        }


def sustained_orbit(
    lyapunov: LyapunovOrbit,
    arms: ArmChainParameters,
    *,
    limits: Limits | None = None,
    settings: ReferenceSettings = SUSTAINED,
    progress: Progress = no_progress,
) -> SustainedOrbit:
    """Return the periodic orbit of arms with friction, kept up by a cart, that continues one of their Lyapunov orbits.

    If `converged` is False, do not use the result; `status` has the cause and a remedy.

    Args:
        lyapunov: conservative orbit.
        arms: arms with friction.
        limits: limits of the cart.
        settings: settings of the collocation.
        progress: receiver of progress reports.

    Raises:
        InputError: the Lyapunov orbit is not one of these arms.
    """
    n = lyapunov.system.dimension // 2
    # A system's last parameters are its friction, which the orbit does not use.
    conservative = lyapunov.system.parameters[:-n]
    if arms.count != n or not np.array_equal(arms.frictionless().base()[:-n], conservative):
        raise InputError(f"the orbit about {lyapunov.saddle} is of other arms than the {arms.count} given")
    curve = OrbitCurve(lyapunov)
    # The fastest arm resolves the phase best.
    fastest_arm = int(np.argmax(np.abs(lyapunov.state[n : 2 * n])))
    start = np.full(2 * n + 2, np.nan)
    start[fastest_arm] = lyapunov.state[fastest_arm]
    problem = ReferenceProblem(
        equations=equations_of(arms, Level.CART),
        parameters=arms.base(),
        guess=lambda times: curve.states(np.asarray(times) / lyapunov.period),
        duration=lyapunov.period,
        limits=limits or Limits(),
        ends=EndConditions(start=start, closing=np.zeros(2 * n + 2), energy=lyapunov.energy, stretch=STRETCH),
    )
    reference = find_reference(problem, settings, progress=progress)
    if reference.converged and abs(reference.duration / lyapunov.period - 1) > 0.999 * STRETCH:
        reference = replace(
            reference,
            converged=False,
            ending=ReferenceEnding(ReferenceCause.OTHER_PERIOD, times=(lyapunov.period,), allowed=STRETCH),
        )
    return SustainedOrbit(lyapunov, arms, reference)
