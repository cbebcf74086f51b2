"""Arms of a robot that is described in URDF or MJCF.

MuJoCo compiles the description. Its joints must form a chain of parallel hinges on a slider or a fixed base that moves
in one plane: with down along gravity in this plane, x along the slider, and y the axis of positive angles,

    θ_k = φ_k + Σ s_j (q_j - q_j0),  j <= k      φ_k: angle of arm k at q_0,  s_j = ±1: direction of hinge j about y

Arm k leads from its hinge to the next one, the last arm to its centre of mass. Bodies that are welded to an arm belong
to it. Its inertia about y is that of MuJoCo's inertia tensors, R diag(I) Rᵀ, with Steiner's term. The rotor inertia
of the first hinge belongs to arm 1, because its rate is absolute. The last arm, which only pictures show, is as long as
the uniform rod from its joint with the same inertia beyond the centre of mass, a + √(3 J/m).

Source: MuJoCo's documentation, chapter Computation, and its XML reference.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.parts import part

ENDINGS = (".urdf", ".xml")
"""Endings of robots' descriptions."""
_PARALLEL = 1e-3
"""Largest angle between axes that count as parallel, rad: the error of π/2 written as 1.57."""
_EXACT = 1e-7
"""Angle between axes that is mentioned, rad."""
_ASIDE = 0.1
"""Largest distance of a centre of mass from the line between joints, as a share of its length."""
_SLIDE, _HINGE = 2, 3
"""Types of joints, `mujoco.mjtJoint`."""
_COLUMNS: Sequence[str] = ("mass", "centre_of_mass", "length", "inertia", "viscous", "coulomb")
_CHAIN = "a model is a chain of one to eight parallel hinges on a slider or a fixed base"


@dataclass(frozen=True)
class Robot:
    """Arms of a robot, inner one first.

    Attributes:
        columns: parameters by name as in `ArmChainParameters`, each (n,).
        gravity: in the plane of motion, m/s².
        angles: angles (n,) at the joints' reference positions, rad.
        turns: 1 for each hinge that turns in the direction of positive angles, else -1.
        cart_mass: kg, 0 without a slider.
        differences: sentences on angles and cart, and on what the model leaves out or replaces.
    """

    columns: Mapping[str, Sequence[float]]
    gravity: float
    angles: Sequence[float]
    turns: Sequence[float]
    cart_mass: float
    differences: tuple[str, ...]


def load_robot(path: Path) -> Robot:
    """Return the arms of a robot that is described in URDF or MJCF.

    Args:
        path: file in URDF or MJCF.

    Raises:
        InputError: the file cannot be compiled, or its joints form no planar chain.
    """
    mujoco = part("mujoco")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise InputError(f"{path}: MuJoCo cannot compile it: {' '.join(str(error).split())}") from error
    pose = mujoco.MjData(model)
    # With all actuators at their limits, the force on the slider is the drive's largest.
    pose.ctrl[:] = model.actuator_ctrlrange[:, 1]
    model.opt.gravity *= not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    mujoco.mj_forward(model, pose)
    for applies, text in _flaws(model, pose):
        if applies:
            raise InputError(f"{path}: {text}; {_CHAIN}")
    *parameters, angles, turns, _ = _arms(model, pose).T.tolist()
    columns = dict(zip(_COLUMNS, parameters, strict=True))
    # A slider and a hinge of one body are a cart without mass.
    cart_bodies = (model.body_weldid == model.jnt_bodyid[0]) & (model.body_weldid != model.jnt_bodyid[_first(model)])
    cart_mass = float(model.body_mass[cart_bodies].sum() + model.dof_armature[: _first(model)].sum())
    gravity = float(np.linalg.norm(_plane(model, pose)[2]))
    return Robot(columns, gravity, angles, turns, cart_mass, tuple(_differences(model, pose, cart_mass)))


def _first(m: Any) -> int:
    """Return the number of the first hinge in MuJoCo's model `m`, which follows the slider, if there is one."""
    return int(m.njnt > 0 and m.jnt_type[0] == _SLIDE)


