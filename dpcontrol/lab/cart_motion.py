"""How the cart of a recording moved: the acceleration that its arms felt, from the command or from its position.

    v = d/dt of cubics through 20 ms of the position (Savitzky–Golay),      u_k = (v_{k+1} - v_k) / Δt

A command is sharper, but a drive may lag, saturate or give less than it is told. It is taken where it explains the
position: where its integral, smoothed alike, has the accelerations of the position to a tenth of their rms.
Source: Savitzky & Golay, Smoothing and Differentiation of Data (1964).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from dpcontrol.lab.recordings import Recording

Array = NDArray[np.float64]

STILL = 1e-3
"""m: a cart that moves less counts as clamped."""
_SMOOTHED = 0.02
"""s of position to each cubic: at micrometres the acceleration is known to some mm/s², and 10 Hz pass."""
_EXPLAINED = 0.1


@dataclass(frozen=True, eq=False)
class CartMotion:
    """At each of K samples: position m, velocity m/s, and the acceleration m/s² held until the next sample.

    commanded: whether the acceleration is the command's; else it is the position's.
    """

    position: Array
    velocity: Array
    acceleration: Array
    commanded: bool


def cart_motion(part: Recording) -> CartMotion | None:
    """Return how the cart moved in a recording of one segment, or None where it was clamped."""
    period, command = part.dt, part.command
    if part.cart is None:
        if command is None or not command.any():
            return None
        velocity = period * np.concatenate([[0.0], np.cumsum(command[:-1])])
        return CartMotion(_integral(velocity, command, period), velocity, command, True)
    if float(np.ptp(part.cart)) < STILL:
        return None
    velocity = _velocity(part.cart, period)
    acceleration = np.diff(velocity, append=2 * velocity[-1] - velocity[-2]) / period
    if command is not None:
        sent = period * np.concatenate([[0.0], np.cumsum(command[:-1])])
        told = np.diff(_velocity(_integral(sent, command, period), period)) / period
        missed, moved = (float(np.sqrt(np.mean(np.square(a)))) for a in (told - acceleration[:-1], acceleration))
        if missed <= _EXPLAINED * moved:
            return CartMotion(part.cart, velocity, command, True)
    return CartMotion(part.cart, velocity, acceleration, False)


def _velocity(position: Array, period: float) -> Array:
    width = min(max(round(_SMOOTHED / period) | 1, 5), len(position) if len(position) % 2 else len(position) - 1)
    if width < 5:
        return np.asarray(np.gradient(position, period), dtype=np.float64)
    return np.asarray(savgol_filter(position, width, 3, deriv=1, delta=period), dtype=np.float64)


def _integral(velocity: Array, acceleration: Array, period: float) -> Array:
    """Return positions (K,) m from velocities at the samples and accelerations held between them."""
    steps = period * velocity[:-1] + period**2 / 2 * acceleration[:-1]
    return np.concatenate([[0.0], np.cumsum(steps)])
