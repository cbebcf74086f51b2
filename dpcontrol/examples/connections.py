# %% [markdown]
# # All connections and their graph
# At 0.2 J, two saddles have Lyapunov orbits with thirty homoclinic and heteroclinic connections. Every walk on their
# graph is shadowed by a real trajectory.

# %%
import numpy as np
from matplotlib.figure import Figure

import dpcontrol as dp

graph = dp.graph(dp.load_model("lab"), energy=0.2)
kinds = {(a, b): graph.between(a, b) for a in graph.saddles for b in graph.saddles}

# %% All connections by source and target.
figure = Figure(figsize=(11, 8), layout="constrained")
for axes, ((source, target), found) in zip(figure.subplots(2, 2).flat, kinds.items(), strict=True):
    for connection in found:
        times = np.linspace(-connection.time_out, connection.time_in, 300)
        states = connection.orbit.sample(times)
        axes.plot(times, np.rad2deg(states[:, 0]), color="#1f6fb4", linewidth=0.8)
        axes.plot(times, np.rad2deg(states[:, 1]), color="#d9640d", linewidth=0.8)
    axes.set(title=f"{source} → {target}: {len(found)}", xlabel="s from the section", ylabel="angles (degrees)")

# %%
figure.savefig("connections.png", dpi=110)
