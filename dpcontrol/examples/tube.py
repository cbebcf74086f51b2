# %% [markdown]
# # A tube and its cut
# The trajectories that leave an orbit form a tube. Its cut with a section, here the outer arm upright after a turn, is
# a closed curve. The mirror image of this curve belongs to the tube that approaches the orbit. At each intersection of
# the two curves, a trajectory leaves the orbit and returns. It is a homoclinic orbit.

# %%
from matplotlib.figure import Figure

import dpcontrol as dp

atlas = dp.atlas(dp.load_model("lab"), energy=-0.07)
cut = atlas.cuts[0]

# %%
figure = Figure(figsize=(11, 5), layout="constrained")
tube, section = figure.subplots(1, 2)
for strand in cut.strands:
    tube.plot(strand[:, 1], strand[:, 3], color="#d4544b", linewidth=0.6)
samples = atlas.orbits[0].samples
tube.plot(samples[:, 1], samples[:, 3], color="black", linewidth=2)
tube.set(xlabel="angle of the outer arm (rad)", ylabel="its rate (rad/s)", title="The unstable tube")
for k, piece in enumerate(cut.pieces):
    section.plot(*piece.points.T, color="#d4544b", label="unstable tube" if not k else None)
    section.plot(*piece.stable_points.T, color="#3c9c5f", label="stable tube" if not k else None)
for connection in atlas.connections:
    section.plot(*connection.point, "ko", markersize=4)
section.set(xlabel="inner arm (rad)", ylabel="its momentum, scaled", title=f"{len(atlas.connections)} connections")
section.legend()

# %%
figure.savefig("tube.png", dpi=110)
