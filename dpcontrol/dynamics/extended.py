"""Propagation and energy in 113-bit arithmetic (34 decimal digits), by the same equations as in double.

Numbers are numpy arrays whose dtype is heyoka's 113-bit real; +, -, *, /, @ and comparisons keep the precision.
Doubles enter as the exact binary numbers that they are, fractions and decimals correctly rounded; π is given to 36
digits, since 2 * np.pi is off by 2e-16. An array of doubles must be turned by `extended` first: numpy refuses to mix
the two. Source: Biscani & Izzo, Revisiting high-order Taylor methods for astrodynamics and celestial mechanics (2021).
"""

from collections.abc import Sequence
from decimal import Decimal, localcontext
from fractions import Fraction
from functools import cached_property
from typing import Any

import casadi as ca
import heyoka as hy
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.dynamics.compiled import to_heyoka
from dpcontrol.dynamics.equations import Equations
from dpcontrol.dynamics.propagator import check_arrival, taylor_system
from dpcontrol.foundation.errors import GoalMissed

Array = NDArray[np.float64]
Extended = NDArray[Any]
"""A numpy array of 113-bit reals."""

Exact = int | float | Fraction | Decimal

PI = "3.141592653589793238462643383279502884197169399375105820974944592307816406"


def _real() -> Any:
    """Return heyoka's type of 113-bit reals.

    Raises:
        GoalMissed: this build of heyoka has none.
    """
    if not hasattr(hy, "real128"):
        raise GoalMissed("this build of heyoka has no 113-bit reals (it needs libquadmath); use double precision")
    return hy.real128


def _rounded(value: Exact) -> Any:
    exact = Fraction(value)
    # Sixty digits are enough for the nearest 113-bit number.
    with localcontext() as context:
        context.prec = 60
        return _real()(str(Decimal(exact.numerator) / Decimal(exact.denominator)))


def extended(values: ArrayLike | Sequence[Exact]) -> Extended:
    """Return doubles, whole numbers, fractions or decimals, of any shape, as an array of 113-bit reals.

    Raises:
        GoalMissed: this build of heyoka has no such reals.
    """
    given = np.asarray(values)
    if given.dtype == np.float64 or np.issubdtype(given.dtype, np.integer):
        return given.astype(_real())
    flat = [_rounded(value) for value in given.ravel()]
    return np.array(flat, dtype=_real()).reshape(given.shape)


def pi_times(multiples: ArrayLike) -> Extended:
    """Return π times doubles of any shape, each product rounded once to 113 bits."""
    return extended(multiples) * np.array(_real()(PI))


def digits(values: Extended) -> list[str]:
    """Return the decimal digits of 113-bit reals (K,), 36 significant: enough to get each number back."""
    return [str(value) for value in values]


class ExtendedPropagator:
    """Propagates one set of equations in 113-bit arithmetic, with Taylor tolerance 2e-34.

    parameters: exact values of the equations' parameters. Not to be shared between threads.
    """

    def __init__(self, equations: Equations, parameters: Sequence[Exact] | Array) -> None:
        self.equations = equations
        self.parameters = extended(parameters)

    @cached_property
    def _integrator(self) -> Any:
        system = taylor_system(self.equations, [])
        zero = extended(np.zeros(len(system)))
        integrator = hy.taylor_adaptive(system, zero, time=zero[0], fp_type=_real(), compact_mode=True)
        # Parameters that the equations never use are not part of the compiled code.
        integrator.pars[:] = self.parameters[: len(integrator.pars)]
        return integrator

    @cached_property
    def _energy(self) -> Any:
        e = self.equations
        states, parameters = [x for x, _ in taylor_system(e, [])], [hy.par[i] for i in range(e.parameters.shape[0])]
        function = ca.Function("energy", [e.state, e.parameters], [e.hamiltonian])
        value = to_heyoka(function, [states, parameters])
        return hy.cfunc(value, vars=states, fp_type=_real(), compact_mode=True)

    def flow(self, state: Extended, duration: Any) -> Extended:
        """Return the state (N,) after `duration` seconds (negative: before), a 113-bit real.

        Raises:
            ArithmeticError: the state became infinite or undefined.
        """
        return self.sample(state, np.array([duration]))[0]

    def sample(self, state: Extended, times: Extended) -> Extended:
        """Return the states (K, N) at monotonic `times` (K,) s from `state` (N,) at time zero.

        Raises:
            ArithmeticError: the state became infinite or undefined.
        """
        integrator = self._integrator
        integrator.time = _real()(0)
        integrator.state[:] = state
        states = []
        for time in times:
            check_arrival(integrator, integrator.propagate_until(time)[0])
            states.append(integrator.state.copy())
        return np.array(states)

    def energy(self, state: Extended) -> Any:
        """Return the energy H at a state (N,), a 113-bit real, in the equations' unit (J for a pendulum)."""
        return self._energy(state, pars=self.parameters[: self._energy.nparams])[0]
