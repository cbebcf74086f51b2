# %% [markdown]
# # A plant of your own as an expression: air drag
# The simulated arms have paddles that the model lacks. A `SymbolicPlant` adds terms to the Lagrangian and the
# dissipation of the simulated arms. Campaigns simulate it in lockstep.

# %%
from dataclasses import dataclass

import casadi as ca
from matplotlib.figure import Figure

import dpcontrol as dp
from dpcontrol.dynamics.components import ComponentFrame


@dataclass(frozen=True)
class AirDrag(dp.SymbolicPlant):
    """Quadratic drag (N s²/m²) at the arms' ends, with lengths in m."""

    drag: tuple[float, ...]
    length: tuple[float, ...]

    @classmethod
    def sizes(cls, arms: int) -> dp.Sizes:
        return dp.Sizes(parameters=2 * arms)

    @classmethod
    def terms(cls, frame: ComponentFrame) -> dp.Terms:
        drag, length = ca.vertsplit(frame.parameters, [0, 2, 4])
        across, up, lost = frame.velocity[-1], ca.SX(0), ca.SX(0)
        for k in range(2):
            across += length[k] * ca.cos(frame.position[k]) * frame.velocity[k]
            up += length[k] * ca.sin(frame.position[k]) * frame.velocity[k]
            # The drag force b v² is the derivative of b v³/3.
            lost += drag[k] * ca.sqrt(across**2 + up**2 + 1e-12) ** 3 / 3
        return dp.Terms(dissipation=lost)


# %%
length = dp.load_model("lab").arms.length
plants = {f"{drag:g} N s²/m²": AirDrag((drag, drag), length) for drag in (0.0, 1e-3, 3e-3)}
runs = {text: dp.closed_loop("outer-turn", plant=plant).run(seed=1) for text, plant in plants.items()}
counted = dp.closed_loop("outer-turn").campaign(runs=16, over={"plant": [*plants.values()]})
shares = [one.completed.successes for one in counted.results]
print("completed of 16:", ", ".join(map(str, shares)))

# %%
figure = Figure(figsize=(7, 4), layout="constrained")
axes = figure.subplots()
for text, run in runs.items():
    axes.plot(run.log.time, run.log.controls["feedback"], label=text)
axes.set(xlabel="time (s)", ylabel="feedback (m/s²)", title="Feedback effort due to drag that the model lacks")
axes.legend()

# %%
figure.savefig("air-drag.png", dpi=110)
