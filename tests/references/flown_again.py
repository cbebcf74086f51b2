"""A reference's intervals flown again on their own input, by an accurate propagator."""

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import ArmChainParameters, Level, arm_chain_equations
from dpcontrol.dynamics.propagator import PolynomialInputPropagator
from dpcontrol.references.problem import state_scale
from dpcontrol.references.reference import Reference
from dpcontrol.references.trajectory import power_coefficients


def gaps(reference: Reference, arms: ArmChainParameters) -> NDArray[np.float64]:
    """Return the scaled distances (N-1, 6) of the intervals' ends from the next intervals' starts."""
    points, lengths = reference.method.points, np.diff(reference.mesh)
    propagator = PolynomialInputPropagator(
        arm_chain_equations(arms.count, Level.CART), arms.base(), degree=len(points) - 1
    )
    powers = power_coefficients(points, reference.inputs[..., 0]) / lengths[:, None] ** np.arange(len(points))
    starts = reference.states[:, 0]
    landed = [propagator.flow(*flight) for flight in zip(starts[:-1], powers[:-1], lengths[:-1], strict=True)]
    return np.abs(landed - starts[1:]) / state_scale(reference.states.shape[-1], reference.limits)
