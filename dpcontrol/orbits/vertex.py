"""Rotating orbits as vertices of the connection graph."""

from dataclasses import dataclass

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.orbits.rotating import RotatingOrbit


@dataclass(frozen=True)
class HyperbolicOrbit(LyapunovOrbit):
    """A hyperbolic periodic orbit outside the saddles' families.

    The attribute `saddle` is the name of the vertex.

    Attributes:
        mirror (N, N), rest (N,): reverser and its centre.
        winding (N,): whole turns per period.
        node_times (M + 1,): 0 to the period, s.
        node_states (M + 1, N): including both ends.
    """

    mirror: Array
    rest: Array
    winding: Array
    node_times: Array
    node_states: Array

    @property
    def nodes(self) -> tuple[Array, Array]:
        """Times (M + 1,), s, and states (M + 1, N), including both ends."""
        return self.node_times, self.node_states

    @property
    def centre(self) -> Array:
        """State (N,) at rest about which the orbit is symmetric."""
        return self.rest

    @property
    def reverser(self) -> Array:
        """The reverser (N, N) that maps the orbit to itself."""
        return self.mirror

    @property
    def whole_turns(self) -> Array:
        """Whole turns (N,) of the coordinates per period."""
        return self.winding

    @property
    def laps(self) -> bool:
        """True: the orbit itself, and its tubes with it, may cross sections in every period."""
        return True


_FLOWN = 8
"""Segments of a rotating orbit from the symmetry line; their mirror images give as many more."""


def rotating_vertex(orbit: RotatingOrbit, *, name: str | None = None) -> HyperbolicOrbit:
    """Return a rotating orbit as a vertex of the connection graph.

    Args:
        orbit: hyperbolic rotating orbit.
        name: by default "outer-rotating" or "inner-rotating", with "-back" for clockwise rotation.

    Raises:
        InputError: the orbit is not hyperbolic and has no tubes.
    """
    if not orbit.hyperbolic:
        raise InputError(
            f"the rotating orbit at {orbit.energy:g} J is {orbit.kind} (trace {orbit.trace:.6g}): only hyperbolic "
            "orbits have tubes; choose another orbit or energy"
        )
    system, n = orbit.system, orbit.system.dimension // 2
    default = f"{('inner', 'outer')[orbit.arm - 1]}-rotating{'' if sum(orbit.winding) > 0 else '-back'}"
    resting_state = np.concatenate([orbit.state[:n], np.zeros(n)])
    winding = np.zeros(2 * n)
    winding[:n] = orbit.winding
    times = np.linspace(0.0, orbit.period, 2 * _FLOWN + 1)
    mirror = system.reversers[-1]
    first_half = system.propagator.sample(orbit.state, times[: _FLOWN + 1])
    # γ(1 - φ) = R γ(φ) + a whole turn.
    second_half = (first_half[:-1][::-1] - resting_state) @ mirror.T + resting_state + winding * system.turn_lengths
    states = np.vstack([first_half, second_half])
    _, stms = system.propagator.flows_with_stm(states[:-1], np.diff(times))
    monodromy = np.eye(2 * n)
    for stm in stms:
        monodromy = stm @ monodromy
    multiplier = float(complex(orbit.floquet_multipliers[0]).real)
    neutral = [1.0] * (2 * n - 2)
    return HyperbolicOrbit(
        system=system,
        saddle=name or default,
        family=0,
        energy=orbit.energy,
        state=states[0],
        period=orbit.period,
        floquet_multipliers=np.array([multiplier, *neutral, 1 / multiplier], dtype=complex),
        monodromy=monodromy,
        residual=orbit.residual,
        outcome=orbit.outcome,
        mirror=mirror,
        rest=resting_state,
        winding=winding,
        node_times=times,
        node_states=states,
    )
