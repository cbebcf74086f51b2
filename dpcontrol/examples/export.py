# %% [markdown]
# # Export a controller to C
# Estimator, law and supervisor leave as C99 with tables of the reference and its gains: the same tick as in the loop.
# `make -C controller check` compiles it and replays a simulated run.

# %%
from matplotlib.figure import Figure

import dpcontrol as dp

planned = dp.plan("outer-turn")
source = dp.export(planned, "controller", single=True, force=True)
sizes = {name: len(content) / 1024 for name, content in source.files.items()}

# %%
figure = Figure(figsize=(7, 4), layout="constrained")
axes = figure.subplots()
axes.barh(list(sizes), list(sizes.values()))
axes.set(xlabel="KiB", xscale="log", title="What `controller/` holds")

# %%
figure.savefig("export.png", dpi=110)