def _name(m: Any, joint: int) -> str:
    """Return the name of a joint of MuJoCo's model `m`, or its number if it has none."""
    return m.joint(joint).name or f"joint {joint + 1}"


def _flaws(m: Any, pose: Any) -> Iterator[tuple[bool, str]]:
    """Yield the properties that exclude a planar chain, each with True if the robot has it.

    The order is such that each check needs the ones before. `m` is MuJoCo's model and `pose` its state at the reference
    positions.
    """
    first = _first(m)
    for k in range(m.njnt):
        name, body = _name(m, k), m.jnt_bodyid[k]
        yield k >= first and m.jnt_type[k] != _HINGE, f"{name} is no hinge"
        yield k > 0 and m.dof_parentid[k] != k - 1, f"{name} does not follow {_name(m, max(k - 1, 0))}"
        yield k > first and body == m.jnt_bodyid[k - 1], f"{name} is the second hinge of a body"
        joint_torques = m.jnt_stiffness[k], *m.jnt_stiffnesspoly[k], *m.dof_dampingpoly[k], m.body_gravcomp[body]
        yield k >= first and any(joint_torques), f"{name} has a spring, nonlinear damping or compensated gravity"
    yield m.njnt == first, "there is no hinge"
    yield m.neq + m.ntendon + m.nflex > 0, "there are equality constraints, tendons or flexible bodies"
    _, _, gravity, tilt = _plane(m, pose)
    yield not gravity.any(), "there is no gravity across the hinges"
    yield (
        tilt > _PARALLEL,
        f"axes deviate by {tilt:.3g} rad: hinges must be parallel, and a slider level and across them",
    )
    for k, (_, along_line, length, *_, beside_line) in enumerate(_arms(m, pose), start=first):
        position = f"{along_line:.4g} m along and {beside_line:.4g} m beside the line to the next joint"
        yield (
            not (along_line > 0 and beside_line <= _ASIDE * length),
            f"the centre of mass of the arm at {_name(m, k)} is {position}",
        )


def _plane(m: Any, pose: Any) -> tuple[Array, Array, Array, float]:
    """Return the plane in which a robot moves, and the deviation of its axes from it.

    Args:
        m: MuJoCo's model.
        pose: its state at the reference positions.

    Returns:
        Directions x and y (3,), gravity in the plane of motion (3,), m/s², and the largest tilt of axes, rad.
    """
    first = _first(m)
    hinge = pose.xaxis[first]
    gravity = m.opt.gravity - (m.opt.gravity @ hinge) * hinge
    across = -hinge if first and np.cross(gravity, pose.xaxis[0]) @ hinge < 0 else hinge
    along = np.cross(across, gravity / max(np.linalg.norm(gravity), 1e-300))
    deviations = [np.cross(axis, along if k < first else across) for k, axis in enumerate(pose.xaxis)]
    return along, across, gravity, float(np.arcsin(min(np.linalg.norm(deviations, axis=1).max(), 1.0)))


def _arms(m: Any, pose: Any) -> Array:
    """Return the numbers of a robot's arms (n, 9), from MuJoCo's model `m` and its state `pose`.

    Mass, centre of mass, length, inertia, viscous and dry friction, angle from hanging, turn (1 if the hinge turns in
    the direction of positive angles, else -1), and the distance of the centre of mass from the line between joints, m.
    """
    along, across, gravity, _ = _plane(m, pose)
    plane, rows = np.stack([along, gravity / np.linalg.norm(gravity)]), list[list[Any]]()
    joints, first = pose.xanchor @ plane.T, _first(m)
    for k in range(first, m.njnt):
        bodies = np.flatnonzero(m.body_weldid == m.jnt_bodyid[k])
        masses, centres = m.body_mass[bodies], pose.xipos[bodies] @ plane.T
        centre, axes = masses @ centres / masses.sum(), pose.ximat[bodies].reshape(-1, 3, 3)
        inertia = np.sum((across @ axes) ** 2 * m.body_inertia[bodies]) + masses @ ((centres - centre) ** 2).sum(axis=1)
        inertia += m.dof_armature[k] * (k == first)
        offset, is_last = centre - joints[k], k + 1 == m.njnt
        line = offset if is_last else joints[k + 1] - joints[k]
        length = np.linalg.norm(line)
        line_x, line_down = line / max(length, 1e-300)
        along_line, beside_line = (
            line_x * offset[0] + line_down * offset[1],
            abs(line_x * offset[1] - line_down * offset[0]),
        )
        arm_length = along_line + np.sqrt(3 * inertia / masses.sum()) if is_last else length
        turn = np.sign(pose.xaxis[k] @ across)
        friction = m.dof_damping[k], m.dof_frictionloss[k]
        rows.append(
            [masses.sum(), along_line, arm_length, inertia, *friction, np.arctan2(line_x, line_down), turn, beside_line]
        )
    return np.array(rows)


