"""Hill's problem, the restricted three-body problem near a small primary.

    L = ½ (ẋ² + ẏ²) + x ẏ - y ẋ + 3/2 x² + 1/r

in the rotating frame, without parameters. L1 and L2 are at x = ∓3^(-1/3). The kinetic energy has terms linear in
velocity, so the motion is reversed by y -> -y together with time.

Source: Szebehely, Theory of Orbits (1967), section 10.4.
"""

import casadi as ca

import dpcontrol as dp


def lagrangian(q, v, _):
    (x, y), (vx, vy) = q, v
    return (vx**2 + vy**2) / 2 + x * vy - y * vx + 1.5 * x**2 + 1 / ca.sqrt(x**2 + y**2)


def hill():
    return dp.System.from_lagrangian(
        "hill",
        lagrangian,
        coordinates=("x", "y"),
        equilibria={"L1": (-0.7, 0.0), "L2": (0.7, 0.0)},
        sections={
            "left": dp.Section.plane("y = 0, x < 0", (0, 1)).where((-1, 0)),
            "middle": dp.Section.plane("x = 0", (1, 0)),
            "right": dp.Section.plane("y = 0, x > 0", (0, 1)).where((1, 0)),
        },
        between={("L1", "L1"): "right", ("L1", "L2"): "middle", ("L2", "L1"): "middle", ("L2", "L2"): "left"},
        scale=0.2,
        flight_periods=4.0,
    )
