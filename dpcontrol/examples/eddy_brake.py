# %% [markdown]
# # A plant of your own as an expression: a switched brake
# An eddy-current brake on the inner joint is switched on during the run. Its clock is a state of the plant, and a mode
# is the state of the switch. The mode is set at the beginning of a step. A step with a change is split at that time.

# %%
from dataclasses import dataclass

import casadi as ca
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import dpcontrol as dp
from dpcontrol.dynamics.components import ComponentFrame


@dataclass(frozen=True)
class EddyBrake(dp.SymbolicPlant):
    """A brake (N m s/rad) on the inner joint after `since` (s)."""

    strength: float
    since: float

    @classmethod
    def sizes(cls, arms: int) -> dp.Sizes:
        return dp.Sizes(states=1, parameters=2, modes=1)

    @classmethod
    def terms(cls, frame: ComponentFrame) -> dp.Terms:
        strength = frame.parameters[0] * frame.modes[0]
        return dp.Terms(dissipation=strength * frame.velocity[0] ** 2 / 2, rates=ca.SX(1))

    @classmethod
    def chosen(cls, frame: ComponentFrame, mass: ca.SX, acceleration: ca.SX) -> ca.SX:
        return ca.if_else(frame.states >= frame.parameters[1] - 1e-9, 1, 0)

    @classmethod
    def guards(cls, frame: ComponentFrame) -> ca.SX:
        return ca.if_else(frame.modes, 1, frame.parameters[1] - frame.states)

    def start(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.zeros(1)


# %%
SINCE = 0.5
plants = {f"{strength:g} N m s/rad": EddyBrake(strength, SINCE) for strength in (0.0, 2e-3, 5e-3)}
runs = {text: dp.closed_loop("outer-turn", plant=plant).run(seed=1) for text, plant in plants.items()}
counted = dp.closed_loop("outer-turn").campaign(runs=16, over={"plant": [*plants.values()]})
shares = [one.completed.successes for one in counted.results]
print("completed of 16:", ", ".join(map(str, shares)))

# %%
figure = Figure(figsize=(7, 4), layout="constrained")
axes = figure.subplots()
for text, run in runs.items():
    axes.plot(run.log.time, run.log.controls["feedback"], label=text)
axes.axvline(SINCE, color="black", linewidth=0.8)
axes.set(xlabel="time (s)", ylabel="feedback (m/s²)", title="Feedback as the inner joint's brake is switched on")
axes.legend()

# %%
figure.savefig("eddy-brake.png", dpi=110)
