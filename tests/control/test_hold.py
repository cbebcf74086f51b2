from dataclasses import replace

import numpy as np
import pytest
from quick_rate import quick_rate
from scipy.integrate import solve_ivp
from scipy.linalg import solve_discrete_are
from shadowing_stand_in import LAB

from dpcontrol.control.interface import sampled_model
from dpcontrol.control.lqr import ExtraEffects, HoldController, HoldSettings, hold_controller
from dpcontrol.control.tracking import riccati_gains
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.loop.result import Ending
from dpcontrol.plans.itinerary import itinerary_from
from dpcontrol.plans.model import load_model
from dpcontrol.plans.plan import make_plan
from dpcontrol.references.problem import Limits
from dpcontrol.runs.run import run_plan

GAIN = 1e-6  # Relative, of two solvers of one Riccati equation.
MARGIN = 0.01  # Of two grids of frequencies.
HELD = 0.02  # rad: 5 % of mismatch and encoder counts leave less than a hundredth.
PERIOD = 1e-3
MODEL = sampled_model(LAB, 1 / PERIOD)
EQUILIBRIA = {"down-down": (0.0, 0.0), "down-up": (0.0, np.pi), "up-down": (np.pi, 0.0), "up-up": (np.pi, np.pi)}


def hold(name: str) -> HoldController:
    return hold_controller([*EQUILIBRIA[name], 0.0, 0.0], MODEL, HoldSettings(damping=0.0), seconds=60.0)


@pytest.mark.parametrize("name", ["down-down", "up-up"])
def test_the_gain_is_that_of_the_riccati_equation(name: str) -> None:
    model, controller = MODEL, hold(name)
    step = 1e-6 * np.eye(6)
    a = np.array([model.step(controller.state + d, 0.0) - model.step(controller.state - d, 0.0) for d in step]).T / 2e-6
    b = (model.step(controller.state, 1e-3) - model.step(controller.state, -1e-3)) / 2e-3
    weights, effort = HoldSettings().weights(2, PERIOD)
    cost = solve_discrete_are(a, b[:, None], np.diag(weights), np.array([[effort]]))
    expected = (b @ cost @ a) / (effort + b @ cost @ b)
    # The Jacobian by differences is good to 1e-9.
    assert controller.gain == pytest.approx(expected, rel=1e3 * GAIN, abs=1e-3)
    assert np.abs(np.linalg.eigvals(a - np.outer(b, controller.gain))).max() < 1


def test_assumed_damping_is_viscous_friction_that_grows_with_gravity_and_inertia() -> None:
    base = LAB.base()
    share, added = 0.1, 0.1 * np.sqrt([base[3] * base[0], base[4] * base[2]])
    rough = replace(LAB, viscous=tuple(float(k) for k in np.array(LAB.viscous) + added))
    settings, up = HoldSettings(damping=share), [np.pi, np.pi, 0.0, 0.0]
    assumed = hold_controller(up, MODEL, settings, seconds=1.0).gain
    expected = hold_controller(up, sampled_model(rough, 1 / PERIOD), replace(settings, damping=0.0), seconds=1.0).gain
    assert assumed == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("count", [2, 5])
def test_the_default_damping_leaves_arms_without_dry_friction_half_of_their_margin(count: int) -> None:
    """The margin min |1 + L| is that of the transfer function on a finer grid."""
    rods = ArmChainParameters(
        mass=(0.1,) * count, centre_of_mass=(0.25,) * count, length=(0.5,) * count, inertia=(0.1 / 48,) * count,
        gravity=9.81, viscous=(0.0,) * count,
    )  # fmt: skip
    model, up = sampled_model(rods, 1000.0), np.concatenate([np.full(count, np.pi), np.zeros(count + 2)])
    a, b = (one[0] for one in model.linearised(up[None], np.zeros(1)))
    shifted = np.exp(1j * np.geomspace(1e-4, np.pi, 2000))[:, None, None] * np.eye(len(b)) - a
    response = np.linalg.solve(shifted, b[:, None])[..., 0]

    def margin(damping: float | None) -> float:
        gain = hold_controller(up, model, HoldSettings(damping=damping), seconds=1.0).gain
        stable = np.abs(np.linalg.eigvals(a - np.outer(b, gain))).max() < 1
        return float(stable * np.abs(1 + response @ gain).min())

    assert margin(None) >= 0.5 * margin(0.0) - MARGIN
    if count == 2:
        assert margin(None) == margin(0.06)
    else:
        assert margin(0.03) == 0.0
        assert margin(0.0125) < 0.5 * margin(0.0)


