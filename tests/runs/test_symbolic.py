"""Users' expressions: a law against the built-in one, and its C; plants against equations by hand."""

import itertools
import runpy
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dpcontrol as dp
from dpcontrol.dynamics.plant import PlantParameters
from dpcontrol.loop.simulated import SimulatedPlant
from dpcontrol.plans.itinerary import itinerary_from
from dpcontrol.plans.model import load_model
from dpcontrol.plans.plan import make_plan

SAME, BEGINNING = 1e-9, 300
"""rad, before an encoder's count flips: sums in another order. Ticks before that."""
SHORT_HOLD = """
model = "lab"
start = "hold"
hold = "up-up"
seconds = 4.0
controller = { kind = "lqr" }
run = { mismatch = 0.02, initial_error = 0.02 }
"""
PLAN = make_plan(itinerary_from(SHORT_HOLD, "short-hold", load_model("lab")))
HELD = dp.closed_loop(PLAN, estimator="ekf").assembly.controller


def same_gains() -> dp.SymbolicLaw:
    """Return the regulator that holds both arms upright, without what it feeds back of the estimator's extras."""
    gain = HELD.gain

    def own(state, reference, memory, parameters):
        return reference.feedforward + ca.dot(gain, reference.state - state), memory + 1.0

    return dp.SymbolicLaw(own, memory=1)


@pytest.mark.slow
def test_expressions_fly_as_the_same_law_in_python_does() -> None:
    gain = HELD.gain

    class Own:
        def control(self, time, state, reference):
            return reference.feedforward + gain @ (reference.state - state)

    made, python = (dp.closed_loop(PLAN, controller=law).run(seed=2) for law in (same_gains(), Own()))
    assert made.converged
    assert np.abs(made.log.states["truth"] - python.log.states["truth"])[:BEGINNING].max() < SAME
    assert made.log.events[0].text.startswith("own, ekf")


