"""The Hénon–Heiles system: three saddles about one well, turned into each other by 120 degrees.

    H = ½ (p_x² + p_y²) + ½ (x² + y²) + x² y - y³/3

Source: Hénon, Heiles, The applicability of the third integral of motion: some numerical experiments (1964).
"""

import dpcontrol as dp


def hamiltonian(q, p, _):
    (x, y), (px, py) = q, p
    return (px**2 + py**2 + x**2 + y**2) / 2 + x**2 * y - y**3 / 3


def henon_heiles():
    saddles = {"top": (0.0, 1.0), "left": (-0.9, -0.5), "right": (0.9, -0.5)}
    return dp.System.from_hamiltonian("henon-heiles", hamiltonian, coordinates=("x", "y"), equilibria=saddles)
