# %% [markdown]
# # Export a controller to C
# Estimator, law and supervisor are exported to C99, with tables of the reference and the gains. The tick is the same
# as in the simulated loop.
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
axes.set(xlabel="KiB", xscale="log", title="Sizes of the files in `controller/`")

# %%
figure.savefig("export.png", dpi=110)
