"""How the cart of a recording moved: the acceleration that its arms felt, from the command or from its position.

    u_k = (a_k + a_{k+1}) / 2,      a = d²/dt² of cubics through 20 ms of the position (Savitzky–Golay)

A command is sharper, but a drive may lag, saturate or give less than it is told. It is taken where it explains the
position: where its integral, smoothed alike, has the accelerations of the position to a tenth of their rms.
Source: Savitzky & Golay, Smoothing and Differentiation of Data (1964).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
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
    known = np.isfinite(part.cart)
    if known.sum() < 2 or float(np.ptp(part.cart[known])) < STILL:
        return None
    # A reading now and then that is missing leaves the position on the line through its neighbours.
    position = part.cart
    if not known.all():
        between = make_interp_spline(part.time[known], part.cart[known], k=1)
        position = np.asarray(between(part.time), dtype=np.float64)
    velocity, felt = (_derivative(position, period, order) for order in (1, 2))
    if command is not None:
        sent = period * np.concatenate([[0.0], np.cumsum(command[:-1])])
        told = _derivative(_integral(sent, command, period), period, 2)
        missed, moved = (float(np.sqrt(np.mean(np.square(a)))) for a in (told - felt, felt))
        if missed <= _EXPLAINED * moved:
            return CartMotion(position, velocity, command, True)
    acceleration = (felt + np.append(felt[1:], felt[-1])) / 2
    return CartMotion(position, velocity, acceleration, False)


def _derivative(position: Array, period: float, order: int) -> Array:
    width = min(max(round(_SMOOTHED / period) | 1, 5), len(position) if len(position) % 2 else len(position) - 1)
    if width < 5:
        return np.zeros(len(position))
    return np.asarray(savgol_filter(position, width, 3, deriv=order, delta=period), dtype=np.float64)


def _integral(velocity: Array, acceleration: Array, period: float) -> Array:
    """Return positions (K,) m from velocities at the samples and accelerations held between them."""
    steps = period * velocity[:-1] + period**2 / 2 * acceleration[:-1]
    return np.concatenate([[0.0], np.cumsum(steps)])
