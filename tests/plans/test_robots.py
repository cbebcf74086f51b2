"""Models of robots in URDF and MJCF move as in MuJoCo, and what is no planar chain is refused in one sentence."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol
from scipy.integrate import solve_ivp

import dpcontrol as dp
from dpcontrol.dynamics.chain import Level, equations_of
from dpcontrol.foundation.errors import Remark
from dpcontrol.plans.robots import load_robot

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'dpcontrol[mujoco]'")

SAME = 1e-6
"""Error of the angles after one second, rad; fourth-order Runge-Kutta with 0.1 ms is nearer by three orders."""
STEP = 1e-4
"""Step of MuJoCo, s."""
POLE = '<geom type="capsule" fromto="0 0 0 0 0 {0}" size="0.04" mass="0.1" contype="0" conaffinity="0"/>'


def chain(count: int, *, slider: str = '<joint name="slider" type="slide" axis="1 0 0" damping="0.3"/>') -> str:
    """Return upright poles on a cart, as MJCF."""
    bodies = ""
    for k in reversed(range(count)):
        bodies = f"""<body pos="0 0 {0.7 if k else 0}"><joint name="hinge_{k + 1}" axis="0 1 0" damping="0.00{k + 1}"/>
        {POLE.format(0.7)}{bodies}</body>"""
    cart = f'<body>{slider}<geom type="box" size="0.2 0.15 0.1" mass="1" contype="0" conaffinity="0"/>{bodies}</body>'
    return f"""<mujoco><worldbody>{cart}</worldbody></mujoco>"""


TURNED = """
<mujoco><compiler angle="degree"/><option gravity="0 -9.7 0"/>
  <worldbody><body name="base" pos="1 2 3" quat="0.3 0.4 -0.2 0.8">
    <frame euler="0 0 0"><body name="inner" pos="0.1 0 0">
      <joint name="a" axis="{0}" pos="0.01 0.02 -0.03" damping="0.002" armature="0.001" ref="20"/>
      <geom type="box" pos="{1}" size="0.02 0.03 0.04" density="2000"/>
      <body name="weight" pos="{1}" euler="20 30 40">
        <geom type="ellipsoid" size="0.03 0.02 0.05" density="3000"/></body>
      <body name="outer" pos="{2}" quat="0.6 {3}">
        <joint name="b" axis="{4}" damping="0.001"/>
        <geom type="capsule" fromto="0.2 0.1 0.3 0.1 -0.2 0.1" size="0.02" density="900"/>
        <geom type="sphere" pos="0.1 0.1 0.1" size="0.05" density="500"/>
      </body></body></frame></body></worldbody></mujoco>"""
LINKS = """
<robot name="bench">
  <link name="rail"/>
  <link name="cart"><inertial><mass value="2"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="arm"><inertial><origin xyz="0 0 -0.25" rpy="0.3 0 0.4"/><mass value="0.2"/>
    <inertia ixx="0.0042" iyy="0.003" izz="0.002" ixy="1e-4" ixz="2e-4" iyz="0"/></inertial></link>
  <link name="clamp"><inertial><mass value="0.05"/>
    <inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tip"><inertial><origin xyz="0.02 0.1 -0.2"/><mass value="0.15"/>
    <inertia ixx="0.002" iyy="0.002" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="slider" type="prismatic"><parent link="rail"/><child link="cart"/><axis xyz="0 1 0"/>
    <limit lower="-0.5" upper="0.5" effort="60" velocity="3"/></joint>
  <joint name="first" type="continuous"><parent link="cart"/><child link="arm"/><axis xyz="-1 0 0"/></joint>
  <joint name="weld" type="fixed"><parent link="arm"/><child link="clamp"/><origin xyz="0 0 -0.4"/></joint>
  <joint name="second" type="revolute"><parent link="clamp"/><child link="tip"/><origin xyz="0.1 0 -0.1" rpy="0 0 0.7"/>
    <axis xyz="0.7648421872844885 -0.644217687237691 0"/><limit lower="-1" upper="1" effort="1" velocity="3"/>
    <dynamics damping="0.0005"/></joint>
