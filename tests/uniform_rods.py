"""Double pendulums of two uniform rods, for tests of searches with other arms."""

from dpcontrol.dynamics.chain import ArmChainParameters, pendulum_system
from dpcontrol.dynamics.system import System


def uniform_rods(lengths: tuple[float, float], masses: tuple[float, float]) -> System:
    """Return two frictionless uniform rods with lengths in m and masses in kg."""
    arms = ArmChainParameters(
        mass=masses,
        centre_of_mass=(lengths[0] / 2, lengths[1] / 2),
        length=lengths,
        inertia=(masses[0] * lengths[0] ** 2 / 12, masses[1] * lengths[1] ** 2 / 12),
        gravity=9.81,
        viscous=(0.0, 0.0),
    )
    return pendulum_system(f"rods {lengths} {masses}", arms)
