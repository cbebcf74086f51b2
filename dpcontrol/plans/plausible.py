"""Plausible values of benches.

Remarks report numbers of a rig that seem to be in another unit.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.units import Usual
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.references.problem import Limits

_ZEROS = Usual(0.0, 2 * math.pi, "rad")
_USUAL = {
    "limits": {
        "position": Usual(0.02, 5.0, "m"),
        "velocity": Usual(0.05, 20.0, "m/s"),
        "acceleration": Usual(0.05, 300.0, "m/s²"),
        "jerk": Usual(5.0, 1e6, "m/s³"),
    },
    "run": {
        "rate": Usual(20.0, 20_000.0, "Hz"),
        "initial_error": Usual(0.0, 1.0, "rad"),
        "travel": Usual(0.02, 5.0, "m"),
        "drive_lag": Usual(0.0, 0.2, "s"),
    },
    "sensors": {
        "counts": Usual(8.0, 2e7, ""),
        "cart_resolution": Usual(1e-9, 5e-3, "m"),
        "zero_error": Usual(0.0, 0.6, "rad"),
        "noise": Usual(0.0, 0.1, "rad"),
        "cart_noise": Usual(0.0, 0.02, "m"),
        "jitter": Usual(0.0, 0.1, "s"),
        "rate_noise": Usual(0.0, 20.0, "rad/s"),
        "stuck_at": Usual(0.0, 600.0, "s"),
        "stuck_for": Usual(0.0, 60.0, "s"),
        "zero_drift": Usual(0.0, 20.0, "rad/h"),
    },
    "drive": {
        "velocity": Usual(0.05, 20.0, "m/s"),
        "acceleration": Usual(0.05, 300.0, "m/s²"),
        "jerk": Usual(5.0, 1e6, "m/s³"),
        "delay": Usual(0.0, 100.0, "periods"),
        "lag": Usual(0.0, 0.2, "s"),
        "cart_mass": Usual(0.02, 200.0, "kg"),
        "cart_viscous": Usual(0.0, 1e4, "N s/m"),
        "command_noise": Usual(0.0, 100.0, "m/s²"),
        "response": Usual(0.05, 3.0, ""),
        "track": Usual(0.02, 5.0, "m"),
        "switch_margin": Usual(0.0, 0.5, "m"),
        "failed_at": Usual(0.0, 600.0, "s"),
    },
    "disturbances": {
        "push_impulse": Usual(0.0, 2.0, "N m s"),
        "knock_impulse": Usual(0.0, 2.0, "N m s"),
        "knock_velocity": Usual(0.0, 5.0, "m/s"),
        "knocks_per_minute": Usual(0.0, 600.0, "1/min"),
        "tilt": Usual(0.0, 0.4, "rad"),
    },
    "mechanics": {
        "belt": Usual(0.5, 1000.0, "Hz"),
        "known_belt": Usual(0.5, 1000.0, "Hz"),
        "play": Usual(0.0, 0.5, "rad"),
        "known_play": Usual(0.0, 0.5, "rad"),
        "cable_torque": Usual(0.0, 2.0, "N m"),
        "cable_stiffness": Usual(0.0, 5.0, "N m/rad"),
        "stiction": Usual(0.0, 1.0, "N m"),
        "initial_rate": Usual(0.0, 50.0, "rad/s"),
        "initial_cart": Usual(0.0, 5.0, "m"),
    },
    "supervisor": {
        "lost_tracking": Usual(0.05, 4 * math.pi, "rad"),
        "resynchronise": Usual(0.0, 4 * math.pi, "rad"),
        "missing": Usual(1e-3, 5.0, "s"),
    },
    "estimator": {
        "first_angle": Usual(0.0, 1.0, "rad"),
        "first_rate": Usual(0.0, 50.0, "rad/s"),
        "zero_error": Usual(0.0, 0.6, "rad"),
    },
    "blows": {
        "impulse": Usual(0.0, 2.0, "N m s"),
        "rate": Usual(0.0, 100.0, "rad/s"),
        "knock": Usual(0.0, 5.0, "m/s"),
        "time": Usual(0.0, 600.0, "s"),
    },
}
"""Usual ranges of the numbers of each part of a bench."""


def rig_oddities(
    limits: Limits, loop: LoopSettings, *, arms: int, zeros: Sequence[float] = ()
) -> Iterator[tuple[str, str, str]]:
    """Yield the table, the key and a sentence on each unusual number of a rig.

    Args:
        limits: the cart's limits.
        loop: settings of the run.
        arms: number n of arms.
        zeros: readings (n,) of the hanging arms, rad, or none.

    Raises:
        InputError: an impossible number.
    """
    sensor = loop.sensors.stuck_sensor
    if sensor > arms:
        raise InputError(
            f"[run] stuck_sensor = {sensor}: must be 0 to {arms}: 0 is the encoder of the inner arm, {arms} the cart's"
        )
    for number, blow in enumerate(loop.disturbances.explicit, start=1):
        if blow.arm >= arms:
            raise InputError(f"[[run.blows]] {number}, arm = {blow.arm}: must be 0 to {arms - 1}, 0 for the inner arm")
    for name in ("counts", "play", "known_play", "stiction"):
        try:
            (loop.sensors if name == "counts" else loop.mechanics).of_each(name, arms)
        except InputError as error:
            raise error.under("[run] ") from error
    parts: list[tuple[str, str, object]] = [("[limits]", "limits", limits), ("[run]", "run", loop)]
    parts += [("[run]", name, getattr(loop, name)) for name in ("sensors", "drive", "disturbances", "mechanics")]
    parts += [(f"[{name}]", name, getattr(loop, name)) for name in ("supervisor", "estimator")]
    parts += [("[[run.blows]]", "blows", blow) for blow in loop.disturbances.explicit]
    numbers = [
        (table, key, usual, getattr(one, key)) for table, name, one in parts for key, usual in _USUAL[name].items()
    ]
    for table, key, usual, value in (*numbers, ("[run]", "zeros", _ZEROS, zeros)):
        values = np.atleast_1d(np.array(value, dtype=float))
        try:
            for sentence in usual.oddities(key, values[np.isfinite(values)].tolist()):
                yield table, key, sentence
        except InputError as error:
            raise error.under(f"{table} ") from error
