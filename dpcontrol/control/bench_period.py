"""Sensors and drive of a simulated bench between two ticks, as expressions.

Their arithmetic is that of `dpcontrol.loop.simulated.Encoders` and of `DriveLimits`, which the bench uses as well.
"""

from collections import namedtuple
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca

from dpcontrol.dynamics.compiled import Compiled

_WHOLE = 1.5 * 2**52
"""A number whose sum with smaller ones is rounded to whole numbers, half to even."""


Clip = Callable[[Any, Any, Any], Any]
"""Function of a value and its bounds."""


@dataclass(frozen=True)
class DriveLimits:
    """Bounds of the drive on demands.

    Demands are floats, arrays (S,) or expressions, each with a `clip` of its own.

    acceleration m/s², velocity m/s, jerk_step m/s² per period (inf for none), response.
    """

    acceleration: Any
    velocity: Any
    jerk_step: Any
    response: Any
    clip: Clip

    def demanded(self, command: Any, noise: Any, last: Any) -> Any:
        """Return the demand on the drive that results from a command, m/s², within the limits of acceleration and jerk.

        Args:
            command: commanded acceleration, m/s², a number or (S,).
            noise: noise on the command, m/s², a number or (S,).
            last: demand of the last period, m/s², a number or (S,).
        """
        unlimited = self.clip(self.response * command + noise, -self.acceleration, self.acceleration)
        return self.clip(unlimited, last - self.jerk_step, last + self.jerk_step)

    def acting(self, demanded: Any, velocity: Any, duration: Any) -> Any:
        """Return the acceleration that keeps the velocity reference in bounds, m/s².

        After a knock out of these bounds, the reference returns as fast as the drive can.

        Args:
            demanded: demanded acceleration, m/s², a number or (S,).
            velocity: present velocity reference, m/s, a number or (S,).
            duration: time for which the acceleration acts, s.
        """
        low, high = (-self.velocity - velocity) / duration, (self.velocity - velocity) / duration
        return self.clip(self.clip(demanded, low, high), -self.acceleration, self.acceleration)

    def braking(self, velocity: Any, duration: Any) -> Any:
        """Return the acceleration towards standstill, as fast as the drive can.

        Args:
            velocity: present velocity reference, m/s, a number or (S,).
            duration: time for which the acceleration acts, s.
        """
        return self.clip(-velocity / duration, -self.acceleration, self.acceleration)


DriveNumbers = namedtuple(
    "DriveNumbers", "acceleration velocity jerk_step response lag period up down", defaults=(_WHOLE, _WHOLE)
)
"""Constants of drive and clock: limits, response, lag, s, period, s, and two numbers that round to whole ones."""


@dataclass(frozen=True)
class PeriodKind:
    """A period of a bench as one expression, with the arithmetic of `Encoders` and `DriveLimits`.

    Attributes:
        step: the plant's step.
        size: length of its state.
        demands: number of demands on their way.
        lags: True for a drive with a lag.
        counted: True for each of the positions (n+1,) that is rounded to counts.
        reads: places in the state that replace those of measured positions, with the positions.
        cart, motor: places of the cart and of the motor in the state.
    """

    step: Compiled
    size: int
    demands: int
    lags: bool
    counted: tuple[bool, ...]
    reads: tuple[tuple[int, int], ...]
    cart: int
    motor: int

    def measured(self, state: ca.SX, zeros: ca.SX, noise: ca.SX, steps: ca.SX, drive: DriveNumbers) -> list[ca.SX]:
        """Return the readings (n+1,) of a state, rad and m: absolute angles of the arms and the cart's position.

        Each encoder measures the angle between two arms, so errors of the inner arms shift the outer ones' angles as
        well.

        `zeros` (n,) rad, `noise` (n+1,) rad and m: errors of the encoders. `steps` (n+1,): sizes of their counts.
        """
        n, reads = len(self.counted) - 1, dict(self.reads)
        values = [state[reads[k]] if k in reads else state[k] - (state[k - 1] if k else 0) for k in range(n)]
        values = [value + zeros[k] for k, value in enumerate(values)] + [state[reads.get(n, self.cart)]]
        for k, counted in enumerate(self.counted):
            values[k] += noise[k]
            if counted:
                # The two large numbers round to whole counts, see `_WHOLE`.
                values[k] = steps[k] * (values[k] / steps[k] + drive.up - drive.down)
        for k in range(1, n):
            values[k] += values[k - 1]
        return values


@lru_cache(maxsize=32)
def sensors_and_drive(kind: PeriodKind, lanes: int) -> tuple[ca.Function, ca.Function]:
    """Return the functions of sensors and drive of a simulated bench, which run between two steps of its plant.

    (state, zeros, noise, steps, drive, present, last) -> reading

    (command, command_noise, demands, state, drive) -> demands, acceleration

    zeros (n,), noise (n+1,), steps (n+1,): see `PeriodKind.measured`. drive: `DriveNumbers`. present, last: 1 for each
    position that is read, and the last reading, which replaces a missing one. command m/s²: from the loop.
    command_noise m/s²: error of the drive. demands m/s²: commands on their way, oldest first. acceleration m/s²: of the
    drive in the coming period.

    state, present, last, command, reading and acceleration are parts of the machine code's rows. They have all lanes,
    of which the first is used.

    Args:
        kind: kind of the bench's period.
        lanes: lanes of the rows.
    """
    n, rounds = len(kind.counted) - 1, len(DriveNumbers._fields)

    def symbols(**lengths: int) -> dict[str, ca.SX]:
        """Return symbols by name with these lengths."""
        return {name: ca.SX.sym(name, length) for name, length in lengths.items()}

    def spread(values: Sequence[ca.SX]) -> ca.SX:
        """Return each value once for every lane, as the machine code's rows need it."""
        return ca.vertcat(*(value for value in values for _ in range(lanes)))

    size, position_rows = kind.size * lanes, (n + 1) * lanes
    sensor_inputs = symbols(
        state=size, zeros=n, noise=n + 1, steps=n + 1, drive=rounds, present=position_rows, last=position_rows
    )
    drive = DriveNumbers(*ca.vertsplit(sensor_inputs["drive"]))
    measured = kind.measured(
        sensor_inputs["state"][::lanes], sensor_inputs["zeros"], sensor_inputs["noise"], sensor_inputs["steps"], drive
    )
    readings = [
        ca.if_else(sensor_inputs["present"][i * lanes], measured[i], sensor_inputs["last"][i * lanes])
        for i in range(n + 1)
    ]
    sensors = ca.Function("sensors", [*sensor_inputs.values()], [spread(readings)])
    drive_inputs = symbols(command=lanes, command_noise=1, demands=kind.demands, state=size, drive=rounds)
    drive = DriveNumbers(*ca.vertsplit(drive_inputs["drive"]))
    limits, state = (
        DriveLimits(*drive[:4], clip=lambda value, low, high: ca.fmax(ca.fmin(value, high), low)),
        drive_inputs["state"][::lanes],
    )
    demand = limits.demanded(drive_inputs["command"][0], drive_inputs["command_noise"], drive_inputs["demands"][-1])
    demands = ca.vertcat(drive_inputs["demands"][1:], demand)
    velocity = state[kind.motor + 1] + (drive.lag * state[kind.cart + 2] if kind.lags else 0)
    acting = limits.acting(demands[1], velocity, drive.period)
    return sensors, ca.Function("drive", [*drive_inputs.values()], [demands, spread([acting])])
