# %% [markdown]
# # An orbit and its family
# At every energy above a saddle's there is an unstable periodic orbit about it. In each period, an error grows by the
# orbit's Floquet multiplier.

# %%
import numpy as np
from matplotlib.figure import Figure

import dpcontrol as dp

lab = dp.load_model("lab")
orbits = [dp.orbit(lab, "down-up", energy=energy) for energy in (-0.16, -0.12, -0.07, 0.0, 0.1, 0.2)]

# %% Each orbit over one period in the outer arm's phase plane.
figure = Figure(figsize=(7, 5), layout="constrained")
axes = figure.subplots()
for orbit in orbits:
    states = orbit.system.propagator.sample(orbit.state, np.linspace(0.0, orbit.period, 300))
    growth = max(abs(orbit.floquet_multipliers))
    axes.plot(states[:, 1], states[:, 3], label=f"{orbit.energy:g} J: {orbit.period:.3f} s, errors × {growth:.0f}")
axes.set(xlabel="angle of the outer arm (rad)", ylabel="its rate (rad/s)", title="Lyapunov orbits about Down-Up")
axes.legend(fontsize=8)

# %%
figure.savefig("orbit.png", dpi=110)