def test_estimated_disturbances_are_compensated_at_the_cost_of_a_long_recursion() -> None:
    settings = HoldSettings()
    rough = sampled_model(replace(LAB, viscous=(0.004, 0.002)), 1 / PERIOD)
    effects = np.zeros((6, 2))
    effects[2:4] = PERIOD * np.eye(2)
    extras = ExtraEffects(("disturbance_1", "disturbance_2"), effects, np.array([0.99, 0.995]))
    up = np.array([np.pi, np.pi, 0.0, 0.0, 0.0, 0.0])
    found = hold_controller(up, rough, replace(settings, damping=0.0), seconds=1.0, extras=extras)
    a, b = rough.linearised(np.tile(up, (8000, 1)), np.zeros(8000))
    weights, effort = settings.weights(2, PERIOD)
    held = np.tile(effects, (8000, 1, 1)), extras.kept
    _, expected, _ = riccati_gains(a, b, weights=weights, effort=effort, terminal=np.diag(weights), extras=held)
    assert found.extra_gains == pytest.approx(expected[0], rel=1e-6)
    session, extra = found.join(0, up), np.array([0.5, -2.0])
    assert session.command(0, up, extra).feedback == pytest.approx(-float(expected[0] @ extra), rel=1e-6)
    assert hold_controller(up, MODEL, settings, seconds=1.0).extra_gains is None


@pytest.mark.parametrize("name", EQUILIBRIA)
def test_each_equilibrium_is_held_by_encoders_with_other_parameters(name: str) -> None:
    text = f'hold = "{name}"\nstart = "hold"\nseconds = 6.0\ncontroller = {{ kind = "lqr", damping = 0.0 }}'
    plan = make_plan(itinerary_from(text, name, load_model("lab")).with_run({"mismatch": 0.05, "initial_error": 0.03}))
    run = run_plan(plan)
    truth = run.log.states["truth"]
    assert run.log.metadata["ending"] == Ending.FINISHED.value
    assert np.abs(truth[-1000:, :2] - EQUILIBRIA[name]).max() < HELD
    assert np.abs(truth[:, 4]).max() < 0.2


@pytest.mark.slow
@pytest.mark.parametrize(("kick", "caught"), [(2.02, True), (2.06, False)])
def test_a_kick_is_caught_within_the_track_up_to_where_the_cart_meets_its_stop(kick: float, caught: bool) -> None:
    # rad/s of the outer arm at Up-Up: the border lies at 2.041, by bisection of the same loop in lockstep.
    controller, limits = hold("up-up"), Limits()
    rate = quick_rate(MODEL.equations)
    state, farthest = controller.state + np.array([0, 0, 0, kick, 0, 0]), 0.0
    for _ in range(3000):
        u = float(np.clip(controller.gain @ (controller.state - state), -limits.acceleration, limits.acceleration))
        right = lambda _, x, u=u: np.array(rate(x, u, MODEL.parameters)).ravel()  # noqa: E731
        state = solve_ivp(right, (0, PERIOD), state, rtol=1e-6, atol=1e-8).y[:, -1]
        farthest = max(farthest, abs(state[4]))
        if farthest >= limits.position:
            break
    assert (farthest < limits.position) == caught
    assert not caught or np.abs(state[:2] - controller.state[:2]).max() < 0.1


@pytest.mark.parametrize(("name", "margin"), [("down-up", 35), ("up-up", 25)])
def test_an_unmodelled_delay_is_tolerated_up_to_the_margin_of_the_eigenvalues(name: str, margin: int) -> None:
    # Ticks: the most for which all eigenvalues of state and commands on their way lie within the unit circle.
    controller = hold(name)

    def growth(delay: int) -> float:
        state = controller.state + np.array([1e-6, 0, 0, 0, 0, 0])
        queue, sizes = [0.0] * delay, []
        for _ in range(12_000):
            queue.append(float(controller.gain @ (controller.state - state)))
            state = MODEL.step(state, queue.pop(0))
            sizes.append(np.abs(state - controller.state).max())
            if sizes[-1] > 0.1:
                return np.inf
        return max(sizes[9000:]) / max(sizes[1000:4000])

    assert growth(margin - 1) < 1
    assert growth(margin + 2) > 1


def test_a_turned_arm_is_held_where_it_is() -> None:
    controller = hold("down-up")
    turned = controller.state + np.array([-2 * np.pi, 4 * np.pi, 0, 0, 0, 0])
    session = controller.join(100, turned + np.array([0.01, 0, 0, 0, 0, 0]))
    action = session.command(100, turned, np.zeros(0))
    assert action.feedback == pytest.approx(0.0, abs=1e-10)
    assert action.reference == pytest.approx(turned)
    assert controller.distance(turned) == pytest.approx(0.0, abs=1e-12)
    assert session.resynchronise(100, turned) == ""