</robot>"""


def across(vector: np.ndarray, axis: np.ndarray) -> np.ndarray:
    return vector - (vector @ axis) * axis


def turned() -> str:
    """Return two bodies on a fixed base whose hinges are parallel to an oblique axis, with a line of centres."""
    axis = np.array([0.36, 0.48, 0.8])
    hinge = np.array([0.01, 0.02, -0.03])
    line = across(np.array([0.2, -0.3, 0.4]), axis) / 2
    place, end = hinge + line + 0.1 * axis, hinge + 2 * line - 0.05 * axis
    rotation = np.zeros(4)
    mujoco.mju_axisAngle2Quat(rotation, np.array([0.0, 0.6, 0.8]), 1.0)
    rotation *= 0.6 / rotation[0]
    own, back = np.zeros(3), np.zeros(4)
    mujoco.mju_negQuat(back, rotation / np.linalg.norm(rotation))
    mujoco.mju_rotVecQuat(own, -axis, back)
    text = [" ".join(map(repr, map(float, one))) for one in (axis, place, end, rotation[1:], own)]
    return TURNED.format(*text)


def free_motion(file: Path, *, push: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the angles after one second in the model's angles, by MuJoCo and by the model with a force on the cart."""
    robot, model = load_robot(file), dp.load_model(file)
    m, count = mujoco.MjModel.from_xml_path(str(file)), model.arms.count
    m.opt.timestep, m.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
    m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    m.dof_frictionloss[:] = 0
    data, first = mujoco.MjData(m), m.njnt - count
    turns, placed = np.array(robot.turns), np.array(robot.angles)
    data.qpos[first:] += turns * np.linspace(0.4, -0.7, count)
    data.qvel[first:] = turns * np.linspace(2.0, -3.0, count)
    start = np.concatenate(
        [placed + np.cumsum(turns * (data.qpos - m.qpos0)[first:]), np.cumsum(turns * data.qvel[first:]), [0.0, 0.0]]
    )
    for _ in range(round(1 / STEP)):
        data.qfrc_applied[:first] = push
        mujoco.mj_step(m, data)
    arms = model.arms.viscous_only()
    equations, base = equations_of(arms, Level.CART).function(), arms.base()
    drag = float(m.dof_damping[0]) if first else 0.0

    def rate(_: float, state: np.ndarray) -> np.ndarray:
        acceleration = 0.0
        if first:
            none, one = (model.force(state, u, cart_mass=robot.cart_mass, cart_viscous=drag) for u in (0.0, 1.0))
            acceleration = (push - none) / (one - none)
        return np.array(equations(state, acceleration, base)).ravel()

    ours = solve_ivp(rate, (0, 1), start, "DOP853", rtol=1e-11, atol=1e-11).y[:count, -1]
    return placed + np.cumsum(turns * (data.qpos - m.qpos0)[first:]), ours


FIXED = '<geom size="0.01" mass="1" contype="0" conaffinity="0"/>'
ROBOTS: dict[str, tuple[str, Callable[[], str], float]] = {
    "one pole on a fixed base": ("one.xml", lambda: chain(1, slider=""), 0.0),
    "two poles with 10 N": ("two.xml", lambda: chain(2), 10.0),
    "three poles with 10 N": ("three.xml", lambda: chain(3), 10.0),
    "eight poles": ("eight.xml", lambda: chain(8), 0.0),
    "oblique axes and welded bodies": ("turned.xml", turned, 0.0),
    "links of a URDF with a fixed joint": ("bench.urdf", lambda: LINKS, 10.0),
}


@pytest.mark.filterwarnings("ignore::dpcontrol.foundation.errors.Remark")
@pytest.mark.parametrize("name", ROBOTS)
def test_the_model_of_a_robot_moves_as_in_mujoco(name: str, tmp_path: Path) -> None:
    file, text, push = ROBOTS[name]
    (tmp_path / file).write_text(text())
    theirs, ours = free_motion(tmp_path / file, push=push)
    assert np.abs(theirs - ours).max() < SAME


@pytest.mark.filterwarnings("ignore::dpcontrol.foundation.errors.Remark")
def test_the_double_pendulum_of_gymnasium_moves_as_in_mujoco() -> None:
    gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed: pip install 'dpcontrol[gym]'")
    file = Path(gymnasium.__file__).parent / "envs/mujoco/assets/inverted_double_pendulum.xml"
    theirs, ours = free_motion(file, push=0.0)
    # Its gravity is tilted by 1e-6 against the slider, which the model leaves out, as it says.
    assert np.abs(theirs - ours).max() < 10 * SAME


def edited(*changes: tuple[str, str], count: int = 2) -> str:
    text = chain(count)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return text


