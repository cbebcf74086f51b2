"""Arms on their cart as a MuJoCo model in MJCF.

The cart slides along x, up is z, and hanging arms have zero angles. Joints turn about -y, so a positive angle moves an
arm's end to positive x. MuJoCo's joint angles are relative: θ_i - θ_{i-1}. The cart is driven by a velocity servo,
whose control is the velocity reference w of the drive:

    F = M/τ (w - ẋ)        M: mass of the cart, τ: time constant of the drive

Source: MuJoCo's XML reference, elements joint (damping, frictionloss), inertial and velocity.
"""

from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.errors import InputError

STEP = 5e-4
"""Time step of the simulation, s."""


def mjcf_text(arms: ArmChainParameters, *, name: str, cart_mass: float, lag: float) -> str:
    """Return arms on a cart as MJCF, the text of a model that MuJoCo simulates.

    Args:
        arms: parameters of the arms.
        name: name of the model.
        cart_mass: mass of the cart, kg.
        lag: time constant of the drive, s.

    Raises:
        InputError: a mass or lag that is not positive, or quadratic friction, which MuJoCo does not have.
    """
    for key, value in (("cart_mass", cart_mass), ("lag", lag)):
        if not 0 < value < 1e9:
            raise InputError(f"mjcf: {key} = {value!r}: must be above 0")
    if arms.quadratic:
        raise InputError("mjcf: quadratic friction has no counterpart in MuJoCo; remove it from the model's file")
    bodies, friction = "", arms.coulomb or (0.0,) * arms.count
    # The outer arms are bodies within the inner ones.
    for k in reversed(range(arms.count)):
        height, inertia = -arms.length[k - 1] if k else 0.0, f"{max(arms.inertia[k], 1e-12)!r}"
        bodies = f"""
<body name="arm_{k + 1}" pos="0 0 {height!r}">
<joint name="joint_{k + 1}" type="hinge" axis="0 -1 0" damping="{arms.viscous[k]!r}" frictionloss="{friction[k]!r}"/>
<inertial pos="0 0 {-arms.centre_of_mass[k]!r}" mass="{arms.mass[k]!r}" diaginertia="{inertia} {inertia} {inertia}"/>
<geom type="capsule" fromto="0 0 0 0 0 {-arms.length[k]!r}" size="0.006"/>{bodies}
</body>"""
    return f"""<mujoco model="{name}">
<compiler angle="radian" autolimits="true"/>
<option timestep="{STEP!r}" integrator="RK4" gravity="0 0 {-arms.gravity!r}"/>
<default><geom contype="0" conaffinity="0" density="0"/></default>
<worldbody>
<body name="cart">
<joint name="cart" type="slide" axis="1 0 0"/>
<inertial pos="0 0 0" mass="{cart_mass!r}" diaginertia="1 1 1"/>
<geom type="box" size="0.04 0.03 0.02"/>{bodies}
</body>
</worldbody>
<actuator><velocity name="drive" joint="cart" kv="{cart_mass / lag!r}"/></actuator>
</mujoco>
"""
