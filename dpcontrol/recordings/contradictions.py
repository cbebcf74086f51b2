"""Whether a model's arms can have moved as a recording says: not to a percent, as an identification asks, but at all.

Over windows of h = 20 ms the recorded angles accelerate by (θ_{k+h} - 2 θ_k + θ_{k-h}) / h², and the model by its
equations at θ_k and (θ_{k+h} - θ_{k-h}) / 2h, the cart's motion being its input. Encoders of step q blur the former by
q √(i/2) / h² for arm i. Where both differ by more than a third of their size, the recording is not of these arms:
columns are exchanged, an encoder stands still, a sign is wrong, or the arms are others.
"""

from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.recordings.recording import Recording, cart_motion

Array = NDArray[np.float64]

_WINDOW = 0.02
"""s: quantised angles have no accelerations from one sample to the next."""
_CONTRADICTS = 0.3
"""Difference over size: the rig's swings and their model have 0.02, arms of twice the length 0.4, exchanged columns 0.4
to 1.2, an angle that stands still 0.8."""
_AGREES = 3.0
"""Times by which another order of the columns must fit better to be the one."""
_LEAST = 2.0
"""rad/s²: recordings in which the model would move less say nothing."""
_MOVES = 0.05
"""rad over which an arm moves for certain."""


def constant_angles(recording: Recording) -> tuple[str, ...]:
    """Return a sentence on each angle that never changes, while others do or all of them do not."""
    reach = np.ptp(recording.angles, axis=0)
    most, mover = float(reach.max()), int(np.argmax(reach)) + 1
    if most == 0:
        count = len(recording.time)
        return (f"no angle changes in {count} samples: are the encoders connected, and the columns the right ones?",)
    return tuple(
        f"angle {arm + 1} is {recording.angles[0, arm]:g} rad in all {len(recording.time)} samples while angle {mover} "
        f"moves over {most:.3g} rad: is its encoder connected, and its column the right one?"
        for arm in range(recording.arms)
        if reach[arm] == 0 and most > _MOVES
    )


def contradiction(recording: Recording, arms: ArmChainParameters, *, model: str) -> str:
    """Return a sentence on how much these arms, of a model of that name, contradict a recording; empty: not by much."""
    if arms.count != recording.arms:
        return f"the recording has {recording.arms} arms and the model {model} {arms.count}: one is not of the other"
    orders = list(permutations(range(arms.count)))
    # Relative encoders add up to an outer arm's angle.
    blurred = np.sqrt(0.5 * np.arange(1, arms.count + 1)) * _encoder_steps(recording.angles) / _WINDOW**2
    off: list[float] = []
    sizes: list[tuple[Array, Array]] = []
    for order in orders:
        measured, predicted = _accelerations(recording, arms, order)
        if not len(measured):
            return ""
        sizes.append((_rms(measured), _rms(predicted)))
        largest = max(float(np.linalg.norm(size)) for size in sizes[-1])
        apart = float(np.sum(_rms(measured - predicted) ** 2)) - float(np.sum(blurred**2))
        off.append(np.sqrt(max(apart, 0.0)) / max(largest, 1e-300))
        if len(off) == 1 and (off[0] < _CONTRADICTS or sizes[0][1].max() < _LEAST):
            return ""
    said = [" and ".join(f"{value:.3g}" for value in size) for size in sizes[0]]
    text = (
        f"the model {model} contradicts the recording: its arms would accelerate by {said[1]} rad/s² (rms) where the "
        f"recorded ones do by {said[0]}, and the difference is {off[0]:.2g} times as large as the larger"
    )
    best = int(np.argmin(off))
    if _AGREES * off[best] < off[0]:
        as_read = ", ".join(str(arm + 1) for arm in orders[best])
        return f"{text}; with the angles in the order {as_read} it is {off[best]:.2g}: are columns exchanged?"
    return f"{text}; check columns, signs and zeros, or give the model of these arms"


def _encoder_steps(angles: Array) -> Array:
    """Return the smallest change of each angle (n,) from one sample to the next, zero where there is none."""
    changes = np.abs(np.diff(angles, axis=0))
    smallest = np.min(changes, axis=0, where=changes > 1e-12, initial=np.inf)
    return np.where(np.isfinite(smallest), smallest, 0.0)


def _rms(values: Array) -> Array:
    return np.sqrt(np.mean(np.square(values), axis=0))


def _accelerations(recording: Recording, arms: ArmChainParameters, order: tuple[int, ...]) -> tuple[Array, Array]:
    """Return what is measured and predicted (K, n), rad/s², with the angles taken in an order; K may be zero."""
    equations = equations_of(arms, Level.CART)
    rate, n = equations.function(), arms.count
    stride = max(round(_WINDOW / recording.dt), 1)
    step = stride * recording.dt
    measured, predicted = [np.zeros((0, n))], [np.zeros((0, n))]
    for part in recording.split():
        if len(part.time) < 4 * stride:
            continue
        cart, angles = cart_motion(part), part.angles[:, order]
        before, here, after = angles[: -2 * stride], angles[stride:-stride], angles[2 * stride :]
        every = slice(None, None, max(stride // 2, 1))
        states = np.hstack([here, (after - before) / (2 * step), np.zeros((len(here), 2))])
        driven = np.zeros(len(here))
        if cart is not None:
            states[:, -1] = cart.velocity[stride:-stride]
            driven = np.convolve(cart.acceleration, np.ones(2 * stride + 1) / (2 * stride + 1), mode="valid")
        found = np.asarray(rate(states[every].T, driven[every][None], arms.base()), dtype=float).T
        predicted.append(found[:, n : 2 * n])
        measured.append(((after - 2 * here + before) / step**2)[every])
    together = np.concatenate(measured), np.concatenate(predicted)
    known = np.isfinite(np.hstack(together)).all(axis=1)
    return together[0][known], together[1][known]
