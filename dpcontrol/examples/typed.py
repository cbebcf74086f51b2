# %% [markdown]
# # A typed script
# From an orbit to runs of a law of your own. It checks under `mypy --strict` and under pyright's strict mode.

# %%
# pyright: strict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import dpcontrol as dp


@dataclass
class Damped:
    """Feedforward with a correction by the inner arm's rate.

    `gain` is in m/s.
    """

    gain: float
    called: int = 0

    def control(self, time: float, state: NDArray[np.float64], reference: dp.Setpoint) -> float:
        self.called += 1
        return float(reference.feedforward) + self.gain * float(state[2] - reference.state[2])


# %%
lab = dp.load_model("lab")
orbit = dp.orbit(lab, "down-up", energy=-0.07)
tube = orbit.manifold(stable=True, branch=1)
section: NDArray[np.float64] = tube.cut().pieces[0].points
found = dp.connections(orbit)
walk = dp.shadow(found, [found.connections[0].name])
plan = dp.reference(walk, limits=dp.Limits(position=0.4))
law: dp.Law = Damped(0.0)
runs = [dp.closed_loop(plan, controller=one, mismatch=0.02).run(seed=3) for one in (law, "adaptive")]
for run in runs:
    print(f"{run.score().sentence} ({len(section)} points on the tube's cut)")
errors = [float(np.abs(run.states()[-1] - plan.states()[-1]).max()) for run in runs]
print(f"largest errors at the end: {errors[0]:.2g} and {errors[1]:.2g}")
page = dp.picture(runs[1], file="typed.png")
