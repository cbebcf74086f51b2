# %% [markdown]
# # A law of your own as an expression
# LQR with integral action on the cart. On a tilted track, with a filter that estimates only the state, the plain
# regulator has a steady error of the cart's position. The law consists of CasADi expressions, so it supports lockstep
# campaigns, margins and C export.

# %%
from pathlib import Path

import casadi as ca
import numpy as np
import scipy.linalg
from matplotlib.figure import Figure
from numpy.typing import NDArray

import dpcontrol as dp

TILT, CART = 0.02, 4
itinerary = """
title = "Hold both arms upright for six seconds"
model = "lab"
start = "hold"
hold = "up-up"
seconds = 6.0
estimator = { augment = [] }
run = { mismatch = 0.02, initial_error = 0.02 }
"""
Path("tilted.toml").write_text(itinerary, encoding="utf-8")
plan = dp.plan("tilted.toml")
model = dp.closed_loop(plan).assembly.model


def gains(weight: float) -> NDArray[np.float64]:
    """Return the gains on the errors and the cart's weighted integral.

    Args:
        weight: weight of the cart's integral.
    """
    a, b = (one[0] for one in model.linearised(plan.reference.state(0.0)[None], np.zeros(1)))
    integrates = np.eye(7)
    integrates[:6, :6], integrates[6, :6] = a, model.period * np.eye(6)[CART]
    push = np.append(b, 0.0)[:, None]
    states = np.diag([100.0, 100.0, 1.0, 1.0, 10.0, 1.0, weight])
    cost = np.array(scipy.linalg.solve_discrete_are(integrates, push, states, np.eye(1)), dtype=np.float64)
    found: NDArray[np.float64] = push.T @ cost @ integrates / (1 + push.T @ cost @ push)
    return found.ravel()


def law(weight: float) -> dp.SymbolicLaw:
    """Return the regulator, without integral action if the weight is 0.

    Args:
        weight: weight of the cart's integral.
    """
    gain = gains(max(weight, 1e-9))

    def lqr(state: ca.SX, reference: dp.Setpoint, memory: ca.SX, parameters: ca.SX) -> tuple[ca.SX, ca.SX]:
        error: ca.SX = state - reference.state
        command: ca.SX = reference.feedforward - ca.dot(gain[:6], error) - (gain[6] * memory[0] if weight else 0)
        return command, memory + model.period * error[CART]

    return dp.SymbolicLaw(lqr, memory=1)


# %%
laws = {"LQR": law(0.0), "with integral action": law(100.0)}
loops = {text: dp.closed_loop(plan, controller=one, tilt=TILT) for text, one in laws.items()}
runs = {text: loop.run(seed=1) for text, loop in loops.items()}
counted = loops["with integral action"].campaign(runs=16)
source = loops["with integral action"].export("controller", force=True)
print(f"{counted.results[0].completed.successes} of 16 runs completed; {source.figures.operations} operations per tick")

# %%
figure = Figure(figsize=(7, 4), layout="constrained")
axes = figure.subplots()
for text, run in runs.items():
    axes.plot(run.log.time, 1e3 * run.log.states["truth"][:, CART], label=text)
axes.set(xlabel="time (s)", ylabel="cart (mm)", title=f"Both arms held upright on a track tilted by {TILT:g} rad")
axes.legend()

# %%
figure.savefig("integral-action.png", dpi=110)
