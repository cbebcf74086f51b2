"""What stands between the model and the world: plant, encoders, drive.

    plant: ẋ = f(x, u; p) between ticks, u held; encoders: q round(s/q), relative joints, summed to absolute angles;
    drive: |u| ≤ a, |v + u Δt| ≤ v_max; travel: |x| ≤ x_max, or the run ends

Sources: the rig's data sheets as read for its parameters: 40,000 counts per turn, 1 µm on the cart, 3 m/s.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.drive_level import PlantParameters
from dpcontrol.dynamics.equations import Equations
from dpcontrol.dynamics.parameters import ArmChainParameters
from dpcontrol.dynamics.polynomial_input import PolynomialInputPropagator
from dpcontrol.lab.disturbances import DisturbanceSettings
from dpcontrol.lab.drive import DriveSettings
from dpcontrol.lab.sensors import Encoders, SensorSettings
from dpcontrol.references.problem import Limits

__all__ = ["BenchSettings", "Drive", "Encoders", "Plant", "SensorSettings"]

Array = NDArray[np.float64]


class Plant:
    """What is simulated: equations of the cart level with the plant's own parameters (p,), input held."""

    def __init__(self, equations: Equations, parameters: Array) -> None:
        self._propagator = PolynomialInputPropagator(equations, parameters, degree=0)

    def after(self, state: Array, acceleration: float, duration: float) -> Array:
        """Return the state (N,) after `duration` s of cart acceleration in m/s², to machine precision.

        Raises:
            ArithmeticError: the state became infinite or undefined.
        """
        return self._propagator.flow(state, acceleration, duration)


@dataclass(frozen=True)
class BenchSettings:
    """What stands between the model and the world."""

    sensors: SensorSettings = field(default_factory=SensorSettings)
    drive: DriveSettings = field(default_factory=DriveSettings)
    disturbances: DisturbanceSettings = field(default_factory=DisturbanceSettings)

    def plant(self, arms: ArmChainParameters) -> PlantParameters:
        """Return these arms on this drive and track.

        Raises:
            InputError: the drive or the tilt is impossible.
        """
        drive = self.drive
        return PlantParameters(
            arms, lag=drive.lag, cart_mass=drive.cart_mass, cart_viscous=drive.cart_viscous, tilt=self.disturbances.tilt
        )


@dataclass(frozen=True)
class Drive:
    """Gives the cart the commanded acceleration within its limits; period s of the loop."""

    limits: Limits
    period: float

    def applied(self, command: float, velocity: float) -> float:
        """Return the acceleration given to the cart at `velocity` m/s: clipped so that both limits hold."""
        most, fastest = self.limits.acceleration, self.limits.velocity
        clipped = min(max(command, -most), most)
        low, high = (-fastest - velocity) / self.period, (fastest - velocity) / self.period
        return min(max(clipped, low), high)

    def at_stop(self, position: float) -> bool:
        """Tell whether the cart has reached the end of its travel."""
        return abs(position) >= self.limits.position
