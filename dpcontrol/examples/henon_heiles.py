# %% [markdown]
# # A system of your own: Hénon–Heiles
# The system has one well and three saddles, related by rotations of 120 degrees. Orbits, tubes, connections and walks
# need only a Hamiltonian, its coordinates and its saddles.
#
#     H = ½ (p_x² + p_y²) + ½ (x² + y²) + x² y - y³/3
#
# Source: Hénon, Heiles, The applicability of the third integral of motion: some numerical experiments (1964).

# %%
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import dpcontrol as dp


def hamiltonian(q: Any, p: Any, _: Any) -> Any:
    (x, y), (px, py) = q, p
    return (px**2 + py**2 + x**2 + y**2) / 2 + x**2 * y - y**3 / 3


def henon_heiles() -> dp.System:
    saddles = {"top": (0.0, 1.0), "left": (-0.9, -0.5), "right": (0.9, -0.5)}
    return dp.System.from_hamiltonian("henon-heiles", hamiltonian, coordinates=("x", "y"), equilibria=saddles)


# %% The homoclinic connections of the top orbit, over the potential.
if __name__ == "__main__":
    orbit = dp.orbit(henon_heiles(), "top", energy=0.17)
    found = dp.connections(orbit).connections
    figure = Figure(figsize=(7, 6), layout="constrained")
    axes = figure.subplots()
    x, y = np.meshgrid(np.linspace(-1.1, 1.1, 200), np.linspace(-0.8, 1.3, 200))
    axes.contour(x, y, (x**2 + y**2) / 2 + x**2 * y - y**3 / 3, np.linspace(0, 0.3, 16), colors="#c9ced4")
    for connection in found:
        flight = connection.orbit.sample(np.linspace(-connection.time_out, connection.time_in, 600))
        axes.plot(flight[:, 0], flight[:, 1], linewidth=1.0)
    axes.set(xlabel="x", ylabel="y", aspect="equal", title=f"Hénon–Heiles at 0.17: {len(found)} connections")

    # %%
    figure.savefig("henon-heiles.png", dpi=110)