HINGE, SLIDE = '<joint name="hinge_2" axis="0 1 0"', 'type="slide" axis="1 0 0"'
REFUSED = {
    "a ball": edited((HINGE + ' damping="0.002"/>', '<joint name="hinge_2" type="ball"/>')),
    "a second chain": edited(("</worldbody>", f"<body><joint/>{FIXED}</body></worldbody>")),
    "a hinge before the slider": edited((SLIDE, 'type="hinge" axis="0 1 0"'), (HINGE, '<joint type="slide"')),
    "two hinges of one body": edited((HINGE, f'<joint axis="0 1 0" pos="0 0 0.3"/>{HINGE}')),
    "a skew hinge": edited((HINGE, '<joint axis="0 1 0.01"')),
    "a steep slider": edited((SLIDE, 'type="slide" axis="1 0 0.1"')),
    "a slider along the hinges": edited((SLIDE, 'type="slide" axis="0 1 0"')),
    "a spring": edited((HINGE, f'{HINGE} stiffness="0.1"')),
    "gravity along the hinges": edited(("<worldbody>", '<option gravity="0 9.81 0"/><worldbody>')),
    "no gravity": edited(("<worldbody>", '<option><flag gravity="disable"/></option><worldbody>')),
    "a tendon": edited(
        ("</worldbody>", '</worldbody><tendon><fixed><joint joint="hinge_1" coef="1"/></fixed></tendon>')
    ),
    "an eccentric arm": edited(('fromto="0 0 0 0 0 0.7"', 'fromto="0.2 0 0 0.2 0 0.7"')),
    "hinges at one place": edited(('<body pos="0 0 0.7">', '<body pos="0 0 0">')),
    "nine arms": chain(9),
    "no joint": f"<mujoco><worldbody><body>{FIXED}</body></worldbody></mujoco>",
    "a missing mesh": edited(("<worldbody>", '<asset><mesh file="no.stl"/></asset><worldbody>')),
    "no XML": "title = 3",
    "an unknown element": "<mujoco><wheel/></mujoco>",
    "nothing": "",
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_planar_chain_is_refused_in_one_sentence(name: str, tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    file.write_text(REFUSED[name])
    with pytest.raises(dp.InputError) as caught:
        dp.load_model(file)
    assert str(caught.value).startswith(str(file))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < len(str(file)) + 400


def test_what_the_model_leaves_out_is_listed(tmp_path: Path) -> None:
    listed = {
        "contacts": ("<worldbody>", '<worldbody><geom type="plane" size="1 1 1"/>'),
        "drag of the medium": ("<worldbody>", '<option density="1.2"/><worldbody>'),
        "friction of the slider, 0.3 N s/m and 0 N": (SLIDE, SLIDE),
        "actuators other than the slider's": (
            "</worldbody>",
            '</worldbody><actuator><motor joint="hinge_1"/></actuator>',
        ),
        "limits of hinges": (HINGE, f'{HINGE} limited="true" range="-1 1"'),
        "rotor inertia of outer hinges": (HINGE, f'{HINGE} armature="0.1"'),
    }
    for number, (name, change) in enumerate(listed.items()):
        text = edited(change)
        if name == "contacts":
            text = text.replace('contype="0" conaffinity="0"', "", 1)
        (file := tmp_path / f"robot-{number}.xml").write_text(text)
        with pytest.warns(Remark) as found:
            model = dp.load_model(file)
        assert {sentence for sentence in model.differences if sentence.startswith("left out")} == {
            f"left out: {part}" for part in {name, "friction of the slider, 0.3 N s/m and 0 N"}
        }
        (remark,) = (str(warning.message) for warning in found)
        assert f"in {len(model.differences)} points" in remark


def test_the_verb_writes_a_model_file_with_the_differences(tmp_path: Path) -> None:
    robot, file = tmp_path / "bench.urdf", tmp_path / "models" / "bench.toml"
    robot.write_text(LINKS)
    done = dpcontrol("model", str(robot), "--out", str(file))
    assert done.code == 0, done.stderr
    assert "60 N, 25 m/s² for 2.4 kg in all" in done.stdout
    text, arms = file.read_text(), dp.load_model(file).arms
    assert "# angle_1 = 0 - first\n# angle_2 = angle_1 + 0.42" in text
    assert arms.mass == pytest.approx((0.25, 0.15))
    # The clamp of 50 g sits 0.4 m from the hinge, and 0.1 m from the next one.
    assert arms.centre_of_mass[0] == pytest.approx((0.2 * 0.25 + 0.05 * 0.4) / 0.25)
    assert dpcontrol("model", str(robot), "--out", str(file)).code == 0
    file.write_text(f"{text}\n# my note")
    again = dpcontrol("model", str(robot), "--out", str(file))
    assert (again.code, "holds another model" in again.stderr) == (2, True)
    assert dpcontrol("model", str(robot), "--out", str(file), "--force").code == 0
    assert file.read_text() == text


def test_force_of_a_cart_without_moving_arms_is_mass_times_acceleration() -> None:
    # With level arms of points, the whole weight of the arms is accelerated.
    arms = dp.load_model("lab").arms
    still = dp.load_model("lab").force([np.pi / 2, np.pi / 2, 0, 0, 0, 0], 0.0, cart_mass=3.0)
    one = dp.load_model("lab").force([np.pi / 2, np.pi / 2, 0, 0, 0, 0], 1.0, cart_mass=3.0)
    assert one - still == pytest.approx(3.0 + sum(arms.mass))
    moving = dp.load_model("lab").force([0, 0, 0, 0, 0, 2.0], 0.0, cart_mass=3.0, cart_viscous=0.5)
    assert moving == pytest.approx(1.0)
