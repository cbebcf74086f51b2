"""The pendulum as a URDF, and the poses of its links, for viewers of ROS 2 logs.

The plane of motion is x to the right and z up, seen along +y. A joint's coordinate is the arm's *absolute* angle
from hanging, counter-clockwise: at each elbow a link turns back by the inner arm's angle (a mimic joint with
multiplier -1), so that the next arm hangs at zero. Source: the URDF specification (joint, mimic, origin).
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

WORLD = "world"
_THICKNESS = 0.012
_INK = {
    "robot": {
        "track": "0.45 0.45 0.47 1",
        "cart": "0.20 0.22 0.26 1",
        "arm": "0.10 0.42 0.72 1",
        "tip": "0.90 0.45 0.10 1",
    },
    "ghost": dict.fromkeys(("track", "cart", "arm", "tip"), "0.6 0.6 0.6 0.35"),
}


def frames(arms: int, *, has_cart: bool, prefix: str = "") -> tuple[tuple[str, str], ...]:
    """Return (parent, child) of every frame that moves, in the order of `poses`, after `world` to the base."""
    names = ["base", *(["cart_link"] if has_cart else [])]
    for i in range(1, arms + 1):
        names += [f"arm_{i}_link", f"elbow_{i}_link"]
    chain = [WORLD, *(prefix + name for name in names[:-1])]
    return tuple(pairwise(chain))


def poses(states: NDArray[np.float64], *, arm_lengths: Sequence[float], has_cart: bool) -> NDArray[np.float64]:
    """Return the pose of each of `frames` in its parent.

    Args:
        states: (K, 2n+2), or (K, 2n) without a cart; rad, rad/s, m, m/s.
        arm_lengths: (n,), m.
        has_cart: whether the pivot is on a cart.

    Returns:
        (K, F, 7): x, y, z in m and the quaternion's x, y, z, w.
    """
    arms = len(arm_lengths)
    first = 1 + has_cart
    half = states[:, :arms] / 2
    sine, cosine = np.sin(half), np.cos(half)
    found = np.zeros((len(states), first + 2 * arms - 1, 7))
    found[:, :first, 6] = 1.0
    if has_cart:
        found[:, 1, 0] = states[:, 2 * arms]
    # Counter-clockwise with x right and z up is a turn about -y; arms and elbows alternate.
    found[:, first::2, 4], found[:, first::2, 6] = -sine, cosine
    found[:, first + 1 :: 2, 4], found[:, first + 1 :: 2, 6] = sine[:, :-1], cosine[:, :-1]
    found[:, first + 1 :: 2, 2] = -np.asarray(arm_lengths[:-1])
    return found


def robot_description(
    arm_lengths: Sequence[float],
    *,
    has_cart: bool = True,
    limits: tuple[float, float, float] | None = None,
    prefix: str = "",
    ghost: bool = False,
) -> str:
    """Return the URDF of the pendulum.

    Args:
        arm_lengths: (n,) in m, pivot to elbow, elbow to elbow, last elbow to tip.
        has_cart: whether the pivot is on a cart; then the base is a track.
        limits: the cart's greatest distance from the centre in m, velocity in m/s, acceleration in m/s².
        prefix: put before the name of every link and joint.
        ghost: draw it grey and half transparent, and without the track.
    """
    reach, speed = (limits[0], limits[1]) if limits else (max(sum(arm_lengths), 0.1), 3.0)
    ink = _INK["ghost" if ghost else "robot"]
    # The ghost swings just behind the robot; in one plane the two would flicker.
    depth = 1.5 * _THICKNESS if ghost else 0.0
    names = [
        (child.removeprefix(prefix), child) for _, child in frames(len(arm_lengths), has_cart=has_cart, prefix=prefix)
    ]
    lines = ['<?xml version="1.0"?>', f'<robot name="{"reference_" if ghost else ""}pendulum">']
    lines += [f'  <material name="{prefix}{part}"><color rgba="{colour}"/></material>' for part, colour in ink.items()]
    for name, link in names:
        lines.append(f'  <link name="{link}">')
        lines += _visuals(name, arm_lengths, depth=depth, reach=reach, prefix=prefix, track=has_cart and not ghost)
        lines.append("  </link>")
    lines += _joints(arm_lengths, has_cart=has_cart, prefix=prefix, reach=reach, speed=speed)
    return "\n".join([*lines, "</robot>"]) + "\n"


def _visuals(
    name: str, arm_lengths: Sequence[float], *, depth: float, reach: float, prefix: str, track: bool
) -> list[str]:
    def visual(shape: str, at: tuple[float, float, float], part: str, *, turn: str = "0 0 0") -> str:
        x, y, z = at
        return (
            f'    <visual><origin xyz="{x:g} {y + depth:g} {z:g}" rpy="{turn}"/><geometry>{shape}</geometry>'
            f'<material name="{prefix}{part}"/></visual>'
        )

    def box(x: float, y: float, z: float, at: tuple[float, float, float], part: str) -> str:
        return visual(f'<box size="{x:g} {y:g} {z:g}"/>', at, part)

    def disc(radius: float, at: tuple[float, float, float], part: str) -> str:
        shape = f'<cylinder radius="{radius:g}" length="{1.4 * _THICKNESS:g}"/>'
        return visual(shape, at, part, turn="1.5707963 0 0")

    wide = 0.06
    if name == "base" and track:
        stops = [box(_THICKNESS, wide, 0.03, (side * (reach + 0.05), 0.06, 0), "track") for side in (-1, 1)]
        return [box(2 * reach + 0.1, wide, 0.01, (0, 0.06, -0.02), "track"), *stops]
    if name == "cart_link":
        return [box(0.1, wide, 0.03, (0, 0.06, 0), "cart"), disc(0.6 * _THICKNESS, (0, 0.02, 0), "cart")]
    if name.startswith("arm_"):
        i = int(name.split("_")[1]) - 1
        length = arm_lengths[i]
        # Each arm swings in front of the last, as on the rig, and so is drawn whole.
        y = -1.6 * _THICKNESS * i
        return [
            box(1.6 * _THICKNESS, _THICKNESS, length, (0, y, -length / 2), "arm"),
            disc(1.3 * _THICKNESS, (0, y, 0), "cart"),
            disc(1.3 * _THICKNESS, (0, y, -length), "tip" if i == len(arm_lengths) - 1 else "cart"),
        ]
    return []


def _joints(arm_lengths: Sequence[float], *, has_cart: bool, prefix: str, reach: float, speed: float) -> list[str]:
    lines = []
    axis = '<axis xyz="0 -1 0"/>'
    for parent, child in frames(len(arm_lengths), has_cart=has_cart, prefix=prefix)[1:]:
        name = child.removeprefix(prefix).removesuffix("_link")
        ends = f'<parent link="{parent}"/><child link="{child}"/>'
        if name == "cart":
            body = f'<axis xyz="1 0 0"/><limit lower="{-reach:g}" upper="{reach:g}" velocity="{speed:g}" effort="0"/>'
            lines.append(f'  <joint name="{prefix}cart" type="prismatic">{ends}{body}</joint>')
        elif name.startswith("arm_"):
            lines.append(f'  <joint name="{prefix}{name}" type="continuous">{ends}{axis}</joint>')
        else:
            i = int(name.split("_")[1])
            origin = f'<origin xyz="0 0 {-arm_lengths[i - 1]:g}" rpy="0 0 0"/>'
            mimic = f'<mimic joint="{prefix}arm_{i}" multiplier="-1" offset="0"/>'
            lines.append(f'  <joint name="{prefix}{name}" type="continuous">{ends}{origin}{axis}{mimic}</joint>')
    return lines
