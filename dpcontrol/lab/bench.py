"""What stands between the model and the world: sensors, drive, disturbances; and the plant that they make of the arms.

Source: the rig's data sheets as read for its parameters: 40,000 counts per turn, 1 µm on the cart, 3 m/s.
"""

from dataclasses import dataclass, field

from dpcontrol.dynamics.drive_level import PlantParameters
from dpcontrol.dynamics.parameters import ArmChainParameters
from dpcontrol.lab.disturbances import DisturbanceSettings
from dpcontrol.lab.drive import DriveSettings
from dpcontrol.lab.sensors import SensorSettings


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