# Slow: C is made and compiled.
@pytest.mark.slow
@pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc")
def test_the_example_flies_counts_and_leaves_as_c_that_replays_its_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    made = runpy.run_module("dpcontrol.examples.integral_action", run_name="__main__")
    assert "16 of 16 runs completed" in capsys.readouterr().out
    assert (tmp_path / "integral-action.png").stat().st_size > 10_000
    alone, integral = (run.log.states["truth"][-500:, 4].mean() for run in made["runs"].values())
    # At rest the command is zero: K₁ b + K₂ b + K_x x = 0, both arms off by the tilt b.
    gain = made["gains"](1e-9)
    assert alone == pytest.approx(-made["TILT"] * gain[:2].sum() / gain[4], rel=0.1)
    assert abs(integral) < 0.02 * abs(alone)
    done = subprocess.run(
        ["make", "check", "CC=gcc"], cwd=tmp_path / "controller", capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "1e-09 allowed" in done.stderr


LAB = load_model("lab").arms
EXACT = 1e-9
"""rad: DOP853 at 1e-11 over half a second of motion."""
NAMES = {"air_drag": "AirDrag", "eddy_brake": "EddyBrake"}


def example(name: str, monkeypatch: pytest.MonkeyPatch) -> type[dp.SymbolicPlant]:
    """Return the class of an example, without its runs."""
    import dpcontrol.examples

    text = (Path(dpcontrol.examples.__file__).parent / f"{name}.py").read_text()
    space: dict = {"__name__": name}
    exec(text.split("# %%\n")[1], space)
    return space[NAMES[name]]


def moved(plant: dp.SymbolicPlant, state: np.ndarray, seconds: float) -> np.ndarray:
    """Return the state after so many seconds with the cart accelerated by 1 m/s²."""
    whole = PlantParameters(replace(LAB, viscous=(0.0, 0.0)), components=(plant,))
    moving = SimulatedPlant([whole], np.concatenate([state, whole.own_states(state)]), track=10.0)
    for k in range(round(1000 * seconds)):
        moving.move(1.0, 1e-3, time=1e-3 * k)
    return moving.state[:6].copy()


def by_hand(torques, state: np.ndarray, seconds: float, *, breaks: tuple[float, ...] = ()) -> np.ndarray:
    """Return the same by Lagrange's equations with torques (time, angles, rates, cart velocity) on the two arms."""
    m, a, long, j, g = LAB.mass, LAB.centre_of_mass, LAB.length, LAB.inertia, LAB.gravity
    s1, s2 = m[0] * a[0] + m[1] * long[0], m[1] * a[1]
    m11, m22, m12 = j[0] + m[0] * a[0] ** 2 + m[1] * long[0] ** 2, j[1] + m[1] * a[1] ** 2, m[1] * a[1] * long[0]

    def slope(time: float, y: np.ndarray) -> list[float]:
        (p, q, w, v), cart = y[:4], y[5]
        c, s = np.cos(p - q), np.sin(p - q)
        one, two = torques(time, y[:2], y[2:4], cart)
        force = [-m12 * s * v**2 - s1 * (g * np.sin(p) + np.cos(p)) + one,
                 m12 * s * w**2 - s2 * (g * np.sin(q) + np.cos(q)) + two]  # fmt: skip
        return [w, v, *np.linalg.solve([[m11, m12 * c], [m12 * c, m22]], force), cart, 1.0]

    times = [0.0, *breaks, seconds]
    for begin, end in itertools.pairwise(times):
        # The later piece begins after the switch.
        shift = 1e-12 if begin else 0.0
        made = solve_ivp(lambda t, y, d=shift: slope(t + d, y), (begin, end), state, "DOP853", rtol=1e-11, atol=1e-12)
        state = made.y[:, -1]
    return state


START = np.array([0.4, -0.9, 3.0, -5.0, 0.05, 0.3])


def test_air_drag_is_a_force_against_the_motion_of_each_arms_end(monkeypatch: pytest.MonkeyPatch) -> None:
    drag, length = (0.02, 0.01), LAB.length

    def torques(time: float, angles: np.ndarray, rates: np.ndarray, cart: float) -> tuple[float, float]:
        end, on = np.array([cart, 0.0]), np.zeros(2)
        arms = [np.array([np.cos(x), np.sin(x)]) * own for x, own in zip(angles, length, strict=True)]
        for k in range(2):
            end = end + arms[k] * rates[k]
            for i in range(k + 1):
                on[i] -= drag[k] * np.linalg.norm(end) * (end @ arms[i])
        return on[0], on[1]

    plant = example("air_drag", monkeypatch)(drag, length)
    assert np.abs(moved(plant, START, 0.5) - by_hand(torques, START, 0.5)).max() < EXACT


def test_the_brake_acts_from_its_time_on_to_the_microsecond(monkeypatch: pytest.MonkeyPatch) -> None:
    # Within a period, so that a step has to be split there.
    since = 0.2003
    plant = example("eddy_brake", monkeypatch)(0.05, since)
    expected = by_hand(lambda t, _, w, __: (-0.05 * w[0] * (t >= since), 0.0), START, 0.5, breaks=(since,))
    assert np.abs(moved(plant, START, 0.5) - expected).max() < 1e-7


@pytest.mark.slow
def test_a_plant_of_expressions_flies_in_lockstep_as_alone_and_keeps_its_arms(tmp_path: Path) -> None:
    file = tmp_path / "plants.py"
    file.write_text(
        "import dpcontrol as dp\nfrom dataclasses import dataclass\n\n@dataclass(frozen=True)\n"
        "class Spring(dp.SymbolicPlant):\n    stiffness: float = 1e-3\n\n    @classmethod\n"
        "    def sizes(cls, arms):\n        return dp.Sizes(parameters=1)\n\n    @classmethod\n"
        "    def terms(cls, frame):\n"
        "        return dp.Terms(lagrangian=-frame.parameters[0] * frame.joints[1] ** 2 / 2)\n"
    )
    loop = dp.closed_loop("outer-turn", plant=f"{file}:Spring", belt=40.0, stiction=1e-4)
    assert loop.assembly.lockstep
    alone = loop.run(seed=5)
    (batched,) = loop.assembly.batch([5])
    assert np.array_equal(batched.truth, alone.log.states["truth"][: len(batched.truth)])
    assert alone.plant is not None
    kinds = [type(one).__name__ for one in loop.assembly.draw().plant.components]
    assert kinds == ["Belt", "Stiction", "Spring"]
