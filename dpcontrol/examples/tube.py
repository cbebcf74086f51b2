# %% [markdown]
# # A tube and its cut
# All trajectories that leave an orbit form a tube. Where it meets a surface, here the outer arm upright again after a
# turn, it leaves a closed curve; mirrored, that is the curve of the tube that comes to the orbit. Where the two curves
# cross, a trajectory leaves the orbit and comes back: a homoclinic orbit.

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
tube.set(xlabel="angle of the outer arm (rad)", ylabel="its rate (rad/s)", title="The tube that leaves the orbit")
for k, piece in enumerate(cut.pieces):
    section.plot(*piece.points.T, color="#d4544b", label="tube that leaves" if not k else None)
    section.plot(*piece.stable_points.T, color="#3c9c5f", label="tube that arrives" if not k else None)
for connection in atlas.connections:
    section.plot(*connection.point, "ko", markersize=4)
section.set(xlabel="inner arm (rad)", ylabel="its momentum, scaled", title=f"{len(atlas.connections)} connections")
section.legend()

# %%
figure.savefig("tube.png", dpi=110)
