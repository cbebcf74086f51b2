# %% [markdown]
# # Identify the arms from a recording
# Encoder recordings of free swings determine the ratios of inertia and friction. For your own rig, use
# `dp.open_recording("swing.mat")` instead of the simulated swings.

# %%
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import dpcontrol as dp

lab = dp.load_model("lab")
recording = dp.swings(lab, count=4, seconds=2.0, seed=2)
wrong = replace(lab, parameters=replace(lab.arms, inertia=tuple(1.2 * np.array(lab.arms.inertia))))
found = dp.identify(recording, model=wrong)
print(found.status)

# %% The residuals, compared with those of the initial model.
figure = Figure(figsize=(8, 4), layout="constrained")
axes = figure.subplots()
for residuals in found.residuals:
    axes.plot(1e3 * residuals, linewidth=0.7)
before = 1e3 * float(np.median(found.started_at))
axes.set(xlabel="sample", ylabel="residual (mrad)", title=f"After identification ({before:.3g} mrad rms before)")

# %%
figure.savefig("identify.png", dpi=110)