def _differences(m: Any, pose: Any, cart: float) -> Iterator[str]:
    """Yield the sentences on a robot's joint angles and cart, and on what the model leaves out or replaces.

    Args:
        m: MuJoCo's model.
        pose: its state at the reference positions.
        cart: mass of the cart, kg, 0 without a slider.
    """
    arms, first = _arms(m, pose), _first(m)
    joint_offsets = np.diff(arms[:, 6], prepend=0.0) - arms[:, 7] * m.qpos0[first:]
    for k, offset in enumerate(np.angle(np.exp(1j * joint_offsets))):
        before = f"angle_{k} + " if k else ""
        yield f"angle_{k + 1} = {before}{offset:.12g} {'+' if arms[k, 7] > 0 else '-'} {_name(m, first + k)}"
    total_mass, hinges = cart + arms[:, 0].sum(), slice(first, None)
    force = abs(pose.qfrc_actuator[0]) if m.nu else m.jnt_actfrcrange[0].max()
    drive = f"{force:g} N, {force / total_mass:.3g} m/s² for {total_mass:.4g} kg in all"
    slider_friction = f"{m.dof_damping[0]:g} N s/m and {m.dof_frictionloss[0]:g} N"
    contacts = (m.geom_contype[:, None] & m.geom_conaffinity) * (m.geom_bodyid[:, None] != m.geom_bodyid)
    *_, gravity, tilt = _plane(m, pose)
    tilt = max(tilt, np.arccos(min(np.linalg.norm(gravity) / np.linalg.norm(m.opt.gravity), 1.0)))
    notes = {
        "there is no slider: runs need a cart that follows commanded accelerations": not first,
        f"the cart's mass of {cart:.9g} kg is no part of the model: give it as cart_mass": first,
        f"the cart moves from {m.jnt_range[0][0]:g} to {m.jnt_range[0][1]:g} m: set limits.position": first
        and m.jnt_limited[0],
        f"the cart's drive has {drive}: set limits.acceleration, see `dpcontrol guide drives`": first and force > 0,
        f"left out: friction of the slider, {slider_friction}": first and m.dof_damping[0] + m.dof_frictionloss[0] > 0,
        "left out: contacts": contacts.any() or m.npair > 0,
        "left out: drag of the medium": m.opt.density > 0 or m.opt.viscosity > 0,
        "left out: actuators other than the slider's": np.any(m.actuator_trnid[:, 0] >= first),
        "left out: limits of hinges": np.any(m.jnt_limited[hinges]),
        "left out: rotor inertia of outer hinges": np.any(m.dof_armature[first + 1 :]),
        "dry friction, which sticks in MuJoCo, is smooth below the rate of smoothing": np.any(arms[:, 5]),
        f"centres of mass, up to {arms[:, 8].max():.3g} m beside the lines between joints, are on them": np.any(
            arms[:, 8] > _EXACT * arms[:, 2]
        ),
        f"axes and gravity deviate by up to {tilt:.3g} rad from one level plane, in which the model moves": tilt
        > _EXACT,
    }
    yield from (text for text, applies in notes.items() if applies)
