# %% [markdown]
# # Two poles swung up by a force
# A public task in MuJoCo: 10 N move a cart with two poles of 1 m, and each step rewards poles that are up and slow, a
# cart in the middle, and a small force. The model is the task's own MJCF. Its equations with `model.force`'s formula
# take forces, so a program of IPOPT plans the motion of the largest reward within 10 N. A regulator for held
# forces follows it and then holds the poles. It needs `pip install 'dpcontrol[mujoco]'`.

# %%
import sys
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import casadi as casadi_package
import mujoco as mujoco_package
import numpy as np
from matplotlib.figure import Figure
from scipy import linalg as scipy_linalg

import dpcontrol as dp
from dpcontrol.dynamics.chain import Level, equations_of

ca: Any = casadi_package
mujoco: Any = mujoco_package
linalg: Any = scipy_linalg
Array = np.ndarray[Any, np.dtype[Any]]
POLE = """<joint name="hinge_{0}" axis="0 1 0" damping="2e-6"/>
<geom type="capsule" fromto="0 0 0 0 0 1" size="0.045" mass="0.1"/>"""
TASK = f"""<mujoco model="two-poles">
<option timestep="0.01" integrator="RK4"><flag contact="disable"/></option>
<worldbody><body name="cart" pos="0 0 1">
<joint name="slider" type="slide" axis="1 0 0" limited="true" range="-1.8 1.8" damping="5e-4"/>
<geom type="box" size="0.2 0.15 0.1" mass="1"/>
<body name="pole_1">{POLE.format(1)}<body name="pole_2" pos="0 0 1">{POLE.format(2)}</body></body>
</body></worldbody>
<actuator><motor joint="slider" gear="10" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>"""
CART_MASS, CART_VISCOUS, FORCE, TRACK = 1.0, 5e-4, 10.0, 1.7
"""Cart (kg, N s/m), the greatest force (N), and the part of the track that is used (m)."""
STEP, HELD, INTERVALS, STEPS = 0.01, 4, 97, 1000
"""Step of the task (s), steps of one planned force, planned forces, and steps of an episode."""
UP = np.array([np.pi, -np.pi, 0.0, 0.0, 0.0, 0.0])
"""The end of the transfer: the outer pole turns the other way."""
ERRORS, EFFORT = np.array([100.0, 100.0, 10.0, 10.0, 10.0, 10.0]), 0.1
"""Weights of squared errors and forces of the regulators."""
_TENTH = -np.log(0.1)


@cache
def motion() -> tuple[Any, Any]:
    """Return the state after a step with a held force, and its slopes by state and force, as casadi functions."""
    file = Path("two-poles.xml")
    file.write_text(TASK, encoding="utf-8")
    with warnings.catch_warnings():
        # The differences of model and robot are the friction of the slider and its mass, which are used here.
        warnings.simplefilter("ignore")
        arms = dp.load_model(file).arms
    accelerated: Any = equations_of(arms, Level.CART).function()
    base, coupling = arms.base(), arms.torques / arms.gravity
    x, force, h = ca.SX.sym("x", 6), ca.SX.sym("F"), ca.SX.sym("h")

    def needed(acceleration: float) -> Any:
        rates: Any = accelerated(x, acceleration, base)
        pushes: Any = coupling * (ca.cos(x[:2]) * rates[2:4] - ca.sin(x[:2]) * x[2:4] ** 2)
        return (CART_MASS + sum(arms.mass)) * acceleration + ca.sum1(pushes) + CART_VISCOUS * x[5]

    none, one = needed(0.0), needed(1.0)
    rate = ca.Function("rate", [x, force], [accelerated(x, (force - none) / (one - none), base)])
    k1 = rate(x, force)
    k2 = rate(x + h / 2 * k1, force)
    k3 = rate(x + h / 2 * k2, force)
    after = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3, force))
    slopes = [ca.jacobian(after, x), ca.jacobian(after, force)]
    return ca.Function("after", [x, force, h], [after]), ca.Function("slopes", [x, force, h], slopes)


def rewards(x: Any, force: Any) -> Any:
    """Return the rewards of states (6, K) and forces (1, K), with a product in place of the lesser of two rates."""
    slow = ca.exp(-_TENTH * (x[2, :] ** 2 + (x[3, :] - x[2, :]) ** 2) / 25)
    upright, middle = (2 - ca.cos(x[0, :]) - ca.cos(x[1, :])) / 4, ca.exp(-_TENTH * x[4, :] ** 2 / 4)
    return upright * (1 + slow) / 2 * (1 + middle) / 2 * (5 - (force / FORCE) ** 2) / 5


# %%
class TransferPlanner:
    """Transfers from near rest to upright poles with the largest sum of rewards."""

    def __init__(self) -> None:
        after, _ = motion()
        self.program = ca.Opti()
        self.x, self.force = self.program.variable(6, INTERVALS + 1), self.program.variable(1, INTERVALS)
        self.first = self.program.parameter(6)
        half, before = HELD * STEP / 2, self.x[:, :-1]
        following = after.map(INTERVALS)(after.map(INTERVALS)(before, self.force, half), self.force, half)
        self.program.subject_to(self.x[:, 1:] == following)
        self.program.subject_to(self.x[:, 0] == self.first)
        self.program.subject_to(self.x[:, INTERVALS] == UP)
        self.program.subject_to(self.program.bounded(-FORCE, self.force, FORCE))
        self.program.subject_to(self.program.bounded(-TRACK, self.x[4, :], TRACK))
        changes = ca.sumsqr(self.force[0, 1:] - self.force[0, :-1])
        self.program.minimize(1e-5 * changes - HELD * STEP * ca.sum2(rewards(before, self.force)))
        options = {"print_level": 0, "max_iter": 200, "sb": "yes"}
        self.program.solver("ipopt", {"expand": True, "print_time": False}, options)

    def plan(self, first: Array, states: Array, forces: Array) -> tuple[float, Array, Array] | None:
        """Return cost, states (6, N+1) and forces (N,) of the transfer near a guess, or None.

        Args:
            first: first state (6,).
            states: guess of the states (6, N+1).
            forces: guess of the forces (N,).
        """
        self.program.set_value(self.first, first)
        self.program.set_initial(self.x, states)
        self.program.set_initial(self.force, forces)
        try:
            found = self.program.solve()
        except RuntimeError:
            return None
        return float(found.value(self.program.f)), np.array(found.value(self.x)), np.array(found.value(self.force))

    def near(self, first: Array, nominal: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return states and forces of the transfer from a state near rest.

        If it is not found from the one from rest, the first state moves there in smaller and smaller parts.

        Args:
            first: first state (6,).
            nominal: states and forces of the transfer from rest.
        """
        for parts in (1, 4, 16):
            guess: tuple[Array, Array] | None = nominal
            for share in np.arange(1, parts + 1) / parts:
                found = None if guess is None else self.plan(share * first, *guess)
                guess = None if found is None else found[1:]
            if guess is not None:
                return guess
        return nominal

    def best(self, tries: int) -> tuple[Array, Array]:
        """Return states and forces of the best transfer from rest, from random swings as guesses.

        Args:
            tries: number of guesses.
        """
        random, times, found = np.random.default_rng(0), np.linspace(0, 1, INTERVALS + 1), list[Any]()
        after, _ = motion()
        for _ in range(tries):
            swings, phase, state = random.uniform(1, 4), random.uniform(0, 2 * np.pi), np.zeros(6)
            forces = 0.7 * FORCE * np.sign(np.sin(2 * np.pi * swings * times[:-1] + phase))
            states = [state]
            for force in forces:
                state = np.array(after(state, force, HELD * STEP)).ravel()
                states.append(state)
            guess = np.array(states).T * (1 - times**3) + UP[:, None] * times**3
            found.append(self.plan(np.zeros(6), guess, forces))
        _, states, forces = min((one for one in found if one is not None), key=lambda one: one[0])
        return states, forces


# %%
def regulator(states: Array, forces: Array) -> Array:
    """Return the gains (K, 6) of the regulator along states (K, 6) and forces (K,), which ends upright."""
    _, slopes = motion()
    a, b = (np.array(one) for one in slopes(UP, 0.0, STEP))
    weight = np.diag(ERRORS)
    p: Array = linalg.solve_discrete_are(a, b, weight, np.array([[EFFORT]]))
    gains = np.empty((len(forces), 6))
    for k in reversed(range(len(forces))):
        a, b = (np.array(one) for one in slopes(states[k], forces[k], STEP))
        gains[k] = np.linalg.solve(EFFORT + b.T @ p @ b, b.T @ p @ a)[0]
        p = weight + a.T @ p @ (a - b @ gains[k : k + 1])
    return gains


def reward(data: Any) -> float:
    """Return the task's reward of a step."""
    cosines, rates, control = data.xmat[2:, 8], data.qvel[1:], float(data.ctrl[0])
    middle = np.exp(-_TENTH * data.qpos[0] ** 2 / 4)
    slow = np.exp(-_TENTH * np.square(rates) / 25).min()
    return float(((1 + cosines) / 2).mean() * (1 + middle) / 2 * (5 - min(control**2, 1.0)) / 5 * (1 + slow) / 2)


def episode(planner: TransferPlanner, nominal: tuple[Array, Array], seed: int) -> tuple[Array, Array]:
    """Return the rewards (1000,) of an episode and the cosines (1000, 2) of the poles.

    The transfer from the random first state is planned near the one from rest.

    Args:
        planner: planner of transfers.
        nominal: states and forces of the transfer from rest.
        seed: seed of the first state.
    """
    random, after = np.random.default_rng(seed), motion()[0]
    model = mujoco.MjModel.from_xml_string(TASK)
    data = mujoco.MjData(model)
    data.qpos[:] = np.array([0.0, np.pi, 0.0]) + np.array([0.01, 0.01, 0.1]) * random.standard_normal(3)
    data.qvel[:] = 0.01 * random.standard_normal(3)

    def state() -> Array:
        # The model's angles, as `dpcontrol model two-poles.xml` lists them: angle_1 = π - hinge_1.
        angles = np.pi - np.cumsum(data.qpos[1:])
        return np.concatenate([angles, -np.cumsum(data.qvel[1:]), [data.qpos[0], data.qvel[0]]])

    nodes, held = planner.near(state(), nominal)
    forces, path = np.repeat(held, HELD), list[Array]()
    for k, force in enumerate(forces):
        # Each interval begins at the planned state, because errors of an unstable motion grow.
        path.append(np.array(after(path[-1], force, STEP)).ravel() if k % HELD else nodes[:, k // HELD])
    gains, given, cosines = regulator(np.array(path), forces), np.empty(STEPS), np.empty((STEPS, 2))
    for k in range(STEPS):
        flown = k < len(forces)
        wanted, forward = (path[k], forces[k]) if flown else (UP, 0.0)
        data.ctrl[0] = np.clip((forward - gains[min(k, len(forces) - 1)] @ (state() - wanted)) / FORCE, -1, 1)
        mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        given[k], cosines[k] = reward(data), data.xmat[2:, 8]
    return given, cosines


# %%
if __name__ == "__main__":
    planner = TransferPlanner()
    nominal = planner.best(12)
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for seed in range(int(sys.argv[1]) if sys.argv[1:] and sys.argv[1].isdigit() else 3):
        given, cosines = episode(planner, nominal, seed)
        print(f"seed {seed}: return {given.sum():.1f}, held {bool((cosines[-300:] > 0.99).all())}")
        axes.plot(STEP * np.arange(STEPS), np.cumsum(given))
    axes.set(xlabel="time (s)", ylabel="return", title="Two poles swung up by 10 N")
    figure.savefig("two-poles.png", dpi=110)
